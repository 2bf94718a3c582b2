//! `/api/v1/stream`, with a third-party WebSocket client.

use std::time::Duration;

use futures::{SinkExt, StreamExt};
use prost::Message as _;
use roundel_core::id::{CameraId, ObjectId};
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

use super::rig::{self, Rig, TIMEOUT, objects};

pub type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;

pub async fn open(rig: &Rig, query: &str) -> Socket {
    let url = format!("ws://{}/api/v1/stream{query}", rig.address);
    connect_async(url).await.unwrap().0
}

/// Opens a socket that uses protobuf.
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
        let message = timeout(TIMEOUT, socket.next()).await.expect("no message arrives");
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
async fn sends_only_snapshots_by_default() {
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
async fn one_socket_carries_cameras_and_events() {
    let rig = Rig::start().await;
    for id in 1..=60 {
        let (kind, id) = (EventKind::ObjectAppeared, Some(ObjectId(id)));
        rig.hub.publish_object_event(rig.clock.now(), kind, id, String::new());
    }
    rig.hub.update_camera(CameraId(1), |camera| camera.status = CameraStatus::Running);
    let mut socket = open(&rig, "?include=cameras,events").await;
    // The backlog of fifty events comes first, oldest first.
    for sequence in 11..=60 {
        assert_eq!(next(&mut socket).await["event"]["sequence"], sequence);
    }
    let (kind, id) = (EventKind::ObjectLost, Some(ObjectId(7)));
    rig.hub.publish_object_event(rig.clock.now(), kind, id, "object 7 was given up".into());
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
async fn rejects_a_wrong_query_before_the_upgrade() {
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
async fn a_slow_client_skips_to_the_newest() {
    // On a busy machine the test itself may be slower than the send timeout.
    let limits = ApiLimits { send_timeout: TIMEOUT * 10, ..ApiLimits::default() };
    let rig = Rig::start_with(rig::hub("run"), limits, "127.0.0.1:0").await;
    let mut slow = open(&rig, "").await;
    let mut quick = open(&rig, "").await;
    // More than the kernel buffers on both ends.
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
async fn a_message_changes_the_subscriptions_of_an_open_socket() {
    let rig = Rig::start().await;
    rig.publish(objects(3));
    let (kind, id) = (EventKind::ObjectAppeared, Some(ObjectId(1)));
    rig.hub.publish_object_event(rig.clock.now(), kind, id, "one".into());
    let mut socket = open(&rig, "?ids=1").await;
    assert_eq!(next_snapshot(&mut socket).await.objects.len(), 1);
    let request =
        r#"{"snapshots": {"object_ids": [2, 3], "omit_covariance": true}, "events": true}"#;
    socket.send(Message::text(request)).await.unwrap();
    assert_eq!(next(&mut socket).await["event"]["message"], "one");
    let snapshot = next_snapshot(&mut socket).await;
    let ids: Vec<u64> = snapshot.objects.iter().map(|object| object.object_id).collect();
    assert_eq!((ids.as_slice(), snapshot.missed), ([2, 3].as_slice(), 0));
    assert!(snapshot.objects[0].covariance.is_empty());
    // Ends the snapshots, and does not repeat the event.
    socket.send(Message::text(r#"{"cameras": true, "events": true}"#)).await.unwrap();
    assert!(next(&mut socket).await["cameras"].is_array());
    rig.publish(objects(3));
    assert!(next(&mut socket).await["cameras"].is_array());
    rig.stop().await;
}

#[tokio::test]
async fn a_wrong_request_is_rejected_and_changes_nothing() {
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
async fn a_subprotocol_selects_protobuf_with_the_same_content() {
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

    let request = v1::StreamRequest { events: true, ..Default::default() };
    binary.send(Message::binary(request.encode_to_vec())).await.unwrap();
    let (kind, id) = (EventKind::ObjectLost, Some(ObjectId(7)));
    rig.hub.publish_object_event(rig.clock.now(), kind, id, "gone".into());
    let event = async {
        loop {
            if let Alternative::Event(event) = next_binary(&mut binary).await {
                return event;
            }
        }
    };
    assert_eq!(timeout(TIMEOUT, event).await.unwrap().message, "gone");
    binary.send(Message::binary(vec![0xff; 9])).await.unwrap();
    let Alternative::Error(error) = next_binary(&mut binary).await else { panic!("no error") };
    assert_eq!(error.code, "invalid_argument");
    rig.stop().await;
}

pub async fn next_binary(socket: &mut Socket) -> Alternative {
    loop {
        let message = timeout(TIMEOUT, socket.next()).await.expect("no message arrives");
        if let Message::Binary(bytes) = message.unwrap().unwrap() {
            return v1::StreamMessage::decode(bytes.as_ref()).unwrap().message.unwrap();
        }
    }
}

#[tokio::test]
async fn a_client_that_sends_an_oversized_or_invalid_message_is_closed_with_a_reason() {
    let rig = Rig::start().await;
    let mut other = open(&rig, "").await;
    for (message, code, reason) in [
        (Message::binary(vec![0; 3_000_000]), CloseCode::Size, "at most 262144 bytes"),
        // A text message that is not UTF-8.
        (
            Message::Frame(Frame::message(vec![0xff], OpCode::Data(Data::Text), true)),
            CloseCode::Invalid,
            "UTF-8",
        ),
    ] {
        let mut sender = open(&rig, "").await;
        sender.send(message).await.unwrap();
        let end = async {
            loop {
                if let Message::Close(frame) = sender.next().await.unwrap().unwrap() {
                    break frame.unwrap();
                }
            }
        };
        let end = timeout(TIMEOUT, end).await.expect("the server does not close the socket");
        assert_eq!(end.code, code);
        assert!(end.reason.contains(reason), "{end}");
        // The server drains what the client has sent, so that the connection is not reset.
        while let Some(rest) =
            timeout(TIMEOUT, sender.next()).await.expect("the connection is still open")
        {
            rest.unwrap();
        }
    }
    // A request with the largest number of IDs is accepted.
    let ids: Vec<u64> = (1_000_000..1_010_000).collect();
    let request = serde_json::json!({"snapshots": {"object_ids": ids}}).to_string();
    other.send(Message::text(request)).await.unwrap();
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
    let stalled = open(&rig, "").await;
    let gone = async {
        loop {
            rig.publish(objects(300));
            tokio::time::sleep(Duration::from_millis(5)).await;
            if rig.get("/metrics").await.text().contains("\nroundel_subscribers 0\n") {
                break;
            }
        }
    };
    timeout(TIMEOUT, gone).await.expect("the stalled client is still a subscriber");
    drop(stalled);
    rig.stop().await;
}

#[tokio::test]
async fn a_socket_in_the_middle_of_a_message_gets_a_close_frame_on_shutdown() {
    let rig = Rig::start().await;
    let mut socket = open(&rig, "").await;
    // More than the connection buffers while the client does not read.
    for _ in 0..100 {
        rig.publish(objects(500));
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    rig.cancel.cancel();
    tokio::time::sleep(Duration::from_millis(50)).await;
    let closed = async {
        loop {
            match socket.next().await.expect("a close frame").expect("whole frames") {
                Message::Text(text) => assert!(serde_json::from_str::<Value>(&text).is_ok()),
                Message::Close(Some(frame)) => return frame.code,
                other => panic!("{other:?}"),
            }
        }
    };
    let code = timeout(TIMEOUT, closed).await.expect("no close frame arrives");
    assert_eq!(code, tungstenite::protocol::frame::coding::CloseCode::Away);
    rig.stop().await;
}
