//! Trials: rings of a given size and tilt are rendered, detected, tracked and located, each in a small picture.
//!
//! Rings have random subpixel positions and tilt directions and move by up to a pixel per frame. The camera is a pinhole
//! with the ring at an angle off its axis, under even light.

use std::f64::consts::{FRAC_1_SQRT_2, PI};

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{
    Imaging, Sensor, TrialCache,
    ring_image::{developed, picture},
    roundel_image::{RoundelImage, image_roundel},
};
use roundel_vision::{
    camera::{Camera, Intrinsics, Lens},
    frame::Frame,
    marker::{Detector, Kind, Mode, Params, Tracker},
    pose::Locator,
    rigid::Rigid,
};

/// Outer diameter of the rings, metres.
pub(super) const OUTER_M: f64 = 0.1;
/// Maximum motion per frame, pixels and radians.
const MOVED_PX: f64 = 1.0;
const TURNED_RAD: f64 = 0.01;
/// Margin around the ring, pixels and deviations of the blur.
const PAGE_PX: f64 = 6.0;
const PAGE_BLURS: f64 = 4.0;

/// Geometry of a view.
#[derive(Clone, Copy, Debug)]
pub(super) struct ViewGeometry {
    /// Shorter diameter, pixels.
    pub minor_px: f64,
    /// Angle between normal and line of sight.
    pub tilt_rad: f64,
    /// Angle between line of sight and optical axis.
    pub off_axis_rad: f64,
}

/// What pictures depend on besides the geometry.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct TrialSetup {
    pub focal_px: f64,
    pub imaging: Imaging,
    pub mode: Mode,
    /// Its outer diameter is [`OUTER_M`].
    pub kind: Kind,
}

/// Trials of one geometry.
pub(super) struct RingTrial<'a> {
    kind: &'a Kind,
    view: ViewGeometry,
    frames: usize,
    /// The part of the camera around the ring.
    pub sensor: Sensor,
    tracker: Tracker,
    locator: Locator,
    pixels: Vec<u8>,
}

/// A ring in a frame.
pub(super) struct TrialFrame {
    pub pose: Rigid,
    pub image: RoundelImage,
    /// The located position; `None` if the ring was not found.
    pub position_m: Option<Vector3<f64>>,
}

impl<'a> RingTrial<'a> {
    /// For rings in this number of consecutive frames.
    pub fn new(setup: &'a TrialSetup, view: ViewGeometry, frames: usize) -> Self {
        let TrialSetup { focal_px, imaging, mode, ref kind } = *setup;
        let diameter_px = view.minor_px / view.tilt_rad.cos();
        let page_px = PAGE_PX + PAGE_BLURS * imaging.blur_px + MOVED_PX * frames as f64;
        let long_px = diameter_px / view.off_axis_rad.cos().sqrt();
        let side = (long_px + 2.0 * page_px).ceil() as usize;
        let camera = square(focal_px, side, view.off_axis_rad);
        let params = Params { mode, ..Params::default() };
        let detector = Detector::new(vec![kind.clone()], params).expect("a kind as planned with");
        let trials = TrialCache::default();
        Self {
            kind,
            view,
            frames,
            tracker: Tracker::new(detector),
            locator: Locator::new(camera.clone(), vec![kind.clone()], mode),
            sensor: Sensor { camera, lens_uncertainty: None, imaging, mode, trials },
            pixels: vec![0; side * side],
        }
    }

    /// Consecutive frames of a random ring.
    pub fn run(&mut self, seed: u64) -> Vec<TrialFrame> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        self.tracker.reset();
        self.locator.reset();
        let ViewGeometry { minor_px, tilt_rad, off_axis_rad } = self.view;
        // Geometric mean of the radial and tangential scale, so that a ring has the same size as on the axis.
        let per_rad_px = self.sensor.camera.intrinsics().fx_px / off_axis_rad.cos().powf(1.5);
        let depth_m = per_rad_px * OUTER_M / (minor_px / tilt_rad.cos());
        let per_px = depth_m / per_rad_px;
        let axis = UnitQuaternion::from_scaled_axis(aside_axis() * off_axis_rad);
        let mut pose = axis * random_pose(depth_m, per_px, tilt_rad, &mut random);
        let mut frames = Vec::with_capacity(self.frames);
        for frame in 0..self.frames {
            if frame > 0 {
                pose = moved(&pose, per_px, &mut random);
            }
            frames.extend(self.observe(pose, &mut random));
        }
        frames
    }

    /// `None` if the ring faces away.
    fn observe(&mut self, pose: Rigid, random: &mut ChaCha8Rng) -> Option<TrialFrame> {
        let Sensor { camera, imaging, .. } = &self.sensor;
        let image = image_roundel(camera, self.kind, imaging, &pose)?;
        let side = camera.width();
        let levels = picture(&image.ring, imaging, side);
        developed(&levels, imaging.noise, random, &mut self.pixels);
        let view = Frame::new(&self.pixels, side, side, side).expect("a frame of this size");
        let tracked = self.tracker.process(&view).first();
        let located = tracked.and_then(|ring| self.locator.locate(&view, ring).ok());
        let position_m = located.map(|located| located.pose.position_m);
        Some(TrialFrame { pose, image, position_m })
    }
}

