//! How long a frame takes: the paper's equation (20) with the terms that our detector has.
//!
//! While all roundels are followed, a frame costs a little for itself and for the share of it that is searched for
//! new ones, and for each roundel a constant, a term with its diameter d (the pixels near its rims) and one with d²
//! (the pixels of its area, the paper's s_p). A frame in which roundels are lost, the paper's α, is searched as a
//! whole:
//!
//! t = c₀ + c₁ s_i + n (k₀ + k₁ d + k₂ d²) + α (c₂ s_i + n k₃)
//!
//! The constants belong to a machine and a mode; [`fit`] finds them from measured times, none below zero.

use nalgebra::{DMatrix, DVector};

/// Numbers of the model.
const TERMS: usize = 7;

/// What is done in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// Pixels of the picture.
    pub image_px: f64,
    /// Roundels in it.
    pub roundels: f64,
    /// Their mean diameter, pixels.
    pub diameter_px: f64,
    /// Share of frames that are searched as a whole, 0 to 1.
    pub searched_share: f64,
}

/// What a machine takes for it, in seconds: c₀, c₁, c₂, k₀, k₁, k₂, k₃.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Constants(pub [f64; TERMS]);

impl Constants {
    /// Of precise mode on one core of a virtual machine (Intel Xeon), as `roundel plan --measure` found them; for
    /// whoever has not measured.
    pub const PRECISE: Self = Self([5.0e-6, 1.2e-11, 1.45e-10, 1.22e-5, 0.0, 9.5e-9, 9.7e-6]);
    /// The same of fast mode.
    pub const FAST: Self = Self([1.5e-6, 8.3e-12, 1.35e-10, 4.0e-6, 0.0, 8.0e-10, 7.4e-6]);

    /// Seconds a frame, on one core.
    pub fn frame_s(&self, load: &Load) -> f64 {
        self.0.iter().zip(terms(load)).map(|(constant, term)| constant * term).sum()
    }
}

fn terms(load: &Load) -> [f64; TERMS] {
    let Load { image_px, roundels, diameter_px, searched_share } = *load;
    [
        1.0,
        image_px,
        searched_share * image_px,
        roundels,
        roundels * diameter_px,
        roundels * diameter_px * diameter_px,
        searched_share * roundels,
    ]
}

/// The constants that explain measured times best: least squares of relative errors, none of them negative. `None`
/// without as many measurements as constants.
pub fn fit(measured: &[(Load, f64)]) -> Option<Constants> {
    if measured.len() < TERMS
        || measured.iter().any(|(_, time_s)| time_s.is_nan() || *time_s <= 0.0)
    {
        return None;
    }
    let all: Vec<_> = measured.iter().map(|(load, time_s)| (terms(load), *time_s)).collect();
    // Columns of one size, so that seconds a pixel do not vanish beside seconds a frame.
    let rows = DMatrix::from_fn(all.len(), TERMS, |row, term| all[row].0[term] / all[row].1);
    let scale: Vec<f64> = rows.column_iter().map(|column| column.norm()).collect();
    let mut free: Vec<usize> = (0..TERMS).filter(|&term| scale[term] > 0.0).collect();
    // The constant that would be most negative is left out until none is.
    loop {
        let part = DMatrix::from_fn(all.len(), free.len(), |row, column| {
            rows[(row, free[column])] / scale[free[column]]
        });
        let solved = part.svd(true, true).solve(&DVector::repeat(all.len(), 1.0), 1e-9).ok()?;
        let worst = (0..free.len()).min_by(|&a, &b| solved[a].total_cmp(&solved[b]))?;
        if solved[worst] < 0.0 {
            free.remove(worst);
            continue;
        }
        let mut constants = [0.0; TERMS];
        for (column, &term) in free.iter().enumerate() {
            constants[term] = solved[column] / scale[term];
        }
        return Some(Constants(constants));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn loads() -> Vec<Load> {
        let mut loads = Vec::new();
        for image_px in [3e5, 9e5, 2e6] {
            for roundels in [1.0, 20.0, 100.0] {
                for diameter_px in [12.0, 30.0, 80.0] {
                    for searched_share in [0.0, 1.0] {
                        loads.push(Load { image_px, roundels, diameter_px, searched_share });
                    }
                }
            }
        }
        loads
    }

    #[test]
    fn measured_constants_are_found_again() {
        let truth = Constants([1e-5, 1e-11, 5e-10, 2e-6, 1e-7, 1e-9, 3e-6]);
        let measured: Vec<_> =
            loads().into_iter().map(|load| (load, truth.frame_s(&load))).collect();
        let found = fit(&measured).unwrap();
        for (found, truth) in found.0.iter().zip(truth.0) {
            assert!((found / truth - 1.0).abs() < 1e-6, "{found:?}");
        }
    }

    #[test]
    fn no_constant_is_negative_and_too_few_times_are_refused() {
        let measured: Vec<_> = loads()
            .into_iter()
            .map(|load| {
                (load, 1e-5 + 1e-6 * load.roundels - 1e-9 * load.roundels * load.diameter_px)
            })
            .collect();
        let found = fit(&measured).unwrap();
        assert!(found.0.iter().all(|&constant| constant >= 0.0), "{found:?}");
        assert_eq!(fit(&measured[..TERMS - 1]), None);
        assert_eq!(fit(&[(loads()[0], f64::NAN); 9]), None);
    }

    #[test]
    fn more_of_anything_takes_longer() {
        let usual = Load { image_px: 9e5, roundels: 20.0, diameter_px: 30.0, searched_share: 0.0 };
        for constants in [Constants::PRECISE, Constants::FAST] {
            let time_s = constants.frame_s(&usual);
            for more in [
                Load { image_px: 2e6, ..usual },
                Load { roundels: 30.0, ..usual },
                Load { diameter_px: 40.0, ..usual },
                Load { searched_share: 0.1, ..usual },
            ] {
                assert!(constants.frame_s(&more) > time_s, "{more:?}");
            }
        }
    }
}
