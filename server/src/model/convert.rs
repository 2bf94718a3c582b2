//! Converts core's types and the hub's to messages. The `.proto` files document the fields.

mod fused;

pub use fused::{
    fused_camera, fused_configuration, read_covariance, read_fused_camera, read_pose,
    recorded_configuration,
};

use nalgebra::{UnitQuaternion, Vector3};
use roundel_core::{
    calib::watch::{CameraHealth, WatchState},
    camera::{Camera, PixelPoint},
    ellipse::Ellipse,
    id::CameraId,
    marker::{Code, CodeReading},
    pose::{Detection, RoundelPose},
    rigid::{Rigid, upper_triangle},
    time::Timestamp,
    world::{
        self, ClockEstimate, FrameObservations, KindPrintSize, LifeStage, ObjectState, PrintSize,
        PrintSizeState,
    },
};
use roundel_proto::v1;

use crate::model::capture_clock::CaptureClock;
use crate::model::hub::{
    CameraPoseState, CameraState, CameraStatus, FusedSnapshot, Installation, ObjectRecord,
    SenderLink,
};

/// `chosen`: the objects of `fused` that the subscriber selected.
pub fn snapshot(
    installation: &Installation,
    fused: &FusedSnapshot,
    chosen: &world::Snapshot,
    with_covariance: bool,
) -> v1::Snapshot {
    v1::Snapshot {
        sequence: fused.sequence,
        source_id: installation.source_id.clone(),
        pose_time_ns: chosen.pose_time.as_ns(),
        capture_time_ns: chosen.capture_time.unwrap_or_default().as_ns(),
        fused_time_ns: fused.fused_time.as_ns(),
        sent_time_ns: 0,
        objects: chosen
            .objects
            .iter()
            .map(|state| object_state(installation, chosen.pose_time, state, with_covariance))
            .collect(),
        missed: 0,
    }
}

fn object_state(
    installation: &Installation,
    pose_time: Timestamp,
    state: &ObjectState,
    with_covariance: bool,
) -> v1::ObjectState {
    let velocity_covariance = state.motion_covariance.fixed_view::<3, 3>(3, 3).into_owned();
    v1::ObjectState {
        object_id: state.id.0,
        name: installation.object_name(state.kind, state.body).to_owned(),
        stage: life_stage(state.stage) as i32,
        position: Some(vector(&state.position_m)),
        orientation: Some(quaternion(&state.orientation)),
        yaw_observed: state.yaw_observed,
        yaw_symmetry: if state.yaw_observed { state.yaw_symmetry } else { 0 },
        velocity: Some(vector(&state.velocity_m_s)),
        angular_velocity: Some(vector(&state.angular_velocity_rad_s)),
        covariance: if with_covariance { upper_triangle(&state.covariance) } else { Vec::new() },
        velocity_covariance: if with_covariance {
            upper_triangle(&velocity_covariance)
        } else {
            Vec::new()
        },
        cameras: names(installation, &state.cameras),
        observation_age_ns: pose_time.ns_since(state.newest_observation),
        residual: state.residual,
        untrusted: state.trust == 0,
        acceleration: with_covariance.then(|| vector(&state.acceleration_m_s2)),
        roundel: installation.kind_name(state.kind).to_owned(),
        code: state.code.map(code),
    }
}

/// Names of the cameras that still exist.
fn names(installation: &Installation, cameras: &[CameraId]) -> Vec<String> {
    let each = cameras.iter().filter_map(|id| installation.cameras.get(id));
    each.map(|camera| camera.name.clone()).collect()
}

pub fn observations(
    installation: &Installation,
    frame: &FrameObservations,
) -> v1::FrameObservations {
    v1::FrameObservations {
        camera: installation.camera_name(frame.camera).to_owned(),
        frame: frame.frame,
        capture_time_ns: frame.capture_time.as_ns(),
        received_time_ns: frame.received_time.as_ns(),
        calibration_version: frame.calibration_version,
        detections: frame.detections.iter().map(|d| detection(installation, d)).collect(),
        missed: 0,
    }
}

fn detection(installation: &Installation, detection: &Detection) -> v1::Detection {
    let ring = &detection.ring;
    v1::Detection {
        track: detection.track.0,
        roundel: installation.kind_name(ring.kind).to_owned(),
        outer: Some(ellipse(&ring.outer)),
        inner: Some(ellipse(&ring.inner)),
        threshold: u32::from(ring.threshold),
        capture_time_ns: detection.capture_time.as_ns(),
        pose: detection.pose.as_ref().map(roundel_pose),
        code: ring.code.as_ref().map(code_reading),
        black: ring.black,
        white: ring.white,
    }
}

