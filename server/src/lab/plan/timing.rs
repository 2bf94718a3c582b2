//! What frames take on this machine: the real tracker and locator, timed on rendered ones.
//!
//! In a [`TimingCase`] robots drive below one camera. Its first frame is searched as a whole; in the others the roundels are
//! followed, sought (a part of each frame goes for new ones) and located, and those count in which all that is kept of
//! tracks has settled. A frame's usual time in several rounds counts, in which the machine was quiet ([`super::contention`]).
//! How fast robots go through the picture is a matter of the camera's rate; frames are exposed for a quarter of the time between two.

use std::{collections::HashMap, time::Instant};

use anyhow::ensure;
use nalgebra::Vector3;
use roundel_core::{
    frame::Frame,
    id::TrackNumber,
    marker::{CodeLayout, Detector, Kind, Mode, Params, Pattern, TrackedRing, Tracker},
    plan::time::Load,
    pose::{Located, Locator, PoseError},
    sim::{CameraMount, Renderer, Scenario, ScenarioParams},
};

use super::{
    contention::{ContentionProbe, TimedRounds},
    robot_rows,
};

/// Frames before those that count, and these: as many as precise mode follows until it looks for motion again.
const SETTLING: usize = 7;
const COUNTED: usize = 9;
const MODES: [Mode; 2] = [Mode::Precise, Mode::Fast];
/// Share of the time between frames in which one is exposed.
const EXPOSED_SHARE: f64 = 0.25;
/// Focal length over the picture's width, that of the reference installations.
const FOCAL: f64 = 1100.0 / 1920.0;
/// What robots drive on average, metres a second, and the highest rate, at which they as good as stand.
const SPEED_M_S: f64 = 0.45;
const MAX_HZ: f64 = 1000.0;
/// Height of the roundels, metres.
const HEIGHT_M: f64 = 0.3;
/// Which way robots in rows move: along no row of pixels.
const WAY: [f64; 2] = [0.8, 0.6];
/// Frames a second of robots in rows that stand.
const STANDING_HZ: f64 = 60.0;

#[derive(Clone, Copy, Debug)]
pub struct TimingCase {
    /// Columns and rows.
    size: (usize, usize),
    robots: usize,
    /// Outer diameter of their roundels, metres, and in the picture, pixels.
    outer_m: f64,
    diameter_px: f64,
    /// How far they move from frame to frame, pixels, about.
    motion_px: f64,
    /// Whether they stand in rows and all move alike, and not each on a way of its own.
    in_rows: bool,
    /// Of coded ones: the bits of their codes.
    bits: Option<u8>,
}

const SMALL: (usize, usize) = (640, 480);
const MIDDLE: (usize, usize) = (1280, 720);
const LARGE: (usize, usize) = (1920, 1080);
const HUGE: (usize, usize) = (2592, 1944);

/// What is measured: size of the picture, robots, metres and pixels of their roundels, pixels a frame.
type CaseRow = ((usize, usize), usize, f64, f64, f64);

// Small ones on robots that show round their prints, which looks nearly like a ring, and on such that do not.
const PLAIN: [CaseRow; 34] = [
    (SMALL, 10, 0.25, 16.0, 1.0),
    (SMALL, 12, 0.25, 24.0, 0.0),
    (MIDDLE, 50, 0.25, 20.0, 1.5),
    (MIDDLE, 36, 0.25, 26.0, 1.0),
    (LARGE, 80, 0.25, 16.0, 1.0),
    (LARGE, 60, 0.25, 24.0, 0.0),
    (HUGE, 20, 0.25, 60.0, 0.0),
    (HUGE, 12, 0.25, 80.0, 1.5),
    (HUGE, 8, 0.25, 95.0, 0.0),
    (SMALL, 1, 0.25, 30.0, 0.0),
    (SMALL, 4, 0.10, 14.0, 1.0),
    (SMALL, 6, 0.16, 22.0, 4.0),
    (SMALL, 1, 0.25, 40.0, 1.5),
    (MIDDLE, 1, 0.16, 25.0, 2.0),
    (MIDDLE, 18, 0.10, 12.0, 0.0),
    (MIDDLE, 12, 0.10, 13.0, 2.0),
    (MIDDLE, 8, 0.16, 24.0, 4.0),
    (MIDDLE, 12, 0.25, 36.0, 0.0),
    (MIDDLE, 8, 0.25, 40.0, 2.0),
    (MIDDLE, 5, 0.25, 60.0, 4.0),
    (LARGE, 1, 0.25, 80.0, 3.0),
    (LARGE, 36, 0.10, 13.0, 0.5),
    (LARGE, 30, 0.10, 16.0, 3.0),
    (LARGE, 44, 0.16, 20.0, 0.0),
    (LARGE, 24, 0.16, 26.0, 1.5),
    (LARGE, 36, 0.25, 32.0, 3.0),
    (LARGE, 22, 0.25, 36.0, 4.5),
    (LARGE, 14, 0.25, 48.0, 0.0),
    (LARGE, 12, 0.25, 52.0, 1.0),
    (LARGE, 6, 0.25, 80.0, 0.0),
    (LARGE, 5, 0.25, 84.0, 4.5),
    (LARGE, 1, 0.16, 20.0, 0.0),
    (HUGE, 30, 0.25, 36.0, 1.5),
    (HUGE, 1, 0.25, 45.0, 0.0),
];

