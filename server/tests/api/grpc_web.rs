//! gRPC-Web as browsers use it, malformed gRPC requests, and abandoned streams.

use axum::{
    body::Body,
    http::{Request, StatusCode, Version},
};
use http_body_util::BodyExt;
use hyper::body::Incoming;
use hyper_util::{client::legacy, rt::TokioExecutor};
use prost::Message;
use roundel_proto::v1;
use tokio::time::timeout;

use super::{
    grpc,
    rig::{Rig, TIMEOUT, objects},
    websocket,
};

/// A message with gRPC's length prefix.
fn framed(message: &impl Message) -> Vec<u8> {
    let bytes = message.encode_to_vec();
    [&[0], (bytes.len() as u32).to_be_bytes().as_slice(), &bytes].concat()
}

#[tokio::test]
async fn browsers_call_over_http1() {
    let rig = Rig::start().await;
    rig.publish(objects(2));
    let call = |call: &str, body: Vec<u8>| {
        Request::post(format!("{}/roundel.v1.Roundel/{call}", rig.url()))
            .header("content-type", "application/grpc-web+proto")
            .header("x-grpc-web", "1")
            .body(Body::from(body))
            .unwrap()
    };
    let answer = rig.request(call("GetSnapshot", framed(&v1::GetSnapshotRequest::default()))).await;
    assert_eq!(answer.header("content-type"), "application/grpc-web+proto");
    let length = u32::from_be_bytes(answer.body[1..5].try_into().unwrap()) as usize;
    let snapshot = v1::Snapshot::decode(&answer.body[5..5 + length]).unwrap();
    assert_eq!(snapshot.objects.len(), 2);
    // The trailers are a frame in the body with the highest bit set.
    let trailers = &answer.body[5 + length..];
    assert_eq!(trailers[0], 0x80);
    assert!(String::from_utf8_lossy(&trailers[5..]).contains("grpc-status:0"), "{trailers:?}");

    let wrong = v1::SubscribeSnapshotsRequest { horizon_ms: Some(-1.0), ..Default::default() };
    let answer = rig.request(call("SubscribeSnapshots", framed(&wrong))).await;
    assert_eq!(answer.header("grpc-status"), "3", "{:?}", answer.headers);
    assert!(answer.header("grpc-message").contains("horizon_ms"), "{:?}", answer.headers);
    rig.stop().await;
}

#[tokio::test]
async fn rejects_malformed_request_bodies() {
    let rig = Rig::start().await;
    let well = framed(&v1::SubscribeSnapshotsRequest::default());
    let long = [&[0], 9_u32.to_be_bytes().as_slice()].concat();
    for (body, code) in [
        (vec![], "13"),
        (vec![0, 0], "13"),
        (long, "13"),
        (vec![0, 0, 0, 0, 2, 0xff, 0xff], "13"),
        ([&[1], &well[1..]].concat(), "13"),
        ([&[0], 1_000_000_u32.to_be_bytes().as_slice(), &[0; 1_000_000]].concat(), "11"),
    ] {
        let request = Request::post(format!("{}/roundel.v1.Roundel/SubscribeSnapshots", rig.url()))
            .header("content-type", "application/grpc")
            .body(Body::from(body.clone()))
            .unwrap();
        let answer = rig.request(request).await;
        assert_eq!(answer.header("grpc-status"), code, "{:?} {:?}", body.get(..9), answer.headers);
    }
    rig.stop().await;
}

/// A response body that is still being received.
struct StreamingBody {
    body: Incoming,
    bytes: Vec<u8>,
}

impl StreamingBody {
    async fn until(&mut self, count: usize) {
        while self.bytes.len() < count {
            let frame = timeout(TIMEOUT, self.body.frame()).await.expect("no data arrives");
            let data = frame.expect("the body has ended").unwrap().into_data().unwrap();
            self.bytes.extend(&data);
        }
    }

