//! Subscriptions that select objects by name or code, which stay valid over a server restart, unlike object IDs.

use std::collections::BTreeMap;

use futures::SinkExt;
use roundel_core::{
    id::{BodyId, KindId, ObjectId},
    marker::Code,
    world::ObjectState,
};
use roundel_proto::v1;
use serde_json::Value;
use tokio_tungstenite::tungstenite::Message;

use super::{
    grpc,
    rig::{Rig, object, objects},
    websocket,
};

fn ids(snapshot: &v1::Snapshot) -> Vec<u64> {
    snapshot.objects.iter().map(|object| object.object_id).collect()
}

/// Selects by names and by codes (bits, number).
fn selection(names: &[&str], codes: &[(u32, u32)]) -> v1::SubscribeSnapshotsRequest {
    v1::SubscribeSnapshotsRequest {
        names: names.iter().map(|&name| name.to_owned()).collect(),
        codes: codes.iter().map(|&(bits, number)| v1::Code { bits, number }).collect(),
        ..Default::default()
    }
}

#[tokio::test]
async fn includes_objects_that_are_named_or_whose_code_is_read_later() {
    let rig = Rig::start().await;
    let mut client = grpc::connect(&rig).await;
    let request = selection(&["drone", "carrier"], &[(0, 9)]);
    let mut stream = client.subscribe_snapshots(request).await.unwrap().into_inner();
    let body = |id, body| ObjectState { body: Some(BodyId(body)), ..object(id) };
    let coded = |id, number| ObjectState { code: Some(Code { bits: 8, number }), ..object(id) };

    rig.publish(objects(6));
    assert_eq!(ids(&grpc::next(&mut stream).await), [] as [u64; 0]);
    // The hub's first body is named "carrier".
    rig.publish(vec![object(1), body(3, 0), body(5, 1)]);
    assert_eq!(ids(&grpc::next(&mut stream).await), [3]);
    rig.hub.set_object_names(BTreeMap::new(), vec!["carrier".into(), "drone".into()]);
    rig.publish(vec![object(1), body(3, 0), body(5, 1)]);
    assert_eq!(ids(&grpc::next(&mut stream).await), [3, 5]);
    // A renamed object leaves the selection; an object enters it when its code is read.
    rig.hub.set_object_names(BTreeMap::new(), vec!["cart".into(), "drone".into()]);
    rig.publish(vec![coded(1, 9), coded(2, 8), body(3, 0), body(5, 1)]);
    assert_eq!(ids(&grpc::next(&mut stream).await), [1, 5]);
    // One name can apply to a whole kind.
    rig.hub.set_object_names(BTreeMap::from([(KindId(0), "drone".into())]), vec![]);
    rig.publish(objects(4));
    assert_eq!(ids(&grpc::next(&mut stream).await), [1, 3]);
    rig.stop().await;
}

#[tokio::test]
async fn ids_names_and_codes_are_a_union_and_kinds_and_regions_restrict_it() {
    let rig = Rig::start().await;
    // Objects with even IDs are carts with codes of 8 bits; their kind has the name `cart "one"`.
    rig.publish(objects(6));
    let mut client = grpc::connect(&rig).await;
    let mut once = async |request: v1::GetSnapshotRequest| {
        let snapshot = client.get_snapshot(request).await.unwrap().into_inner();
        (ids(&snapshot), snapshot.objects.iter().any(|it| !it.covariance.is_empty()))
    };
    let v1::SubscribeSnapshotsRequest { names, codes, .. } =
        selection(&["cart \"one\""], &[(0, 3)]);
    let request =
        v1::GetSnapshotRequest { object_ids: vec![5], names, codes, ..Default::default() };
    assert_eq!(once(request.clone()).await, (vec![2, 4, 5, 6], true));
    let corner = |x| Some(v1::Vector3 { x, y: -9.0, z: 0.0 });
    let max = Some(v1::Vector3 { x: 5.0, y: 9.0, z: 9.0 });
    let request = v1::GetSnapshotRequest {
        region: Some(v1::Box { min: corner(3.0), max }),
        omit_covariance: true,
        ..request
    };
    assert_eq!(once(request.clone()).await, (vec![4, 5], false));
    let request = v1::GetSnapshotRequest { roundels: vec!["robot".into()], ..request };
    assert_eq!(once(request).await, (vec![5], false));
    for (bits, expected) in [(0, vec![4]), (8, vec![4]), (9, vec![])] {
        let codes = vec![v1::Code { bits, number: 4 }];
        let request = v1::GetSnapshotRequest { codes, ..Default::default() };
        assert_eq!(once(request).await.0, expected, "{bits} bits");
    }
    let request = v1::GetSnapshotRequest { horizon_ms: Some(1e9), ..Default::default() };
    let status = client.get_snapshot(request).await.unwrap_err();
    assert!(status.message().starts_with("horizon_ms: expected"), "{status}");
    rig.stop().await;
}

#[tokio::test]
async fn rest_and_websocket_accept_names_and_codes() {
    let rig = Rig::start().await;
    let named = |body| ObjectState { body: Some(BodyId(body)), id: ObjectId(7), ..object(1) };
    rig.publish([objects(6), vec![named(0)]].concat());
    let rest = async |query: &str| {
        let json = rig.get(&format!("/api/v1/snapshot?{query}")).await.json();
        ids(&serde_json::from_value::<v1::Snapshot>(json).unwrap())
    };
    assert_eq!(rest("names=carrier,other").await, [7]);
    assert_eq!(rest("codes=4,9:6").await, [4]);
    assert_eq!(rest("names=carrier&codes=8:6&ids=1").await, [1, 6, 7]);
    assert_eq!(rest("names=unknown").await, [] as [u64; 0]);
    for (query, message) in [
        ("codes=0", "codes: expected numbers of codes, from 1 to 65535, found 0"),
        ("codes=1:1", "codes: expected codes of 2 to 16 bits, or 0 for any, found 1 bits"),
        (
            "codes=1,%238",
            "codes: expected numbers with commas between, such as 12, or 8:12 for one of 8 bits, found \"#8\"",
        ),
    ] {
        let answer = rig.get(&format!("/api/v1/snapshot?{query}")).await;
        assert_eq!((answer.status.as_u16(), answer.error().1.as_str()), (400, message));
    }

    let mut socket = websocket::open(&rig, "?names=carrier").await;
    assert_eq!(ids(&websocket::next_snapshot(&mut socket).await), [7]);
    let request = r#"{"snapshots": {"names": ["carrier"], "codes": [{"number": 2}, {"bits": 9, "number": 4}]}}"#;
    socket.send(Message::text(request)).await.unwrap();
    assert_eq!(ids(&websocket::next_snapshot(&mut socket).await), [2, 7]);
    socket.send(Message::text(r#"{"snapshots": {"names": [""]}}"#)).await.unwrap();
    let answer: Value = websocket::next(&mut socket).await;
    assert_eq!(answer["error"]["message"], "names: expected names of objects, found an empty one");
    rig.stop().await;
}
