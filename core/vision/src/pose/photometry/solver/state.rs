//! The fit's unknowns, and what stays the same during a fit.

use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};

use super::{
    cholesky::MAX_UNKNOWNS, normal_equation_cache::NormalEquationCache,
    normal_equations::NormalEquations,
};
use crate::{
    ellipse::Chords,
    frame::Frame,
    marker::{Kind, Ring},
    pose::photometry::model::{
        blur_kernel::BLUR_LIMITS_PX, column_products::column, local_lens::LocalLens, motion,
        projection::PrintPose, teeth::Teeth,
    },
};

/// What stays the same during one fit.
#[derive(Clone, Copy)]
pub struct Problem<'a> {
    pub frame: &'a Frame<'a>,
    pub kind: &'a Kind,
    /// Of a coded print.
    pub teeth: Option<Teeth>,
    /// Whether these teeth are those of earlier frames.
    pub teeth_are_predicted: bool,
    pub radius_m: f64,
    pub lens: &'a LocalLens,
    /// Pixels that count.
    pub chords: Chords,
    /// Variance of μ beforehand besides its own size, px⁴.
    pub motion_prior: f64,
    /// Whether the motion is held at none.
    pub is_still: bool,
    /// From a frame before.
    pub cache: Option<&'a NormalEquationCache>,
}

/// The unknowns.
#[derive(Clone, Debug)]
pub struct State {
    pub pose: PrintPose,
    /// σ², px².
    pub blur2: f64,
    /// μ, the motion's square, px².
    pub motion2: Vector2<f64>,
    /// W, grey levels.
    pub white: f64,
    /// C = B - W, grey levels.
    pub step: f64,
    /// ℓ: relative change of the light by t.
    pub light: Vector2<f64>,
}

/// Unknowns.
pub const UNKNOWNS: usize = MAX_UNKNOWNS;
/// The motion's square; its columns are the last ones, so that held ones can be left out.
pub const MOTION: usize = 0;
/// The first of those that are always free, in their columns' order.
pub const WHITE: usize = 2;
pub const STEP: usize = unknown_of(column::STEP);
pub const BLUR: usize = unknown_of(column::BLUR);
pub const LIGHT: usize = unknown_of(column::LIGHT);
pub const SHIFT: usize = unknown_of(column::SHIFT);
pub const RANGE: usize = unknown_of(column::RANGE);
pub const TILT: usize = unknown_of(column::TILT);

/// The unknown of a column other than the motion's, which has one.
pub const fn unknown_of(column: usize) -> usize {
    column - column::WHITE + WHITE
}

/// The column of an unknown.
pub const fn column_of(unknown: usize) -> usize {
    if unknown < WHITE {
        column::MOTION + unknown - MOTION
    } else {
        unknown - WHITE + column::WHITE
    }
}

/// Largest turn of one step, radians.
const MAX_TURN_RAD: f64 = 0.3;
/// A turn by no more than this share of the tilt is a small one: of a roundel that is seen face-on the
/// information about its tilt comes with the tilt.
const SMALL_TURN: f64 = 0.3;
/// Sine of the tilt from which on a first step tells the two normals apart.
const MIN_TILT_SINE: f64 = 0.2;

impl State {
    pub fn new(pose: PrintPose, ring: &Ring, blur_px: f64, motion_px: &Vector2<f64>) -> Self {
        Self {
            pose,
            blur2: blur_px * blur_px,
            motion2: motion::to_square(motion_px),
            white: ring.white,
            step: ring.black - ring.white,
            light: Vector2::zeros(),
        }
    }

    /// The other place that looks nearly the same: mirrored along the line of sight.
    pub fn mirrored(&self) -> Self {
        let sight = self.pose.position_m.normalize();
        let flip = |axis: Vector3<f64>| axis - sight * (2.0 * sight.dot(&axis));
        let axes = &self.pose.axes;
        // The normal's component along the sight stays, those of the plane's axes turn round.
        let a = flip(axes.column(0).into_owned());
        let normal = -flip(axes.column(2).into_owned());
        let pose = PrintPose {
            position_m: self.pose.position_m,
            axes: Matrix3::from_columns(&[a, normal.cross(&a), normal]),
        };
        Self { pose, ..self.clone() }
    }

