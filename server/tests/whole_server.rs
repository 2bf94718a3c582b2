//! Whole servers on real sockets: failing and recovering cameras, image folders, and shutdown with connected clients.
//! Waits have generous timeouts and end as soon as their condition holds.

use std::{
    fs,
    io::{BufRead, BufReader},
    path::Path,
    process::{Command, Stdio},
    time::Duration,
};

use roundel_core::camera::{Camera, Intrinsics, Lens};
use roundel_proto::v1::{self, roundel_client::RoundelClient};
use roundel_server::{
    app::serve::Server,
    model::{
        camera_file,
        config::Config,
        hub::{CameraState, CameraStatus},
    },
};
use tokio::time::{sleep, timeout};

/// Timeout of every wait; only a stalled machine reaches it.
const TIMEOUT: Duration = Duration::from_secs(60);

const CONFIG: &str = r#"
name = "lab"
[server]
listen = "127.0.0.1:0"
[[roundel]]
name = "robot"
outer_mm = 160.0
inner_mm = 64.0
[[camera]]
name = "a"
source = "images:a?fps=25&loop=true"
calibration = "camera.yaml"
pose = { position_m = [0.0, 0.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }
[[camera]]
name = "b"
source = "images:b/*.png?fps=25&loop=true"
calibration = "camera.yaml"
pose = { position_m = [1.0, 0.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }
"#;

/// A folder with the frames of two cameras, their camera file and the configuration.
fn lab() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let camera = Camera::new(Intrinsics {
        width: 64,
        height: 48,
        fx_px: 60.0,
        fy_px: 60.0,
        cx_px: 31.5,
        cy_px: 23.5,
        lens: Lens::PlumbBob([0.0; 5]),
    });
    fs::write(folder.path().join("camera.yaml"), camera_file::write("a", &camera.unwrap()))
        .unwrap();
    fs::write(folder.path().join("lab.toml"), CONFIG).unwrap();
    for camera in ["a", "b"] {
        fs::create_dir(folder.path().join(camera)).unwrap();
        for frame in 0..3 {
            let path = folder.path().join(camera).join(format!("{frame}.pgm"));
            fs::write(&path, [b"P5 64 48 255\n".as_slice(), &[150; 64 * 48]].concat()).unwrap();
            // The format is recognised by content, so a PGM file may be named `.png`.
            fs::rename(&path, path.with_extension("png")).unwrap();
        }
    }
    folder
}

async fn start(folder: &Path) -> Server {
    let config = Config::load(&folder.join("lab.toml")).unwrap();
    Server::start(config).await.unwrap()
}

/// Waits until `is_reached` accepts the cameras.
async fn cameras(
    server: &Server,
    what: &str,
    is_reached: impl Fn(&[CameraState]) -> bool,
) -> Vec<CameraState> {
    let look = async {
        loop {
            let cameras: Vec<CameraState> = server.hub().cameras().into_values().collect();
            if is_reached(&cameras) {
                return cameras;
            }
            sleep(Duration::from_millis(10)).await;
        }
    };
    match timeout(TIMEOUT, look).await {
        Ok(cameras) => cameras,
        Err(_) => panic!("timed out waiting for {what}: {:#?}", server.hub().cameras()),
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_failed_camera_is_reported_and_retried_and_disturbs_no_other() {
    let folder = lab();
    let server = start(folder.path()).await;
    let running = |state: &CameraState| state.status == CameraStatus::Running && state.frames > 2;
    cameras(&server, "running", |cameras| cameras.iter().all(running)).await;

    let (here, away) = (folder.path().join("a"), folder.path().join("away"));
    fs::rename(&here, &away).unwrap();
    let failed = cameras(&server, "failure", |cameras| cameras[0].restarts > 0).await;
    assert_eq!(failed[0].status, CameraStatus::Failed);
    assert!(failed[0].error.contains("/a"), "{}", failed[0].error);
    assert_eq!(failed[0].rate_hz, 0.0);

    fs::rename(&away, &here).unwrap();
    let frames = failed.iter().map(|state| state.frames).collect::<Vec<_>>();
    let back = cameras(&server, "recovery", |cameras| {
        cameras[0].status == CameraStatus::Running
            && cameras.iter().zip(&frames).all(|(state, before)| state.frames > before + 2)
    })
    .await;
    assert_eq!(back[0].error, "");
    assert_eq!((back[1].status, back[1].restarts), (CameraStatus::Running, 0));

    let (events, _) = server.hub().events(100);
    let about_b = events.iter().filter(|event| event.message.contains("Camera b")).count();
    assert_eq!(about_b, 1, "the other camera must only have started: {events:#?}");
    server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn images_of_a_wrong_size_fail_with_an_error_that_names_both_sizes() {
    let folder = lab();
    for frame in 0..3 {
        let path = folder.path().join(format!("b/{frame}.png"));
        fs::write(path, [b"P5 32 48 255\n".as_slice(), &[150; 32 * 48]].concat()).unwrap();
    }
    let server = start(folder.path()).await;
    let failed = cameras(&server, "failure", |cameras| {
        cameras[1].status == CameraStatus::Failed && cameras[0].frames > 0
    })
    .await;
    let expected =
        "b/0.png: expected an image of 64 x 48 pixels as the camera file says, found 32 x 48";
    assert!(failed[1].error.contains(expected), "{}", failed[1].error);
    assert_eq!(failed[0].status, CameraStatus::Running);
    server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_folder_played_once_is_finished() {
    let folder = lab();
    let once = CONFIG.replacen("&loop=true", "", 1);
    fs::write(folder.path().join("lab.toml"), once).unwrap();
    let server = start(folder.path()).await;
    let finished =
        cameras(&server, "the end", |cameras| cameras[0].status == CameraStatus::Finished).await;
    assert_eq!(finished[0].frames + finished[0].dropped, 3);
    server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_file_clock_keeps_recorded_times() {
    let folder = lab();
    let start_ns = 1_234_567_890_123_456_789_i64;
    let times: String = (0..3).map(|k| format!("{}\n", start_ns + k * 40_000_000)).collect();
    fs::write(folder.path().join("times.txt"), times).unwrap();
    let config = CONFIG.replace("fps=25&loop=true", "times=times.txt&clock=file");
    fs::write(folder.path().join("lab.toml"), config).unwrap();
    let config = Config::load(&folder.path().join("lab.toml")).unwrap();
    let server = Server::start(config).await.unwrap();
    let mut observations = server.hub().observations();
    let mut seen = Vec::new();
    let receive = async {
        while seen.len() < 6 {
            match observations.recv().await {
                Ok(frame) => seen.push(frame),
                Err(error) => panic!("{error} after {seen:?}"),
            }
        }
    };
    // A stalled machine may drop frames; those that arrive carry the times of the file.
    let _ = timeout(Duration::from_secs(10), receive).await;
    assert!(!seen.is_empty());
    for frame in &seen {
        let offset_ns = frame.capture_time.as_ns() - start_ns;
        assert!([0, 40_000_000, 80_000_000].contains(&offset_ns), "{offset_ns} ns");
        assert!(frame.received_time >= frame.capture_time);
    }
    let now = server.hub().snapshots().borrow().snapshot.pose_time;
    assert!((now.as_ns() - start_ns).abs() < 600_000_000_000, "the server's clock is at {now}");
    server.shutdown().await;
}

async fn client(address: &str) -> RoundelClient<tonic::transport::Channel> {
    let endpoint = tonic::transport::Endpoint::from_shared(format!("http://{address}")).unwrap();
    RoundelClient::new(endpoint.connect().await.unwrap())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn shutdown_ends_while_clients_are_connected() {
    let folder = lab();
    let server = start(folder.path()).await;
    let mut client = client(&server.local_addr().to_string()).await;
    let request = v1::SubscribeSnapshotsRequest::default();
    let mut stream = client.subscribe_snapshots(request).await.unwrap().into_inner();
    assert!(stream.message().await.unwrap().is_some());
    timeout(TIMEOUT, server.shutdown()).await.expect("shutdown hangs");
    let end = async {
        loop {
            match stream.message().await {
                Ok(Some(_)) => {}
                end => return end,
            }
        }
    };
    let end = timeout(TIMEOUT, end).await.expect("the stream does not end");
    assert!(end.is_err_and(|status| status.code() == tonic::Code::Unavailable));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_signal_ends_the_process_while_clients_are_connected() {
    let folder = lab();
    for signal in ["-INT", "-TERM"] {
        let mut child = Command::new(env!("CARGO_BIN_EXE_roundel"))
            .args(["serve", "--config"])
            .arg(folder.path().join("lab.toml"))
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut stdout = BufReader::new(child.stdout.take().unwrap());
        let mut line = String::new();
        stdout.read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("listening on http://").expect(&line).to_owned();
        let mut client = client(&address).await;
        let request = v1::SubscribeSnapshotsRequest::default();
        let mut stream = client.subscribe_snapshots(request).await.unwrap().into_inner();
        assert!(stream.message().await.unwrap().is_some());
        let sent = Command::new("kill").arg(signal).arg(child.id().to_string()).status().unwrap();
        assert!(sent.success());
        let ended = tokio::task::spawn_blocking(move || child.wait().unwrap());
        let status = timeout(TIMEOUT, ended).await.expect("the process does not end").unwrap();
        assert!(status.success(), "{signal}: {status}");
        let mut rest = String::new();
        stdout.read_line(&mut rest).unwrap();
        assert_eq!(rest, "", "expected a single line on stdout");
    }
}
