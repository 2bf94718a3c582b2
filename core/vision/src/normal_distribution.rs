//! The standard normal distribution: density φ, distribution function Φ, the logarithm of its tail, and how much of a
//! blurred edge lies beyond a cut.
//!
//! Φ is the rational approximation of Abramowitz and Stegun, 26.2.17, with an absolute error below 7.5e-8;
//! `normal_each` and [`Beyond`] use 26.2.16, to 1e-5, for code that runs in vector lanes.

use std::f64::consts::TAU;

use crate::simd::{Lane, floor};

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

/// The part of a blurred edge beyond a cut parallel to it.
#[derive(Clone, Copy, Debug)]
pub struct Beyond<T> {
    /// ∫ Φ(-x/σ) dx, pixels.
    pub moved_px: T,
    /// ∫ x Φ(-x/σ) dx / σ²; 1/4 for a cut on the edge.
    pub spread: T,
}

impl<T: Lane> Beyond<T> {
    #[inline(always)]
    fn density(z: T) -> T {
        (z * z * -0.5).exponential() * FRAC_1_SQRT_TAU
    }

    /// For a cut at this distance from an edge with this blur.
    #[inline(always)]
    pub fn new(distance_px: T, blur_px: T) -> Self {
        let z = distance_px / blur_px;
        let density = Self::density(z);
        let tail = upper_tail(z.size(), density);
        let none = z.splat(0.0);
        let tail = T::choose(z.below(none), -tail + 1.0, tail);
        Self {
            moved_px: (blur_px * (density - z * tail)).larger(none),
            spread: ((-(z * z) + 1.0) * tail + z * density).larger(none) * 0.5,
        }
    }
}

/// Φ(-z) for z ≥ 0, given φ(z), to 1e-5 (Abramowitz and Stegun, 26.2.16).
#[inline(always)]
fn upper_tail<T: Lane>(z: T, density: T) -> T {
    let t = (z * 0.33267 + 1.0).under(1.0);
    density * t * (t * (t * 0.937_298_0 - 0.120_167_6) + 0.436_183_6)
}

/// φ(z) and Φ(z) to 1e-5, in operations that the compiler vectorizes.
#[inline(always)]
pub(crate) fn normal_each(z: f32) -> (f32, f32) {
    const MIN_POWER: f32 = -120.0;
    // 2^x = 2^n 2^f, f in [0, 1), by its series.
    let power = (-0.5 * std::f32::consts::LOG2_E * z * z).max(MIN_POWER);
    let whole = floor(power);
    let rest = (power - whole as f32) * std::f32::consts::LN_2;
    let mut value = 1.0 + rest * (1.0 / 7.0);
    for k in [6.0, 5.0, 4.0, 3.0, 2.0, 1.0] {
        value = 1.0 + value * rest * (1.0 / k);
    }
    let scale = f32::from_bits(((whole + 127) << 23) as u32);
    let density = value * scale * FRAC_1_SQRT_TAU as f32;
    // As `upper_tail`.
    let t = 1.0 / (1.0 + 0.33267 * z.abs());
    let tail = density * t * (t * (t * 0.937_298 - 0.120_167_6) + 0.436_183_6);
    (density, 0.5 + (0.5 - tail).copysign(z))
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

    fn normal_density(z: f64) -> f64 {
        (-0.5 * z * z).exp() * FRAC_1_SQRT_TAU
    }

    fn normal_share(z: f64) -> f64 {
        let tail = upper_tail(z.abs(), normal_density(z));
        if z < 0.0 { tail } else { 1.0 - tail }
    }

    /// Σ of `value` over the half line from `from`, by the midpoint rule.
    fn integral(from: f64, value: impl Fn(f64) -> f64) -> f64 {
        (0..20_000).map(|i| value(from + (f64::from(i) + 0.5) * 5e-4) * 5e-4).sum()
    }

    #[test]
    fn single_precision_agrees_with_double() {
        for step in -4000..4000 {
            let z = f64::from(step) * 0.01;
            let (density, share) = normal_each(z as f32);
            assert!((f64::from(density) - normal_density(z)).abs() < 3e-6, "{z}");
            assert!((f64::from(share) - normal_share(z)).abs() < 3e-6, "{z}");
        }
    }

    #[test]
    fn closed_forms_equal_their_integrals() {
        let blur_px = 0.8f64;
        let beyond = |x: f64| Beyond::new(x, blur_px);
        // Φ(-x/σ) is the derivative of the part beyond x.
        let tail = |x: f64| (beyond(x - 1e-4).moved_px - beyond(x + 1e-4).moved_px) / 2e-4;
        for distance_px in [0.1, 0.4, 1.3, 2.5] {
            let moved = integral(distance_px, tail);
            assert!((beyond(distance_px).moved_px - moved).abs() < 1e-4, "{distance_px}");
            let spread = integral(distance_px, |x| x * tail(x)) / blur_px.powi(2);
            assert!((beyond(distance_px).spread - spread).abs() < 1e-3, "{distance_px}");
        }
        assert!((beyond(0.0).spread - 0.25).abs() < 1e-4);
        assert!((upper_tail(1.0, normal_density(1.0)) - 0.158_655).abs() < 2e-5);
    }
}
