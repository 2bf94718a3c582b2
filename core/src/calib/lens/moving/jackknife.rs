//! The covariance of what was found, from how much it depends on each roundel's stretches of time.
//!
//! Errors of one roundel hang together for as long as the others' do, so H⁻¹, with H the information of all sightings as if
//! they were independent, promises too much. Leaving out a stretch g changes the result by (H - H_g)⁻¹ s_g, s_g being what it
//! pulls; (G - 1)/G times the sum of squares of these is the covariance, whatever errors within a stretch have to do with
//! one another (the jackknife; Quenouille 1956, Tukey 1958).

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use super::bundle::{Pair, Part};

/// Errors of one roundel this far apart in time are independent, seconds.
const STRETCH_S: f64 = 4.0;

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

/// With each pair's whitened derivatives and error, and what was known beforehand; `None` if something is not determined.
pub(super) fn jackknife(pairs: &[Pair], parts: &[Part], known: &DMatrix<f64>) -> Option<Jackknife> {
    let size = known.nrows();
    let mut information = known.clone();
    let mut stretches = BTreeMap::<(usize, i64), Stretch>::new();
    for (pair, part) in pairs.iter().zip(parts) {
        let Some((slopes, error)) = part else { continue };
        let own = slopes.transpose() * slopes;
        information += &own;
        let stretch = (pair.way, (pair.stamp_s / STRETCH_S).floor() as i64);
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
