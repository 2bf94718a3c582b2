//! One trial: rings of a size and tilt are shown, detected, followed and located, each in a small picture of its own.
//!
//! They lie anywhere on the pixels, tilted to any side, and move by up to a pixel from frame to frame, as a worker follows
//! them. Lens and light are as simple as can be: a pinhole, looked through at an angle off its axis, and even light.

use std::f64::consts::{FRAC_1_SQRT_2, PI};

use nalgebra::{Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::{
    Imaging, Sensor, Trials,
    shot::{Edge, developed},
    sight::{Sighting, sight},
};
use roundel_vision::{
    camera::{Camera, Intrinsics, Lens},
    frame::Frame,
    marker::{Detector, Kind, Mode, Params, Tracker},
    pose::Locator,
    rigid::Rigid,
};

/// Outer diameter of what is shown, metres.
pub(super) const OUTER_M: f64 = 0.1;
/// Between frames: pixels and radians at most, each way.
const MOVED_PX: f64 = 1.0;
const TURNED_RAD: f64 = 0.01;
/// Picture about the ring, pixels and deviations of the blur.
const PAGE_PX: f64 = 6.0;
const PAGE_BLURS: f64 = 4.0;

/// How a ring is seen.
#[derive(Clone, Copy, Debug)]
pub(super) struct Geometry {
    /// Shorter diameter, pixels.
    pub minor_px: f64,
    /// Between normal and line of sight.
    pub tilt_rad: f64,
    /// Between line of sight and optical axis.
    pub aside_rad: f64,
}

/// How many rings are shown, in how many frames each, of which so many last ones count.
#[derive(Clone, Copy, Debug)]
pub(super) struct Length {
    pub courses: usize,
    pub frames: usize,
    pub counted: usize,
}

/// What looks, and at what.
#[derive(Debug)]
pub(super) struct Stage {
    pub sensor: Sensor,
    pub kind: Kind,
}

/// What was shown in a frame.
pub(super) struct Shown<'a> {
    pub sensor: &'a Sensor,
    pub kind: &'a Kind,
    pub pose: Rigid,
    pub sighting: Sighting,
}

impl Stage {
    /// Of a kind of the outer diameter [`OUTER_M`].
    pub fn new(focal_px: f64, imaging: Imaging, mode: Mode, kind: Kind) -> Self {
        let camera = square(focal_px, 1, 0.0);
        Self { sensor: Sensor { camera, imaging, mode, trials: Trials::default() }, kind }
    }

    /// Shows so many rings of a shorter diameter and a tilt, each for so many frames, and tells of the last ones where it was
    /// and where it was located, if it was found; until it is told that this is enough.
    pub fn shoot(
        &self,
        Geometry { minor_px, tilt_rad, aside_rad }: Geometry,
        Length { courses, frames, counted }: Length,
        mut told: impl FnMut(&Shown, Option<Vector3<f64>>) -> bool,
    ) {
        let Self { sensor, kind, .. } = self;
        let blur_px = sensor.imaging.blur_px;
        let diameter_px = minor_px / tilt_rad.cos();
        let page_px = PAGE_PX + PAGE_BLURS * blur_px + MOVED_PX * frames as f64;
        let side = (diameter_px / aside_rad.cos().sqrt() + 2.0 * page_px).ceil() as usize;
        let focal_px = sensor.camera.intrinsics().fx_px;
        let camera = square(focal_px, side, aside_rad);
        let sensor = &Sensor { camera: camera.clone(), ..sensor.clone() };
        let params = Params { mode: sensor.mode, ..Params::default() };
        let detector = Detector::new(vec![kind.clone()], params).expect("a kind as planned with");
        let mut tracker = Tracker::new(detector);
        let mut locator = Locator::new(camera, vec![kind.clone()], sensor.mode);
        let mut located = Vec::new();
        let edge = Edge::new(blur_px);
        let mut pixels = vec![0; side * side];
        // Of the angles that a pixel spans outwards and around, the mean: a ring is as large as one on the axis.
        let per_rad_px = focal_px / aside_rad.cos().powf(1.5);
        let depth_m = per_rad_px * OUTER_M / diameter_px;
        let axis = UnitQuaternion::from_scaled_axis(aside_axis() * aside_rad);
        for course in 0..courses {
            let mut random = ChaCha8Rng::seed_from_u64(course as u64);
            tracker.reset();
            locator.reset();
            let per_px = depth_m / per_rad_px;
            let mut pose = posed(depth_m, per_px, tilt_rad, &mut random);
            pose = axis * pose;
            for frame in 0..frames {
                if frame > 0 {
                    pose = moved(&pose, per_px, &mut random);
                }
                let seen = sight(&sensor.camera, kind, &sensor.imaging, &pose);
                let Some(sighting) = seen else { continue };
                let levels = edge.picture(&sighting.ring, &sensor.imaging, side);
                developed(&levels, sensor.imaging.noise, &mut random, &mut pixels);
                let view = Frame::new(&pixels, side, side, side).expect("a frame of this size");
                // One alone stays on this thread: others would have it wait for trials of theirs.
                let tracked = tracker.process(&view);
                locator.locate_all(&view, &tracked[..tracked.len().min(1)], &mut located);
                let position = located.iter().flatten().next().map(|it| it.pose.position_m);
                let counts = frame + counted >= frames;
                if counts && !told(&Shown { sensor, kind, pose, sighting }, position) {
                    return;
                }
            }
        }
    }
}

