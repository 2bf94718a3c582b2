//! Whether something that is timed had the machine to itself.
//!
//! A processor's core may serve somebody else beside: the other thread of a core, or a virtual machine's neighbours, whom
//! no list of processes shows. For seconds on end all takes half again as long then, and twice, of which the least of
//! several times that follow each other closely says nothing. So a short piece of known work is timed beside each
//! round of what is measured ([`ContentionProbe`]), and those rounds count beside which it hardly took longer than it ever did
//! ([`TimedRounds`]). Its frames are as large as a camera's: memory that others use as well is felt in them, too.

use std::time::{Duration, Instant};

use anyhow::ensure;
use roundel_core::{
    frame::Frame,
    marker::{Detector, Mode, Params, Tracker},
    sim::{Renderer, Scenario, ScenarioParams},
};

/// A round counts if the work beside it took at most this share longer than it ever did.
const SHARE: f64 = 0.12;
/// Rounds that have to count, and for how long it is tried that so many do.
const WANTED: usize = 10;
const MOST: Duration = Duration::from_millis(3000);
/// Between rounds that do not count, so that many fall into different times.
const PAUSE: Duration = Duration::from_millis(5);
/// Runs of the known work, of which the quickest tells, and its frames and their size.
const RUNS: usize = 3;
const FRAMES: u64 = 2;
const SIZE: (usize, usize) = (1920, 1080);

/// A short piece of work of the kind that is measured: a tracker on rendered frames.
#[derive(Debug)]
pub struct ContentionProbe {
    tracker: Tracker,
    pictures: Vec<Vec<u8>>,
    /// The frame at hand, written just before.
    pixels: Vec<u8>,
    /// The least that it took so far.
    least_s: f64,
}

/// Times of a piece of work, from rounds of the same.
#[derive(Clone, Debug, Default)]
pub struct TimedRounds {
    /// What the known work took about a round, and what each part of the round took, seconds.
    each: Vec<(f64, Vec<f64>)>,
}

impl ContentionProbe {
    pub fn new() -> anyhow::Result<Self> {
        let mut params = ScenarioParams::r4_lite(1);
        params.robots = 4;
        params.still = 4;
        params.flying_share = 0.0;
        let optics = &mut params.optics;
        optics.focal_px *= SIZE.0 as f64 / optics.width as f64;
        (optics.width, optics.height) = SIZE;
        let scenario = Scenario::new(params)?;
        let mut renderer = Renderer::new(&scenario, 0)?;
        let mut pictures = Vec::new();
        for number in 0..FRAMES {
            let mut pixels = vec![0; SIZE.0 * SIZE.1];
            renderer.render(number, &mut pixels)?;
            pictures.push(pixels);
        }
        let params = Params { mode: Mode::Fast, ..Params::default() };
        let detector = Detector::new(scenario.params().kinds.clone(), params)?;
        let pixels = pictures[0].clone();
        let least_s = f64::INFINITY;
        let mut probe = Self { tracker: Tracker::new(detector), pictures, pixels, least_s };
        probe.time_s();
        let is_followed = !probe.tracker.process(&frame(&probe.pixels)).is_empty();
        ensure!(
            is_followed,
            "no roundel was found in the frames by which the machine's quiet is told"
        );
        Ok(probe)
    }

    /// What it takes now, seconds.
    pub fn time_s(&mut self) -> f64 {
        let Self { tracker, pictures, pixels, .. } = self;
        let mut run_s = || {
            tracker.reset();
            let frame_s = |picture: &Vec<u8>| {
                pixels.copy_from_slice(picture);
                let begun = Instant::now();
                tracker.process(&frame(pixels));
                begun.elapsed().as_secs_f64()
            };
            pictures.iter().map(frame_s).sum::<f64>()
        };
        // What was timed has left other things in the caches; later runs find their own.
        run_s();
        let time_s = (0..RUNS).map(|_| run_s()).fold(f64::INFINITY, f64::min);
        self.least_s = self.least_s.min(time_s);
        time_s
    }

