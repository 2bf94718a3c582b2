//! Capture times: camera stamps, clock offsets, the order of frames, and frames that never arrived.

pub(super) mod comparison;
pub(super) mod estimator;
pub(super) mod missing_frames;
pub(super) mod stamp;
pub(super) mod timeline;
