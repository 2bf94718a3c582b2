//! What a running camera is told anew: its lens and its pose, both at once, between two frames.

use std::sync::{Arc, Mutex, PoisonError};

use roundel_core::camera::Camera;

use super::PoseSource;

/// What a camera is from its next frame on.
#[derive(Clone, Debug)]
pub struct CalibrationUpdate {
    pub lens: Camera,
    pub pose: PoseSource,
    /// Of the calibration that says so.
    pub version: u64,
}

/// Where a worker looks before each frame; clones are the same. Of two that come between two frames, the
/// later one counts.
#[derive(Clone, Debug, Default)]
pub struct CalibrationMailbox(Arc<Mutex<Option<CalibrationUpdate>>>);

impl CalibrationMailbox {
    /// Leaves it for the worker's next frame.
    pub fn put(&self, calibration_update: CalibrationUpdate) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(calibration_update);
    }

    /// What has come, once.
    pub(super) fn take(&self) -> Option<CalibrationUpdate> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}
