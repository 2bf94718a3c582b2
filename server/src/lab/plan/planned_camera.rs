//! Inputs of a plan: cameras of a configuration or of a running server.

use roundel_core::{
    marker::{Mask, Mode},
    plan::{Imaging, Sensor, TrialCache, map::PlacedCamera},
    rigid::Covariance6,
    world::CameraPlacement,
};

use crate::model::{
    config::{CameraConfig, PoseConfig},
    hub::{CameraInfo, CameraState},
};

#[derive(Clone, Debug)]
pub struct PlannedCamera {
    pub name: String,
    /// The input of the plan, or why the camera is left out and what to do.
    pub station: Result<Box<PlacedCamera>, String>,
}

/// The cameras that the plan can use, or why there are none.
pub fn usable_stations(cameras: &[PlannedCamera]) -> Result<Vec<PlacedCamera>, String> {
    let (mut stations, mut reasons) = (Vec::new(), Vec::new());
    for camera in cameras {
        match &camera.station {
            Ok(station) => stations.push(PlacedCamera::clone(station)),
            Err(reason) => reasons.push(format!("{}: {reason}", camera.name)),
        }
    }
    if !stations.is_empty() {
        return Ok(stations);
    }
    let reasons =
        if cameras.is_empty() { "there are no cameras".to_owned() } else { reasons.join("; ") };
    Err(format!("expected a camera with known lens and pose, found none; {reasons}"))
}

/// A camera of a configuration. Cameras with equal optics and shared `trials` are simulated once.
pub fn from_config(camera: &CameraConfig, imaging: Imaging, trials: &TrialCache) -> PlannedCamera {
    let station = || {
        let place = match &camera.pose {
            PoseConfig::Known(world_from_camera) => CameraPlacement {
                world_from_camera: *world_from_camera,
                covariance: Covariance6::zeros(),
            },
            PoseConfig::Calibrated(place) => **place,
            PoseConfig::Unknown => {
                let reason = "its pose is \"unknown\": configure a pose, or calibrate the arena";
                return Err(reason.to_owned());
            }
            PoseConfig::Mounted(_) => return Err("it is mounted on an object".to_owned()),
        };
        let mask = Mask::of_polygons(&camera.mask).map_err(|error| error.to_string())?;
        let sensor = Sensor {
            camera: camera.calibration.clone(),
            lens_uncertainty: camera.lens_uncertainty.clone(),
            imaging,
            mode: camera.mode,
            trials: trials.clone(),
        };
        Ok(Box::new(PlacedCamera { sensor, place, mask }))
    };
    PlannedCamera { name: camera.name.clone(), station: station() }
}

/// A camera of a running server, with its measured blur and noise; `usual` replaces missing measurements.
pub fn from_running(
    info: &CameraInfo,
    state: &CameraState,
    usual: Imaging,
    trials: &TrialCache,
) -> PlannedCamera {
    let station = || {
        if info.ride.is_some() {
            return Err("it is mounted on an object".to_owned());
        }
        let camera = state.camera.clone().ok_or("its lens is unknown")?;
        let place = state.pose.placement.ok_or_else(|| match state.pose.reason.as_str() {
            "" => "its pose is unknown".to_owned(),
            reason => format!("its pose is unknown: {reason}"),
        })?;
        let measured = |value: f64, usual: f64| if value > 0.0 { value } else { usual };
        let imaging = Imaging {
            noise: measured(state.noise, usual.noise),
            blur_px: measured(state.blur_px, usual.blur_px),
            ..usual
        };
        // The counts of located rings reveal the mode.
        let is_fast = state.counts.precise == 0 && state.counts.fast > 0;
        let mode = if is_fast { Mode::Fast } else { Mode::Precise };
        let mask = Mask::of_polygons(&info.mask).map_err(|error| error.to_string())?;
        let lens_uncertainty = info.lens_uncertainty.clone();
        let sensor = Sensor { camera, lens_uncertainty, imaging, mode, trials: trials.clone() };
        Ok(Box::new(PlacedCamera { sensor, place, mask }))
    };
    PlannedCamera { name: info.name.clone(), station: station() }
}
