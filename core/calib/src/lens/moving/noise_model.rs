//! How large the errors of a moving roundel's image are that nobody states: of its rim's centre, and of the stamps from frame to
//! frame.
//!
//! Along the motion a squared error is expected to be k + s² r̄/r + τ² v², across it k' + s² r̄/r, with k and k' what is
//! known of the place in these directions, v the speed in the image. Both s² and τ² follow by least squares,
//! weighted by the squared expectation, twice, since that is not known before; negative ones are none.

use super::super::fit::robust::median;

/// A rim's centre is not found more exactly than this, pixels.
const LEAST_PX: f64 = 0.01;
/// Errors so many times what is expected are other roundels'.
const OTHERS: f64 = 25.0;
const ROUNDS: usize = 4;

/// What nobody states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Spread {
    /// Deviation of one coordinate of the centre of a rim of mean radius, pixels.
    pub(super) pixel_px: f64,
    /// Deviation of stamps from frame to frame, seconds.
    pub(super) stamp_s: f64,
}

/// An error along the motion and across it: its square and what is expected of it by what is known of the place, pixels².
#[derive(Clone, Copy, Debug)]
pub(super) struct Apart {
    pub(super) along: (f64, f64),
    pub(super) across: (f64, f64),
    pub(super) px_per_s: f64,
    pub(super) radius_px: f64,
}

impl Spread {
    /// Before anything is known: a lens that is not known yet is off by more.
    pub(super) const BEGIN: Self = Self { pixel_px: 1.0, stamp_s: 0.0 };

    /// As errors show it.
    pub(super) fn of(errors: &[Apart]) -> Self {
        let mean_px =
            errors.iter().map(|it| it.radius_px).sum::<f64>() / errors.len().max(1) as f64;
        let mut squares: Vec<f64> =
            errors.iter().map(|it| 0.5 * (it.along.0 + it.across.0)).collect();
        let Some(median) = median(&mut squares) else { return Self::BEGIN };
        // Half of a χ² of two degrees of freedom has its median at ln 2.
        let (mut pixel, mut stamp) = (median / std::f64::consts::LN_2, 0.0);
        for _ in 0..ROUNDS {
            let (mut pp, mut pt, mut tt, mut p, mut t) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for it in errors {
                let size = mean_px / it.radius_px;
                let speed = it.px_per_s * it.px_per_s;
                for ((square, known), speed) in [(it.along, speed), (it.across, 0.0)] {
                    let expected = known + pixel * size + stamp * speed + LEAST_PX * LEAST_PX;
                    if square > OTHERS * expected {
                        continue;
                    }
                    let weight = expected.powi(-2);
                    let rest = square - known;
                    pp += weight * size * size;
                    pt += weight * size * speed;
                    tt += weight * speed * speed;
                    p += weight * size * rest;
                    t += weight * speed * rest;
                }
            }
            let determinant = pp * tt - pt * pt;
            let (both, alone) = (
                ((tt * p - pt * t) / determinant, (pp * t - pt * p) / determinant),
                p / pp.max(f64::MIN_POSITIVE),
            );
            let is_told = determinant > 1e-9 * pp * tt && both.1 > 0.0;
            (pixel, stamp) = if is_told { both } else { (alone, 0.0) };
            pixel = pixel.max(LEAST_PX * LEAST_PX);
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
    fn both_are_told_apart_and_neither_is_where_there_is_none() {
        for stamp_s in [0.0_f64, 2e-3] {
            let mut rng = ChaCha8Rng::seed_from_u64(1);
            let errors: Vec<Apart> = (0..4000)
                .map(|index| {
                    let (px_per_s, radius_px) =
                        (rng.random_range(0.0..300.0), rng.random_range(10.0..30.0));
                    let known = 0.01;
                    let own = known + 0.04 * 20.0 / radius_px;
                    let mut drawn = |variance: f64| {
                        let normal: f64 = StandardNormal.sample(&mut rng);
                        variance * normal * normal
                    };
                    let off = if index % 100 == 0 { 1e4 } else { 0.0 };
                    let along = (drawn(own + (stamp_s * px_per_s).powi(2)) + off, known);
                    Apart { along, across: (drawn(own) + off, known), px_per_s, radius_px }
                })
                .collect();
            let spread = Spread::of(&errors);
            assert!((spread.pixel_px / 0.2 - 1.0).abs() < 0.05, "{spread:?}");
            assert!((spread.stamp_s - stamp_s).abs() < 2e-4, "{spread:?}");
        }
    }
}
