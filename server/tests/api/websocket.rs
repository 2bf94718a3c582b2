//! `/api/v1/stream`, with a real WebSocket client.

use std::time::Duration;

use futures::{SinkExt, StreamExt};
use prost::Message as _;
use roundel_core::{
    id::{CameraId, ObjectId},
    world,
};
use roundel_proto::v1::{self, stream_message::Message as Alternative};
use roundel_server::api::ApiLimits;
use roundel_server::model::hub::{CameraStatus, EventKind};
use serde_json::Value;
use tokio::{net::TcpStream, time::timeout};
use tokio_tungstenite::{
    MaybeTlsStream, WebSocketStream, connect_async,
    tungstenite::{
        self, Message,
        client::IntoClientRequest,
        protocol::frame::{
            Frame,
            coding::{CloseCode, Data, OpCode},
        },
    },
};

use crate::rig::{self, HANG, Rig, objects};

pub type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;

pub async fn open(rig: &Rig, query: &str) -> Socket {
    let url = format!("ws://{}/api/v1/stream{query}", rig.address);
    connect_async(url).await.unwrap().0
}

/// One that takes protobuf.
pub async fn open_binary(rig: &Rig, query: &str) -> Socket {
    let url = format!("ws://{}/api/v1/stream{query}", rig.address);
    let mut request = url.into_client_request().unwrap();
    let protocols = "roundel.v9.avian, roundel.v1.protobuf".parse().unwrap();
    request.headers_mut().insert("sec-websocket-protocol", protocols);
    let (socket, response) = connect_async(request).await.unwrap();
    assert_eq!(response.headers()["sec-websocket-protocol"], "roundel.v1.protobuf");
    socket
}

pub async fn next(socket: &mut Socket) -> Value {
    loop {
        let message = timeout(HANG, socket.next()).await.expect("no message comes");
        if let Message::Text(text) = message.unwrap().unwrap() {
            return serde_json::from_str(&text).unwrap();
        }
    }
}

