//! Headings with a symmetry of half a turn: the first one is kept, and the tracked point lies to one side or the other.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::{UnitQuaternion, Vector3};
use roundel_core::{
    id::KindId,
    rigid::{UNKNOWN_ANGLE_VARIANCE_RAD2, orientation_of_normal},
    time::Timestamp,
    world::{FrameObservations, FusionParams},
};

use super::{
    arena::{Arena, START, Setting},
    score::fusion_of,
};

const RATE_RAD_S: f64 = 1.3;
/// Standard deviation of a heading.
const NOISE_RAD: f64 = 0.02;

fn setting() -> Setting {
    Setting { objects: 1, still: 1, cameras: 4, dropout: 0.0, ..Setting::default() }
}

/// World from roundel.
fn truth(arena: &Arena, time: Timestamp) -> UnitQuaternion<f64> {
    let heading_rad = RATE_RAD_S * 1e-9 * time.ns_since(START) as f64;
    orientation_of_normal(&arena.truth(0, time).normal)
        * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading_rad)
}

/// Reports yaws from -π/2 to π/2, since half a turn about the normal is invisible.
fn with_headings(arena: &Arena, frames: &mut [FrameObservations]) {
    for (count, frame) in frames.iter_mut().enumerate() {
        let placement = arena.placements[frame.camera.0 as usize].world_from_camera;
        for detection in &mut frame.detections {
            let Some(pose) = &mut detection.pose else { continue };
            let camera_from_roundel =
                placement.rotation.inverse() * truth(arena, detection.capture_time);
            let (x, z) = (camera_from_roundel * Vector3::x(), camera_from_roundel * Vector3::z());
            // The other normal has the same direction in the image.
            let line_of_sight = pose.position_m.normalize();
            let is_right = pose.normal.dot(&z) > pose.other_normal.dot(&z);
            let x = if is_right { x } else { x - line_of_sight * (2.0 * line_of_sight.dot(&x)) };
            let in_plane = orientation_of_normal(&pose.normal).inverse() * x;
            let noise_rad = NOISE_RAD * (1.7 * count as f64).sin() * 2f64.sqrt();
            let yaw_rad = in_plane.y.atan2(in_plane.x) + noise_rad;
            pose.yaw_rad = Some((yaw_rad + FRAC_PI_2).rem_euclid(PI) - FRAC_PI_2);
            pose.yaw_symmetry = 2;
            let about = pose.normal * pose.normal.transpose();
            let mut rotation = pose.covariance.fixed_view_mut::<3, 3>(3, 3);
            rotation += about * (NOISE_RAD * NOISE_RAD - UNKNOWN_ANGLE_VARIANCE_RAD2);
        }
    }
}

#[test]
fn a_heading_is_kept_through_half_turns() {
    let arena = Arena::new(setting());
    let mut frames = arena.frames(8.0);
    with_headings(&arena, &mut frames);
    let mut fusion = fusion_of(&arena, FusionParams::default());
    let (mut sides, mut turning_rad_s) = (Vec::new(), 0.0);
    for frame in &frames {
        fusion.observe(frame);
        let time = frame.capture_time;
        // Until the angular velocity is known, the prediction stands still.
        if time < START.plus_seconds(2.0) {
            continue;
        }
        let snapshot = fusion.snapshot(time);
        let [object] = &snapshot.objects[..] else { panic!("{snapshot:?}") };
        assert!(object.yaw_observed);
        assert_eq!(object.yaw_symmetry, 2);
        let off = truth(&arena, time).inverse() * object.orientation;
        let x = off * Vector3::x();
        let off_rad = x.y.atan2(x.x);
        let opposite = off_rad.abs() > FRAC_PI_2;
        let error_rad = if opposite { PI - off_rad.abs() } else { off_rad.abs() };
        assert!(error_rad < 0.1, "{error_rad} at {time:?}");
        sides.push(opposite);
        turning_rad_s += object.angular_velocity_rad_s.dot(&(object.orientation * Vector3::z()));
    }
    assert!(RATE_RAD_S * 6.0 > TAU && sides.len() > 100);
    let turning_rad_s = turning_rad_s / sides.len() as f64;
    assert!((turning_rad_s - RATE_RAD_S).abs() < 0.1, "{turning_rad_s}");
    assert!(sides.iter().all(|side| *side == sides[0]), "it turned round");
}

#[test]
fn the_tracked_point_lies_to_one_side_or_the_other() {
    let arena = Arena::new(setting());
    let mut frames = arena.frames(2.0);
    with_headings(&arena, &mut frames);
    let mut fusion = fusion_of(&arena, FusionParams::default());
    frames.iter().for_each(|frame| fusion.observe(frame));
    let time = START.plus_seconds(2.0);
    let center = fusion.snapshot(time).objects[0].clone();
    fusion.set_offset(KindId(0), Vector3::new(0.05, 0.0, -0.1));
    let point = fusion.snapshot(time).objects[0].clone();
    let below = center.orientation * Vector3::new(0.0, 0.0, -0.1);
    assert!((point.position_m - center.position_m - below).norm() < 1e-9);
    let grown = (point.covariance - center.covariance).fixed_view::<3, 3>(0, 0).into_owned();
    let along = |axis: Vector3<f64>| {
        let axis = center.orientation * axis;
        axis.dot(&(grown * axis))
    };
    assert!(along(Vector3::x()) > 0.9 * 0.05 * 0.05, "{grown}");
    assert!(along(Vector3::y()) < 0.3 * 0.05 * 0.05, "{grown}");
}