    /// Runs `round` until enough rounds count, or it has been tried for long enough; it returns what its parts took.
    pub fn rounds(&mut self, mut round: impl FnMut() -> Vec<f64>) -> TimedRounds {
        let begun = Instant::now();
        let mut rounds = TimedRounds::default();
        let mut before_s = self.time_s();
        loop {
            let times_s = round();
            let after_s = self.time_s();
            rounds.each.push((before_s.max(after_s), times_s));
            let counted = rounds.uncontended(self).count();
            if counted >= WANTED || begun.elapsed() > MOST {
                return rounds;
            }
            before_s = after_s;
            if !self.is_uncontended(after_s) {
                std::thread::sleep(PAUSE);
                before_s = self.time_s();
            }
        }
    }

    fn is_uncontended(&self, time_s: f64) -> bool {
        time_s <= (1.0 + SHARE) * self.least_s
    }
}

fn frame(pixels: &[u8]) -> Frame<'_> {
    Frame::new(pixels, SIZE.0, SIZE.1, SIZE.0).expect("pixels of a frame of this size")
}

impl TimedRounds {
    fn uncontended(&self, probe: &ContentionProbe) -> impl Iterator<Item = &[f64]> {
        let quiet = self.each.iter().filter(|(time_s, _)| probe.is_uncontended(*time_s));
        quiet.map(|(_, times_s)| times_s.as_slice())
    }

    /// Whether the machine was ever quiet meanwhile, by all that the probe knows by now.
    pub fn any_uncontended(&self, probe: &ContentionProbe) -> bool {
        self.uncontended(probe).next().is_some()
    }

    /// The time of each part, seconds, that a quarter of the rounds that count stay below, or of all if none does: each as
    /// much shorter as the known work beside it would have been on the quiet machine. What disturbs single passes and not
    /// the quickest run beside them is left out that way, and what was measured too quick beside a slow one as well.
    pub fn times_s(&self, probe: &ContentionProbe) -> Vec<f64> {
        let was_uncontended = self.any_uncontended(probe);
        let used = self
            .each
            .iter()
            .filter(|(time_s, _)| !was_uncontended || probe.is_uncontended(*time_s));
        let scaled: Vec<(f64, &[f64])> =
            used.map(|(time_s, times_s)| (probe.least_s / time_s, times_s.as_slice())).collect();
        let parts = scaled.first().map_or(0, |(_, times_s)| times_s.len());
        let time_s = |part: usize| {
            let mut list: Vec<f64> =
                scaled.iter().map(|(scale, times_s)| scale * times_s[part]).collect();
            let quarter = list.len() / 4;
            *list.select_nth_unstable_by(quarter, f64::total_cmp).1
        };
        (0..parts).map(time_s).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_beside_which_the_known_work_took_longer_do_not_count() {
        let mut probe = ContentionProbe::new().unwrap();
        probe.least_s = 1.0;
        let each = vec![(1.1, vec![5.0, 9.0]), (1.5, vec![1.0, 1.0]), (1.0, vec![6.0, 7.0])];
        let rounds = TimedRounds { each };
        assert!(rounds.any_uncontended(&probe));
        // Two count, 6 and 7 beside the least, and 5 and 9 beside a tenth more; the lesser stands for a quarter of them.
        assert_eq!(rounds.times_s(&probe), [5.0 / 1.1, 7.0]);
        // Later it is known what a quiet machine does, and that it was none.
        probe.least_s = 0.5;
        assert!(!rounds.any_uncontended(&probe));
        let all = rounds.times_s(&probe);
        assert!(
            (all[0] - 0.5 / 1.5).abs() < 1e-12 && (all[1] - 0.5 / 1.5).abs() < 1e-12,
            "{all:?}"
        );
    }

    #[test]
    fn enough_rounds_are_run_and_the_known_work_is_timed_beside_each() {
        let mut probe = ContentionProbe::new().unwrap();
        let mut count = 0.0;
        let rounds = probe.rounds(|| {
            count += 1.0;
            vec![count]
        });
        assert!(count >= 1.0 && rounds.each.len() as f64 == count);
        assert!(rounds.each.iter().all(|(time_s, _)| *time_s >= probe.least_s));
    }
}
