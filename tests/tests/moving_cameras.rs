//! Moving cameras over the public interfaces: rendered frames as image files, a real `roundel serve`, and gRPC's
//! snapshots, cameras and events compared with the truth.

use std::{f64::consts::PI, fs, time::Duration};

use anyhow::{Context, ensure};
use futures::StreamExt;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use roundel_client::{Client, Subscription, Update};
use roundel_proto::v1::{Camera, EventKind, Pose, PoseStatus, Snapshot};
use roundel_tests::{
    arena::{Arena, Course},
    export::{Export, Installation},
    process::Server,
    score::{Judge, Score},
};

/// Time after the first frame until tracks and velocities have settled.
const SETTLED_NS: i64 = 1_000_000_000;
const FRAMES: usize = 105;

/// Everything that clients received while the frames were played.
struct Received {
    snapshots: Vec<Snapshot>,
    /// State of the moving camera at each query.
    moving_camera: Vec<Camera>,
    server: Server,
    client: Client,
}

async fn watch(arena: &Arena, installation: &Installation) -> anyhow::Result<Received> {
    let server = Server::serve(&installation.config)?;
    let client = Client::connect(&server.url()).await?;
    let end_ns = arena.capture_time_ns(&arena.sites[0], FRAMES - 1);
    let mut stream = client.snapshots(Subscription::default());
    let (mut snapshots, mut moving_camera) = (Vec::new(), Vec::new());
    loop {
        let update = tokio::time::timeout(Duration::from_secs(60), stream.next()).await;
        let update = update.with_context(|| format!("no snapshot:\n{}", server.log()))?;
        let Update::Snapshot(snapshot) = update.context("the stream ended")?? else { continue };
        if snapshot.pose_time_ns > end_ns {
            return Ok(Received { snapshots, moving_camera, server, client });
        }
        if snapshot.sequence % 3 == 0 {
            moving_camera
                .extend(client.cameras().await?.into_iter().find(|it| it.name == "aboard"));
        }
        snapshots.push(snapshot);
    }
}

fn isometry(pose: &Pose) -> Isometry3<f64> {
    let (p, q) = (pose.position.unwrap_or_default(), pose.orientation.unwrap_or_default());
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(q.w, q.x, q.y, q.z));
    Isometry3::from_parts(Translation3::new(p.x, p.y, p.z), turn)
}

impl Received {
    /// Rms errors of the camera's position, metres, and rotation, radians, while its pose was known.
    fn camera_errors(&self, arena: &Arena) -> anyhow::Result<(f64, f64)> {
        let site = arena.sites.iter().find(|site| site.name == "aboard").context("no camera")?;
        let (mut squares, mut count) = ((0.0, 0.0), 0.0);
        for camera in &self.moving_camera {
            let after_s = (camera.pose_time_ns - arena.start_ns) as f64 * 1e-9;
            let Some(pose) = &camera.pose else {
                ensure!(!camera.pose_reason.is_empty() && camera.pose_covariance.is_empty());
                continue;
            };
            assert_eq!(camera.pose_status(), PoseStatus::Riding);
            ensure!(camera.pose_reason.is_empty() && camera.pose_covariance.len() == 21);
            if after_s * 1e9 < SETTLED_NS as f64 {
                continue;
            }
            let off = arena.camera_pose(site, after_s).inverse() * isometry(pose);
            squares.0 += off.translation.vector.norm_squared();
            squares.1 += off.rotation.angle().powi(2);
            count += 1.0;
        }
        ensure!(count > 20.0, "placed {count} times; the server's log:\n{}", self.server.log());
        Ok(((squares.0 / count).sqrt(), (squares.1 / count).sqrt()))
    }

    /// Scores selected objects of the settled snapshots against selected robots.
    fn score(
        &self,
        arena: &Arena,
        chosen: impl Fn(&str) -> bool,
        robots: std::ops::Range<usize>,
    ) -> Score {
        let mut judge = Judge::default();
        for snapshot in &self.snapshots {
            if snapshot.pose_time_ns < arena.start_ns + SETTLED_NS {
                continue;
            }
            let mut part = snapshot.clone();
            part.objects.retain(|object| chosen(&object.name));
            judge.take(&part, &arena.truth(snapshot.pose_time_ns)[robots.clone()]);
        }
        judge.finish()
    }

