//! Cameras that are bumped: noticed, out of service, found again; and who is at fault if that can be known.

use nalgebra::Vector3;
use roundel_core::{
    calib::watch::{Watch, WatchEvent, WatchParams},
    id::{CameraId, KindId},
    marker::Code,
    rigid::Covariance6,
    time::Timestamp,
    world::{CameraPlacement, Fusion, FusionParams, Landmark, LifeStage, ObjectState},
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
fn two_bumped_at_once_heal() {
    let outcome = bumped(Healing::r4(4, 60.0, NOISE_PX), &[0, 3], (0.02, 0.01));
    assert!(outcome.is_healed(), "{outcome:?}");
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

/// What one camera alone sees from afar is off by more, and says so, metres.
const SURE_M: f64 = 1.5e-3;
/// How long a bumped camera's sightings may still count, seconds: until it is noticed, and until what only it
/// saw is forgotten.
const MEANWHILE_S: f64 = 3.0;

/// Largest error of a tracked object that is said to be well known, after the first three seconds, metres: but for a while after each bump,
/// and in it; its cameras are watched, and those that are bumped left out. And how many came back.
fn worst_track(healing: &Healing, seconds: f64) -> ([f64; 2], usize) {
    let start = Timestamp::from_ns(healing.arena.start_ns);
    let mut fusion = Fusion::new(FusionParams::default());
    let mut watch = Watch::new(WatchParams::default());
    for (index, site) in healing.arena.sites.iter().enumerate() {
        let (id, world_from_camera) = (CameraId(index as u32), site.world_from_camera);
        let placement = CameraPlacement { world_from_camera, covariance: Covariance6::zeros() };
        fusion.set_camera(id, Some(placement));
        watch.set_camera(id, placement);
    }
    let (mut next_s, mut worst_m, mut returned) = (3.0, [0.0f64; 2], 0);
    for frame in healing.frames(seconds) {
        watch.observe(&frame, 0.0);
        fusion.observe(&frame);
        let now = frame.received_time;
        for event in watch.advance(now) {
            match event {
                WatchEvent::Bumped { camera, .. } => fusion.set_camera(camera, None),
                WatchEvent::Returned { camera, placement } => {
                    returned += 1;
                    fusion.set_camera(camera, Some(placement));
                }
                WatchEvent::Drifted { camera, placement, .. } => {
                    fusion.set_camera(camera, Some(placement));
                }
                WatchEvent::Contradiction { .. } | WatchEvent::Agreed { .. } => {}
            }
        }
        if now.seconds_since(start) < next_s {
            continue;
        }
        next_s += 1.0 / 60.0;
        let t = now.seconds_since(start);
        let is_meanwhile =
            healing.moves.iter().any(|it| (it.at_s..it.at_s + MEANWHILE_S).contains(&t));
        let worst_m = &mut worst_m[usize::from(is_meanwhile)];
        let truth = healing.arena.truth(now.as_ns());
        let snapshot = fusion.snapshot(now);
        let is_sure = |it: &&ObjectState| {
            let variance = it.covariance.fixed_view::<3, 3>(0, 0).trace();
            it.stage == LifeStage::Tracked && variance < SURE_M * SURE_M
        };
        for object in snapshot.objects.iter().filter(is_sure) {
            let number = object.code.map(|code| code.number);
            let robot = truth.iter().find(|robot| number.is_some() && robot.code == number);
            let Some(robot) = robot else { continue };
            let off_m = (robot.pose.translation.vector - object.position_m).norm();
            *worst_m = worst_m.max(off_m);
        }
    }
    (worst_m, returned)
}

#[test]
fn tracks_are_right_once_a_bump_is_noticed() {
    for (camera, size) in [(1, (0.02, 0.0)), (2, (0.0, 1f64.to_radians()))] {
        let mut healing = Healing::r4(7, 60.0, NOISE_PX);
        let mut random = Random::new(camera, 79);
        healing.moves.push(Move::bump(CameraId(camera as u32), 6.03, size, &mut random));
        let ([worst_m, meanwhile_m], returned) = worst_track(&healing, 30.0);
        println!(
            "{size:?}: {:.2} mm, {:.1} mm just after the bump",
            worst_m * 1e3,
            meanwhile_m * 1e3
        );
        assert!(worst_m < 5e-3, "{size:?}: {worst_m} m");
        assert_eq!(returned, 1);
    }
}
