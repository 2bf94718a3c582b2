//! Cost of one snapshot of 100 objects for a subscriber: conversion, prediction, protobuf and JSON, with covariances
//! (full) and without (lean). Prints the sizes first.
//!
//! `cargo bench -p roundel-server --bench snapshot`

#[path = "shared/object.rs"]
mod object;

use std::{collections::BTreeMap, hint::black_box};

use criterion::{Criterion, criterion_group, criterion_main};
use prost::Message;
use roundel_core::{time::Timestamp, world::Snapshot};
use roundel_proto::v1;
use roundel_server::{
    api::selection::{MESSAGE_FIELDS, Selection},
    model::hub::{CameraInfo, FusedSnapshot, Installation},
};

const OBJECTS: u64 = 100;

fn installation() -> Installation {
    let camera =
        |place: usize| CameraInfo { name: format!("camera {place}"), ..CameraInfo::default() };
    Installation {
        name: "bench".into(),
        source_id: "0123456789abcdef".into(),
        started: Timestamp::default(),
        snapshot_rate_hz: 60.0,
        cameras: Installation::number_cameras((0..4).map(camera)),
        kinds: vec!["robot".into()],
        object_names: BTreeMap::new(),
        body_names: vec![],
    }
}

fn selection(omit_covariance: bool, horizon_ms: Option<f64>) -> Selection {
    let request =
        v1::SubscribeSnapshotsRequest { omit_covariance, horizon_ms, ..Default::default() };
    Selection::new(request, &[], &MESSAGE_FIELDS).expect("a valid selection")
}

fn snapshot(criterion: &mut Criterion) {
    let installation = installation();
    let observed = Timestamp::from_ns(1_700_000_000_111_222_333);
    let fused = FusedSnapshot {
        sequence: 123_456,
        fused_time: Timestamp::from_ns(1_700_000_000_123_456_789),
        snapshot: Snapshot {
            pose_time: Timestamp::from_ns(1_700_000_000_123_400_000),
            capture_time: Some(observed),
            objects: (1..=OBJECTS).map(|id| object::object(id, 0.0, observed)).collect(),
        },
    };
    for (payload, omit_covariance) in [("full", false), ("lean", true)] {
        let filter = selection(omit_covariance, None).filter;
        let message = filter.message(&installation, &fused);
        let json = serde_json::to_string(&message).expect("messages are JSON");
        println!("{payload}: {} bytes in protobuf, {} in JSON", message.encoded_len(), json.len());
        let mut group = criterion.benchmark_group(format!("snapshot/{payload}"));
        group.bench_function("convert", |bencher| {
            bencher.iter(|| filter.message(black_box(&installation), black_box(&fused)));
        });
        let ahead = selection(omit_covariance, Some(20.0)).filter;
        group.bench_function("predict and convert", |bencher| {
            bencher.iter(|| ahead.message(black_box(&installation), black_box(&fused)));
        });
        group.bench_function("protobuf", |bencher| {
            bencher.iter(|| black_box(&message).encode_to_vec());
        });
        group.bench_function("json", |bencher| {
            bencher.iter(|| serde_json::to_string(black_box(&message)));
        });
        group.finish();
    }
}

criterion_group!(benches, snapshot);
criterion_main!(benches);
