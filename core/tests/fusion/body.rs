//! Objects with several roundels: one object each, with a better heading than a single roundel gives, and correct
//! covariances.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use roundel_core::{
    camera::PixelPoint,
    id::{BodyId, CameraId, KindId, ObjectId},
    marker::{Code, CodeReading},
    pose::Detection,
    rigid::{Rigid, UNKNOWN_ANGLE_VARIANCE_RAD2, mahalanobis_squared, orientation_of_normal},
    time::Timestamp,
    world::{
        Body, BodyError, CameraPlacement, EventKind, FrameObservations, Fusion, FusionParams,
        LifeStage, MotionClass, Mount,
    },
};

use super::{
    arena::{Arena, START, Setting, Truth, detection, gaussian3},
    score::fusion_of,
};

/// χ² of 3 degrees of freedom at 95 %.
const CHI3: f64 = 7.815;
const BAND: std::ops::RangeInclusive<f64> = 0.92..=0.98;
/// Standard deviation of a coded roundel's yaw.
const YAW_RAD: f64 = 0.02;
/// The plain kind; `arena` uses kind 0 for all, which is coded here.
const PLAIN: KindId = KindId(1);

pub(crate) fn code(number: u16) -> Code {
    Code { bits: 8, number }
}

/// A flat print at this distance ahead and to the left of the origin, 0.1 m above it.
pub(crate) fn flat(x_m: f64, y_m: f64, yaw_rad: f64) -> Rigid {
    Rigid::new(Vector3::new(x_m, y_m, 0.1), Vector3::z() * yaw_rad)
}

pub(crate) fn coded(number: u16, object_from_roundel: Rigid) -> Mount {
    Mount { kind: KindId(0), code: Some(code(number)), object_from_roundel }
}

fn plain(object_from_roundel: Rigid) -> Mount {
    Mount { kind: PLAIN, code: None, object_from_roundel }
}

/// A coded roundel in front, one behind.
fn two() -> Vec<Mount> {
    vec![coded(3, flat(0.2, 0.0, 0.0)), coded(4, flat(-0.2, 0.0, 2.0))]
}

/// Pose of the robot after `t` seconds.
pub(crate) fn truth(t: f64) -> Rigid {
    let place =
        Vector3::new(0.8 * (0.9 * t).sin(), 0.6 * (1.1 * t + 1.0).sin(), 0.25 + 0.05 * t.sin());
    let tilt = UnitQuaternion::from_euler_angles(0.1 * (0.8 * t).sin(), 0.1 * (0.7 * t).cos(), 0.0);
    let heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.7 * t + (1.6 * t).sin());
    Rigid::from_parts(place.into(), tilt * heading)
}

/// Four cameras and a robot with these roundels.
pub(crate) struct World {
    pub(crate) arena: Arena,
    mounts: Vec<Mount>,
    /// Whether a roundel is hidden after some seconds.
    hidden: fn(usize, f64) -> bool,
}

/// A roundel of the robot at one time.
struct MountedRoundel<'a> {
    mount: &'a Mount,
    world_from_roundel: Rigid,
}

/// Errors of one detection, in standard deviations.
struct SensorError<'a> {
    /// Systematic errors of position, normal and yaw.
    bias: &'a [Vector3<f64>; 3],
    yaw: f64,
}

impl World {
    pub(crate) fn new(mounts: Vec<Mount>) -> Self {
        let setting = Setting { objects: 1, ..Setting::default() };
        Self { arena: Arena::new(setting), mounts, hidden: |_, _| false }
    }

    fn fusion(&self, mounts: &[Mount]) -> Fusion {
        let mut fusion = fusion_of(&self.arena, FusionParams::default());
        let body = Body { motion: MotionClass::Free, mounts: mounts.to_vec() };
        assert_eq!(fusion.add_body(body), Ok(BodyId(0)));
        fusion
    }

