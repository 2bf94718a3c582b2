//! Renders one ring with exact blur and noise.
//!
//! A pixel at (p, q) is the convolution of an ellipse's indicator with its own square and a Gaussian of deviation σ. The
//! ellipse is integrated along lines at y = c + h sin θ, each from a(θ) to b(θ):
//!
//! s(p, q) = ∫ k(q - y) (K(p - a) - K(p - b)) h cos θ dθ,  K(x) = ∫₋∞ˣ k = 1 + B(x + ½) - B(x - ½),
//!
//! B(x) = ∫ₓ^∞ Φ(-t/σ) dt. The integrand is smooth with period π, so the midpoint rule converges faster than any power of
//! its step, also for discs as small as the blur; the approximation of [`roundel_sim`] by the distance to the edge is off by
//! hundredths of a pixel there. Limits: even light, and no distortion within a ring.

use std::f64::consts::{FRAC_PI_2, PI};

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::{FULL_SCALE, Imaging};
use roundel_vision::{
    ellipse::Ellipse,
    marker::{Polarity, Ring},
    normal_distribution::{self, Beyond},
};

/// Extent of an edge's blur in deviations.
const REACH_SIGMA: f64 = 4.5;
/// Maximum distance of lines in deviations of blur and pixel, and minimum number of lines.
const LINES_SIGMA: f64 = 1.0;
const MIN_LINES: usize = 8;

/// Diameter of the sheet over that of the ring, and level of the floor from that of the sheet to that of the ring.
/// The surroundings affect small rings.
const SHEET_SHARE: f64 = 1.8;
const FLOOR_SHARE: f64 = 0.5;

fn reach_px(blur_px: f64) -> f64 {
    REACH_SIGMA * blur_px + 0.5
}

/// K.
fn share(x_px: f64, blur_px: f64) -> f64 {
    if x_px.abs() >= reach_px(blur_px) {
        return if x_px < 0.0 { 0.0 } else { 1.0 };
    }
    let beyond = |x_px: f64| Beyond::new(x_px, blur_px).moved_px;
    1.0 + beyond(x_px + 0.5) - beyond(x_px - 0.5)
}

/// k.
fn weight(x_px: f64, blur_px: f64) -> f64 {
    let below = |x_px: f64| normal_distribution::cumulative(x_px / blur_px);
    below(x_px + 0.5) - below(x_px - 0.5)
}

/// Adds `sign` times the coverage of an ellipse to a square picture.
fn cover(ellipse: &Ellipse, blur_px: f64, sign: f64, side: usize, shares: &mut [f64]) {
    let shape = ellipse.matrix();
    let high_px = shape.vv.sqrt();
    // Length of the longest line, and shear of the lines.
    let wide_px = (shape.determinant() / shape.vv).sqrt();
    let aslant = shape.uv / shape.vv;
    let step_px = LINES_SIGMA * (blur_px.powi(2) + 1.0 / 12.0).sqrt();
    let lines = ((PI * high_px / step_px).ceil() as usize).max(MIN_LINES);
    let step = PI / lines as f64;
    let mut along = vec![0.0; side];
    for line in 0..lines {
        let (sin, cos) = ((line as f64 + 0.5) * step - FRAC_PI_2).sin_cos();
        let (y, half) = (high_px * sin, wide_px * cos);
        let middle = ellipse.center.u + aslant * y;
        for (p, along) in along.iter_mut().enumerate() {
            let x_px = p as f64 - middle;
            *along = share(x_px + half, blur_px) - share(x_px - half, blur_px);
        }
        let v = ellipse.center.v + y;
        let first = (v - reach_px(blur_px)).ceil().max(0.0) as usize;
        let last = ((v + reach_px(blur_px)).floor() + 1.0).clamp(0.0, side as f64) as usize;
        for q in first..last {
            let weight = sign * high_px * cos * step * weight(q as f64 - v, blur_px);
            let row = &mut shares[q * side..][..side];
            row.iter_mut().zip(&along).for_each(|(sum, share)| *sum += weight * share);
        }
    }
}

