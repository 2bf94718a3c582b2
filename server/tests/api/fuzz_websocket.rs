//! Corrupted requests on `/api/v1/stream`: each is rejected with an error or takes effect, and the socket stays open.

use std::time::Duration;

use futures::{SinkExt, StreamExt};
use prost::Message as _;
use roundel_proto::v1::{self, stream_message::Message as Alternative};
use roundel_server::api::ApiLimits;
use tokio::time::timeout;
use tokio_tungstenite::{
    connect_async,
    tungstenite::{Message, client::IntoClientRequest},
};

use super::{
    fuzz::{Bystander, Random},
    rig::TIMEOUT,
    websocket::Socket,
};

/// Rounds of each test.
const ROUNDS: usize = 1500;

fn request() -> v1::StreamRequest {
    let corner = |x| Some(v1::Vector3 { x, y: x, z: 1.5 });
    v1::StreamRequest {
        snapshots: Some(v1::SubscribeSnapshotsRequest {
            object_ids: vec![1, 2, u64::MAX],
            region: Some(v1::Box { min: corner(-1.0), max: corner(1.0) }),
            max_rate_hz: Some(30.0),
            horizon_ms: Some(10.0),
            omit_covariance: true,
            roundels: vec!["robot".into()],
            names: vec!["cart \"one\"".into(), "ü".into()],
            codes: vec![v1::Code { bits: 8, number: 2 }],
        }),
        cameras: true,
        events: true,
        observations: Some(v1::SubscribeObservationsRequest { cameras: vec!["north".into()] }),
    }
}

/// Opens a socket with this subprotocol.
async fn open(bystander: &Bystander, protocol: &str) -> Socket {
    let url = format!("ws://{}/api/v1/stream", bystander.rig.address);
    let mut request = url.into_client_request().unwrap();
    request.headers_mut().insert("sec-websocket-protocol", protocol.parse().unwrap());
    connect_async(request).await.unwrap().0
}

/// The next message that `wanted` accepts.
async fn until<T>(socket: &mut Socket, wanted: impl Fn(Message) -> Option<T>) -> T {
    let found = async {
        loop {
            let message = socket.next().await.expect("the socket has ended").unwrap();
            assert!(!message.is_close(), "{message:?}");
            if let Some(found) = wanted(message) {
                return found;
            }
        }
    };
    timeout(TIMEOUT, found).await.expect("no response arrives")
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn corrupted_protobuf_is_rejected_or_applied_and_the_socket_stays_open() {
    let mut bystander = Bystander::new(ApiLimits::default()).await;
    let mut socket = open(&bystander, "roundel.v1.protobuf").await;
    let mut random = Random(0x5eed);
    let whole = request().encode_to_vec();
    // Ends all subscriptions, so that every following message is a response.
    let nothing = Message::binary(v1::StreamRequest::default().encode_to_vec());
    let (mut rejected, mut applied) = (0, 0);
    for round in 0..ROUNDS {
        let count = random.below(200);
        let corrupted = if round % 3 == 0 { random.bytes(count) } else { random.corrupted(&whole) };
        socket.send(Message::binary(corrupted.clone())).await.unwrap();
        socket.send(nothing.clone()).await.unwrap();
        // An unreadable message, whose error shows that all messages before it were processed.
        socket.send(Message::binary(vec![0xff; 3])).await.unwrap();
        let error = |message: Message| {
            let Message::Binary(bytes) = message else { return None };
            match v1::StreamMessage::decode(bytes.as_ref()).unwrap().message {
                Some(Alternative::Error(error)) => Some(error),
                _ => None,
            }
        };
        let first = until(&mut socket, error).await;
        assert!(["invalid_argument", "not_found"].contains(&first.code.as_str()), "{first:?}");
        assert!(!first.message.is_empty());
        // What prost cannot decode is rejected; what it decodes may still be invalid.
        let is_readable = v1::StreamRequest::decode(corrupted.as_slice()).is_ok();
        let marker = first.message.starts_with("message: ");
        if !is_readable || !marker {
            rejected += 1;
            until(&mut socket, error).await;
        } else {
            applied += 1;
        }
        if round % 100 == 0 {
            bystander.is_served("corrupted requests").await;
        }
    }
    assert!(
        rejected > ROUNDS / 50 && applied > ROUNDS / 50,
        "{rejected} rejected, {applied} applied"
    );
    drop(socket);
    bystander.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn corrupted_json_is_rejected_or_applied_and_the_socket_stays_open() {
    let mut bystander = Bystander::new(ApiLimits::default()).await;
    let mut socket = open(&bystander, "roundel.v1.json").await;
    let mut random = Random(0xfeed);
    let whole = serde_json::to_string(&request()).unwrap();
    let error = |message: Message| {
        let Message::Text(text) = message else { return None };
        let value: serde_json::Value = serde_json::from_str(&text).unwrap();
        value["error"]["message"].as_str().map(str::to_owned)
    };
    for round in 0..ROUNDS {
        let corrupted = String::from_utf8_lossy(&random.corrupted(whole.as_bytes())).into_owned();
        socket.send(Message::text(corrupted)).await.unwrap();
        socket.send(Message::text("{}")).await.unwrap();
        let marker = format!(r#"{{"snapshots": {{"roundels": ["{round}"]}}}}"#);
        socket.send(Message::text(marker)).await.unwrap();
        // The response to the marker comes after the one to the corrupted request, if there is one.
        let own = format!("found \"{round}\"");
        while !until(&mut socket, error).await.contains(&own) {}
        if round % 100 == 0 {
            bystander.is_served("corrupted requests").await;
        }
    }
    // Deep nesting, a long list, and a number out of range.
    let numbers = format!(r#"{{"snapshots": {{"object_ids": [{}1]}}}}"#, "1,".repeat(12_000));
    for wrong in ["[".repeat(60_000), numbers, r#"{"snapshots": {"max_rate_hz": 1e999}}"#.into()] {
        socket.send(Message::text(wrong)).await.unwrap();
        assert!(!until(&mut socket, error).await.is_empty());
    }
    let quiet = timeout(Duration::from_millis(50), until(&mut socket, error)).await;
    assert!(quiet.is_err(), "an unexpected response: {quiet:?}");
    drop(socket);
    bystander.end().await;
}