    /// All frames of `seconds` in order of their times.
    pub(crate) fn frames(&self, seconds: f64) -> Vec<FrameObservations> {
        let (rate_hz, share) = (30.0, self.arena.setting.systematic_share);
        let kept = (-1.0 / (rate_hz * self.arena.setting.systematic_time_s)).exp();
        let mut frames = Vec::new();
        for camera in 0..self.arena.setting.cameras {
            let mut rng = ChaCha8Rng::seed_from_u64(7 + camera as u64);
            let mut biases = vec![[0; 3].map(|_| gaussian3(&mut rng)); self.mounts.len()];
            for frame in 0..(seconds * rate_hz) as u64 {
                let t = (frame as f64 + camera as f64 / 4.0) / rate_hz;
                let time = START.plus_seconds(t);
                let mut detections = Vec::new();
                for (index, mount) in self.mounts.iter().enumerate() {
                    for bias in &mut biases[index] {
                        *bias = *bias * kept + gaussian3(&mut rng) * (1.0 - kept * kept).sqrt();
                    }
                    let fresh = gaussian3(&mut rng).x;
                    let yaw = biases[index][2].x * share.sqrt() + fresh * (1.0 - share).sqrt();
                    let world_from_roundel = truth(t) * mount.object_from_roundel;
                    let roundel = MountedRoundel { mount, world_from_roundel };
                    let error = SensorError { bias: &biases[index], yaw };
                    let detection = self.detect(camera, &roundel, &error, time, &mut rng);
                    if let Some(mut detection) = detection.filter(|_| !(self.hidden)(index, t)) {
                        detection.track.0 = index as u64 + 1;
                        detections.push(detection);
                    }
                }
                frames.push(FrameObservations {
                    camera: CameraId(camera as u32),
                    frame: frame + 1,
                    capture_time: time,
                    received_time: time.plus_seconds(0.02),
                    calibration_version: 1,
                    detections,
                });
            }
        }
        frames.sort_by_key(|frame| frame.capture_time);
        frames
    }

    fn detect(
        &self,
        camera: usize,
        roundel: &MountedRoundel<'_>,
        error: &SensorError<'_>,
        time: Timestamp,
        rng: &mut ChaCha8Rng,
    ) -> Option<Detection> {
        let (mount, at) = (roundel.mount, &roundel.world_from_roundel);
        let SensorError { bias, yaw } = error;
        let truth = Truth {
            position_m: at.translation.vector,
            velocity_m_s: Vector3::zeros(),
            normal: at.rotation * Vector3::z(),
        };
        let mut pose = self.arena.detect(camera, &truth, &[bias[0], bias[1]], rng)?;
        let mut reading = None;
        if let Some(code) = mount.code {
            let camera_from_world = self.arena.placements[camera].world_from_camera.inverse();
            let turned = camera_from_world.rotation * at.rotation;
            let (x, z) = (turned * Vector3::x(), turned * Vector3::z());
            // The other normal has the same direction in the image.
            let line_of_sight = pose.position_m.normalize();
            let is_right = pose.normal.dot(&z) > pose.other_normal.dot(&z);
            let x = if is_right { x } else { x - line_of_sight * (2.0 * line_of_sight.dot(&x)) };
            let in_plane = orientation_of_normal(&pose.normal).inverse() * x;
            pose.yaw_rad = Some(in_plane.y.atan2(in_plane.x) + YAW_RAD * yaw);
            let about = pose.normal * pose.normal.transpose();
            let mut rotation = pose.covariance.fixed_view_mut::<3, 3>(3, 3);
            rotation += about * (YAW_RAD * YAW_RAD - UNKNOWN_ANGLE_VARIANCE_RAD2);
            reading = Some(CodeReading::certain(code, PixelPoint::default()));
        }
        let mut detection = detection(1, time, Some(pose));
        detection.ring.kind = Some(mount.kind);
        detection.ring.code = reading;
        Some(detection)
    }
}

/// Snapshots against the truth.
#[derive(Default)]
struct Score {
    states: usize,
    inside: [usize; 2],
    square_m2: f64,
    square_yaw_rad2: f64,
    others: usize,
}

impl Score {
    fn add(&mut self, fusion: &mut Fusion, time: Timestamp) {
        for object in &fusion.snapshot(time).objects {
            if object.stage != LifeStage::Tracked {
                continue;
            }
            if object.body != Some(BodyId(0)) || object.id != ObjectId(1) {
                self.others += 1;
                continue;
            }
            let truth = truth(time.seconds_since(START));
            let error_m = object.position_m - truth.translation.vector;
            let turn = (object.orientation * truth.rotation.inverse()).scaled_axis();
            let block = |from: usize| -> Matrix3<f64> {
                object.covariance.fixed_view::<3, 3>(from, from).into_owned()
            };
            for (index, (error, spread)) in
                [(error_m, block(0)), (turn, block(3))].into_iter().enumerate()
            {
                let inside = mahalanobis_squared(&error, &spread).unwrap() <= CHI3;
                self.inside[index] += usize::from(inside);
            }
            self.states += 1;
            self.square_m2 += error_m.norm_squared();
            self.square_yaw_rad2 += turn.z * turn.z;
        }
    }

