//! Cameras that move: what they see is placed by what carries them, and what they see of landmarks
//! places that.

use std::f64::consts::PI;

use nalgebra::{Matrix3, UnitQuaternion, Vector3, Vector6};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use roundel_core::{
    camera::PixelPoint,
    ellipse::Ellipse,
    id::{CameraId, KindId, TrackNumber},
    marker::{Code, CodeReading, Ring},
    pose::{Detection, RoundelPose},
    rigid::{
        Covariance6, Rigid, UNKNOWN_ANGLE_VARIANCE_RAD2, mahalanobis_squared, orientation_of_normal,
    },
    time::Timestamp,
    world::{
        Body, CameraMount, CameraPlacement, Carrier, FrameObservations, Fusion, FusionParams,
        Landmark, LifeStage, MotionClass, Mount, ObjectState, Unplaced,
    },
};

use crate::arena::START;

const KIND: KindId = KindId(0);
/// χ² of 3 degrees of freedom at 95 %.
const CHI3: f64 = 7.815;
/// The camera on board, and what stands.
const ABOARD: CameraId = CameraId(9);
const STANDING: [[f64; 2]; 4] = [[-2.5, -2.0], [2.5, -2.0], [-2.5, 2.0], [2.5, 2.0]];
const DRONE: u16 = 1;

fn code(number: u16) -> Code {
    Code { bits: 8, number }
}

fn carrier(number: u16) -> Carrier {
    Carrier::Roundel { kind: KIND, code: code(number) }
}

/// Looking down, the image's right along the x of what carries it, so much below its roundel.
fn downwards(depth_m: f64) -> Rigid {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    Rigid::from_parts(Vector3::new(0.05, 0.0, -depth_m).into(), turn)
}

/// What a camera makes of roundels: errors as fresh in each frame as it states.
struct Eye {
    random: ChaCha8Rng,
    noise_px: f64,
    tilt_rad: f64,
}

impl Eye {
    fn new(seed: u64) -> Self {
        Self { random: ChaCha8Rng::seed_from_u64(seed), noise_px: 0.1, tilt_rad: 0.02 }
    }

    fn draw(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| StandardNormal.sample(&mut self.random))
    }

    /// `code`: none if it is not read, and no yaw with it.
    fn see(&mut self, seen: &Rigid, time: Timestamp, number: u64, code: Option<Code>) -> Detection {
        let place_m = seen.translation.vector;
        let distance_m = place_m.norm();
        let sight = place_m / distance_m;
        let across_m = self.noise_px * distance_m / 600.0;
        let along_m = across_m * distance_m / 0.16;
        let along = sight * sight.transpose();
        let root = (Matrix3::identity() - along) * across_m + along * along_m;
        let position_m = place_m + root * self.draw();
        let slip = self.draw() * self.tilt_rad;
        let turn = UnitQuaternion::from_scaled_axis(slip) * seen.rotation;
        let (x, z) = (turn * Vector3::x(), turn * Vector3::z());
        let level = orientation_of_normal(&z).inverse() * x;
        let mut covariance = Covariance6::zeros();
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&(root * root.transpose()));
        let tilt = Matrix3::from_diagonal_element(self.tilt_rad * self.tilt_rad);
        let about =
            z * z.transpose() * if code.is_some() { 0.0 } else { UNKNOWN_ANGLE_VARIANCE_RAD2 };
        covariance.fixed_view_mut::<3, 3>(3, 3).copy_from(&(tilt + about));
        let center = PixelPoint { u: 320.0, v: 240.0 };
        let rim = Ellipse { center, semi_major_px: 20.0, semi_minor_px: 20.0, angle_rad: 0.0 };
        let ring = Ring {
            kind: Some(KIND),
            code: code.map(|code| CodeReading::certain(code, center)),
            ..Ring::of_rims(rim, rim)
        };
        let pose = RoundelPose {
            position_m,
            normal: z,
            normal_likelihood: 0.8,
            other_normal: (sight * (2.0 * sight.dot(&z)) - z).normalize(),
            yaw_rad: code.map(|_| level.y.atan2(level.x)),
            yaw_symmetry: 1,
            covariance,
        };
        Detection { track: TrackNumber(number), ring, capture_time: time, pose: Some(pose) }
    }
}

