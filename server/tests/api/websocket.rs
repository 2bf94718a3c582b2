//! `/api/v1/stream`, with a real WebSocket client.

use std::time::Duration;

use futures::{SinkExt, StreamExt};
use roundel_core::{
    id::{CameraId, ObjectId},
    world::EventKind,
};
use roundel_proto::v1;
use roundel_server::api::Limits;
use roundel_server::hub::{CameraStatus, Happening};
use serde_json::Value;
use tokio::{net::TcpStream, time::timeout};
use tokio_tungstenite::{
    MaybeTlsStream, WebSocketStream, connect_async,
    tungstenite::{self, Message},
};

use crate::rig::{self, HANG, Rig, objects};

pub type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;

pub async fn open(rig: &Rig, query: &str) -> Socket {
    let url = format!("ws://{}/api/v1/stream{query}", rig.address);
    connect_async(url).await.unwrap().0
}

async fn next(socket: &mut Socket) -> Value {
    loop {
        let message = timeout(HANG, socket.next()).await.expect("no message comes");
        if let Message::Text(text) = message.unwrap().unwrap() {
            return serde_json::from_str(&text).unwrap();
        }
    }
}

async fn next_snapshot(socket: &mut Socket) -> v1::Snapshot {
    let mut message = next(socket).await;
    assert_eq!(message.as_object().unwrap().len(), 1, "{message}");
    serde_json::from_value(message["snapshot"].take()).unwrap()
}

#[tokio::test]
async fn snapshots_are_all_that_comes_by_default() {
    let rig = Rig::start().await;
    rig.publish(objects(3));
    let mut socket = open(&rig, "").await;
    let snapshot = next_snapshot(&mut socket).await;
    assert_eq!((snapshot.sequence, snapshot.objects.len()), (1, 3));
    assert!(snapshot.sent_time_ns >= snapshot.fused_time_ns);
    for sequence in 2..5 {
        rig.publish(objects(1));
        assert_eq!(next_snapshot(&mut socket).await.sequence, sequence);
    }
    let query = "?include=snapshots&ids=3,2&omit_covariance=true&horizon_ms=&max_rate_hz=30";
    rig.publish(objects(3));
    let mut chosen = open(&rig, query).await;
    let snapshot = next_snapshot(&mut chosen).await;
    let ids: Vec<u64> = snapshot.objects.iter().map(|object| object.object_id).collect();
    assert_eq!(ids, [2, 3]);
    assert!(snapshot.objects.iter().all(|object| object.covariance.is_empty()));
    rig.stop().await;
}

#[tokio::test]
async fn one_socket_carries_cameras_and_events_too() {
    let rig = Rig::start().await;
    for id in 1..=60 {
        let happening = Happening::Object(ObjectId(id), EventKind::Appeared);
        rig.hub.publish_event(rig.clock.now(), happening, String::new());
    }
    rig.hub.update_camera(CameraId(1), |camera| camera.status = CameraStatus::Running);
    let mut socket = open(&rig, "?include=cameras,events").await;
    // The newest fifty first, in their order.
    for sequence in 11..=60 {
        assert_eq!(next(&mut socket).await["event"]["sequence"], sequence);
    }
    rig.hub.publish_event(
        rig.clock.now(),
        Happening::Object(ObjectId(7), EventKind::Lost),
        "object 7 was given up".into(),
    );
    let (mut cameras, mut event) = (0, None);
    while cameras < 2 || event.is_none() {
        let message = next(&mut socket).await;
        if let Some(list) = message.get("cameras") {
            cameras += 1;
            assert_eq!(list[1]["name"], "south side");
            assert_eq!(list[1]["status"], "running");
        } else {
            event = Some(message["event"].clone());
        }
    }
    let event = event.unwrap();
    assert_eq!((&event["sequence"], &event["kind"]), (&61.into(), &"object_lost".into()));
    assert_eq!(event["message"], "object 7 was given up");
    rig.stop().await;
}

#[tokio::test]
async fn a_wrong_query_is_refused_before_the_upgrade() {
    let rig = Rig::start().await;
    let url = format!("ws://{}/api/v1/stream?max_rate_hz=NaN", rig.address);
    let error = connect_async(url).await.unwrap_err();
    let tungstenite::Error::Http(response) = error else { panic!("{error}") };
    assert_eq!(response.status(), 400);
    let body: Value = serde_json::from_slice(response.body().as_ref().unwrap()).unwrap();
    let message = body["error"]["message"].as_str().unwrap();
    assert!(message.starts_with("max_rate_hz: expected a rate above 0"), "{message}");
    rig.stop().await;
}

#[tokio::test]
async fn a_slow_page_skips_to_the_newest() {
    // On a busy machine the test itself may be slower than the limit for stuck clients.
    let limits = Limits { send_timeout: HANG * 10, ..Limits::default() };
    let rig = Rig::start_with(rig::hub("run"), limits, "127.0.0.1:0").await;
    let mut slow = open(&rig, "").await;
    let mut quick = open(&rig, "").await;
    // More than the kernel holds for both ends together.
    let last = 400;
    for _ in 1..=last {
        rig.publish(objects(100));
        assert_eq!(next_snapshot(&mut quick).await.missed, 0);
    }
    let (mut accounted, mut newest) = (0, 0);
    while newest < last {
        let snapshot = next_snapshot(&mut slow).await;
        accounted += 1 + snapshot.missed;
        newest = snapshot.sequence;
    }
    assert!(accounted >= last - 1 && accounted <= last, "{accounted} of {last}");
    rig.stop().await;
}

#[tokio::test]
async fn what_a_client_says_is_ignored_up_to_a_size() {
    let rig = Rig::start().await;
    let mut talker = open(&rig, "").await;
    let mut other = open(&rig, "").await;
    talker.send(Message::text("hello")).await.unwrap();
    talker.send(Message::binary(vec![0; 60_000])).await.unwrap();
    rig.publish(objects(1));
    assert_eq!(next_snapshot(&mut talker).await.sequence, 1);
    assert_eq!(next_snapshot(&mut other).await.sequence, 1);

    talker.send(Message::binary(vec![0; 100_000])).await.unwrap();
    let end = async {
        while let Some(Ok(message)) = talker.next().await {
            if message.is_close() {
                break;
            }
        }
    };
    timeout(HANG, end).await.expect("a client that says too much is still there");
    rig.publish(objects(1));
    assert_eq!(next_snapshot(&mut other).await.sequence, 2);
    rig.stop().await;
}

#[tokio::test]
async fn a_client_that_does_not_read_is_cut_off() {
    let limits = Limits { send_timeout: Duration::from_millis(200), ..Limits::default() };
    let rig = Rig::start_with(rig::hub("run"), limits, "127.0.0.1:0").await;
    let stuck = open(&rig, "").await;
    let gone = async {
        loop {
            rig.publish(objects(300));
            tokio::time::sleep(Duration::from_millis(5)).await;
            if rig.get("/metrics").await.text().contains("\nroundel_subscribers 0\n") {
                break;
            }
        }
    };
    timeout(HANG, gone).await.expect("a stuck client is still a subscriber");
    drop(stuck);
    rig.stop().await;
}
