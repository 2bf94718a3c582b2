//! Converts recorded messages to the types of core and the hub, as far as they have the data.

use nalgebra::{Matrix6, Quaternion, UnitQuaternion, Vector3};
use roundel_core::{
    camera::Camera,
    id::{CameraId, KindId, ObjectId},
    marker::Code,
    rigid::from_upper_triangle,
    time::Timestamp,
    world::{self, CameraPlacement, LifeStage, ProcessNoise},
};
use roundel_proto::v1;

use crate::capture::push_messages::{self as push, WireFieldError};
use crate::model::convert::{read_covariance, read_pose};
use crate::model::hub::{
    CameraInfo, CameraPoseState, CameraState, CameraStatus, Hub, MountInfo, PoseStatus,
};

/// Reads a snapshot. Covariances between position and velocity and the process noise are not recorded and become 0. The
/// hub learns unknown object names.
pub fn read_snapshot(hub: &Hub, message: &v1::Snapshot) -> world::Snapshot {
    let pose_time = Timestamp::from_ns(message.pose_time_ns);
    let capture_time = Timestamp::from_ns(message.capture_time_ns);
    let objects = message.objects.iter().map(|state| object(hub, pose_time, state)).collect();
    let is_seen = message.capture_time_ns != 0;
    world::Snapshot { pose_time, capture_time: is_seen.then_some(capture_time), objects }
}

fn object(hub: &Hub, pose_time: Timestamp, state: &v1::ObjectState) -> world::ObjectState {
    let vector = |vector: Option<v1::Vector3>| {
        vector.map_or_else(Vector3::zeros, |it| Vector3::new(it.x, it.y, it.z))
    };
    let turn = state.orientation.unwrap_or(v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 });
    let turn = Quaternion::new(turn.w, turn.x, turn.y, turn.z);
    let covariance = read_covariance(&state.covariance);
    let mut motion_covariance = Matrix6::zeros();
    let mut rotation_covariance = Matrix6::zeros();
    motion_covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&covariance.fixed_view::<3, 3>(0, 0));
    rotation_covariance
        .fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&covariance.fixed_view::<3, 3>(3, 3));
    if let Some(velocity) = from_upper_triangle::<3>(&state.velocity_covariance) {
        motion_covariance.fixed_view_mut::<3, 3>(3, 3).copy_from(&velocity);
    }
    let installation = hub.installation();
    let kind = installation.kinds.iter().position(|kind| *kind == state.roundel);
    let newest_observation = pose_time.plus_ns(state.observation_age_ns.saturating_neg());
    world::ObjectState {
        id: ObjectId(state.object_id),
        kind: kind.and_then(|kind| u16::try_from(kind).ok()).map(KindId),
        body: (!state.name.is_empty()).then(|| hub.intern_body_name(&state.name)),
        code: state.code.map(|code| Code { bits: code.bits as u8, number: code.number as u16 }),
        stage: stage(state.stage()),
        position_m: vector(state.position),
        orientation: UnitQuaternion::new_unchecked(turn),
        yaw_observed: state.yaw_observed,
        yaw_symmetry: state.yaw_symmetry.max(1),
        velocity_m_s: vector(state.velocity),
        acceleration_m_s2: vector(state.acceleration),
        angular_velocity_rad_s: vector(state.angular_velocity),
        covariance,
        motion_covariance,
        rotation_covariance,
        process_noise: ProcessNoise::default(),
        cameras: state.cameras.iter().filter_map(|name| installation.camera_id(name)).collect(),
        trust: u8::from(!state.untrusted),
        newest_observation,
        residual: state.residual,
        first_observation: newest_observation,
        observations: 0,
    }
}

fn stage(stage: v1::LifeStage) -> LifeStage {
    match stage {
        v1::LifeStage::Unspecified | v1::LifeStage::Tentative => LifeStage::Tentative,
        v1::LifeStage::Tracked => LifeStage::Tracked,
        v1::LifeStage::Predicted => LifeStage::Predicted,
        v1::LifeStage::Lost => LifeStage::Lost,
    }
}

/// Reads observations of a camera, bit for bit.
pub fn read_observations(
    hub: &Hub,
    camera: CameraId,
    message: v1::FrameObservations,
) -> Result<world::FrameObservations, WireFieldError> {
    let frame = message.frame;
    let read = push::read_observations(&hub.installation(), message, "observations")?;
    Ok(world::FrameObservations { camera, frame, ..read })
}

/// Reads a camera's lens.
pub fn read_lens(camera: &v1::Camera) -> Option<Camera> {
    // The size of a camera without frames is unknown. It is inferred from the principal point.
    let size = |said: u32, middle_px: f64| {
        if said > 0 { said } else { (2.0 * middle_px + 1.0).round().clamp(1.0, 1e5) as u32 }
    };
    let intrinsics = camera.intrinsics.as_ref()?;
    push::calibration_camera(&v1::PushedCalibration {
        width: size(camera.width, intrinsics.cx_px),
        height: size(camera.height, intrinsics.cy_px),
        intrinsics: camera.intrinsics.clone(),
        version: 0,
    })
}

pub fn read_camera_info(camera: &v1::Camera) -> CameraInfo {
    let mount = camera.mount.as_ref().and_then(read_pose);
    CameraInfo {
        name: camera.name.clone(),
        source: camera.source.clone(),
        mask: Vec::new(),
        ride: mount.map(|object_from_camera| MountInfo {
            carrier: camera.carrier.clone(),
            object_from_camera,
            localizes: camera.localizes,
        }),
        lens_uncertainty: None,
    }
}

pub fn read_camera_state(state: &mut CameraState, camera: &v1::Camera) {
    state.status = match camera.status() {
        v1::CameraStatus::Unspecified | v1::CameraStatus::Starting => CameraStatus::Starting,
        v1::CameraStatus::Running => CameraStatus::Running,
        v1::CameraStatus::Failed => CameraStatus::Failed,
        v1::CameraStatus::Finished => CameraStatus::Finished,
    };
    state.error = camera.error.clone();
    (state.width, state.height) = (camera.width as usize, camera.height as usize);
    state.camera = read_lens(camera);
    state.pose = place(camera);
    state.calibration_version = camera.calibration_version;
    (state.frames, state.dropped, state.broken) = (camera.frames, camera.dropped, camera.broken);
    state.restarts = camera.restarts;
    (state.rate_hz, state.promised_hz) = (camera.rate_hz, camera.promised_rate_hz);
    state.rate_reason = camera.rate_reason.clone();
    state.detections = camera.detections as usize;
    (state.detect_ms, state.decode_ms) = (camera.detect_ms, camera.decode_ms);
    (state.blur_px, state.noise) = (camera.blur_px, camera.noise);
    state.reprojection_px = camera.reprojection_px;
    state.latency_ms = camera.latency_ms;
}

fn place(camera: &v1::Camera) -> CameraPoseState {
    let status = match camera.pose_status() {
        v1::PoseStatus::Unspecified => PoseStatus::Searching,
        known => known,
    };
    let covariance = read_covariance(&camera.pose_covariance);
    let placement = camera.pose.as_ref().and_then(read_pose);
    CameraPoseState {
        status,
        placement: placement
            .map(|world_from_camera| CameraPlacement { world_from_camera, covariance }),
        time: (camera.pose_time_ns != 0).then(|| Timestamp::from_ns(camera.pose_time_ns)),
        reason: camera.pose_reason.clone(),
    }
}
