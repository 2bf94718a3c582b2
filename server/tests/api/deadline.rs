//! gRPC calls and streams with a deadline.

use std::time::Duration;

use axum::{body::Body, http::Request};
use roundel_proto::v1;
use tokio::time::timeout;
use tonic::{Code, Request as Call};

use super::{
    grpc,
    rig::{Rig, TIMEOUT, objects},
};

#[tokio::test]
async fn streams_end_at_their_deadline() {
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
                Ok(None) => panic!("the stream ends without a status"),
                Err(status) => break (received, status),
            }
        }
    };
    let (received, status) = timeout(TIMEOUT, end).await.expect("the stream does not end");
    assert!(received >= 3, "expected whole messages until the deadline");
    assert_eq!(status.code(), Code::DeadlineExceeded, "{status}");
    assert_eq!(status.message(), "the call's deadline of 200ms has passed");
    let status =
        timeout(TIMEOUT, events.message()).await.expect("the stream does not end").unwrap_err();
    assert_eq!(status.code(), Code::DeadlineExceeded, "an idle stream must end, too: {status}");
    // The connection remains usable.
    grpc::next(&mut endless).await;
    let metrics = rig.get("/metrics").await;
    assert!(metrics.text().contains("\nroundel_subscribers 1\n"), "{}", metrics.text());
    rig.stop().await;
}

#[tokio::test]
async fn rejects_an_unreadable_timeout() {
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
