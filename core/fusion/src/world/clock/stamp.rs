//! Coarse correction of stamps: foreign epochs and clock steps.
//!
//! A frame cannot be received before its capture. A stamp later than its reception by more than the largest lead
//! belongs to a clock that was set forward or never had the server's epoch. Stamps of frames in order do not go back
//! unless the clock was set back. A frame far behind its reception is only late. From the first such frame on, a
//! camera's frames are rejected. When [`STEP_FRAMES`] of them agree with one another, the camera's *base* is moved so
//! that stamps have the same distance to reception as before. A single wrong stamp has no effect.
//!
//! The remaining offset, a fraction of a second, is left to `estimator`.

use std::collections::BTreeMap;

use super::FrameStamp;
use roundel_vision::{id::CameraId, time::Timestamp};

/// Number of consecutive frames that confirm a step.
const STEP_FRAMES: u32 = 5;
/// Smallest duration of these frames.
const STEP_NS: i64 = 150_000_000;
/// Tolerance of their agreement.
const AGREEMENT_NS: i64 = 50_000_000;
/// Smallest step back; smaller ones are left to `estimator`.
const MIN_STEP_NS: i64 = 100_000_000;
/// A first stamp this far before its reception has a foreign epoch.
const EPOCH_NS: i64 = 60_000_000_000;
/// Assumed latency of a camera with a foreign epoch.
const LATENCY_NS: i64 = 30_000_000;

/// Verdict about a stamp, with the base to subtract, nanoseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum StampVerdict {
    Valid(i64),
    /// First valid stamp after a step or with a foreign epoch.
    Stepped(i64),
    /// Not to be used.
    Rejected,
}

#[derive(Clone, Copy, Debug)]
struct LastStamp {
    number: u64,
    stamp: Timestamp,
    /// Stamp less base less receiving time.
    ahead_ns: i64,
}

#[derive(Clone, Copy, Debug)]
struct Step {
    ahead_ns: i64,
    since: Timestamp,
    frames: u32,
}

#[derive(Clone, Copy, Debug)]
struct Camera {
    base_ns: i64,
    newest: LastStamp,
    step: Option<Step>,
}

/// Newest stamps and bases of all cameras.
#[derive(Clone, Debug, Default)]
pub(crate) struct StampCorrector {
    cameras: BTreeMap<CameraId, Camera>,
}

impl StampCorrector {
    pub(crate) fn forget(&mut self, camera: CameraId) {
        self.cameras.remove(&camera);
    }

    /// Judges a frame's stamp by its receiving time.
    pub(crate) fn judge(&mut self, frame: &FrameStamp, max_lead_ns: i64) -> StampVerdict {
        let FrameStamp { camera: id, number, stamp, received } = *frame;
        let raw_ns = stamp.ns_since(received);
        let Some(camera) = self.cameras.get_mut(&id) else {
            let is_foreign = raw_ns > max_lead_ns || raw_ns < -EPOCH_NS;
            let base_ns = if is_foreign { raw_ns.saturating_add(LATENCY_NS) } else { 0 };
            let newest = LastStamp { number, stamp, ahead_ns: raw_ns.saturating_sub(base_ns) };
            self.cameras.insert(id, Camera { base_ns, newest, step: None });
            return if is_foreign {
                StampVerdict::Stepped(base_ns)
            } else {
                StampVerdict::Valid(base_ns)
            };
        };
        let ahead_ns = raw_ns.saturating_sub(camera.base_ns);
        let newest = camera.newest;
        let is_next = number > newest.number;
        let went_back = is_next
            && stamp < newest.stamp
            && newest.ahead_ns.saturating_sub(ahead_ns) > MIN_STEP_NS;
        let agrees =
            camera.step.is_some_and(|step| ahead_ns.abs_diff(step.ahead_ns) <= AGREEMENT_NS as u64);
        if ahead_ns <= max_lead_ns && !went_back && !agrees {
            camera.step = None;
            if is_next {
                camera.newest = LastStamp { number, stamp, ahead_ns };
            }
            return StampVerdict::Valid(camera.base_ns);
        }
        let step = match camera.step {
            Some(step) if agrees => Step { frames: step.frames + 1, ..step },
            _ => Step { ahead_ns, since: received, frames: 1 },
        };
        if step.frames < STEP_FRAMES || received.ns_since(step.since) < STEP_NS {
            camera.step = Some(step);
            return StampVerdict::Rejected;
        }
        let moved_ns = step.ahead_ns.saturating_sub(newest.ahead_ns);
        camera.base_ns = camera.base_ns.saturating_add(moved_ns);
        camera.step = None;
        camera.newest = LastStamp { number, stamp, ahead_ns: ahead_ns.saturating_sub(moved_ns) };
        StampVerdict::Stepped(camera.base_ns)
    }
}
