//! Capture times: camera stamps, clock offsets, the order of frames, and frames that never arrived.

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
