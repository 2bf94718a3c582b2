//! Many subscribers with the same selection, and several subscriptions on one connection: every message arrives
//! complete and in order, and no subscriber disturbs another.

use futures::{SinkExt, StreamExt};
use roundel_proto::v1::{
    self, roundel_client::RoundelClient, stream_message::Message as Alternative,
};
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::Message;
use tonic::{
    Code, Streaming,
    transport::{Channel, Endpoint},
};

use super::{
    grpc::{connect, next},
    rig::{Rig, TIMEOUT, objects},
    websocket,
};

/// A client whose flow-control windows are exhausted many times.
async fn connect_with_small_windows(rig: &Rig) -> RoundelClient<Channel> {
    let endpoint = Endpoint::from_shared(rig.url())
        .unwrap()
        .initial_stream_window_size(100_000)
        .initial_connection_window_size(600_000);
    RoundelClient::new(endpoint.connect().await.unwrap())
}

async fn subscribe(
    client: &mut RoundelClient<Channel>,
    request: v1::SubscribeSnapshotsRequest,
) -> Streaming<v1::Snapshot> {
    client.subscribe_snapshots(request).await.unwrap().into_inner()
}

async fn ends_as_unavailable(mut snapshots: Streaming<v1::Snapshot>) {
    let ended = timeout(TIMEOUT, snapshots.message()).await.expect("the stream does not end");
    assert_eq!(ended.unwrap_err().code(), Code::Unavailable);
}

#[tokio::test]
async fn forty_subscribers_of_the_same_selection_receive_every_snapshot() {
    const SUBSCRIBERS: u64 = 40;
    const ROUNDS: u64 = 50;
    let rig = Rig::start().await;
    rig.publish(objects(1));
    let (mut clients, mut all) = (Vec::new(), Vec::new());
    for _ in 0..SUBSCRIBERS {
        let mut client = connect_with_small_windows(&rig).await;
        let mut snapshots = subscribe(&mut client, Default::default()).await;
        assert_eq!(next(&mut snapshots).await.sequence, 1);
        clients.push(client);
        all.push(snapshots);
    }
    for round in 2..ROUNDS + 2 {
        let count = 100 + round % 7;
        rig.publish(objects(count));
        let mut first = None;
        for snapshots in &mut all {
            let mut snapshot = next(snapshots).await;
            assert_eq!((snapshot.sequence, snapshot.missed), (round, 0));
            assert_eq!(snapshot.objects.len() as u64, count);
            let sent_ns = std::mem::take(&mut snapshot.sent_time_ns);
            assert!((snapshot.fused_time_ns..=rig.clock.now().as_ns()).contains(&sent_ns));
            assert_eq!(*first.get_or_insert_with(|| snapshot.clone()), snapshot);
        }
    }
    // A subscriber with another selection receives its own encoding, and one that leaves does not disturb the others.
    let lean = v1::SubscribeSnapshotsRequest { omit_covariance: true, ..Default::default() };
    let mut lean = subscribe(&mut clients[0], lean).await;
    assert!(next(&mut lean).await.objects[0].covariance.is_empty());
    drop(all.pop());
    for round in ROUNDS + 2..ROUNDS + 6 {
        rig.publish(objects(100));
        for snapshots in &mut all {
            assert_eq!(next(snapshots).await.objects[0].covariance.len(), 21);
        }
        let snapshot = next(&mut lean).await;
        assert_eq!((snapshot.sequence, snapshot.missed), (round, 0));
        assert!(snapshot.objects[0].covariance.is_empty());
    }
    rig.cancel.cancel();
    for snapshots in all {
        ends_as_unavailable(snapshots).await;
    }
    rig.stop().await;
}