// Pictures full of them, which no arena on whose ways robots keep clear of each other shows.
const ROWS: [CaseRow; 19] = [
    (SMALL, 15, 0.25, 22.0, 2.0),
    (SMALL, 12, 0.25, 38.0, 4.0),
    (MIDDLE, 90, 0.25, 18.0, 1.0),
    (MIDDLE, 60, 0.25, 22.0, 3.0),
    (MIDDLE, 50, 0.25, 28.0, 4.0),
    (MIDDLE, 40, 0.25, 36.0, 0.0),
    (MIDDLE, 24, 0.25, 55.0, 2.0),
    (MIDDLE, 32, 0.25, 62.0, 0.0),
    (MIDDLE, 16, 0.25, 80.0, 0.0),
    (LARGE, 70, 0.25, 15.0, 1.0),
    (LARGE, 100, 0.25, 24.0, 1.0),
    (LARGE, 80, 0.25, 32.0, 2.0),
    (LARGE, 60, 0.25, 45.0, 0.0),
    (LARGE, 60, 0.25, 65.0, 0.0),
    (LARGE, 36, 0.25, 78.0, 1.0),
    (LARGE, 24, 0.25, 95.0, 2.0),
    (LARGE, 12, 0.25, 50.0, 6.0),
    (LARGE, 2, 0.25, 70.0, 1.5),
    (LARGE, 1, 0.25, 110.0, 3.0),
];

// Robots drive at different speeds: the fastest of a case is smeared by no more than 2 px, beyond which the fit of a coded
// one ends in the careful one, ten times as long, and tells nothing of the others.
const CODED: [CaseRow; 15] = [
    (MIDDLE, 1, 0.25, 50.0, 0.0),
    (MIDDLE, 6, 0.25, 42.0, 1.5),
    (MIDDLE, 6, 0.25, 50.0, 3.0),
    (LARGE, 1, 0.25, 70.0, 2.0),
    (LARGE, 20, 0.25, 42.0, 0.0),
    (LARGE, 20, 0.25, 42.0, 1.0),
    (LARGE, 20, 0.25, 44.0, 3.0),
    (LARGE, 12, 0.25, 56.0, 0.0),
    (LARGE, 12, 0.25, 58.0, 2.0),
    (LARGE, 10, 0.25, 60.0, 2.5),
    (LARGE, 5, 0.25, 84.0, 0.0),
    (LARGE, 6, 0.25, 80.0, 1.5),
    (LARGE, 4, 0.25, 90.0, 2.5),
    (HUGE, 24, 0.25, 50.0, 3.0),
    (HUGE, 1, 0.25, 60.0, 0.0),
];

/// Bits of the codes of coded ones.
// All as fast as the fastest of those.
const CODED_ROWS: [CaseRow; 3] =
    [(MIDDLE, 3, 0.25, 62.0, 6.0), (LARGE, 6, 0.25, 48.0, 6.5), (LARGE, 10, 0.25, 70.0, 5.5)];
const BITS: u8 = 8;

pub fn cases() -> Vec<TimingCase> {
    let of = |in_rows: bool, bits: Option<u8>| {
        move |&(size, robots, outer_m, diameter_px, motion_px): &CaseRow| TimingCase {
            size,
            robots,
            outer_m,
            diameter_px,
            motion_px,
            in_rows,
            bits,
        }
    };
    let plain = PLAIN.iter().map(of(false, None));
    let rows = ROWS.iter().map(of(true, None));
    let coded = CODED.iter().map(of(false, Some(BITS)));
    let coded_rows = CODED_ROWS.iter().map(of(true, Some(BITS)));
    plain.chain(rows).chain(coded).chain(coded_rows).collect()
}

#[derive(Clone, Copy, Debug)]
pub struct TimingSample {
    pub mode: Mode,
    pub load: Load,
    /// Seconds a frame.
    pub time_s: f64,
}

/// What is seen of a case in a frame of those that count, in the mean.
#[derive(Clone, Copy, Debug, Default)]
struct CaseStatistics {
    roundels: f64,
    diameter_px: f64,
    motion_px: f64,
}

