//! Cells along the rims, each with its own levels and its information about rim and pose.
//!
//! A cell is a stretch of one rim, about [`LENGTH_PX`] long, with the pixels closer to it than to
//! the other rim. Its sums are the products of all columns over its pixels. From them follow,
//! without another pass over the pixels,
//!
//! * its information about the pose with its own levels (W, C) free: with local columns l and
//!   shared ones g, A_gg - A_gl A_ll⁻¹ A_lg (Schur's complement);
//! * the displacement δ of its rim from the model's, and δ²/var(δ), which is 1 on average for noise
//!   alone;
//! * the remaining residual.

use fearless_simd::prelude::*;
use nalgebra::{Matrix2, SMatrix, SVector};

use crate::pose::photometry::model::column_products::{self, STILL, column};

/// Columns of a pixel: those of the plain fit, the last replaced by the spread of the outer rim,
/// then that of the inner one; padded to whole vectors.
pub const WIDTH: usize = 16;
/// Spread of the outer rim; that of the inner one follows.
pub const SPREAD: usize = STILL - 1;
/// The motion is held.
pub type Products = column_products::Products<STILL>;
/// Length of a cell along its rim …
const LENGTH_PX: f64 = 6.0;
/// … within these numbers of cells on a rim.
const COUNT: (f64, f64) = (6.0, 32.0);
pub const MAX_CELLS: usize = 2 * COUNT.1 as usize;
/// A cell of fewer pixels is not evaluated.
const MIN_PIXELS: f64 = 8.0;
/// Standard deviation of a cell's levels from the reference, grey levels; wide, to keep the levels
/// finite.
const LEVEL_PRIOR: f64 = 200.0;

#[derive(Clone, Debug)]
pub struct Cell {
    /// 0 the outer rim, 1 the inner one.
    pub rim: usize,
    /// W and C, grey levels.
    pub levels: [f64; 2],
    pub kept: bool,
    /// Products of the columns; those of shape are over the step.
    pub sums: [[f32; WIDTH]; WIDTH],
}

/// How well a cell agrees with the model.
#[derive(Clone, Copy, Debug)]
pub struct CellFit {
    /// Variance of its pixels with levels and rim free, grey levels².
    pub variance: f64,
    /// (gradient of δ)² over its information: δ²/var(δ) times the noise's variance.
    pub square: f64,
    /// Its step over that of the reference.
    pub contrast: f64,
}

pub fn count(around_px: f64) -> usize {
    (around_px / LENGTH_PX).clamp(COUNT.0, COUNT.1).round() as usize
}

impl Cell {
    pub fn new(rim: usize, levels: [f64; 2]) -> Self {
        Self { rim, levels, kept: true, sums: [[0.0; WIDTH]; WIDTH] }
    }

    #[inline(always)]
    pub fn add<S: Simd>(&mut self, simd: S, columns: &[f32; WIDTH]) {
        let width = S::f32s::LEN;
        for (sums, factor) in self.sums.iter_mut().zip(columns).take(SPREAD + 2) {
            let factor = S::f32s::splat(simd, *factor);
            for (sums, columns) in sums.chunks_exact_mut(width).zip(columns.chunks_exact(width)) {
                let sum = S::f32s::from_slice(simd, sums);
                S::f32s::from_slice(simd, columns).mul_add(factor, sum).store_slice(sums);
            }
        }
    }

    /// Products with the spread of both rims as one column, the last; columns of shape are over the
    /// reference's step.
    pub fn products(&self, step: f64) -> Products {
        let ratio = self.levels[1] / step;
        let mut products = Products::zeros();
        let scale = |index: usize| if is_shape(index) { ratio } else { 1.0 };
        for row in 0..WIDTH.min(STILL + 1) {
            for column in 0..WIDTH.min(STILL + 1) {
                let (to_row, to_column) = (row.min(SPREAD), column.min(SPREAD));
                let sum = f64::from(self.sums[row][column]);
                products[(to_row, to_column)] += sum * scale(to_row) * scale(to_column);
            }
        }
        products
    }

