//! Cameras as the plan takes them: of a configuration, or of a server that runs.

use roundel_core::{
    marker::{Mask, Mode},
    plan::{Imaging, Sensor, Trials, map::Station},
    rigid::Covariance6,
    world::CameraPlacement,
};

use crate::model::{
    config::{CameraConfig, PoseConfig},
    hub::{CameraInfo, CameraState},
};

/// A camera with its name: planned with, or why not.
#[derive(Clone, Debug)]
pub struct PlannedCamera {
    pub name: String,
    /// How it sees, or why it is left out and what to do.
    pub station: Result<Box<Station>, String>,
}

/// A camera of a configuration; cameras that share trials are tried once.
pub fn from_config(camera: &CameraConfig, imaging: Imaging, trials: &Trials) -> PlannedCamera {
    let place = match &camera.pose {
        PoseConfig::Known(world_from_camera) => Ok(CameraPlacement {
            world_from_camera: *world_from_camera,
            covariance: Covariance6::zeros(),
        }),
        PoseConfig::Calibrated(place) => Ok(**place),
        PoseConfig::Unknown => {
            Err("its pose is \"unknown\": write one to plan with, or calibrate the arena"
                .to_owned())
        }
        PoseConfig::Mounted(_) => Err("it rides on an object".to_owned()),
    };
    let (calibration, mode) = (camera.calibration.clone(), camera.mode);
    let sensor = Sensor { camera: calibration, imaging, mode, trials: trials.clone() };
    let doubt = camera.lens_uncertainty.clone();
    let mask = Mask::of_polygons(&camera.mask).map_err(|error| error.to_string());
    let station =
        place.and_then(|place| Ok(Box::new(Station { sensor, doubt, place, mask: mask? })));
    PlannedCamera { name: camera.name.clone(), station }
}

/// A camera of a running server, with the blur and the noise that were measured of it, where they were.
pub fn from_running(
    info: &CameraInfo,
    state: &CameraState,
    usual: Imaging,
    trials: &Trials,
) -> PlannedCamera {
    let station = || {
        if info.ride.is_some() {
            return Err("it rides on an object".to_owned());
        }
        let camera = state.camera.clone().ok_or("its lens is not known yet")?;
        let place = state.pose.placement.ok_or_else(|| match state.pose.reason.as_str() {
            "" => "its place is not known".to_owned(),
            reason => format!("its place is not known: {reason}"),
        })?;
        let measured = |value: f64, usual: f64| if value > 0.0 { value } else { usual };
        let imaging = Imaging {
            noise: measured(state.noise, usual.noise),
            blur_px: measured(state.blur_px, usual.blur_px),
            ..usual
        };
        // What it located it with is the mode; before anything was seen, the usual one.
        let is_fast = state.counts.precise == 0 && state.counts.fast > 0;
        let mode = if is_fast { Mode::Fast } else { Mode::Precise };
        let mask = Mask::of_polygons(&info.mask).map_err(|error| error.to_string())?;
        let doubt = info.lens_uncertainty.clone();
        let sensor = Sensor { camera, imaging, mode, trials: trials.clone() };
        Ok(Box::new(Station { sensor, doubt, place, mask }))
    };
    PlannedCamera { name: info.name.clone(), station: station() }
}
