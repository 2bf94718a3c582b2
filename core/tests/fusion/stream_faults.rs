//! Faulty streams: each fault is counted, and no object is lost or doubled by it.

use std::collections::BTreeSet;

use nalgebra::Vector3;
use roundel_core::{
    id::CameraId,
    rigid::Covariance6,
    time::Timestamp,
    world::{EventKind, FrameObservations, Fusion, FusionCounts, FusionParams, LifeStage},
};

use super::{
    arena::{Arena, START, Setting},
    score::{Score, fusion_of, run},
};

const HOUR_S: f64 = 3600.0;

fn setting() -> Setting {
    Setting { objects: 9, random: true, ..Setting::default() }
}

/// Checks that tampered frames do no harm; returns the counters.
fn unharmed(tamper: impl Fn(Vec<FrameObservations>) -> Vec<FrameObservations>) -> FusionCounts {
    let arena = Arena::new(setting());
    let mut fusion = fusion_of(&arena, FusionParams::default());
    let score = run(&arena, &mut fusion, &tamper(arena.frames(5.0)), 1.0);
    let Score { swaps, ghosts, ref ids, .. } = score;
    assert_eq!((ids.len(), swaps, ghosts), (9, 0, 0), "{}", score.summary());
    assert!(score.shares()[0] > 0.92, "{}", score.summary());
    let lost = fusion.drain_events().filter(|event| event.kind == EventKind::Lost).count();
    assert_eq!(lost, 0);
    fusion.counts()
}

fn shifted(frame: &FrameObservations, seconds: f64) -> FrameObservations {
    let mut shifted = frame.clone();
    shifted.capture_time = frame.capture_time.plus_seconds(seconds);
    for detection in &mut shifted.detections {
        detection.capture_time = detection.capture_time.plus_seconds(seconds);
    }
    shifted
}

#[test]
fn duplicate_frames() {
    let counts =
        unharmed(|frames| frames.iter().flat_map(|frame| [frame.clone(), frame.clone()]).collect());
    assert_eq!(counts.duplicate_frames * 2, counts.frames);
    assert_eq!(counts.duplicate * 2, counts.detections);
}

#[test]
fn frames_beyond_the_late_window() {
    let counts = unharmed(|mut frames| {
        for frame in frames.iter_mut().filter(|frame| frame.frame % 10 == 0) {
            frame.received_time = frame.received_time.plus_seconds(0.5);
        }
        frames.sort_by_key(|frame| frame.received_time);
        frames
    });
    // For the last ones no newer frame exists to make them late.
    assert!((50..=60).contains(&counts.late_frames), "{counts:?}");
}

#[test]
fn late_frames_within_the_window_are_used() {
    let counts = unharmed(|mut frames| {
        for frame in frames.iter_mut().filter(|frame| frame.frame % 3 == 0) {
            frame.received_time = frame.received_time.plus_seconds(0.2);
        }
        frames.sort_by_key(|frame| frame.received_time);
        frames
    });
    assert_eq!(counts.late, 0);
    assert!(counts.out_of_order > counts.used / 4, "{counts:?}");
}

#[test]
fn one_camera_clock_jumps_by_an_hour() {
    for hours in [1.0, -1.0] {
        let counts = unharmed(|mut frames| {
            for frame in frames.iter_mut() {
                if frame.camera == CameraId(2) && (50..100).contains(&frame.frame) {
                    *frame = shifted(frame, hours * HOUR_S);
                }
            }
            frames
        });
        // Two steps: some frames are rejected until each is confirmed.
        assert!((10..=16).contains(&counts.jumped_frames), "{counts:?}");
        assert_eq!((counts.clock_steps, counts.late_frames, counts.restarts), (2, 0, 0));
    }
}

#[test]
fn one_frame_with_a_wrong_stamp() {
    for seconds in [HOUR_S, -HOUR_S, 0.8, -0.25] {
        let counts = unharmed(|mut frames| {
            let is_wrong =
                |frame: &&mut FrameObservations| frame.camera == CameraId(2) && frame.frame == 60;
            frames.iter_mut().filter(is_wrong).for_each(|frame| *frame = shifted(frame, seconds));
            frames
        });
        assert_eq!((counts.jumped_frames, counts.clock_steps, counts.restarts), (1, 0, 0));
    }
}

