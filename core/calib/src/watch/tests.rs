use nalgebra::{UnitQuaternion, Vector3};

use super::*;
use crate::test_world::{KIND, Random, SIGMA_M, at, detection, frame};
use roundel_vision::{marker::Code, pose::Detection};

const FRAME_S: f64 = 1.0 / 30.0;

/// Cameras side by side, 4 m up and looking down, and robots that circle below all of them.
struct World {
    truth: Vec<Rigid>,
    robots: usize,
    is_coded: bool,
    random: Random,
}

impl World {
    fn new(cameras: usize) -> Self {
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let pose = |index: usize| {
            Rigid::from_parts(Vector3::new(0.8 * index as f64, 0.0, 4.0).into(), down)
        };
        Self {
            truth: (0..cameras).map(pose).collect(),
            robots: 6,
            is_coded: true,
            random: Random(1),
        }
    }

    fn watch(&self) -> Watch {
        let mut watch = Watch::new(WatchParams::default());
        for (index, pose) in self.truth.iter().enumerate() {
            watch.set_camera(CameraId(index as u32), placement(pose));
        }
        watch
    }

    fn robot(index: usize, t: f64) -> Vector3<f64> {
        let phase = index as f64 * 1.3;
        let (sin, cos) = (0.9 * t + phase).sin_cos();
        let middle = Vector3::new(0.9 * (index % 3) as f64 - 0.5, 0.9 * (index / 3) as f64, 0.3);
        middle + Vector3::new(0.2 * cos, 0.2 * sin, 0.0)
    }

    fn world_view(&mut self, camera: usize, t: f64) -> Vec<Detection> {
        let mut seen = Vec::new();
        for robot in 0..self.robots {
            let place_m =
                self.truth[camera].inverse() * nalgebra::Point3::from(Self::robot(robot, t));
            let error = Vector3::from_fn(|_, _| self.random.next() * SIGMA_M);
            let number = robot as u16 + 1;
            let code = self.is_coded.then_some(Code { bits: 8, number });
            seen.push(detection(robot as u64 + 1, code, place_m.coords + error, at(t)));
        }
        seen
    }

    /// Runs from one time to another; `change` may alter the detections.
    fn run(
        &mut self,
        watch: &mut Watch,
        (from_s, to_s): (f64, f64),
        change: impl Fn(usize, &mut Vec<Detection>),
    ) -> Vec<WatchEvent> {
        let mut events = Vec::new();
        let (first, last) = ((from_s / FRAME_S) as usize, (to_s / FRAME_S) as usize);
        for number in first..last {
            for camera in 0..self.truth.len() {
                // Frames of different cameras are not simultaneous.
                let t = (number as f64 + 0.37 * camera as f64) * FRAME_S;
                let mut detections = self.world_view(camera, t);
                change(camera, &mut detections);
                watch.observe(&frame(camera, number as u64, at(t), detections), 0.0);
            }
            events.extend(watch.advance(at((number + 1) as f64 * FRAME_S)));
        }
        events
    }

    fn bump(&mut self, camera: usize) {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.01, -0.004, 0.0));
        self.truth[camera] *= Rigid::from_parts(Vector3::new(0.01, 0.0, 0.005).into(), turn);
    }
}

fn placement(pose: &Rigid) -> CameraPlacement {
    CameraPlacement { world_from_camera: *pose, covariance: Matrix6::zeros() }
}

fn assert_healed(world: &mut World) {
    let mut watch = world.watch();
    assert_eq!(world.run(&mut watch, (0.0, 4.0), |_, _| ()), []);
    assert_eq!(watch.health(CameraId(1)).unwrap().state, WatchState::Watched);
    world.bump(1);
    let events = world.run(&mut watch, (4.0, 6.0), |_, _| ());
    let [WatchEvent::Bumped { camera: CameraId(1), moved_m, turned_rad }] = events[..] else {
        panic!("{events:?}")
    };
    assert!((moved_m - 0.0112).abs() < 4e-3 && (turned_rad - 0.0108).abs() < 1e-3);
    assert_eq!(watch.health(CameraId(1)).unwrap().state, WatchState::Quarantined);
    let events = world.run(&mut watch, (6.0, 30.0), |_, _| ());
    let [WatchEvent::Returned { camera: CameraId(1), placement }] = events[..] else {
        panic!("{events:?}")
    };
    let error = placement.world_from_camera.inverse() * world.truth[1];
    assert!(error.translation.vector.norm() < 1e-3 && error.rotation.angle() < 3e-4, "{error}");
    // Setting the same pose keeps the evidence.
    watch.set_camera(CameraId(1), placement);
    assert_eq!(watch.health(CameraId(1)).unwrap().state, WatchState::Watched);
}

