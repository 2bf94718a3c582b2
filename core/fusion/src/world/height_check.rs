//! Whether what drives is as high as was said.
//!
//! A wrong height is not harmless: every track is held to it, so that sightings do not fit the tracks that they
//! belong to, each camera sees the object elsewhere on the wrong plane, and ghosts come and go. What a camera
//! measures, held to nothing, gives it away: d = z - h with the variance v = σ_z² + σ_floor². A frame is off if
//! even the sighting of the kind that fits best has d² > 16 v (some robots may be carried about, but not
//! all), by the mean of its d weighted by 1/v. A camera doubts the height when nearly all of
//! [`SAMPLES`] frames, [`EVERY_S`] apart, are off, and the height is told as wrong when one camera has doubted it
//! twice in a row and all that have an opinion doubt it and agree on d, the median.
//!
//! Cameras that disagree have wrong places rather, which is not told here; and a wrong diameter, which all
//! of them see alike, cannot be told from a wrong height.

use std::collections::BTreeMap;

use super::{identity::Subject, params::FLOOR_M};
use crate::track::Measurement;
use roundel_vision::{
    id::{BodyId, CameraId, KindId},
    time::Timestamp,
};

/// Frames in a camera's opinion.
const FRAMES_PER_VERDICT: usize = 64;
/// No two of them are closer, seconds.
const FRAME_SPACING_S: f64 = 0.1;
/// So many of them are off, of a camera that doubts.
const MIN_OFF_FRAMES: usize = 58;
/// A sighting further off than this many deviations is off.
const MAX_SIGMAS: f64 = 4.0;
/// Heights as wrong as this do no harm, metres.
const MIN_ERROR_M: f64 = 0.02;
/// Cameras that agree differ by no more than this part of the distance.
const MAX_DISAGREEMENT: f64 = 0.25;

/// Objects that cameras see at another height than was said of them.
#[derive(Clone, Debug, PartialEq)]
pub struct WrongHeight {
    /// Their kind.
    pub kind: Option<KindId>,
    /// Which body, if it is one.
    pub body: Option<BodyId>,
    /// What was said of the kind's roundels, or of the body's origin, metres.
    pub said_m: f64,
    /// What the cameras see, metres.
    pub seen_m: f64,
    /// Who agrees on that.
    pub cameras: Vec<CameraId>,
}

/// The sightings of a frame.
#[derive(Clone, Copy, Debug)]
struct FrameHeights {
    frame: u64,
    time: Timestamp,
    /// Distances over variances, and these inverted, summed.
    weighted: [f64; 2],
    /// Of the one that fits best.
    sigmas: f64,
}

/// What one camera makes of one height.
#[derive(Clone, Debug)]
struct CameraHeights {
    frame: Option<FrameHeights>,
    /// Distances of frames that are off.
    off_m: [f64; FRAMES_PER_VERDICT],
    off: usize,
    frames: usize,
    verdict: Verdict,
    /// Doubted so often in a row.
    off_verdicts: u32,
}

/// What it came to, last.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Verdict {
    /// Too little seen so far.
    Unknown,
    Consistent,
    /// By the median distance.
    Off(f64),
}

/// All cameras' opinions of one height.
#[derive(Clone, Debug, Default)]
struct HeightCheck {
    cameras: BTreeMap<CameraId, CameraHeights>,
    is_reported: bool,
}

/// Every height that was said.
#[derive(Clone, Debug, Default)]
pub(super) struct HeightChecks {
    checks: BTreeMap<Subject, HeightCheck>,
    mismatches: Vec<WrongHeight>,
}

impl CameraHeights {
    fn new() -> Self {
        let verdict = Verdict::Unknown;
        Self {
            frame: None,
            off_m: [0.0; FRAMES_PER_VERDICT],
            off: 0,
            frames: 0,
            verdict,
            off_verdicts: 0,
        }
    }

