//! Capture times: stamps, clock offsets, the order of frames, and frames that never arrive.
//!
//! `stamp` corrects foreign epochs and clock steps, `timeline` decides by their times which frames are used,
//! `missing_frames` counts those that never arrive. `estimator` estimates the remaining clock offsets from moving
//! objects: `comparison` compares several cameras' views of one object, `evidence` holds what follows for their clocks.

mod comparison;
mod estimator;
mod evidence;
mod frame_stamp;
mod missing_frames;
mod stamp;
mod timeline;

pub(super) use comparison::{WINDOW_NS, compare};
pub(super) use estimator::Clocks;
pub use estimator::{ClockEstimate, ClockPrior};
pub(super) use evidence::Comparison;
pub(super) use frame_stamp::FrameStamp;
pub(super) use missing_frames::MissingFrames;
pub(super) use stamp::{StampCorrector, StampVerdict};
pub(super) use timeline::{TimeLimits, Timeline, Verdict};