/// Grey levels of a ring on its sheet without noise, `side` rows and columns.
pub(super) fn picture(ring: &Ring, imaging: &Imaging, side: usize) -> Vec<f64> {
    let sheet = Ellipse {
        semi_major_px: SHEET_SHARE * ring.outer.semi_major_px,
        semi_minor_px: SHEET_SHARE * ring.outer.semi_minor_px,
        ..ring.outer
    };
    // In units of the contrast: 0 is the sheet, 1 the print.
    let mut levels = vec![FLOOR_SHARE; side * side];
    for (ellipse, sign) in [(&sheet, -FLOOR_SHARE), (&ring.outer, 1.0), (&ring.inner, -1.0)] {
        cover(ellipse, imaging.blur_px, sign, side, &mut levels);
    }
    let (page, step) = match ring.polarity {
        Polarity::BlackRing => (imaging.white, -imaging.contrast()),
        Polarity::WhiteRing => (imaging.black, imaging.contrast()),
    };
    levels.iter_mut().for_each(|level| *level = page + step * *level);
    levels
}

/// Adds noise and quantizes.
pub(super) fn developed(levels: &[f64], noise: f64, random: &mut ChaCha8Rng, pixels: &mut [u8]) {
    for (level, pixel) in levels.iter().zip(pixels) {
        let normal: f64 = random.sample(StandardNormal);
        *pixel = (level + noise * normal).round().clamp(0.0, FULL_SCALE) as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use roundel_vision::camera::PixelPoint;

    fn ring(center: [f64; 2], angle_rad: f64, [outer_px, inner_px]: [[f64; 2]; 2]) -> Ring {
        let [u, v] = center;
        let ellipse = |[semi_major_px, semi_minor_px]: [f64; 2]| Ellipse {
            center: PixelPoint { u, v },
            semi_major_px,
            semi_minor_px,
            angle_rad,
        };
        Ring::of_rims(ellipse(outer_px), ellipse(inner_px))
    }

    /// Area, centre and covariance of a blurred ellipse.
    #[test]
    fn blur_keeps_area_and_centre_and_adds_its_variance() {
        let side = 40;
        for (semiaxes_px, angle_rad) in [([2.0, 1.1], 0.4), ([9.0, 6.5], -1.2), ([3.0, 3.0], 0.0)] {
            let Ring { outer, .. } = ring([19.3, 20.6], angle_rad, [semiaxes_px; 2]);
            let mut sums = [0.0; 6];
            let mut shares = vec![0.0; side * side];
            cover(&outer, 0.7, 1.0, side, &mut shares);
            for (index, share) in shares.iter().enumerate() {
                let (u, v) = ((index % side) as f64 - 19.3, (index / side) as f64 - 20.6);
                let moments = [1.0, u, v, u * u, u * v, v * v];
                sums.iter_mut().zip(moments).for_each(|(sum, of)| *sum += share * of);
            }
            let area_px2 = outer.area_px2();
            assert!((sums[0] / area_px2 - 1.0).abs() < 1e-4, "{} {area_px2}", sums[0]);
            assert!(sums[1].hypot(sums[2]) < 1e-3 * area_px2, "{sums:?}");
            let (shape, added) = (outer.matrix(), 0.49 + 1.0 / 12.0);
            let expected = [0.25 * shape.uu + added, 0.25 * shape.uv, 0.25 * shape.vv + added];
            for (sum, expected) in sums[3..].iter().zip(expected) {
                let found = sum / area_px2;
                assert!((found - expected).abs() < 2e-3 * expected.abs().max(1.0), "{found}");
            }
        }
    }

    #[test]
    fn levels_are_correct_for_both_polarities() {
        let side = 64;
        let mut ring = ring([32.0, 31.0], 0.3, [[15.0, 13.0], [6.0, 5.0]]);
        let imaging = Imaging { noise: 0.0, blur_px: 0.7, black: 40.0, white: 200.0 };
        let at = |levels: &[f64], u: usize, v: usize| levels[v * side + u];
        let levels = picture(&ring, &imaging, side);
        for (u, v, expected) in [(2, 2, 120.0), (32, 31, 200.0), (32, 40, 40.0), (12, 25, 200.0)] {
            assert!((at(&levels, u, v) - expected).abs() < 0.05, "{u} {v}");
        }
        ring.polarity = Polarity::WhiteRing;
        let turned = picture(&ring, &imaging, side);
        assert!(levels.iter().zip(&turned).all(|(one, other)| (one + other - 240.0).abs() < 1e-9));
    }
}
