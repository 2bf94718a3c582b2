//! Has cameras stand where they were found to, now and at the next start.

use roundel_core::{camera::Camera, id::CameraId, world::CameraPlacement};

use super::{
    CalibrationReport, Shared,
    file::{CalibrationFile, StoredCamera},
    lock,
};
use crate::{
    capture::worker::{PoseSource, calibration_update::CalibrationUpdate},
    model::hub::{EventKind, PoseStatus},
};

/// One camera's pose with its lens.
type FoundPose = (CameraId, CameraPlacement, Camera);

impl Shared {
    pub(super) fn apply(&self, report: &CalibrationReport) {
        let found = report
            .cameras
            .iter()
            .map(|camera| (camera.result.camera, camera.placement(), camera.lens.clone()));
        let (version, kept) = self.apply_poses(found);
        self.status.send_modify(|status| {
            status.applied_version = version;
            status.error = kept.clone().err().unwrap_or_default();
        });
        let name = |id: CameraId| self.hub.installation().camera_name(id).to_owned();
        let names: Vec<String> =
            report.cameras.iter().map(|camera| name(camera.result.camera)).collect();
        let (Ok(where_kept) | Err(where_kept)) = kept;
        let cameras = names.join(", ");
        let message = format!("Calibration {version} is in use by {cameras}; {where_kept}.");
        self.report_event(EventKind::CalibrationApplied, message);
    }

    /// One camera's pose, with the lens that it has.
    pub(super) fn apply_pose(&self, camera: CameraId, placement: CameraPlacement) {
        let Some(lens) = self.hub.camera(camera).and_then(|state| state.camera) else {
            return;
        };
        let (_, kept) = self.apply_poses(std::iter::once((camera, placement, lens)));
        if let Err(why) = kept {
            tracing::error!("{why}");
        }
    }

    /// The version that this is, and where it is kept or why it could not be.
    fn apply_poses(&self, found: impl Iterator<Item = FoundPose>) -> (u64, Result<String, String>) {
        let mut file = lock(&self.file);
        file.version += 1;
        file.made_unix_s = self.clock.now().as_ns().div_euclid(1_000_000_000);
        let version = file.version;
        let cameras = lock(&self.cameras);
        for (id, placement, lens) in found {
            let Some(camera) = cameras.get(&id) else { continue };
            let Some(configured) = camera.configured.clone() else { continue };
            let stored = StoredCamera::new(camera.name.clone(), &placement, &lens, configured);
            file.set(stored);
            let pose = PoseSource::Fixed(PoseStatus::Calibrated, Box::new(placement));
            camera.mailbox.put(CalibrationUpdate { lens, pose, version });
        }
        (version, self.save(&file))
    }

    pub(super) fn save(&self, file: &CalibrationFile) -> Result<String, String> {
        let Some(path) = &self.path else {
            return Ok("it is kept until this server ends".to_owned());
        };
        let kept = format!("it is kept in {}", path.display());
        file.save(path).map(|()| kept).map_err(|error| error.to_string())
    }
}
