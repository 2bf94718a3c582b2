//! Noise of ellipse centres as a function of the rim's size, estimated from residuals.
//!
//! The variance of a centre is modelled as σ² (r̄ / r)^γ with the geometric mean radius r̄. The maximum likelihood estimate
//! of γ for N centres with squared residuals e² (variance function: Davidian, Carroll 1987) maximizes
//! -N ln Σ (r / r̄)^γ e², which is concave in γ. In theory γ = 1, as information is proportional to the rim's length;
//! centres of precise mode from 22 to 60 px have 0.005 px at any size (noise 2/255, blur 0.8 px), so γ = 0.

const EXPONENTS: (f64, f64) = (0.0, 3.0);
/// With fewer residuals the exponent is 0.
const MIN_ERRORS: usize = 50;
const STEPS: usize = 60;

/// Weight of a centre by the rim's radius.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CenterNoise {
    mean_px: f64,
    exponent: f64,
}

impl CenterNoise {
    /// From pairs of radius in pixels and squared residual.
    pub(crate) fn fit(errors: &[(f64, f64)]) -> Self {
        let count = errors.len() as f64;
        let mean_px = (errors.iter().map(|(radius_px, _)| radius_px.ln()).sum::<f64>()
            / count.max(1.0))
        .exp();
        let log_likelihood = |exponent: f64| {
            let noise = Self { mean_px, exponent };
            let squares = errors.iter().map(|(radius_px, it)| noise.weight(*radius_px) * it);
            -squares.sum::<f64>().max(f64::MIN_POSITIVE).ln()
        };
        let (mut min, mut max) = EXPONENTS;
        if errors.len() < MIN_ERRORS {
            max = min;
        }
        for _ in 0..STEPS {
            let third = (max - min) / 3.0;
            if log_likelihood(min + third) < log_likelihood(max - third) {
                min += third;
            } else {
                max -= third;
            }
        }
        Self { mean_px, exponent: 0.5 * (min + max) }
    }

    /// Weight of a centre of a rim of this radius, 1 on average.
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
    fn the_exponent_of_simulated_errors_is_recovered() {
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
            let found = CenterNoise::fit(&errors);
            assert!((found.exponent - exponent).abs() < 0.2, "{exponent}: {found:?}");
        }
        assert_eq!(CenterNoise::fit(&[(20.0, 1.0), (30.0, 0.1)]).weight(90.0), 1.0);
    }
}