#[test]
fn a_bumped_camera_is_found_and_returns() {
    assert_healed(&mut World::new(3));
}

#[test]
fn roundels_without_codes_will_do() {
    assert_healed(&mut World { is_coded: false, ..World::new(3) });
}

#[test]
fn a_contradiction_of_two_cameras_corrects_neither() {
    let mut world = World::new(2);
    let mut watch = world.watch();
    assert_eq!(world.run(&mut watch, (0.0, 4.0), |_, _| ()), []);
    world.bump(0);
    let cameras = vec![CameraId(0), CameraId(1)];
    let events = world.run(&mut watch, (4.0, 10.0), |_, _| ());
    assert_eq!(events, [WatchEvent::Contradiction { cameras: cameras.clone() }]);
    assert_eq!(watch.health(CameraId(0)).unwrap().state, WatchState::Suspected);
    world.truth[0] = World::new(2).truth[0];
    let events = world.run(&mut watch, (10.0, 18.0), |_, _| ());
    assert_eq!(events, [WatchEvent::Agreed { cameras }]);
}

#[test]
fn a_reference_identifies_which_of_two_moved() {
    let mut world = World::new(2);
    let mut watch = world.watch();
    let reference_m = Vector3::new(0.3, 0.2, 0.0);
    let code = Code { bits: 8, number: 99 };
    let landmark = Landmark::new(KIND, Some(code), reference_m);
    watch.set_landmarks(&[landmark]);
    let poses = world.truth.clone();
    let with_reference = |truth: Vec<Rigid>| {
        move |camera: usize, seen: &mut Vec<Detection>| {
            let place_m = truth[camera].inverse() * nalgebra::Point3::from(reference_m);
            let time = seen[0].capture_time;
            seen.push(detection(99, Some(code), place_m.coords, time));
        }
    };
    assert_eq!(world.run(&mut watch, (0.0, 4.0), with_reference(poses)), []);
    world.bump(1);
    let truth = world.truth.clone();
    let events = world.run(&mut watch, (4.0, 7.0), with_reference(truth));
    assert!(matches!(events[..], [WatchEvent::Bumped { camera: CameraId(1), .. }]), "{events:?}");
}

#[test]
fn a_code_shown_twice_has_no_effect() {
    let mut world = World::new(3);
    let mut watch = world.watch();
    // Camera 2 sees another roundel with the code of the first, which it does not see.
    let events = world.run(&mut watch, (0.0, 10.0), |camera, seen| {
        if camera == 2 {
            seen[0].pose.as_mut().unwrap().position_m.x += 0.7;
        }
    });
    assert_eq!(events, []);
}

#[test]
fn a_camera_without_common_roundels_is_alone() {
    let mut world = World::new(3);
    let mut watch = world.watch();
    let events = world.run(&mut watch, (0.0, 8.0), |camera, seen| {
        if camera == 2 {
            seen.clear();
        }
    });
    assert_eq!(events, []);
    assert_eq!(watch.health(CameraId(2)).unwrap().state, WatchState::Alone);
    assert_eq!(watch.health(CameraId(1)).unwrap().state, WatchState::Watched);
    assert_eq!(watch.health(CameraId(7)), None);
}

#[test]
fn drift_is_followed() {
    let mut world = World::new(3);
    let mut watch = world.watch();
    assert_eq!(world.run(&mut watch, (0.0, 60.0), |_, _| ()), []);
    let still = world.truth.clone();
    for step in 0..12 {
        world.truth[2].translation.vector.x += 2.5e-4;
        let from_s = 60.0 + 20.0 * f64::from(step);
        for event in world.run(&mut watch, (from_s, from_s + 20.0), |_, _| ()) {
            assert!(matches!(event, WatchEvent::Drifted { camera: CameraId(2), .. }), "{event:?}");
        }
    }
    let found = watch.slots[2].placement.world_from_camera;
    let error_m = (found.translation.vector - world.truth[2].translation.vector).norm();
    let way_m = (still[2].translation.vector - world.truth[2].translation.vector).norm();
    assert!(error_m < 1e-3 && way_m > 2.9e-3, "{error_m}");
    assert_eq!(watch.slots[0].placement.world_from_camera, still[0]);
}

