//! Limits and invariants of scenarios.

use super::*;
use crate::CameraMount;
use roundel_vision::marker::CodeLayout;

/// Instants over ten minutes, and one a month later.
fn instants() -> impl Iterator<Item = f64> {
    (0..1500).map(|i| f64::from(i) * 0.4 - 1.0).chain([2.6e6])
}

#[test]
fn velocities_are_derivatives_of_poses() {
    let scenario = Scenario::r4_lite(11);
    let step_s = 1e-4;
    for time_s in instants().step_by(37).take_while(|&t| t < 1e4) {
        let (before, here, after) = (
            scenario.truth(time_s - step_s),
            scenario.truth(time_s),
            scenario.truth(time_s + step_s),
        );
        for ((before, here), after) in before.iter().zip(&here).zip(&after) {
            let place = |truth: &RobotTruth| truth.world_from_roundel.translation.vector;
            let velocity = (place(after) - place(before)) / (2.0 * step_s);
            assert!((velocity - here.velocity_m_s).norm() < 1e-6, "{here:?}: {velocity}");
            let acceleration = (after.velocity_m_s - before.velocity_m_s) / (2.0 * step_s);
            assert!((acceleration - here.acceleration_m_s2).norm() < 1e-6, "{here:?}");
            let turn = |truth: &RobotTruth| truth.world_from_roundel.rotation;
            let rate = (turn(after) * turn(before).inverse()).scaled_axis() / (2.0 * step_s);
            assert!((rate - here.angular_velocity_rad_s).norm() < 1e-5, "{here:?}: {rate}");
        }
    }
}

/// Checks limits and distances of all robots at an instant.
fn check_traffic(scenario: &Scenario, time_s: f64) {
    let params = scenario.params();
    let robots = scenario.truth(time_s);
    for (i, robot) in robots.iter().enumerate() {
        let seed = params.seed;
        let place = robot.world_from_roundel.translation.vector;
        let half_m = params.arena_m.map(|side| side / 2.0);
        let inside = place.x.abs() < half_m[0] && place.y.abs() < half_m[1];
        assert!(inside, "seed {seed}, {time_s} s: {robot:?}");
        let acceleration = robot.acceleration_m_s2.norm();
        assert!(acceleration <= params.acceleration_limit_m_s2, "{robot:?}");
        let up = (robot.world_from_roundel.rotation * Vector3::z()).z;
        if robot.flying {
            assert!((1.0..=params.flying_top_m).contains(&place.z), "{robot:?}");
            assert!(up > 15f64.to_radians().cos(), "{robot:?}");
        } else {
            assert_eq!(place.z, params.roundel_height_m);
            assert!((up - 1.0).abs() < 1e-12);
        }
        for other in &robots[..i] {
            let gap_m = (other.world_from_roundel.translation.vector - place).norm();
            assert!(
                gap_m > 0.4,
                "seed {seed}, {time_s} s: {} and {} are {gap_m} m apart",
                other.index,
                robot.index
            );
        }
    }
}

#[test]
fn robots_keep_limits_and_distance() {
    for seed in 1..=6 {
        let scenario = Scenario::r4_lite(seed);
        instants().for_each(|time_s| check_traffic(&scenario, time_s));
    }
}

#[test]
fn a_large_arena_takes_two_hundred_robots() {
    let mut params = ScenarioParams::r4(1);
    params.arena_m = [24.0, 18.0];
    let rows = [-6.75, -2.25, 2.25, 6.75];
    params.mounts = [-9.0, -3.0, 3.0, 9.0]
        .into_iter()
        .flat_map(|x| rows.map(|y| [x, y]))
        .map(|[x, y]| CameraMount { position_m: [x, y, 8.0], target_m: [0.9 * x, 0.9 * y, 0.0] })
        .collect();
    (params.robots, params.still) = (200, 20);
    params.kinds[0].pattern = Pattern::Coded(CodeLayout { bits: 12, min_distance: 1 });
    let scenario = Scenario::new(params).unwrap();
    for time_s in instants().step_by(50) {
        check_traffic(&scenario, time_s);
        for robot in scenario.truth(time_s) {
            let seen = scenario.cameras().iter().any(|camera| scenario.in_view(camera, &robot));
            assert!(seen, "{time_s} s: {robot:?}");
        }
    }
}

#[test]
fn a_dense_crowd_still_keeps_its_distance() {
    let mut params = ScenarioParams::r4_lite(5);
    // The maximum number.
    (params.flying_share, params.still, params.acceleration_limit_m_s2) = (0.0, 8, 0.2);
    params.robots = 400;
    let Err(ScenarioError::Crowded { max, .. }) = Scenario::new(params.clone()) else {
        panic!("400 robots do not fit")
    };
    params.robots = max + params.still;
    let scenario = Scenario::new(params).unwrap();
    instants().step_by(3).for_each(|time_s| check_traffic(&scenario, time_s));
}

#[test]
fn roles_are_assigned_as_configured() {
    let robots = Scenario::r4_lite(2).truth(5.0);
    assert_eq!(robots.len(), 24);
    assert_eq!(robots.iter().filter(|robot| robot.flying).count(), 8);
    assert_eq!(robots.iter().filter(|robot| robot.still).count(), 4);
    let fast = |robot: &RobotTruth| robot.velocity_m_s.norm() > 0.05;
    assert!(robots.iter().filter(|robot| !robot.still).all(fast));
}

