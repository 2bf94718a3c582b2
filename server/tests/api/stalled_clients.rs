//! Clients that stop reading are disconnected, whatever they subscribed to; other clients are not affected.

use std::{sync::Arc, time::Duration};

use axum::{body::Body, http::Request};
use http_body_util::BodyExt;
use hyper_util::{client::legacy, rt::TokioExecutor};
use roundel_core::{
    camera::PixelPoint,
    ellipse::Ellipse,
    id::{CameraId, TrackNumber},
    marker::Ring,
    pose::Detection,
    world::FrameObservations,
};
use roundel_proto::v1;
use roundel_server::{api::ApiLimits, model::hub::EventKind};
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
    time::{sleep, timeout},
};

use super::{
    grpc,
    rig::{self, Rig, TIMEOUT, objects},
};

async fn rig() -> Rig {
    rig_with_send_timeout(Duration::from_millis(400)).await
}

async fn rig_with_send_timeout(send_timeout: Duration) -> Rig {
    let limits = ApiLimits { send_timeout, ..ApiLimits::default() };
    Rig::start_with(rig::hub("run"), limits, "127.0.0.1:0").await
}

/// Runs `happen` until one client is disconnected, while another subscriber receives every snapshot.
async fn until_one_is_cut_off(rig: &Rig, happen: impl Fn()) {
    let mut reader = grpc::connect(rig).await;
    let all = v1::SubscribeSnapshotsRequest::default();
    let mut reader = reader.subscribe_snapshots(all).await.unwrap().into_inner();
    let cut = async {
        loop {
            happen();
            rig.publish(objects(1));
            grpc::next(&mut reader).await;
            sleep(Duration::from_millis(5)).await;
            let metrics = rig.get("/metrics").await;
            if metrics.text().contains("\nroundel_subscribers_cut_total 1\n") {
                break;
            }
        }
    };
    timeout(TIMEOUT, cut).await.expect("the stalled client is still connected");
    rig.publish(objects(1));
    grpc::next(&mut reader).await;
}

#[tokio::test]
async fn a_client_that_stops_reading_snapshots_is_cut_off_and_others_are_not() {
    let rig = rig().await;
    let all = v1::SubscribeSnapshotsRequest::default;
    let mut stalled = grpc::connect(&rig).await;
    let mut stalled = stalled.subscribe_snapshots(all()).await.unwrap().into_inner();
    // A subscriber without due snapshots is idle, not stalled.
    let mut idle = grpc::connect(&rig).await;
    let rare = v1::SubscribeSnapshotsRequest { max_rate_hz: Some(1e-3), ..all() };
    let mut idle = idle.subscribe_snapshots(rare).await.unwrap().into_inner();
    let mut reader = grpc::connect(&rig).await;
    let mut reader = reader.subscribe_snapshots(all()).await.unwrap().into_inner();
    rig.publish(objects(300));
    grpc::next(&mut idle).await;
    let cut = async {
        loop {
            rig.publish(objects(300));
            grpc::next(&mut reader).await;
            sleep(Duration::from_millis(5)).await;
            let metrics = rig.get("/metrics").await;
            if metrics.text().contains("\nroundel_subscribers_cut_total 1\n") {
                break;
            }
        }
    };
    timeout(TIMEOUT, cut).await.expect("the stalled subscriber is still connected");
    // Data in flight still arrives, then its connection ends.
    let end = async { while let Ok(Some(_)) = stalled.message().await {} };
    timeout(TIMEOUT, end).await.expect("the stalled stream does not end");
    let gone =
        async { while !rig.get("/metrics").await.text().contains("\nroundel_subscribers 2\n") {} };
    timeout(TIMEOUT, gone).await.expect("expected two remaining subscribers");
    rig.publish(objects(1));
    grpc::next(&mut reader).await;
    let silent = timeout(Duration::from_millis(50), idle.message()).await;
    assert!(silent.is_err(), "the idle subscriber received {silent:?}");
    rig.stop().await;
}

#[tokio::test]
async fn a_client_that_stops_reading_observations_is_cut_off() {
    let rig = rig().await;
    let request = v1::SubscribeObservationsRequest::default();
    let mut client = grpc::connect(&rig).await;
    let mut stalled = client.subscribe_observations(request).await.unwrap().into_inner();
    let rim = |semi_px| Ellipse {
        center: PixelPoint { u: 30.0, v: 20.0 },
        semi_major_px: semi_px,
        semi_minor_px: semi_px,
        angle_rad: 0.0,
    };
    let time = rig.clock.now();
    let detection = Detection {
        track: TrackNumber(1),
        ring: Ring::of_rims(rim(10.0), rim(6.0)),
        capture_time: time,
        pose: None,
    };
    until_one_is_cut_off(&rig, || {
        rig.hub.publish_observations(Arc::new(FrameObservations {
            camera: CameraId(0),
            frame: 1,
            capture_time: time,
            received_time: time,
            calibration_version: 1,
            detections: vec![detection.clone(); 100],
        }));
    })
    .await;
    let end = async { while let Ok(Some(_)) = stalled.message().await {} };
    timeout(TIMEOUT, end).await.expect("the stalled stream does not end");
    rig.stop().await;
}

