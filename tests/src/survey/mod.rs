//! Recordings for the calibration of an arena's cameras, and the errors of the result.
//!
//! References are coded roundels on the floor, near the corners of the first camera's image. Other cameras'
//! observations of them are removed, so that the other cameras' poses depend on moving robots alone.

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
pub use lens::{WrongLenses, world_error_m};

/// Distance between references and the image's edges, as a share of its sides.
const INSET: f64 = 0.12;
/// Stated deviation of a reference's position.
const REFERENCE_SIGMA_M: f64 = 5e-5;
/// Detections this close to a reference are removed with it.
const REFERENCE_RADIUS_M: f64 = 0.15;
/// Kind of robots without codes.
const PLAIN: KindId = KindId(1);

/// An arena with cameras of unknown pose.
#[derive(Clone, Debug)]
pub struct Survey {
    /// The references are the last of its robots.
    pub arena: Arena,
    /// With their stated positions.
    pub references: Vec<Landmark>,
    /// True positions of the references.
    places_m: Vec<Vector3<f64>>,
}

impl Survey {
    /// Places four references before the first camera of an arena with coded roundels.
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

    /// The arena's cameras with their true lenses.
    pub fn cameras(&self) -> Vec<ArenaCamera> {
        let camera = |(index, site): (usize, &crate::arena::Site)| ArenaCamera {
            id: CameraId(index as u32),
            lens: core_camera(&site.optics).expect("survey: a lens that core takes"),
            lens_deviation: None,
        };
        self.arena.sites.iter().enumerate().map(camera).collect()
    }

    /// Observations for `seconds`, simulated without pixels.
    pub fn record(&self, sensing: Sensing, seconds: f64, max_hz: f64) -> Recording {
        self.record_with_lenses(sensing, seconds, max_hz, |_, place_m| *place_m)
    }

    /// The same with poses computed by wrong lenses: `place` maps a true position in the camera frame to the measured
    /// one.
    pub fn record_with_lenses(
        &self,
        sensing: Sensing,
        seconds: f64,
        max_hz: f64,
        place: impl Fn(CameraId, &Vector3<f64>) -> Vector3<f64>,
    ) -> Recording {
        let mut recording = Recording::new(max_hz);
        for mut frame in Stream::new(&self.arena, sensing, seconds) {
            for pose in frame.detections.iter_mut().filter_map(|it| it.pose.as_mut()) {
                pose.position_m = place(frame.camera, &pose.position_m);
            }
            recording.add(&self.without_references(frame));
        }
        recording
    }

    /// The same for robots without codes. The references keep theirs and have a kind of their own.
    pub fn record_plain(&self, sensing: Sensing, seconds: f64, max_hz: f64) -> Recording {
        let mut recording = Recording::new(max_hz);
        for mut frame in Stream::new(&self.arena, sensing, seconds) {
            let place = self.arena.sites[frame.camera.0 as usize].world_from_camera;
            for seen in &mut frame.detections {
                if !seen.pose.as_ref().is_some_and(|pose| self.is_reference(&place, pose)) {
                    (seen.ring.kind, seen.ring.code) = (Some(PLAIN), None);
                }
            }
            recording.add(&self.without_references(frame));
        }
        recording
    }

    /// Observations of this number of rendered frames of each camera.
    pub fn record_pixels(&self, frames: usize) -> Recording {
        let mut recording = Recording::new(1e3);
        for frame in pixels::watch(&self.arena, frames) {
            recording.add(&self.without_references(frame));
        }
        recording
    }

    /// Removes detections near references, read, misread or not, unless the camera is the first.
    pub fn without_references(&self, mut frame: FrameObservations) -> FrameObservations {
        if frame.camera != CameraId(0) {
            let place = self.arena.sites[frame.camera.0 as usize].world_from_camera;
            let is_reference = |it: &Detection| {
                it.pose.as_ref().is_some_and(|pose| self.is_reference(&place, pose))
            };
            frame.detections.retain(|it| !is_reference(it));
        }
        frame
    }

    /// Whether a detection by a camera at pose `place` is near a reference.
    fn is_reference(&self, place: &Isometry3<f64>, pose: &RoundelPose) -> bool {
        let seen_m = place * Point3::from(pose.position_m);
        self.places_m.iter().any(|at_m| (seen_m.coords - at_m).norm() < REFERENCE_RADIUS_M)
    }

    /// Errors of a camera's calibration.
    pub fn error(&self, found: &CalibratedCamera, seconds: f64) -> SurveyError {
        let truth = self.arena.sites[found.camera.0 as usize].world_from_camera;
        let off = found.world_from_camera.translation.vector - truth.translation.vector;
        let turn = (found.world_from_camera.rotation * truth.rotation.inverse()).scaled_axis();
        let both = Vector6::new(off.x, off.y, off.z, turn.x, turn.y, turn.z);
        let square =
            found.covariance.cholesky().map_or(f64::INFINITY, |k| both.dot(&k.solve(&both)));
        let clock_s = found.clock_offset_s - self.ahead_s(found.camera, seconds / 2.0);
        SurveyError { position_m: off.norm(), rotation_rad: turn.norm(), square, clock_s }
    }

    /// Lead of a camera's clock over the first one's, `t` seconds after the arena's start.
    fn ahead_s(&self, camera: CameraId, t: f64) -> f64 {
        let [it, first] = [camera.0 as usize, 0].map(|index| self.arena.sites[index].clock);
        it.ahead_s - first.ahead_s + (it.skew - first.skew) * t
    }
}

/// Errors of one camera's calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurveyError {
    pub position_m: f64,
    pub rotation_rad: f64,
    /// Normalized squared error, six degrees of freedom.
    pub square: f64,
    /// Error of its clock's offset.
    pub clock_s: f64,
}

/// Intersection of a pixel's ray with the floor.
fn on_floor(optics: &Pinhole, place: &Isometry3<f64>, pixel: &Vector2<f64>) -> Vector3<f64> {
    let ray = place.rotation * optics.ray(pixel).expect("survey: a pixel with a ray");
    let eye_m = place.translation.vector;
    eye_m - ray * (eye_m.z / ray.z)
}
