//! What one snapshot of 100 objects costs a subscriber: conversion, prediction, protobuf and JSON,
//! with covariances (full) and without (lean). Prints the sizes first.
//!
//! `cargo bench -p roundel-server --bench snapshot`

use std::{collections::BTreeMap, hint::black_box};

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{UnitQuaternion, Vector3};
use prost::Message;
use roundel_core::{
    id::{CameraId, KindId, ObjectId},
    rigid::Covariance6,
    time::Timestamp,
    world::{LifeStage, ObjectState, ProcessNoise, Snapshot},
};
use roundel_proto::v1;
use roundel_server::{
    api::selection::{MESSAGE_FIELDS, Selection},
    hub::{CameraInfo, FusedSnapshot, Installation},
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
        cameras: Installation::numbered((0..4).map(camera)),
        kinds: vec!["robot".into()],
        object_names: BTreeMap::new(),
        body_names: vec![],
    }
}

/// Numbers with all their digits, as real ones have.
fn object(id: u64) -> ObjectState {
    let phase = id as f64 * 0.7;
    let factor = Covariance6::from_fn(|row, column| {
        ((row * 6 + column) as f64 + phase).sin() * 1e-3 + f64::from(u8::from(row == column)) * 1e-2
    });
    let covariance = factor * factor.transpose();
    ObjectState {
        id: ObjectId(id),
        kind: Some(KindId(0)),
        body: None,
        code: None,
        stage: LifeStage::Tracked,
        position_m: Vector3::new(5.0 * phase.sin(), 4.0 * phase.cos(), 0.3),
        orientation: UnitQuaternion::from_euler_angles(0.1 * phase.sin(), 0.2, phase),
        yaw_observed: false,
        yaw_symmetry: 1,
        velocity_m_s: Vector3::new(phase.cos(), -phase.sin(), 0.01 * phase.cos()),
        acceleration_m_s2: Vector3::zeros(),
        angular_velocity_rad_s: Vector3::new(0.1, 0.2, 0.3) * phase.sin(),
        covariance,
        motion_covariance: covariance,
        rotation_covariance: covariance,
        process_noise: ProcessNoise {
            acceleration_density_m2_s3: Vector3::repeat(0.1),
            angular_density_rad2_s3: Vector3::repeat(0.1),
        },
        cameras: vec![CameraId(0), CameraId(2)],
        newest_observation: Timestamp::from_ns(1_700_000_000_111_222_333),
        residual: 0.9 + 0.1 * phase.sin(),
        first_observation: Timestamp::from_ns(1_700_000_000_000_000_000),
        observations: 1000,
    }
}

fn selection(omit_covariance: bool, horizon_ms: Option<f64>) -> Selection {
    let request =
        v1::SubscribeSnapshotsRequest { omit_covariance, horizon_ms, ..Default::default() };
    Selection::new(request, &[], &MESSAGE_FIELDS).expect("a valid selection")
}

fn snapshot(criterion: &mut Criterion) {
    let installation = installation();
    let fused = FusedSnapshot {
        sequence: 123_456,
        fused_time: Timestamp::from_ns(1_700_000_000_123_456_789),
        snapshot: Snapshot {
            pose_time: Timestamp::from_ns(1_700_000_000_123_400_000),
            capture_time: Some(Timestamp::from_ns(1_700_000_000_111_222_333)),
            objects: (1..=OBJECTS).map(object).collect(),
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
