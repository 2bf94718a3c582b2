//! Cameras that are changed.

use std::fs;

use axum::http::Method;
use roundel_client::Client;
use roundel_proto::v1;
use roundel_server::model::hub::PoseStatus;
use serde_json::json;

use crate::rig::{CONFIG, Rig, come_about, lens, third, write_lens};

/// Height of what camera `a` sees, in the newest snapshot.
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
    come_about("an object", look, || rig.camera("a")).await
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn another_pose_or_lens_is_taken_over_between_two_frames_and_no_track_is_lost() {
    let rig = Rig::start().await;
    rig.running("a").await;
    let id = object_of_a(&rig).await;
    let before = rig.newest_event();
    // 1 cm higher: the track moves with it.
    let pose = json!({ "pose": {
        "position": { "x": 0.0, "y": 0.0, "z": 3.01 },
        "orientation": { "x": 1.0, "y": 0.0, "z": 0.0, "w": 0.0 },
    } });
    let answer = rig.done(Method::PATCH, "/cameras/a", Some(json!({ "pose": pose }))).await;
    assert_eq!(answer["camera"]["pose"]["position"]["z"], 3.01, "{answer}");
    assert_eq!(rig.file(), CONFIG.replace("[0.0, 0.0, 3.0]", "[0.0, 0.0, 3.01]"));
    // 160 mm over 40 px at 300 px focal length are 1.2 m away.
    let high = || height_m(&rig, id).filter(|height_m| (height_m - 1.81).abs() < 0.004);
    come_about("the new place", high, || height_m(&rig, id)).await;

    write_lens(rig.folder.path(), "longer.yaml", 301.0);
    rig.done(Method::PATCH, "/cameras/a", Some(json!({ "calibration": "longer.yaml" }))).await;
    let state =
        rig.until("the lens", "a", |state| state.camera.as_ref() == Some(&lens(301.0))).await;
    assert_eq!(state.pose.status, PoseStatus::Configured);
    // The same file with another lens in it: it is read anew without any field.
    write_lens(rig.folder.path(), "longer.yaml", 302.0);
    rig.done(Method::PATCH, "/cameras/a", Some(json!({}))).await;
    rig.until("the lens", "a", |state| state.camera.as_ref() == Some(&lens(302.0))).await;
    rig.running("a").await;
    assert!(height_m(&rig, id).is_some(), "the object is the same");
    let state = rig.camera("a").unwrap();
    assert_eq!(state.restarts, 0);
    let told = rig.events_since(before);
    let expected = ["(pose)", "(lens)", "(lens)"];
    assert_eq!(told.len(), expected.len(), "{told:#?}");
    assert!(told.iter().zip(expected).all(|(it, what)| it.contains(what)), "{told:#?}");
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn another_source_has_only_that_camera_begin_anew() {
    let rig = Rig::start().await;
    let before = [rig.running("a").await, rig.running("b").await];
    let id = rig.server.hub().installation().camera_id("a").unwrap();
    let mut observations =
        Client::connect(&rig.url()).await.unwrap().observations(&["a"]).await.unwrap();
    let change =
        json!({ "source": "images:c/*.pgm?fps=50&loop=true", "mode": "fast", "rate_hz": 50 });
    rig.done(Method::PATCH, "/cameras/a", Some(change)).await;
    let state = rig.until("its new rate", "a", |state| state.rate_hz > 40.0).await;
    assert_eq!(rig.server.hub().installation().camera_id("a"), Some(id));
    assert_eq!((state.promised_hz, state.restarts), (50.0, 0));
    assert!(state.frames > before[0].frames, "it goes on to count");
    assert_eq!(rig.running("b").await.restarts, 0);
    let counts = rig.server.hub().fusion_counts();
    assert_eq!((counts.duplicate_frames, counts.clock_steps), (0, 0), "{counts:?}");
    // Who follows the camera goes on, with numbers that go on.
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
    let (told, expected) = (rig.file(), expected);
    let sorted = |text: &str| {
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        lines.sort();
        lines
    };
    assert_eq!(sorted(&told), sorted(&expected));
    assert!(told.contains("name = \"a\"  # as on its label"), "{told}");
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_new_name_is_the_same_camera() {
    let rig = Rig::start().await;
    rig.running("a").await;
    let id = rig.server.hub().installation().camera_id("a").unwrap();
    let answer = rig.done(Method::PATCH, "/cameras/a", Some(json!({ "name": "door" }))).await;
    assert_eq!(answer["camera"]["name"], "door");
    assert_eq!(rig.file(), CONFIG.replace("name = \"a\"", "name = \"door\""));
    rig.running("door").await;
    assert_eq!(rig.server.hub().installation().camera_id("door"), Some(id));
    let (status, message) = rig.refused(Method::PATCH, "/cameras/a", Some(json!({}))).await;
    assert_eq!((status, message.as_str()), (404, "no camera \"a\"; there are: door, b"));
    let (status, message) =
        rig.refused(Method::PATCH, "/cameras/door", Some(json!({ "name": "b" }))).await;
    assert_eq!(status, 400);
    assert!(message.starts_with("name: cameras 1 and 2 are both named \"b\""), "{message}");
    rig.server.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_setup_comes_back_as_it_was_given_but_for_passwords() {
    let rig = Rig::start().await;
    let mut camera = third();
    camera["source"] = json!("http://lab:secret@127.0.0.1:9/stream");
    camera["rate_hz"] = json!(12.5);
    camera["mask"] = json!([{ "corners": [{ "u": 0.0, "v": 0.0 }, { "u": 20.0, "v": 0.0 }, { "u": 0.0, "v": 20.0 }] }]);
    rig.done(Method::POST, "/cameras", Some(camera.clone())).await;
    assert!(rig.file().contains("lab:secret@"), "{}", rig.file());
    let setup = rig.done(Method::GET, "/cameras/c/setup", None).await;
    assert!(!setup.to_string().contains("secret"), "{setup}");
    camera["source"] = json!("http://127.0.0.1:9/stream");
    for (key, value) in camera.as_object().unwrap().iter().filter(|(key, _)| *key != "pose") {
        assert_eq!(&setup[key], value, "{key}");
    }
    assert_eq!(setup["pose"]["pose"], camera["pose"]["pose"]);
    // Over gRPC, with a key that is taken out: null there, a field that is named and absent here.
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
async fn what_a_calibration_found_holds_until_pose_or_lens_change() {
    let rig = Rig::start().await;
    let state = rig.running("a").await;
    let id = rig.server.hub().installation().camera_id("a").unwrap();
    let mut placement = state.pose.placement.unwrap();
    placement.world_from_camera.translation.vector.x = 0.002;
    rig.server.calibrator().apply_pose(id, placement);
    let kept = rig.folder.path().join("lab.calibration.toml");
    rig.until("the calibration", "a", |state| state.pose.status == PoseStatus::Calibrated).await;
    // A worker that begins anew stands where the calibration found its camera.
    rig.done(Method::PATCH, "/cameras/a", Some(json!({ "mode": "fast" }))).await;
    let state = rig.running("a").await;
    assert_eq!((state.pose.status, state.calibration_version), (PoseStatus::Calibrated, 1));
    // Another name is the same camera.
    rig.done(Method::PATCH, "/cameras/a", Some(json!({ "name": "door" }))).await;
    assert_eq!(rig.running("door").await.pose.status, PoseStatus::Calibrated);
    assert!(fs::read_to_string(&kept).unwrap().contains("name = \"door\""));
    // Where a person says where it stands, that counts.
    let pose = json!({ "pose": {
        "position": { "x": 0.0, "y": 0.5, "z": 3.0 },
        "orientation": { "x": 1.0, "y": 0.0, "z": 0.0, "w": 0.0 },
    } });
    rig.done(Method::PATCH, "/cameras/door", Some(json!({ "pose": pose }))).await;
    let state = rig.running("door").await;
    assert_eq!((state.pose.status, state.calibration_version), (PoseStatus::Configured, 0));
    assert!(!fs::read_to_string(&kept).unwrap().contains("name = \"door\""));
    rig.server.shutdown().await;
}
