//! What stays constant during a fit, and its unknowns.

use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};

pub use super::cholesky::UNKNOWNS;
use super::cholesky::Unknowns;
use crate::{
    marker::{Kind, Ring},
    pose::{
        PrintDeviation,
        photometry::model::{
            blur_kernel::BLUR_LIMITS_PX, column_products::column, local_lens::LocalLens, motion,
            projection::PrintPose, teeth::Teeth,
        },
    },
};

#[derive(Clone, Copy)]
pub struct Problem<'a> {
    pub kind: &'a Kind,
    pub print: PrintDeviation,
    pub teeth: Option<Teeth>,
    /// Whether the teeth are those of earlier frames.
    pub teeth_are_predicted: bool,
    pub radius_m: f64,
    pub lens: &'a LocalLens,
    /// Variance of μ besides its own size, px⁴.
    pub motion_prior: f64,
    /// Whether the motion is held at zero.
    pub is_still: bool,
}

impl Problem<'_> {
    /// Radius of the disc over that of the outer rim, as printed.
    pub fn disc_ratio(&self) -> f64 {
        self.print.disc_scale * self.kind.mean_ratio()
    }
}

#[derive(Clone, Debug)]
pub struct State {
    pub pose: PrintPose,
    /// σ², px².
    pub blur2: f64,
    /// μ, the square of the motion, px².
    pub motion2: Vector2<f64>,
    /// W, grey levels.
    pub white: f64,
    /// C = B - W, grey levels.
    pub step: f64,
    /// ℓ: relative change of the light by t.
    pub light: Vector2<f64>,
}

/// Indices of the unknowns.
/// The first two, since their columns are the last and may be left out.
pub const MOTION: usize = 0;
/// First of the unknowns that are always free, in the order of their columns.
pub const WHITE: usize = 2;
pub const STEP: usize = unknown_of(column::STEP);
pub const BLUR: usize = unknown_of(column::BLUR);
pub const LIGHT: usize = unknown_of(column::LIGHT);
pub const SHIFT: usize = unknown_of(column::SHIFT);
pub const RANGE: usize = unknown_of(column::RANGE);
pub const TILT: usize = unknown_of(column::TILT);

/// The unknown of a column other than those of the motion.
pub const fn unknown_of(column: usize) -> usize {
    column - column::WHITE + WHITE
}

pub const fn column_of(unknown: usize) -> usize {
    if unknown < WHITE {
        column::MOTION + unknown - MOTION
    } else {
        unknown - WHITE + column::WHITE
    }
}

/// Largest rotation of one step.
const MAX_TURN_RAD: f64 = 0.3;
/// Share of the tilt up to which a rotation is small: near face-on the information about the tilt
/// is proportional to its square.
const SMALL_TURN: f64 = 0.3;
/// Change of a rim by a rotation from face-on, pixels, which is linear enough.
const SMALL_BEND_PX: f64 = 0.01;
/// Sine of the tilt from which a first step separates the two normals.
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

    /// Mirrored along the line of sight.
    pub fn mirrored(&self) -> Self {
        let sight = self.pose.position_m.normalize();
        let flip = |axis: Vector3<f64>| axis - sight * (2.0 * sight.dot(&axis));
        let axes = &self.pose.axes;
        // The normal keeps its component along the line of sight; the plane's axes reverse theirs.
        let a = flip(axes.column(0).into_owned());
        let normal = -flip(axes.column(2).into_owned());
        let pose = PrintPose {
            position_m: self.pose.position_m,
            axes: Matrix3::from_columns(&[a, normal.cross(&a), normal]),
        };
        Self { pose, ..self.clone() }
    }

    /// Whether the blur is at a limit, and a change would exceed it.
    pub fn blur_at_limit(&self, change: f64) -> bool {
        let (low, high) = BLUR_LIMITS_PX;
        (change < 0.0 && self.blur2 <= low * low) || (change > 0.0 && self.blur2 >= high * high)
    }

    /// Changes the variance of blur and motion, averaged over directions, and the motion's square,
    /// within their limits.
    pub fn change_blur(&mut self, change: f64, motion2: Vector2<f64>) {
        let (low, high) = (BLUR_LIMITS_PX.0.powi(2), BLUR_LIMITS_PX.1.powi(2));
        let mean = (self.blur2 + motion::mean_variance(&self.motion2) + change).max(low);
        self.motion2 = motion::clamped(&(self.motion2 + motion2), mean - low);
        self.blur2 = (mean - motion::mean_variance(&self.motion2)).clamp(low, high);
    }

    /// Standard deviation of the edges, averaged over directions: blur, motion and the pixel's box.
    pub fn edge_px(&self) -> f64 {
        (self.blur2 + motion::mean_variance(&self.motion2) + 1.0 / 12.0).sqrt()
    }

    /// Without motion, and with edges of the same mean width.
    pub fn without_motion(&self) -> Self {
        let mut next = self.clone();
        next.change_blur(0.0, -self.motion2);
        next
    }

    pub fn tilt_sine2(&self) -> f64 {
        let cosine = self.pose.axes.column(2).dot(&self.pose.position_m.normalize());
        1.0 - cosine * cosine
    }

    /// Whether a rotation is small: beside the tilt, or by what it changes of a rim of this radius.
    pub fn is_small_turn(&self, change: &Unknowns, radius_px: f64) -> bool {
        let turn2 = change[TILT].powi(2) + change[TILT + 1].powi(2);
        let sine2 = self.tilt_sine2();
        let bend_px = radius_px * turn2.sqrt() * (turn2.sqrt() + sine2.sqrt());
        turn2 < SMALL_TURN * SMALL_TURN * sine2 || bend_px < SMALL_BEND_PX
    }

    /// Whether the two normals differ by more than a first step; nearer to face-on its estimate of
    /// the other one is useless.
    pub fn is_tilted(&self) -> bool {
        self.tilt_sine2() > MIN_TILT_SINE * MIN_TILT_SINE
    }

    /// After a step, with `unit_m` metres per unit of shift; `None` unless that is a roundel in front of the camera.
    pub fn moved(&self, unit_m: f64, change: &Unknowns) -> Option<Self> {
        let mut next = self.clone();
        next.white += change[WHITE];
        next.step += change[STEP];
        // The columns of shape were scaled by the old step.
        let ratio = self.step / next.step;
        if !(0.2..5.0).contains(&ratio) {
            return Some(next);
        }
        let motion2 = Vector2::new(change[MOTION], change[MOTION + 1]);
        next.change_blur(ratio * change[BLUR], motion2 * ratio);
        next.light += Vector2::new(change[LIGHT], change[LIGHT + 1]);
        let turn = Vector2::new(change[TILT], change[TILT + 1]) * ratio;
        // A rotation beyond its linearization is shortened, and the whole step with it.
        let cut = (MAX_TURN_RAD / turn.norm()).min(1.0) * ratio;
        let pose = &mut next.pose;
        let shift = Vector3::new(change[SHIFT], change[SHIFT + 1], 0.0) * unit_m;
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
