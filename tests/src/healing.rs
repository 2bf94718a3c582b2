//! Arenas whose cameras are bumped or drift, and the watch's reaction.
//!
//! A camera that moves by M, in its own frame, observes at M⁻¹ p what it observed at p. So the observations of fixed
//! cameras ([`Stream`]) are transformed. Detections that leave the image are kept.

mod tracks;

use std::sync::mpsc;

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use roundel_core::{
    calib::watch::{Watch, WatchEvent, WatchParams},
    id::CameraId,
    rigid::{Covariance6, rotate_covariance},
    time::Timestamp,
    world::{CameraPlacement, FrameObservations, Landmark},
};

use crate::{
    arena::Arena,
    random::Random,
    sensor::{Sensing, Stream},
};
pub use tracks::{CERTAIN_M, Tracks};

/// Duration of a bump.
pub const BUMP_S: f64 = 0.1;
/// Interval of virtual time between calls of the watch.
const STEP_S: f64 = 0.05;
/// A bump must be corrected within this time.
const RECOVERY_S: f64 = 60.0;

/// Motion of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Move {
    pub camera: CameraId,
    /// Start, seconds after the arena's start.
    pub at_s: f64,
    /// Duration.
    pub lasts_s: f64,
    /// In the camera's frame.
    pub shift_m: Vector3<f64>,
    /// About the camera's centre.
    pub turn_rad: Vector3<f64>,
}

/// Distance and angle of a bump.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BumpSize {
    pub shift_m: f64,
    pub turn_rad: f64,
}

impl BumpSize {
    /// A bump without rotation.
    pub fn shift(shift_m: f64) -> Self {
        Self { shift_m, turn_rad: 0.0 }
    }

    /// A bump without translation.
    pub fn turn(turn_rad: f64) -> Self {
        Self { shift_m: 0.0, turn_rad }
    }
}

impl Move {
    /// A bump in random directions.
    pub fn bump(camera: CameraId, at_s: f64, size: BumpSize, random: &mut Random) -> Self {
        let mut direction = || Vector3::from_fn(|_, _| f64::from(random.normal())).normalize();
        let (shift_m, turn_rad) = (direction() * size.shift_m, direction() * size.turn_rad);
        Self { camera, at_s, lasts_s: BUMP_S, shift_m, turn_rad }
    }

    fn by(&self, t: f64) -> Isometry3<f64> {
        let share = ((t - self.at_s) / self.lasts_s).clamp(0.0, 1.0);
        let turn = UnitQuaternion::from_scaled_axis(self.turn_rad * share);
        Isometry3::from_parts((self.shift_m * share).into(), turn)
    }
}

/// An arena whose cameras move.
#[derive(Clone, Debug)]
pub struct Healing {
    pub arena: Arena,
    pub sensing: Sensing,
    /// In order of time.
    pub moves: Vec<Move>,
    /// Landmarks that the watch knows.
    pub landmarks: Vec<Landmark>,
    /// Camera poses that the watch starts with.
    pub initial_poses: Vec<Isometry3<f64>>,
    /// Whether those poses were written by hand.
    pub is_rough: bool,
    /// Lens errors by camera: of the focal length, relative, and of the principal point, in focal lengths. Empty if
    /// lenses are right.
    pub lenses: Vec<[f64; 3]>,
}

/// Reaction to a bump.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Response {
    /// Seconds from the bump to its detection.
    pub detected_s: Option<f64>,
    /// Seconds from the bump to the camera's return.
    pub returned_s: Option<f64>,
    /// Position error of the new pose.
    pub position_error_m: f64,
    /// Rotation error of the new pose.
    pub rotation_error_rad: f64,
}

/// Results of a run.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// By bump, in the order of the moves.
    pub responses: Vec<Response>,
    /// Cameras reported as bumped that were not.
    pub false_alarms: usize,
    /// Corrections of drift.
    pub corrections: usize,
    /// All events with their times, seconds.
    pub events: Vec<(f64, WatchEvent)>,
    /// Largest position error of a pose in use, except within the minute after a bump.
    pub worst_m: f64,
    /// Largest rotation error of such a pose.
    pub worst_rad: f64,
}

impl Outcome {
    /// Whether each bump was detected within 3 s and corrected within 30 s to 1 mm and 0.02°, without false alarms.
    pub fn is_healed(&self) -> bool {
        let within = |time_s: Option<f64>, max_s: f64| time_s.is_some_and(|it| it <= max_s);
        let is_well = |it: &Response| {
            within(it.detected_s, 3.0)
                && within(it.returned_s, 30.0)
                && it.position_error_m <= 1e-3
                && it.rotation_error_rad <= 0.02f64.to_radians()
        };
        self.false_alarms == 0 && self.responses.iter().all(is_well)
    }
}