#[test]
fn the_covariance_does_not_grow_with_every_recovery() {
    let mut world = World::new(4);
    let mut watch = world.watch();
    let mut spread = Vec::new();
    for turn in 0..6 {
        let from_s = 40.0 * f64::from(turn);
        let events = world.run(&mut watch, (from_s, from_s + 5.0), |_, _| ());
        assert_eq!(events, []);
        world.bump(1);
        for event in world.run(&mut watch, (from_s + 5.0, from_s + 40.0), |_, _| ()) {
            if let WatchEvent::Returned { placement, .. } = event {
                spread.push(placement.covariance.fixed_view::<3, 3>(0, 0).trace());
            }
        }
    }
    assert_eq!(spread.len(), 6);
    assert!(spread[5] < 1.5 * spread[0] && spread[0] > 0.0, "{spread:?}");
}

#[test]
fn a_new_pose_of_one_camera_keeps_the_evidence_about_others() {
    let mut world = World::new(4);
    let mut watch = world.watch();
    assert_eq!(world.run(&mut watch, (0.0, 30.0), |_, _| ()), []);
    let before = watch.health(CameraId(2)).unwrap();
    let camera = CameraId(0);
    world.bump(0);
    watch.set_camera(camera, placement(&world.truth[0]));
    let states = [0, 2].map(|camera| watch.health(CameraId(camera)).unwrap().state);
    assert_eq!(states, [WatchState::Alone, WatchState::Watched]);
    let after = watch.health(CameraId(2)).unwrap();
    let growth = after.deviation_m / before.deviation_m;
    assert!((1.0..3.0).contains(&growth), "{before:?} {after:?}");
    assert_eq!(world.run(&mut watch, (30.0, 40.0), |_, _| ()), []);
    assert_eq!(watch.health(camera).unwrap().state, WatchState::Watched);
}

fn is_noticed(world: &mut World, watch: &mut Watch, from_s: f64) -> bool {
    world.bump(2);
    let events = world.run(watch, (from_s, from_s + 2.0), |_, _| ());
    matches!(events[..], [WatchEvent::Bumped { camera: CameraId(2), .. }])
}

#[test]
fn a_wrong_manual_pose_is_reported_and_not_corrected() {
    let mut world = World::new(4);
    let mut watch = world.watch();
    let rough = Rigid::translation(0.07, -0.03, 0.1);
    watch.set_camera(CameraId(1), placement(&(rough * world.truth[1])));
    (0..4).for_each(|camera| watch.distrust(CameraId(camera)));
    let cameras = (0..4).map(CameraId).collect();
    let events = world.run(&mut watch, (0.0, 20.0), |_, _| ());
    assert_eq!(events, [WatchEvent::Misplaced { cameras }]);
    // A calibration corrects the pose.
    watch.set_camera(CameraId(1), placement(&world.truth[1]));
    assert_eq!(world.run(&mut watch, (20.0, 30.0), |_, _| ()), []);
    assert!(is_noticed(&mut world, &mut watch, 30.0));
}

#[test]
fn a_correct_manual_pose_is_supervised() {
    let mut world = World::new(4);
    let mut watch = world.watch();
    (0..4).for_each(|camera| watch.distrust(CameraId(camera)));
    assert_eq!(world.run(&mut watch, (0.0, 10.0), |_, _| ()), []);
    assert!(is_noticed(&mut world, &mut watch, 10.0));
}

#[test]
fn a_held_camera_has_a_lower_threshold() {
    for is_held in [false, true] {
        let mut world = World::new(3);
        let mut watch = world.watch();
        assert_eq!(world.run(&mut watch, (0.0, 80.0), |_, _| ()), []);
        world.truth[1].translation.vector.x += 0.003;
        watch.hold(CameraId(1), is_held);
        let events = world.run(&mut watch, (80.0, 83.0), |_, _| ());
        let is_bumped = matches!(events[..], [WatchEvent::Bumped { camera: CameraId(1), .. }]);
        assert!(if is_held { is_bumped } else { events.is_empty() }, "{is_held}: {events:?}");
    }
}
