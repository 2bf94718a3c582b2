//! Removing a camera.

use axum::http::Method;
use futures::StreamExt;
use roundel_client::Client;
use roundel_proto::v1;
use tonic::Code;

use super::{
    change_camera::grpc,
    rig::{CONFIG, Rig, third_camera, wait_for},
};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_removed_camera_disappears_everywhere_and_can_be_added_again() {
    let rig = Rig::start().await;
    rig.running("a").await;
    let before = rig.running("b").await;
    let id = rig.server.hub().installation().camera_id("a").unwrap();
    let mut client = grpc(&rig).await;
    let request = |cameras: &[&str]| v1::SubscribeObservationsRequest {
        cameras: cameras.iter().map(|&name| name.to_owned()).collect(),
    };
    let mut only = client.subscribe_observations(request(&["a"])).await.unwrap().into_inner();
    let mut both = client.subscribe_observations(request(&["a", "b"])).await.unwrap().into_inner();
    let mut events = Client::connect(&rig.url()).await.unwrap().events(0).await.unwrap();
    let answer = rig.accepted(Method::DELETE, "/cameras/a", None).await;
    assert!(answer["camera"].is_null() && answer["kept"].as_str().unwrap().contains("lab.toml"));
    let (from, to) =
        (CONFIG.find("# By the door.").unwrap(), CONFIG.find("[[camera]]\nname = \"b\"").unwrap());
    let without = [&CONFIG[..from], &CONFIG[to..]].concat();
    assert_eq!(rig.file(), without, "its own comment must be removed, and no other");

    let end = loop {
        match only.message().await {
            Ok(Some(_)) => {}
            Ok(None) => panic!("the stream ends without a status"),
            Err(status) => break status,
        }
    };
    assert_eq!(end.code(), Code::NotFound);
    assert!(end.message().contains("no camera \"a\"; it was removed"), "{end}");
    let event = events.next().await.unwrap().unwrap();
    assert_eq!((event.kind(), event.camera.as_str()), (v1::EventKind::CameraRemoved, "a"));
    let (status, message) = rig.rejected(Method::GET, "/cameras/a", None).await;
    assert_eq!((status, message.as_str()), (404, "no camera \"a\"; there are: b"));
    let (status, _) = rig.rejected(Method::GET, "/cameras/a/frame.jpg", None).await;
    assert_eq!(status, 404);
    let (status, _) = rig.rejected(Method::DELETE, "/cameras/a", None).await;
    assert_eq!(status, 404);
    // Its object is lost like any unobserved one, and the object of the other camera remains.
    let lost = || {
        let snapshots = rig.server.hub().snapshots();
        let newest = snapshots.borrow().clone();
        Some(()).filter(|()| newest.snapshot.objects.len() == 1)
    };
    wait_for("the end of its track", lost, || rig.server.hub().objects()).await;
    let after = rig.running("b").await;
    assert!(after.frames > before.frames && after.restarts == 0);
    let (status, message) = rig.rejected(Method::DELETE, "/cameras/b", None).await;
    assert_eq!(status, 409);
    assert!(message.contains("it is the only camera"), "{message}");

    // A camera added with the same name is a new one; a subscription by name includes it.
    let mut again = third_camera();
    again["name"] = "a".into();
    rig.accepted(Method::POST, "/cameras", Some(again)).await;
    rig.running("a").await;
    assert_ne!(rig.server.hub().installation().camera_id("a"), Some(id));
    let mut first = u64::MAX;
    while first > 100 {
        let frame = both.message().await.unwrap().unwrap();
        if frame.camera == "a" {
            first = first.min(frame.frame);
        }
    }
    rig.server.shutdown().await;
}