impl Healing {
    /// R4 with this frame rate and noise.
    pub fn r4(seed: u64, rate_hz: f64, noise_px: f64) -> Self {
        let mut arena = Arena::r4(seed);
        for site in &mut arena.sites {
            site.offset_s *= site.rate_hz / rate_hz;
            site.rate_hz = rate_hz;
        }
        let sensing = Sensing { noise_px, ..Sensing::DEFAULT };
        let initial_poses = arena.sites.iter().map(|site| site.world_from_camera).collect();
        let (moves, landmarks, lenses) = (Vec::new(), Vec::new(), Vec::new());
        Self { arena, sensing, moves, landmarks, initial_poses, is_rough: false, lenses }
    }

    /// Adds random errors of 0.05 % of the focal length, and of 0.5 px of the principal point at a focal length of
    /// 1000 px, to the lenses.
    pub fn with_wrong_lenses(mut self) -> Self {
        let mut random = Random::new(self.arena.seed, 90);
        let mut pose_error = || f64::from(random.normal()) * 5e-4;
        self.lenses =
            self.arena.sites.iter().map(|_| [pose_error(), pose_error(), pose_error()]).collect();
        self
    }

    /// Adds errors of this rms, metres and radians, to the camera poses that the watch starts with.
    pub fn with_rough_poses(mut self, position_error_m: f64, rotation_error_rad: f64) -> Self {
        let mut random = Random::new(self.arena.seed, 91);
        let mut pose_error =
            |rms: f64| Vector3::from_fn(|_, _| f64::from(random.normal()) * rms / 3.0f64.sqrt());
        for place in &mut self.initial_poses {
            let turn = UnitQuaternion::from_scaled_axis(pose_error(rotation_error_rad));
            *place *= Isometry3::from_parts(pose_error(position_error_m).into(), turn);
        }
        self.is_rough = true;
        self
    }

    /// Starts with the camera poses at the end of another run.
    pub fn with_corrections(mut self, outcome: &Outcome) -> Self {
        for (_, event) in &outcome.events {
            if let WatchEvent::Returned { camera, placement }
            | WatchEvent::Drifted { camera, placement, .. } = event
            {
                self.initial_poses[camera.0 as usize] = placement.world_from_camera;
            }
        }
        self
    }

    /// Bumps random cameras by 1 to 3 cm, 0.5° to 2° or both, spread over `seconds`.
    pub fn with_bumps(mut self, count: usize, seconds: f64) -> Self {
        let mut random = Random::new(self.arena.seed, 77);
        for index in 0..count {
            let camera = random.uniform(0.0, self.arena.sites.len() as f64) as u32;
            let at_s = (index as f64 + random.uniform(0.1, 0.9)) * seconds / count as f64;
            let shift_m = random.uniform(0.01, 0.03);
            let turn_rad = random.uniform(0.5, 2.0).to_radians();
            let both = BumpSize { shift_m, turn_rad };
            let size = [BumpSize::shift(shift_m), BumpSize::turn(turn_rad), both][index % 3];
            self.moves.push(Move::bump(CameraId(camera), at_s, size, &mut random));
        }
        self
    }

    /// True pose of a camera.
    pub fn truth(&self, camera: CameraId, t: f64) -> Isometry3<f64> {
        self.arena.sites[camera.0 as usize].world_from_camera * self.moved(camera, t)
    }

    fn moved(&self, camera: CameraId, t: f64) -> Isometry3<f64> {
        let own = self.moves.iter().filter(|it| it.camera == camera && it.at_s < t);
        own.fold(Isometry3::identity(), |before, it| before * it.by(t))
    }

    fn observed(&self, mut frame: FrameObservations) -> FrameObservations {
        let start = Timestamp::from_ns(self.arena.start_ns);
        let t = frame.capture_time.seconds_since(start);
        let back = self.moved(frame.camera, t).inverse();
        for pose in frame.detections.iter_mut().filter_map(|it| it.pose.as_mut()) {
            pose.position_m = (back * Point3::from(pose.position_m)).coords;
            if let Some([scale, right, down]) = self.lenses.get(frame.camera.0 as usize) {
                let depth_m = pose.position_m.z * (1.0 + scale);
                pose.position_m.z = depth_m;
                pose.position_m.x += right * depth_m;
                pose.position_m.y += down * depth_m;
            }
            pose.normal = back * pose.normal;
            pose.other_normal = back * pose.other_normal;
            pose.covariance = rotate_covariance(&back.rotation, &pose.covariance);
        }
        frame
    }

