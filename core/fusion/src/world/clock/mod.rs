//! Capture times: stamps, clock offsets, the order of frames, and frames that never arrive.
//!
//! `stamp` corrects foreign epochs and clock steps, `timeline` decides by their times which frames are used,
//! `missing_frames` counts those that never arrive. `estimator` estimates the remaining clock offsets from moving
//! objects: `comparison` compares several cameras' views of one object, `evidence` holds what follows for their clocks.

mod comparison;
mod estimator;
mod evidence;
mod missing_frames;
mod stamp;
mod timeline;

pub(super) use comparison::{WINDOW_NS, compare};
pub(super) use estimator::Clocks;
pub use estimator::{ClockEstimate, ClockPrior};
pub(super) use evidence::Comparison;
pub(super) use missing_frames::MissingFrames;
pub(super) use stamp::{StampCorrector, StampVerdict};
pub(super) use timeline::{Timeline, Verdict};

use super::FrameObservations;
use roundel_vision::{id::CameraId, time::Timestamp};

/// Identity and times of a frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FrameStamp {
    pub(crate) camera: CameraId,
    pub(crate) number: u64,
    /// Capture time by the camera's clock.
    pub(crate) stamp: Timestamp,
    pub(crate) received: Timestamp,
}

impl From<&FrameObservations> for FrameStamp {
    fn from(frame: &FrameObservations) -> Self {
        Self {
            camera: frame.camera,
            number: frame.frame,
            stamp: frame.capture_time,
            received: frame.received_time,
        }
    }
}
