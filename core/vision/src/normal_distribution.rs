//! The standard normal distribution: density φ, distribution function Φ, and the logarithm of its
//! tail.
//!
//! Φ is the rational approximation of Abramowitz and Stegun, 26.2.17, with an absolute error below
//! 7.5e-8.

use std::f64::consts::TAU;

/// 1/√(2π).
const FRAC_1_SQRT_TAU: f64 = 0.398_942_280_401_432_7;

/// φ(z).
pub fn density(z: f64) -> f64 {
    FRAC_1_SQRT_TAU * (-0.5 * z * z).exp()
}

/// Φ(z).
pub fn cumulative(z: f64) -> f64 {
    cumulative_with_density(z, density(z))
}

/// Φ(z), for a caller that has φ(z) already.
pub fn cumulative_with_density(z: f64, density: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.231_641_9 * z.abs());
    let series = t
        * (0.319_381_530
            + t * (-0.356_563_782
                + t * (1.781_477_937 + t * (-1.821_255_978 + t * 1.330_274_429))));
    let above = density * series;
    if z < 0.0 { above } else { 1.0 - above }
}

/// φ(z)/Φ(-z) and -2 ln Φ(-z).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tail {
    pub hazard: f64,
    pub minus_two_ln: f64,
}

/// The tail beyond z, to 0.1 %.
pub(crate) fn tail(z: f64) -> Tail {
    if z > 3.5 {
        // Laplace's continued fraction.
        let hazard = z + 1.0 / (z + 2.0 / (z + 3.0 / (z + 4.0 / z)));
        return Tail { hazard, minus_two_ln: z * z + 2.0 * (hazard * TAU.sqrt()).ln() };
    }
    let density = density(z);
    let above = cumulative_with_density(-z, density);
    Tail { hazard: density / above, minus_two_ln: -2.0 * above.ln() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_distribution_function_is_the_integral_of_the_density() {
        let step = 1e-3;
        let mut integral = 0.5;
        for i in 0..5_000 {
            let z = f64::from(i) * step;
            assert!((cumulative(z) - integral).abs() < 1e-7, "{z}");
            assert!((cumulative(-z) - (1.0 - integral)).abs() < 1e-7, "{z}");
            // Simpson's rule.
            let middle = density(z + 0.5 * step);
            integral += step / 6.0 * (density(z) + 4.0 * middle + density(z + step));
        }
    }

    #[test]
    fn tails_are_continuous_and_approach_their_limits() {
        let far = tail(8.0).hazard;
        assert!((far - 8.12).abs() < 0.02, "{far}");
        let (below, above) = (tail(3.4999).hazard, tail(3.5001).hazard);
        assert!((below / above - 1.0).abs() < 0.01, "{below} {above}");
        let middle = tail(0.0);
        assert!((middle.hazard - 0.7979).abs() < 1e-3);
        assert!((middle.minus_two_ln - 2.0 * 2f64.ln()).abs() < 1e-3);
        assert!(tail(-4.0).hazard < 1e-3);
    }
}
