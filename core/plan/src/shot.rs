//! Pictures of one ring, as a blurring lens and a sensor with noise give them.
//!
//! A pixel at (p, q) sees the indicator of an ellipse through its own square blurred by a Gaussian of the deviation σ. With
//! the ellipse's lines at the heights y = c + h sin θ, each from a(θ) to b(θ), its share of the pixel is
//!
//! s(p, q) = ∫ k(q - y) (K(p - a) - K(p - b)) h cos θ dθ,  K(x) = ∫₋∞ˣ k = 1 + B(x + ½) - B(x - ½),
//!
//! B(x) = ∫ₓ^∞ Φ(-t/σ) dt. The integrand is smooth and of the period π, so that the midpoint rule converges faster than any
//! power of its step: discs as small as the blur are as exact as large ones, where coverage by an edge's distance alone
//! ([`roundel_sim`]) is off by some hundredths of a pixel. Light is even, and the lens bends nothing over one ring.

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

/// Deviations beyond which an edge's blur shows no more.
const REACH_SIGMA: f64 = 4.5;
/// Values of K for each pixel; between them it is as good as straight.
const STEPS_PER_PX: f64 = 64.0;
/// Distance of an ellipse's lines at most, of the deviation of blur and pixel together, and fewest lines.
const LINES_SIGMA: f64 = 0.5;
const LEAST_LINES: usize = 8;

/// A sheet's diameter over the ring's, and where the floor's level lies from the sheet's to the ring's. What is about a ring
/// matters while it is small: its rims' light and the floor's run into each other.
const SHEET_SHARE: f64 = 1.8;
const FLOOR_SHARE: f64 = 0.5;

/// A blurred edge, as pixels see it.
pub(super) struct Edge {
    blur_px: f64,
    reach_px: f64,
    /// K from `-reach_px` on.
    shares: Vec<f64>,
}

impl Edge {
    pub fn new(blur_px: f64) -> Self {
        let reach_px = REACH_SIGMA * blur_px + 0.5;
        let beyond = |x_px: f64| Beyond::new(x_px, blur_px).moved_px;
        let share = |step: usize| {
            let x_px = step as f64 / STEPS_PER_PX - reach_px;
            1.0 + beyond(x_px + 0.5) - beyond(x_px - 0.5)
        };
        let count = (2.0 * reach_px * STEPS_PER_PX) as usize + 2;
        Self { blur_px, reach_px, shares: (0..count).map(share).collect() }
    }

    /// Of a pixel whose middle is so far on the covered side.
    fn share(&self, x_px: f64) -> f64 {
        let place = (x_px + self.reach_px) * STEPS_PER_PX;
        if place <= 0.0 {
            return 0.0;
        }
        let step = place as usize;
        match self.shares.get(step + 1) {
            Some(next) => {
                let this = self.shares[step];
                this + (place - step as f64) * (next - this)
            }
            None => 1.0,
        }
    }

    /// k.
    fn weight(&self, x_px: f64) -> f64 {
        let below = |x_px: f64| normal_distribution::cumulative(x_px / self.blur_px);
        below(x_px + 0.5) - below(x_px - 0.5)
    }

    /// Shares of the pixels of a row between two edges; most of them lie on either side of both.
    fn chord(&self, [left, right]: [f64; 2], shares: &mut [f64]) {
        let side = shares.len() as f64;
        let near = |at: f64| {
            let [from, to] = [(at - self.reach_px).ceil(), (at + self.reach_px).floor() + 1.0];
            [from, to].map(|end| end.clamp(0.0, side) as usize)
        };
        let ([first, inside], [outside, last]) = (near(left), near(right));
        shares.fill(0.0);
        if inside < outside {
            shares[inside..outside].fill(1.0);
        }
        for range in [first..inside.min(last), outside.max(inside)..last] {
            for p in range {
                shares[p] = self.share(p as f64 - left) - self.share(p as f64 - right);
            }
        }
    }

