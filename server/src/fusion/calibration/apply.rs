//! Applies calibrated poses and lenses to cameras, and stores them for the next start.

use roundel_core::{camera::Camera, id::CameraId, world::CameraPlacement};

use super::{CalibrationReport, Shared, file::StoredCamera, lock};
use crate::{
    capture::worker::{PoseSource, calibration_update::CalibrationUpdate},
    model::hub::{EventKind, PoseStatus},
};

impl Shared {
    pub(super) fn apply(&self, report: &CalibrationReport) {
        let installation = self.hub.installation();
        let name = |id: CameraId| installation.camera_name(id);
        let names: Vec<&str> =
            report.cameras.iter().map(|camera| name(camera.result.camera)).collect();
        let found = report
            .cameras
            .iter()
            .map(|camera| (camera.result.camera, camera.placement(), camera.lens.clone()));
        let (version, kept) = self.apply_poses(found);
        self.status.send_modify(|status| {
            status.applied_version = version;
            status.error = kept.clone().err().unwrap_or_default();
        });
        let (Ok(where_kept) | Err(where_kept)) = kept;
        let cameras = names.join(", ");
        let message = format!("Calibration {version} was applied to {cameras}; {where_kept}.");
        self.report_event(EventKind::CalibrationApplied, message);
    }

    /// Applies a pose to one camera, which keeps its lens.
    pub(super) fn apply_pose(&self, camera: CameraId, placement: CameraPlacement) {
        let Some(lens) = self.hub.camera(camera).and_then(|state| state.camera) else {
            return;
        };
        if let (_, Err(error)) = self.apply_poses([(camera, placement, lens)]) {
            tracing::error!("{error}");
        }
    }

    /// Returns the new version, and where it is saved or why it is not.
    fn apply_poses(
        &self,
        found: impl IntoIterator<Item = (CameraId, CameraPlacement, Camera)>,
    ) -> (u64, Result<String, String>) {
        let mut file = lock(&self.file);
        file.version += 1;
        file.made_unix_s = self.clock.now().as_ns().div_euclid(1_000_000_000);
        let version = file.version;
        let cameras = lock(&self.cameras);
        for (id, placement, lens) in found {
            let Some(camera) = cameras.get(&id) else { continue };
            let Some(configured) = camera.configured.clone() else { continue };
            file.set(StoredCamera::new(camera.name.clone(), &placement, &lens, configured));
            let pose = PoseSource::Fixed(PoseStatus::Calibrated, Box::new(placement));
            camera.mailbox.put(CalibrationUpdate { lens, pose, version });
        }
        drop((file, cameras));
        (version, self.save())
    }

    /// Writes the newest version. Returns where it is saved.
    pub(super) fn save(&self) -> Result<String, String> {
        let Some(path) = &self.path else {
            return Ok("not saved".to_owned());
        };
        let _saving = lock(&self.saving);
        let file = lock(&self.file).clone();
        file.save(path).map_err(|error| error.to_string())?;
        Ok(format!("saved in {}", path.display()))
    }
}
