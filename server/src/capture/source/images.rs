//! `images:` – image files, played in real time.

use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use roundel_core::time::Timestamp;

use super::{
    FrameInfo, FrameSource, LentFrame, Playback, SourceError, SourceParts, bad_frame,
    image_list::{ListError, list_files},
    playback::{mean_interval_ns, read_times},
    wrong_size,
};
use crate::{
    capture::image_file::{self, Expectation, GreyImage, ImageError, UNSCALED_HINT},
    model::{address::ImagesAddress, source_rules::SourceRules, stop::StopSignal},
};

/// The files and their due times.
#[derive(Debug)]
pub(super) struct Schedule {
    files: Vec<PathBuf>,
    timing: Timing,
    repeat: bool,
}

#[derive(Debug)]
enum Timing {
    Rate { start: Timestamp, fps: f64 },
    Times { times: Vec<Timestamp>, cycle_ns: i64 },
}

impl Schedule {
    /// Lists the files and their times; `start` is when the first one is due if a rate is given. With rules, files
    /// outside of their folders are left out.
    pub(super) fn read(
        address: &ImagesAddress,
        rules: Option<&SourceRules>,
        playback: &Playback,
        start: Timestamp,
        stop: &StopSignal,
    ) -> Result<Self, SourceError> {
        let failed = SourceError::Failed;
        let listed = list_files(&address.pattern, stop);
        let mut files = listed.map_err(|error| match error {
            ListError::Stopped => SourceError::Stopped,
            other => failed(other.to_string()),
        })?;
        if let Some(rules) = rules {
            rules.retain_inside(&mut files);
            if files.is_empty() {
                return Err(failed(ListError::Empty(address.pattern.clone()).to_string()));
            }
        }
        let timing = match &address.times {
            None => Timing::Rate { start, fps: address.rate_hz() },
            Some(path) => {
                let mut times =
                    read_times(path).map_err(|error| SourceError::Failed(error.to_string()))?;
                if times.len() != files.len() {
                    return Err(SourceError::Failed(format!(
                        "{}: expected one capture time for each of the {} images of {}, found {}",
                        path.display(),
                        files.len(),
                        address.pattern,
                        times.len()
                    )));
                }
                let shift_ns = playback.origin.ns_since(playback.zero.unwrap_or(times[0]));
                let own_round_ns =
                    times[times.len() - 1].ns_since(times[0]) + mean_interval_ns(&times);
                times.iter_mut().for_each(|time| *time = time.plus_ns(shift_ns));
                Timing::Times { times, cycle_ns: playback.cycle_ns.max(own_round_ns) }
            }
        };
        Ok(Self { files, timing, repeat: address.repeat })
    }

    /// When frame number `frame` is due, from 0; `None` after the last one.
    fn due(&self, frame: u64) -> Option<Timestamp> {
        let count = self.files.len() as u64;
        if frame >= count && !self.repeat {
            return None;
        }
        Some(match &self.timing {
            Timing::Rate { start, fps } => start.plus_seconds(frame as f64 / fps),
            Timing::Times { times, cycle_ns } => {
                let round = i64::try_from(frame / count).unwrap_or(i64::MAX);
                times[(frame % count) as usize].plus_ns(cycle_ns.saturating_mul(round))
            }
        })
    }

    fn file(&self, frame: u64) -> &Path {
        &self.files[(frame % self.files.len() as u64) as usize]
    }

    /// The newest frame from `next` on that is due at `now`, or `next` itself if none is.
    fn newest_due(&self, next: u64, now: Timestamp) -> u64 {
        let is_due = |frame: u64| self.due(frame).is_some_and(|due| due <= now);
        // Doubling steps, then halving: fast even if the source was closed for an hour.
        let (mut newest, mut step) = (next, 1);
        while is_due(newest + step) {
            newest += step;
            step *= 2;
        }
        while step > 0 {
            if is_due(newest + step) {
                newest += step;
            }
            step /= 2;
        }
        newest
    }
}

pub(super) struct ImageSource {
    schedule: Schedule,
    parts: SourceParts,
    image: GreyImage,
    expected: Expectation,
    /// `None` before the first frame, which skips no others.
    next: Option<u64>,
}

impl ImageSource {
    pub(super) fn new(schedule: Schedule, parts: SourceParts) -> Self {
        let expected = Expectation { size: Some(parts.size), ..Expectation::default() };
        Self { schedule, parts, image: GreyImage::default(), expected, next: None }
    }
}

impl FrameSource for ImageSource {
    fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError> {
        let frame = self.schedule.newest_due(self.next.unwrap_or(0), self.parts.clock.now());
        let due = self.schedule.due(frame).ok_or(SourceError::Finished)?;
        let skipped = self.next.map_or(0, |next| frame - next);
        // Decoded before it is due, so that decoding costs no latency.
        let path = self.schedule.file(frame);
        let begun = Instant::now();
        let bits = self.expected.depth.unscaled_bits();
        self.image = match image_file::load_expected(path, &mut self.expected) {
            Ok(image) => image,
            Err(ImageError::Size { path, found }) => {
                return Err(wrong_size(&path.display().to_string(), self.parts.size, found));
            }
            Err(error) => return Err(SourceError::Failed(error.to_string())),
        };
        let decoding = begun.elapsed();
        let now = self.expected.depth.unscaled_bits();
        if let Some(bits) = now.filter(|_| now != bits) {
            tracing::warn!(file = %path.display(), bits, "{UNSCALED_HINT}");
        }
        if self.parts.stop.wait(self.parts.clock.until(due)) {
            return Err(SourceError::Stopped);
        }
        self.next = Some(frame + 1);
        let info = FrameInfo { skipped, decoding, ..FrameInfo::at(due) };
        Ok(LentFrame { frame: self.image.frame().map_err(bad_frame)?, info })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn schedule(timing: Timing, files: usize, repeat: bool) -> Schedule {
        let files = (0..files).map(|file| PathBuf::from(format!("{file}.png"))).collect();
        Schedule { files, timing, repeat }
    }

    fn ns(ns: i64) -> Timestamp {
        Timestamp::from_ns(ns)
    }

    #[test]
    fn the_newest_frame_that_is_due_is_next() {
        let rate = schedule(Timing::Rate { start: ns(1000), fps: 1e8 }, 100, false);
        assert_eq!(rate.newest_due(0, ns(0)), 0);
        assert_eq!(rate.newest_due(0, ns(1009)), 0);
        for late in [10, 11, 25, 500, 987, 990] {
            let expected = (late / 10) as u64;
            assert_eq!(rate.newest_due(0, ns(1000 + late)), expected, "{late} ns late");
        }
        assert_eq!(rate.newest_due(3, ns(99_999)), 99);
        assert_eq!(rate.newest_due(100, ns(99_999)), 100);
        assert_eq!(rate.due(100), None);
    }

    #[test]
    fn rounds_follow_without_a_gap() {
        let times = vec![ns(10), ns(20), ns(35)];
        let rounds = schedule(Timing::Times { times, cycle_ns: 40 }, 3, true);
        let due: Vec<i64> = (0..7).map(|frame| rounds.due(frame).unwrap().as_ns()).collect();
        assert_eq!(due, [10, 20, 35, 50, 60, 75, 90]);
        assert_eq!(rounds.file(4), Path::new("1.png"));
        assert_eq!(rounds.newest_due(0, ns(40_000_020)), 3_000_001);
    }
}
