//! Clients that do not take what there is for them: they are cut off, whatever they asked for, and nobody else is.

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
use roundel_server::{
    api::ApiLimits,
    model::hub::{CameraStatus, EventKind},
};
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
    time::{sleep, timeout},
};

use crate::{
    grpc,
    rig::{self, HANG, Rig, objects},
};

async fn rig() -> Rig {
    rig_that_waits(Duration::from_millis(400)).await
}

async fn rig_that_waits(send_timeout: Duration) -> Rig {
    let limits = ApiLimits { send_timeout, ..ApiLimits::default() };
    Rig::start_with(rig::hub("run"), limits, "127.0.0.1:0").await
}

/// Has things happen until one client has been cut off; whoever reads beside it is served all the time.
async fn until_one_is_cut(rig: &Rig, happen: impl Fn()) {
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
    timeout(HANG, cut).await.expect("a stuck client is still there");
    rig.publish(objects(1));
    grpc::next(&mut reader).await;
}

#[tokio::test]
async fn who_takes_no_snapshots_is_cut_off_and_nobody_else() {
    let rig = rig().await;
    let all = v1::SubscribeSnapshotsRequest::default;
    let mut stuck = grpc::connect(&rig).await;
    let mut stuck = stuck.subscribe_snapshots(all()).await.unwrap().into_inner();
    // One that has nothing to take, since nothing is due for it, is not stuck.
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
    timeout(HANG, cut).await.expect("a stuck subscriber is still there");
    // What was under way to it comes, and then the end of its connection.
    let end = async { while let Ok(Some(_)) = stuck.message().await {} };
    timeout(HANG, end).await.expect("the stuck one's stream goes on");
    let gone =
        async { while !rig.get("/metrics").await.text().contains("\nroundel_subscribers 2\n") {} };
    timeout(HANG, gone).await.expect("expected two subscribers to be left");
    rig.publish(objects(1));
    grpc::next(&mut reader).await;
    let silent = timeout(Duration::from_millis(50), idle.message()).await;
    assert!(silent.is_err(), "the idle one was given {silent:?}");
    rig.stop().await;
}

#[tokio::test]
async fn who_takes_no_observations_is_cut_off() {
    let rig = rig().await;
    let request = v1::SubscribeObservationsRequest::default();
    let mut client = grpc::connect(&rig).await;
    let mut stuck = client.subscribe_observations(request).await.unwrap().into_inner();
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
    until_one_is_cut(&rig, || {
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
    let end = async { while let Ok(Some(_)) = stuck.message().await {} };
    timeout(HANG, end).await.expect("the stuck one's stream goes on");
    rig.stop().await;
}

#[tokio::test]
async fn who_takes_no_events_is_cut_off() {
    let rig = rig().await;
    let request = v1::SubscribeEventsRequest { backlog: 0 };
    let mut client = grpc::connect(&rig).await;
    let mut stuck = client.subscribe_events(request).await.unwrap().into_inner();
    until_one_is_cut(&rig, || {
        let kind = EventKind::CameraStatusChanged(CameraId(0), CameraStatus::Failed);
        rig.hub.publish_event(rig.clock.now(), kind, "no such file; ".repeat(500));
    })
    .await;
    let end = async { while let Ok(Some(_)) = stuck.message().await {} };
    timeout(HANG, end).await.expect("the stuck one's stream goes on");
    rig.stop().await;
}

/// More than kernels hold for both ends of a connection.
const MANY: u64 = 8000;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_takes_nothing_of_a_download_is_cut_off() {
    let rig = rig().await;
    rig.publish(objects(MANY));
    let mut stuck = TcpStream::connect(&rig.address).await.unwrap();
    stuck.write_all(b"GET /api/v1/snapshot HTTP/1.1\r\nhost: a\r\n\r\n").await.unwrap();
    let mut begin = [0; 12];
    timeout(HANG, stuck.read_exact(&mut begin)).await.unwrap().unwrap();
    assert_eq!(&begin, b"HTTP/1.1 200");
    until_one_is_cut(&rig, || ()).await;
    // What was under way comes, and then the end, early.
    let mut rest = Vec::new();
    let _ = timeout(HANG, stuck.read_to_end(&mut rest)).await.expect("it is still open");
    assert!(!rest.ends_with(b"}"), "all of it has come: {} bytes", rest.len());
    rig.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_takes_nothing_of_a_stream_of_http2_is_cut_off_though_it_reads_the_socket() {
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
    let stuck = timeout(HANG, client.request(request())).await.unwrap().unwrap();
    assert_eq!(stuck.status(), 200);
    until_one_is_cut(&rig, || ()).await;
    let rest = timeout(HANG, stuck.into_body().collect()).await.expect("it is still open");
    assert!(rest.is_err(), "all of it has come");
    rig.stop().await;
}

/// How long the slow ones may take nothing. A quarter of it lies between two reads, and a busy machine may make more of
/// that.
const SLOW_LIMIT: Duration = Duration::from_secs(1);

/// Asks like this, and reads for three times as long as it would take to be cut off, until what has come `is_all`.
async fn read_slowly(rig: &Rig, ask: &str, is_all: impl Fn(&[u8]) -> bool) -> Vec<u8> {
    let mut slow = TcpStream::connect(&rig.address).await.unwrap();
    slow.write_all(ask.as_bytes()).await.unwrap();
    let (mut come, mut buffer) = (Vec::new(), vec![0; 256 * 1024]);
    let mut round = 0;
    while !is_all(&come) {
        let count = timeout(HANG, slow.read(&mut buffer)).await.unwrap().unwrap();
        assert!(count > 0, "the end after {} bytes", come.len());
        come.extend(&buffer[..count]);
        round += 1;
        if round <= 12 {
            sleep(SLOW_LIMIT / 4).await;
        }
    }
    assert!(round > 8, "it came in {round} reads");
    come
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_takes_a_download_slowly_gets_all_of_it() {
    let rig = rig_that_waits(SLOW_LIMIT).await;
    rig.publish(objects(MANY));
    let ask = "GET /api/v1/snapshot HTTP/1.1\r\nhost: a\r\nconnection: close\r\n\r\n";
    let body = |come: &[u8]| Some(come.windows(4).position(|it| it == b"\r\n\r\n")? + 4);
    let snapshot = |come: &[u8]| serde_json::from_slice::<v1::Snapshot>(&come[body(come)?..]).ok();
    let come =
        read_slowly(&rig, ask, |come| come.ends_with(b"}") && snapshot(come).is_some()).await;
    assert_eq!(snapshot(&come).unwrap().objects.len() as u64, MANY);
    rig.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_page_that_takes_a_long_message_slowly_gets_all_of_it() {
    let rig = rig_that_waits(SLOW_LIMIT).await;
    rig.publish(objects(MANY));
    let ask = "GET /api/v1/stream HTTP/1.1\r\nhost: a\r\nconnection: upgrade\r\nupgrade: websocket\r\n\
        sec-websocket-version: 13\r\nsec-websocket-key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n";
    // Objects end like the message does, so only parsing tells whether all of it is there.
    let message = |come: &[u8]| -> Option<serde_json::Value> {
        let begin = come.windows(2).position(|it| it == b"{\"")?;
        serde_json::from_slice(&come[begin..]).ok()
    };
    let come =
        read_slowly(&rig, ask, |come| come.ends_with(b"}}") && message(come).is_some()).await;
    let message = message(&come).unwrap();
    assert_eq!(message["snapshot"]["objects"].as_array().unwrap().len() as u64, MANY);
    rig.stop().await;
}
