//! Arenas whose cameras are bumped and drift, and what the watch makes of that.
//!
//! A camera that moves by M, in its own frame, has everything at M⁻¹ p that it had at p, so that sightings
//! of cameras that stand ([`Stream`]) are carried over. What falls out of the image is kept.

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
    normal::Random,
    sensor::{Sensing, Stream},
};
pub use tracks::{SURE_M, Tracks};

/// A bump takes so long, seconds.
pub const BUMP_S: f64 = 0.1;
/// Time is let pass in steps of this, seconds.
const STEP_S: f64 = 0.05;
/// A bump is answered within this, or missed, seconds.
const ANSWER_S: f64 = 60.0;

/// How a camera moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Move {
    /// Which.
    pub camera: CameraId,
    /// From when on, seconds after the arena's start …
    pub at_s: f64,
    /// … and for how long.
    pub lasts_s: f64,
    /// In its frame, metres.
    pub shift_m: Vector3<f64>,
    /// About its centre, radians.
    pub turn_rad: Vector3<f64>,
}

impl Move {
    /// A bump in a random direction: by so many metres, and so many radians.
    pub fn bump(
        camera: CameraId,
        at_s: f64,
        (shift_m, turn_rad): (f64, f64),
        random: &mut Random,
    ) -> Self {
        let mut direction = || Vector3::from_fn(|_, _| f64::from(random.normal())).normalize();
        let (shift_m, turn_rad) = (direction() * shift_m, direction() * turn_rad);
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
    /// As it was found.
    pub arena: Arena,
    /// How cameras err.
    pub sensing: Sensing,
    /// By time.
    pub moves: Vec<Move>,
    /// What the watch is told of.
    pub landmarks: Vec<Landmark>,
    /// Where cameras are said to stand, of those that there are.
    pub believed: Vec<Isometry3<f64>>,
    /// Those places were written by hand.
    pub is_rough: bool,
    /// How wrong lenses are, by camera: share of the focal length, and of the centre in focal lengths. None: not at all.
    pub lenses: Vec<[f64; 3]>,
}

/// What became of a bump.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Answer {
    /// Seconds from the bump to its notice …
    pub noticed_s: Option<f64>,
    /// … and to the return.
    pub returned_s: Option<f64>,
    /// How far off the place is with which it returned, metres …
    pub off_m: f64,
    /// … and radians.
    pub off_rad: f64,
}

/// What became of everything.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// By bump, in the moves' order.
    pub answers: Vec<Answer>,
    /// Cameras called bumped that were not.
    pub imagined: usize,
    /// Corrections of drift.
    pub corrections: usize,
    /// All events with their times, seconds.
    pub events: Vec<(f64, WatchEvent)>,
    /// Largest error of a place in service, but for the minute after each bump of it, metres …
    pub worst_m: f64,
    /// … and radians.
    pub worst_rad: f64,
}

impl Outcome {
    /// Whether each bump was noticed within 3 s, and healed within 30 s, 1 mm and 0.02°, and nothing else was.
    pub fn is_healed(&self) -> bool {
        let within = |time_s: Option<f64>, most_s: f64| time_s.is_some_and(|it| it <= most_s);
        let is_well = |it: &Answer| {
            within(it.noticed_s, 3.0)
                && within(it.returned_s, 30.0)
                && it.off_m <= 1e-3
                && it.off_rad <= 0.02f64.to_radians()
        };
        self.imagined == 0 && self.answers.iter().all(is_well)
    }
}

impl Healing {
    /// R4 with cameras of so many frames a second, that err by so many pixels.
    pub fn r4(seed: u64, rate_hz: f64, noise_px: f64) -> Self {
        let mut arena = Arena::r4(seed);
        for site in &mut arena.sites {
            site.offset_s *= site.rate_hz / rate_hz;
            site.rate_hz = rate_hz;
        }
        let sensing = Sensing { noise_px, ..Sensing::USUAL };
        let believed = arena.sites.iter().map(|site| site.world_from_camera).collect();
        let (moves, landmarks, lenses) = (Vec::new(), Vec::new(), Vec::new());
        Self { arena, sensing, moves, landmarks, believed, is_rough: false, lenses }
    }

    /// With lenses that are off by 0.05 % and 0.5 px of a focal length of 1000, at random.
    pub fn with_wrong_lenses(mut self) -> Self {
        let mut random = Random::new(self.arena.seed, 90);
        let mut off = || f64::from(random.normal()) * 5e-4;
        self.lenses = self.arena.sites.iter().map(|_| [off(), off(), off()]).collect();
        self
    }

