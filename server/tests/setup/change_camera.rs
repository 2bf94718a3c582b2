//! Changing a camera.

use std::fs;

use axum::http::Method;
use roundel_client::Client;
use roundel_proto::v1;
use roundel_server::model::hub::PoseStatus;
use serde_json::json;

use super::rig::{CONFIG, Rig, lens, third_camera, wait_for, write_lens};

/// Height of an object in the newest snapshot.
fn height_m(rig: &Rig, id: u64) -> Option<f64> {
    let snapshots = rig.server.hub().snapshots();
    let newest = snapshots.borrow().clone();
    let object = newest.snapshot.objects.iter().find(|object| object.id.0 == id)?;
    Some(object.position_m.z)
}

/// The object that camera `a` sees.
async fn object_of_a(rig: &Rig) -> u64 {
    let look = || {
        let snapshots = rig.server.hub().snapshots();
        let newest = snapshots.borrow().clone();
        newest.snapshot.objects.iter().find(|it| it.position_m.x < 2.0).map(|it| it.id.0)
    };
    wait_for("an object", look, || rig.camera("a")).await
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_new_pose_or_lens_applies_between_two_frames_and_keeps_the_track() {
    let rig = Rig::start().await;
    rig.running("a").await;
    let id = object_of_a(&rig).await;
    let before = rig.newest_event();
    // The camera is 1 cm higher, and so is the track.
    let pose = json!({ "pose": {
        "position": { "x": 0.0, "y": 0.0, "z": 3.01 },
        "orientation": { "x": 1.0, "y": 0.0, "z": 0.0, "w": 0.0 },
    } });
    let answer = rig.accepted(Method::PATCH, "/cameras/a", Some(json!({ "pose": pose }))).await;
    assert_eq!(answer["camera"]["pose"]["position"]["z"], 3.01, "{answer}");
    assert_eq!(rig.file(), CONFIG.replace("[0.0, 0.0, 3.0]", "[0.0, 0.0, 3.01]"));
    // 160 mm appear as 40 px at 300 px focal length, so the roundel is 1.2 m away.
    let is_higher = || height_m(&rig, id).filter(|height_m| (height_m - 1.81).abs() < 0.004);
    wait_for("the new height", is_higher, || height_m(&rig, id)).await;

    write_lens(rig.folder.path(), "longer.yaml", 301.0);
    rig.accepted(Method::PATCH, "/cameras/a", Some(json!({ "calibration": "longer.yaml" }))).await;
    let state =
        rig.until("the lens", "a", |state| state.camera.as_ref() == Some(&lens(301.0))).await;
    assert_eq!(state.pose.status, PoseStatus::Configured);
    // The same file with another lens: an empty change reads it again.
    write_lens(rig.folder.path(), "longer.yaml", 302.0);
    rig.accepted(Method::PATCH, "/cameras/a", Some(json!({}))).await;
    rig.until("the lens", "a", |state| state.camera.as_ref() == Some(&lens(302.0))).await;
    rig.running("a").await;
    assert!(height_m(&rig, id).is_some(), "the object must keep its ID");
    let state = rig.camera("a").unwrap();
    assert_eq!(state.restarts, 0);
    let events = rig.events_since(before);
    let expected = ["(pose)", "(lens)", "(lens)"];
    assert_eq!(events.len(), expected.len(), "{events:#?}");
    assert!(events.iter().zip(expected).all(|(it, what)| it.contains(what)), "{events:#?}");
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_new_source_restarts_only_that_camera() {
    let rig = Rig::start().await;
    let before = [rig.running("a").await, rig.running("b").await];
    let id = rig.server.hub().installation().camera_id("a").unwrap();
    let mut observations =
        Client::connect(&rig.url()).await.unwrap().observations(&["a"]).await.unwrap();
    let change =
        json!({ "source": "images:c/*.pgm?fps=50&loop=true", "mode": "fast", "rate_hz": 50 });
    rig.accepted(Method::PATCH, "/cameras/a", Some(change)).await;
    let state = rig.until("the new rate", "a", |state| state.rate_hz > 40.0).await;
    assert_eq!(rig.server.hub().installation().camera_id("a"), Some(id));
    assert_eq!((state.promised_hz, state.restarts), (50.0, 0));
    assert!(state.frames > before[0].frames, "the frame count must continue");
    assert_eq!(rig.running("b").await.restarts, 0);
    let counts = rig.server.hub().fusion_counts();
    assert_eq!((counts.duplicate_frames, counts.clock_steps), (0, 0), "{counts:?}");
    // An open subscription continues, and so do the frame numbers.
    let mut number = 0;
    for _ in 0..20 {
        let frame = futures::StreamExt::next(&mut observations).await.unwrap().unwrap();
        assert!(frame.frame > number, "{} after {number}", frame.frame);
        number = frame.frame;
    }
    let expected = CONFIG.replacen("images:a/*.pgm?fps=25", "images:c/*.pgm?fps=50", 1).replacen(
        "[1.0, 0.0, 0.0, 0.0] }\n",
        "[1.0, 0.0, 0.0, 0.0] }\nrate_hz = 50.0\nmode = \"fast\"\n",
        1,
    );
    let saved = rig.file();
    let sorted = |text: &str| {
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        lines.sort();
        lines
    };
    assert_eq!(sorted(&saved), sorted(&expected));
    assert!(saved.contains("name = \"a\"  # as on its label"), "{saved}");
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_renamed_camera_keeps_its_id() {
    let rig = Rig::start().await;
    rig.running("a").await;
    let id = rig.server.hub().installation().camera_id("a").unwrap();
    let answer = rig.accepted(Method::PATCH, "/cameras/a", Some(json!({ "name": "door" }))).await;
    assert_eq!(answer["camera"]["name"], "door");
    assert_eq!(rig.file(), CONFIG.replace("name = \"a\"", "name = \"door\""));
    rig.running("door").await;
    assert_eq!(rig.server.hub().installation().camera_id("door"), Some(id));
    let (status, message) = rig.rejected(Method::PATCH, "/cameras/a", Some(json!({}))).await;
    assert_eq!((status, message.as_str()), (404, "no camera \"a\"; there are: door, b"));
    let (status, message) =
        rig.rejected(Method::PATCH, "/cameras/door", Some(json!({ "name": "b" }))).await;
    assert_eq!(status, 400);
    assert!(message.starts_with("name: cameras 1 and 2 are both named \"b\""), "{message}");
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_setup_is_returned_as_sent_except_for_passwords() {
    let rig = Rig::start().await;
    let mut camera = third_camera();
    camera["source"] = json!("http://lab:secret@127.0.0.1:9/stream");
    camera["rate_hz"] = json!(12.5);
    camera["mask"] = json!([{ "corners": [{ "u": 0.0, "v": 0.0 }, { "u": 20.0, "v": 0.0 }, { "u": 0.0, "v": 20.0 }] }]);
    rig.accepted(Method::POST, "/cameras", Some(camera.clone())).await;
    assert!(rig.file().contains("lab:secret@"), "{}", rig.file());
    let setup = rig.accepted(Method::GET, "/cameras/c/setup", None).await;
    assert!(!setup.to_string().contains("secret"), "{setup}");
    camera["source"] = json!("http://127.0.0.1:9/stream");
    for (key, value) in camera.as_object().unwrap().iter().filter(|(key, _)| *key != "pose") {
        assert_eq!(&setup[key], value, "{key}");
    }
    assert_eq!(setup["pose"]["pose"], camera["pose"]["pose"]);
    // Removes optional keys over gRPC: they are listed in `fields` and absent from the message. JSON uses null.
    let mut client = grpc(&rig).await;
    let request = v1::ChangeCameraRequest {
        name: "c".into(),
        camera: Some(v1::CameraSetup::default()),
        fields: vec!["rate_hz".into(), "mask".into()],
    };
    client.change_camera(request.clone()).await.unwrap();
    let setup = client.get_camera_setup(v1::GetCameraSetupRequest { name: "c".into() }).await;
    let setup = setup.unwrap().into_inner();
    assert_eq!((setup.rate_hz, setup.mask.len()), (None, 0));
    let wrong = v1::ChangeCameraRequest { fields: vec!["colour".into()], ..request };
    let status = client.change_camera(wrong).await.unwrap_err();
    assert_eq!(status.code(), tonic::Code::InvalidArgument);
    assert!(status.message().starts_with("fields: expected any of name, source"), "{status}");
    rig.server.shutdown().await;
}

pub async fn grpc(rig: &Rig) -> v1::roundel_client::RoundelClient<tonic::transport::Channel> {
    let endpoint = tonic::transport::Endpoint::from_shared(rig.url()).unwrap();
    v1::roundel_client::RoundelClient::new(endpoint.connect().await.unwrap())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_calibration_remains_in_force_until_pose_or_lens_change() {
    let rig = Rig::start().await;
    let state = rig.running("a").await;
    let id = rig.server.hub().installation().camera_id("a").unwrap();
    let mut placement = state.pose.placement.unwrap();
    placement.world_from_camera.translation.vector.x = 0.002;
    rig.server.calibrator().apply_pose(id, placement);
    let kept = rig.folder.path().join("lab.calibration.toml");
    rig.until("the calibration", "a", |state| state.pose.status == PoseStatus::Calibrated).await;
    // A restarted worker uses the calibrated pose.
    rig.accepted(Method::PATCH, "/cameras/a", Some(json!({ "mode": "fast" }))).await;
    let state = rig.running("a").await;
    assert_eq!((state.pose.status, state.calibration_version), (PoseStatus::Calibrated, 1));
    // A renamed camera keeps its calibration.
    rig.accepted(Method::PATCH, "/cameras/a", Some(json!({ "name": "door" }))).await;
    assert_eq!(rig.running("door").await.pose.status, PoseStatus::Calibrated);
    assert!(fs::read_to_string(&kept).unwrap().contains("name = \"door\""));
    // A pose set by a user replaces the calibrated one.
    let pose = json!({ "pose": {
        "position": { "x": 0.0, "y": 0.5, "z": 3.0 },
        "orientation": { "x": 1.0, "y": 0.0, "z": 0.0, "w": 0.0 },
    } });
    rig.accepted(Method::PATCH, "/cameras/door", Some(json!({ "pose": pose }))).await;
    let state = rig.running("door").await;
    assert_eq!((state.pose.status, state.calibration_version), (PoseStatus::Configured, 0));
    assert!(!fs::read_to_string(&kept).unwrap().contains("name = \"door\""));
    rig.server.shutdown().await;
}
