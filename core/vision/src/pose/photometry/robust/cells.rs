//! Cells along the rims, each with its own levels and its information about rim and pose.
//!
//! A cell is a stretch of one rim, about [`LENGTH_PX`] long, with the pixels closer to it than to
//! the other rim. Its sums are the products of residual, levels and rim with all columns over its
//! pixels. From them follow, without another pass over the pixels,
//!
//! * its information about the pose with its own levels (W, C) free: with local columns l and
//!   shared ones g, A_gg - A_gl A_ll⁻¹ A_lg (Schur's complement);
//! * the displacement δ of its rim from the model's, and δ²/var(δ), which is 1 on average for noise
//!   alone;
//! * the remaining residual.

use fearless_simd::prelude::*;
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

use crate::pose::photometry::model::column_products::{self, STILL, column};

/// Columns of a pixel: those of the plain fit, the last replaced by the spread of the rims; padded to
/// whole vectors.
pub const WIDTH: usize = 16;
/// Spread of the rims.
pub const SPREAD: usize = STILL - 1;
/// Columns whose products with all columns a cell keeps.
const ROWS: [usize; 4] = [0, column::WHITE, column::STEP, SPREAD];
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

/// Aligned, since a vector across two cache lines takes several times as long to update.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub struct Cell {
    /// Products of the columns [`ROWS`] with all; those of shape are over the reference's step.
    pub sums: [[f32; WIDTH]; ROWS.len()],
    /// 0 the outer rim, 1 the inner one.
    pub rim: usize,
    /// W and C, grey levels.
    pub levels: [f64; 2],
    pub kept: bool,
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
        Self { rim, levels, kept: true, sums: Default::default() }
    }

    #[inline(always)]
    pub fn add<S: Simd>(&mut self, simd: S, columns: &[f32]) {
        let width = S::f32s::LEN;
        for (sums, column) in self.sums.iter_mut().zip(ROWS) {
            let factor = S::f32s::splat(simd, columns[column]);
            for (sums, columns) in sums.chunks_exact_mut(width).zip(columns.chunks_exact(width)) {
                let sum = S::f32s::from_slice(simd, sums);
                S::f32s::from_slice(simd, columns).mul_add(factor, sum).store_slice(sums);
            }
        }
    }

    /// Products of the levels with all columns.
    fn level_rows(&self) -> SMatrix<f64, 2, STILL> {
        SMatrix::from_fn(|row, column| f64::from(self.sums[1 + row][column]))
    }

    /// Inverse of the levels' information, and the gradient of the prior.
    fn level_inverse(&self, reference: &Reference) -> Option<(Matrix2<f64>, [f64; 2])> {
        let prior = reference.noise2 / (LEVEL_PRIOR * LEVEL_PRIOR);
        let at = |row: usize, column: usize| f64::from(self.sums[row][column]);
        let information = Matrix2::new(
            at(1, column::WHITE) + prior,
            at(1, column::STEP),
            at(2, column::WHITE),
            at(2, column::STEP) + prior,
        );
        let pull = [0, 1].map(|k| prior * (reference.levels[k] - self.levels[k]));
        Some((information.try_inverse()?, pull))
    }

    /// Σ r², with the prior's part.
    pub fn misfit(&self, reference: &Reference) -> f64 {
        let prior = reference.noise2 / (LEVEL_PRIOR * LEVEL_PRIOR);
        let off = |k: usize| (reference.levels[k] - self.levels[k]).powi(2);
        f64::from(self.sums[0][0]) + prior * (off(0) + off(1))
    }

    /// Subtracts from the ring's products what the cell's own levels explain.
    pub fn marginalize(&self, reference: &Reference, products: &mut Products) {
        let Some((inverse, pull)) = self.level_inverse(reference) else { return };
        let mut rows = self.level_rows();
        rows[(0, 0)] += pull[0];
        rows[(1, 0)] += pull[1];
        let explained = inverse * rows;
        for column in 0..STILL {
            for row in 0..=column {
                let product = rows[(0, row)] * explained[(0, column)]
                    + rows[(1, row)] * explained[(1, column)];
                products[(row, column)] -= product;
            }
        }
    }

    /// Updates the levels for the coefficients of the shared columns.
    pub fn update_levels(&mut self, reference: &Reference, coefficients: &SVector<f64, STILL>) {
        let Some((inverse, pull)) = self.level_inverse(reference) else { return };
        let mut right = self.level_rows() * coefficients;
        right[0] += pull[0];
        right[1] += pull[1];
        let change = inverse * right;
        self.levels[0] += change[0];
        self.levels[1] += change[1];
    }

    /// Number of pixels, less those with clipped levels.
    pub fn pixels(&self) -> f64 {
        f64::from(self.sums[1][column::WHITE])
    }

    /// After a step with these coefficients of the columns; `None` with too few pixels.
    pub fn evaluate(&self, reference: &Reference, taken: &SVector<f64, STILL>) -> Option<CellFit> {
        let pixels = self.pixels();
        if pixels < MIN_PIXELS {
            return None;
        }
        let (inverse, _) = self.level_inverse(reference)?;
        let with_levels = |column: usize| {
            Vector2::new(f64::from(self.sums[1][column]), f64::from(self.sums[2][column]))
        };
        let less = |row: usize, column: usize| {
            let explained = with_levels(ROWS[row]).dot(&(inverse * with_levels(column)));
            f64::from(self.sums[row][column]) - explained
        };
        let (information, before) = (less(3, SPREAD), less(3, 0));
        let levels = self.level_rows() * taken;
        let of_rim: f64 =
            self.sums[3].iter().zip(taken).map(|(sum, by)| f64::from(*sum) * by).sum();
        let gradient = of_rim - with_levels(SPREAD).dot(&(inverse * levels));
        let settled = inverse * with_levels(0);
        let contrast = (self.levels[1] + settled[1]) / reference.levels[1];
        let is_informative = information > 1e-3 * f64::from(self.sums[3][SPREAD]);
        let square = |gradient: f64| {
            if is_informative { gradient * gradient / information } else { 0.0 }
        };
        // A step moves the cell's rim, and changes nothing of what remains besides.
        let variance = (less(0, 0) - square(before)).max(0.0) / (pixels - 3.0);
        Some(CellFit { variance, square: square(gradient), contrast })
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