fn frame(
    camera: CameraId,
    number: u64,
    time: Timestamp,
    detections: Vec<Detection>,
) -> FrameObservations {
    FrameObservations {
        camera,
        frame: number,
        capture_time: time,
        received_time: time.plus_seconds(0.02),
        calibration_version: 1,
        detections,
    }
}

/// Errors as fresh as [`Eye`] makes them.
fn fusion() -> Fusion {
    let mut fusion = Fusion::new(FusionParams { systematic_share: 0.0, ..FusionParams::default() });
    for (index, standing) in STANDING.iter().enumerate() {
        let world_from_camera = standing_camera(*standing);
        let placement = CameraPlacement { world_from_camera, covariance: Covariance6::zeros() };
        fusion.set_camera(CameraId(index as u32), Some(placement));
    }
    fusion
}

fn standing_camera([x, y]: [f64; 2]) -> Rigid {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    Rigid::from_parts(Vector3::new(x, y, 5.0).into(), turn)
}

fn mount() -> CameraMount {
    CameraMount {
        carrier: carrier(DRONE),
        object_from_camera: downwards(0.1),
        covariance: Covariance6::zeros(),
        localizes: false,
    }
}

/// A drone that goes to and fro, turns and leans.
fn drone(t: f64) -> Rigid {
    let place =
        Vector3::new(1.2 * (0.9 * t).sin(), 0.9 * (0.7 * t).cos(), 2.0 + 0.2 * (1.1 * t).sin());
    let lean =
        UnitQuaternion::from_euler_angles(0.07 * (0.9 * t).sin(), 0.05 * (0.7 * t).cos(), 0.3 * t);
    Rigid::from_parts(place.into(), lean)
}

/// One robot on the floor, driving slowly.
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

/// Twelve frames of each standing camera for one in six of the drone's; `with_code`: the drone's is read.
fn fly(
    fusion: &mut Fusion,
    seconds: f64,
    with_code: bool,
    mut look: impl FnMut(&mut Fusion, Timestamp),
) {
    let mut eyes: Vec<Eye> = (0..5).map(|seed| Eye::new(seed + 1)).collect();
    for step in 0..(seconds * 120.0) as u64 {
        let t = step as f64 / 120.0;
        let time = START.plus_seconds(t);
        if step % 4 == 2 {
            let seen = (drone(t) * downwards(0.1)).inverse();
            let look = |number: u16| (seen * robot(number, t), number);
            let detections = ROBOTS
                .map(look)
                .map(|(seen, number)| eyes[4].see(&seen, time, number.into(), Some(code(number))))
                .collect();
            fusion.observe(&frame(ABOARD, step / 4 + 1, time, detections));
        } else if step % 4 != 3 {
            let camera = (step % 4 + step / 4 % 2 * 2) as usize % 4;
            let seen = standing_camera(STANDING[camera]).inverse() * drone(t);
            let read = with_code.then(|| code(DRONE));
            let detection = eyes[camera].see(&seen, time, 1, read);
            fusion.observe(&frame(CameraId(camera as u32), step + 1, time, vec![detection]));
        }
        look(fusion, time);
    }
}

fn own(objects: &[ObjectState], number: u16) -> Option<&ObjectState> {
    objects
        .iter()
        .find(|object| object.code == Some(code(number)) && object.stage == LifeStage::Tracked)
}

fn error(object: &ObjectState, truth: &Rigid) -> Vector6<f64> {
    let off = object.position_m - truth.translation.vector;
    let turn = (object.orientation * truth.rotation.inverse()).scaled_axis();
    Vector6::new(off.x, off.y, off.z, turn.x, turn.y, turn.z)
}

