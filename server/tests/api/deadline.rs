//! Clients that say how long they wait.

use std::time::Duration;

use axum::{body::Body, http::Request};
use roundel_proto::v1;
use tokio::time::timeout;
use tonic::{Code, Request as Call};

use crate::{
    grpc,
    rig::{HANG, Rig, objects},
};

#[tokio::test]
async fn streams_end_when_their_clients_have_waited_long_enough() {
    let rig = Rig::start().await;
    rig.publish(objects(3));
    let mut client = grpc::connect(&rig).await;
    let mut snapshots = Call::new(v1::SubscribeSnapshotsRequest::default());
    snapshots.set_timeout(Duration::from_millis(200));
    let mut snapshots = client.subscribe_snapshots(snapshots).await.unwrap().into_inner();
    let mut events = Call::new(v1::SubscribeEventsRequest { backlog: 0 });
    events.set_timeout(Duration::from_millis(200));
    let mut events = client.subscribe_events(events).await.unwrap().into_inner();
    let mut endless = client
        .subscribe_snapshots(v1::SubscribeSnapshotsRequest::default())
        .await
        .unwrap()
        .into_inner();
    let end = async {
        let mut received = 0;
        loop {
            rig.publish(objects(3));
            match snapshots.message().await {
                Ok(Some(snapshot)) => received += snapshot.objects.len(),
                Ok(None) => panic!("it ends without a reason"),
                Err(status) => break (received, status),
            }
        }
    };
    let (received, status) = timeout(HANG, end).await.expect("it goes on for ever");
    assert!(received >= 3, "whole messages until then");
    assert_eq!(status.code(), Code::DeadlineExceeded, "{status}");
    assert_eq!(status.message(), "the call's deadline of 200ms has passed");
    let status = timeout(HANG, events.message()).await.expect("it goes on for ever").unwrap_err();
    assert_eq!(status.code(), Code::DeadlineExceeded, "one that nothing comes on, too: {status}");
    // The connection is there for others.
    grpc::next(&mut endless).await;
    let metrics = rig.get("/metrics").await;
    assert!(metrics.text().contains("\nroundel_subscribers 1\n"), "{}", metrics.text());
    rig.stop().await;
}

#[tokio::test]
async fn a_time_that_is_none_is_refused() {
    let rig = Rig::start().await;
    let request = Request::post(format!("{}/roundel.v1.Roundel/GetTime", rig.url()))
        .header("content-type", "application/grpc")
        .header("grpc-timeout", "soon")
        .body(Body::from(vec![0; 5]))
        .unwrap();
    let answer = rig.request(request).await;
    assert_eq!(answer.header("grpc-status"), "3", "{:?}", answer.headers);
    assert!(answer.header("grpc-message").starts_with("grpc-timeout:"), "{:?}", answer.headers);
    rig.stop().await;
}