    fn shares(&self) -> [f64; 2] {
        self.inside.map(|inside| inside as f64 / self.states as f64)
    }

    /// Angles are filtered for arbitrary changes, and these change less, so their covariance may be too large.
    fn assert_honest(&self) {
        let [position, rotation] = self.shares();
        assert!(BAND.contains(&position) && rotation > 0.92, "{}", self.summary());
    }

    fn rms_mm(&self) -> f64 {
        (self.square_m2 / self.states as f64).sqrt() * 1e3
    }

    fn yaw_deg(&self) -> f64 {
        (self.square_yaw_rad2 / self.states as f64).sqrt().to_degrees()
    }

    fn summary(&self) -> String {
        format!(
            "{} states, inside 95 % (position, rotation) {:.3?}, rms {:.2} mm, yaw {:.3}°, {} others",
            self.states,
            self.shares(),
            self.rms_mm(),
            self.yaw_deg(),
            self.others
        )
    }
}

fn scored(name: &str, fusion: &mut Fusion, frames: &[FrameObservations]) -> Score {
    let mut score = Score::default();
    for frame in frames {
        fusion.observe(frame);
        if frame.capture_time > START.plus_seconds(2.0) {
            score.add(fusion, frame.capture_time.plus_seconds(0.005));
        }
    }
    println!("{name}: {}\n{:?}", score.summary(), fusion.counts());
    score
}

#[test]
fn two_roundels_give_one_object_with_a_better_heading() {
    let world = World::new(two());
    let frames = world.frames(30.0);
    let both = scored("both", &mut world.fusion(&two()), &frames);
    let mut front = frames.clone();
    front.iter_mut().for_each(|frame| frame.detections.retain(|detection| detection.track.0 == 1));
    let front = scored("front", &mut world.fusion(&two()), &front);
    for score in [&both, &front] {
        assert_eq!((score.states, score.others), (3359, 0));
        score.assert_honest();
    }
    assert!(both.yaw_deg() < 0.4 * front.yaw_deg() && both.rms_mm() < 0.6 * front.rms_mm());
}

#[test]
fn one_of_two_roundels_is_hidden_half_the_time() {
    let hidden =
        |index, t: f64| t.rem_euclid(2.0) < 1.0 && (t.rem_euclid(4.0) < 2.0) == (index == 0);
    let world = World { hidden, ..World::new(two()) };
    let frames = world.frames(30.0);
    let score = scored("hidden", &mut world.fusion(&two()), &frames);
    assert_eq!(score.others, 0);
    score.assert_honest();
}

#[test]
fn a_plain_roundel_beside_a_coded_one() {
    let mounts = vec![coded(3, flat(0.0, 0.0, 0.3)), plain(flat(-0.4, 0.1, 0.0))];
    let world = World {
        // Only the plain one for half a second in every two.
        hidden: |index, t| index == 0 && t.rem_euclid(2.0) < 0.5,
        ..World::new(mounts.clone())
    };
    let frames = world.frames(30.0);
    let score = scored("plain and coded", &mut world.fusion(&mounts), &frames);
    assert_eq!(score.others, 0);
    score.assert_honest();
}

/// Too many roundels for an exhaustive search over normals.
#[test]
fn six_roundels_are_more_precise_than_two() {
    let round = |index: u16| {
        let angle = f64::from(index);
        coded(3 + index, flat(0.2 * angle.cos(), 0.2 * angle.sin(), angle))
    };
    let mounts: Vec<Mount> = (0..6).map(round).collect();
    let world = World::new(mounts.clone());
    let score = scored("six", &mut world.fusion(&mounts), &world.frames(10.0));
    let two = World::new(two());
    let of_two = scored("two", &mut two.fusion(&two.mounts), &two.frames(10.0));
    assert_eq!(score.others, 0);
    assert!(score.shares().iter().all(|share| *share > 0.92), "{}", score.summary());
    assert!(score.rms_mm() < 0.8 * of_two.rms_mm());
}