#[tokio::test]
async fn one_connection_carries_several_subscriptions_and_calls() {
    let rig = Rig::start().await;
    let mut client = connect_with_small_windows(&rig).await;
    let request = |id| v1::SubscribeSnapshotsRequest {
        object_ids: vec![id],
        omit_covariance: id == 2,
        ..Default::default()
    };
    let mut of_each = Vec::new();
    for id in 1..=3 {
        of_each.push(subscribe(&mut client, request(id)).await);
    }
    let mut all = subscribe(&mut client, Default::default()).await;
    for round in 1..=30 {
        rig.publish(objects(150));
        let time = client.get_time(v1::GetTimeRequest { sent_time_ns: round }).await.unwrap();
        assert_eq!(time.into_inner().sent_time_ns, round);
        let snapshot = client.get_snapshot(v1::GetSnapshotRequest::default()).await.unwrap();
        assert_eq!(snapshot.into_inner().objects.len(), 150);
        for (id, snapshots) in (1..).zip(&mut of_each) {
            let snapshot = next(snapshots).await;
            let [object] = &snapshot.objects[..] else { panic!("{snapshot:?}") };
            assert_eq!((snapshot.sequence, snapshot.missed), (round as u64, 0));
            assert_eq!((object.object_id, object.covariance.is_empty()), (id, id == 2));
        }
        assert_eq!(next(&mut all).await.objects.len(), 150);
    }
    // A cancelled stream does not disturb the others, even in the middle of a message.
    rig.publish(objects(150));
    of_each.pop();
    rig.publish(objects(150));
    all = subscribe(&mut client, Default::default()).await;
    for snapshots in &mut of_each {
        assert!(next(snapshots).await.sequence > 30);
    }
    assert_eq!(next(&mut all).await.objects.len(), 150);
    rig.cancel.cancel();
    for snapshots in of_each.into_iter().chain([all]) {
        ends_as_unavailable(snapshots).await;
    }
    rig.stop().await;
}

#[tokio::test]
async fn a_subscription_with_a_deadline_receives_whole_messages_until_it_ends() {
    let rig = Rig::start().await;
    let mut request = tonic::Request::new(v1::SubscribeSnapshotsRequest::default());
    request.set_timeout(std::time::Duration::from_millis(400));
    let mut snapshots =
        connect(&rig).await.subscribe_snapshots(request).await.unwrap().into_inner();
    let mut received = 0;
    let ended = loop {
        rig.publish(objects(100));
        match timeout(TIMEOUT, snapshots.message()).await.expect("the stream does not end") {
            Ok(snapshot) => received += snapshot.unwrap().objects.len(),
            Err(status) => break status.code(),
        }
    };
    assert!(matches!(ended, Code::DeadlineExceeded | Code::Cancelled), "{ended:?}");
    assert!(received > 300);
    rig.stop().await;
}

#[tokio::test]
async fn many_websockets_receive_the_same_snapshots_beside_their_own_pings() {
    const PAGES: u64 = 30;
    const ROUNDS: u64 = 25;
    let rig = Rig::start().await;
    rig.publish(objects(1));
    let (mut texts, mut binaries) = (Vec::new(), Vec::new());
    for _ in 0..PAGES {
        let mut page = websocket::open(&rig, "?include=snapshots").await;
        assert_eq!(websocket::next_snapshot(&mut page).await.sequence, 1);
        texts.push(page);
        let mut page = websocket::open_binary(&rig, "").await;
        let Alternative::Snapshot(first) = websocket::next_binary(&mut page).await else {
            panic!()
        };
        assert_eq!(first.sequence, 1);
        binaries.push(page);
    }
    for round in 2..ROUNDS + 2 {
        // About 150 kB as text: more than a socket accepts at once.
        rig.publish(objects(120 + round));
        let mut first = None;
        for page in &mut texts {
            if round % 5 == 0 {
                page.send(Message::Ping(vec![7; 100].into())).await.unwrap();
            }
            let mut snapshot = websocket::next_snapshot(page).await;
            assert_eq!((snapshot.sequence, snapshot.missed), (round, 0));
            let sent_ns = std::mem::take(&mut snapshot.sent_time_ns);
            assert!((snapshot.fused_time_ns..=rig.clock.now().as_ns()).contains(&sent_ns));
            assert_eq!(*first.get_or_insert_with(|| snapshot.clone()), snapshot);
        }
        for page in &mut binaries {
            let Alternative::Snapshot(mut snapshot) = websocket::next_binary(page).await else {
                panic!("only snapshots were requested")
            };
            snapshot.sent_time_ns = 0;
            assert_eq!(Some(snapshot), first);
        }
    }
    rig.cancel.cancel();
    for mut page in texts {
        let closed = async {
            // The pong of the last ping may arrive first.
            while !matches!(page.next().await, Some(Ok(Message::Close(Some(_))))) {}
        };
        timeout(TIMEOUT, closed).await.expect("no close frame arrives");
    }
    rig.stop().await;
}
