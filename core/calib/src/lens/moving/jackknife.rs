//! The covariance of what was found, from how much it depends on each roundel's stretches of time.
//!
//! Errors of one roundel hang together for as long as the others' do, so H⁻¹, with H the information of all sightings as if
//! they were independent, promises too much. Leaving out a stretch g changes the result by (H - H_g)⁻¹ s_g, s_g being what it
//! pulls; (G - 1)/G times the sum of squares of these is the covariance, whatever errors within a stretch have to do with
//! one another (the jackknife; Quenouille 1956, Tukey 1958).

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, Matrix2xX, Vector2};

/// Errors of one roundel this far apart in time are independent, seconds.
const STRETCH_S: f64 = 4.0;

/// What one sighting says.
pub(super) struct Part {
    /// Which roundel's it is, and when.
    pub(super) way: usize,
    pub(super) stamp_s: f64,
    /// Whitened derivatives by all unknowns.
    pub(super) slopes: Matrix2xX<f64>,
    /// Whitened.
    pub(super) error: Vector2<f64>,
}

/// Covariances of the unknowns.
pub(super) struct Jackknife {
    pub(super) covariance: DMatrix<f64>,
    /// Were all errors independent.
    pub(super) plain: DMatrix<f64>,
}

/// What a stretch says, and how it pulls.
struct Stretch {
    information: DMatrix<f64>,
    pull: DVector<f64>,
}

/// With what was known beforehand; `None` if something is not determined.
pub(super) fn jackknife(parts: &[Part], known: &DMatrix<f64>) -> Option<Jackknife> {
    let size = known.nrows();
    let mut information = known.clone();
    let mut stretches = BTreeMap::<(usize, i64), Stretch>::new();
    for Part { way, stamp_s, slopes, error } in parts {
        let own = slopes.transpose() * slopes;
        information += &own;
        let stretch = (*way, (stamp_s / STRETCH_S).floor() as i64);
        let stretch = stretches.entry(stretch).or_insert_with(|| Stretch {
            information: DMatrix::zeros(size, size),
            pull: DVector::zeros(size),
        });
        stretch.information += own;
        stretch.pull += slopes.transpose() * error;
    }
    let plain = information.clone().cholesky()?.inverse();
    let mut covariance = DMatrix::zeros(size, size);
    for stretch in stretches.values() {
        // Where all depends on it, it counts as if it were there.
        let moved = match (&information - &stretch.information).cholesky() {
            Some(rest) => rest.solve(&stretch.pull),
            None => &plain * &stretch.pull,
        };
        covariance += &moved * moved.transpose();
    }
    let count = stretches.len() as f64;
    covariance *= (count - 1.0) / count;
    // What was known beforehand errs as it says.
    covariance += &plain * known * &plain;
    Some(Jackknife { covariance, plain })
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    #[test]
    fn errors_that_hang_together_count_once() {
        const EACH: usize = 10;
        const ROUNDELS: usize = 20;
        const STRETCHES: usize = 20;
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut drawn = || Vector2::from_fn(|_, _| StandardNormal.sample(&mut rng));
        for (hangs_together, expected) in [(true, EACH as f64), (false, 1.0)] {
            let mut parts = Vec::new();
            for place in 0..ROUNDELS * STRETCHES {
                let (way, stretch) = (place / STRETCHES, place % STRETCHES);
                let mut error = drawn();
                for index in 0..EACH {
                    let stamp_s = (stretch as f64 + index as f64 / EACH as f64) * STRETCH_S;
                    parts.push(Part { way, stamp_s, slopes: Matrix2xX::identity(2), error });
                    if !hangs_together {
                        error = drawn();
                    }
                }
            }
            let found = jackknife(&parts, &DMatrix::zeros(2, 2)).unwrap();
            let plain = 1.0 / (ROUNDELS * STRETCHES * EACH) as f64;
            for unknown in 0..2 {
                assert!((found.plain[(unknown, unknown)] / plain - 1.0).abs() < 1e-9);
                let ratio = found.covariance[(unknown, unknown)] / plain / expected;
                // χ² with 400 degrees of freedom over 400: 0.79 to 1.24 holds 99.9 %.
                assert!((0.75..1.3).contains(&ratio), "{hangs_together}: {ratio}");
            }
        }
    }
}
