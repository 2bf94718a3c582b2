//! Block jackknife covariance over time blocks of each roundel.
//!
//! Errors of one roundel are correlated in time, so H⁻¹, with the information H of all observations as if independent, is
//! too small. Leaving out the block g changes the result by (H - H_g)⁻¹ s_g with the block's gradient s_g. The covariance
//! is (G - 1)/G times the sum of squares of these changes, whatever the correlations within a block (Quenouille 1956,
//! Tukey 1958).

use std::collections::BTreeMap;

use nalgebra::{DMatrix, Matrix2xX, Vector2};

use crate::least_squares::NormalEquations;

/// Duration of a block, seconds. Errors of one roundel this far apart are independent.
const BLOCK_S: f64 = 4.0;

pub(super) struct Linearized {
    /// Roundel and time.
    pub(super) trajectory: usize,
    pub(super) stamp_s: f64,
    /// Whitened derivatives by all unknowns.
    pub(super) slopes: Matrix2xX<f64>,
    /// Whitened residual.
    pub(super) error: Vector2<f64>,
}

pub(super) struct Jackknife {
    pub(super) covariance: DMatrix<f64>,
    /// Covariance for independent errors.
    pub(super) plain: DMatrix<f64>,
}

/// Adds the prior information; returns `None` if an unknown is undetermined.
pub(super) fn jackknife(linearized: &[Linearized], prior: &DMatrix<f64>) -> Option<Jackknife> {
    let size = prior.nrows();
    let mut information = prior.clone();
    let mut blocks = BTreeMap::<(usize, i64), NormalEquations>::new();
    for Linearized { trajectory, stamp_s, slopes, error } in linearized {
        information += slopes.transpose() * slopes;
        let block = (*trajectory, (stamp_s / BLOCK_S).floor() as i64);
        blocks.entry(block).or_insert_with(|| NormalEquations::zeros(size)).add(slopes, error);
    }
    let plain = information.clone().cholesky()?.inverse();
    let mut covariance = DMatrix::zeros(size, size);
    for block in blocks.values() {
        // If the rest does not determine the unknowns, treat the block as if it were still there.
        let moved = match (&information - &block.information).cholesky() {
            Some(rest) => rest.solve(&block.gradient),
            None => &plain * &block.gradient,
        };
        covariance += &moved * moved.transpose();
    }
    let count = blocks.len() as f64;
    covariance *= (count - 1.0) / count;
    // The prior has its stated error.
    covariance += &plain * prior * &plain;
    Some(Jackknife { covariance, plain })
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    #[test]
    fn correlated_errors_count_once() {
        const EACH: usize = 10;
        const ROUNDELS: usize = 20;
        const STRETCHES: usize = 20;
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut drawn = || Vector2::from_fn(|_, _| StandardNormal.sample(&mut rng));
        for (is_correlated, expected) in [(true, EACH as f64), (false, 1.0)] {
            let mut linearized = Vec::new();
            for place in 0..ROUNDELS * STRETCHES {
                let (trajectory, block) = (place / STRETCHES, place % STRETCHES);
                let mut error = drawn();
                for index in 0..EACH {
                    let stamp_s = (block as f64 + index as f64 / EACH as f64) * BLOCK_S;
                    linearized.push(Linearized {
                        trajectory,
                        stamp_s,
                        slopes: Matrix2xX::identity(2),
                        error,
                    });
                    if !is_correlated {
                        error = drawn();
                    }
                }
            }
            let found = jackknife(&linearized, &DMatrix::zeros(2, 2)).unwrap();
            let plain = 1.0 / (ROUNDELS * STRETCHES * EACH) as f64;
            for unknown in 0..2 {
                assert!((found.plain[(unknown, unknown)] / plain - 1.0).abs() < 1e-9);
                let ratio = found.covariance[(unknown, unknown)] / plain / expected;
                // χ² with 400 degrees of freedom, over 400: 99.9 % lie between 0.79 and 1.24.
                assert!((0.75..1.3).contains(&ratio), "{is_correlated}: {ratio}");
            }
        }
    }
}
