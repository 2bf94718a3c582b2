//! Adding a camera.

use axum::http::Method;
use roundel_client::{Client, PushOptions};
use roundel_proto::v1;
use roundel_server::model::hub::{CameraStatus, PoseStatus};
use serde_json::json;

use super::rig::{CONFIG, Rig, THIRD_CAMERA_TOML, third_camera};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_added_camera_disturbs_no_other_and_is_saved() {
    let rig = Rig::start().await;
    let before = [rig.running("a").await, rig.running("b").await];
    let known = rig.server.hub().objects();
    let mut events = Client::connect(&rig.url()).await.unwrap().events(0).await.unwrap();
    let answer = rig.accepted(Method::POST, "/cameras", Some(third_camera())).await;
    assert_eq!(answer["camera"]["name"], "c");
    assert!(answer["kept"].as_str().unwrap().contains("lab.toml"), "{answer}");
    assert_eq!(
        rig.file(),
        CONFIG.replace("\n# ---- The end", &format!("{THIRD_CAMERA_TOML}\n# ---- The end"))
    );
    let state = rig.running("c").await;
    assert_eq!(state.pose.status, PoseStatus::Configured);
    // An open event stream receives the event.
    let event = futures::StreamExt::next(&mut events).await.unwrap().unwrap();
    assert_eq!((event.kind(), event.camera.as_str()), (v1::EventKind::CameraAdded, "c"));

    let after = [rig.running("a").await, rig.running("b").await];
    for (before, after) in before.iter().zip(&after) {
        assert_eq!((after.restarts, after.status), (0, CameraStatus::Running));
        assert!(after.frames > before.frames);
    }
    let counts = rig.server.hub().fusion_counts();
    assert_eq!((counts.duplicate_frames, counts.clock_steps, counts.restarts), (0, 0, 0));
    let objects = rig.server.hub().objects();
    for object in known {
        assert!(objects.iter().any(|it| it.id == object.id && it.first_seen == object.first_seen));
    }
    assert_eq!(objects.len(), 3, "each camera sees its own object: {objects:#?}");
    let listed = rig.accepted(Method::GET, "/cameras", None).await;
    let names: Vec<&str> = listed["cameras"]
        .as_array()
        .unwrap()
        .iter()
        .map(|it| it["name"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["a", "b", "c"]);
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_invalid_camera_names_the_field_and_changes_nothing() {
    let rig = Rig::start().await;
    for (change, expected) in [
        (json!({ "name": "b" }), "name: cameras 2 and 3 are both named \"b\""),
        (json!({ "name": "" }), "name: `name` must be a text in quotes that is not empty"),
        (json!({ "source": "htp://10.0.0.2/" }), "source: "),
        (json!({ "calibration": "" }), "calibration: missing key `calibration`"),
        (json!({ "calibration": "none.yaml" }), "calibration: "),
        (json!({ "rate_hz": -3.0 }), "rate_hz: `rate_hz` must be a number above 0"),
        (json!({ "mode": "quick" }), "mode: `mode` must be \"precise\" or \"fast\""),
        (json!({ "pose": null }), "pose: missing key `pose`"),
        (
            json!({ "pose": { "unknown": true } }),
            "pose: `pose = \"unknown\"` needs reference roundels",
        ),
        (
            json!({ "pose": { "pose": {} } }),
            "pose: `orientation_xyzw` must be a quaternion of length 1",
        ),
        (json!({ "mask": [{ "corners": [{ "u": 1, "v": 1 }] }] }), "mask: "),
        (json!({ "sorce": "sim:" }), "body: expected JSON such as"),
    ] {
        let mut camera = third_camera();
        for (key, value) in change.as_object().unwrap() {
            camera[key] = value.clone();
        }
        let (status, message) = rig.rejected(Method::POST, "/cameras", Some(camera)).await;
        assert_eq!(status, 400, "{message}");
        assert!(message.starts_with(expected), "{message}");
    }
    assert_eq!(rig.file(), CONFIG);
    assert_eq!(rig.server.hub().cameras().len(), 2);
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_push_camera_accepts_a_sender_at_once_and_disconnects_it_when_removed() {
    let rig = Rig::start().await;
    let mut camera = third_camera();
    camera["source"] = json!("push:");
    rig.accepted(Method::POST, "/cameras", Some(camera.clone())).await;
    let client = Client::connect(&rig.url()).await.unwrap();
    let pusher = client.push(PushOptions::new("c")).unwrap();
    let mut statuses = pusher.statuses();
    statuses.wait_for(|status| status.connected).await.unwrap();
    rig.until("a sender", "c", |state| state.link.as_ref().is_some_and(|link| link.connected))
        .await;

    rig.accepted(Method::DELETE, "/cameras/c", None).await;
    let removed = statuses.wait_for(|status| !status.connected).await.unwrap().error.clone();
    assert!(removed.contains("this camera was removed"), "{removed}");
    let rejected = statuses.wait_for(|status| status.error.contains("no camera")).await.unwrap();
    assert!(rejected.error.contains("there are: a, b"), "{}", rejected.error);
    drop(rejected);
    // The sender reconnects when the camera is added again.
    rig.accepted(Method::POST, "/cameras", Some(camera)).await;
    statuses.wait_for(|status| status.connected).await.unwrap();
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_server_without_setup_rejects_every_change() {
    let open = CONFIG.replace("# any", "\nsetup = false");
    let rig = Rig::start_with(&open).await;
    for (method, path, body) in [
        (Method::POST, "/cameras", Some(third_camera())),
        (Method::PATCH, "/cameras/a", Some(json!({ "mode": "fast" }))),
        (Method::DELETE, "/cameras/a", None),
        (Method::GET, "/cameras/a/setup", None),
    ] {
        let (status, message) = rig.rejected(method, path, body).await;
        assert_eq!(status, 409);
        assert!(message.contains("`setup = true` under [server]"), "{message}");
    }
    assert_eq!(rig.file(), open);
    rig.server.shutdown().await;
}