#[test]
fn clocks_of_another_epoch() {
    let arena = Arena::new(setting());
    let mut fusion = fusion_of(&arena, FusionParams::default());
    let mut frames = arena.frames(8.0);
    for frame in &mut frames {
        match frame.camera {
            CameraId(1) => *frame = shifted(frame, -400.0 * HOUR_S),
            CameraId(2) => *frame = shifted(frame, 7.0 * HOUR_S),
            _ => {}
        }
    }
    // Reception locates the offsets to some ten milliseconds, motion does the rest.
    let score = run(&arena, &mut fusion, &frames, 2.5);
    assert_eq!((score.ids.len(), score.swaps, score.ghosts), (9, 0, 0), "{}", score.summary());
    assert!(score.shares()[0] > 0.92, "{}", score.summary());
    let counts = fusion.counts();
    assert_eq!((counts.jumped_frames, counts.late_frames, counts.restarts), (0, 0, 0));
}

#[test]
fn a_first_frame_from_the_future() {
    let arena = Arena::new(setting());
    let mut fusion = fusion_of(&arena, FusionParams::default());
    let mut frames = arena.frames(5.0);
    frames[0] = shifted(&frames[0], HOUR_S);
    let score = run(&arena, &mut fusion, &frames, 2.0);
    // There and back.
    assert_eq!((fusion.counts().clock_steps, fusion.counts().restarts), (2, 0));
    assert_eq!((score.swaps, score.ghosts), (0, 0));
    assert!(score.states > 1500, "{}", score.summary());
}

#[test]
fn a_pause_of_all_cameras_is_not_a_jump() {
    let arena = Arena::new(Setting { still: 1, ..setting() });
    let mut fusion = fusion_of(&arena, FusionParams::default());
    for frame in arena.frames(2.0) {
        fusion.observe(&frame);
    }
    let mut after = arena.frames(1.0);
    for frame in &mut after {
        *frame = shifted(frame, HOUR_S);
        frame.received_time = frame.received_time.plus_seconds(HOUR_S);
        frame.frame += 1000;
    }
    for frame in &after {
        fusion.observe(frame);
    }
    let counts = fusion.counts();
    assert_eq!((counts.jumped_frames, counts.late_frames, counts.restarts), (0, 0, 0));
    let lost = fusion.drain_events().filter(|event| event.kind == EventKind::Lost).count();
    assert_eq!(lost, 9);
}

#[test]
fn a_camera_that_stops_and_returns() {
    unharmed(|mut frames| {
        frames.retain(|frame| {
            let t = frame.capture_time.seconds_since(START);
            frame.camera != CameraId(1) || !(1.5..3.5).contains(&t)
        });
        frames
    });
}

/// As with a ring that is half covered: a position too far away, with a small stated error.
#[test]
fn a_camera_contradicts_the_others_for_half_a_second() {
    let counts = unharmed(|mut frames| {
        for frame in &mut frames {
            let t = frame.capture_time.seconds_since(START);
            if frame.camera != CameraId(2) || !(2.0..2.5).contains(&t) {
                continue;
            }
            let pose = frame.detections.first_mut().and_then(|seen| seen.pose.as_mut());
            pose.into_iter().for_each(|pose| pose.position_m *= 1.1);
        }
        frames
    });
    assert!((12..=15).contains(&counts.contradicted), "{counts:?}");
    assert_eq!(counts.begun, 9, "{counts:?}");
}

#[test]
fn every_camera_stops_for_a_second() {
    let arena = Arena::new(Setting { still: 1, ..setting() });
    let mut fusion = fusion_of(&arena, FusionParams::default());
    let mut frames = arena.frames(5.0);
    frames.retain(|frame| !(2.0..3.0).contains(&frame.capture_time.seconds_since(START)));
    let score = run(&arena, &mut fusion, &frames, 1.0);
    assert_eq!((score.ids.len(), score.swaps, score.ghosts), (9, 0, 0));
    let kinds: Vec<EventKind> = fusion.drain_events().map(|event| event.kind).collect();
    let count = |kind: EventKind| kinds.iter().filter(|found| **found == kind).count();
    assert_eq!(count(EventKind::Appeared), 9);
    assert_eq!(count(EventKind::Predicted), 9);
    assert_eq!(count(EventKind::Recovered), 9);
    assert_eq!(count(EventKind::Lost), 0);
}