/// A case that has been timed.
#[derive(Clone, Debug)]
pub struct TimedCase {
    image_px: f64,
    is_coded: bool,
    seen: [CaseStatistics; MODES.len()],
    /// Of each frame in each mode.
    rounds: TimedRounds,
}

/// A frame's way through a worker, timed.
pub struct TimedPipeline {
    tracker: Tracker,
    locator: Locator,
    located: Vec<Result<Located, PoseError>>,
    pixels: Vec<u8>,
    size: (usize, usize),
}

impl TimedPipeline {
    /// For frames of so many columns and rows.
    pub fn new(tracker: Tracker, locator: Locator, size: (usize, usize)) -> Self {
        Self { tracker, locator, located: Vec::new(), pixels: vec![0; size.0 * size.1], size }
    }

    /// The next frame is the first one. This picture goes before: what was timed before has left other things in the
    /// caches, which is the case for no frame of a camera but its very first.
    pub fn begin(&mut self, picture: &[u8]) {
        self.pass(picture);
        self.tracker.reset();
        self.locator.reset();
    }

    /// Follows, locates and seeks what is in a picture of that size: seconds, and how many were followed. As a camera's
    /// frame it has just been written, so that not all of it is in the nearest cache.
    pub fn pass(&mut self, picture: &[u8]) -> (f64, usize) {
        let Self { tracker, locator, located, pixels, size } = self;
        pixels.copy_from_slice(picture);
        let frame = frame_of(pixels, *size);
        let begun = Instant::now();
        let tracked = tracker.follow(&frame);
        locator.locate_all(&frame, tracked, located);
        let followed = tracked.len();
        tracker.seek(&frame);
        (begun.elapsed().as_secs_f64(), followed)
    }
}

/// A case in all modes: followed, and searched as a whole.
pub fn time(case: &TimingCase, probe: &mut ContentionProbe) -> anyhow::Result<TimedCase> {
    let scenario = case.scenario()?;
    let (width, height) = case.size;
    let mut renderer = Renderer::new(&scenario, 0)?;
    let mut pictures = Vec::new();
    let first = case.first_frame();
    for number in first..first + (SETTLING + COUNTED) as u64 {
        let mut pixels = vec![0; width * height];
        renderer.render(number, &mut pixels)?;
        pictures.push(pixels);
        probe.time_s();
    }
    let mut seen = [CaseStatistics::default(); MODES.len()];
    let mut ways = Vec::new();
    for (mode, seen) in MODES.into_iter().zip(&mut seen) {
        let kinds = &scenario.params().kinds;
        let detector = Detector::new(kinds.clone(), Params { mode, ..Params::default() })?;
        let mut tracker = Tracker::new(detector);
        *seen = track_all(&mut tracker, &pictures, case.size)?;
        let camera = renderer.camera().camera.clone();
        ways.push(TimedPipeline::new(
            tracker,
            Locator::new(camera, kinds.clone(), mode),
            case.size,
        ));
    }
    let rounds = probe.rounds(|| {
        let times = |way: &mut TimedPipeline| {
            way.begin(&pictures[1]);
            pictures.iter().map(|picture| way.pass(picture).0).collect::<Vec<_>>()
        };
        ways.iter_mut().flat_map(times).collect()
    });
    Ok(TimedCase { image_px: (width * height) as f64, is_coded: case.bits.is_some(), seen, rounds })
}

impl TimedCase {
    /// Whether the machine was ever quiet meanwhile.
    pub fn was_uncontended(&self, probe: &ContentionProbe) -> bool {
        self.rounds.any_uncontended(probe)
    }

    /// What it took in all modes: of the first frame, and of one of those that count in the mean.
    pub fn measured(&self, probe: &ContentionProbe) -> Vec<TimingSample> {
        let times_s = self.rounds.times_s(probe);
        let modes = MODES.into_iter().zip(&self.seen).zip(times_s.chunks(SETTLING + COUNTED));
        let each = modes.flat_map(|((mode, seen), times_s)| {
            let load = |searched_share: f64| Load {
                image_px: self.image_px,
                roundels: seen.roundels,
                diameter_px: seen.diameter_px,
                motion_px: seen.motion_px,
                is_coded: self.is_coded,
                searched_share,
            };
            let follow_s = times_s[SETTLING..].iter().sum::<f64>() / COUNTED as f64;
            [
                TimingSample { mode, load: load(0.0), time_s: follow_s },
                TimingSample { mode, load: load(1.0), time_s: times_s[0] },
            ]
        });
        each.collect()
    }
}