    /// Kinds of the events about the moving camera, in order.
    async fn events(&self) -> anyhow::Result<Vec<EventKind>> {
        let mut events = self.client.events(100).await?;
        let mut kinds = Vec::new();
        while let Ok(Some(event)) =
            tokio::time::timeout(Duration::from_millis(500), events.next()).await
        {
            let event = event?;
            if event.camera == "aboard" {
                kinds.push(event.kind());
            }
        }
        Ok(kinds)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_drones_camera_tracks_robots_that_no_other_camera_sees() -> anyhow::Result<()> {
    let mut arena = Arena::with_drone(31);
    let moving_camera = arena.sites.pop().context("no drone")?;
    arena.sites = Arena::r4_lite(31, 1, 0).sites.split_off(2);
    arena.sites.push(moving_camera);
    arena.robots.truncate(5);
    let folder = tempfile::tempdir()?;
    let installation = Export::lab(FRAMES).write(&arena, folder.path())?;
    let received = watch(&arena, &installation).await?;

    let (off_m, off_rad) = received.camera_errors(&arena)?;
    let drone = received.score(&arena, |name| name == "robot 1", 0..1);
    let robots = received.score(&arena, str::is_empty, 1..5);
    println!("camera off by {:.1} mm, {:.1} mrad", off_m * 1e3, off_rad * 1e3);
    println!("drone\n{drone}\nrobots below\n{robots}");
    ensure!(off_m < 0.02 && off_rad < 0.03, "off by {off_m} m and {off_rad} rad");
    assert_eq!((drone.ids, drone.swaps, drone.strays), (1, 0, 0));
    assert_eq!((robots.ids, robots.swaps, robots.strays, robots.extra_ids), (4, 0, 0, 0));
    // The drone's orientation displaces objects 1.7 m below it: see the scenario `drone`.
    ensure!(robots.position.rms() < 0.06, "{}", robots.position.rms());
    let first = received.moving_camera.first().context("never asked")?;
    assert_eq!((first.carrier.as_str(), first.localizes), ("robot 1", false));
    let mount = isometry(first.mount.as_ref().context("no mount")?);
    let true_mount = arena.sites[2].mount.context("it stands")?.robot_from_camera;
    ensure!((mount.inverse() * true_mount).translation.vector.norm() < 1e-9);
    ensure!(received.events().await?.contains(&EventKind::CameraPlaced));
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_docking_robot_localizes_itself() -> anyhow::Result<()> {
    let mut arena = Arena::docking(32);
    // Codes are readable at close range, so it starts near its station and retreats.
    let Course::Sines(sines) = &mut arena.robots[0].path.course else { panic!("no sines") };
    (sines[0].phase_rad, sines[0].rate_rad_s) = (PI / 2.0, 0.6);
    // Two coded kinds with the same number of bits are rejected, and no camera sees the robot's own roundel.
    let station = arena.kinds.pop().context("no station")?;
    arena.robots[0].kind = station.name.clone();
    arena.kinds = vec![station];
    arena.landmarks.iter_mut().for_each(|landmark| landmark.kind = 0);
    let folder = tempfile::tempdir()?;
    let installation = Export::lab(FRAMES).write(&arena, folder.path())?;
    // So the robot needs no roundel.
    let config = fs::read_to_string(&installation.config)?;
    let carried = "name = \"robot 1\"\nroundel = \"station\"\ncode = 1\n";
    ensure!(config.contains(carried), "{config}");
    fs::write(&installation.config, config.replace(carried, "name = \"robot 1\"\n"))?;
    let received = watch(&arena, &installation).await?;

    let (off_m, off_rad) = received.camera_errors(&arena)?;
    let score = received.score(&arena, |_| true, 0..1);
    println!("camera off by {:.1} mm, {:.1} mrad\n{score}", off_m * 1e3, off_rad * 1e3);
    assert_eq!((score.ids, score.swaps, score.strays, score.misses), (1, 0, 0, 0));
    ensure!(score.position.rms() < 0.03 && off_m < 0.03, "{} m", score.position.rms());
    ensure!(off_rad < 0.02, "{off_rad} rad");
    let named = |snapshot: &Snapshot| snapshot.objects.iter().all(|it| it.name == "robot 1");
    ensure!(received.snapshots.iter().all(named), "its station is no object");
    ensure!(
        received.moving_camera.iter().all(|camera| camera.localizes && camera.carrier == "robot 1")
    );
    assert_eq!(received.events().await?.first(), Some(&EventKind::CameraRunning));
    Ok(())
}