#[test]
fn every_robot_is_visible_unless_occluded() {
    let (mut shown, mut hidden) = (0, 0);
    for seed in 1..=3 {
        let scenario = Scenario::r4_lite(seed);
        for time_s in instants().step_by(3) {
            for robot in scenario.truth(time_s) {
                let viewers: Vec<&SimCamera> = scenario
                    .cameras()
                    .iter()
                    .filter(|camera| scenario.in_view(camera, &robot))
                    .collect();
                assert!(!viewers.is_empty(), "seed {seed}, {time_s} s: {robot:?} unseen");
                let clear = viewers
                    .iter()
                    .filter(|camera| !scenario.is_hidden(camera, &robot, time_s))
                    .count();
                shown += usize::from(clear > 0);
                hidden += viewers.len() - clear;
            }
        }
    }
    let all = 3 * instants().step_by(3).count() * 24;
    assert!(hidden > 0, "nothing is ever hidden");
    assert!(shown as f64 > 0.97 * all as f64, "{shown} of {all} robots shown");
    assert!(shown < all, "occlusions never hide a robot from all cameras");
}

#[test]
fn cameras_are_not_synchronized() {
    let scenario = Scenario::r4_lite(3);
    let cameras = scenario.cameras();
    assert_eq!(cameras.len(), 4);
    for (i, camera) in cameras.iter().enumerate() {
        assert!(camera.phase_s.abs() <= 0.040);
        assert!((camera.rate_hz / 30.0 - 1.0).abs() <= 50e-6);
        assert!(cameras[..i].iter().all(|other| other.phase_s != camera.phase_s));
        let between = camera.frame_time_s(31) - camera.frame_time_s(30);
        assert!((between * 30.0 - 1.0).abs() < 1e-4);
        let rows = camera.row_time_s(0.0, 719.0) - camera.row_time_s(0.0, 0.0);
        assert!((rows - 719.0 * 12e-6).abs() < 1e-12);
    }
}

#[test]
fn a_boom_hides_what_lies_behind_it() {
    let scenario = Scenario::r4_lite(3);
    let boom = scenario.booms_at(7.0)[0];
    let camera = &scenario.cameras()[0];
    let eye = camera.world_from_camera.translation.vector;
    let behind = eye + (boom.world_from_boom.translation.vector - eye) * 1.2;
    let mut robot = scenario.robot(0, 7.0);
    robot.world_from_roundel = Rigid::translation(behind.x, behind.y, behind.z);
    assert!(scenario.is_hidden(camera, &robot, 7.0));
    let before = eye + (behind - eye) * 0.5;
    robot.world_from_roundel = Rigid::translation(before.x, before.y, before.z);
    assert!(!scenario.is_hidden(camera, &robot, 7.0));
}

#[test]
fn too_many_robots_are_rejected_with_the_maximum() {
    let mut params = ScenarioParams::r4_lite(1);
    params.robots = 400;
    let Err(ScenarioError::Crowded { max, .. }) = Scenario::new(params.clone()) else {
        panic!("400 robots do not fit")
    };
    params.robots = max + params.still;
    params.flying_share = 0.0;
    assert!(Scenario::new(params.clone()).is_ok());
    params.robots += 1;
    assert!(Scenario::new(params).is_err());
}

#[test]
fn cameras_that_see_nothing_of_the_arena_are_rejected() {
    let mut params = ScenarioParams::r4_lite(1);
    for mount in &mut params.mounts {
        mount.target_m = [mount.position_m[0] * 4.0, mount.position_m[1] * 4.0, 4.0];
    }
    assert!(matches!(Scenario::new(params), Err(ScenarioError::Uncovered { .. })));
}

#[test]
fn a_driven_robot_leaves_its_path_smoothly() {
    for mut scenario in [Scenario::r4_lite(3), Scenario::r4(4)] {
        let undisturbed = scenario.clone();
        let robots = scenario.truth(5.0).len();
        for index in 0..robots {
            let velocity_m_s = Vector3::new(0.3, -0.2, 0.0);
            scenario.drive(index, Drive { velocity_m_s, span_s: [5.0, 7.0] });
        }
        assert_eq!(scenario.truth(4.99), undisturbed.truth(4.99));
        for (before, after) in scenario.truth(5.0 - 1e-6).iter().zip(scenario.truth(5.0 + 1e-6)) {
            let moved = before.world_from_roundel.translation.vector
                - after.world_from_roundel.translation.vector;
            let turned =
                before.world_from_roundel.rotation.angle_to(&after.world_from_roundel.rotation);
            assert!(moved.norm() < 1e-5 && turned < 1e-4, "{before:?}: {moved}, {turned}");
            assert!((before.acceleration_m_s2 - after.acceleration_m_s2).norm() < 1e-4);
        }
        for robot in scenario.truth(6.9) {
            assert!((robot.velocity_m_s - Vector3::new(0.3, -0.2, 0.0)).norm() < 0.02, "{robot:?}");
            assert!(!robot.still);
        }
        assert!(scenario.truth(11.0).iter().all(|robot| robot.velocity_m_s.norm() < 1e-3));
    }
}