/// Shares of positions, velocities and rotations within 95 %, and the rms error of positions.
#[derive(Default)]
struct Tally {
    count: usize,
    inside: [usize; 3],
    square_m2: f64,
}

impl Tally {
    fn add(&mut self, object: &ObjectState, truth: impl Fn(f64) -> Rigid, t: f64) {
        let error = error(object, &truth(t));
        let ahead_m = truth(t + 1e-4).translation.vector - truth(t - 1e-4).translation.vector;
        let speed = object.velocity_m_s - ahead_m / 2e-4;
        let (moved, turned) =
            (error.fixed_rows::<3>(0).into_owned(), error.fixed_rows::<3>(3).into_owned());
        let block = |whole: &Covariance6| whole.fixed_view::<3, 3>(3, 3).into_owned();
        let place: Matrix3<f64> = object.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let squares = [
            mahalanobis_squared(&moved, &place),
            mahalanobis_squared(&speed, &block(&object.motion_covariance)),
            mahalanobis_squared(&turned, &block(&object.covariance)),
        ];
        for (inside, square) in self.inside.iter_mut().zip(squares) {
            *inside += usize::from(square.unwrap() < CHI3);
        }
        self.count += 1;
        self.square_m2 += moved.norm_squared();
    }

    fn shares(&self) -> [f64; 3] {
        self.inside.map(|inside| inside as f64 / self.count as f64)
    }

    fn rms_mm(&self) -> f64 {
        (self.square_m2 / self.count as f64).sqrt() * 1e3
    }
}

#[test]
fn what_a_drone_sees_is_where_it_is() {
    let mut fusion = fusion();
    fusion.set_mount(ABOARD, Some(mount()));
    let (mut robots, mut place) = (Tally::default(), Tally::default());
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
        let camera = fusion.camera_place(ABOARD, time).unwrap();
        let off = camera.world_from_camera.inverse() * drone(t) * downwards(0.1);
        assert!(off.translation.vector.norm() < 0.05 && off.rotation.angle() < 0.1, "{off}");
    });
    let shares = robots.shares();
    println!("robots {shares:.3?} {:.1} mm, drone {:.3?}", robots.rms_mm(), place.shares());
    assert!(shares.iter().all(|share| (0.92..=0.995).contains(share)), "{shares:?}");
    assert!(robots.rms_mm() < 25.0, "{}", robots.rms_mm());
    assert_eq!(fusion.counts().begun, 5, "{:?}", fusion.counts());
}

/// A drone that is configured by its roundel's place on it, and the camera's, from its middle or from the
/// roundel, which is the drone's and no object by itself.
#[test]
fn what_carries_a_camera_may_be_a_body() {
    for by_roundel in [false, true] {
        let mut fusion = fusion();
        let turn = UnitQuaternion::from_euler_angles(0.1, 0.0, 0.7);
        let object_from_roundel = Rigid::from_parts(Vector3::new(0.3, 0.1, 0.05).into(), turn);
        let mounts = vec![Mount { kind: KIND, code: Some(code(DRONE)), object_from_roundel }];
        let body = fusion.add_body(Body { motion: MotionClass::Free, mounts }).unwrap();
        let object_from_camera = object_from_roundel * downwards(0.1);
        let on_body = CameraMount { carrier: Carrier::Body(body), object_from_camera, ..mount() };
        fusion.set_mount(ABOARD, Some(if by_roundel { mount() } else { on_body }));
        let mut robots = Tally::default();
        fly(&mut fusion, 4.0, true, |fusion, time| {
            let t = time.seconds_since(START);
            if t > 1.0 {
                let snapshot = fusion.snapshot(time);
                for number in ROBOTS {
                    robots.add(own(&snapshot.objects, number).unwrap(), |t| robot(number, t), t);
                }
                let camera = fusion.camera_place(ABOARD, time).unwrap();
                let off = camera.world_from_camera.inverse() * drone(t) * downwards(0.1);
                let (off_m, off_rad) = (off.translation.vector.norm(), off.rotation.angle());
                assert!(off_m < 0.05 && off_rad < 0.1, "{off}");
            }
        });
        assert!(robots.rms_mm() < 25.0 && robots.shares()[0] > 0.9, "{} mm", robots.rms_mm());
        assert_eq!(fusion.counts().begun, 5);
    }
}

