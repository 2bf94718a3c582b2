//! The products of the linear problem's columns, from one frame to the next.
//!
//! Where a ring stands, is lit and blurred nearly as in a frame before, its columns have nearly the products
//! that they had there, and only those with the residual, which are the frame's own, are to be summed: the
//! step, and the covariance, then err by a share of themselves that [`RecalledProducts::serve`] bounds.
//! Products recalled are never handed on as those of the frame that recalled them, so that no such share
//! comes upon another.
//!
//! PERF: 30 px followed, 0.88 of the time (`cargo bench -p roundel-tests --bench time`).

use nalgebra::Matrix2;

use super::{
    normal_equations::NormalEquations,
    state::{BLUR, Problem, SHIFT, State, unknown_of},
};
use crate::{
    marker::Pattern,
    pose::photometry::model::{
        column_products::{Products, STILL, column},
        projection::PrintPose,
    },
};

/// Columns but for the residual's and the motion's, and their products.
const COLUMNS: usize = STILL - 1;
const COUNT: usize = COLUMNS * (COLUMNS + 1) / 2;

/// By no more than this share may range, lens and number of pixels be others …
const MAX_CHANGE: f64 = 0.02;
/// … the levels by this share of the step, with which only the light's columns go, …
const MAX_LEVEL_CHANGE: f64 = 0.05;
/// … and σ², with whose fourth root the information goes.
const MAX_BLUR2_CHANGE: f64 = 0.06;
/// Turned by no more than this share of the sine of the tilt, with whose square the tilts' information goes.
const MAX_TILT_CHANGE: f64 = 0.05;

/// Products of columns of a frame before, and of what they depend on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormalEquationCache {
    /// Upper triangle, row by row.
    products: [f32; COUNT],
    pose: PrintPose,
    /// Of the lens.
    slope: Matrix2<f64>,
    blur2: f64,
    white: f64,
    step: f64,
    pixels: f64,
}

impl NormalEquationCache {
    /// Of a fit that took them anew; `None` if its motion was free, the blur was held, or the print is not
    /// a plain one, whose columns hang on more than is compared.
    pub fn of(problem: &Problem, state: &State, equations: &NormalEquations) -> Option<Self> {
        let is_plain = matches!(problem.kind.pattern, Pattern::Plain);
        if !(problem.is_still && is_plain) || equations.is_held(BLUR) {
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
        let (slope, pixels) = (problem.lens.slope, equations.pixels);
        Some(Self { products, pose, slope, blur2, white, step, pixels })
    }

    /// Whether they are as good as those of a state, of which so many pixels count.
    pub fn is_valid_for(&self, problem: &Problem, state: &State, pixels: usize) -> bool {
        let is_near = |one: f64, other: f64| (one - other).abs() < MAX_CHANGE * other.abs();
        let is_lit =
            |one: f64, other: f64| (one - other).abs() < MAX_LEVEL_CHANGE * self.step.abs();
        let pose = &state.pose;
        let cosine = pose.axes.column(2).dot(&pose.position_m.normalize());
        // Of a turn by a small angle the matrix's difference has the norm √2 times the angle.
        let turn2 = 0.5 * (pose.axes - self.pose.axes).norm_squared();
        problem.is_still
            && matches!(problem.kind.pattern, Pattern::Plain)
            && turn2 < MAX_TILT_CHANGE * MAX_TILT_CHANGE * (1.0 - cosine * cosine)
            && is_near(pose.position_m.z, self.pose.position_m.z)
            && (state.blur2 - self.blur2).abs() < MAX_BLUR2_CHANGE * state.blur2
            && is_lit(state.white, self.white)
            && is_lit(state.step, self.step)
            && is_near(pixels as f64, self.pixels)
            && (problem.lens.slope - self.slope).norm() < MAX_CHANGE * self.slope.norm()
    }

    /// Puts them in place.
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
    /// Of two columns, none of which is the residual's or the motion's.
    fn product(&self, one: usize, other: usize) -> f64 {
        let (with_unknowns, _, own) = &self.mirror;
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
