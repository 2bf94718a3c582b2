//! Cameras that are bumped: noticed, out of service, found again; and who is at fault if that can be known.

use nalgebra::Vector3;
use roundel_core::{
    calib::watch::{WatchEvent, WatchParams},
    id::{CameraId, KindId},
    marker::Code,
    world::Landmark,
};
use roundel_tests::{
    arena::Path,
    healing::{Healing, Move, Outcome},
    normal::Random,
};

const NOISE_PX: f64 = 0.03;
const SECONDS: f64 = 45.0;

fn bumped(mut healing: Healing, cameras: &[u32], size: (f64, f64)) -> Outcome {
    let mut random = Random::new(healing.arena.seed, 78);
    for camera in cameras {
        healing.moves.push(Move::bump(CameraId(*camera), 10.03, size, &mut random));
    }
    healing.run(WatchParams::default(), SECONDS)
}

#[test]
fn a_bumped_camera_heals() {
    for (seed, size) in [(1, (0.02, 0.0)), (2, (0.0, 1f64.to_radians())), (3, (0.01, 0.0))] {
        let outcome = bumped(Healing::r4(seed, 30.0, NOISE_PX), &[seed as u32 % 4], size);
        assert!(outcome.is_healed(), "seed {seed}: {outcome:?}");
    }
}

#[test]
fn a_quarter_of_an_hour_without_a_bump_has_none() {
    let healing = Healing::r4(5, 12.0, NOISE_PX);
    let outcome = healing.run(WatchParams::default(), 900.0);
    assert!(outcome.events.is_empty(), "{outcome:?}");
}

#[test]
fn bumps_one_after_another_heal() {
    let healing = Healing::r4(6, 12.0, NOISE_PX).with_bumps(6, 900.0);
    let outcome = healing.run(WatchParams::default(), 900.0);
    assert!(outcome.is_healed() && outcome.worst_m < 1e-3, "{outcome:?}");
}

#[test]
fn two_cameras_alone_contradict_and_a_reference_decides() {
    let mut healing = Healing::r4(1, 60.0, NOISE_PX);
    healing.arena.sites.truncate(2);
    let outcome = bumped(healing.clone(), &[1], (0.02, 0.0));
    let cameras = vec![CameraId(0), CameraId(1)];
    let events: Vec<WatchEvent> = outcome.events.into_iter().map(|(_, event)| event).collect();
    assert_eq!(events, [WatchEvent::Contradiction { cameras }]);

    let place_m = Vector3::new(0.0, -1.0, 0.0);
    healing.arena.add_robot(Path::still(place_m));
    let reference = healing.arena.robots.last().unwrap();
    let code = reference.code.map(|number| Code { bits: 8, number });
    healing.landmarks.push(Landmark::new(KindId(0), code, place_m));
    let outcome = bumped(healing, &[1], (0.02, 0.0));
    assert!(outcome.is_healed(), "{outcome:?}");
}