/// Of the carrier's normal alone nothing follows about what its camera sees.
#[test]
fn without_a_yaw_nothing_is_placed_and_that_is_counted() {
    let mut fusion = fusion();
    fusion.set_mount(ABOARD, Some(mount()));
    fly(&mut fusion, 2.0, false, |_, _| {});
    let counts = fusion.counts();
    assert_eq!((counts.begun, counts.no_camera_pose), (1, 4 * 60));
    // A carrier is known by its code, which nobody has read.
    assert_eq!(counts.carrier_unseen, counts.no_camera_pose);
    let end = START.plus_seconds(2.0);
    assert_eq!(fusion.camera_place(ABOARD, end), Err(Unplaced::CarrierUnseen));
    assert_eq!(fusion.camera_place(CameraId(77), end), Err(Unplaced::Unknown));
    assert!(fusion.camera_place(CameraId(0), end).is_ok());
}

/// A code that is not read once leaves the yaw known; one that is not read for long, the normal alone.
#[test]
fn a_yaw_that_is_not_observed_any_more_places_nothing() {
    let mut fusion = fusion();
    fusion.set_mount(ABOARD, Some(mount()));
    fly(&mut fusion, 1.0, true, |_, _| {});
    let mut eye = Eye::new(5);
    let mut places = Vec::new();
    for number in 0..120u32 {
        let t = 1.0 + f64::from(number) / 60.0;
        let time = START.plus_seconds(t);
        let seen = standing_camera(STANDING[0]).inverse() * drone(t);
        let mut unread = eye.see(&seen, time, 1, None);
        unread.pose.as_mut().unwrap().normal_likelihood = 0.99;
        fusion.observe(&frame(CameraId(0), 1000 + u64::from(number), time, vec![unread]));
        places.push(fusion.camera_place(ABOARD, time).map(|_| ()));
    }
    assert_eq!(places[0], Ok(()));
    assert_eq!(*places.last().unwrap(), Err(Unplaced::CarrierWithoutYaw), "{places:?}");
}

/// Two drones in sight of each other: each is located by cameras that stand alone.
#[test]
fn carriers_do_not_make_each_other_sure() {
    let covariances = [false, true].map(|looks| {
        let mut fusion = fusion();
        let other = CameraMount { carrier: carrier(2), ..mount() };
        fusion.set_mount(ABOARD, Some(mount()));
        fusion.set_mount(CameraId(10), Some(other));
        let mut eye = Eye::new(3);
        let beside = Rigid::translation(0.0, 0.3, -1.0) * drone(0.0);
        for step in 0..240 {
            let time = START.plus_seconds(step as f64 / 120.0);
            let drones = [(drone(0.0), DRONE), (beside, 2)];
            let camera = step as usize % 4;
            let seen = drones.map(|(place, number)| {
                let seen = standing_camera(STANDING[camera]).inverse() * place;
                eye.see(&seen, time, u64::from(number), Some(code(number)))
            });
            fusion.observe(&frame(CameraId(camera as u32), step + 1, time, seen.to_vec()));
            if looks {
                let mut aside = Eye::new(step);
                let seen = (drone(0.0) * downwards(0.1)).inverse() * beside;
                let detection = aside.see(&seen, time, 1, Some(code(2)));
                fusion.observe(&frame(ABOARD, step + 1, time, vec![detection]));
            }
        }
        assert_eq!(fusion.counts().of_carriers > 200, looks, "{:?}", fusion.counts());
        assert_eq!(fusion.counts().begun, 2);
        let snapshot = fusion.snapshot(START.plus_seconds(2.0));
        own(&snapshot.objects, 2).unwrap().covariance
    });
    assert_eq!(covariances[0], covariances[1]);
}

