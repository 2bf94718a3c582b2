//! Products of the linear problem's columns, reused from one frame to the next.
//!
//! Where a ring has nearly the same pose, light and blur as in an earlier frame, its columns have
//! nearly the same products. Only those with the residual, which belong to the frame, are summed.
//! The relative error of step and covariance is bounded by [`NormalEquationCache::is_valid_for`]. A
//! frame that uses the cache passes it on unchanged, so errors do not accumulate.
//!
//! PERF: 30 px tracked, 0.88 of the time (`cargo bench -p roundel-tests --bench time`).

use nalgebra::Matrix2;

use super::{
    normal_equations::{MirrorProducts, NormalEquations},
    state::{BLUR, SHIFT, State, unknown_of},
};
use crate::pose::photometry::model::{
    column_products::{Products, STILL, column},
    local_lens::LocalLens,
    projection::PrintPose,
};

/// Columns without those of the residual and of the motion.
const COLUMNS: usize = STILL - 1;
const COUNT: usize = COLUMNS * (COLUMNS + 1) / 2;

/// Largest relative change of range, lens and number of pixels.
const MAX_CHANGE: f64 = 0.02;
/// Largest change of the levels, as a share of the step; only the columns of the light depend on
/// them.
const MAX_LEVEL_CHANGE: f64 = 0.05;
/// Largest relative change of σ²; the information varies with its fourth root.
const MAX_BLUR2_CHANGE: f64 = 0.06;
/// Largest rotation, as a share of the sine of the tilt; the information about tilts varies with
/// its square.
const MAX_TILT_CHANGE: f64 = 0.05;

/// Products of the columns of an earlier frame, and the conditions that they depend on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormalEquationCache {
    /// Upper triangle, row by row.
    products: [f32; COUNT],
    pose: PrintPose,
    /// Derivative of the lens.
    slope: Matrix2<f64>,
    blur2: f64,
    white: f64,
    step: f64,
    pixels: f64,
}

impl NormalEquationCache {
    /// From a fit of a plain print without motion; `None` if its blur was at a limit.
    pub fn new(state: &State, equations: &NormalEquations, lens: &LocalLens) -> Option<Self> {
        if equations.is_held(BLUR) {
            return None;
        }
        let mut products = [0.0; COUNT];
        let mut at = 0;
        for one in column::WHITE..STILL {
            for other in one..STILL {
                products[at] = equations.product(one, other) as f32;
                at += 1;
            }
        }
        let State { pose, blur2, white, step, .. } = *state;
        let (slope, pixels) = (lens.slope, equations.pixels);
        Some(Self { products, pose, slope, blur2, white, step, pixels })
    }

    /// Whether the products hold at a state with this number of counted pixels.
    pub fn is_valid_for(&self, state: &State, lens: &LocalLens, pixels: usize) -> bool {
        let is_near = |one: f64, other: f64| (one - other).abs() < MAX_CHANGE * other.abs();
        let is_lit =
            |one: f64, other: f64| (one - other).abs() < MAX_LEVEL_CHANGE * self.step.abs();
        let pose = &state.pose;
        let cosine = pose.axes.column(2).dot(&pose.position_m.normalize());
        // The difference of the matrices for a rotation by a small angle has the norm √2 times the
        // angle.
        let turn2 = 0.5 * (pose.axes - self.pose.axes).norm_squared();
        turn2 < MAX_TILT_CHANGE * MAX_TILT_CHANGE * (1.0 - cosine * cosine)
            && is_near(pose.position_m.z, self.pose.position_m.z)
            && (state.blur2 - self.blur2).abs() < MAX_BLUR2_CHANGE * state.blur2
            && is_lit(state.white, self.white)
            && is_lit(state.step, self.step)
            && is_near(pixels as f64, self.pixels)
            && (lens.slope - self.slope).norm() < MAX_CHANGE * self.slope.norm()
    }

    pub fn write_to(&self, products: &mut Products) {
        let mut at = 0;
        for one in column::WHITE..STILL {
            for other in one..STILL {
                let product = f64::from(self.products[at]);
                products[(one, other)] = product;
                products[(other, one)] = product;
                at += 1;
            }
        }
    }
}

impl NormalEquations {
    /// Product of two columns other than those of residual and motion.
    fn product(&self, one: usize, other: usize) -> f64 {
        let MirrorProducts { with_unknowns, own, .. } = &self.mirror;
        let step = self.scale[SHIFT];
        match (one, other) {
            (column::MIRROR, column::MIRROR) => own / (step * step),
            (one, column::MIRROR) | (column::MIRROR, one) => {
                let one = unknown_of(one);
                with_unknowns[one] / (self.scale[one] * step)
            }
            (one, other) => {
                let (one, other) = (unknown_of(one), unknown_of(other));
                self.information[one][other] / (self.scale[one] * self.scale[other])
            }
        }
    }
}