pub async fn next_snapshot(socket: &mut Socket) -> v1::Snapshot {
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
        let kind = EventKind::ObjectStageChanged(ObjectId(id), world::EventKind::Appeared);
        rig.hub.publish_event(rig.clock.now(), kind, String::new());
    }
    rig.hub.update_camera(CameraId(1), |camera| camera.status = CameraStatus::Running);
    let mut socket = open(&rig, "?include=cameras,events").await;
    // The newest fifty first, in their order.
    for sequence in 11..=60 {
        assert_eq!(next(&mut socket).await["event"]["sequence"], sequence);
    }
    rig.hub.publish_event(
        rig.clock.now(),
        EventKind::ObjectStageChanged(ObjectId(7), world::EventKind::Lost),
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
    let limits = ApiLimits { send_timeout: HANG * 10, ..ApiLimits::default() };
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
async fn what_is_wanted_changes_on_the_open_socket() {
    let rig = Rig::start().await;
    rig.publish(objects(3));
    let kind = EventKind::ObjectStageChanged(ObjectId(1), world::EventKind::Appeared);
    rig.hub.publish_event(rig.clock.now(), kind, "one".into());
    let mut socket = open(&rig, "?ids=1").await;
    assert_eq!(next_snapshot(&mut socket).await.objects.len(), 1);
    let wish = r#"{"snapshots": {"object_ids": [2, 3], "omit_covariance": true}, "events": true}"#;
    socket.send(Message::text(wish)).await.unwrap();
    assert_eq!(next(&mut socket).await["event"]["message"], "one");
    let snapshot = next_snapshot(&mut socket).await;
    let ids: Vec<u64> = snapshot.objects.iter().map(|object| object.object_id).collect();
    assert_eq!((ids.as_slice(), snapshot.missed), ([2, 3].as_slice(), 0));
    assert!(snapshot.objects[0].covariance.is_empty());
    // No snapshots any more, and the event is not told twice.
    socket.send(Message::text(r#"{"cameras": true, "events": true}"#)).await.unwrap();
    assert!(next(&mut socket).await["cameras"].is_array());
    rig.publish(objects(3));
    assert!(next(&mut socket).await["cameras"].is_array());
    rig.stop().await;
}

#[tokio::test]
async fn a_wrong_wish_is_answered_and_changes_nothing() {
    let rig = Rig::start().await;
    let mut socket = open(&rig, "?ids=2").await;
    for (wrong, why) in [
        (Message::text("hello"), "expected a message such as {\"snapshots\""),
        (Message::text(r#"{"snapshot": {}}"#), "unknown field `snapshot`"),
        (Message::text(r#"{"snapshots": {"ids": [1]}}"#), "unknown field `ids`"),
        (Message::text(r#"{"snapshots": {"horizon_ms": 1e9}}"#), "horizon_ms: expected"),
        (Message::text(r#"{"snapshots": {"roundels": ["x"]}}"#), "any of robot, cart"),
        (Message::binary(vec![0; 60_000]), "binary bytes"),
    ] {
        socket.send(wrong).await.unwrap();
        let answer = next(&mut socket).await;
        assert_eq!(answer["error"]["code"], "invalid_argument");
        let message = answer["error"]["message"].as_str().unwrap();
        assert!(message.contains(why), "{message}");
    }
    rig.publish(objects(3));
    assert_eq!(next_snapshot(&mut socket).await.objects[0].object_id, 2);
    rig.stop().await;
}

#[tokio::test]
async fn a_subprotocol_gives_the_same_in_protobuf() {
    let rig = Rig::start().await;
    let mut text = open(&rig, "").await;
    let mut binary = open_binary(&rig, "?include=snapshots,cameras").await;
    rig.publish(objects(40));
    let expected = next_snapshot(&mut text).await;
    let (mut cameras, mut snapshot) = (None, None);
    while cameras.is_none() || snapshot.is_none() {
        match next_binary(&mut binary).await {
            Alternative::Cameras(list) => cameras = Some(list.cameras),
            Alternative::Snapshot(found) => snapshot = Some(found),
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(cameras.unwrap()[1].name, "south side");
    let snapshot = snapshot.unwrap();
    assert!(snapshot.sent_time_ns > 0);
    assert_eq!(snapshot, v1::Snapshot { sent_time_ns: snapshot.sent_time_ns, ..expected });

    let wish = v1::StreamRequest { events: true, ..Default::default() };
    binary.send(Message::binary(wish.encode_to_vec())).await.unwrap();
    let kind = EventKind::ObjectStageChanged(ObjectId(7), world::EventKind::Lost);
    rig.hub.publish_event(rig.clock.now(), kind, "gone".into());
    let event = async {
        loop {
            if let Alternative::Event(event) = next_binary(&mut binary).await {
                return event;
            }
        }
    };
    assert_eq!(timeout(HANG, event).await.unwrap().message, "gone");
    binary.send(Message::binary(vec![0xff; 9])).await.unwrap();
    let Alternative::Error(error) = next_binary(&mut binary).await else { panic!("no error") };
    assert_eq!(error.code, "invalid_argument");
    rig.stop().await;
}

pub async fn next_binary(socket: &mut Socket) -> Alternative {
    loop {
        let message = timeout(HANG, socket.next()).await.expect("no message comes");
        if let Message::Binary(bytes) = message.unwrap().unwrap() {
            return v1::StreamMessage::decode(bytes.as_ref()).unwrap().message.unwrap();
        }
    }
}

#[tokio::test]
async fn a_client_that_says_too_much_hears_so_and_is_cut_off() {
    let rig = Rig::start().await;
    let mut other = open(&rig, "").await;
    for (message, code, reason) in [
        (Message::binary(vec![0; 3_000_000]), CloseCode::Size, "at most 262144 bytes"),
        // A text that is none.
        (
            Message::Frame(Frame::message(vec![0xff], OpCode::Data(Data::Text), true)),
            CloseCode::Invalid,
            "UTF-8",
        ),
    ] {
        let mut talker = open(&rig, "").await;
        talker.send(message).await.unwrap();
        let end = async {
            loop {
                if let Message::Close(frame) = talker.next().await.unwrap().unwrap() {
                    break frame.unwrap();
                }
            }
        };
        let end = timeout(HANG, end).await.expect("a client that says too much is still there");
        assert_eq!(end.code, code);
        assert!(end.reason.contains(reason), "{end}");
        // Its answer is taken: the connection is not reset.
        while let Some(rest) = timeout(HANG, talker.next()).await.expect("it is not hung up") {
            rest.unwrap();
        }
    }
    // So many ids as there may be have a place.
    let ids: Vec<u64> = (1_000_000..1_010_000).collect();
    let wish = serde_json::json!({"snapshots": {"object_ids": ids}}).to_string();
    other.send(Message::text(wish)).await.unwrap();
    rig.publish(objects(1));
    while !next_snapshot(&mut other).await.objects.is_empty() {
        rig.publish(objects(1));
    }
    let mut other = open(&rig, "").await;
    assert!(next_snapshot(&mut other).await.sequence > 0);
    rig.stop().await;
}

#[tokio::test]
async fn a_client_that_does_not_read_is_cut_off() {
    let limits = ApiLimits { send_timeout: Duration::from_millis(200), ..ApiLimits::default() };
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

#[tokio::test]
async fn a_page_in_the_middle_of_a_message_hears_that_the_server_goes_down() {
    let rig = Rig::start().await;
    let mut page = open(&rig, "").await;
    // More than lies between a server and a page that does not read.
    for _ in 0..100 {
        rig.publish(objects(500));
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    rig.cancel.cancel();
    tokio::time::sleep(Duration::from_millis(50)).await;
    let goodbye = async {
        loop {
            match page.next().await.expect("a close frame").expect("whole frames") {
                Message::Text(text) => assert!(serde_json::from_str::<Value>(&text).is_ok()),
                Message::Close(Some(frame)) => return frame.code,
                other => panic!("{other:?}"),
            }
        }
    };
    let code = timeout(HANG, goodbye).await.expect("it says no goodbye");
    assert_eq!(code, tungstenite::protocol::frame::coding::CloseCode::Away);
    rig.stop().await;
}
