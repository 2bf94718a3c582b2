//! Estimates the noise of rim centres and of stamps from residuals.
//!
//! The expected square of a residual is k + s² r̄/r + τ² v² along the motion and k' + s² r̄/r across it, where k and k' are
//! the known variances of the position in these directions and v is the image velocity. s² and τ² follow by least squares,
//! weighted by the inverse squared expectation and iterated; negative values become zero.

use crate::robust::median;

/// Minimum noise of a rim's centre, pixels.
const MIN_PX: f64 = 0.01;
/// Squares beyond this factor of their expectation are outliers.
const OUTLIER_RATIO: f64 = 25.0;
const ROUNDS: usize = 4;

/// Noise that detections do not state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct NoiseModel {
    /// Standard deviation of one coordinate of the centre of a rim of mean radius, pixels.
    pub(super) pixel_px: f64,
    /// Standard deviation of stamps from frame to frame, seconds.
    pub(super) stamp_s: f64,
}

/// Square of a residual along and across the motion, each with its known variance, pixels².
#[derive(Clone, Copy, Debug)]
pub(super) struct NoiseSample {
    pub(super) along: (f64, f64),
    pub(super) across: (f64, f64),
    pub(super) px_per_s: f64,
    pub(super) radius_px: f64,
}

impl NoiseModel {
    /// Initial value, which covers the errors of an unknown lens.
    pub(super) const INITIAL: Self = Self { pixel_px: 1.0, stamp_s: 0.0 };

    pub(super) fn fit(errors: &[NoiseSample]) -> Self {
        let mean_px =
            errors.iter().map(|it| it.radius_px).sum::<f64>() / errors.len().max(1) as f64;
        let mut squares: Vec<f64> =
            errors.iter().map(|it| 0.5 * (it.along.0 + it.across.0)).collect();
        let Some(median) = median(&mut squares) else { return Self::INITIAL };
        // Half of χ² with two degrees of freedom has the median ln 2.
        let (mut pixel, mut stamp) = (median / std::f64::consts::LN_2, 0.0);
        for _ in 0..ROUNDS {
            let (mut pp, mut pt, mut tt, mut p, mut t) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for it in errors {
                let size = mean_px / it.radius_px;
                let speed = it.px_per_s * it.px_per_s;
                for ((square, known_px2), speed) in [(it.along, speed), (it.across, 0.0)] {
                    let expected = known_px2 + pixel * size + stamp * speed + MIN_PX * MIN_PX;
                    if square > OUTLIER_RATIO * expected {
                        continue;
                    }
                    let weight = expected.powi(-2);
                    let rest = square - known_px2;
                    pp += weight * size * size;
                    pt += weight * size * speed;
                    tt += weight * speed * speed;
                    p += weight * size * rest;
                    t += weight * speed * rest;
                }
            }
            let determinant = pp * tt - pt * pt;
            let (joint, pixel_only) = (
                ((tt * p - pt * t) / determinant, (pp * t - pt * p) / determinant),
                p / pp.max(f64::MIN_POSITIVE),
            );
            let is_determined = determinant > 1e-9 * pp * tt && joint.1 > 0.0;
            (pixel, stamp) = if is_determined { joint } else { (pixel_only, 0.0) };
            pixel = pixel.max(MIN_PX * MIN_PX);
        }
        Self { pixel_px: pixel.sqrt(), stamp_s: stamp.sqrt() }
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    #[test]
    fn rim_and_stamp_noise_are_separated() {
        for stamp_s in [0.0_f64, 2e-3] {
            let mut rng = ChaCha8Rng::seed_from_u64(1);
            let errors: Vec<NoiseSample> = (0..4000)
                .map(|index| {
                    let (px_per_s, radius_px) =
                        (rng.random_range(0.0..300.0), rng.random_range(10.0..30.0));
                    let known_px2 = 0.01;
                    let own = known_px2 + 0.04 * 20.0 / radius_px;
                    let mut drawn = |variance: f64| {
                        let normal: f64 = StandardNormal.sample(&mut rng);
                        variance * normal * normal
                    };
                    let off = if index % 100 == 0 { 1e4 } else { 0.0 };
                    let along = (drawn(own + (stamp_s * px_per_s).powi(2)) + off, known_px2);
                    NoiseSample {
                        along,
                        across: (drawn(own) + off, known_px2),
                        px_per_s,
                        radius_px,
                    }
                })
                .collect();
            let noise = NoiseModel::fit(&errors);
            assert!((noise.pixel_px / 0.2 - 1.0).abs() < 0.05, "{noise:?}");
            assert!((noise.stamp_s - stamp_s).abs() < 2e-4, "{noise:?}");
        }
    }
}