/// A stray roundel with the code of another one of the robot, and a misread one of its own.
#[test]
fn a_misread_code_is_left_out() {
    let world = World::new(two());
    let clean = world.frames(10.0);
    let best = scored("clean", &mut world.fusion(&two()), &clean);
    let mut frames = clean.clone();
    let mut misread = 0;
    for frame in frames.iter_mut().filter(|frame| frame.capture_time > START.plus_seconds(1.0)) {
        // In half of the frames the camera's tracker has lost all roundels.
        if frame.frame % 2 == 0 {
            for detection in &mut frame.detections {
                detection.track.0 += 100 * frame.frame;
            }
        }
        if frame.frame % 4 == 0 && frame.detections.len() == 2 {
            // The rear roundel is misread as the front one.
            frame.detections[1].ring.code = frame.detections[0].ring.code;
            misread += 1;
        }
        if frame.frame % 4 == 1 {
            // The front one, tracked for long, is misread as a stray code.
            let stray = CodeReading::certain(code(9), PixelPoint::default());
            frame
                .detections
                .iter_mut()
                .take(1)
                .for_each(|detection| detection.ring.code = Some(stray));
        }
    }
    let mut fusion = world.fusion(&two());
    let score = scored("misread", &mut fusion, &frames);
    assert!(misread > 200, "{misread}");
    assert_eq!((score.others, fusion.counts().left_out), (0, misread));
    assert_eq!(fusion.counts().begun, 1);
    assert!(score.shares().iter().all(|share| *share > 0.92), "{}", score.summary());
    assert!(score.rms_mm() < 1.5 * best.rms_mm());
}

#[test]
fn a_returning_body_keeps_its_id() {
    use EventKind::{Appeared, Lost, Predicted, Recovered};
    let hidden = |_, t: f64| (2.0..3.0).contains(&t) || (4.0..7.0).contains(&t);
    let world = World { hidden, ..World::new(two()) };
    let mut fusion = world.fusion(&two());
    for frame in &world.frames(9.0) {
        fusion.observe(frame);
    }
    let events: Vec<_> = fusion.drain_events().map(|event| (event.object, event.kind)).collect();
    let kinds = [Appeared, Predicted, Recovered, Predicted, Lost, Appeared];
    assert_eq!(events, kinds.map(|kind| (ObjectId(1), kind)));
    assert_eq!(fusion.counts().returned, 1);
    let snapshot = fusion.snapshot(START.plus_seconds(9.0));
    let [object] = &snapshot.objects[..] else { panic!("{snapshot:?}") };
    assert_eq!((object.id, object.body, object.code), (ObjectId(1), Some(BodyId(0)), None));
}

/// A robot that is carried elsewhere unobserved.
#[test]
fn a_body_that_reappears_elsewhere_keeps_its_id() {
    let world = World::new(two());
    let mut fusion = world.fusion(&two());
    for frame in &mut world.frames(4.0) {
        if frame.capture_time > START.plus_seconds(2.0) {
            let place = &world.arena.placements[frame.camera.0 as usize].world_from_camera;
            for detection in &mut frame.detections {
                let pose = detection.pose.as_mut().unwrap();
                pose.position_m += place.rotation.inverse() * Vector3::new(0.5, 0.8, 0.0);
                detection.track.0 += 100;
            }
        }
        fusion.observe(frame);
    }
    let snapshot = fusion.snapshot(START.plus_seconds(4.0));
    let [object] = &snapshot.objects[..] else { panic!("{snapshot:?}") };
    let expected_m = truth(4.0).translation.vector + Vector3::new(0.5, 0.8, 0.0);
    assert_eq!((object.id, object.stage), (ObjectId(1), LifeStage::Tracked));
    assert!((object.position_m - expected_m).norm() < 0.02, "{object:?}");
}