    /// Whether the blur is at the end of its range, and a change would take it out.
    pub fn blur_at_limit(&self, change: f64) -> bool {
        let (low, high) = BLUR_LIMITS_PX;
        (change < 0.0 && self.blur2 <= low * low) || (change > 0.0 && self.blur2 >= high * high)
    }

    /// The variance of blur and motion in the mean of all directions changed, and the motion's square, within
    /// their limits.
    pub fn change_blur(&mut self, change: f64, motion2: Vector2<f64>) {
        let (low, high) = (BLUR_LIMITS_PX.0.powi(2), BLUR_LIMITS_PX.1.powi(2));
        let mean = (self.blur2 + motion::mean_variance(&self.motion2) + change).max(low);
        self.motion2 = motion::clamped(&(self.motion2 + motion2), mean - low);
        self.blur2 = (mean - motion::mean_variance(&self.motion2)).clamp(low, high);
    }

    /// Deviation of the edges in the mean of all directions: blur, motion and the pixel's box.
    pub fn edge_px(&self) -> f64 {
        (self.blur2 + motion::mean_variance(&self.motion2) + 1.0 / 12.0).sqrt()
    }

    /// The same without motion, and edges as wide in the mean.
    pub fn without_motion(&self) -> Self {
        let mut next = self.clone();
        next.change_blur(0.0, -self.motion2);
        next
    }

    /// Whether a change turns the plane by little, compared to its tilt.
    pub fn is_small_turn(&self, change: &[f64; MAX_UNKNOWNS]) -> bool {
        let cosine = self.pose.axes.column(2).dot(&self.pose.position_m.normalize());
        let turn2 = change[TILT].powi(2) + change[TILT + 1].powi(2);
        turn2 < SMALL_TURN * SMALL_TURN * (1.0 - cosine * cosine)
    }

    /// Whether the two normals are so far apart that a first step tells them apart: nearer to face-on
    /// it goes as far as they are, and what it says of the other one is worth nothing.
    pub fn is_tilted(&self) -> bool {
        let pose = &self.pose;
        let cosine = pose.axes.column(2).dot(&pose.position_m.normalize());
        1.0 - cosine * cosine > MIN_TILT_SINE * MIN_TILT_SINE
    }

    /// Moved by a solution; `None` if that is no roundel in front of the camera.
    pub fn moved(&self, equations: &NormalEquations, change: &[f64; MAX_UNKNOWNS]) -> Option<Self> {
        let mut next = self.clone();
        next.white += change[WHITE];
        next.step += change[STEP];
        // Shape's columns were taken times the step; it is known better now.
        let ratio = self.step / next.step;
        if !(0.2..5.0).contains(&ratio) {
            return Some(next);
        }
        let motion2 = Vector2::new(change[MOTION], change[MOTION + 1]);
        next.change_blur(ratio * change[BLUR], motion2 * ratio);
        next.light += Vector2::new(change[LIGHT], change[LIGHT + 1]);
        let turn = Vector2::new(change[TILT], change[TILT + 1]) * ratio;
        // A turn too large for its own linearization is cut, and all else with it.
        let cut = (MAX_TURN_RAD / turn.norm()).min(1.0) * ratio;
        let pose = &mut next.pose;
        let shift = Vector3::new(change[SHIFT], change[SHIFT + 1], 0.0) * equations.unit_m;
        pose.position_m *= (cut * change[RANGE]).clamp(-0.2, 0.2).exp();
        pose.position_m += shift * cut;
        let (a, b) = (pose.axes.column(0), pose.axes.column(1));
        let turn = (a * change[TILT] + b * change[TILT + 1]) * cut;
        pose.axes = Rotation3::new(turn).matrix() * pose.axes;
        let normal = pose.axes.column(2);
        let faces = normal.dot(&pose.position_m) < 0.0 && pose.position_m.z > 0.0;
        faces.then_some(next)
    }
}
