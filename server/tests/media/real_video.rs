//! A real video over RTSP into a server: every frame arrives, timed by the camera's clock, and gives one unbroken
//! track.

use std::{path::Path, time::Duration};

use roundel_core::camera::{Camera, Intrinsics, Lens};
use roundel_server::{
    app::serve::Server,
    model::{
        camera_file,
        capture_clock::TimeBase,
        config::Config,
        hub::{CameraStatus, EventKind},
    },
};
use tokio::time::{sleep, timeout};

use super::{TIMEOUT, rtsp_server::RtspServer, run_exclusively};

const NAME: &str = "a_real_video_over_rtsp_is_one_track";

/// The camera was not calibrated: the assumed focal length only scales distances.
fn config(folder: &Path, source: &str) -> Config {
    let camera = Camera::new(Intrinsics {
        width: 848,
        height: 480,
        fx_px: 700.0,
        fy_px: 700.0,
        cx_px: 423.5,
        cy_px: 239.5,
        lens: Lens::PlumbBob([0.0; 5]),
    });
    std::fs::write(folder.join("phone.yaml"), camera_file::write("phone", &camera.unwrap()))
        .unwrap();
    let text = format!(
        "[server]\nlisten = \"127.0.0.1:0\"\n\
         [[roundel]]\nname = \"print\"\nouter_mm = 100.0\ninner_mm = 59.3\n\
         [[camera]]\nname = \"phone\"\nsource = \"{source}\"\ncalibration = \"phone.yaml\"\n\
         pose = {{ position_m = [0.0, 0.0, 0.0], orientation_xyzw = [0.0, 0.0, 0.0, 1.0] }}\n"
    );
    Config::parse(&text, folder).map_err(|problems| format!("{problems:#?}")).unwrap()
}

#[test]
fn a_real_video_over_rtsp_is_one_track() {
    let video = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/real/ring/video.mp4");
    if !video.exists() {
        println!("skipped: {NAME} needs ../shared");
        return;
    }
    let _guard = run_exclusively();
    let Some(camera) = RtspServer::start(NAME, &["file", &video.to_string_lossy()]) else { return };
    tokio::runtime::Runtime::new().unwrap().block_on(play(&camera.url()));
}

async fn play(url: &str) {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(config(folder.path(), url)).await.unwrap();
    // Waits for the end of the stream, which counts as a failure of the camera.
    let mut base = None;
    let end = async {
        loop {
            let state = server.hub().cameras().into_values().next().unwrap();
            base = state.capture_clock.map(|clock| clock.base).or(base);
            if state.status == CameraStatus::Failed {
                return state;
            }
            sleep(Duration::from_millis(5)).await;
        }
    };
    let state = timeout(TIMEOUT, end).await.expect("the stream does not end");
    assert!(state.error.ends_with("the stream has ended"), "{}", state.error);
    println!("{} frames searched, {} dropped for newer ones", state.frames, state.dropped);
    assert!(state.frames + state.dropped >= 270, "{} + {}", state.frames, state.dropped);
    assert_eq!(base, Some(TimeBase::Synchronized));
    let (events, _) = server.hub().events(1000);
    let count = |kind: EventKind| events.iter().filter(|event| event.kind() == kind).count();
    assert_eq!(
        (count(EventKind::ObjectAppeared), count(EventKind::ObjectLost)),
        (1, 0),
        "{events:#?}"
    );
    server.shutdown().await;
}