/// One invalid detection of each sort per frame, beside the valid ones.
#[test]
fn detections_with_invalid_numbers() {
    type Spoil = fn(&mut roundel_core::pose::RoundelPose);
    let spoils: [Spoil; 11] = [
        |pose| pose.position_m.x = f64::NAN,
        |pose| pose.position_m.z = f64::INFINITY,
        |pose| pose.position_m = Vector3::zeros(),
        |pose| pose.normal = Vector3::zeros(),
        |pose| pose.normal = -pose.normal,
        |pose| pose.other_normal = pose.position_m.cross(&pose.normal).normalize(),
        |pose| pose.other_normal.y = f64::NAN,
        |pose| pose.normal_likelihood = f64::NAN,
        |pose| pose.covariance = Covariance6::zeros(),
        |pose| pose.covariance[(1, 1)] = -1e-6,
        |pose| pose.covariance[(4, 4)] = f64::NAN,
    ];
    for spoil in spoils {
        let counts = unharmed(|mut frames| {
            for frame in frames.iter_mut().filter(|frame| frame.frame % 5 == 0) {
                if let Some(pose) =
                    frame.detections.first_mut().and_then(|detection| detection.pose.as_mut())
                {
                    spoil(pose);
                }
            }
            frames
        });
        assert!(counts.invalid > 50, "{counts:?}");
    }
}

#[test]
fn detections_without_pose_or_camera_pose() {
    let counts = unharmed(|mut frames| {
        for frame in frames.iter_mut().filter(|frame| frame.frame % 5 == 0) {
            if let Some(detection) = frame.detections.first_mut() {
                detection.pose = None;
            }
            if let Some(copy) = frame.detections.last().cloned() {
                frame.detections.push(copy);
            }
            frame.camera = CameraId(frame.camera.0 + 40 * u32::from(frame.frame % 2 == 0));
        }
        frames
    });
    assert!(
        counts.no_pose > 20 && counts.duplicate > 20 && counts.no_camera_pose > 20,
        "{counts:?}"
    );
    let sum = counts.used
        + counts.late
        + counts.duplicate
        + counts.jumped
        + counts.no_camera_pose
        + counts.no_pose
        + counts.invalid
        + counts.contradicted
        + counts.outranked
        + counts.over_max_objects
        + counts.joined
        + counts.left_out;
    assert_eq!(sum, counts.detections, "{counts:?}");
}

#[test]
fn times_at_the_limits_of_their_range() {
    let arena = Arena::new(setting());
    let mut fusion = fusion_of(&arena, FusionParams::default());
    let frames = arena.frames(1.0);
    for (frame, ns) in frames.iter().zip([i64::MAX, i64::MIN, 0, -1, i64::MAX - 1].iter().cycle()) {
        fusion.observe(frame);
        let mut odd = frame.clone();
        odd.frame += 5000;
        odd.capture_time = Timestamp::from_ns(*ns);
        odd.received_time = frame.received_time;
        fusion.observe(&odd);
    }
    let snapshot = fusion.snapshot(frames.last().unwrap().received_time);
    assert_eq!(snapshot.objects.len(), 9);
    for ns in [i64::MIN, i64::MAX] {
        let snapshot = fusion.snapshot(Timestamp::from_ns(ns));
        for object in &snapshot.objects {
            assert!(object.position_m.iter().all(|number| number.is_finite()));
            assert!(object.covariance.iter().all(|number| number.is_finite()));
        }
    }
}

#[test]
fn more_objects_than_allowed() {
    let arena = Arena::new(setting());
    let params = FusionParams { max_objects: 5, ..FusionParams::default() };
    let mut fusion = fusion_of(&arena, params);
    for frame in arena.frames(1.0) {
        fusion.observe(&frame);
    }
    assert_eq!(fusion.snapshot(START.plus_seconds(1.0)).objects.len(), 5);
    assert!(fusion.counts().over_max_objects > 100);
}

#[test]
fn the_same_frames_give_the_same_bits() {
    let arena = Arena::new(Setting { clutter: 0.5, jitter_s: 0.05, ..setting() });
    let snapshots = [0, 1].map(|_| {
        let mut fusion: Fusion = fusion_of(&arena, FusionParams::default());
        for frame in arena.frames(2.0) {
            fusion.observe(&frame);
        }
        fusion.snapshot(START.plus_seconds(2.0))
    });
    assert_eq!(snapshots[0], snapshots[1]);
    let tracked = snapshots[0].objects.iter().filter(|o| o.stage == LifeStage::Tracked);
    assert_eq!(tracked.map(|object| object.id).collect::<BTreeSet<_>>().len(), 9);
}