/// On the axis but for a part of a pixel, tilted to any side and turned about its normal.
fn posed(depth_m: f64, per_px: f64, tilt_rad: f64, random: &mut ChaCha8Rng) -> Rigid {
    let aside = Vector3::new(within(random, 0.5), within(random, 0.5), 0.0) * per_px;
    let [lean, yaw] = [PI; 2].map(|most| within(random, most));
    let lean = Vector3::new(lean.cos(), lean.sin(), 0.0) * tilt_rad;
    let rotation = UnitQuaternion::from_scaled_axis(lean)
        * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI)
        * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
    Rigid::from_parts(Translation3::from(Vector3::z() * depth_m + aside), rotation)
}

/// A frame later.
fn moved(pose: &Rigid, per_px: f64, random: &mut ChaCha8Rng) -> Rigid {
    let shift = Vector3::from_fn(|_, _| within(random, MOVED_PX * per_px));
    let turn = Vector3::from_fn(|_, _| within(random, TURNED_RAD));
    Rigid::from_parts(
        Translation3::from(pose.translation.vector + shift),
        UnitQuaternion::from_scaled_axis(turn) * pose.rotation,
    )
}

/// Uniform from `-most` to `most`.
fn within(random: &mut ChaCha8Rng, most: f64) -> f64 {
    most * (2.0 * random.random::<f64>() - 1.0)
}

/// About it what is looked at is turned away from the optical axis, to the picture's lower right.
fn aside_axis() -> Vector3<f64> {
    Vector3::new(-FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0)
}

/// The part about this angle off the axis of a pinhole's picture, so many pixels either way.
fn square(focal_px: f64, side: usize, aside_rad: f64) -> Camera {
    let middle_px = 0.5 * (side as f64 - 1.0);
    let center_px = middle_px - FRAC_1_SQRT_2 * focal_px * aside_rad.tan();
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

    fn stage() -> Stage {
        let kind = Kind::plain("", OUTER_M, 0.4 * OUTER_M);
        Stage::new(700.0, Imaging::default(), Mode::Fast, kind)
    }

    const LENGTH: Length = Length { courses: 40, frames: 3, counted: 2 };

    #[test]
    fn rings_are_shown_as_large_and_as_tilted_as_is_asked_for() {
        for (tilt_rad, aside_rad) in [(0.0, 0.0), (0.7, 0.0), (0.1, 0.6), (0.8, 0.6)] {
            let (mut count, mut ratio) = (0.0, 0.0);
            stage().shoot(Geometry { minor_px: 20.0, tilt_rad, aside_rad }, LENGTH, |shown, _| {
                let Sighting { minor_px, tilt_rad: shown_rad, .. } = shown.sighting;
                assert!((shown_rad - tilt_rad).abs() < 0.06, "{shown_rad} {tilt_rad}");
                (count, ratio) = (count + 1.0, ratio + minor_px / 20.0);
                true
            });
            assert_eq!(count, 80.0);
            assert!((ratio / count - 1.0).abs() < 0.1, "{}", ratio / count);
        }
    }

    #[test]
    fn all_are_located_near_the_truth_and_the_same_each_time() {
        let geometry = Geometry { minor_px: 24.0, tilt_rad: 0.5, aside_rad: 0.5 };
        let positions = || {
            let mut all = Vec::new();
            stage().shoot(geometry, LENGTH, |shown, position| {
                let (position, truth) = (position.unwrap(), shown.pose.translation.vector);
                assert!((position - truth).norm() < 0.02 * truth.norm(), "{position} {truth}");
                all.push(position);
                true
            });
            all
        };
        assert_eq!(positions(), positions());
    }

    #[test]
    fn no_more_is_shown_than_is_wanted() {
        let geometry = Geometry { minor_px: 24.0, tilt_rad: 0.5, aside_rad: 0.0 };
        let mut count = 0;
        stage().shoot(geometry, LENGTH, |_, _| {
            count += 1;
            count < 5
        });
        assert_eq!(count, 5);
    }
}
