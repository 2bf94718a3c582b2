//! Has cameras stand where they were found to, now and at the next start.

use roundel_core::{camera::Camera, id::CameraId, world::CameraPlacement};

use super::{
    Report, Shared,
    file::{CalibratedCamera, CalibrationFile},
    lock,
};
use crate::{
    capture::worker::{Place, adoption::Adoption},
    model::hub::{Happening, PoseStatus},
};

/// One camera's place with its lens.
type Found = (CameraId, CameraPlacement, Camera);

impl Shared {
    /// All that a calibration found.
    pub(super) fn apply(&self, report: &Report) {
        let found = report
            .cameras
            .iter()
            .map(|camera| (camera.result.camera, camera.placement(), camera.lens.clone()));
        let (version, kept) = self.take_over(found);
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
        self.tell(Happening::CalibrationApplied, message);
    }

    /// One camera's place, with the lens that it has.
    pub(super) fn adopt(&self, camera: CameraId, placement: CameraPlacement) {
        let Some(lens) = self.hub.camera(camera).and_then(|state| state.camera) else {
            return;
        };
        let (_, kept) = self.take_over(std::iter::once((camera, placement, lens)));
        if let Err(why) = kept {
            tracing::error!("{why}");
        }
    }

    /// The version that this is, and where it is kept or why it could not be.
    fn take_over(&self, found: impl Iterator<Item = Found>) -> (u64, Result<String, String>) {
        let mut file = lock(&self.file);
        file.version += 1;
        file.made_unix_s = self.clock.now().as_ns().div_euclid(1_000_000_000);
        let version = file.version;
        let cameras = lock(&self.cameras);
        for (id, placement, lens) in found {
            let Some(camera) = cameras.get(&id) else { continue };
            let Some(configured) = camera.configured.clone() else { continue };
            let stored = CalibratedCamera::new(camera.name.clone(), &placement, &lens, configured);
            file.set(stored);
            let place = Place::Standing(PoseStatus::Calibrated, Box::new(placement));
            camera.inbox.put(Adoption { lens, place, version });
        }
        (version, self.keep(&file))
    }

    pub(super) fn keep(&self, file: &CalibrationFile) -> Result<String, String> {
        let Some(path) = &self.path else {
            return Ok("it is kept until this server ends".to_owned());
        };
        let kept = format!("it is kept in {}", path.display());
        file.save(path).map(|()| kept).map_err(|error| error.to_string())
    }
}
