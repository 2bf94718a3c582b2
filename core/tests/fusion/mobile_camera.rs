//! Cameras on moving objects: their detections are located through their carriers.

use nalgebra::{UnitQuaternion, Vector3};
use roundel_core::{
    id::CameraId,
    rigid::Rigid,
    time::Timestamp,
    world::{Body, CameraMount, Carrier, Fusion, MotionClass, Mount, Unplaced},
};

use super::{
    arena::START,
    roundel_camera::{
        DRONE, ErrorStatistics, KIND, ONBOARD, RoundelCamera, STATIONARY, carrier, code, downwards,
        frame, fusion, mount, own, stationary_camera,
    },
};

/// A drone that moves to and fro, turns and leans.
fn drone(t: f64) -> Rigid {
    let place =
        Vector3::new(1.2 * (0.9 * t).sin(), 0.9 * (0.7 * t).cos(), 2.0 + 0.2 * (1.1 * t).sin());
    let lean =
        UnitQuaternion::from_euler_angles(0.07 * (0.9 * t).sin(), 0.05 * (0.7 * t).cos(), 0.3 * t);
    Rigid::from_parts(place.into(), lean)
}

/// A robot that drives slowly on the floor.
fn robot(number: u16, t: f64) -> Rigid {
    let at = f64::from(number);
    let place = Vector3::new(
        0.4 * (at * 1.7).sin() + 0.2 * (0.5 * t + at).sin(),
        0.4 * (at * 2.3).cos() + 0.2 * (0.6 * t + at).cos(),
        0.2,
    );
    Rigid::from_parts(place.into(), UnitQuaternion::from_euler_angles(0.0, 0.0, at + 0.2 * t))
}

const ROBOTS: std::ops::RangeInclusive<u16> = 11..=14;

/// Twelve frames of each stationary camera for every six of the drone's; `with_code`: whether the drone's code is
/// read.
fn fly(
    fusion: &mut Fusion,
    seconds: f64,
    with_code: bool,
    mut observe: impl FnMut(&mut Fusion, Timestamp),
) {
    let mut sensors: Vec<RoundelCamera> = (0..5).map(|seed| RoundelCamera::new(seed + 1)).collect();
    for step in 0..(seconds * 120.0) as u64 {
        let t = step as f64 / 120.0;
        let time = START.plus_seconds(t);
        if step % 4 == 2 {
            let camera_from_world = (drone(t) * downwards(0.1)).inverse();
            let detections = ROBOTS
                .map(|number| {
                    let camera_from_roundel = camera_from_world * robot(number, t);
                    sensors[4].detect(&camera_from_roundel, time, number.into(), Some(code(number)))
                })
                .collect();
            fusion.observe(&frame(ONBOARD, step / 4 + 1, time, detections));
        } else if step % 4 != 3 {
            let camera = (step % 4 + step / 4 % 2 * 2) as usize % 4;
            let camera_from_roundel = stationary_camera(STATIONARY[camera]).inverse() * drone(t);
            let read = with_code.then(|| code(DRONE));
            let detection = sensors[camera].detect(&camera_from_roundel, time, 1, read);
            fusion.observe(&frame(CameraId(camera as u32), step + 1, time, vec![detection]));
        }
        observe(fusion, time);
    }
}

#[test]
fn a_drones_detections_are_consistent() {
    let mut fusion = fusion();
    fusion.set_mount(ONBOARD, Some(mount()));
    let (mut robots, mut place) = (ErrorStatistics::default(), ErrorStatistics::default());
    fly(&mut fusion, 20.0, true, |fusion, time| {
        let t = time.seconds_since(START);
        if t < 1.0 {
            return;
        }
        let snapshot = fusion.snapshot(time);
        for number in ROBOTS {
            robots.add(own(&snapshot.objects, number).unwrap(), |t| robot(number, t), t);
        }
        place.add(own(&snapshot.objects, DRONE).unwrap(), drone, t);
        let camera = fusion.camera_placement(ONBOARD, time).unwrap();
        let off = camera.world_from_camera.inverse() * drone(t) * downwards(0.1);
        assert!(off.translation.vector.norm() < 0.05 && off.rotation.angle() < 0.1, "{off}");
    });
    let shares = robots.shares();
    println!("robots {shares:.3?} {:.1} mm, drone {:.3?}", robots.rms_mm(), place.shares());
    assert!(shares.iter().all(|share| (0.92..=0.995).contains(share)), "{shares:?}");
    assert!(robots.rms_mm() < 25.0, "{}", robots.rms_mm());
    assert_eq!(fusion.counts().begun, 5, "{:?}", fusion.counts());
}

