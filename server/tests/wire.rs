//! Golden files of messages: a changed unit, order, sign or meaning in the conversion from core's types to messages
//! differs from a file in `proto/golden`. The Python client's tests read the same files, so that both ends agree.
//!
//! Each message is stored as JSON, as in REST and the WebSocket, and as protobuf in hexadecimal. After adding a field, run
//! `ROUNDEL_GOLDEN=write cargo test -p roundel-server --test main wire::` and check that existing numbers are unchanged.

use std::{collections::BTreeMap, fmt::Debug, fs, path::PathBuf};

use nalgebra::{Quaternion, Translation3, UnitQuaternion, Vector3};
use prost::Message;
use roundel_core::{
    calib::watch::{CameraHealth, WatchState},
    camera::{Camera, Intrinsics, Lens, PixelPoint},
    ellipse::Ellipse,
    id::{BodyId, CameraId, KindId, ObjectId, TrackNumber},
    marker::{Code, CodeReading, Ring},
    pose::{Detection, RoundelPose},
    rigid::{Covariance6, Rigid},
    time::Timestamp,
    world::{
        CameraPlacement, ClockEstimate, FrameObservations, LifeStage, ObjectState, ProcessNoise,
        Snapshot,
    },
};
use roundel_server::model::{
    capture_clock::{CaptureClock, TimeBase},
    convert,
    hub::{
        CameraInfo, CameraPoseState, CameraState, CameraStatus, DetectionCounts, Event, EventKind,
        FusedSnapshot, Installation, ObjectRecord, PoseStatus,
    },
};
use serde::Serialize;

/// 2 October 2023, 12:00 UTC, plus 7 ns, which only integer nanoseconds represent exactly.
const POSE_TIME: Timestamp = Timestamp::from_ns(1_696_248_000_000_000_007);

#[test]
fn snapshots_use_metres_the_world_frame_xyzw_quaternions_and_row_major_triangles() {
    let selected = Snapshot {
        pose_time: POSE_TIME,
        capture_time: Some(POSE_TIME.plus_ns(-12_500_000)),
        objects: vec![coded(), plain()],
    };
    let fused = FusedSnapshot {
        sequence: 41,
        fused_time: POSE_TIME.plus_ns(-3_000_000),
        snapshot: selected.clone(),
    };
    check("snapshot", &convert::snapshot(&installation(), &fused, &selected, true));
    check("lean_snapshot", &convert::snapshot(&installation(), &fused, &selected, false));
}

#[test]
fn observations_use_raw_pixels_and_the_camera_frame() {
    let rim = |half_px: f64| Ellipse {
        center: PixelPoint { u: 640.25, v: 359.75 },
        semi_major_px: half_px,
        semi_minor_px: 0.75 * half_px,
        angle_rad: -0.5,
    };
    let reading = CodeReading {
        code: Code { bits: 8, number: 12 },
        word: None,
        zero: PixelPoint { u: 651.5, v: 352.0 },
        opposite: PixelPoint { u: 629.0, v: 367.5 },
        yaw_deviation_rad: 0.01,
        confidence: 0.9375,
        corrected: 1,
    };
    let ring = Ring {
        kind: Some(KindId(0)),
        threshold: 117,
        black: 31.5,
        white: 203.25,
        code: Some(reading),
        ..Ring::of_rims(rim(20.0), rim(8.0))
    };
    let pose = RoundelPose {
        position_m: Vector3::new(-0.25, 0.5, 3.0),
        normal: Vector3::new(0.0, 0.6, -0.8),
        normal_likelihood: 0.75,
        other_normal: Vector3::new(0.0, -0.6, -0.8),
        yaw_rad: Some(1.25),
        yaw_symmetry: 1,
        covariance: numbered(0.0),
    };
    let detection = |pose| Detection {
        track: TrackNumber(77),
        ring,
        capture_time: POSE_TIME.plus_ns(1_000),
        pose,
    };
    let frame = FrameObservations {
        camera: CameraId(1),
        frame: 1234,
        capture_time: POSE_TIME,
        received_time: POSE_TIME.plus_ns(33_000_000),
        calibration_version: 3,
        detections: vec![detection(Some(pose)), detection(None)],
    };
    check("observations", &convert::observations(&installation(), &frame));
}

#[test]
fn cameras_use_milliseconds_and_parts_per_million() {
    let camera = Camera::new(Intrinsics {
        width: 1280,
        height: 720,
        fx_px: 1001.0,
        fy_px: 1002.0,
        cx_px: 641.5,
        cy_px: 358.5,
        lens: Lens::PlumbBob([-0.25, 0.125, 0.001, -0.002, 0.0625]),
    })
    .unwrap();
    let placement = CameraPlacement { world_from_camera: place(), covariance: numbered(0.0) };
    let state = CameraState {
        status: CameraStatus::Running,
        width: 1280,
        height: 720,
        pose: CameraPoseState::fixed(PoseStatus::Calibrated, placement),
        camera: Some(camera),
        calibration_version: 3,
        frames: 1000,
        dropped: 7,
        broken: 2,
        restarts: 1,
        rate_hz: 29.5,
        detections: 12,
        detect_ms: 1.5,
        decode_ms: 0.5,
        blur_px: 0.75,
        noise: 2.25,
        reprojection_px: 0.375,
        budget_used: 0.625,
        counts: DetectionCounts { deferred: 9, ..DetectionCounts::default() },
        latency_ms: 18.5,
        capture_clock: Some(CaptureClock { base: TimeBase::Arrival, deviation_s: 0.0625 }),
        clock: Some(ClockEstimate {
            offset_s: 0.015625,
            skew: 2.0_f64.powi(-18),
            deviation_s: 0.0009765625,
            skew_deviation: 1.0,
        }),
        health: Some(CameraHealth {
            state: WatchState::Suspected,
            error_m: 0.01,
            error_rad: 0.02,
            deviation_m: 0.003,
            deviation_rad: 0.004,
            seen_error_m: 0.05,
        }),
        promised_hz: 30.0,
        ..CameraState::default()
    };
    check("camera", &convert::camera(&installation(), CameraId(1), &state));
}

