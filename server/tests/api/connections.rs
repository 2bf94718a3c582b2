//! Limits on connections and subscriptions, and shutdown with connected clients.

use std::time::Duration;

use futures::StreamExt;
use roundel_proto::v1;
use roundel_server::api::ApiLimits;
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
    time::timeout,
};
use tokio_tungstenite::tungstenite::{Message, protocol::frame::coding::CloseCode};
use tonic::Code;

use super::{
    grpc,
    rig::{self, Rig, TIMEOUT, objects},
    websocket,
};

#[tokio::test]
async fn shutdown_notifies_every_client() {
    let rig = Rig::start().await;
    rig.publish(objects(1));
    let mut client = grpc::connect(&rig).await;
    let request = v1::SubscribeSnapshotsRequest::default();
    let mut snapshots = client.subscribe_snapshots(request).await.unwrap().into_inner();
    let events = v1::SubscribeEventsRequest::default();
    let mut events = client.subscribe_events(events).await.unwrap().into_inner();
    let observations = v1::SubscribeObservationsRequest::default();
    let mut observations = client.subscribe_observations(observations).await.unwrap().into_inner();
    let mut socket = websocket::open(&rig, "?include=events").await;
    grpc::next(&mut snapshots).await;

    rig.cancel.cancel();
    let ends = [
        timeout(TIMEOUT, snapshots.message()).await.unwrap().unwrap_err(),
        timeout(TIMEOUT, events.message()).await.unwrap().unwrap_err(),
        timeout(TIMEOUT, observations.message()).await.unwrap().unwrap_err(),
    ];
    for end in ends {
        assert_eq!((end.code(), end.message()), (Code::Unavailable, "server is shutting down"));
    }
    let Message::Close(Some(frame)) =
        timeout(TIMEOUT, socket.next()).await.unwrap().unwrap().unwrap()
    else {
        panic!("expected a close frame")
    };
    assert_eq!((frame.code, frame.reason.as_str()), (CloseCode::Away, "server is shutting down"));
    rig.stop().await;
}

#[tokio::test]
async fn shutdown_does_not_wait_for_stalled_clients() {
    let limits = ApiLimits { grace: Duration::from_millis(300), ..ApiLimits::default() };
    let rig = Rig::start_with(rig::hub("run"), limits, "127.0.0.1:0").await;
    // An idle connection, an incomplete request, and streams that are never read.
    let silent = TcpStream::connect(&rig.address).await.unwrap();
    let mut slow = TcpStream::connect(&rig.address).await.unwrap();
    slow.write_all(b"GET /api/v1/info HTTP/1.1\r\nHost:").await.unwrap();
    let stuck = websocket::open(&rig, "").await;
    let mut client = grpc::connect(&rig).await;
    let request = v1::SubscribeSnapshotsRequest::default();
    let unread = client.subscribe_snapshots(request).await.unwrap().into_inner();
    for _ in 0..100 {
        rig.publish(objects(200));
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    rig.stop().await;
    drop((silent, slow, stuck, unread));
}

#[tokio::test]
async fn rejects_subscriptions_beyond_the_limit_with_a_reason() {
    let limits = ApiLimits { max_clients: 2, ..ApiLimits::default() };
    let rig = Rig::start_with(rig::hub("run"), limits, "127.0.0.1:0").await;
    rig.publish(objects(1));
    let mut client = grpc::connect(&rig).await;
    let mut open = Vec::new();
    for _ in 0..8 {
        let request = v1::SubscribeSnapshotsRequest::default();
        let mut snapshots = client.subscribe_snapshots(request).await.unwrap().into_inner();
        assert_eq!(grpc::next(&mut snapshots).await.sequence, 1);
        open.push(snapshots);
    }
    let subscribe = v1::SubscribeSnapshotsRequest::default;
    let status = client.subscribe_snapshots(subscribe()).await.unwrap_err();
    assert_eq!(status.code(), Code::ResourceExhausted);
    assert!(
        status.message().contains("8, which is 4 for each of [limits] max_clients"),
        "{status}"
    );
    open.pop();
    let free = async { while client.subscribe_snapshots(subscribe()).await.is_err() {} };
    timeout(TIMEOUT, free).await.expect("the released slot is not reusable");
    rig.stop().await;
}

#[tokio::test]
async fn rejects_connections_beyond_the_limit_with_a_reason() {
    let limits = ApiLimits { max_clients: 2, ..ApiLimits::default() };
    let rig = Rig::start_with(rig::hub("run"), limits, "127.0.0.1:0").await;
    rig.publish(objects(1));
    let mut client = grpc::connect(&rig).await;
    // An idle connection would give up its slot.
    let snapshots = v1::SubscribeSnapshotsRequest::default();
    let _snapshots = client.subscribe_snapshots(snapshots).await.unwrap();
    // A WebSocket keeps its slot after the upgrade.
    let socket = websocket::open(&rig, "").await;

    let refused = rig.get("/api/v1/info").await;
    assert_eq!(refused.status, 503);
    let (code, message) = refused.error();
    assert_eq!(code, "resource_exhausted");
    assert!(message.contains("all 2 connections") && message.contains("limits.max_clients"));
    let mut late = grpc::connect(&rig).await;
    let status = late.get_server_info(v1::GetServerInfoRequest {}).await.unwrap_err();
    assert_eq!(status.code(), Code::ResourceExhausted, "{status}");
    assert_eq!(status.message(), message);
    // Existing connections are not disturbed, and a released slot is reusable.
    client.get_server_info(v1::GetServerInfoRequest {}).await.unwrap();
    drop(socket);
    let free = async { while rig.get("/api/v1/info").await.status != 200 {} };
    timeout(TIMEOUT, free).await.expect("the released slot is not reusable");
    rig.stop().await;
}

#[tokio::test]
async fn rejects_bytes_of_another_protocol() {
    let rig = Rig::start().await;
    for bytes in [
        &b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03"[..],
        b"\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0",
    ] {
        let mut stream = TcpStream::connect(&rig.address).await.unwrap();
        stream.write_all(bytes).await.unwrap();
        let mut answer = Vec::new();
        // Closed, with an HTTP error or without a response.
        timeout(TIMEOUT, stream.read_to_end(&mut answer)).await.expect("still open").ok();
        assert!(answer.is_empty() || answer.starts_with(b"HTTP/1.1 400"), "{answer:?}");
    }
    assert_eq!(rig.get("/healthz").await.status, 200);
    rig.stop().await;
}
