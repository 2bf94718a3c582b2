//! From the configuration to what the parts of a server are told: fusion, the hub, the cameras' workers.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use roundel_core::{
    id::{BodyId, CameraId, KindId},
    marker::{Mask, MaskError, Params},
    rigid::Covariance6,
    time::Timestamp,
    world::{
        CameraMount, CameraPlacement, Carrier, ClockPrior, Fusion, FusionParams, Landmark,
        reference::Reference,
    },
};

use super::ServeError;
use crate::{
    config::{
        CameraConfig, CameraPose, Carried, Config, ObjectConfig, ReferenceConfig, RideConfig,
    },
    hub::{CameraInfo, Installation, PoseStatus, RideInfo},
    worker::{Place, pipeline::PipelineParts},
};

/// How much faster or slower than the others a camera's clock may run: quartz without care.
const CLOCK_SKEW: f64 = 1e-4;

/// Cameras are numbered as they are configured.
pub(super) fn camera_id(index: usize) -> CameraId {
    CameraId(u32::try_from(index).unwrap_or(u32::MAX))
}

/// What the hub says of the installation.
pub(super) fn installation(config: &Config, started: Timestamp) -> Installation {
    let unique = started.as_ns() as u64 ^ (u64::from(std::process::id()) << 32).rotate_left(16);
    Installation {
        name: config.name.clone(),
        source_id: format!("{}-{unique:016x}", config.name),
        started,
        snapshot_rate_hz: config.server.snapshot_rate_hz,
        cameras: config
            .cameras
            .iter()
            .map(|camera| CameraInfo {
                name: camera.name.clone(),
                source: camera.source.clone(),
                mask: camera.mask.clone(),
                ride: ride(camera, config),
            })
            .collect(),
        kinds: config.kinds.iter().map(|kind| kind.name.clone()).collect(),
        object_names: config
            .objects
            .iter()
            .filter_map(|object| match object.carries {
                Carried::Kind { kind, .. } => Some((kind, object.name.clone())),
                Carried::Body(_) => None,
            })
            .collect::<BTreeMap<_, _>>(),
        // In the order in which fusion is told of them, which numbers them.
        body_names: config
            .objects
            .iter()
            .filter(|object| matches!(object.carries, Carried::Body(_)))
            .map(|object| object.name.clone())
            .collect(),
    }
}

fn ride(camera: &CameraConfig, config: &Config) -> Option<RideInfo> {
    let CameraPose::Rides(RideConfig { object, object_from_camera, localizes }) = camera.pose
    else {
        return None;
    };
    let carrier = config.objects.get(object)?.name.clone();
    Some(RideInfo { carrier, object_from_camera, localizes })
}

/// A fusion machine that knows objects, motions, landmarks, clocks and cameras.
pub(super) fn fusion(config: &Config) -> Result<Fusion, ServeError> {
    let ns = |seconds: f64| (seconds * 1e9).round() as i64;
    let defaults = FusionParams::default();
    let mut fusion = Fusion::new(FusionParams {
        acceleration_m_s2: config.fusion.acceleration_m_s2,
        late_window_ns: ns(config.fusion.late_window_s),
        predicted_after_ns: ns(config.fusion.predicted_after_s),
        lost_after_ns: ns(config.fusion.lost_after_s),
        max_objects: config.limits.max_objects,
        // Nobody would judge who is held back.
        held_back_ns: if config.server.watches { defaults.held_back_ns } else { 0 },
        ..defaults
    });
    for (index, class) in config.motions.iter().enumerate() {
        fusion.set_motion(KindId(u16::try_from(index).unwrap_or(u16::MAX)), *class);
    }
    let mut bodies = Vec::new();
    for ObjectConfig { name, carries } in &config.objects {
        bodies.push(match carries {
            Carried::Kind { kind, offset_m, motion } => {
                fusion.set_offset(*kind, *offset_m);
                motion.iter().for_each(|class| fusion.set_motion(*kind, *class));
                None
            }
            Carried::Body(body) => {
                let named = |source| ServeError::Object { name: name.clone(), source };
                Some(fusion.add_body(body.clone()).map_err(named)?)
            }
        });
    }
    fusion.set_landmarks(landmarks(config));
    for (index, camera) in config.cameras.iter().enumerate() {
        if camera.clock_uncertainty_s > 0.0 {
            let prior = ClockPrior { offset_s: camera.clock_uncertainty_s, skew: CLOCK_SKEW };
            fusion.set_clock(camera_id(index), prior);
        }
        place_camera(&mut fusion, camera_id(index), camera, &bodies);
    }
    Ok(fusion)
}

/// Cameras that stand where that is known.
pub(super) fn standing(config: &Config) -> BTreeMap<CameraId, CameraPlacement> {
    let known = config.cameras.iter().enumerate().filter_map(|(index, camera)| {
        match place(camera, config) {
            Place::Standing(_, placement) => Some((camera_id(index), *placement)),
            Place::Unknown { .. } | Place::Rides => None,
        }
    });
    known.collect()
}

/// Of these, cameras whose place a person has written.
pub(super) fn configured(config: &Config) -> Vec<CameraId> {
    let cameras = config.cameras.iter().enumerate();
    let written = cameras.filter(|(_, camera)| matches!(camera.pose, CameraPose::Known(_)));
    written.map(|(index, _)| camera_id(index)).collect()
}

/// The reference roundels, in the order of the configuration.
pub(super) fn landmarks(config: &Config) -> Vec<Landmark> {
    let landmark = |reference: &ReferenceConfig| Landmark {
        orientation: reference.orientation,
        position_deviation_m: reference.deviation_m,
        ..Landmark::new(reference.kind, reference.code, reference.position_m)
    };
    config.references.iter().map(landmark).collect()
}

/// Tells fusion what is known of a camera's place; `bodies` are those of the configured objects.
fn place_camera(
    fusion: &mut Fusion,
    id: CameraId,
    camera: &CameraConfig,
    bodies: &[Option<BodyId>],
) {
    let covariance = Covariance6::zeros();
    match camera.pose {
        CameraPose::Known(world_from_camera) => {
            fusion.set_camera(id, Some(CameraPlacement { world_from_camera, covariance }));
        }
        CameraPose::Calibrated(ref placement) => fusion.set_camera(id, Some(**placement)),
        CameraPose::Unknown => {}
        CameraPose::Rides(RideConfig { object, object_from_camera, localizes }) => {
            let body = bodies.get(object).copied().flatten();
            let carrier = body.map(Carrier::Body);
            let mount =
                |carrier| CameraMount { carrier, object_from_camera, covariance, localizes };
            fusion.set_mount(id, carrier.map(mount));
        }
    }
}

/// How a camera's frames are searched.
pub(super) fn pipeline(camera: &CameraConfig, config: &Config) -> Result<PipelineParts, MaskError> {
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