    /// Adds `sign` times an ellipse's shares to those of the pixels of a square picture.
    fn cover(&self, ellipse: &Ellipse, sign: f64, side: usize, shares: &mut [f64]) {
        let shape = ellipse.matrix();
        let high_px = shape.vv.sqrt();
        // Lines are this much shorter in the middle than the box is wide, and lie aslant.
        let wide_px = (shape.determinant() / shape.vv).sqrt();
        let aslant = shape.uv / shape.vv;
        let step_px = LINES_SIGMA * (self.blur_px.powi(2) + 1.0 / 12.0).sqrt();
        let lines = ((PI * high_px / step_px).ceil() as usize).max(LEAST_LINES);
        let step = PI / lines as f64;
        let mut along = vec![0.0; side];
        for line in 0..lines {
            let (sin, cos) = ((line as f64 + 0.5) * step - FRAC_PI_2).sin_cos();
            let (y, half) = (high_px * sin, wide_px * cos);
            let middle = ellipse.center.u + aslant * y;
            self.chord([middle - half, middle + half], &mut along);
            let v = ellipse.center.v + y;
            let first = (v - self.reach_px).ceil().max(0.0) as usize;
            let last = ((v + self.reach_px).floor() + 1.0).clamp(0.0, side as f64) as usize;
            for q in first..last {
                let weight = sign * high_px * cos * step * self.weight(q as f64 - v);
                let row = &mut shares[q * side..][..side];
                row.iter_mut().zip(&along).for_each(|(sum, share)| *sum += weight * share);
            }
        }
    }

    /// Grey levels of a ring on its sheet, before a floor midway between black and white; without noise, in `side` rows
    /// and columns.
    pub fn picture(&self, ring: &Ring, imaging: &Imaging, side: usize) -> Vec<f64> {
        let sheet = Ellipse {
            semi_major_px: SHEET_SHARE * ring.outer.semi_major_px,
            semi_minor_px: SHEET_SHARE * ring.outer.semi_minor_px,
            ..ring.outer
        };
        // Of the contrast: 0 is the sheet, 1 the print.
        let mut levels = vec![FLOOR_SHARE; side * side];
        self.cover(&sheet, -FLOOR_SHARE, side, &mut levels);
        self.cover(&ring.outer, 1.0, side, &mut levels);
        self.cover(&ring.inner, -1.0, side, &mut levels);
        let (page, step) = match ring.polarity {
            Polarity::BlackRing => (imaging.white, -imaging.contrast()),
            Polarity::WhiteRing => (imaging.black, imaging.contrast()),
        };
        levels.iter_mut().for_each(|level| *level = page + step * *level);
        levels
    }
}

/// The pixels of a picture with noise of this deviation, grey levels.
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

    /// Shares of an ellipse, one of each pixel.
    fn shares(edge: &Edge, ellipse: &Ellipse, side: usize) -> Vec<f64> {
        let mut shares = vec![0.0; side * side];
        edge.cover(ellipse, 1.0, side, &mut shares);
        shares
    }

    /// Moments of a blurred ellipse: its area, its centre, and its own covariance with blur and pixel added.
    #[test]
    fn blur_keeps_area_and_centre_and_widens_by_its_variance() {
        let side = 40;
        for (semiaxes_px, angle_rad) in [([2.0, 1.1], 0.4), ([9.0, 6.5], -1.2), ([3.0, 3.0], 0.0)] {
            let Ring { outer, .. } = ring([19.3, 20.6], angle_rad, [semiaxes_px; 2]);
            let mut sums = [0.0; 6];
            for (index, share) in shares(&Edge::new(0.7), &outer, side).iter().enumerate() {
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

    /// Pixel by pixel, without leaving any out.
    #[test]
    fn chords_are_what_their_edges_say_however_short_and_wherever_they_lie() {
        let (edge, mut shares) = (Edge::new(0.7), vec![0.5; 40]);
        for ends in [[10.3, 25.8], [12.1, 12.4], [-9.0, 3.2], [36.0, 70.0], [-5.0, 60.0]] {
            edge.chord(ends, &mut shares);
            for (p, share) in shares.iter().enumerate() {
                let [left, right] = ends.map(|end| edge.share(p as f64 - end));
                assert!((share - (left - right)).abs() < 1e-5, "{ends:?} at {p}: {share}");
            }
        }
    }

    #[test]
    fn levels_are_those_of_floor_sheet_black_and_disc_and_may_be_turned_over() {
        let side = 64;
        let mut ring = ring([32.0, 31.0], 0.3, [[15.0, 13.0], [6.0, 5.0]]);
        let imaging = Imaging { noise: 0.0, blur_px: 0.7, black: 40.0, white: 200.0 };
        let edge = Edge::new(imaging.blur_px);
        let at = |levels: &[f64], u: usize, v: usize| levels[v * side + u];
        let levels = edge.picture(&ring, &imaging, side);
        for (u, v, expected) in [(2, 2, 120.0), (32, 31, 200.0), (32, 40, 40.0), (12, 25, 200.0)] {
            assert!((at(&levels, u, v) - expected).abs() < 0.05, "{u} {v}");
        }
        ring.polarity = Polarity::WhiteRing;
        let turned = edge.picture(&ring, &imaging, side);
        assert!(levels.iter().zip(&turned).all(|(one, other)| (one + other - 240.0).abs() < 1e-9));
    }
}
