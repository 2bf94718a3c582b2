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
    ring_image::{BlurredEdge, developed},
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

/// Number of rings, frames of each, and frames that count at the end.
#[derive(Clone, Copy, Debug)]
pub(super) struct TrialLength {
    pub rings: usize,
    pub frames: usize,
    pub counted: usize,
}

#[derive(Debug)]
pub(super) struct TrialSetup {
    pub sensor: Sensor,
    pub kind: Kind,
}

pub(super) struct TrialFrame<'a> {
    pub sensor: &'a Sensor,
    pub pose: Rigid,
    pub image: RoundelImage,
}

impl TrialSetup {
    /// For a kind with the outer diameter [`OUTER_M`].
    pub fn new(focal_px: f64, imaging: Imaging, mode: Mode, kind: Kind) -> Self {
        let camera = square(focal_px, 1, 0.0);
        let trials = TrialCache::default();
        Self { sensor: Sensor { camera, lens_uncertainty: None, imaging, mode, trials }, kind }
    }

    /// Runs the trials of a geometry and passes each counted frame with the located position, if any, until
    /// `on_frame` returns false.
    pub fn run(
        &self,
        ViewGeometry { minor_px, tilt_rad, off_axis_rad }: ViewGeometry,
        TrialLength { rings, frames, counted }: TrialLength,
        mut on_frame: impl FnMut(&TrialFrame, Option<Vector3<f64>>) -> bool,
    ) {
        let Self { sensor, kind, .. } = self;
        let blur_px = sensor.imaging.blur_px;
        let diameter_px = minor_px / tilt_rad.cos();
        let page_px = PAGE_PX + PAGE_BLURS * blur_px + MOVED_PX * frames as f64;
        let side = (diameter_px / off_axis_rad.cos().sqrt() + 2.0 * page_px).ceil() as usize;
        let focal_px = sensor.camera.intrinsics().fx_px;
        let camera = square(focal_px, side, off_axis_rad);
        let sensor = &Sensor { camera: camera.clone(), ..sensor.clone() };
        let params = Params { mode: sensor.mode, ..Params::default() };
        let detector = Detector::new(vec![kind.clone()], params).expect("a kind as planned with");
        let mut tracker = Tracker::new(detector);
        let mut locator = Locator::new(camera, vec![kind.clone()], sensor.mode);
        let mut located = Vec::new();
        let edge = BlurredEdge::new(blur_px);
        let mut pixels = vec![0; side * side];
        // Geometric mean of the radial and tangential scale, so that a ring has the same size as on the axis.
        let per_rad_px = focal_px / off_axis_rad.cos().powf(1.5);
        let depth_m = per_rad_px * OUTER_M / diameter_px;
        let axis = UnitQuaternion::from_scaled_axis(aside_axis() * off_axis_rad);
        for ring_index in 0..rings {
            let mut random = ChaCha8Rng::seed_from_u64(ring_index as u64);
            tracker.reset();
            locator.reset();
            let per_px = depth_m / per_rad_px;
            let mut pose = random_pose(depth_m, per_px, tilt_rad, &mut random);
            pose = axis * pose;
            for frame in 0..frames {
                if frame > 0 {
                    pose = moved(&pose, per_px, &mut random);
                }
                let seen = image_roundel(&sensor.camera, kind, &sensor.imaging, &pose);
                let Some(image) = seen else { continue };
                let levels = edge.picture(&image.ring, &sensor.imaging, side);
                developed(&levels, sensor.imaging.noise, &mut random, &mut pixels);
                let view = Frame::new(&pixels, side, side, side).expect("a frame of this size");
                // A single ring is located on this thread; a parallel one could wait for other trials.
                let tracked = tracker.process(&view);
                locator.locate_all(&view, &tracked[..tracked.len().min(1)], &mut located);
                let position = located.iter().flatten().next().map(|it| it.pose.position_m);
                let counts = frame + counted >= frames;
                if counts && !on_frame(&TrialFrame { sensor, pose, image }, position) {
                    return;
                }
            }
        }
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
        TrialSetup::new(700.0, Imaging::default(), Mode::Fast, kind)
    }

    const ERROR_TRIALS: TrialLength = TrialLength { rings: 40, frames: 3, counted: 2 };

    #[test]
    fn rings_have_the_requested_size_and_tilt() {
        for (tilt_rad, off_axis_rad) in [(0.0, 0.0), (0.7, 0.0), (0.1, 0.6), (0.8, 0.6)] {
            let (mut count, mut ratio) = (0.0, 0.0);
            setup().run(
                ViewGeometry { minor_px: 20.0, tilt_rad, off_axis_rad },
                ERROR_TRIALS,
                |trial, _| {
                    let RoundelImage { minor_px, tilt_rad: shown_rad, .. } = trial.image;
                    assert!((shown_rad - tilt_rad).abs() < 0.06, "{shown_rad} {tilt_rad}");
                    (count, ratio) = (count + 1.0, ratio + minor_px / 20.0);
                    true
                },
            );
            assert_eq!(count, 80.0);
            assert!((ratio / count - 1.0).abs() < 0.1, "{}", ratio / count);
        }
    }

    #[test]
    fn trials_are_accurate_and_reproducible() {
        let geometry = ViewGeometry { minor_px: 24.0, tilt_rad: 0.5, off_axis_rad: 0.5 };
        let positions = || {
            let mut all = Vec::new();
            setup().run(geometry, ERROR_TRIALS, |trial, position| {
                let (position, truth) = (position.unwrap(), trial.pose.translation.vector);
                assert!((position - truth).norm() < 0.02 * truth.norm(), "{position} {truth}");
                all.push(position);
                true
            });
            all
        };
        assert_eq!(positions(), positions());
    }

    #[test]
    fn a_trial_stops_on_request() {
        let geometry = ViewGeometry { minor_px: 24.0, tilt_rad: 0.5, off_axis_rad: 0.0 };
        let mut count = 0;
        setup().run(geometry, ERROR_TRIALS, |_, _| {
            count += 1;
            count < 5
        });
        assert_eq!(count, 5);
    }
}
