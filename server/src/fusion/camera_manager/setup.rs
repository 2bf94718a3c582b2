//! Inputs of hub, fusion, worker and calibrator from a camera's configuration.

use nalgebra::Vector3;
use roundel_core::{
    id::BodyId,
    marker::{Mask, MaskError, Params},
    rigid::{Covariance6, Rigid},
    time::Timestamp,
    world::{CameraMount, CameraPlacement, Carrier, ClockPrior, reference::Reference},
};

use super::{CameraManagerError, bodies::BodyTable, kind_names};
use crate::{
    capture::worker::{
        PoseSource,
        calibration_update::CalibrationMailbox,
        pipeline::{Pipeline, PipelineParts},
    },
    fusion::calibration::{CalibratorCamera, file::StoredConfig},
    model::{
        command::{CameraPose, ClockModel},
        config::{CameraConfig, Config, MountConfig, PoseConfig, UNTRUSTED},
        hub::{CameraInfo, DetectionCounts, Installation, MountInfo, PoseStatus},
    },
};

/// Standard deviation of a camera clock's rate: plain quartz.
const CLOCK_SKEW: f64 = 1e-4;
/// A print's rim is rarely known better: lens and print deviate by as much.
const UNTRUSTED_ERROR_PX: f64 = 0.1;

pub fn installation(config: &Config, started: Timestamp) -> Installation {
    let unique = started.as_ns() as u64 ^ (u64::from(std::process::id()) << 32).rotate_left(16);
    Installation {
        name: config.name.clone(),
        source_id: format!("{}-{unique:016x}", config.name),
        started,
        snapshot_rate_hz: config.server.snapshot_rate_hz,
        cameras: Installation::number_cameras(
            config.cameras.iter().map(|camera| camera_info(camera, config)),
        ),
        kinds: config.kinds.iter().map(|kind| kind.name.clone()).collect(),
        object_names: kind_names(&config.objects),
        body_names: BodyTable::of(&config.objects).names,
    }
}

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

/// `camera`: before a calibration was merged.
pub fn calibrator_camera(camera: &CameraConfig) -> CalibratorCamera {
    let rides = matches!(camera.pose, PoseConfig::Mounted(_));
    CalibratorCamera {
        name: camera.name.clone(),
        configured: (!rides).then(|| StoredConfig::of(camera)),
        mailbox: CalibrationMailbox::default(),
    }
}

/// The pose for fusion; `bodies` are those of the configured objects.
pub(super) fn camera_pose(
    camera: &CameraConfig,
    config: &Config,
    bodies: &[Option<BodyId>],
) -> CameraPose {
    match &camera.pose {
        PoseConfig::Known(world_from_camera) => {
            CameraPose::Fixed { placement: exact(*world_from_camera), is_configured: true }
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
                covariance: Covariance6::zeros(),
                localizes,
            });
            CameraPose::Mounted(mount, mount_info(ride, config))
        }
    }
}

fn exact(world_from_camera: Rigid) -> CameraPlacement {
    CameraPlacement { world_from_camera, covariance: Covariance6::zeros() }
}

/// The clock for fusion.
pub(super) fn clock_model(camera: &CameraConfig) -> ClockModel {
    let offset_s = camera.clock_uncertainty_s;
    if offset_s > 0.0 {
        ClockModel::Estimated(ClockPrior { offset_s, skew: CLOCK_SKEW })
    } else {
        ClockModel::Exact
    }
}

/// Least error of detections that a remote program states, pixels of a rim's place.
pub(super) fn min_error_px(camera: &CameraConfig) -> f64 {
    if camera.trust == UNTRUSTED { UNTRUSTED_ERROR_PX } else { 0.0 }
}

pub(super) fn pipeline(
    camera: &CameraConfig,
    config: &Config,
    counts: DetectionCounts,
) -> Result<Pipeline, CameraManagerError> {
    Ok(Pipeline::new(pipeline_parts(camera, config, counts)?)?)
}

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

/// The pose for the worker.
pub(super) fn pose_source(camera: &CameraConfig, config: &Config) -> PoseSource {
    match camera.pose {
        PoseConfig::Known(world_from_camera) => {
            let placement = exact(world_from_camera);
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
