//! What does not come by tonic's client: gRPC as pages speak it, and streams that nobody reads.

use std::time::Duration;

use axum::{body::Body, http::Request};
use prost::Message;
use roundel_proto::v1;
use roundel_server::api::Limits;
use tokio::time::{sleep, timeout};

use crate::{
    grpc,
    rig::{self, HANG, Rig, objects},
};

/// gRPC's frame of a message.
fn framed(message: &impl Message) -> Vec<u8> {
    let bytes = message.encode_to_vec();
    [&[0], (bytes.len() as u32).to_be_bytes().as_slice(), &bytes].concat()
}

#[tokio::test]
async fn pages_call_over_http1() {
    let rig = Rig::start().await;
    rig.publish(objects(2));
    let call = |call: &str, body: Vec<u8>| {
        Request::post(format!("{}/roundel.v1.Roundel/{call}", rig.url()))
            .header("content-type", "application/grpc-web+proto")
            .header("x-grpc-web", "1")
            .body(Body::from(body))
            .unwrap()
    };
    let answer = rig.request(call("GetSnapshot", framed(&v1::GetSnapshotRequest {}))).await;
    assert_eq!(answer.header("content-type"), "application/grpc-web+proto");
    let length = u32::from_be_bytes(answer.body[1..5].try_into().unwrap()) as usize;
    let snapshot = v1::Snapshot::decode(&answer.body[5..5 + length]).unwrap();
    assert_eq!(snapshot.objects.len(), 2);
    // The trailers are a frame of the body, with the highest bit set.
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
async fn a_request_that_is_no_message_is_refused() {
    let rig = Rig::start().await;
    let well = framed(&v1::SubscribeSnapshotsRequest::default());
    let long = [&[0], 9_u32.to_be_bytes().as_slice()].concat();
    for (body, code) in [
        (vec![], "13"),
        (vec![0, 0], "13"),
        (long, "13"),
        (vec![0, 0, 0, 0, 2, 0xff, 0xff], "13"),
        ([&[1], &well[1..]].concat(), "12"),
        ([well.as_slice(), &well].concat(), "13"),
        (vec![0; 1_000_000], "11"),
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

#[tokio::test]
async fn who_takes_no_snapshots_is_cut_off_and_nobody_else() {
    let limits = Limits { send_timeout: Duration::from_millis(400), ..Limits::default() };
    let rig = Rig::start_with(rig::hub("run"), limits, "127.0.0.1:0").await;
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