fn code(code: Code) -> v1::Code {
    v1::Code { bits: u32::from(code.bits), number: u32::from(code.number) }
}

fn code_reading(reading: &CodeReading) -> v1::CodeReading {
    v1::CodeReading {
        bits: u32::from(reading.code.bits),
        number: u32::from(reading.code.number),
        confidence: reading.confidence,
        corrected_bits: u32::from(reading.corrected),
        zero: Some(pixel_point(&reading.zero)),
    }
}

fn roundel_pose(pose: &RoundelPose) -> v1::RoundelPose {
    v1::RoundelPose {
        position: Some(vector(&pose.position_m)),
        normal: Some(vector(&pose.normal)),
        normal_likelihood: pose.normal_likelihood,
        other_normal: Some(vector(&pose.other_normal)),
        yaw_rad: pose.yaw_rad,
        yaw_symmetry: pose.yaw_rad.map_or(0, |_| pose.yaw_symmetry),
        covariance: upper_triangle(&pose.covariance),
    }
}

pub fn camera(installation: &Installation, id: CameraId, state: &CameraState) -> v1::Camera {
    let info = installation.cameras.get(&id);
    let ride = info.and_then(|info| info.ride.as_ref());
    let CameraPoseState { status, placement, time, reason } = &state.pose;
    let covariance = placement.as_ref().map(|placement| upper_triangle(&placement.covariance));
    v1::Camera {
        name: installation.camera_name(id).to_owned(),
        source: info.map(|info| info.source.clone()).unwrap_or_default(),
        status: camera_status(state.status) as i32,
        error: state.error.clone(),
        width: pixels(state.width),
        height: pixels(state.height),
        pose: placement.as_ref().map(|placement| pose(&placement.world_from_camera)),
        intrinsics: state.camera.as_ref().map(intrinsics),
        calibration_version: state.calibration_version,
        frames: state.frames,
        dropped: state.dropped,
        restarts: state.restarts,
        rate_hz: state.rate_hz,
        detections: pixels(state.detections),
        detect_ms: state.detect_ms,
        latency_ms: state.latency_ms,
        blur_px: state.blur_px,
        noise: state.noise,
        reprojection_px: state.reprojection_px,
        budget_used: state.budget_used,
        deferred: state.counts.deferred,
        clock: state.clock.as_ref().map(camera_clock),
        pose_status: (*status).into(),
        pose_reason: reason.clone(),
        pose_covariance: covariance.unwrap_or_default(),
        pose_time_ns: time.unwrap_or_default().as_ns(),
        carrier: ride.map(|ride| ride.carrier.clone()).unwrap_or_default(),
        mount: ride.map(|ride| pose(&ride.object_from_camera)),
        localizes: ride.is_some_and(|ride| ride.localizes),
        agreement: state.health.as_ref().map(agreement),
        capture_clock: state.capture_clock.map(capture_clock),
        broken: state.broken,
        decode_ms: state.decode_ms,
        link: state.link.as_ref().map(camera_link),
        promised_rate_hz: state.promised_hz,
        rate_reason: state.rate_reason.clone(),
    }
}

fn camera_clock(clock: &ClockEstimate) -> v1::CameraClock {
    v1::CameraClock {
        offset_ms: clock.offset_s * 1e3,
        skew_ppm: clock.skew * 1e6,
        deviation_ms: clock.deviation_s * 1e3,
    }
}

pub fn capture_clock(clock: CaptureClock) -> v1::CaptureClock {
    v1::CaptureClock { base: clock.base.into(), deviation_ms: clock.deviation_s * 1e3 }
}

pub fn intrinsics(camera: &Camera) -> v1::Intrinsics {
    let intrinsics = camera.intrinsics();
    v1::Intrinsics {
        lens: intrinsics.lens.name().to_owned(),
        fx_px: intrinsics.fx_px,
        fy_px: intrinsics.fy_px,
        cx_px: intrinsics.cx_px,
        cy_px: intrinsics.cy_px,
        distortion: intrinsics.lens.coefficients().to_vec(),
    }
}

/// `sizes`: of the kinds with a tolerance.
pub fn print_sizes(installation: &Installation, sizes: &[KindPrintSize]) -> Vec<v1::PrintSize> {
    let each = installation.kinds.iter().enumerate().map(|(index, name)| {
        let size = sizes.iter().find(|size| usize::from(size.kind.0) == index);
        let PrintSize { factor, deviation, .. } = size.map_or(PrintSize::EXACT, |size| size.size);
        let state = match size.map(|size| size.state) {
            None => v1::PrintSizeState::Exact,
            Some(PrintSizeState::Assumed) => v1::PrintSizeState::Assumed,
            Some(PrintSizeState::Measured) => v1::PrintSizeState::Measured,
            Some(PrintSizeState::Contradicted) => v1::PrintSizeState::Contradicted,
        };
        let cameras = size.map_or(&[][..], |size| &size.cameras);
        v1::PrintSize {
            roundel: name.clone(),
            factor,
            deviation,
            state: state as i32,
            cameras: names(installation, cameras),
        }
    });
    each.collect()
}