    /// Takes one sighting; true when the opinion has been formed anew.
    fn add(&mut self, heights: FrameHeights) -> bool {
        let Some(current) = &mut self.frame else {
            self.frame = Some(heights);
            return false;
        };
        if current.frame == heights.frame {
            current.sigmas = current.sigmas.min(heights.sigmas);
            current.weighted[0] += heights.weighted[0];
            current.weighted[1] += heights.weighted[1];
            return false;
        }
        if heights.time.seconds_since(current.time) < FRAME_SPACING_S {
            return false;
        }
        let complete = std::mem::replace(current, heights);
        if complete.sigmas > MAX_SIGMAS {
            self.off_m[self.off] = complete.weighted[0] / complete.weighted[1];
            self.off += 1;
        }
        self.frames += 1;
        if self.frames < FRAMES_PER_VERDICT {
            return false;
        }
        self.off_m[..self.off].sort_unstable_by(f64::total_cmp);
        let median_m = self.off_m[self.off / 2];
        let is_off = self.off >= MIN_OFF_FRAMES && median_m.abs() > MIN_ERROR_M;
        self.verdict = if is_off { Verdict::Off(median_m) } else { Verdict::Consistent };
        self.off_verdicts = if is_off { self.off_verdicts.saturating_add(1) } else { 0 };
        (self.off, self.frames) = (0, 0);
        true
    }
}

impl HeightCheck {
    /// The mean distance of all who have an opinion, if they all doubt and agree.
    fn agreed_m(&self) -> Option<f64> {
        let (mut sum_m, mut count) = (0.0, 0.0);
        let (mut min_m, mut max_m) = (f64::INFINITY, f64::NEG_INFINITY);
        for camera in self.cameras.values() {
            match camera.verdict {
                Verdict::Unknown => continue,
                Verdict::Consistent => return None,
                Verdict::Off(off_m) => {
                    (min_m, max_m) = (min_m.min(off_m), max_m.max(off_m));
                    sum_m += off_m;
                    count += 1.0;
                }
            }
        }
        let mean_m: f64 = sum_m / count;
        (count > 0.0 && max_m - min_m <= MAX_DISAGREEMENT * mean_m.abs()).then_some(mean_m)
    }
}

impl HeightChecks {
    /// Forgets what cameras made of a height that is another now.
    pub(super) fn forget(&mut self, subject: &Subject) {
        self.checks.remove(subject);
    }

    /// Takes a sighting of what is held at `held_m`, which was told as `said_m`.
    pub(super) fn observe(
        &mut self,
        subject: Subject,
        seen: &Measurement,
        (held_m, said_m): (f64, f64),
    ) {
        let check = self.checks.entry(subject).or_default();
        let camera = check.cameras.entry(seen.camera).or_insert_with(CameraHeights::new);
        let off_m = seen.position_m.z - held_m;
        let variance = seen.position_noise.total[(2, 2)] + FLOOR_M * FLOOR_M;
        let heights = FrameHeights {
            frame: seen.frame,
            time: seen.time,
            weighted: [off_m / variance, 1.0 / variance],
            sigmas: off_m.abs() / variance.sqrt(),
        };
        if !camera.add(heights) {
            return;
        }
        let is_certain = camera.off_verdicts >= 2;
        let Some(agreed_m) = check.agreed_m() else {
            check.is_reported = false;
            return;
        };
        if is_certain && !check.is_reported {
            check.is_reported = true;
            let disagreeing = |(&camera, heights): (&CameraId, &CameraHeights)| {
                matches!(heights.verdict, Verdict::Off(_)).then_some(camera)
            };
            self.mismatches.push(WrongHeight {
                kind: subject.kind,
                body: subject.body,
                said_m,
                seen_m: said_m + agreed_m,
                cameras: check.cameras.iter().filter_map(disagreeing).collect(),
            });
        }
    }

    /// What was found out since the last call.
    pub(super) fn drain(&mut self) -> impl Iterator<Item = WrongHeight> + '_ {
        self.mismatches.drain(..)
    }
}
