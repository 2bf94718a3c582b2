//! Whether both rims of a newly found ring are ellipses, told by the grey levels along them.
//!
//! Areas and moments see a shape as a whole: a disc in a square frame, a square hole in a round disc
//! or a gear has those of some ring. Along a rim that is where its ellipse says, every point has the
//! same level; where the true outline lies further out or in, the level is blacker or whiter. With
//! L(t) the level at the ellipse's angle t over the contrast, and its harmonics
//!
//!   L(t) = Σ_k a_k cos kt + b_k sin kt,   h_k² = (a_k² + b_k²) / 2,
//!
//! h₀ is a wrong threshold, h₁ a gradient of the light, h₂ an ellipse slightly off: none of them tells
//! against a roundel. Corners of polygons and gaps stand in h₃ … h₆, the teeth of gears and jagged
//! outlines beyond (by Parseval the variance that is left). Each of the two rests may be as large as
//! noise and paper make it, and no larger.
//!
//! Figures behind the limits (contrast 90 and more, noise to 4, blur 0.5 to 1.1 px): 1,470 rendered
//! roundels have at most 0.021 in h₃ … h₆ and 0.027 beyond, where perspective adds up to 0.056 to large
//! ones; photographed prints have up to 0.04 and 0.02 when small, 0.062 and 0.034 at 50 px on paper
//! that is not flat. Of 240 rings that stood where the renderer had shown something else, all but two
//! exceeded them (`cargo run -p roundel-tests --bin recall`).
//!
//! Only the search asks this, since a track is not lost to a passing shadow.

use std::sync::LazyLock;

use crate::{
    ellipse::Ellipse,
    frame::Frame,
    marker::{Ring, reject::Reject},
};

/// Points along a rim.
const POINTS: usize = 64;
/// Harmonics that tell corners and gaps.
const LOW: std::ops::Range<usize> = 3..7;
/// Largest h₃ … h₆ together: a share of the contrast, grey levels, and a share for each pixel of the
/// longer semiaxis, since the same bend of the paper is more pixels there.
const LOW_LIMIT: (f64, f64, f64) = (0.03, 0.9, 0.001);
/// Largest rest beyond them, in the same way.
const HIGH_LIMIT: (f64, f64, f64) = (0.035, 1.5, 0.0005);

/// cos and sin of the points' angles.
static TURN: LazyLock<[(f64, f64); POINTS]> = LazyLock::new(|| {
    std::array::from_fn(|point| {
        let (sin, cos) = (std::f64::consts::TAU * point as f64 / POINTS as f64).sin_cos();
        (cos, sin)
    })
});

/// That the outer rim is an ellipse, and the inner one where its disc is a plain one.
pub(crate) fn check_rims(frame: &Frame, ring: &Ring, plain: bool) -> Result<(), Reject> {
    let contrast = (ring.white - ring.black).abs();
    let inner = plain.then_some(&ring.inner);
    for rim in std::iter::once(&ring.outer).chain(inner) {
        let (low, high) = Rest::of(&levels_along(frame, rim)).shares(contrast);
        let limit = |(share, levels, per_px): (f64, f64, f64)| {
            share + levels / contrast + per_px * rim.semi_major_px
        };
        // Not numbers where there is no contrast.
        if !(low <= limit(LOW_LIMIT) && high <= limit(HIGH_LIMIT)) {
            return Err(Reject::Outline);
        }
    }
    Ok(())
}

/// Grey levels along an ellipse, at even steps of its angle.
pub(super) fn levels_along(frame: &Frame, rim: &Ellipse) -> [f64; POINTS] {
    let (sin_tilt, cos_tilt) = rim.angle_rad.sin_cos();
    std::array::from_fn(|point| {
        let (cos, sin) = TURN[point];
        let (x, y) = (rim.semi_major_px * cos, rim.semi_minor_px * sin);
        let u = rim.center.u + x * cos_tilt - y * sin_tilt;
        let v = rim.center.v + x * sin_tilt + y * cos_tilt;
        level_at(frame, u, v)
    })
}

/// Grey level between the pixels, bilinear.
fn level_at(frame: &Frame, u: f64, v: f64) -> f64 {
    let (u, v) =
        (u.clamp(0.0, (frame.width() - 1) as f64), v.clamp(0.0, (frame.height() - 1) as f64));
    let (left, top) = (u as usize, v as usize);
    let (right, bottom) = ((left + 1).min(frame.width() - 1), (top + 1).min(frame.height() - 1));
    let (du, dv) = (u - left as f64, v - top as f64);
    let row = |v: usize| {
        let row = frame.row(v);
        let (left, right) = (f64::from(row[left]), f64::from(row[right]));
        left + (right - left) * du
    };
    row(top) + (row(bottom) - row(top)) * dv
}

/// Variances of levels, by harmonics.
#[derive(Clone, Copy, Debug)]
struct Rest {
    low: f64,
    high: f64,
}

impl Rest {
    fn of(levels: &[f64; POINTS]) -> Self {
        let n = POINTS as f64;
        let mean = levels.iter().sum::<f64>() / n;
        let whole = levels.iter().map(|level| (level - mean).powi(2)).sum::<f64>() / n;
        let variance = |k: usize| {
            let (mut along, mut across) = (0.0, 0.0);
            for (point, level) in levels.iter().enumerate() {
                let (cos, sin) = TURN[point * k % POINTS];
                along += level * cos;
                across += level * sin;
            }
            2.0 * (along * along + across * across) / (n * n)
        };
        let low = LOW.map(variance).sum::<f64>();
        let high = (whole - variance(1) - variance(2) - low).max(0.0);
        Self { low, high }
    }

    /// Rms as shares of the contrast.
    fn shares(self, contrast: f64) -> (f64, f64) {
        (self.low.sqrt() / contrast, self.high.sqrt() / contrast)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::PixelPoint;

    /// Grey 40 inside of `radius_px(angle)` and outside of a disc of 0.4 of 12 px, edges 1.5 px soft.
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
        check_rims(&frame, &Ring::of_rims(circle(12.0), circle(4.8)), true)
    }

    #[test]
    fn circles_pass_and_polygons_gears_and_gaps_do_not() {
        assert_eq!(verdict(|_| 12.0, |_| 4.8), Ok(()));
        let harmonic = |px: f64, k: f64, share: f64| {
            move |angle: f64| px * (1.0 + share * (k * angle + 0.3).cos())
        };
        // A little off in place and shape is no fault.
        assert_eq!(verdict(harmonic(12.0, 1.0, 0.02), harmonic(4.8, 2.0, 0.03)), Ok(()));
        for k in [3.0, 4.0, 5.0, 9.0, 14.0] {
            assert_eq!(verdict(harmonic(12.0, k, 0.04), |_| 4.8), Err(Reject::Outline), "{k}");
        }
        assert_eq!(verdict(|_| 12.0, harmonic(4.8, 4.0, 0.08)), Err(Reject::Outline));
        let gap = |angle: f64| if angle.abs() < 0.15 { 8.0 } else { 12.0 };
        assert_eq!(verdict(gap, |_| 4.8), Err(Reject::Outline));
    }
}
