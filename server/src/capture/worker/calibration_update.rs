//! New lens and pose of a running camera, applied between two frames.

use std::sync::{Arc, Mutex, PoisonError};

use roundel_core::camera::Camera;

use super::PoseSource;

#[derive(Clone, Debug)]
pub struct CalibrationUpdate {
    pub lens: Camera,
    pub pose: PoseSource,
    /// Version of the calibration that it belongs to.
    pub version: u64,
}

/// Slot for the newest calibration update of a worker; clones share it.
#[derive(Clone, Debug, Default)]
pub struct CalibrationMailbox(Arc<Mutex<Option<CalibrationUpdate>>>);

impl CalibrationMailbox {
    /// Replaces an update that the worker has not taken yet.
    pub fn put(&self, calibration_update: CalibrationUpdate) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(calibration_update);
    }

    pub(super) fn take(&self) -> Option<CalibrationUpdate> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}
