//! Cameras' stamps brought to the server's time, roughly: epochs of their own, and clocks that step.
//!
//! Nothing is received before it was captured, so that a stamp later than its receipt by more than the
//! greatest lead is of a clock that was set forward (or never was the server's); nor are frames that
//! come in their order stamped backwards, unless the clock was set back. A frame far behind its
//! receipt is neither, only late. From the first such frame on a camera's frames are refused; when
//! [`STEP_FRAMES`] of them agree with one another, the camera's *base* is moved so that stamps are as far
//! from receipts as they were before. A single frame with a wrong stamp moves nothing.
//!
//! What is left, a fraction of a second, is for [`super::clock`] to find.

use std::collections::BTreeMap;

use roundel_vision::{id::CameraId, time::Timestamp};

/// Frames in a row that agree about a step before it is believed …
const STEP_FRAMES: u32 = 5;
/// … over this time at least …
const STEP_NS: i64 = 150_000_000;
/// … within this.
const AGREEMENT_NS: i64 = 50_000_000;
/// A clock set back by less is left to [`super::clock`].
const MIN_STEP_NS: i64 = 100_000_000;
/// A first stamp this far before its receipt is of another epoch.
const EPOCH_NS: i64 = 60_000_000_000;
/// Latency of a camera of which only a stamp of another epoch is known.
const LATENCY_NS: i64 = 30_000_000;

/// What a frame's stamp is worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::world) enum StampVerdict {
    /// Later than it should be by so many nanoseconds.
    Valid(i64),
    /// The same, and the first one after the clock was set, or of another epoch.
    Stepped(i64),
    /// Not to be used.
    MeasurementReject,
}

#[derive(Clone, Copy, Debug)]
struct LastStamp {
    frame: u64,
    stamp: Timestamp,
    /// Stamp, less the base, less receipt.
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

/// What is remembered of all cameras' stamps.
#[derive(Clone, Debug, Default)]
pub(in crate::world) struct StampCorrector {
    cameras: BTreeMap<CameraId, Camera>,
}

impl StampCorrector {
    /// Knows nothing of a camera.
    pub(in crate::world) fn forget(&mut self, camera: CameraId) {
        self.cameras.remove(&camera);
    }

    /// Judges a frame's stamp by when it was received, and remembers it.
    pub(in crate::world) fn judge(
        &mut self,
        (id, frame): (CameraId, u64),
        stamp: Timestamp,
        received: Timestamp,
        max_lead_ns: i64,
    ) -> StampVerdict {
        let raw_ns = stamp.ns_since(received);
        let Some(camera) = self.cameras.get_mut(&id) else {
            let is_foreign = raw_ns > max_lead_ns || raw_ns < -EPOCH_NS;
            let base_ns = if is_foreign { raw_ns.saturating_add(LATENCY_NS) } else { 0 };
            let newest = LastStamp { frame, stamp, ahead_ns: raw_ns.saturating_sub(base_ns) };
            self.cameras.insert(id, Camera { base_ns, newest, step: None });
            return if is_foreign {
                StampVerdict::Stepped(base_ns)
            } else {
                StampVerdict::Valid(base_ns)
            };
        };
        let ahead_ns = raw_ns.saturating_sub(camera.base_ns);
        let newest = camera.newest;
        let is_next = frame > newest.frame;
        let went_back = is_next
            && stamp < newest.stamp
            && newest.ahead_ns.saturating_sub(ahead_ns) > MIN_STEP_NS;
        let agrees =
            camera.step.is_some_and(|step| ahead_ns.abs_diff(step.ahead_ns) <= AGREEMENT_NS as u64);
        if ahead_ns <= max_lead_ns && !went_back && !agrees {
            camera.step = None;
            if is_next {
                camera.newest = LastStamp { frame, stamp, ahead_ns };
            }
            return StampVerdict::Valid(camera.base_ns);
        }
        let step = match camera.step {
            Some(step) if agrees => Step { frames: step.frames + 1, ..step },
            _ => Step { ahead_ns, since: received, frames: 1 },
        };
        if step.frames < STEP_FRAMES || received.ns_since(step.since) < STEP_NS {
            camera.step = Some(step);
            return StampVerdict::MeasurementReject;
        }
        let moved_ns = step.ahead_ns.saturating_sub(newest.ahead_ns);
        camera.base_ns = camera.base_ns.saturating_add(moved_ns);
        camera.step = None;
        camera.newest = LastStamp { frame, stamp, ahead_ns: ahead_ns.saturating_sub(moved_ns) };
        StampVerdict::Stepped(camera.base_ns)
    }
}
