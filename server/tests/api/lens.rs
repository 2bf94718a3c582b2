//! Lens calibration over REST, without a board in view; `tests/tests/lens_session.rs` tests it with one.

use std::{sync::Arc, time::Duration};

use axum::{
    body::Body,
    http::{Request, StatusCode},
};
use roundel_core::{id::CameraId, world::FrameObservations};
use roundel_server::model::hub::Picture;
use serde_json::Value;

use super::rig::{Answer, Rig};

async fn send(rig: &Rig, method: &str, path: &str, body: &str) -> Answer {
    let request = Request::builder()
        .method(method)
        .uri(format!("{}/api/v1/lens{path}", rig.url()))
        .header("content-type", "application/json")
        .body(Body::from(body.to_owned()))
        .unwrap();
    rig.request(request).await
}

/// Polls until `is_so` accepts the status; fails on a hang.
async fn until(rig: &Rig, is_so: impl Fn(&Value) -> bool) -> Value {
    for _ in 0..1000 {
        let status = rig.get("/api/v1/lens").await.json();
        if is_so(&status) {
            return status;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    panic!("the status never matched: {}", rig.get("/api/v1/lens").await.text());
}

/// Runs a camera that delivers a white picture on each request.
fn show_white(rig: &Rig) -> tokio::task::JoinHandle<()> {
    let hub = rig.hub.clone();
    tokio::spawn(async move {
        loop {
            if hub.take_picture_request(CameraId(0)) {
                let observations = Arc::new(FrameObservations {
                    camera: CameraId(0),
                    frame: 1,
                    capture_time: hub.installation().started,
                    received_time: hub.installation().started,
                    calibration_version: 0,
                    detections: Vec::new(),
                });
                let picture = Picture::new((64, 48), vec![255; 64 * 48], observations);
                hub.publish_picture(CameraId(0), picture);
            }
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    })
}

#[tokio::test]
async fn calibration_without_a_board_reports_what_is_missing() {
    let rig = Rig::start().await;
    assert_eq!(rig.get("/api/v1/lens").await.json()["stage"], "idle");
    assert_eq!(rig.get("/api/v1/lens/picture.jpg").await.error().0, "unavailable");
    let begun = send(&rig, "POST", "", r#"{"camera": "north"}"#).await;
    assert_eq!(begun.status, StatusCode::OK, "{}", begun.text());
    let begun = begun.json();
    assert_eq!((&begun["stage"], &begun["camera"]), (&"gathering".into(), &"north".into()));
    assert_eq!(begun["board"], "7 x 5 roundels of 30 mm, 36 mm from centre to centre");

    // Before the first picture the status explains the wait.
    let waiting = until(&rig, |it| it["error"] != "").await;
    assert!(waiting["error"].as_str().unwrap().contains("no picture from camera north"));
    let white = show_white(&rig);
    let seen = until(&rig, |it| it["frames"].as_u64() > Some(1)).await;
    assert_eq!(
        (&seen["newest"], &seen["error"]),
        (&"no roundel of the board is visible".into(), &"".into())
    );
    assert_eq!((&seen["width"], &seen["taken"]), (&64.into(), &0.into()));
    assert_eq!(seen["coverage"]["zones"], serde_json::json!([0, 0, 0, 0, 0, 0, 0, 0, 0]));
    let missing = seen["missing"].as_array().unwrap();
    assert!(missing[0].as_str().unwrap().starts_with("a view tilted by 20° to 45°"), "{missing:?}");
    let picture = rig.get("/api/v1/lens/picture.jpg").await;
    assert_eq!(picture.header("content-type"), "image/jpeg");
    assert!(picture.body.starts_with(&[0xff, 0xd8]));

    // Only one calibration can run at a time.
    let second = send(&rig, "POST", "", r#"{"camera": "south side"}"#).await;
    assert_eq!(second.error().0, "failed_precondition");
    assert!(
        second.error().1.contains("the lens of north is being calibrated"),
        "{}",
        second.text()
    );

    let finished = send(&rig, "PUT", "/finished", "").await;
    assert_eq!(finished.status, StatusCode::OK);
    let failed = until(&rig, |it| it["stage"] == "failed").await;
    let error = failed["error"].as_str().unwrap();
    assert!(error.contains("expected at least 5 different views of the board, found 0"), "{error}");
    assert!(error.contains("still missing") && error.contains("without the board"), "{error}");
    for (method, path) in [("PUT", "/finished"), ("DELETE", "")] {
        let answer = send(&rig, method, path, "").await;
        assert!(answer.error().1.contains("no lens is being calibrated"), "{}", answer.text());
    }
    for (method, path) in [("PUT", "/applied"), ("GET", "/file")] {
        let answer = send(&rig, method, path, "").await;
        assert!(answer.error().1.contains("there is no calibrated lens"), "{}", answer.text());
    }

    // A second calibration starts from the beginning, and can be cancelled without an error.
    send(&rig, "POST", "", r#"{"camera": "north", "board": "5x4", "marker": 40}"#).await;
    until(&rig, |it| it["frames"].as_u64() > Some(0)).await;
    assert_eq!(send(&rig, "DELETE", "", "").await.status, StatusCode::OK);
    let idle = until(&rig, |it| it["stage"] == "idle").await;
    assert_eq!(idle["error"], "");
    white.abort();
    rig.stop().await;
}

#[tokio::test]
async fn removing_the_camera_ends_the_calibration() {
    let rig = Rig::start().await;
    send(&rig, "POST", "", r#"{"camera": "north"}"#).await;
    rig.hub.remove_camera(CameraId(0));
    let failed = until(&rig, |it| it["stage"] == "failed").await;
    assert_eq!(failed["error"], "camera north was removed");
    rig.stop().await;
}

#[tokio::test]
async fn wrong_requests_name_what_was_expected() {
    let rig = Rig::start().await;
    for (body, status, expected) in [
        ("{}", 400, "camera: expected a camera's name, or a `source`, found neither"),
        (r#"{"camera": "north", "source": "sim:"}"#, 400, "either a camera or a source"),
        (r#"{"camera": "east"}"#, 404, "no camera \"east\""),
        // The rig's server is open to the network and has no `setup = true`.
        (r#"{"source": "v4l2:/dev/video0"}"#, 409, "`setup = true` under [server] allows it"),
        (r#"{"camera": "north", "board": "7"}"#, 400, "board: expected COLUMNSxROWS"),
        (r#"{"camera": "north", "board": "2x2"}"#, 400, "board: expected a board of 3 to 40"),
        (r#"{"camera": "north", "board": "40x40"}"#, 400, "use more bits"),
        (r#"{"camera": "north", "marker": 0}"#, 400, "marker: expected a diameter above 0 mm"),
        (r#"{"camera": "north", "pitch": 20}"#, 400, "at least 1.15 of the outer diameter"),
        (r#"{"camera": "north", "code": "99"}"#, 400, "code: expected codes of 2 to 16 bits"),
        (r#"{"camera": "north", "views": 4}"#, 400, "views: expected 5 to 100 views, found 4"),
        (r#"{"camera": "north", "model": "fisheye"}"#, 400, "model: expected plumb_bob, "),
        (r#"{"camera": "north", "bord": "7x5"}"#, 400, "unknown field `bord`"),
        ("[", 400, "body: expected JSON such as"),
    ] {
        let answer = send(&rig, "POST", "", body).await;
        assert_eq!(answer.status.as_u16(), status, "{body}: {}", answer.text());
        assert!(answer.error().1.contains(expected), "{body}: {}", answer.text());
    }
    assert_eq!(rig.get("/api/v1/lens").await.json()["stage"], "idle");
    rig.stop().await;
}