/// Four landmarks on a wall, facing those who come along x.
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

/// The camera of a robot that drives: forwards, 0.3 m before its roundel and 0.1 m below.
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
    mut look: impl FnMut(&mut Fusion, Timestamp),
) {
    fusion.set_mount(ABOARD, Some(CameraMount { carrier, ..forwards() }));
    fusion.set_landmarks(landmarks.to_vec());
    let mut eye = Eye::new(8);
    for step in 0..(seconds * 30.0) as u64 {
        let t = step as f64 / 30.0;
        let time = START.plus_seconds(t);
        let camera = docking(t) * forwards().object_from_camera;
        let detections = landmarks.iter().zip(1..).map(|(landmark, number)| {
            let place = landmark.position_m.into();
            let stands = Rigid::from_parts(place, landmark.orientation.unwrap());
            eye.see(&(camera.inverse() * stands), time, number, landmark.code)
        });
        fusion.observe(&frame(ABOARD, step + 1, time, detections.collect()));
        look(fusion, time);
    }
}

#[test]
fn a_robot_finds_itself_by_landmarks_coded_or_plain() {
    for coded in [true, false] {
        let mut fusion = fusion();
        let mut tally = Tally::default();
        dock(&mut fusion, carrier(DRONE), &station(coded), 8.0, |fusion, time| {
            let t = time.seconds_since(START);
            if t > 0.5 {
                let snapshot = fusion.snapshot(time);
                tally.add(own(&snapshot.objects, DRONE).unwrap(), docking, t);
            }
        });
        let shares = tally.shares();
        println!("coded {coded}: {shares:.3?}, {:.2} mm", tally.rms_mm());
        assert!(shares.iter().all(|share| *share >= 0.92), "{shares:?}");
        assert!(tally.rms_mm() < 15.0, "{}", tally.rms_mm());
        let counts = fusion.counts();
        assert_eq!((counts.begun, counts.localized), (1, 240), "{counts:?}");
        assert_eq!(counts.of_landmarks, counts.detections);
    }
}

/// A robot that nothing is printed on is an object all the same.
#[test]
fn a_robot_without_a_roundel_finds_itself() {
    let mut fusion = fusion();
    let motion = MotionClass::Ground { height_m: Some(0.5) };
    let body = fusion.add_body(Body { motion, mounts: vec![] }).unwrap();
    let mut tally = Tally::default();
    dock(&mut fusion, Carrier::Body(body), &station(true), 8.0, |fusion, time| {
        let t = time.seconds_since(START);
        if t > 0.5 {
            let snapshot = fusion.snapshot(time);
            let [object] = &snapshot.objects[..] else { panic!("{snapshot:?}") };
            assert_eq!((object.body, object.kind, object.code), (Some(body), None, None));
            tally.add(object, docking, t);
        }
    });
    let shares = tally.shares();
    assert!(shares.iter().all(|share| *share >= 0.92), "{shares:?}");
    assert!(tally.rms_mm() < 15.0, "{}", tally.rms_mm());
}

/// One landmark has two normals: nothing is said until one of them is sure, and then the right one.
#[test]
fn one_landmark_is_enough_once_its_normal_is_known() {
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

/// Seen by a camera that stands as well, it is still one object, and better known.
#[test]
fn own_and_others_sight_go_to_one_track() {
    let mut fusion = fusion();
    let mut eye = Eye::new(4);
    let mut number = 0;
    let mut sizes = Vec::new();
    dock(&mut fusion, carrier(DRONE), &station(true), 4.0, |fusion, time| {
        let t = time.seconds_since(START);
        number += 1;
        if t > 2.0 {
            let seen = standing_camera(STANDING[1]).inverse() * docking(t);
            let detection = eye.see(&seen, time, 1, Some(code(DRONE)));
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
    assert_eq!(cameras[..], [CameraId(1), ABOARD]);
    assert!(*size < 0.9 * sizes[sizes.len() / 3].1, "{sizes:?}");
}
