//! Test whether residuals are noise or are correlated.
//!
//! Over all patches of 4 × 4 pixels, in groups of four rows at any column,
//!
//!   T = Σ (Σ r)² / (4 Σ r²)
//!
//! is 1 on average where the residuals r of pixels are independent, and up to 16 where neighbours
//! agree, as at an occlusion, a shadow, bloom or clipped levels. With n pixels its standard
//! deviation is about 5 / √n. Test `noise_is_uncorrelated_and_an_occlusion_is_not`.

use fearless_simd::prelude::*;

use crate::scratch::reserve_total;

/// Rows and columns of a patch.
const SIDE: usize = 4;
/// Lanes of the widest vector.
const LANES: usize = 16;

/// Sums of the current group of rows, and of those before.
#[derive(Clone, Debug, Default)]
pub struct Patches {
    /// Residuals of the group by column; zero while it has no rows.
    columns: Vec<f32>,
    /// Range of the columns in use.
    from: usize,
    to: usize,
    rows: usize,
    /// Σ (Σ r)² of the groups before.
    total: f32,
}

impl Patches {
    /// Reserves memory for rows of this width.
    pub fn reserve(&mut self, width: usize) {
        reserve_total(&mut self.columns, width + 2 * LANES);
    }

    pub fn set_width(&mut self, width: usize) {
        self.columns.resize((width + 2 * LANES).max(self.columns.len()), 0.0);
    }

    /// Adds a row's residuals, columns `from` to `to`, padded with zeros to whole vectors.
    #[inline(always)]
    pub fn add_row<S: Simd>(&mut self, simd: S, residuals: &[f32], from: usize, to: usize) {
        let lanes = S::f32s::LEN;
        (self.from, self.to) =
            if self.rows == 0 { (from, to) } else { (self.from.min(from), self.to.max(to)) };
        let columns = &mut self.columns[from + SIDE..from + SIDE + residuals.len()];
        let residuals = residuals.chunks_exact(lanes);
        for (column, residual) in columns.chunks_exact_mut(lanes).zip(residuals) {
            let sum = S::f32s::from_slice(simd, column) + S::f32s::from_slice(simd, residual);
            sum.store_slice(column);
        }
        self.rows += 1;
        if self.rows == SIDE {
            self.finish_group(simd);
        }
    }

    /// Σ (Σ r)² of all rows since the last call.
    #[inline(always)]
    pub fn finish<S: Simd>(&mut self, simd: S) -> f32 {
        if self.rows > 0 {
            self.finish_group(simd);
        }
        std::mem::take(&mut self.total)
    }

    #[inline(always)]
    fn finish_group<S: Simd>(&mut self, simd: S) {
        self.rows = 0;
        let lanes = S::f32s::LEN;
        let zero = S::f32s::splat(simd, 0.0);
        let mut total = zero;
        // A patch begins up to three columns before the first residual.
        let (first, end) = (self.from + 1, self.to + SIDE);
        for start in (first..end).step_by(lanes) {
            let at = |by: usize| {
                S::f32s::from_slice(simd, &self.columns[start + by..start + by + lanes])
            };
            let sum = (at(0) + at(1)) + (at(2) + at(3));
            total = sum.mul_add(sum, total);
        }
        for start in (first..end).step_by(lanes) {
            zero.store_slice(&mut self.columns[start..start + lanes]);
        }
        let mut list = [0.0; LANES];
        total.store_slice(&mut list[..lanes]);
        self.total += list.iter().sum::<f32>();
    }
}

/// T.
pub fn correlation_ratio(patches: f64, misfit: f64) -> f64 {
    if misfit > 0.0 { patches / (SIDE as f64 * misfit) } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::*;

    /// The same without vectors.
    fn plain(rows: &[(usize, Vec<f32>)]) -> f32 {
        let mut total = 0.0;
        for group in rows.chunks(SIDE) {
            let mut columns = [0.0f32; 100];
            for (from, residuals) in group {
                for (i, residual) in residuals.iter().enumerate() {
                    columns[SIDE + from + i] += residual;
                }
            }
            total +=
                columns.windows(SIDE).map(|list| list.iter().sum::<f32>().powi(2)).sum::<f32>();
        }
        total
    }

    fn residual(state: &mut u64) -> f32 {
        *state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*state >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    }

    fn rows(offset: f32) -> Vec<(usize, Vec<f32>)> {
        let mut state = 1;
        let mut row = |i: usize| {
            let count = 11 + (7 * i) % 30;
            let list = (0..count)
                .map(|j| residual(&mut state) + if i > 10 && j < 8 { offset } else { 0.0 });
            (i % 9, list.collect())
        };
        (0..41).map(&mut row).collect()
    }

    fn fast(rows: &[(usize, Vec<f32>)]) -> f32 {
        let mut patches = Patches::default();
        patches.set_width(64);
        let mut sum = 0.0;
        dispatch!(Level::new(), simd => {
            for (from, residuals) in rows {
                let mut whole = residuals.clone();
                whole.resize(residuals.len().next_multiple_of(LANES), 0.0);
                patches.add_row(simd, &whole, *from, from + residuals.len());
            }
            sum = patches.finish(simd);
        });
        sum
    }

    #[test]
    fn noise_is_uncorrelated_and_an_occlusion_is_not() {
        for (offset, low, high) in [(0.0, 0.7, 1.3), (1.0, 2.5, 16.0)] {
            let rows = rows(offset);
            let (fast, plain) = (fast(&rows), plain(&rows));
            assert!((fast - plain).abs() < 1e-4 * plain, "{fast} {plain}");
            let misfit: f32 = rows.iter().flat_map(|(_, list)| list).map(|r| r * r).sum();
            let correlation_ratio = correlation_ratio(f64::from(fast), f64::from(misfit));
            assert!((low..high).contains(&correlation_ratio), "{offset}: {correlation_ratio}");
        }
    }
}
