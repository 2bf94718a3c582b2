//! What several bodies share: a server's state without its sockets, and files.

use std::{cell::LazyCell, collections::BTreeMap, fs, path::Path, sync::Arc};

use nalgebra::{UnitQuaternion, Vector3};
use roundel_core::{
    camera::{Camera, Intrinsics, Lens, PixelPoint},
    id::{CameraId, KindId, ObjectId},
    marker::{Code, Kind},
    rigid::{Covariance6, Rigid},
    time::Timestamp,
    world::{CameraPlacement, LifeStage, ObjectState, ProcessNoise, Snapshot},
};
use roundel_server::{
    api::ApiState,
    model::{
        camera::PoseStatus,
        clock::Clock,
        hub::{CameraInfo, CameraPoseState, CameraStatus, EventKind, Hub, Installation},
    },
};
use tempfile::TempDir;
use tokio::runtime::{Builder, Runtime};

pub const SIZE: (usize, usize) = (64, 48);
/// The camera that a remote program feeds.
pub const PUSHED: (CameraId, &str) = (CameraId(0), "north");
pub const MAX_DETECTIONS: usize = 400;

pub fn runtime() -> Runtime {
    Builder::new_current_thread().enable_all().build().unwrap()
}

/// Calls `read` with the path of a file of these bytes.
pub fn with_file<T>(name: &str, bytes: &[u8], read: impl FnOnce(&Path) -> T) -> T {
    thread_local! {
        static FOLDER: LazyCell<TempDir> = LazyCell::new(|| tempfile::tempdir().unwrap());
    }
    FOLDER.with(|folder| {
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        read(&path)
    })
}

/// A pinhole camera of [`SIZE`].
pub fn lens() -> Camera {
    let (width, height) = SIZE;
    let lens = Lens::PlumbBob([0.0; 5]);
    let (fx_px, fy_px, cx_px, cy_px) = (60.0, 60.0, 31.5, 23.5);
    Camera::new(Intrinsics { width, height, fx_px, fy_px, cx_px, cy_px, lens }).unwrap()
}

/// Three metres above the floor, looking down.
pub fn placement() -> CameraPlacement {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    CameraPlacement {
        world_from_camera: Rigid::from_parts(Vector3::new(0.0, 0.0, 3.0).into(), turn),
        covariance: Covariance6::identity() * 1e-8,
    }
}

/// A server's state with two cameras, one of them `push:`, and two objects.
pub fn api() -> ApiState {
    let clock = Clock::anchored_now();
    let corners = [(4.0, 4.0), (14.0, 4.0), (4.0, 14.0)].map(|(u, v)| PixelPoint { u, v });
    let camera = |name: &str, source: &str| CameraInfo {
        name: name.into(),
        source: source.into(),
        mask: vec![corners.to_vec()],
        ride: None,
        lens_uncertainty: None,
    };
    let cameras = [camera(PUSHED.1, "push:"), camera("south side", "sim:")];
    let hub = Arc::new(Hub::new(Installation {
        name: "lab".into(),
        source_id: "run".into(),
        started: clock.now(),
        snapshot_rate_hz: 60.0,
        cameras: Installation::number_cameras(cameras),
        kinds: vec!["robot".into(), "cart".into()],
        object_names: BTreeMap::from([(KindId(1), "cart \"one\"".into())]),
        body_names: vec!["carrier".into()],
    }));
    for id in [CameraId(0), CameraId(1)] {
        hub.update_camera(id, |state| {
            state.status = CameraStatus::Running;
            (state.width, state.height) = SIZE;
            state.camera = Some(lens());
            state.pose = CameraPoseState::fixed(PoseStatus::Configured, placement());
        });
    }
    hub.publish_event(clock.now(), EventKind::CameraAdded, "added".into());
    let now = clock.now();
    let objects = vec![object(1, now), object(2, now)];
    hub.publish_snapshot(Snapshot { pose_time: now, capture_time: Some(now), objects }, now);
    let api = ApiState {
        kinds: vec![Kind::plain("robot", 0.16, 0.064), Kind::plain("cart", 0.16, 0.08)],
        ..ApiState::new(hub, clock)
    };
    api.ports.open(PUSHED.0, MAX_DETECTIONS);
    api
}

fn object(id: u64, time: Timestamp) -> ObjectState {
    let covariance = Covariance6::identity() * 1e-4;
    ObjectState {
        id: ObjectId(id),
        kind: Some(KindId((id % 2) as u16)),
        body: None,
        code: id.is_multiple_of(2).then_some(Code { bits: 8, number: id as u16 }),
        stage: LifeStage::Tracked,
        position_m: Vector3::new(id as f64, 0.5, 0.0),
        orientation: UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3),
        yaw_observed: false,
        yaw_symmetry: 1,
        velocity_m_s: Vector3::new(1.0, 2.0, 0.0),
        acceleration_m_s2: Vector3::zeros(),
        angular_velocity_rad_s: Vector3::zeros(),
        covariance,
        motion_covariance: covariance,
        rotation_covariance: covariance,
        process_noise: ProcessNoise::default(),
        cameras: vec![CameraId(0), CameraId(1)],
        trust: 1,
        newest_observation: time,
        residual: 0.75,
        first_observation: time,
        observations: 180,
    }
}
