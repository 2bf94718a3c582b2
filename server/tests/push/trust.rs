//! A program that lies about what a trusted camera sees, with a tiny covariance.

use std::{
    path::Path,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use roundel_client::{Client, PushOptions, Pusher, v1};
use roundel_core::id::CameraId;
use roundel_server::{app::serve::Server, model::config::Config};
use tokio::time::{sleep, timeout};

use super::rig::{CAMERAS, TIMEOUT, config, wait_for};

const FRAME_INTERVAL: Duration = Duration::from_millis(20);
/// Place of the robot in the world, and of the one that the liar reports.
const TRUE_X_M: f64 = 0.5;
const FALSE_X_M: f64 = 0.6;

/// A robot at this place in the camera's frame.
fn detection(x_m: f64, variance: f64) -> v1::PushedObservations {
    let capture_time_ns = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_nanos() as i64;
    let center = Some(v1::PixelPoint { u: 159.5 + 100.0 * x_m, v: 119.5 });
    let rim = |radius_px| {
        let (semi_major_px, semi_minor_px) = (radius_px, radius_px);
        Some(v1::Ellipse { center, semi_major_px, semi_minor_px, angle_rad: 0.0 })
    };
    let up = Some(v1::Vector3 { x: 0.0, y: 0.0, z: -1.0 });
    let mut covariance = vec![0.0; 21];
    for diagonal in [0, 6, 11, 15, 18, 20] {
        covariance[diagonal] = variance;
    }
    let detection = v1::Detection {
        track: 1,
        roundel: "robot".into(),
        outer: rim(8.0),
        inner: rim(3.2),
        threshold: 120,
        capture_time_ns,
        pose: Some(v1::RoundelPose {
            position: Some(v1::Vector3 { x: x_m, y: 0.0, z: 3.0 }),
            normal: up,
            normal_likelihood: 1.0,
            other_normal: up,
            covariance,
            ..Default::default()
        }),
        ..Default::default()
    };
    let detections = vec![detection];
    v1::PushedObservations {
        observations: Some(v1::FrameObservations {
            capture_time_ns,
            detections,
            ..Default::default()
        }),
        ..Default::default()
    }
}

async fn feed(pusher: Pusher, x_m: f64, variance: f64) {
    loop {
        pusher.observations(detection(x_m, variance));
        sleep(FRAME_INTERVAL).await;
    }
}

/// Cameras at x = 0 m and 1 m, of which only the first is trusted.
fn configuration(folder: &Path) -> Config {
    let mut config = config(&CAMERAS, "push:", "127.0.0.1:0", folder);
    assert_eq!(config.cameras[1].trust, 0, "pushed cameras are untrusted by default");
    config.cameras[0].trust = 1;
    config
}

/// The first tracked robot that `is_it` accepts.
async fn robot(
    client: &Client,
    what: &str,
    is_it: impl Fn(&v1::ObjectState) -> bool,
) -> v1::ObjectState {
    let looking = async {
        loop {
            // There is none before the first frame.
            let objects = client.snapshot().await.map(|snapshot| snapshot.objects);
            let mut tracked = objects
                .unwrap_or_default()
                .into_iter()
                .filter(|it| it.stage() == v1::LifeStage::Tracked);
            if let Some(found) = tracked.find(&is_it) {
                return found;
            }
            sleep(FRAME_INTERVAL).await;
        }
    };
    timeout(TIMEOUT, looking).await.unwrap_or_else(|_| panic!("{what} did not appear"))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_lying_program_moves_nothing_that_a_trusted_camera_sees() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(configuration(folder.path())).await.unwrap();
    let client = Client::connect(&server.local_addr().to_string()).await.unwrap();
    let push = |name| client.push(PushOptions::new(name).times(v1::PushTimes::Unix)).unwrap();
    let honest = tokio::spawn(feed(push("north"), TRUE_X_M, 1e-6));
    robot(&client, "the true robot", |it| !it.untrusted).await;
    let liar = tokio::spawn(feed(push("south"), FALSE_X_M - 1.0, 4e-10));
    let frames = || server.hub().camera(CameraId(1)).unwrap().frames;
    wait_for("frames of the liar", || (frames() > 50).then_some(()), frames).await;
    let seen = robot(&client, "the true robot", |it| !it.untrusted).await;
    let x_m = seen.position.unwrap().x;
    assert!((x_m - TRUE_X_M).abs() < 0.01, "{seen:?}");

    // Without the trusted camera the program decides, and the snapshot says so.
    honest.abort();
    robot(&client, "an untrusted robot", |it| it.untrusted).await;
    liar.abort();
}