    /// With cameras that stand so many metres and radians, rms, from where a person says that they do.
    pub fn with_rough_places(mut self, off_m: f64, off_rad: f64) -> Self {
        let mut random = Random::new(self.arena.seed, 91);
        let mut off =
            |rms: f64| Vector3::from_fn(|_, _| f64::from(random.normal()) * rms / 3.0f64.sqrt());
        for place in &mut self.believed {
            let turn = UnitQuaternion::from_scaled_axis(off(off_rad));
            *place *= Isometry3::from_parts(off(off_m).into(), turn);
        }
        self.is_rough = true;
        self
    }

    /// Cameras stand where the watch has come to believe that they do.
    pub fn as_found(mut self, outcome: &Outcome) -> Self {
        for (_, event) in &outcome.events {
            if let WatchEvent::Returned { camera, placement }
            | WatchEvent::Drifted { camera, placement, .. } = event
            {
                self.believed[camera.0 as usize] = placement.world_from_camera;
            }
        }
        self
    }

    /// Bumps of 1 to 3 cm, 0.5° to 2° or both, of random cameras, spread over so many seconds.
    pub fn with_bumps(mut self, count: usize, seconds: f64) -> Self {
        let mut random = Random::new(self.arena.seed, 77);
        for index in 0..count {
            let camera = random.uniform(0.0, self.arena.sites.len() as f64) as u32;
            let at_s = (index as f64 + random.uniform(0.1, 0.9)) * seconds / count as f64;
            let shift_m = random.uniform(0.01, 0.03);
            let turn_rad = random.uniform(0.5, 2.0).to_radians();
            let size = [(shift_m, 0.0), (0.0, turn_rad), (shift_m, turn_rad)][index % 3];
            self.moves.push(Move::bump(CameraId(camera), at_s, size, &mut random));
        }
        self
    }

    /// Where a camera truly stands.
    pub fn truth(&self, camera: CameraId, t: f64) -> Isometry3<f64> {
        self.arena.sites[camera.0 as usize].world_from_camera * self.moved(camera, t)
    }

    fn moved(&self, camera: CameraId, t: f64) -> Isometry3<f64> {
        let own = self.moves.iter().filter(|it| it.camera == camera && it.at_s < t);
        own.fold(Isometry3::identity(), |before, it| before * it.by(t))
    }

    fn seen(&self, mut frame: FrameObservations) -> FrameObservations {
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

    /// What cameras see in so many seconds, in the order in which it arrives.
    pub fn frames(&self, seconds: f64) -> impl Iterator<Item = FrameObservations> {
        Stream::new(&self.arena, self.sensing, seconds).map(|frame| self.seen(frame))
    }

    /// So many seconds of it.
    pub fn run(&self, params: WatchParams, seconds: f64) -> Outcome {
        let mut watch = Watch::new(params);
        let start = Timestamp::from_ns(self.arena.start_ns);
        let mut places: Vec<Option<Isometry3<f64>>> = Vec::new();
        for (index, (&world_from_camera, _)) in
            self.believed.iter().zip(&self.arena.sites).enumerate()
        {
            let placement = CameraPlacement { world_from_camera, covariance: Covariance6::zeros() };
            watch.set_camera(CameraId(index as u32), placement);
            places.push(Some(world_from_camera));
        }
        watch.set_landmarks(&self.landmarks);
        let bumps = self.moves.iter().filter(|it| it.lasts_s <= BUMP_S).count();
        let mut outcome = Outcome { answers: vec![Answer::default(); bumps], ..Outcome::default() };
        let mut next_s = STEP_S;
        std::thread::scope(|scope| {
            let (sender, frames) = mpsc::sync_channel(1000);
            scope.spawn(move || {
                // Nobody listens any more: the test has failed.
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

    /// A camera's last bump before `t`, among the bumps.
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
                    Some((index, at_s)) if outcome.answers[index].noticed_s.is_none() => {
                        outcome.answers[index].noticed_s = Some(t - at_s);
                    }
                    _ => outcome.imagined += 1,
                }
            }
            WatchEvent::Returned { camera, placement } => {
                let place = placement.world_from_camera;
                places[camera.0 as usize] = Some(place);
                if let Some((index, at_s)) = self.last_bump(*camera, t) {
                    let answer = &mut outcome.answers[index];
                    answer.returned_s = Some(t - at_s);
                    (answer.off_m, answer.off_rad) = off(&place, &self.truth(*camera, t));
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
            if self.last_bump(camera, t).is_some_and(|(_, at_s)| t - at_s < ANSWER_S) {
                continue;
            }
            let (off_m, off_rad) = off(place, &self.truth(camera, t));
            outcome.worst_m = outcome.worst_m.max(off_m);
            outcome.worst_rad = outcome.worst_rad.max(off_rad);
        }
    }
}

/// How far a place is from another, metres and radians.
fn off(one: &Isometry3<f64>, other: &Isometry3<f64>) -> (f64, f64) {
    let apart_m = (one.translation.vector - other.translation.vector).norm();
    (apart_m, one.rotation.angle_to(&other.rotation))
}