impl TimingCase {
    fn scenario(&self) -> anyhow::Result<Scenario> {
        let Self { size, robots, outer_m, diameter_px, in_rows, bits, .. } = *self;
        let mut params = ScenarioParams::r4_lite(1);
        params.arena_m = [24.0, 18.0];
        params.robots = robots;
        params.still = 0;
        params.flying_share = 0.0;
        params.flying_top_m = 1.5;
        params.booms = 0;
        params.roundel_height_m = HEIGHT_M;
        params.kinds = vec![match bits {
            Some(bits) => Kind {
                pattern: Pattern::Coded(CodeLayout { bits, min_distance: 1 }),
                ..Kind::plain("robot", outer_m, CodeLayout::RATIO * outer_m)
            },
            None => Kind::plain("robot", outer_m, 0.4 * outer_m),
        }];
        let optics = &mut params.optics;
        (optics.width, optics.height) = size;
        optics.focal_px = FOCAL * size.0 as f64;
        let per_m = diameter_px / outer_m;
        optics.rate_hz = self.rate_hz();
        optics.exposure_s = EXPOSED_SHARE / optics.rate_hz;
        optics.line_time_s = 0.0;
        let above_m = HEIGHT_M + optics.focal_px / per_m;
        params.mounts =
            vec![CameraMount { position_m: [0.2, 0.0, above_m], target_m: [0.0, 0.0, 0.0] }];
        if !in_rows {
            return Ok(Scenario::new(params)?);
        }
        // From far above all of the arena is seen, where there are ways for as many robots as there may be.
        params.mounts.push(CameraMount { position_m: [0.0, 0.0, 40.0], target_m: [0.0; 3] });
        let mut scenario = Scenario::new(params)?;
        let speed_m_s = if self.motion_px > 0.0 { SPEED_M_S } else { 0.0 };
        let velocity_m_s = Vector3::new(WAY[0], WAY[1], 0.0) * speed_m_s;
        let half_s = 0.5 * (SETTLING + COUNTED) as f64 / self.rate_hz();
        robot_rows::arrange_in_rows(&mut scenario, HEIGHT_M, velocity_m_s, half_s)?;
        Ok(scenario)
    }

    fn rate_hz(&self) -> f64 {
        if self.in_rows && self.motion_px == 0.0 {
            return STANDING_HZ;
        }
        (SPEED_M_S * self.diameter_px / self.outer_m / self.motion_px).min(MAX_HZ)
    }

    /// From which on robots are where they are to be seen.
    fn first_frame(&self) -> u64 {
        if self.in_rows { (robot_rows::BEGIN_S * self.rate_hz()).ceil() as u64 } else { 0 }
    }
}

fn frame_of(pixels: &[u8], (width, height): (usize, usize)) -> Frame<'_> {
    Frame::new(pixels, width, height, width).expect("pixels of a frame of this size")
}

/// Goes through all frames without a clock.
fn track_all(
    tracker: &mut Tracker,
    pictures: &[Vec<u8>],
    size: (usize, usize),
) -> anyhow::Result<CaseStatistics> {
    let mut before: HashMap<TrackNumber, TrackedRing> = HashMap::new();
    let (mut count, mut diameters_px, mut moved, mut motions_px) = (0.0, 0.0, 0.0, 0.0);
    for (number, pixels) in pictures.iter().enumerate() {
        let tracked = tracker.process(&frame_of(pixels, size));
        if number >= SETTLING {
            for one in tracked {
                count += 1.0;
                diameters_px += 2.0 * one.ring.outer.mean_radius_px();
                let Some(before) = before.get(&one.track) else { continue };
                let (from, to) = (before.ring.outer.center, one.ring.outer.center);
                moved += 1.0;
                motions_px += (to.u - from.u).hypot(to.v - from.v);
            }
        }
        before = tracked.iter().map(|one| (one.track, *one)).collect();
    }
    ensure!(
        moved > 0.0,
        "no roundel was followed in the frames that were rendered to measure with"
    );
    Ok(CaseStatistics {
        roundels: count / COUNTED as f64,
        diameter_px: diameters_px / count,
        motion_px: motions_px / moved,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_case_can_be_shown_and_the_first_are_followed() {
        for case in cases() {
            case.scenario().unwrap();
        }
        let mut probe = ContentionProbe::new().unwrap();
        let in_rows = PLAIN.len() + 2;
        for case in [cases()[1], cases()[in_rows], cases()[PLAIN.len() + ROWS.len()]] {
            let measured = time(&case, &mut probe).unwrap().measured(&probe);
            assert_eq!(measured.len(), 4, "{measured:?}");
            for one in measured {
                let Load { roundels, diameter_px, motion_px, is_coded, .. } = one.load;
                assert!(one.time_s > 0.0 && roundels >= 0.9 * case.robots as f64, "{one:?}");
                assert!((diameter_px / case.diameter_px - 1.0).abs() < 0.2, "{one:?}");
                assert!((motion_px - case.motion_px).abs() < 0.2 + 0.5 * case.motion_px, "{one:?}");
                assert_eq!(is_coded, case.bits.is_some());
            }
        }
    }
}
