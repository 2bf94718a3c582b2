//! Rejects new rings whose rims are not ellipses, by the grey levels along them.
//!
//! Areas and moments see a shape as a whole: a disc in a square frame, a square hole in a round disc
//! or a gear can match those of a ring. Along a correct rim, every point has the same level; where the true outline lies
//! further out or in, the level is darker or brighter. With L(t) the level at the ellipse's angle t over the contrast,
//!
//!   L(t) = Σ_k a_k cos kt + b_k sin kt,   h_k² = (a_k² + b_k²) / 2,
//!
//! h₀ is a wrong threshold, h₁ a lighting gradient, h₂ a slightly wrong ellipse: none of them speaks against a roundel.
//! Corners of polygons and gaps appear in h₃ … h₆, the teeth of gears and jagged outlines beyond (by Parseval, the
//! remaining variance). Both are limited to what noise and paper cause.
//!
//! Figures behind the limits (contrast 90 and more, noise to 4, blur 0.5 to 1.1 px): 1,470 rendered
//! roundels have at most 0.021 in h₃ … h₆ and 0.027 beyond, to which perspective adds up to 0.056 for large
//! ones; photographed prints reach 0.04 and 0.02 when small, 0.062 and 0.034 at 50 px on uneven
//! paper. Of 240 rings found on other objects in rendered scenes, all but two exceed the limits
//! (`cargo run -p roundel-tests -- recall`).
//!
//! Tracked rings are not tested, so that a passing shadow does not end a track.

use std::{f64::consts::TAU, sync::LazyLock};

use crate::{
    ellipse::Ellipse,
    frame::Frame,
    marker::{Ring, reject::Reject},
};

/// Points along a rim.
const POINTS: usize = 64;
/// Harmonics of corners and gaps.
const LOW: std::ops::Range<usize> = 3..7;
/// Largest h₃ … h₆ together: a share of the contrast, grey levels, and a share per pixel of the
/// longer semiaxis, since the same bend of the paper is more pixels there.
const LOW_LIMIT: (f64, f64, f64) = (0.03, 0.9, 0.001);
/// Largest remainder beyond h₆, likewise.
const HIGH_LIMIT: (f64, f64, f64) = (0.035, 1.5, 0.0005);

/// Highest harmonic computed separately.
const HIGHEST: usize = LOW.end - 1;

/// cos kt and sin kt at the points, from k = 1 on.
static WAVES: LazyLock<[[[f32; POINTS]; 2]; HIGHEST]> = LazyLock::new(|| {
    std::array::from_fn(|k| {
        let angle = |point: usize| TAU * ((k + 1) * point % POINTS) as f64 / POINTS as f64;
        [
            std::array::from_fn(|point| angle(point).cos() as f32),
            std::array::from_fn(|point| angle(point).sin() as f32),
        ]
    })
});

/// Rejects if the outer rim is not an ellipse, or the inner one of a `plain` disc. `steps_share` of the contrast is
/// tolerated in addition.
pub(crate) fn check_rims(
    frame: &Frame,
    ring: &Ring,
    plain: bool,
    steps_share: f64,
) -> Result<(), Reject> {
    let contrast = (ring.white - ring.black).abs();
    let inner = plain.then_some(&ring.inner);
    for rim in std::iter::once(&ring.outer).chain(inner) {
        let shares = |levels: &[f32; POINTS]| Rest::of(levels).shares(contrast);
        let (low, high) = shares(&levels_along(frame, rim));
        let limit = |(share, levels, per_px): (f64, f64, f64)| {
            steps_share + share + levels / contrast + per_px * rim.semi_major_px
        };
        // False for NaN, without contrast.
        let is_smooth = |high: f64| high <= limit(HIGH_LIMIT);
        if !(low <= limit(LOW_LIMIT)
            && (is_smooth(high) || is_smooth(shares(&soft_levels(frame, rim)).1)))
        {
            return Err(Reject::Outline);
        }
    }
    Ok(())
}

/// Grey levels along an ellipse at `N` even steps of its angle; N divides 64.
pub(super) fn levels_along<const N: usize>(frame: &Frame, rim: &Ellipse) -> [f32; N] {
    let [cos, sin] = &WAVES[0];
    let (sin_tilt, cos_tilt) = rim.angle_rad.sin_cos();
    let place = |center: f64, major: f64, minor: f64| -> [f32; N] {
        let (center, major, minor) = (center as f32, major as f32, minor as f32);
        std::array::from_fn(|i| center + cos[i * POINTS / N] * major + sin[i * POINTS / N] * minor)
    };
    let (major_px, minor_px) = (rim.semi_major_px, rim.semi_minor_px);
    let us = place(rim.center.u, major_px * cos_tilt, -minor_px * sin_tilt);
    let vs = place(rim.center.v, major_px * sin_tilt, minor_px * cos_tilt);
    let (pixels, stride) = frame.pixels();
    let last = |size: usize| (size - 1) as f32;
    let (right, bottom) = (last(frame.width()), last(frame.height()));
    std::array::from_fn(|i| {
        // Bilinear; the last pixels extend beyond the frame.
        let (u, v) = (us[i].clamp(0.0, right), vs[i].clamp(0.0, bottom));
        let (left, top) = (u as i32 as usize, v as i32 as usize);
        let (du, dv) = (u - left as f32, v - top as f32);
        let (next, below) = (usize::from(du > 0.0), if dv > 0.0 { stride } else { 0 });
        let at = top * stride + left;
        let level = |index: usize| f32::from(pixels[index]);
        let mix = |at: usize| level(at) + (level(at + next) - level(at)) * du;
        let upper = mix(at);
        upper + (mix(at + below) - upper) * dv
    })
}

