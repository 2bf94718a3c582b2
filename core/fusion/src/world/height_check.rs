//! Detects that the configured height of objects on a floor is wrong.
//!
//! A wrong height does harm: every track is constrained to it, so measurements do not fit their tracks, each camera
//! sees the object at another place of the wrong plane, and false tracks come and go. The unconstrained measurements
//! reveal it: d = z - h with the variance v = σ_z² + σ_floor². A frame is off if even the best fitting measurement of
//! the kind has d² > 16 v (some robots may be carried, but not all), by the mean of its d weighted by 1/v. A camera
//! rejects the height when at least [`MIN_OFF_FRAMES`] of [`FRAMES_PER_VERDICT`] frames, [`FRAME_SPACING_S`] apart, are
//! off. The height is reported as wrong when one camera has rejected it twice in a row, and all cameras with a verdict
//! reject it and agree on the median d.
//!
//! Limits: cameras that disagree with each other have wrong poses instead, which is not reported here. A wrong diameter
//! affects all cameras alike and cannot be distinguished from a wrong height.

use std::collections::BTreeMap;

use super::{identity::Subject, params::FLOOR_M};
use crate::track::Measurement;
use roundel_vision::{
    id::{BodyId, CameraId, KindId},
    time::Timestamp,
};

/// Frames of a camera in one verdict.
const FRAMES_PER_VERDICT: usize = 64;
/// Smallest interval between these frames, seconds.
const FRAME_SPACING_S: f64 = 0.1;
/// Number of frames that must be off to reject the height.
const MIN_OFF_FRAMES: usize = 58;
/// A measurement is off beyond this many standard deviations.
const MAX_SIGMAS: f64 = 4.0;
/// Smaller errors of height do no harm, metres.
const MIN_ERROR_M: f64 = 0.02;
/// Largest difference between cameras that agree, as a share of d.
const MAX_DISAGREEMENT: f64 = 0.25;

/// Objects that cameras measure at another height than the configured one.
#[derive(Clone, Debug, PartialEq)]
pub struct WrongHeight {
    /// Kind of the objects' roundels.
    pub kind: Option<KindId>,
    /// The body, if it is one.
    pub body: Option<BodyId>,
    /// Configured height of the kind's roundels, or of the body's origin, metres.
    pub configured_m: f64,
    /// Height that the cameras measure, metres.
    pub measured_m: f64,
    /// Cameras that agree on it.
    pub cameras: Vec<CameraId>,
}

/// Height to which an object is constrained.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ConstrainedHeight {
    /// Height of the point that the track follows, metres.
    pub(super) tracked_m: f64,
    /// Configured height, metres.
    pub(super) configured_m: f64,
}

/// Measurements of one frame.
#[derive(Clone, Copy, Debug)]
struct FrameHeights {
    frame: u64,
    time: Timestamp,
    /// Sums of d/v and of 1/v.
    weighted: [f64; 2],
    /// |d| in standard deviations, of the best fitting measurement.
    sigmas: f64,
}

/// One camera's frames and verdict about one height.
#[derive(Clone, Debug)]
struct CameraHeights {
    frame: Option<FrameHeights>,
    /// d of frames that are off.
    off_m: [f64; FRAMES_PER_VERDICT],
    off: usize,
    frames: usize,
    verdict: Verdict,
    /// Number of consecutive verdicts that reject the height.
    off_verdicts: u32,
}

/// Newest verdict of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Verdict {
    /// Too few frames.
    Unknown,
    Consistent,
    /// Rejected, with the median d.
    Off(f64),
}

/// All cameras' verdicts about one height.
#[derive(Clone, Debug, Default)]
struct HeightCheck {
    cameras: BTreeMap<CameraId, CameraHeights>,
    is_reported: bool,
}

/// All configured heights.
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

    /// Adds one measurement; returns true when a new verdict was reached.
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
    /// Mean d of all cameras with a verdict, if all reject the height and agree.
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
    /// Discards the verdicts about a height that was changed.
    pub(super) fn forget(&mut self, subject: &Subject) {
        self.checks.remove(subject);
    }

    /// Adds a measurement of an object whose tracked point is constrained to a height.
    pub(super) fn observe(
        &mut self,
        subject: Subject,
        measurement: &Measurement,
        heights: ConstrainedHeight,
    ) {
        let check = self.checks.entry(subject).or_default();
        let camera = check.cameras.entry(measurement.camera).or_insert_with(CameraHeights::new);
        let off_m = measurement.position_m.z - heights.tracked_m;
        let variance = measurement.position_noise.total[(2, 2)] + FLOOR_M * FLOOR_M;
        let frame = FrameHeights {
            frame: measurement.frame,
            time: measurement.time,
            weighted: [off_m / variance, 1.0 / variance],
            sigmas: off_m.abs() / variance.sqrt(),
        };
        if !camera.add(frame) {
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
                configured_m: heights.configured_m,
                measured_m: heights.configured_m + agreed_m,
                cameras: check.cameras.iter().filter_map(disagreeing).collect(),
            });
        }
    }

    /// Takes the findings since the last call.
    pub(super) fn drain(&mut self) -> impl Iterator<Item = WrongHeight> + '_ {
        self.mismatches.drain(..)
    }
}
