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
    normal_equations::Linear,
    state::{BLUR, Problem, SHIFT, State, unknown_of},
};
use crate::{
    marker::Pattern,
    pose::photometry::model::{
        column_products::{Products, STILL, column},
        projection::Place,
    },
};

/// Columns but for the residual's and the motion's, and their products.
const COLUMNS: usize = STILL - 1;
const COUNT: usize = COLUMNS * (COLUMNS + 1) / 2;

/// By no more than this share may range, lens and number of pixels be others …
const SAME: f64 = 0.02;
/// … the levels by this share of the step, with which only the light's columns go, …
const SAME_LEVEL: f64 = 0.05;
/// … and σ², with whose fourth root the information goes.
const SAME_BLUR2: f64 = 0.06;
/// Turned by no more than this share of the sine of the tilt, with whose square the tilts' information goes.
const SAME_TILT: f64 = 0.05;

/// Products of columns of a frame before, and of what they depend on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecalledProducts {
    /// Upper triangle, row by row.
    products: [f32; COUNT],
    place: Place,
    /// Of the lens.
    slope: Matrix2<f64>,
    blur2: f64,
    white: f64,
    step: f64,
    pixels: f64,
}

impl RecalledProducts {
    /// Of a fit that took them anew; `None` if its motion was free, the blur was held, or the print is not
    /// a plain one, whose columns hang on more than is compared.
    pub fn of(problem: &Problem, state: &State, linear: &Linear) -> Option<Self> {
        let is_plain = matches!(problem.kind.pattern, Pattern::Plain);
        if !(problem.is_still && is_plain) || linear.holds(BLUR) {
            return None;
        }
        let mut products = [0.0; COUNT];
        let mut at = 0;
        for one in column::WHITE..STILL {
            for other in one..STILL {
                products[at] = linear.product(one, other) as f32;
                at += 1;
            }
        }
        let State { place, blur2, white, step, .. } = *state;
        let (slope, pixels) = (problem.lens.slope, linear.pixels);
        Some(Self { products, place, slope, blur2, white, step, pixels })
    }

    /// Whether they are as good as those of a state, of which so many pixels count.
    pub fn serve(&self, problem: &Problem, state: &State, pixels: usize) -> bool {
        let near = |one: f64, other: f64| (one - other).abs() < SAME * other.abs();
        let is_lit = |one: f64, other: f64| (one - other).abs() < SAME_LEVEL * self.step.abs();
        let place = &state.place;
        let cosine = place.axes.column(2).dot(&place.position_m.normalize());
        // Of a turn by a small angle the matrix's difference has the norm √2 times the angle.
        let turn2 = 0.5 * (place.axes - self.place.axes).norm_squared();
        problem.is_still
            && matches!(problem.kind.pattern, Pattern::Plain)
            && turn2 < SAME_TILT * SAME_TILT * (1.0 - cosine * cosine)
            && near(place.position_m.z, self.place.position_m.z)
            && (state.blur2 - self.blur2).abs() < SAME_BLUR2 * state.blur2
            && is_lit(state.white, self.white)
            && is_lit(state.step, self.step)
            && near(pixels as f64, self.pixels)
            && (problem.lens.slope - self.slope).norm() < SAME * self.slope.norm()
    }

    /// Puts them in place.
    pub fn put(&self, products: &mut Products) {
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

impl Linear {
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