    /// Observations of all cameras for `seconds`, in order of arrival.
    pub fn frames(&self, seconds: f64) -> impl Iterator<Item = FrameObservations> {
        Stream::new(&self.arena, self.sensing, seconds).map(|frame| self.observed(frame))
    }

    /// Runs the watch for `seconds`.
    pub fn run(&self, params: WatchParams, seconds: f64) -> Outcome {
        let mut watch = Watch::new(params);
        let start = Timestamp::from_ns(self.arena.start_ns);
        let mut places: Vec<Option<Isometry3<f64>>> = Vec::new();
        for (index, (&world_from_camera, _)) in
            self.initial_poses.iter().zip(&self.arena.sites).enumerate()
        {
            let placement = CameraPlacement { world_from_camera, covariance: Covariance6::zeros() };
            watch.set_camera(CameraId(index as u32), placement);
            places.push(Some(world_from_camera));
        }
        watch.set_landmarks(&self.landmarks);
        let bumps = self.moves.iter().filter(|it| it.lasts_s <= BUMP_S).count();
        let mut outcome =
            Outcome { responses: vec![Response::default(); bumps], ..Outcome::default() };
        let mut next_s = STEP_S;
        std::thread::scope(|scope| {
            let (sender, frames) = mpsc::sync_channel(1000);
            scope.spawn(move || {
                // The receiver is gone if the test has failed.
                let _ = self.frames(seconds).try_for_each(|frame| sender.send(frame));
            });
            for frame in frames {
                let t = frame.received_time.seconds_since(start);
                watch.observe(&frame, 0.0);
                while t >= next_s {
                    for event in watch.advance(start.plus_seconds(next_s)) {
                        self.take(next_s, &event, &mut places, &mut outcome);
                        outcome.events.push((next_s, event));
                    }
                    self.compare(next_s, &places, &mut outcome);
                    next_s += STEP_S;
                }
            }
        });
        outcome
    }

    /// Index among the bumps, and time, of a camera's last bump before `t`.
    fn last_bump(&self, camera: CameraId, t: f64) -> Option<(usize, f64)> {
        let bumps = self.moves.iter().filter(|it| it.lasts_s <= BUMP_S).enumerate();
        let own = bumps.filter(|(_, it)| it.camera == camera && it.at_s <= t);
        own.last().map(|(index, it)| (index, it.at_s))
    }

    fn take(
        &self,
        t: f64,
        event: &WatchEvent,
        places: &mut [Option<Isometry3<f64>>],
        outcome: &mut Outcome,
    ) {
        match event {
            WatchEvent::Bumped { camera, .. } => {
                places[camera.0 as usize] = None;
                match self.last_bump(*camera, t) {
                    Some((index, at_s)) if outcome.responses[index].detected_s.is_none() => {
                        outcome.responses[index].detected_s = Some(t - at_s);
                    }
                    _ => outcome.false_alarms += 1,
                }
            }
            WatchEvent::Returned { camera, placement } => {
                let place = placement.world_from_camera;
                places[camera.0 as usize] = Some(place);
                if let Some((index, at_s)) = self.last_bump(*camera, t) {
                    let response = &mut outcome.responses[index];
                    response.returned_s = Some(t - at_s);
                    (response.position_error_m, response.rotation_error_rad) =
                        pose_error(&place, &self.truth(*camera, t));
                }
            }
            WatchEvent::Drifted { camera, placement, .. } => {
                places[camera.0 as usize] = Some(placement.world_from_camera);
                outcome.corrections += 1;
            }
            WatchEvent::Contradiction { .. }
            | WatchEvent::Misplaced { .. }
            | WatchEvent::Agreed { .. } => {}
        }
    }

    fn compare(&self, t: f64, places: &[Option<Isometry3<f64>>], outcome: &mut Outcome) {
        for (index, place) in places.iter().enumerate() {
            let (Some(place), camera) = (place, CameraId(index as u32)) else { continue };
            if self.last_bump(camera, t).is_some_and(|(_, at_s)| t - at_s < RECOVERY_S) {
                continue;
            }
            let (position_error_m, rotation_error_rad) = pose_error(place, &self.truth(camera, t));
            outcome.worst_m = outcome.worst_m.max(position_error_m);
            outcome.worst_rad = outcome.worst_rad.max(rotation_error_rad);
        }
    }
}

/// Distance between two poses, metres and radians.
fn pose_error(one: &Isometry3<f64>, other: &Isometry3<f64>) -> (f64, f64) {
    let apart_m = (one.translation.vector - other.translation.vector).norm();
    (apart_m, one.rotation.angle_to(&other.rotation))
}
