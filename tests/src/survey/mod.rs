//! Recordings that an arena's cameras are calibrated from, and how far off the result is.
//!
//! References are coded roundels that lie on the floor where the first camera sees them, near the corners
//! of its image; no other camera's sightings of them are kept, so that everything else hangs on robots that
//! drive about.

mod lens;

use nalgebra::{Isometry3, Point3, Vector2, Vector3, Vector6};
use roundel_core::{
    calib::arena::{ArenaCamera, CalibratedCamera, Recording},
    id::{CameraId, KindId},
    marker::Code,
    pose::{Detection, RoundelPose},
    world::{FrameObservations, Landmark},
};

use crate::{
    arena::{Arena, Path},
    optics::Pinhole,
    pipeline::core_camera,
    scenario::pixels,
    sensor::{Sensing, Stream},
};
pub use lens::{Mistaken, world_error_m};

/// References' distance from the image's edges, as shares of its sides.
const INSET: f64 = 0.12;
/// How well a reference's place is said to be known: measured once and well, metres.
const REFERENCE_SIGMA_M: f64 = 5e-5;
/// What is so near to a reference is taken for it where it is to be overlooked, metres.
const OVERLOOKED_M: f64 = 0.15;
/// Of robots whose prints have no codes.
const PLAIN: KindId = KindId(1);

/// An arena whose cameras' places nobody knows.
#[derive(Clone, Debug)]
pub struct Survey {
    /// With the references as the last of its robots.
    pub arena: Arena,
    /// Where they were said to be.
    pub references: Vec<Landmark>,
    /// Where they truly are, which other cameras than the first overlook.
    places_m: Vec<Vector3<f64>>,
}

