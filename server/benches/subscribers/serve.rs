//! The process with the server: the APIs, and a hub that gets a snapshot each sixtieth of a second.

use std::{
    collections::BTreeMap,
    io::{self, Read, Write},
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use nalgebra::{UnitQuaternion, Vector3};
use roundel_core::{
    id::{CameraId, KindId, ObjectId},
    rigid::Covariance6,
    time::Timestamp,
    world::{LifeStage, ObjectState, ProcessNoise, Snapshot},
};
use roundel_server::{
    api::{self, Limits, Served},
    calibration::{Calibrator, CalibratorParts, file::CalibrationFile},
    clock::Clock,
    hub::{CameraInfo, Hub, Installation},
};
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

pub const RATE_HZ: f64 = 60.0;
const OBJECTS: u64 = 100;

/// Serves until its standard input ends; prints its address first.
pub fn run() {
    let clock = Clock::anchored_now();
    let hub = Arc::new(Hub::new(installation(clock)));
    let feeding = hub.clone();
    thread::spawn(move || feed(&feeding, clock));
    // Whoever has started this ends: so does this.
    thread::spawn(|| {
        let _ = io::stdin().read(&mut [0]);
        std::process::exit(0);
    });
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .expect("a runtime");
    runtime.block_on(async {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        println!("{}", listener.local_addr().expect("an address"));
        io::stdout().flush().expect("a pipe");
        let calibrator = Calibrator::new(CalibratorParts {
            hub: hub.clone(),
            clock,
            cameras: BTreeMap::new(),
            landmarks: Vec::new(),
            path: None,
            file: CalibrationFile::default(),
        });
        let served = Served {
            hub,
            clock,
            calibrator: Arc::new(calibrator),
            fleets: Arc::default(),
            ports: Arc::default(),
            late_window_ms: 300.0,
            trier: None,
            roster: None,
        };
        let limits = Limits { max_clients: 4000, ..Limits::default() };
        api::serve(listener, served, limits, CancellationToken::new()).await;
    });
}

fn installation(clock: Clock) -> Installation {
    let camera =
        |place: usize| CameraInfo { name: format!("camera {place}"), ..CameraInfo::default() };
    Installation {
        name: "bench".into(),
        source_id: "0123456789abcdef".into(),
        started: clock.now(),
        snapshot_rate_hz: RATE_HZ,
        cameras: Installation::numbered((0..4).map(camera)),
        kinds: vec!["robot".into()],
        object_names: BTreeMap::new(),
        body_names: vec![],
    }
}

fn feed(hub: &Hub, clock: Clock) {
    let begin = Instant::now();
    for number in 1_u64.. {
        let due = begin + Duration::from_secs_f64(number as f64 / RATE_HZ);
        thread::sleep(due.saturating_duration_since(Instant::now()));
        let now = clock.now();
        let objects = (1..=OBJECTS).map(|id| object(id, number, now)).collect();
        let snapshot = Snapshot { pose_time: now, capture_time: Some(now), objects };
        hub.publish_snapshot(snapshot, clock.now());
    }
}

/// Numbers with all their digits, as real ones have.
fn object(id: u64, number: u64, now: Timestamp) -> ObjectState {
    let phase = id as f64 * 0.7 + number as f64 * 0.01;
    let factor = Covariance6::from_fn(|row, column| {
        ((row * 6 + column) as f64 + phase).sin() * 1e-3 + f64::from(u8::from(row == column)) * 1e-2
    });
    let covariance = factor * factor.transpose();
    ObjectState {
        id: ObjectId(id),
        kind: Some(KindId(0)),
        body: None,
        code: None,
        stage: LifeStage::Tracked,
        position_m: Vector3::new(5.0 * phase.sin(), 4.0 * phase.cos(), 0.3),
        orientation: UnitQuaternion::from_euler_angles(0.1 * phase.sin(), 0.2, phase),
        yaw_observed: false,
        yaw_symmetry: 1,
        velocity_m_s: Vector3::new(phase.cos(), -phase.sin(), 0.01 * phase.cos()),
        acceleration_m_s2: Vector3::new(0.1, 0.2, 0.3) * phase.cos(),
        angular_velocity_rad_s: Vector3::new(0.1, 0.2, 0.3) * phase.sin(),
        covariance,
        motion_covariance: covariance,
        rotation_covariance: covariance,
        process_noise: ProcessNoise {
            acceleration_density_m2_s3: Vector3::repeat(0.1),
            angular_density_rad2_s3: Vector3::repeat(0.1),
        },
        cameras: vec![CameraId(0), CameraId(2)],
        newest_observation: now,
        residual: 0.9 + 0.1 * phase.sin(),
        first_observation: now,
        observations: 1000,
    }
}