/// Variances of levels, by harmonics.
#[derive(Clone, Copy, Debug)]
struct Rest {
    low: f32,
    high: f32,
}

impl Rest {
    fn of(levels: &[f32; POINTS]) -> Self {
        let n = POINTS as f32;
        let mean = levels.iter().sum::<f32>() / n;
        let off = levels.map(|level| level - mean);
        let waves = &*WAVES;
        let variance = |k: usize| {
            let [along, across] = waves[k - 1].each_ref().map(|wave| dot(wave, &off));
            2.0 * (along * along + across * across) / (n * n)
        };
        let low = LOW.map(variance).sum::<f32>();
        let high = (dot(&off, &off) / n - variance(1) - variance(2) - low).max(0.0);
        Self { low, high }
    }

    /// Rms as shares of the contrast.
    fn shares(self, contrast: f64) -> (f64, f64) {
        (f64::from(self.low.sqrt()) / contrast, f64::from(self.high.sqrt()) / contrast)
    }
}

/// Levels along an ellipse, blurred across it by 0.35 px. Without blur, as in a drawing,
/// interpolation between two pixels of an edge depends on their position relative to it, by up to
/// 0.08 of the contrast.
fn soft_levels(frame: &Frame, rim: &Ellipse) -> [f32; POINTS] {
    let [inside, at, outside] = [-0.5, 0.0, 0.5].map(|px| {
        let (semi_major_px, semi_minor_px) = (rim.semi_major_px + px, rim.semi_minor_px + px);
        levels_along::<POINTS>(frame, &Ellipse { semi_major_px, semi_minor_px, ..*rim })
    });
    std::array::from_fn(|i: usize| 0.25 * (inside[i] + outside[i]) + 0.5 * at[i])
}

/// Scalar product with eight partial sums.
fn dot(one: &[f32; POINTS], other: &[f32; POINTS]) -> f32 {
    let mut sums = [0.0; 8];
    for (one, other) in one.chunks_exact(8).zip(other.chunks_exact(8)) {
        (0..8).for_each(|i| sums[i] += one[i] * other[i]);
    }
    sums.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::PixelPoint;

    /// Grey 40 inside of `radius_px(angle)` and outside of a disc of 0.4 of 12 px, edges 1.5 px
    /// wide.
    fn verdict(radius_px: impl Fn(f64) -> f64, hole_px: impl Fn(f64) -> f64) -> Result<(), Reject> {
        let center = PixelPoint { u: 31.3, v: 30.8 };
        let pixel = |index: usize| {
            let (u, v) = ((index % 64) as f64 - center.u, (index / 64) as f64 - center.v);
            let (r, angle) = (u.hypot(v), v.atan2(u));
            let black = |edge_px: f64| ((edge_px - r) / 1.5 + 0.5).clamp(0.0, 1.0);
            (200.0 - 160.0 * (black(radius_px(angle)) - black(hole_px(angle)))).round() as u8
        };
        let pixels: Vec<u8> = (0..64 * 64).map(pixel).collect();
        let frame = Frame::new(&pixels, 64, 64, 64).unwrap();
        let circle = |semi_major_px| Ellipse {
            center,
            semi_major_px,
            semi_minor_px: semi_major_px,
            angle_rad: 0.0,
        };
        check_rims(&frame, &Ring::of_rims(circle(12.0), circle(4.8)), true, 0.0)
    }

    #[test]
    fn circles_pass_and_polygons_gears_and_gaps_are_rejected() {
        assert_eq!(verdict(|_| 12.0, |_| 4.8), Ok(()));
        let harmonic = |px: f64, k: f64, share: f64| {
            move |angle: f64| px * (1.0 + share * (k * angle + 0.3).cos())
        };
        // A small error of centre and shape is accepted.
        assert_eq!(verdict(harmonic(12.0, 1.0, 0.02), harmonic(4.8, 2.0, 0.03)), Ok(()));
        for k in [3.0, 4.0, 5.0, 9.0, 14.0] {
            assert_eq!(verdict(harmonic(12.0, k, 0.04), |_| 4.8), Err(Reject::Outline), "{k}");
        }
        assert_eq!(verdict(|_| 12.0, harmonic(4.8, 4.0, 0.08)), Err(Reject::Outline));
        let gap = |angle: f64| if angle.abs() < 0.15 { 8.0 } else { 12.0 };
        assert_eq!(verdict(gap, |_| 4.8), Err(Reject::Outline));
    }
}