pub fn object(installation: &Installation, record: &ObjectRecord) -> v1::Object {
    v1::Object {
        object_id: record.id.0,
        name: installation.object_name(record.kind, record.body).to_owned(),
        roundel: installation.kind_name(record.kind).to_owned(),
        stage: life_stage(record.stage) as i32,
        first_seen_time_ns: record.first_seen.as_ns(),
        last_seen_time_ns: record.last_seen.as_ns(),
        observations: record.observations,
        code: record.code.map(code),
    }
}

/// Without the capabilities of the server.
pub fn server_info(installation: &Installation) -> v1::ServerInfo {
    v1::ServerInfo {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        source_id: installation.source_id.clone(),
        name: installation.name.clone(),
        started_time_ns: installation.started.as_ns(),
        snapshot_rate_hz: installation.snapshot_rate_hz,
        ..v1::ServerInfo::default()
    }
}

fn life_stage(stage: LifeStage) -> v1::LifeStage {
    match stage {
        LifeStage::Tentative => v1::LifeStage::Tentative,
        LifeStage::Tracked => v1::LifeStage::Tracked,
        LifeStage::Predicted => v1::LifeStage::Predicted,
        LifeStage::Lost => v1::LifeStage::Lost,
    }
}

fn camera_status(status: CameraStatus) -> v1::CameraStatus {
    match status {
        CameraStatus::Starting => v1::CameraStatus::Starting,
        CameraStatus::Running => v1::CameraStatus::Running,
        CameraStatus::Failed => v1::CameraStatus::Failed,
        CameraStatus::Finished => v1::CameraStatus::Finished,
    }
}

fn ellipse(ellipse: &Ellipse) -> v1::Ellipse {
    v1::Ellipse {
        center: Some(pixel_point(&ellipse.center)),
        semi_major_px: ellipse.semi_major_px,
        semi_minor_px: ellipse.semi_minor_px,
        angle_rad: ellipse.angle_rad,
    }
}

fn pixel_point(point: &PixelPoint) -> v1::PixelPoint {
    v1::PixelPoint { u: point.u, v: point.v }
}

pub fn pose(rigid: &Rigid) -> v1::Pose {
    v1::Pose {
        position: Some(vector(&rigid.translation.vector)),
        orientation: Some(quaternion(&rigid.rotation)),
    }
}

pub fn vector(vector: &Vector3<f64>) -> v1::Vector3 {
    v1::Vector3 { x: vector.x, y: vector.y, z: vector.z }
}

pub fn quaternion(rotation: &UnitQuaternion<f64>) -> v1::Quaternion {
    v1::Quaternion { x: rotation.i, y: rotation.j, z: rotation.k, w: rotation.w }
}

pub fn pixels(count: usize) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}

fn agreement(health: &CameraHealth) -> v1::CameraAgreement {
    let state = match health.state {
        WatchState::Watched => v1::AgreementState::Agrees,
        WatchState::Suspected => v1::AgreementState::Suspected,
        WatchState::Quarantined => v1::AgreementState::Quarantined,
        WatchState::Alone => v1::AgreementState::Alone,
    };
    v1::CameraAgreement {
        state: state as i32,
        position_error_m: health.error_m,
        position_deviation_m: health.deviation_m,
        rotation_error_rad: health.error_rad,
        rotation_deviation_rad: health.deviation_rad,
        seen_error_m: health.seen_error_m,
    }
}

fn camera_link(link: &SenderLink) -> v1::CameraLink {
    v1::CameraLink {
        sender: link.sender.clone(),
        address: link.address.clone(),
        connected: link.connected,
        received: link.received,
        missing: link.missing,
        repeated: link.repeated,
        round_trip_ms: link.round_trip_ms,
        clock_deviation_ms: link.clock_deviation_ms,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quaternions_are_stored_x_y_z_w() {
        let quarter_about_z =
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        let wire = quaternion(&quarter_about_z);
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!((wire.z - half).abs() < 1e-15 && (wire.w - half).abs() < 1e-15);
        assert_eq!((wire.x, wire.y), (0.0, 0.0));
    }
}
