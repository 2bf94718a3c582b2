//! What a running camera is told anew: its lens and its place, both at once, between two frames.

use std::sync::{Arc, Mutex, PoisonError};

use roundel_core::camera::Camera;

use super::Place;

/// What a camera is from its next frame on.
#[derive(Clone, Debug)]
pub struct Adoption {
    /// Its lens.
    pub lens: Camera,
    /// Where it stands.
    pub place: Place,
    /// Of the calibration that says so.
    pub version: u64,
}

/// Where a worker looks before each frame; clones are the same. Of two that come between two frames, the
/// later one counts.
#[derive(Clone, Debug, Default)]
pub struct Inbox(Arc<Mutex<Option<Adoption>>>);

impl Inbox {
    /// Leaves it for the worker's next frame.
    pub fn put(&self, adoption: Adoption) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(adoption);
    }

    /// What has come, once.
    pub(super) fn take(&self) -> Option<Adoption> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}
