//! Cameras that are removed.

use axum::http::Method;
use futures::StreamExt;
use roundel_client::Client;
use roundel_proto::v1;
use tonic::Code;

use crate::{
    change::grpc,
    rig::{CONFIG, Rig, come_about, third},
};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn it_is_gone_from_everywhere_and_may_come_back() {
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
    let answer = rig.done(Method::DELETE, "/cameras/a", None).await;
    assert!(answer["camera"].is_null() && answer["kept"].as_str().unwrap().contains("lab.toml"));
    let (from, to) =
        (CONFIG.find("# By the door.").unwrap(), CONFIG.find("[[camera]]\nname = \"b\"").unwrap());
    let without = [&CONFIG[..from], &CONFIG[to..]].concat();
    assert_eq!(rig.file(), without, "with its own comment, and no other");

    let end = loop {
        match only.message().await {
            Ok(Some(_)) => {}
            Ok(None) => panic!("the stream ends without a reason"),
            Err(status) => break status,
        }
    };
    assert_eq!(end.code(), Code::NotFound);
    assert!(end.message().contains("no camera \"a\"; it was removed"), "{end}");
    let event = events.next().await.unwrap().unwrap();
    assert_eq!((event.kind(), event.camera.as_str()), (v1::EventKind::CameraRemoved, "a"));
    let (status, message) = rig.refused(Method::GET, "/cameras/a", None).await;
    assert_eq!((status, message.as_str()), (404, "no camera \"a\"; there are: b"));
    let (status, _) = rig.refused(Method::GET, "/cameras/a/frame.jpg", None).await;
    assert_eq!(status, 404);
    let (status, _) = rig.refused(Method::DELETE, "/cameras/a", None).await;
    assert_eq!(status, 404);
    // What it saw grows old as if nobody saw it any more, and what the other sees goes on.
    let lost = || {
        let snapshots = rig.server.hub().snapshots();
        let newest = snapshots.borrow().clone();
        Some(()).filter(|()| newest.snapshot.objects.len() == 1)
    };
    come_about("the end of its track", lost, || rig.server.hub().objects()).await;
    let after = rig.running("b").await;
    assert!(after.frames > before.frames && after.restarts == 0);
    let (status, message) = rig.refused(Method::DELETE, "/cameras/b", None).await;
    assert_eq!(status, 409);
    assert!(message.contains("it is the only camera"), "{message}");

    // Under the same name it is another camera, which who asked for that name sees as well.
    let mut again = third();
    again["name"] = "a".into();
    rig.done(Method::POST, "/cameras", Some(again)).await;
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
