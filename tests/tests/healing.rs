//! Bumped cameras: detected, taken out of service, and recalibrated; and which camera is at fault where that can be
//! decided.

use nalgebra::Vector3;
use roundel_core::{
    calib::watch::{WatchEvent, WatchParams},
    id::{CameraId, KindId},
    marker::Code,
    world::{FusionParams, Landmark},
};
use roundel_tests::{
    arena::{Course, Path, Sine},
    healing::{BumpSize, Healing, Move, Outcome},
    random::Random,
};

const NOISE_PX: f64 = 0.03;
const SECONDS: f64 = 45.0;

fn bumped(mut healing: Healing, cameras: &[u32], size: BumpSize) -> Outcome {
    let mut random = Random::new(healing.arena.seed, 78);
    for camera in cameras {
        healing.moves.push(Move::bump(CameraId(*camera), 10.03, size, &mut random));
    }
    healing.run(WatchParams::default(), SECONDS)
}

#[test]
fn a_bumped_camera_recovers() {
    for (seed, size) in [
        (1, BumpSize::shift(0.02)),
        (2, BumpSize::turn(1f64.to_radians())),
        (3, BumpSize::shift(0.01)),
    ] {
        let outcome = bumped(Healing::r4(seed, 30.0, NOISE_PX), &[seed as u32 % 4], size);
        assert!(outcome.is_healed(), "seed {seed}: {outcome:?}");
    }
}

#[test]
fn two_cameras_bumped_at_once_recover() {
    let outcome =
        bumped(Healing::r4(4, 60.0, NOISE_PX), &[0, 3], BumpSize { shift_m: 0.02, turn_rad: 0.01 });
    assert!(outcome.is_healed(), "{outcome:?}");
}

#[test]
fn a_quarter_of_an_hour_has_no_false_alarm() {
    let healing = Healing::r4(5, 12.0, NOISE_PX);
    let outcome = healing.run(WatchParams::default(), 900.0);
    assert!(outcome.events.is_empty(), "{outcome:?}");
}

#[test]
fn cameras_recover_from_consecutive_bumps() {
    let healing = Healing::r4(6, 12.0, NOISE_PX).with_bumps(6, 900.0);
    let outcome = healing.run(WatchParams::default(), 900.0);
    assert!(outcome.is_healed() && outcome.worst_m < 1e-3, "{outcome:?}");
}

#[test]
fn two_cameras_alone_contradict_and_a_reference_decides() {
    let mut healing = Healing::r4(1, 60.0, NOISE_PX);
    healing.arena.sites.truncate(2);
    let outcome = bumped(healing.clone(), &[1], BumpSize::shift(0.02));
    let cameras = vec![CameraId(0), CameraId(1)];
    let events: Vec<WatchEvent> = outcome.events.into_iter().map(|(_, event)| event).collect();
    assert_eq!(events, [WatchEvent::Contradiction { cameras }]);

    let place_m = Vector3::new(0.0, -1.0, 0.0);
    healing.arena.add_robot(Path::still(place_m));
    let reference = healing.arena.robots.last().unwrap();
    let code = reference.code.map(|number| Code { bits: 8, number });
    healing.landmarks.push(Landmark::new(KindId(0), code, place_m));
    let outcome = bumped(healing, &[1], BumpSize::shift(0.02));
    assert!(outcome.is_healed(), "{outcome:?}");
}

/// Bar for tracks while a camera is bumped.
const MAX_TRACK_ERROR_M: f64 = 5e-3;

#[test]
fn tracks_stay_right_during_a_bump() {
    let degree = 1f64.to_radians();
    for (seed, size) in [
        (7, BumpSize::shift(0.02)),
        (3, BumpSize::shift(0.02)),
        (7, BumpSize::turn(degree)),
        (3, BumpSize::shift(0.01)),
    ] {
        let mut healing = Healing::r4(seed, 60.0, NOISE_PX);
        let mut random = Random::new(seed, 79);
        let camera = CameraId(seed as u32 % 4);
        healing.moves.push(Move::bump(camera, 6.03, size, &mut random));
        let tracks = healing.track(FusionParams::default(), 30.0);
        let is_right =
            tracks.aftermath_m < MAX_TRACK_ERROR_M && tracks.otherwise_m < MAX_TRACK_ERROR_M;
        assert!(is_right && tracks.returned == 1, "seed {seed}, {size:?}: {tracks:?}");
        assert!(tracks.counts.held_frames > 20, "{tracks:?}");
    }
}

/// Cameras that are pushed aside within 0.3 s, at times at which tracks once followed the wrong camera.
#[test]
fn tracks_stay_right_while_a_camera_is_pushed() {
    for (seed, at_s) in [(2, 5.2), (8, 8.9)] {
        let mut healing = Healing::r4(seed, 60.0, NOISE_PX);
        let mut random = Random::new(seed, 79);
        let push = Move::bump(CameraId(seed as u32 % 4), at_s, BumpSize::shift(0.02), &mut random);
        healing.moves.push(Move { lasts_s: 0.3, ..push });
        let tracks = healing.track(FusionParams::default(), at_s + 3.0);
        assert!(tracks.aftermath_m < MAX_TRACK_ERROR_M, "seed {seed}: {tracks:?}");
        assert!(tracks.counts.held_frames > 20, "{tracks:?}");
    }
}

#[test]
fn cameras_recover_from_bumps_of_millimetres() {
    for (seed, size) in [(1, BumpSize::shift(0.002)), (2, BumpSize::turn(0.03f64.to_radians()))] {
        let mut healing = Healing::r4(seed, 60.0, NOISE_PX);
        let mut random = Random::new(seed, 79);
        healing.moves.push(Move::bump(CameraId(seed as u32 % 4), 90.03, size, &mut random));
        let tracks = healing.track(FusionParams::default(), 112.0);
        let is_right =
            tracks.aftermath_m < MAX_TRACK_ERROR_M && tracks.otherwise_m < MAX_TRACK_ERROR_M;
        assert!(is_right && tracks.returned == 1, "seed {seed}, {size:?}: {tracks:?}");
    }
}

#[test]
fn no_camera_is_held_back_without_a_bump() {
    let tracks = Healing::r4(5, 60.0, NOISE_PX).track(FusionParams::default(), 60.0);
    assert_eq!((tracks.counts.held_frames, tracks.counts.retracted), (0, 0), "{tracks:?}");
}

#[test]
fn no_camera_is_held_back_with_rough_initial_poses() {
    for seed in 1..=2 {
        let healing = Healing::r4(seed, 60.0, NOISE_PX).with_rough_poses(0.03, 0.5f64.to_radians());
        let robots = healing.arena.robots.len() as f64;
        let tracks = healing.track(FusionParams::default(), 20.0);
        assert_eq!((tracks.counts.held_frames, tracks.returned), (0, 0), "{tracks:?}");
        assert!((tracks.tracked - robots).abs() < 0.1 * robots, "of {robots}: {tracks:?}");
    }
}

#[test]
fn robots_that_move_together_are_no_bump() {
    let mut healing = Healing::r4(5, 60.0, NOISE_PX);
    // 2.4 m/s² at most.
    let sway = Sine { amplitude_m: 0.3, rate_rad_s: 2.8, phase_rad: 0.0 };
    for robot in &mut healing.arena.robots {
        let course = Course::Sines([sway, Sine::default(), Sine::default()]);
        robot.path = Path { course, ..Path::still(robot.path.center_m) };
    }
    let tracks = healing.track(FusionParams::default(), 20.0);
    assert_eq!(tracks.counts.held_frames, 0, "{tracks:?}");
}
