//! From a camera's configuration to what the parts of a server are told of it: the hub, fusion, its worker.

use nalgebra::Vector3;
use roundel_core::{
    id::BodyId,
    marker::{Mask, MaskError, Params},
    rigid::Covariance6,
    world::{CameraMount, CameraPlacement, Carrier, ClockPrior, reference::Reference},
};

use crate::{
    capture::worker::{
        PoseSource, calibration_update::CalibrationMailbox, pipeline::PipelineParts,
    },
    fusion::calibration::{CalibratorCamera, file::StoredConfig},
    model::{
        command::{CameraPose, ClockModel},
        config::{CameraConfig, Config, MountConfig, PoseConfig},
        hub::{CameraInfo, DetectionCounts, MountInfo, PoseStatus},
    },
};

/// How much faster or slower than the others a camera's clock may run: quartz without care.
const CLOCK_SKEW: f64 = 1e-4;

/// What the hub says of a camera.
pub fn camera_info(camera: &CameraConfig, config: &Config) -> CameraInfo {
    CameraInfo {
        name: camera.name.clone(),
        source: camera.source.clone(),
        mask: camera.mask.clone(),
        ride: match &camera.pose {
            PoseConfig::Mounted(ride) => Some(mount_info(ride, config)),
            _ => None,
        },
        lens_uncertainty: camera.lens_uncertainty.clone(),
    }
}

fn mount_info(ride: &MountConfig, config: &Config) -> MountInfo {
    let MountConfig { object, object_from_camera, localizes } = *ride;
    let carrier = config.objects.get(object).map(|object| object.name.clone()).unwrap_or_default();
    MountInfo { carrier, object_from_camera, localizes }
}

/// What the calibrator is told of a camera, before a kept calibration is merged.
pub fn calibrator_camera(camera: &CameraConfig) -> CalibratorCamera {
    let rides = matches!(camera.pose, PoseConfig::Mounted(_));
    CalibratorCamera {
        name: camera.name.clone(),
        configured: (!rides).then(|| StoredConfig::of(camera)),
        mailbox: CalibrationMailbox::default(),
    }
}

/// What fusion is told of its place; `bodies` are those of the configured objects.
pub(super) fn camera_pose(
    camera: &CameraConfig,
    config: &Config,
    bodies: &[Option<BodyId>],
) -> CameraPose {
    let covariance = Covariance6::zeros();
    match &camera.pose {
        PoseConfig::Known(world_from_camera) => {
            let world_from_camera = *world_from_camera;
            let placement = CameraPlacement { world_from_camera, covariance };
            CameraPose::Fixed { placement, is_configured: true }
        }
        PoseConfig::Calibrated(placement) => {
            CameraPose::Fixed { placement: **placement, is_configured: false }
        }
        PoseConfig::Unknown => CameraPose::Unknown,
        PoseConfig::Mounted(ride) => {
            let MountConfig { object, object_from_camera, localizes } = *ride;
            let body = bodies.get(object).copied().flatten();
            let mount = body.map(|body| CameraMount {
                carrier: Carrier::Body(body),
                object_from_camera,
                covariance,
                localizes,
            });
            CameraPose::Mounted(mount, mount_info(ride, config))
        }
    }
}

/// What fusion is told of its clock.
pub(super) fn clock_model(camera: &CameraConfig) -> ClockModel {
    let offset_s = camera.clock_uncertainty_s;
    if offset_s > 0.0 {
        ClockModel::Estimated(ClockPrior { offset_s, skew: CLOCK_SKEW })
    } else {
        ClockModel::Exact
    }
}

/// How a camera's frames are searched.
pub fn pipeline_parts(
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
pub(super) fn pose_source(camera: &CameraConfig, config: &Config) -> PoseSource {
    match camera.pose {
        PoseConfig::Known(world_from_camera) => {
            let covariance = Covariance6::zeros();
            let placement = CameraPlacement { world_from_camera, covariance };
            PoseSource::Fixed(PoseStatus::Configured, Box::new(placement))
        }
        PoseConfig::Calibrated(ref placement) => {
            PoseSource::Fixed(PoseStatus::Calibrated, placement.clone())
        }
        PoseConfig::Unknown => PoseSource::Unknown {
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
        PoseConfig::Mounted(_) => PoseSource::Mounted,
    }
}