    /// The next gRPC-Web frame: whether it contains the trailers, and its content.
    async fn next(&mut self) -> (bool, Vec<u8>) {
        self.until(5).await;
        let length = u32::from_be_bytes(self.bytes[1..5].try_into().unwrap()) as usize;
        self.until(5 + length).await;
        let rest = self.bytes.split_off(5 + length);
        let frame = std::mem::replace(&mut self.bytes, rest);
        (frame[0] & 0x80 != 0, frame[5..].to_vec())
    }

    async fn next_snapshot(&mut self) -> v1::Snapshot {
        let (is_end, message) = self.next().await;
        assert!(!is_end, "{}", String::from_utf8_lossy(&message));
        v1::Snapshot::decode(message.as_slice()).unwrap()
    }
}

/// Subscribes to all snapshots over HTTP/1.1, as a browser does.
async fn subscribe_as_browser(rig: &Rig) -> StreamingBody {
    let request = Request::post(format!("{}/roundel.v1.Roundel/SubscribeSnapshots", rig.url()))
        .header("content-type", "application/grpc-web+proto")
        .header("x-grpc-web", "1")
        .body(Body::from(framed(&v1::SubscribeSnapshotsRequest::default())))
        .unwrap();
    let client = legacy::Client::builder(TokioExecutor::new()).build_http();
    let answer = timeout(TIMEOUT, client.request(request)).await.unwrap().unwrap();
    assert_eq!((answer.status(), answer.version()), (StatusCode::OK, Version::HTTP_11));
    assert_eq!(answer.headers()["content-type"], "application/grpc-web+proto");
    StreamingBody { body: answer.into_body(), bytes: Vec::new() }
}

#[tokio::test]
async fn browsers_receive_each_message_as_soon_as_it_is_published() {
    let rig = Rig::start().await;
    rig.publish(objects(1));
    let mut stream = subscribe_as_browser(&rig).await;
    // Publishes the next snapshot only after the previous one has arrived, so that a buffered response would hang.
    for sequence in 1..=5 {
        let snapshot = stream.next_snapshot().await;
        assert_eq!((snapshot.sequence, snapshot.objects.len()), (sequence, sequence as usize));
        rig.publish(objects(sequence + 1));
    }
    rig.cancel.cancel();
    let end = async {
        loop {
            if let (true, trailers) = stream.next().await {
                return String::from_utf8(trailers).unwrap();
            }
        }
    };
    let trailers = timeout(TIMEOUT, end).await.expect("the stream does not end");
    assert!(trailers.contains("grpc-status:14"), "{trailers:?}");
    assert!(trailers.contains("shutting%20down"), "{trailers:?}");
    rig.stop().await;
}

#[tokio::test]
async fn an_abandoned_stream_is_unsubscribed() {
    let rig = Rig::start().await;
    rig.publish(objects(1));
    let subscribers = async |count: usize| {
        let line = format!("\nroundel_subscribers {count}\n");
        let reached = async { while !rig.get("/metrics").await.text().contains(&line) {} };
        timeout(TIMEOUT, reached).await.unwrap_or_else(|_| panic!("expected {count} subscribers"));
    };
    let mut client = grpc::connect(&rig).await;
    let all = v1::SubscribeSnapshotsRequest::default;
    // Each stream is idle after its first snapshot: the server must notice the disconnect without writing.
    let mut one = client.subscribe_snapshots(all()).await.unwrap().into_inner();
    let mut other = client.subscribe_snapshots(all()).await.unwrap().into_inner();
    grpc::next(&mut one).await;
    grpc::next(&mut other).await;
    let mut page = subscribe_as_browser(&rig).await;
    page.next_snapshot().await;
    let mut socket = websocket::open(&rig, "").await;
    websocket::next_snapshot(&mut socket).await;
    subscribers(4).await;
    // Drops a stream on a shared connection, then a browser's connection, then a WebSocket without a close frame.
    drop(one);
    subscribers(3).await;
    drop(page);
    subscribers(2).await;
    drop(socket);
    subscribers(1).await;
    rig.publish(objects(2));
    assert_eq!(grpc::next(&mut other).await.objects.len(), 2);
    drop((client, other));
    subscribers(0).await;
    rig.stop().await;
}
