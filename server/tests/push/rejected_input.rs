//! Senders and messages that the server rejects, and the reasons that it returns.

use std::time::Duration;

use roundel_client::{Client, Picture, PushOptions, PushStatus, Pusher, v1};
use roundel_server::{
    app::serve::{ServeError, node::Node},
    model::{config::Config, hub::CameraStatus},
};

use super::rig::{CAMERAS, Rig, SIZE, config, wait_for};

async fn rejection(pusher: &Pusher) -> PushStatus {
    let look = || Some(pusher.status()).filter(|status| !status.error.is_empty());
    wait_for("a rejection", look, || pusher.status()).await
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn rejects_senders_for_unknown_busy_and_other_cameras() {
    let rig = Rig::start().await;
    let client = Client::connect(&rig.url()).await.unwrap();
    let status = rejection(&client.push(PushOptions::new("noth")).unwrap()).await;
    assert!(
        status.refused && status.error.contains("no camera \"noth\"; there are: north, south"),
        "{status:?}"
    );

    let _first = client.push(PushOptions::new("north").sender("robot 7")).unwrap();
    rig.until("a sender", 0, |state| state.link.as_ref().is_some_and(|link| link.connected)).await;
    let second = client.push(PushOptions::new("north").sender("robot 8")).unwrap();
    let status = rejection(&second).await;
    assert!(status.error.contains("robot 7 (127.0.0.1:"), "{status:?}");
    assert!(status.error.contains("is feeding this camera; end it first"), "{status:?}");

    let folder = tempfile::tempdir().unwrap();
    let text = "[server]\nlisten = \"127.0.0.1:0\"\n\
                [[roundel]]\nname = \"robot\"\nouter_mm = 160\ninner_mm = 64\n\
                [[camera]]\nname = \"north\"\nsource = \"sim:\"\n";
    let simulated = Config::parse(text, folder.path()).unwrap();
    let server = roundel_server::app::serve::Server::start(simulated).await.unwrap();
    let client = Client::connect(&server.local_addr().to_string()).await.unwrap();
    let status = rejection(&client.push(PushOptions::new("north")).unwrap()).await;
    assert!(
        status
            .error
            .contains("takes its frames from `sim:`: only a camera with source = \"push:\""),
        "{status:?}"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn invalid_messages_name_the_field() {
    let rig = Rig::start().await;
    let client = Client::connect(&rig.url()).await.unwrap();
    let seen = |detection: v1::Detection| v1::PushedObservations {
        observations: Some(v1::FrameObservations {
            detections: vec![detection],
            ..Default::default()
        }),
        ..Default::default()
    };
    let rim = Some(v1::Ellipse { center: Some(v1::PixelPoint::default()), ..Default::default() });
    let negative = rim.map(|rim| v1::Ellipse { semi_minor_px: -1.0, ..rim });
    let whole =
        v1::Detection { outer: rim, inner: rim, roundel: "robot".into(), ..Default::default() };
    let position = Some(v1::Vector3 { x: 1e200, y: 0.0, z: 1.0 });
    let far_away = v1::RoundelPose { position, ..Default::default() };
    for (wrong, expected) in [
        (
            v1::Detection { roundel: "cart".into(), ..whole.clone() },
            "observations.detections[0].roundel: expected a [[roundel]] of the server's configuration (\"robot\"), found \"cart\"",
        ),
        (
            v1::Detection { outer: None, ..whole.clone() },
            "observations.detections[0].outer: expected an ellipse with its centre, found none",
        ),
        (
            v1::Detection { outer: negative, ..whole.clone() },
            "observations.detections[0].outer: expected semi-axes of 0 pixels or more, found -1",
        ),
        (
            v1::Detection { threshold: 300, ..whole.clone() },
            "observations.detections[0].threshold: expected 0 to 255, found 300",
        ),
        (
            v1::Detection { pose: Some(v1::RoundelPose::default()), ..whole.clone() },
            "observations.detections[0].pose.position: expected three numbers, found none",
        ),
        (
            v1::Detection { pose: Some(far_away), ..whole.clone() },
            "observations.detections[0].pose.position: expected numbers of at most 1e9, found 1e200",
        ),
    ] {
        let pusher = client.push(PushOptions::new("north")).unwrap();
        pusher.observations(seen(wrong));
        let status = rejection(&pusher).await;
        assert!(status.refused && status.error.contains(expected), "{status:?}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn rejects_a_picture_of_a_wrong_size_naming_the_sender() {
    let rig = Rig::start().await;
    let client = Client::connect(&rig.url()).await.unwrap();
    let pusher = client.push(PushOptions::new("north").sender("robot 7")).unwrap();
    pusher.frame(Picture::Grey(vec![0; 64 * 48], [64, 48]), 0, None);
    let state = rig.until("a failure", 0, |state| state.error.contains("expected an image")).await;
    assert_eq!(state.status, CameraStatus::Failed);
    let expected =
        format!("of {} x {} pixels as the camera file says, found 64 x 48", SIZE.0, SIZE.1);
    assert!(state.error.contains("a picture of robot 7 (127.0.0.1:"), "{}", state.error);
    assert!(state.error.ends_with(&expected), "{}", state.error);
    pusher.finish(Duration::ZERO).await;
}

#[tokio::test]
async fn a_node_cannot_have_a_push_camera() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(&CAMERAS, "push:", "127.0.0.1:0", folder.path());
    let client = Client::connect_lazily("127.0.0.1:1").unwrap();
    let error = Node::start(&config, &client).err().unwrap();
    assert!(matches!(error, ServeError::NodeIsFed { .. }), "{error}");
    assert!(error.to_string().contains("only a server accepts pushed frames"), "{error}");
}