impl Survey {
    /// Lays out four references before the first camera of an arena of coded roundels.
    pub fn new(mut arena: Arena) -> Self {
        let (site, kind) = (arena.sites[0].clone(), arena.kinds[0].clone());
        let bits = kind.code_bits.expect("survey: the arena's roundels are coded");
        let (mut references, mut places_m) = (Vec::new(), Vec::new());
        for (across, down) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            let along =
                |share: f64, size: usize| size as f64 * (INSET + share * (1.0 - 2.0 * INSET));
            let pixel =
                Vector2::new(along(across, site.optics.width), along(down, site.optics.height));
            let place_m = on_floor(&site.optics, &site.world_from_camera, &pixel);
            arena.add_robot(Path::still(place_m));
            let number = arena.robots[arena.robots.len() - 1].code.unwrap_or_default();
            places_m.push(place_m);
            references.push(Landmark {
                position_deviation_m: REFERENCE_SIGMA_M,
                ..Landmark::new(KindId(0), Some(Code { bits, number }), place_m)
            });
        }
        Self { arena, references, places_m }
    }

    /// Cameras as the arena has them.
    pub fn cameras(&self) -> Vec<ArenaCamera> {
        let camera = |(index, site): (usize, &crate::arena::Site)| ArenaCamera {
            id: CameraId(index as u32),
            lens: core_camera(&site.optics).expect("survey: a lens that core takes"),
            lens_deviation: None,
        };
        self.arena.sites.iter().enumerate().map(camera).collect()
    }

    /// So many seconds without pixels.
    pub fn record(&self, sensing: Sensing, seconds: f64, most_hz: f64) -> Recording {
        self.record_through(sensing, seconds, most_hz, |_, place_m| *place_m)
    }

    /// The same as if poses had been computed by other lenses: `place` says where a camera then measures
    /// what it measures at a place, metres in its frame.
    pub fn record_through(
        &self,
        sensing: Sensing,
        seconds: f64,
        most_hz: f64,
        place: impl Fn(CameraId, &Vector3<f64>) -> Vector3<f64>,
    ) -> Recording {
        let mut recording = Recording::new(most_hz);
        for mut frame in Stream::new(&self.arena, sensing, seconds) {
            for pose in frame.detections.iter_mut().filter_map(|it| it.pose.as_mut()) {
                pose.position_m = place(frame.camera, &pose.position_m);
            }
            recording.add(&self.overlooked(frame));
        }
        recording
    }

    /// The same of robots whose prints have no codes; the references keep theirs, as a kind of their own.
    pub fn record_plain(&self, sensing: Sensing, seconds: f64, most_hz: f64) -> Recording {
        let mut recording = Recording::new(most_hz);
        for mut frame in Stream::new(&self.arena, sensing, seconds) {
            let place = self.arena.sites[frame.camera.0 as usize].world_from_camera;
            for seen in &mut frame.detections {
                if !seen.pose.as_ref().is_some_and(|pose| self.is_reference(&place, pose)) {
                    (seen.ring.kind, seen.ring.code) = (Some(PLAIN), None);
                }
            }
            recording.add(&self.overlooked(frame));
        }
        recording
    }

    /// So many rendered frames of each camera.
    pub fn record_pixels(&self, frames: usize) -> Recording {
        let mut recording = Recording::new(1e3);
        for frame in pixels::watch(&self.arena, frames) {
            recording.add(&self.overlooked(frame));
        }
        recording
    }

    /// A frame as a camera gives it that cannot see the references, unless it is the first. Whatever stands
    /// where one does is left out, read, misread or not.
    pub fn overlooked(&self, mut frame: FrameObservations) -> FrameObservations {
        if frame.camera != CameraId(0) {
            let place = self.arena.sites[frame.camera.0 as usize].world_from_camera;
            let is_reference = |it: &Detection| {
                it.pose.as_ref().is_some_and(|pose| self.is_reference(&place, pose))
            };
            frame.detections.retain(|it| !is_reference(it));
        }
        frame
    }

    /// Whether what a camera at `place` sees there stands where a reference does.
    fn is_reference(&self, place: &Isometry3<f64>, pose: &RoundelPose) -> bool {
        let seen_m = place * Point3::from(pose.position_m);
        self.places_m.iter().any(|at_m| (seen_m.coords - at_m).norm() < OVERLOOKED_M)
    }

    /// How far a camera's result is off: metres and radians in the world, and the square of both over the
    /// stated covariance.
    pub fn error(&self, found: &CalibratedCamera, seconds: f64) -> SurveyError {
        let truth = self.arena.sites[found.camera.0 as usize].world_from_camera;
        let off = found.world_from_camera.translation.vector - truth.translation.vector;
        let turn = (found.world_from_camera.rotation * truth.rotation.inverse()).scaled_axis();
        let both = Vector6::new(off.x, off.y, off.z, turn.x, turn.y, turn.z);
        let square =
            found.covariance.cholesky().map_or(f64::INFINITY, |k| both.dot(&k.solve(&both)));
        let clock_s = found.clock_offset_s - self.ahead_s(found.camera, seconds / 2.0);
        SurveyError { off_m: off.norm(), turn_rad: turn.norm(), square, clock_s }
    }

    /// What a camera's clock is ahead of the first one's, `t` seconds after the arena's start.
    fn ahead_s(&self, camera: CameraId, t: f64) -> f64 {
        let [it, first] = [camera.0 as usize, 0].map(|index| self.arena.sites[index].clock);
        it.ahead_s - first.ahead_s + (it.skew - first.skew) * t
    }
}

/// How far a camera is off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurveyError {
    /// Metres.
    pub off_m: f64,
    /// Radians.
    pub turn_rad: f64,
    /// Of six, over the covariance.
    pub square: f64,
    /// Its clock's offset, seconds.
    pub clock_s: f64,
}

/// Where a pixel's ray meets the floor.
fn on_floor(optics: &Pinhole, place: &Isometry3<f64>, pixel: &Vector2<f64>) -> Vector3<f64> {
    let ray = place.rotation * optics.ray(pixel).expect("survey: a pixel with a ray");
    let eye_m = place.translation.vector;
    eye_m - ray * (eye_m.z / ray.z)
}
