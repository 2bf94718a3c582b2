//! How exactly centres of rims are found by their size, as errors show it.
//!
//! The variance of a centre is taken to be σ² (r̄ / r)^γ, with r̄ the radii's geometric mean. γ is the most likely one (maximum
//! likelihood of a variance function: Davidian, Carroll 1987): of N centres with squared errors e², each of two coordinates,
//! it has -N ln Σ (r / r̄)^γ e² greatest, which is concave in γ. Theory says γ = 1 where each pixel along a rim adds what it knows;
//! the precise mode's centres of 22 to 60 px have 0.005 px whatever their size (noise 2/255, blur 0.8 px), γ = 0.

/// Exponents that are believed.
const EXPONENTS: (f64, f64) = (0.0, 3.0);
/// Fewer errors say nothing.
const LEAST_ERRORS: usize = 50;
const STEPS: usize = 60;

/// Weights by size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Weighing {
    mean_px: f64,
    exponent: f64,
}

impl Weighing {
    /// By radii, pixels, and squared errors.
    pub(crate) fn of(errors: &[(f64, f64)]) -> Self {
        let count = errors.len() as f64;
        let mean_px = (errors.iter().map(|(radius_px, _)| radius_px.ln()).sum::<f64>()
            / count.max(1.0))
        .exp();
        let likeliness = |exponent: f64| {
            let weighed = Self { mean_px, exponent };
            let squares = errors.iter().map(|(radius_px, it)| weighed.weight(*radius_px) * it);
            -squares.sum::<f64>().max(f64::MIN_POSITIVE).ln()
        };
        let (mut least, mut most) = EXPONENTS;
        if errors.len() < LEAST_ERRORS {
            most = least;
        }
        for _ in 0..STEPS {
            let third = (most - least) / 3.0;
            if likeliness(least + third) < likeliness(most - third) {
                least += third;
            } else {
                most -= third;
            }
        }
        Self { mean_px, exponent: 0.5 * (least + most) }
    }

    /// Of a centre of a rim of this radius, 1 on average.
    pub(crate) fn weight(&self, radius_px: f64) -> f64 {
        (radius_px / self.mean_px).powf(self.exponent)
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    #[test]
    fn the_exponent_is_that_of_the_errors() {
        for exponent in [0.0, 1.0, 2.0_f64] {
            let mut rng = ChaCha8Rng::seed_from_u64(6);
            let errors: Vec<(f64, f64)> = (0..2000)
                .map(|_| {
                    let radius_px: f64 = rng.random_range(12.0..50.0);
                    let mut square = || -> f64 {
                        let normal: f64 = StandardNormal.sample(&mut rng);
                        normal * normal
                    };
                    (radius_px, (square() + square()) * (30.0 / radius_px).powf(exponent))
                })
                .collect();
            let found = Weighing::of(&errors);
            assert!((found.exponent - exponent).abs() < 0.2, "{exponent}: {found:?}");
        }
        assert_eq!(Weighing::of(&[(20.0, 1.0), (30.0, 0.1)]).weight(90.0), 1.0);
    }
}