#[tokio::test]
async fn a_client_that_stops_reading_events_is_cut_off() {
    let rig = rig().await;
    let request = v1::SubscribeEventsRequest { backlog: 0 };
    let mut client = grpc::connect(&rig).await;
    let mut stalled = client.subscribe_events(request).await.unwrap().into_inner();
    until_one_is_cut_off(&rig, || {
        let message = "no such file; ".repeat(500);
        let kind = EventKind::CameraFailed;
        rig.hub.publish_camera_event(rig.clock.now(), kind, CameraId(0), message);
    })
    .await;
    let end = async { while let Ok(Some(_)) = stalled.message().await {} };
    timeout(TIMEOUT, end).await.expect("the stalled stream does not end");
    rig.stop().await;
}

/// Objects in a snapshot that is larger than the kernel's buffers on both ends of a connection.
const MANY: u64 = 8000;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_that_stops_reading_a_download_is_cut_off() {
    let rig = rig().await;
    rig.publish(objects(MANY));
    let mut stalled = TcpStream::connect(&rig.address).await.unwrap();
    stalled.write_all(b"GET /api/v1/snapshot HTTP/1.1\r\nhost: localhost\r\n\r\n").await.unwrap();
    let mut begin = [0; 12];
    timeout(TIMEOUT, stalled.read_exact(&mut begin)).await.unwrap().unwrap();
    assert_eq!(&begin, b"HTTP/1.1 200");
    until_one_is_cut_off(&rig, || ()).await;
    // Data in flight still arrives, then the connection ends early.
    let mut rest = Vec::new();
    let _ = timeout(TIMEOUT, stalled.read_to_end(&mut rest))
        .await
        .expect("the connection is still open");
    assert!(!rest.ends_with(b"}"), "the whole body has arrived: {} bytes", rest.len());
    rig.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_http2_client_that_stops_reading_one_stream_is_cut_off() {
    let rig = rig().await;
    rig.publish(objects(MANY));
    let client = legacy::Client::builder(TokioExecutor::new())
        .http2_only(true)
        .http2_initial_stream_window_size(100_000)
        .http2_initial_connection_window_size(10_000_000)
        .build_http::<Body>();
    let request = || {
        let path = format!("{}/api/v1/snapshot", rig.url());
        Request::get(path).body(Body::empty()).unwrap()
    };
    let stalled = timeout(TIMEOUT, client.request(request())).await.unwrap().unwrap();
    assert_eq!(stalled.status(), 200);
    until_one_is_cut_off(&rig, || ()).await;
    let rest =
        timeout(TIMEOUT, stalled.into_body().collect()).await.expect("the stream is still open");
    assert!(rest.is_err(), "the whole body has arrived");
    rig.stop().await;
}

/// Send timeout of the slow readers, which pause for a quarter of it between two reads. The rest is margin for a busy
/// machine.
const SLOW_LIMIT: Duration = Duration::from_secs(1);

/// Sends `ask` and reads slowly, for three times [`SLOW_LIMIT`], until `is_all` accepts the bytes received.
async fn read_slowly(rig: &Rig, ask: &str, is_all: impl Fn(&[u8]) -> bool) -> Vec<u8> {
    let mut slow = TcpStream::connect(&rig.address).await.unwrap();
    slow.write_all(ask.as_bytes()).await.unwrap();
    let (mut received, mut buffer) = (Vec::new(), vec![0; 256 * 1024]);
    let mut round = 0;
    while !is_all(&received) {
        let count = timeout(TIMEOUT, slow.read(&mut buffer)).await.unwrap().unwrap();
        assert!(count > 0, "the connection ended after {} bytes", received.len());
        received.extend(&buffer[..count]);
        round += 1;
        if round <= 12 {
            sleep(SLOW_LIMIT / 4).await;
        }
    }
    assert!(round > 8, "received in only {round} reads");
    received
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_slow_download_completes() {
    let rig = rig_with_send_timeout(SLOW_LIMIT).await;
    rig.publish(objects(MANY));
    let ask = "GET /api/v1/snapshot HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n";
    let body = |received: &[u8]| Some(received.windows(4).position(|it| it == b"\r\n\r\n")? + 4);
    let snapshot =
        |received: &[u8]| serde_json::from_slice::<v1::Snapshot>(&received[body(received)?..]).ok();
    let received =
        read_slowly(&rig, ask, |received| received.ends_with(b"}") && snapshot(received).is_some())
            .await;
    assert_eq!(snapshot(&received).unwrap().objects.len() as u64, MANY);
    rig.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_websocket_that_reads_a_long_message_slowly_receives_all_of_it() {
    let rig = rig_with_send_timeout(SLOW_LIMIT).await;
    rig.publish(objects(MANY));
    let ask = "GET /api/v1/stream HTTP/1.1\r\nhost: localhost\r\nconnection: upgrade\r\nupgrade: websocket\r\n\
        sec-websocket-version: 13\r\nsec-websocket-key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n";
    // Objects end with the same bytes as the message, so only parsing shows whether it is complete.
    let message = |received: &[u8]| -> Option<serde_json::Value> {
        let begin = received.windows(2).position(|it| it == b"{\"")?;
        serde_json::from_slice(&received[begin..]).ok()
    };
    let received =
        read_slowly(&rig, ask, |received| received.ends_with(b"}}") && message(received).is_some())
            .await;
    let message = message(&received).unwrap();
    assert_eq!(message["snapshot"]["objects"].as_array().unwrap().len() as u64, MANY);
    rig.stop().await;
}
