//! Cameras that detect landmarks and thereby localize their carriers.

use std::f64::consts::PI;

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use roundel_core::{
    id::CameraId,
    rigid::{Rigid, mahalanobis_squared},
    time::Timestamp,
    world::{Body, CameraMount, Carrier, Fusion, Landmark, MotionClass},
};

use super::{
    arena::START,
    roundel_camera::{
        DRONE, ErrorStatistics, KIND, ONBOARD, RoundelCamera, STATIONARY, carrier, code, error,
        frame, fusion, mount, own, stationary_camera,
    },
};

/// Four landmarks on a wall, visible from -x.
fn station(coded: bool) -> Vec<Landmark> {
    let faces = UnitQuaternion::from_euler_angles(0.0, -PI / 2.0, 0.0);
    [[-0.3, 0.2], [0.3, 0.25], [-0.25, 0.7], [0.35, 0.6]]
        .into_iter()
        .zip(101..)
        .map(|([y, z], number)| Landmark {
            orientation: Some(faces),
            position_deviation_m: 1e-4,
            orientation_deviation_rad: 1e-4,
            ..Landmark::new(KIND, coded.then(|| code(number)), Vector3::new(4.0, y, z))
        })
        .collect()
}

/// Camera of a driving robot: looks forwards, 0.3 m ahead of its roundel and 0.1 m below.
fn forwards() -> CameraMount {
    let axes = Matrix3::from_columns(&[-Vector3::y(), -Vector3::z(), Vector3::x()]);
    let turn = UnitQuaternion::from_matrix(&axes);
    CameraMount {
        object_from_camera: Rigid::from_parts(Vector3::new(0.3, 0.0, -0.1).into(), turn),
        localizes: true,
        ..mount()
    }
}

/// From three metres before the station to one, swaying.
fn docking(t: f64) -> Rigid {
    let place = Vector3::new(1.0 + 0.2 * t, 0.15 * (0.5 * t).sin(), 0.5);
    let turn = UnitQuaternion::from_euler_angles(0.0, 0.0, 0.2 * (0.4 * t).cos());
    Rigid::from_parts(place.into(), turn)
}

fn dock(
    fusion: &mut Fusion,
    carrier: Carrier,
    landmarks: &[Landmark],
    seconds: f64,
    mut observe: impl FnMut(&mut Fusion, Timestamp),
) {
    fusion.set_mount(ONBOARD, Some(CameraMount { carrier, ..forwards() }));
    fusion.set_landmarks(landmarks.to_vec());
    let mut sensor = RoundelCamera::new(8);
    for step in 0..(seconds * 30.0) as u64 {
        let t = step as f64 / 30.0;
        let time = START.plus_seconds(t);
        let world_from_camera = docking(t) * forwards().object_from_camera;
        let detections = landmarks.iter().zip(1..).map(|(landmark, number)| {
            let place = landmark.position_m.into();
            let world_from_landmark = Rigid::from_parts(place, landmark.orientation.unwrap());
            sensor.detect(
                &(world_from_camera.inverse() * world_from_landmark),
                time,
                number,
                landmark.code,
            )
        });
        fusion.observe(&frame(ONBOARD, step + 1, time, detections.collect()));
        observe(fusion, time);
    }
}

#[test]
fn a_robot_localizes_by_coded_or_plain_landmarks() {
    for coded in [true, false] {
        let mut fusion = fusion();
        let mut statistics = ErrorStatistics::default();
        dock(&mut fusion, carrier(DRONE), &station(coded), 8.0, |fusion, time| {
            let t = time.seconds_since(START);
            if t > 0.5 {
                let snapshot = fusion.snapshot(time);
                statistics.add(own(&snapshot.objects, DRONE).unwrap(), docking, t);
            }
        });
        let shares = statistics.shares();
        println!("coded {coded}: {shares:.3?}, {:.2} mm", statistics.rms_mm());
        assert!(shares.iter().all(|share| *share >= 0.92), "{shares:?}");
        assert!(statistics.rms_mm() < 15.0, "{}", statistics.rms_mm());
        let counts = fusion.counts();
        assert_eq!((counts.begun, counts.localized), (1, 240), "{counts:?}");
        assert_eq!(counts.landmark_detections, counts.detections);
    }
}

/// A robot without a roundel is an object as well.
#[test]
fn a_robot_without_a_roundel_localizes() {
    let mut fusion = fusion();
    let motion = MotionClass::Ground { height_m: Some(0.5) };
    let body = fusion.add_body(Body { motion, mounts: vec![] }).unwrap();
    let mut statistics = ErrorStatistics::default();
    dock(&mut fusion, Carrier::Body(body), &station(true), 8.0, |fusion, time| {
        let t = time.seconds_since(START);
        if t > 0.5 {
            let snapshot = fusion.snapshot(time);
            let [object] = &snapshot.objects[..] else { panic!("{snapshot:?}") };
            assert_eq!((object.body, object.kind, object.code), (Some(body), None, None));
            statistics.add(object, docking, t);
        }
    });
    let shares = statistics.shares();
    assert!(shares.iter().all(|share| *share >= 0.92), "{shares:?}");
    assert!(statistics.rms_mm() < 15.0, "{}", statistics.rms_mm());
}

/// One landmark has two normals: nothing is reported until one is certain, and then the right one.
#[test]
fn one_landmark_suffices_once_its_normal_is_certain() {
    let mut fusion = fusion();
    let mut first = None;
    dock(&mut fusion, carrier(DRONE), &station(true)[..1], 8.0, |fusion, time| {
        let snapshot = fusion.snapshot(time);
        if let Some(object) = own(&snapshot.objects, DRONE) {
            let t = time.seconds_since(START);
            first.get_or_insert(t);
            let error = error(object, &docking(t));
            let square = mahalanobis_squared(&error, &object.covariance).unwrap();
            assert!(square < 40.0, "{square} at {t}: {error}");
        }
    });
    let first = first.unwrap();
    assert!((0.2..3.0).contains(&first), "{first}");
    assert_eq!(fusion.counts().begun, 1);
}

/// A robot that a stationary camera observes too is still one object, with a smaller error.
#[test]
fn own_and_external_cameras_share_one_track() {
    let mut fusion = fusion();
    let mut sensor = RoundelCamera::new(4);
    let mut number = 0;
    let mut sizes = Vec::new();
    dock(&mut fusion, carrier(DRONE), &station(true), 4.0, |fusion, time| {
        let t = time.seconds_since(START);
        number += 1;
        if t > 2.0 {
            let camera_from_roundel = stationary_camera(STATIONARY[1]).inverse() * docking(t);
            let detection = sensor.detect(&camera_from_roundel, time, 1, Some(code(DRONE)));
            fusion.observe(&frame(CameraId(1), number, time, vec![detection]));
        }
        let snapshot = fusion.snapshot(time);
        if let Some(object) = own(&snapshot.objects, DRONE) {
            assert_eq!(snapshot.objects.len(), 1);
            sizes
                .push((object.cameras.clone(), object.covariance.fixed_view::<3, 3>(0, 0).trace()));
        }
    });
    let (cameras, size) = sizes.last().unwrap();
    assert_eq!(cameras[..], [CameraId(1), ONBOARD]);
    assert!(*size < 0.9 * sizes[sizes.len() / 3].1, "{sizes:?}");
}
