//! A camera that reports wrong positions does not move what more trusted cameras observe.

use std::f64::consts::PI;

use nalgebra::{UnitQuaternion, Vector3};
use roundel_core::{
    id::CameraId,
    rigid::{Covariance6, Rigid},
    world::{CameraPlacement, FrameObservations, Fusion, FusionParams, LifeStage, ObjectState},
};

use super::{
    arena::{Arena, START, Setting},
    roundel_camera,
    score::fusion_of,
};

/// Reports up to 100 mm beside the truth and states 0.02 mm.
const LIAR: CameraId = CameraId(3);
const LIE_M: f64 = 0.1;
/// Bound for the error of an object that a single distant camera observes, metres.
const HONEST_M: f64 = 0.04;

/// A slowly growing offset, which stays within the gates.
#[derive(Clone, Copy)]
struct Lie {
    begins_s: f64,
    grows_m_s: f64,
}

fn shift(frame: &mut FrameObservations, by_m: f64) {
    for pose in frame.detections.iter_mut().filter_map(|detection| detection.pose.as_mut()) {
        pose.position_m.x += by_m;
        pose.covariance = Covariance6::from_diagonal_element(4e-10);
    }
}

/// Largest distance from an object to the nearest trusted track after two seconds, metres.
fn largest_error_m(trust: u8, lie: Lie) -> (f64, Fusion) {
    let arena = Arena::new(Setting { objects: 9, ..Setting::default() });
    let mut fusion = fusion_of(&arena, FusionParams::default());
    fusion.set_trust(LIAR, trust);
    let mut worst_m: f64 = 0.0;
    for mut frame in arena.frames(3.0) {
        let time_s = frame.capture_time.seconds_since(START);
        if frame.camera == LIAR && time_s > lie.begins_s {
            shift(&mut frame, LIE_M.min((time_s - lie.begins_s) * lie.grows_m_s));
        }
        fusion.observe(&frame);
        if time_s < 2.0 {
            continue;
        }
        let snapshot = fusion.snapshot(frame.capture_time);
        for object in 0..9 {
            let truth_m = arena.truth(object, frame.capture_time).position_m;
            let trusted = snapshot
                .objects
                .iter()
                .filter(|state| state.stage == LifeStage::Tracked && state.trust > 0);
            let apart_m = trusted.map(|state| (state.position_m - truth_m).norm());
            worst_m = worst_m.max(apart_m.fold(f64::INFINITY, f64::min));
        }
    }
    (worst_m, fusion)
}

#[test]
fn a_camera_of_lower_rank_does_not_move_observed_objects() {
    let slow = Lie { begins_s: 1.0, grows_m_s: 0.1 };
    for lie in [Lie { begins_s: 0.0, grows_m_s: 1e9 }, Lie { begins_s: 1.0, grows_m_s: 1e9 }, slow]
    {
        let (worst_m, fusion) = largest_error_m(0, lie);
        assert!(worst_m < HONEST_M, "{worst_m} {:?}", fusion.counts());
    }
    let (worst_m, _) = largest_error_m(1, slow);
    assert!(worst_m > 1.5 * HONEST_M, "among equal ranks the offset has an effect: {worst_m}");
}

#[test]
fn honest_detections_of_lower_rank_are_counted() {
    let (worst_m, fusion) = largest_error_m(0, Lie { begins_s: 60.0, grows_m_s: 0.0 });
    assert!(worst_m < HONEST_M, "{worst_m}");
    assert!(fusion.counts().outranked > 100, "{:?}", fusion.counts());
}

/// A roundel 2 m below a camera that looks down.
fn below() -> Rigid {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    Rigid::from_parts(Vector3::new(0.0, 0.0, 2.0).into(), turn)
}

/// Two cameras, the second of rank 0, report code 7 at places 5 m apart, each during an interval of time.
fn robot_by(cameras: [(CameraId, f64, f64); 2]) -> Vec<ObjectState> {
    let mut fusion = roundel_camera::fusion();
    fusion.set_trust(CameraId(1), 0);
    let mut sensor = roundel_camera::RoundelCamera::new(1);
    for number in 1..90_u64 {
        let time_s = number as f64 / 30.0;
        for (camera, from_s, until_s) in cameras {
            if !(from_s..until_s).contains(&time_s) {
                continue;
            }
            let time = START.plus_seconds(time_s);
            let detection = sensor.detect(&below(), time, 1, Some(roundel_camera::code(7)));
            fusion.observe(&roundel_camera::frame(camera, number, time, vec![detection]));
        }
    }
    fusion.snapshot(START.plus_seconds(3.0)).objects
}

fn ids(objects: &[ObjectState], trust: u8) -> Vec<u64> {
    objects.iter().filter(|it| it.trust == trust).map(|it| it.id.0).collect()
}

#[test]
fn a_robot_seen_only_by_a_low_rank_is_marked() {
    let objects = robot_by([(CameraId(1), 0.0, 3.0), (CameraId(0), 9.0, 9.0)]);
    assert_eq!((objects.len(), objects[0].trust), (1, 0), "{objects:?}");
}

#[test]
fn a_spoofed_robot_yields_its_id_to_the_true_one() {
    let objects = robot_by([(CameraId(1), 0.0, 3.0), (CameraId(0), 1.0, 3.0)]);
    // The spoof had the id of code 7 for a second.
    assert_eq!(ids(&objects, 1), [1], "{objects:?}");
    assert!(!ids(&objects, 0).contains(&1), "{objects:?}");
}

#[test]
fn a_spoof_does_not_take_the_id_of_an_observed_robot() {
    let objects = robot_by([(CameraId(1), 1.0, 3.0), (CameraId(0), 0.0, 3.0)]);
    assert_eq!(ids(&objects, 1), [1], "{objects:?}");
    assert!(!ids(&objects, 0).contains(&1), "{objects:?}");
}

#[test]
fn removing_a_camera_resets_its_rank() {
    let mut fusion = roundel_camera::fusion();
    fusion.set_trust(CameraId(0), 0);
    fusion.remove_camera(CameraId(0));
    let world_from_camera = roundel_camera::stationary_camera(roundel_camera::STATIONARY[0]);
    let placement = CameraPlacement { world_from_camera, covariance: Covariance6::zeros() };
    fusion.set_camera(CameraId(0), Some(placement));
    let mut sensor = roundel_camera::RoundelCamera::new(1);
    for number in 1..10_u64 {
        let time = START.plus_seconds(number as f64 / 30.0);
        let detection = sensor.detect(&below(), time, 1, None);
        fusion.observe(&roundel_camera::frame(CameraId(0), number, time, vec![detection]));
    }
    assert_eq!(fusion.snapshot(START.plus_seconds(0.35)).objects[0].trust, 1);
}
