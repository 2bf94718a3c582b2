//! Cameras that come, change and go while nothing is being calibrated.

use std::sync::Arc;

use roundel_core::id::CameraId;

use super::{Calibrator, CalibratorCamera, Shared, lock};

impl Calibrator {
    /// Whether a calibration is recorded or solved now.
    pub fn is_running(&self) -> bool {
        lock(&self.running).as_ref().is_some_and(|(_, thread)| !thread.is_finished())
    }

    /// A camera is there, or is another than it was: what was found of it before does not hold. Where its worker looks
    /// stays the same.
    pub fn set(&self, id: CameraId, camera: CalibratorCamera) {
        let mut cameras = lock(&self.shared.cameras);
        let mailbox = cameras.get(&id).map(|before| before.mailbox.clone());
        let mailbox = mailbox.unwrap_or_else(|| camera.mailbox.clone());
        let name = camera.name.clone();
        let before = cameras.insert(id, CalibratorCamera { mailbox, ..camera });
        drop(cameras);
        self.shared.discard_results(id, before.map_or(name, |before| before.name).as_str());
    }

    /// A camera has another name; what was found of it holds.
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

    /// A camera is there no more.
    pub fn remove(&self, id: CameraId) {
        let camera = lock(&self.shared.cameras).remove(&id);
        if let Some(camera) = camera {
            self.shared.discard_results(id, &camera.name);
        }
    }
}

impl Shared {
    /// What was found of a camera is used no more: not what is in use, nor what could still be taken over.
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

    /// Changes what is kept; writes it if `change` says that it did.
    fn change_file(&self, change: impl FnOnce(&mut super::file::CalibrationFile) -> bool) {
        let mut file = lock(&self.file);
        if change(&mut file)
            && let Err(why) = self.save(&file)
        {
            tracing::error!("{why}");
        }
    }
}
