//! Adds, changes, renames and removes cameras of the calibrator.

use std::sync::{Arc, atomic::Ordering};

use roundel_core::id::CameraId;

use super::{Calibrator, CalibratorCamera, Shared, file::CalibrationFile, lock};

impl Calibrator {
    /// Adds or replaces a camera and discards its results. The mailbox of its worker stays.
    pub fn set(&self, id: CameraId, camera: CalibratorCamera) {
        let mut cameras = lock(&self.shared.cameras);
        let known = cameras.entry(id).or_insert_with(|| camera.clone());
        let before = std::mem::replace(&mut known.name, camera.name);
        known.configured = camera.configured;
        drop(cameras);
        self.shared.discard_results(id, &before);
    }

    /// Renames a camera, which keeps its results.
    pub fn rename(&self, id: CameraId, name: &str) {
        let mut cameras = lock(&self.shared.cameras);
        let Some(camera) = cameras.get_mut(&id) else { return };
        let before = std::mem::replace(&mut camera.name, name.to_owned());
        drop(cameras);
        self.shared.change_file(|file| {
            let stored = file.cameras.iter_mut().find(|stored| stored.name == before);
            stored.map(|stored| name.clone_into(&mut stored.name)).is_some()
        });
    }

    pub fn remove(&self, id: CameraId) {
        let camera = lock(&self.shared.cameras).remove(&id);
        if let Some(camera) = camera {
            self.shared.discard_results(id, &camera.name);
        }
    }

    /// Saves the changes since the last call; callers of the other functions may hold locks that must not wait for a
    /// disk.
    pub fn save_changes(&self) {
        if self.shared.is_unsaved.swap(false, Ordering::Relaxed)
            && let Err(error) = self.shared.save()
        {
            tracing::error!("{error}");
        }
    }
}

impl Shared {
    /// Discards the results of a camera: those in use, and those that could still be applied.
    fn discard_results(&self, id: CameraId, name: &str) {
        self.change_file(|file| {
            let count = file.cameras.len();
            file.cameras.retain(|stored| stored.name != name);
            file.cameras.len() != count
        });
        self.status.send_if_modified(|status| {
            let Some(report) = &mut status.report else { return false };
            if report.cameras.iter().all(|camera| camera.result.camera != id) {
                return false;
            }
            Arc::make_mut(report).cameras.retain(|camera| camera.result.camera != id);
            true
        });
    }

    /// `change` returns whether the file must be saved.
    fn change_file(&self, change: impl FnOnce(&mut CalibrationFile) -> bool) {
        if change(&mut lock(&self.file)) {
            self.is_unsaved.store(true, Ordering::Relaxed);
        }
    }
}