/// Near the axis with a random subpixel offset, tilt direction and rotation.
fn random_pose(depth_m: f64, per_px: f64, tilt_rad: f64, random: &mut ChaCha8Rng) -> Rigid {
    let off_axis = Vector3::new(within(random, 0.5), within(random, 0.5), 0.0) * per_px;
    let [lean, yaw] = [PI; 2].map(|max| within(random, max));
    let lean = Vector3::new(lean.cos(), lean.sin(), 0.0) * tilt_rad;
    let rotation = UnitQuaternion::from_scaled_axis(lean)
        * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI)
        * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
    Rigid::from_parts(Translation3::from(Vector3::z() * depth_m + off_axis), rotation)
}

/// The pose in the next frame.
fn moved(pose: &Rigid, per_px: f64, random: &mut ChaCha8Rng) -> Rigid {
    let shift = Vector3::from_fn(|_, _| within(random, MOVED_PX * per_px));
    let turn = Vector3::from_fn(|_, _| within(random, TURNED_RAD));
    Rigid::from_parts(
        Translation3::from(pose.translation.vector + shift),
        UnitQuaternion::from_scaled_axis(turn) * pose.rotation,
    )
}

/// Uniform from `-max` to `max`.
fn within(random: &mut ChaCha8Rng, max: f64) -> f64 {
    max * (2.0 * random.random::<f64>() - 1.0)
}

/// Axis of the rotation that moves the ring to the lower right.
fn aside_axis() -> Vector3<f64> {
    Vector3::new(-FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0)
}

/// Square part of a pinhole's picture around this angle off the axis.
fn square(focal_px: f64, side: usize, off_axis_rad: f64) -> Camera {
    let middle_px = 0.5 * (side as f64 - 1.0);
    let center_px = middle_px - FRAC_1_SQRT_2 * focal_px * off_axis_rad.tan();
    Camera::new(Intrinsics {
        width: side,
        height: side,
        fx_px: focal_px,
        fy_px: focal_px,
        cx_px: center_px,
        cy_px: center_px,
        lens: Lens::PlumbBob([0.0; 5]),
    })
    .expect("a pinhole of a camera that is planned with")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn setup() -> TrialSetup {
        let kind = Kind::plain("", OUTER_M, 0.4 * OUTER_M);
        TrialSetup { focal_px: 700.0, imaging: Imaging::default(), mode: Mode::Fast, kind }
    }

    fn frames(view: ViewGeometry) -> Vec<TrialFrame> {
        let setup = setup();
        let mut trial = RingTrial::new(&setup, view, 2);
        (0..40).flat_map(|seed| trial.run(seed)).collect()
    }

    #[test]
    fn rings_have_the_requested_size_and_tilt() {
        for (tilt_rad, off_axis_rad) in [(0.0, 0.0), (0.7, 0.0), (0.1, 0.6), (0.8, 0.6)] {
            let frames = frames(ViewGeometry { minor_px: 20.0, tilt_rad, off_axis_rad });
            assert_eq!(frames.len(), 80);
            let mut ratio = 0.0;
            for TrialFrame { image, .. } in &frames {
                assert!((image.tilt_rad - tilt_rad).abs() < 0.06, "{} {tilt_rad}", image.tilt_rad);
                ratio += image.minor_px / 20.0 / frames.len() as f64;
            }
            assert!((ratio - 1.0).abs() < 0.1, "{ratio}");
        }
    }

    #[test]
    fn trials_are_accurate_and_reproducible() {
        let view = ViewGeometry { minor_px: 24.0, tilt_rad: 0.5, off_axis_rad: 0.5 };
        for (frame, again) in frames(view).into_iter().zip(frames(view)) {
            let (position, truth) = (frame.position_m.unwrap(), frame.pose.translation.vector);
            assert!((position - truth).norm() < 0.02 * truth.norm(), "{position} {truth}");
            assert_eq!(Some(position), again.position_m);
        }
    }
}
