//! From a camera's configuration to what the parts of a server are told of it: the hub, fusion, its worker.

use nalgebra::Vector3;
use roundel_core::{
    id::BodyId,
    marker::{Mask, MaskError, Params},
    rigid::Covariance6,
    world::{CameraMount, CameraPlacement, Carrier, ClockPrior, reference::Reference},
};

use crate::{
    capture::worker::{Place, adoption::Inbox, pipeline::PipelineParts},
    fusion::calibration::{Calibrated, file::Configured},
    model::{
        command::{Stand, Timekeeping},
        config::{CameraConfig, CameraPose, Config, RideConfig},
        hub::{CameraInfo, DetectionCounts, PoseStatus, RideInfo},
    },
};

/// How much faster or slower than the others a camera's clock may run: quartz without care.
const CLOCK_SKEW: f64 = 1e-4;

/// What the hub says of a camera.
pub fn info(camera: &CameraConfig, config: &Config) -> CameraInfo {
    CameraInfo {
        name: camera.name.clone(),
        source: camera.source.clone(),
        mask: camera.mask.clone(),
        ride: match &camera.pose {
            CameraPose::Rides(ride) => Some(ride_info(ride, config)),
            _ => None,
        },
        lens_doubt: camera.lens_doubt.clone(),
    }
}

fn ride_info(ride: &RideConfig, config: &Config) -> RideInfo {
    let RideConfig { object, object_from_camera, localizes } = *ride;
    let carrier = config.objects.get(object).map(|object| object.name.clone()).unwrap_or_default();
    RideInfo { carrier, object_from_camera, localizes }
}

/// What the calibrator is told of a camera, before a kept calibration is merged.
pub fn calibrated(camera: &CameraConfig) -> Calibrated {
    let rides = matches!(camera.pose, CameraPose::Rides(_));
    Calibrated {
        name: camera.name.clone(),
        configured: (!rides).then(|| Configured::of(camera)),
        inbox: Inbox::default(),
    }
}

/// What fusion is told of its place; `bodies` are those of the configured objects.
pub(super) fn stand(camera: &CameraConfig, config: &Config, bodies: &[Option<BodyId>]) -> Stand {
    let covariance = Covariance6::zeros();
    match &camera.pose {
        CameraPose::Known(world_from_camera) => {
            let world_from_camera = *world_from_camera;
            let placement = CameraPlacement { world_from_camera, covariance };
            Stand::At { placement, is_written: true }
        }
        CameraPose::Calibrated(placement) => {
            Stand::At { placement: **placement, is_written: false }
        }
        CameraPose::Unknown => Stand::Unknown,
        CameraPose::Rides(ride) => {
            let RideConfig { object, object_from_camera, localizes } = *ride;
            let body = bodies.get(object).copied().flatten();
            let mount = body.map(|body| CameraMount {
                carrier: Carrier::Body(body),
                object_from_camera,
                covariance,
                localizes,
            });
            Stand::On(mount, ride_info(ride, config))
        }
    }
}

/// What fusion is told of its clock.
pub(super) fn timekeeping(camera: &CameraConfig) -> Timekeeping {
    let offset_s = camera.clock_uncertainty_s;
    if offset_s > 0.0 {
        Timekeeping::Estimated(ClockPrior { offset_s, skew: CLOCK_SKEW })
    } else {
        Timekeeping::Exact
    }
}

/// How a camera's frames are searched.
pub fn pipeline(
    camera: &CameraConfig,
    config: &Config,
    counts: DetectionCounts,
) -> Result<PipelineParts, MaskError> {
    Ok(PipelineParts {
        kinds: config.kinds.clone(),
        params: Params {
            mode: camera.mode,
            max_roundels: config.limits.max_roundels_per_camera,
            ..Params::default()
        },
        mask: Mask::of_polygons(&camera.mask)?,
        camera: camera.calibration.clone(),
        line_time_s: camera.line_time_s,
        counts,
    })
}

/// What a camera's worker is told of its place.
pub(super) fn place(camera: &CameraConfig, config: &Config) -> Place {
    match camera.pose {
        CameraPose::Known(world_from_camera) => {
            let covariance = Covariance6::zeros();
            let placement = CameraPlacement { world_from_camera, covariance };
            Place::Standing(PoseStatus::Configured, Box::new(placement))
        }
        CameraPose::Calibrated(ref placement) => {
            Place::Standing(PoseStatus::Calibrated, placement.clone())
        }
        CameraPose::Unknown => Place::Unknown {
            references: config
                .references
                .iter()
                .map(|reference| Reference {
                    position_m: reference.position_m,
                    normal: reference.orientation.map(|turn| turn * Vector3::z()),
                })
                .collect(),
            kinds: config.references.iter().map(|reference| reference.kind).collect(),
        },
        CameraPose::Rides(_) => Place::Rides,
    }
}