    /// Inverse of the levels' information, and the gradient of the prior.
    fn level_inverse(
        &self,
        products: &Products,
        reference: &Reference,
    ) -> Option<(Matrix2<f64>, [f64; 2])> {
        let prior = reference.noise2 / (LEVEL_PRIOR * LEVEL_PRIOR);
        let mut information: Matrix2<f64> = products.fixed_view::<2, 2>(1, 1).into();
        information += Matrix2::identity() * prior;
        let pull = [0, 1].map(|k| prior * (reference.levels[k] - self.levels[k]));
        Some((information.try_inverse()?, pull))
    }

    /// Σ r², with the prior's part.
    pub fn misfit(&self, reference: &Reference) -> f64 {
        let prior = reference.noise2 / (LEVEL_PRIOR * LEVEL_PRIOR);
        let off = |k: usize| (reference.levels[k] - self.levels[k]).powi(2);
        f64::from(self.sums[0][0]) + prior * (off(0) + off(1))
    }

    pub fn marginalized(&self, reference: &Reference) -> Option<Products> {
        let mut products = self.products(reference.levels[1]);
        let (inverse, pull) = self.level_inverse(&products, reference)?;
        let mut rows: SMatrix<f64, 2, STILL> = products.fixed_rows::<2>(1).into();
        rows[(0, 0)] += pull[0];
        rows[(1, 0)] += pull[1];
        products[(0, 0)] = self.misfit(reference);
        products -= rows.transpose() * inverse * rows;
        for level in [column::WHITE, column::STEP] {
            products.fill_row(level, 0.0);
            products.fill_column(level, 0.0);
        }
        products[(column::WHITE, column::WHITE)] = (self.pixels() - 2.0).max(0.0);
        Some(products)
    }

    /// Updates the levels for the coefficients of the shared columns.
    pub fn update_levels(&mut self, reference: &Reference, coefficients: &SVector<f64, STILL>) {
        let products = self.products(reference.levels[1]);
        let Some((inverse, pull)) = self.level_inverse(&products, reference) else { return };
        let rows: SMatrix<f64, 2, STILL> = products.fixed_rows::<2>(1).into();
        let mut right = rows * coefficients;
        right[0] += pull[0];
        right[1] += pull[1];
        let change = inverse * right;
        self.levels[0] += change[0];
        self.levels[1] += change[1];
    }

    /// Number of pixels, less those with clipped levels.
    pub fn pixels(&self) -> f64 {
        f64::from(self.sums[column::WHITE][column::WHITE])
    }

    /// `None` with too few pixels.
    pub fn evaluate(&self, reference: &Reference) -> Option<CellFit> {
        let pixels = self.pixels();
        if pixels < MIN_PIXELS {
            return None;
        }
        let rim = SPREAD + self.rim;
        let at = |row: usize, column: usize| f64::from(self.sums[row][column]);
        let products = self.products(reference.levels[1]);
        let (inverse, _) = self.level_inverse(&products, reference)?;
        let level_inverse = |index: usize| {
            nalgebra::Vector2::new(at(column::WHITE, index), at(column::STEP, index))
        };
        let less =
            |a: usize, b: usize| at(a, b) - level_inverse(a).dot(&(inverse * level_inverse(b)));
        let (information, gradient) = (less(rim, rim), less(rim, 0));
        let settled = inverse * level_inverse(0);
        let contrast = (self.levels[1] + settled[1]) / reference.levels[1];
        let square =
            if information > 1e-3 * at(rim, rim) { gradient * gradient / information } else { 0.0 };
        let variance = (less(0, 0) - square).max(0.0) / (pixels - 3.0);
        Some(CellFit { variance, square, contrast })
    }
}

/// Levels and noise that cells are compared with.
#[derive(Clone, Copy, Debug)]
pub struct Reference {
    /// W and C, grey levels.
    pub levels: [f64; 2],
    /// Variance of a pixel, grey levels².
    pub noise2: f64,
}

/// Whether a column is one of shape, which is proportional to the step.
fn is_shape(index: usize) -> bool {
    index == column::BLUR || index >= column::SHIFT
}
