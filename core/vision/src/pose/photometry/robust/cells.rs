//! Cells along the rims: what each of them says of its own levels, of its rim's place, and of the pose.
//!
//! A cell is a stretch of one rim, about [`LENGTH_PX`] long, with the pixels nearer to it than to the
//! other rim. Its sums are the products of all columns over its pixels. From them, without another look
//! at the pixels, follow
//!
//! * its information on the pose with its own levels (W, C) free: with local columns l and shared ones
//!   g, A_gg - A_gl A_ll⁻¹ A_lg (Schur's complement);
//! * by how much its rim seems to stand off the model's, δ, and δ²/var(δ), which is 1 in the mean where
//!   noise alone moves it;
//! * what is left of the residuals then.

use fearless_simd::prelude::*;
use nalgebra::{Matrix2, SMatrix, SVector};

use crate::pose::photometry::model::column_products::{self, STILL, column};

/// Columns of a pixel: those of the fast fit, but the last is the outer rim's spread, and then the
/// inner one's; filled up to whole vectors.
pub const WIDTH: usize = 16;
/// Of the spread of the outer rim; the inner one's follows.
pub const SPREAD: usize = STILL - 1;
/// All products' sums: the motion is held.
pub type Products = column_products::Products<STILL>;
/// Length of a cell along its rim, pixels …
const LENGTH_PX: f64 = 6.0;
/// … as long as these are not too few or too many.
const COUNT: (f64, f64) = (6.0, 32.0);
/// Cells of both rims, at most.
pub const MAX_CELLS: usize = 2 * COUNT.1 as usize;
/// A cell of fewer pixels says nothing.
const MIN_PIXELS: f64 = 8.0;
/// Deviation of a cell's levels from the reference, grey levels: no more than keeps them finite.
const LEVEL_PRIOR: f64 = 200.0;

/// One cell.
#[derive(Clone, Debug)]
pub struct Cell {
    /// 0 the outer rim, 1 the inner one.
    pub rim: usize,
    /// W and C, grey levels.
    pub levels: [f64; 2],
    /// Whether it counts.
    pub kept: bool,
    /// Products of the columns, shape's over the step.
    pub sums: [[f32; WIDTH]; WIDTH],
}

/// What a cell says for itself.
#[derive(Clone, Copy, Debug)]
pub struct CellFit {
    /// Variance of its pixels once its levels and its rim are free, grey levels².
    pub variance: f64,
    /// (gradient of δ)² over its information: times the noise's variance, δ²/var(δ).
    pub square: f64,
    /// Its step over the reference's.
    pub contrast: f64,
}

/// How many cells a rim of this circumference has.
pub fn count(around_px: f64) -> usize {
    (around_px / LENGTH_PX).clamp(COUNT.0, COUNT.1).round() as usize
}

impl Cell {
    /// Of a rim, with the reference's levels.
    pub fn new(rim: usize, levels: [f64; 2]) -> Self {
        Self { rim, levels, kept: true, sums: [[0.0; WIDTH]; WIDTH] }
    }

    /// Adds a pixel.
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

    /// Its products with the spread of both rims as one column, the last; shape's columns are over the
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

    /// The inverse of the levels' information, and the prior's pull on them.
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

    /// Σ r², with the prior's share.
    pub fn misfit(&self, reference: &Reference) -> f64 {
        let prior = reference.noise2 / (LEVEL_PRIOR * LEVEL_PRIOR);
        let off = |k: usize| (reference.levels[k] - self.levels[k]).powi(2);
        f64::from(self.sums[0][0]) + prior * (off(0) + off(1))
    }

    /// Its products with its levels free.
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

    /// Moves its levels to what they are after the shared columns' coefficients.
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

    /// Pixels, less those whose level is cut off.
    pub fn pixels(&self) -> f64 {
        f64::from(self.sums[column::WHITE][column::WHITE])
    }

    /// What it says for itself; `None` where it has too few pixels.
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

/// The reference that cells are held against.
#[derive(Clone, Copy, Debug)]
pub struct Reference {
    /// W and C, grey levels.
    pub levels: [f64; 2],
    /// Variance of a pixel, grey levels².
    pub noise2: f64,
}

/// Whether a column is one of shape, which grows with the step.
fn is_shape(index: usize) -> bool {
    index == column::BLUR || index >= column::SHIFT
}