/// A roundel whose code is not read at first is an object of its own until then.
#[test]
fn an_unread_roundel_is_absorbed_when_it_is_read() {
    let world = World::new(two());
    let mut fusion = world.fusion(&two());
    for frame in &mut world.frames(3.0) {
        for detection in &mut frame.detections {
            // The front one is read after half a second, the rear one now and then.
            let is_read = if detection.track.0 == 1 {
                frame.capture_time > START.plus_seconds(0.5)
            } else {
                frame.frame % 10 == 1
            };
            detection.ring.code = detection.ring.code.filter(|_| is_read);
        }
        fusion.observe(frame);
    }
    // The lost object is in one snapshot.
    fusion.snapshot(START.plus_seconds(3.0));
    let snapshot = fusion.snapshot(START.plus_seconds(3.0));
    let [object] = &snapshot.objects[..] else { panic!("{snapshot:?}") };
    assert_eq!(object.body, Some(BodyId(0)));
    // All 360 frames show the rear roundel, and three quarters of them the front one.
    let counts = fusion.counts();
    assert!(counts.joined > 290 && counts.merged > 0, "{counts:?}");
}

#[test]
fn a_body_of_one_coded_roundel_has_its_code_and_tracked_point() {
    let mounts = vec![coded(3, flat(0.05, 0.0, 0.5))];
    let world = World::new(mounts.clone());
    let mut fusion = world.fusion(&mounts);
    let score = scored("one", &mut fusion, &world.frames(10.0));
    score.assert_honest();
    let object = &fusion.snapshot(START.plus_seconds(10.0)).objects[0];
    assert_eq!((object.code, object.kind), (Some(code(3)), Some(KindId(0))));
}

#[test]
fn a_driving_body_keeps_its_origin_at_its_height() {
    let world = World::new(two());
    let held_m = 0.4;
    let motion = MotionClass::Ground { height_m: Some(held_m) };
    let mut fusion = fusion_of(&world.arena, FusionParams::default());
    fusion.add_body(Body { motion, mounts: two() }).unwrap();
    // A single camera is less certain of the height than the floor.
    let mut frames = world.frames(3.0);
    frames.retain(|frame| frame.camera == CameraId(0));
    for frame in &mut frames {
        let t = frame.capture_time.seconds_since(START);
        let place = &world.arena.placements[0].world_from_camera;
        let lift_m = Vector3::new(0.0, 0.0, held_m - truth(t).translation.z);
        for detection in &mut frame.detections {
            let pose = detection.pose.as_mut().unwrap();
            pose.position_m += place.rotation.inverse() * lift_m;
            pose.covariance *= 100.0;
        }
        fusion.observe(frame);
    }
    let snapshot = fusion.snapshot(frames.last().unwrap().capture_time);
    let height_m = snapshot.objects[0].position_m.z;
    assert!((height_m - held_m).abs() < 0.01, "{height_m}");
}

/// The covariance includes that of the only camera's pose.
#[test]
fn the_covariance_includes_the_camera_pose() {
    let world = World::new(two());
    let mut fusion = world.fusion(&two());
    for (index, placement) in world.arena.placements.iter().enumerate() {
        let covariance = nalgebra::Matrix6::from_diagonal_element(25e-6);
        let placement = CameraPlacement { covariance, ..*placement };
        fusion.set_camera(CameraId(index as u32), Some(placement));
    }
    world.frames(3.0).iter().for_each(|frame| fusion.observe(frame));
    let object = &fusion.snapshot(START.plus_seconds(3.0)).objects[0];
    let deviation_m = object.covariance.fixed_view::<3, 3>(0, 0).trace().sqrt();
    assert!(deviation_m > 0.004, "{deviation_m}");
}

#[test]
fn a_roundel_belongs_to_one_body_once() {
    let mut fusion = Fusion::new(FusionParams::default());
    let mut add = |mounts| fusion.add_body(Body { motion: MotionClass::Free, mounts });
    let place = flat(0.0, 0.0, 0.0);
    let taken = |mount| Err(BodyError::Taken { mount });
    assert_eq!(add(vec![coded(3, place), coded(3, place)]), taken(1));
    assert_eq!(add(vec![plain(place), plain(place)]), taken(1));
    assert_eq!(add(vec![coded(3, place), plain(place)]), Ok(BodyId(0)));
    assert_eq!(add(vec![coded(4, place), coded(3, place)]), taken(1));
    assert_eq!(add(vec![plain(place)]), taken(0));
    // The failed call has claimed nothing.
    assert_eq!(add(vec![coded(4, place)]), Ok(BodyId(1)));
    let nowhere = Rigid::translation(f64::NAN, 0.0, 0.0);
    assert_eq!(add(vec![coded(5, nowhere)]), Err(BodyError::NotFinite { mount: 0 }));
}
