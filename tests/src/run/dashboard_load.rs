//! A server under the load that the dashboard is measured with: by default 400 robots and 16 cameras, snapshots at 60 Hz,
//! and pictures of the camera that is shown. Objects and pictures are generated and published to the hub, so that the
//! processor is left to the browser; everything from the hub on is the real server. Prints its address, and stops when
//! its standard input ends. `npm run bench` in `tests/browser` starts it.

use std::{
    collections::BTreeMap,
    io::{self, Read, Write},
    process::ExitCode,
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use roundel_core::{
    camera::{Camera, Intrinsics, Lens},
    id::{CameraId, KindId, ObjectId},
    marker::Code,
    rigid::{Covariance6, Rigid},
    time::Timestamp,
    world::{CameraPlacement, FrameObservations, LifeStage, ObjectState, ProcessNoise, Snapshot},
};
use roundel_server::{
    api::{self, ApiState},
    model::{
        clock::Clock,
        hub::{CameraInfo, CameraPoseState, CameraStatus, Hub, Installation, Picture, PoseStatus},
    },
};
use tokio::net::TcpListener;

const RATE_HZ: f64 = 60.0;
/// Snapshots per camera frame.
const TICKS_A_FRAME: u64 = 2;
const SIZE: (usize, usize) = (1280, 720);
const FOCAL_PX: f64 = 735.0;
const CAMERA_HEIGHT_M: f64 = 5.0;
/// Distances of neighbours.
const CAMERA_GAPS_M: [f64; 2] = [6.0, 4.5];
const ROBOT_GAPS_M: [f64; 2] = [0.95, 1.1];
/// Snapshots between two updates of the cameras that see a robot.
const VISIBILITY_TICKS: u64 = 30;
const SIGMA_M: f64 = 1.5e-3;

#[derive(clap::Args)]
pub struct Options {
    #[arg(default_value_t = 400)]
    robots: usize,
    #[arg(default_value_t = 16)]
    cameras: usize,
}

pub fn run(options: &Options) -> anyhow::Result<ExitCode> {
    let Options { robots, cameras } = *options;
    let clock = Clock::anchored_now();
    let mounts = mounts(cameras)?;
    let hub = Arc::new(Hub::new(installation(cameras, clock)));
    let generator = Generator::new(hub.clone(), clock, robots, mounts);
    thread::spawn(move || generator.run());
    // Stops with the process that started it.
    thread::spawn(|| {
        let _ = io::stdin().read_to_end(&mut Vec::new());
        std::process::exit(0);
    });
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    runtime.block_on(async {
        let listener = TcpListener::bind("127.0.0.1:0").await?;
        println!("http://{}/", listener.local_addr()?);
        io::stdout().flush()?;
        api::serve(listener, ApiState::new(hub, clock)).await;
        Ok(ExitCode::SUCCESS)
    })
}

fn installation(cameras: usize, clock: Clock) -> Installation {
    let camera = |place: usize| CameraInfo {
        name: format!("camera-{}", place + 1),
        source: "load".into(),
        ..CameraInfo::default()
    };
    Installation {
        name: "Dashboard load".into(),
        source_id: "load".into(),
        started: clock.now(),
        snapshot_rate_hz: RATE_HZ,
        cameras: Installation::number_cameras((0..cameras).map(camera)),
        kinds: vec!["robot".into()],
        object_names: BTreeMap::new(),
        body_names: Vec::new(),
    }
}

/// A camera's lens and pose.
struct Mount {
    camera: Camera,
    world_from_camera: Rigid,
}

/// Cameras in rows of four, each tilted slightly inwards.
fn mounts(count: usize) -> anyhow::Result<Vec<Mount>> {
    let (width, height) = SIZE;
    let center = [(width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0];
    let camera = Camera::new(Intrinsics {
        width,
        height,
        fx_px: FOCAL_PX,
        fy_px: FOCAL_PX,
        cx_px: center[0],
        cy_px: center[1],
        lens: Lens::PlumbBob([0.0; 5]),
    })?;
    let mount = |place: usize| {
        let x = CAMERA_GAPS_M[0] * ((place % 4) as f64 - 1.5);
        let y = CAMERA_GAPS_M[1] * ((place / 4) as f64 - 1.5);
        let position = Vector3::new(x, y, CAMERA_HEIGHT_M);
        let forward = (Vector3::new(0.9 * x, 0.9 * y, 0.0) - position).normalize();
        // The x axis of the picture is close to the world's.
        let down = forward.cross(&Vector3::x()).normalize();
        let axes = Matrix3::from_columns(&[down.cross(&forward), down, forward]);
        let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        let world_from_camera = Rigid::from_parts(Translation3::from(position), turn);
        Mount { camera: camera.clone(), world_from_camera }
    };
    Ok((0..count).map(mount).collect())
}

/// Publishes what camera workers and fusion would publish.
struct Generator {
    hub: Arc<Hub>,
    clock: Clock,
    mounts: Vec<Mount>,
    /// Cameras that see each robot.
    seen_by: Vec<Vec<CameraId>>,
    floor: Vec<u8>,
}

impl Generator {
    fn new(hub: Arc<Hub>, clock: Clock, robots: usize, mounts: Vec<Mount>) -> Self {
        let (width, height) = SIZE;
        // Textured, so that it compresses like a real picture.
        let level =
            |at: usize| (120.0 + 50.0 * ((at % width + at / width) as f64 / 160.0).sin()) as u8;
        let noise = |at: usize| (at.wrapping_mul(2_654_435_761) >> 13) as u8 % 8;
        let floor = (0..width * height).map(|at| level(at) + noise(at)).collect();
        Self { hub, clock, mounts, seen_by: vec![Vec::new(); robots], floor }
    }

    fn run(mut self) {
        for (id, mount) in (0..).map(CameraId).zip(&self.mounts) {
            let covariance = Covariance6::identity() * 1e-6;
            let placement =
                CameraPlacement { world_from_camera: mount.world_from_camera, covariance };
            self.hub.update_camera(id, |state| {
                state.status = CameraStatus::Running;
                [state.width, state.height] = [SIZE.0, SIZE.1];
                state.camera = Some(mount.camera.clone());
                state.pose = CameraPoseState::fixed(PoseStatus::Configured, placement);
                state.rate_hz = RATE_HZ / TICKS_A_FRAME as f64;
                (state.detect_ms, state.latency_ms) = (1.3, 24.0);
            });
        }
        let started = Instant::now();
        for tick in 0_u64.. {
            let due = started + Duration::from_secs_f64(tick as f64 / RATE_HZ);
            thread::sleep(due.saturating_duration_since(Instant::now()));
            self.publish(tick);
            if tick.is_multiple_of(TICKS_A_FRAME) {
                self.frames(tick);
            }
        }
    }

    fn publish(&mut self, tick: u64) {
        let now = self.clock.now();
        let time_s = tick as f64 / RATE_HZ;
        let objects: Vec<_> = (0..self.seen_by.len())
            .map(|robot| {
                let place = place(robot, time_s);
                if (tick + robot as u64).is_multiple_of(VISIBILITY_TICKS) || tick == 0 {
                    self.seen_by[robot] = self.cameras_seeing(&place);
                }
                object(robot, place, time_s, now, self.seen_by[robot].clone())
            })
            .collect();
        let snapshot =
            Snapshot { pose_time: now, capture_time: Some(now.plus_ns(-24_000_000)), objects };
        self.hub.publish_snapshot(snapshot, self.clock.now());
    }

    fn cameras_seeing(&self, place: &Vector3<f64>) -> Vec<CameraId> {
        let sees = |mount: &Mount| {
            let point = mount.world_from_camera.inverse_transform_point(&Point3::from(*place));
            let pixel = mount.camera.project(&point.coords);
            point.z > 0.0 && pixel.is_ok_and(|pixel| mount.camera.contains(pixel))
        };
        let numbered = (0..).map(CameraId).zip(&self.mounts);
        numbered.filter(|(_, mount)| sees(mount)).map(|(id, _)| id).collect()
    }

    /// Counts a frame of each camera, and publishes its picture if one was requested.
    fn frames(&self, tick: u64) {
        let now = self.clock.now();
        for camera in (0..self.mounts.len() as u32).map(CameraId) {
            let sees = |all: &&Vec<CameraId>| all.contains(&camera);
            let detections = self.seen_by.iter().filter(sees).count();
            self.hub.update_camera(camera, |state| {
                state.frames += 1;
                state.detections = detections;
            });
            if self.hub.take_picture_request(camera) {
                let observations = Arc::new(FrameObservations {
                    camera,
                    frame: tick / TICKS_A_FRAME + 1,
                    capture_time: now.plus_ns(-20_000_000),
                    received_time: now,
                    calibration_version: 0,
                    detections: Vec::new(),
                });
                let picture = Picture::new(SIZE, self.floor.clone(), observations);
                self.hub.publish_picture(camera, picture);
            }
        }
    }
}

/// Position of a robot, metres: on an ellipse of its own. Every third robot flies.
fn place(robot: usize, time_s: f64) -> Vector3<f64> {
    let column = (robot % 25) as f64 - 12.0;
    let row = (robot / 25) as f64 - 7.5;
    let radius_m = 0.35 + 0.12 * (robot % 4) as f64;
    let direction = if robot.is_multiple_of(2) { 1.0 } else { -1.0 };
    let angle = direction * (0.5 + 0.13 * (robot % 5) as f64) * time_s + robot as f64;
    let height_m = if robot % 3 == 2 { 1.5 + 0.3 * (angle / 2.0).sin() } else { 0.3 };
    Vector3::new(
        ROBOT_GAPS_M[0] * column + radius_m * angle.cos(),
        ROBOT_GAPS_M[1] * row + 0.8 * radius_m * angle.sin(),
        height_m,
    )
}

/// State of a robot as fusion publishes it. Its numbers use all digits, like real ones, so that messages are as long.
fn object(
    robot: usize,
    position_m: Vector3<f64>,
    time_s: f64,
    now: Timestamp,
    cameras: Vec<CameraId>,
) -> ObjectState {
    const STEP_S: f64 = 1e-3;
    let velocity_m_s = (place(robot, time_s + STEP_S) - position_m) / STEP_S;
    let stage = if cameras.is_empty() { LifeStage::Predicted } else { LifeStage::Tracked };
    let factor = Covariance6::from_fn(|row, column| {
        let phase = (row * 6 + column + robot) as f64 + time_s;
        SIGMA_M * (0.1 * phase.sin() + f64::from(u8::from(row == column)))
    });
    let covariance = factor * factor.transpose();
    let has_code = robot % 6 == 5;
    ObjectState {
        id: ObjectId(robot as u64 + 1),
        kind: Some(KindId(0)),
        body: None,
        code: has_code.then_some(Code { bits: 16, number: robot as u16 + 1 }),
        stage,
        position_m,
        orientation: UnitQuaternion::from_euler_angles(0.02, 0.01, time_s + robot as f64),
        yaw_observed: has_code,
        yaw_symmetry: 1,
        velocity_m_s,
        acceleration_m_s2: Vector3::new(0.1, 0.2, 0.0) * time_s.cos(),
        angular_velocity_rad_s: Vector3::new(0.0, 0.0, 1.0),
        covariance,
        motion_covariance: covariance * 100.0,
        rotation_covariance: covariance,
        process_noise: ProcessNoise {
            acceleration_density_m2_s3: Vector3::repeat(0.1),
            angular_density_rad2_s3: Vector3::repeat(0.1),
        },
        cameras,
        trust: 1,
        newest_observation: now.plus_ns(-24_000_000),
        residual: 0.9 + 0.1 * time_s.sin(),
        first_observation: now.plus_seconds(-time_s),
        observations: (time_s * RATE_HZ) as u64,
    }
}
