//! What a recording says becomes core's types again, as far as it says it.

use nalgebra::{Matrix6, Quaternion, UnitQuaternion, Vector3};
use roundel_core::{
    camera::Camera,
    id::{CameraId, KindId, ObjectId},
    marker::Code,
    rigid::from_upper_triangle,
    time::Timestamp,
    world::{self, CameraPlacement, LifeStage, ProcessNoise, Unplaced},
};
use roundel_proto::v1;

use crate::capture::push_messages::{self as push, WireFieldError};
use crate::model::convert::{read_covariance, read_pose};
use crate::model::hub::{
    CameraInfo, CameraPoseState, CameraState, CameraStatus, ConfigChange, EventKind, Hub,
    MountInfo, PoseStatus,
};

/// A recorded snapshot. What it does not say, covariances between place and speed and what an object may do next, is
/// taken as 0; names that the hub does not know yet become known to it.
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

/// Recorded observations, bit for bit, of a camera of that id.
pub fn read_observations(
    hub: &Hub,
    camera: CameraId,
    message: v1::FrameObservations,
) -> Result<world::FrameObservations, WireFieldError> {
    let frame = message.frame;
    let read = push::read_observations(&hub.installation(), message, "observations")?;
    Ok(world::FrameObservations { camera, frame, ..read })
}

/// The lens of a recorded camera.
pub fn read_lens(camera: &v1::Camera) -> Option<Camera> {
    // Of one without frames the size is not known: what its principal point is the middle of will do.
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

/// What is fixed of a recorded camera.
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

/// How a recorded camera was doing.
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
        v1::PoseStatus::Configured => PoseStatus::Configured,
        v1::PoseStatus::Found => PoseStatus::Found,
        v1::PoseStatus::Riding => PoseStatus::Riding,
        v1::PoseStatus::Calibrated => PoseStatus::Calibrated,
        v1::PoseStatus::Quarantined => PoseStatus::Quarantined,
        v1::PoseStatus::Unspecified | v1::PoseStatus::Searching => PoseStatus::Searching,
        v1::PoseStatus::CarrierUnseen => PoseStatus::Without(Unplaced::CarrierUnseen),
        v1::PoseStatus::CarrierWithoutYaw => PoseStatus::Without(Unplaced::CarrierWithoutYaw),
        v1::PoseStatus::CarrierUncertain => PoseStatus::Without(Unplaced::CarrierUncertain),
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

/// What a recorded event is about; `None` for one of a kind that this version does not know.
pub fn read_event_kind(hub: &Hub, event: &v1::Event) -> Option<EventKind> {
    use v1::EventKind as Kind;
    let object = |kind| Some(EventKind::ObjectStageChanged(ObjectId(event.object_id), kind));
    let camera = || hub.installation().camera_id(&event.camera);
    let status = |status| camera().map(|id| EventKind::CameraStatusChanged(id, status));
    match event.kind() {
        Kind::Unspecified => None,
        Kind::ObjectAppeared => object(world::EventKind::Appeared),
        Kind::ObjectPredicted => object(world::EventKind::Predicted),
        Kind::ObjectRecovered => object(world::EventKind::Recovered),
        Kind::ObjectLost => object(world::EventKind::Lost),
        Kind::CameraRunning => status(CameraStatus::Running),
        Kind::CameraFailed => status(CameraStatus::Failed),
        Kind::CameraFinished => status(CameraStatus::Finished),
        Kind::CameraClockSet => camera().map(EventKind::CameraClockSet),
        Kind::CameraPlaced => camera().map(EventKind::CameraPlaced),
        Kind::CameraUnplaced => camera().map(EventKind::CameraUnplaced),
        Kind::HeightContradicted => Some(EventKind::HeightContradicted),
        Kind::CalibrationBegun => Some(EventKind::CalibrationBegun),
        Kind::CalibrationDone => Some(EventKind::CalibrationDone),
        Kind::CalibrationFailed => Some(EventKind::CalibrationFailed),
        Kind::CalibrationApplied => Some(EventKind::CalibrationApplied),
        Kind::CameraBumped => camera().map(EventKind::CameraBumped),
        Kind::CameraReturned => camera().map(EventKind::CameraReturned),
        Kind::CameraDrifted => camera().map(EventKind::CameraDrifted),
        Kind::CamerasContradict => Some(EventKind::CamerasContradict),
        Kind::CamerasAgree => Some(EventKind::CamerasAgree),
        Kind::CamerasMisplaced => Some(EventKind::CamerasMisplaced),
        Kind::CameraRateOff => camera().map(EventKind::CameraRateOff),
        Kind::CameraRateAgrees => camera().map(EventKind::CameraRateAgrees),
        Kind::CameraAdded => camera().map(EventKind::CameraAdded),
        Kind::CameraChanged => camera().map(EventKind::CameraChanged),
        Kind::CameraRemoved => camera().map(EventKind::CameraRemoved),
        Kind::ObjectAdded => Some(object_configured(ConfigChange::Added, event)),
        Kind::ObjectChanged => Some(object_configured(ConfigChange::Changed, event)),
        Kind::ObjectRemoved => Some(object_configured(ConfigChange::Removed, event)),
        Kind::RecordingBegun => Some(EventKind::RecordingBegun),
        Kind::RecordingEnded => Some(EventKind::RecordingEnded),
        Kind::RecordingFailed => Some(EventKind::RecordingFailed),
        Kind::RecordingLossy => Some(EventKind::RecordingLossy),
    }
}

fn object_configured(change: ConfigChange, event: &v1::Event) -> EventKind {
    EventKind::ObjectConfigured(change, (event.object_id > 0).then_some(ObjectId(event.object_id)))
}