/// A drone configured as a body, with its roundel and camera relative to its centre.
#[test]
fn a_body_may_carry_a_camera() {
    for by_roundel in [false, true] {
        let mut fusion = fusion();
        let turn = UnitQuaternion::from_euler_angles(0.1, 0.0, 0.7);
        let object_from_roundel = Rigid::from_parts(Vector3::new(0.3, 0.1, 0.05).into(), turn);
        let mounts = vec![Mount { kind: KIND, code: Some(code(DRONE)), object_from_roundel }];
        let body = fusion.add_body(Body { motion: MotionClass::Free, mounts }).unwrap();
        let object_from_camera = object_from_roundel * downwards(0.1);
        let on_body = CameraMount { carrier: Carrier::Body(body), object_from_camera, ..mount() };
        fusion.set_mount(ONBOARD, Some(if by_roundel { mount() } else { on_body }));
        let mut robots = ErrorStatistics::default();
        fly(&mut fusion, 4.0, true, |fusion, time| {
            let t = time.seconds_since(START);
            if t > 1.0 {
                let snapshot = fusion.snapshot(time);
                for number in ROBOTS {
                    robots.add(own(&snapshot.objects, number).unwrap(), |t| robot(number, t), t);
                }
                let camera = fusion.camera_placement(ONBOARD, time).unwrap();
                let off = camera.world_from_camera.inverse() * drone(t) * downwards(0.1);
                let (off_m, off_rad) = (off.translation.vector.norm(), off.rotation.angle());
                assert!(off_m < 0.05 && off_rad < 0.1, "{off}");
            }
        });
        assert!(robots.rms_mm() < 25.0 && robots.shares()[0] > 0.9, "{} mm", robots.rms_mm());
        assert_eq!(fusion.counts().begun, 5);
    }
}

/// The carrier's normal alone locates nothing.
#[test]
fn without_a_yaw_detections_are_counted_and_not_used() {
    let mut fusion = fusion();
    fusion.set_mount(ONBOARD, Some(mount()));
    fly(&mut fusion, 2.0, false, |_, _| {});
    let counts = fusion.counts();
    assert_eq!((counts.begun, counts.no_camera_pose), (1, 4 * 60));
    // A carrier is identified by its code, which was never read.
    assert_eq!(counts.carrier_unseen, counts.no_camera_pose);
    let end = START.plus_seconds(2.0);
    assert_eq!(fusion.camera_placement(ONBOARD, end), Err(Unplaced::CarrierUnseen));
    assert_eq!(fusion.camera_placement(CameraId(77), end), Err(Unplaced::Unknown));
    assert!(fusion.camera_placement(CameraId(0), end).is_ok());
}

/// The yaw survives a frame without a code, but not a long time without one.
#[test]
fn an_expired_yaw_locates_nothing() {
    let mut fusion = fusion();
    fusion.set_mount(ONBOARD, Some(mount()));
    fly(&mut fusion, 1.0, true, |_, _| {});
    let mut sensor = RoundelCamera::new(5);
    let mut places = Vec::new();
    for number in 0..120u32 {
        let t = 1.0 + f64::from(number) / 60.0;
        let time = START.plus_seconds(t);
        let camera_from_roundel = stationary_camera(STATIONARY[0]).inverse() * drone(t);
        let mut unread = sensor.detect(&camera_from_roundel, time, 1, None);
        unread.pose.as_mut().unwrap().normal_likelihood = 0.99;
        fusion.observe(&frame(CameraId(0), 1000 + u64::from(number), time, vec![unread]));
        places.push(fusion.camera_placement(ONBOARD, time).map(|_| ()));
    }
    assert_eq!(places[0], Ok(()));
    assert_eq!(*places.last().unwrap(), Err(Unplaced::CarrierWithoutYaw), "{places:?}");
}

/// Two drones that detect each other: each is located by stationary cameras only.
#[test]
fn carriers_do_not_reinforce_each_other() {
    let covariances = [false, true].map(|detect_each_other| {
        let mut fusion = fusion();
        let other = CameraMount { carrier: carrier(2), ..mount() };
        fusion.set_mount(ONBOARD, Some(mount()));
        fusion.set_mount(CameraId(10), Some(other));
        let mut sensor = RoundelCamera::new(3);
        let beside = Rigid::translation(0.0, 0.3, -1.0) * drone(0.0);
        for step in 0..240 {
            let time = START.plus_seconds(step as f64 / 120.0);
            let drones = [(drone(0.0), DRONE), (beside, 2)];
            let camera = step as usize % 4;
            let detections = drones.map(|(world_from_roundel, number)| {
                let camera_from_roundel =
                    stationary_camera(STATIONARY[camera]).inverse() * world_from_roundel;
                sensor.detect(&camera_from_roundel, time, u64::from(number), Some(code(number)))
            });
            fusion.observe(&frame(CameraId(camera as u32), step + 1, time, detections.to_vec()));
            if detect_each_other {
                let mut aside = RoundelCamera::new(step);
                let camera_from_roundel = (drone(0.0) * downwards(0.1)).inverse() * beside;
                let detection = aside.detect(&camera_from_roundel, time, 1, Some(code(2)));
                fusion.observe(&frame(ONBOARD, step + 1, time, vec![detection]));
            }
        }
        assert_eq!(
            fusion.counts().carrier_detections > 200,
            detect_each_other,
            "{:?}",
            fusion.counts()
        );
        assert_eq!(fusion.counts().begun, 2);
        let snapshot = fusion.snapshot(START.plus_seconds(2.0));
        own(&snapshot.objects, 2).unwrap().covariance
    });
    assert_eq!(covariances[0], covariances[1]);
}