#[test]
fn objects_and_events_carry_ids_names_and_unix_times() {
    let record = ObjectRecord {
        id: ObjectId(3),
        kind: Some(KindId(0)),
        body: Some(BodyId(0)),
        code: Some(Code { bits: 8, number: 12 }),
        stage: LifeStage::Lost,
        first_seen: POSE_TIME.plus_ns(-60_000_000_000),
        last_seen: POSE_TIME.plus_ns(-5_000_000_000),
        observations: 4321,
    };
    check("object", &convert::object(&installation(), &record));
    let event = Event {
        sequence: 99,
        time_ns: POSE_TIME.as_ns(),
        kind: EventKind::ObjectRecovered.into(),
        object_id: 3,
        camera: String::new(),
        message: "carrier is seen again.".to_owned(),
    };
    check("event", &event);
}

/// An object with code 12 and a known heading, seen by both cameras.
fn coded() -> ObjectState {
    ObjectState {
        id: ObjectId(3),
        kind: Some(KindId(0)),
        body: Some(BodyId(0)),
        code: Some(Code { bits: 8, number: 12 }),
        stage: LifeStage::Tracked,
        position_m: Vector3::new(1.5, -2.25, 0.5),
        orientation: turn(),
        yaw_observed: true,
        yaw_symmetry: 1,
        velocity_m_s: Vector3::new(0.25, -0.5, 0.125),
        acceleration_m_s2: Vector3::new(-1.0, 0.75, 0.0625),
        angular_velocity_rad_s: Vector3::new(0.01, -0.02, 0.75),
        covariance: numbered(0.0),
        motion_covariance: numbered(100.0),
        rotation_covariance: numbered(200.0),
        process_noise: ProcessNoise::default(),
        cameras: vec![CameraId(0), CameraId(1)],
        trust: 1,
        newest_observation: POSE_TIME.plus_ns(-12_500_000),
        residual: 1.125,
        first_observation: POSE_TIME.plus_ns(-60_000_000_000),
        observations: 4321,
    }
}

/// An object without a name or an observed heading, currently not observed.
fn plain() -> ObjectState {
    ObjectState {
        id: ObjectId(7),
        kind: Some(KindId(1)),
        body: None,
        code: None,
        stage: LifeStage::Predicted,
        position_m: Vector3::new(-3.0, 4.0, 0.25),
        orientation: UnitQuaternion::identity(),
        yaw_observed: false,
        cameras: Vec::new(),
        newest_observation: POSE_TIME.plus_ns(-200_000_000),
        ..coded()
    }
}

fn installation() -> Installation {
    let camera = |name: &str| CameraInfo {
        name: name.to_owned(),
        source: "sim:r4_lite".to_owned(),
        ..CameraInfo::default()
    };
    Installation {
        name: "golden".to_owned(),
        source_id: "run-1".to_owned(),
        started: POSE_TIME.plus_ns(-3_600_000_000_000),
        snapshot_rate_hz: 60.0,
        cameras: Installation::number_cameras([camera("north"), camera("south")]),
        kinds: vec!["coded".to_owned(), "plain".to_owned()],
        object_names: BTreeMap::new(),
        body_names: vec!["carrier".to_owned()],
    }
}

/// w 0.7, x 0.1, y 0.5, z -0.5: all components differ.
fn turn() -> UnitQuaternion<f64> {
    UnitQuaternion::new_unchecked(Quaternion::new(0.7, 0.1, 0.5, -0.5))
}

fn place() -> Rigid {
    Rigid::from_parts(Translation3::new(-2.5, 1.25, 5.0), turn())
}

/// A symmetric matrix of `base` plus ten times the row plus the column, from 1, so that each number tells its position.
fn numbered(base: f64) -> Covariance6 {
    Covariance6::from_fn(|row, column| {
        base + 10.0 * (row.min(column) + 1) as f64 + (row.max(column) + 1) as f64
    })
}

/// Compares a message with its golden files, or writes them.
fn check<M: Debug + Message + Default + PartialEq + Serialize>(name: &str, message: &M) {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../proto/golden");
    let bytes = message.encode_to_vec();
    assert_eq!(&M::decode(bytes.as_slice()).unwrap(), message);
    let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    // Splits into lines, for readable differences.
    let lines: Vec<&str> =
        hex.as_bytes().chunks(96).map(|line| std::str::from_utf8(line).unwrap()).collect();
    let json = serde_json::to_string_pretty(message).unwrap();
    let write = std::env::var("ROUNDEL_GOLDEN").is_ok_and(|what| what == "write");
    for (ending, found) in [("json", json), ("hex", lines.join("\n"))] {
        let (path, found) = (folder.join(format!("{name}.{ending}")), format!("{found}\n"));
        if write {
            fs::write(&path, &found).unwrap();
        }
        let kept = fs::read_to_string(&path).unwrap_or_default();
        assert_eq!(
            found,
            kept,
            "{}: the encoding of known values has changed; if you have added a field, run \
             ROUNDEL_GOLDEN=write cargo test -p roundel-server --test main wire:: and check the difference",
            path.display()
        );
    }
}
