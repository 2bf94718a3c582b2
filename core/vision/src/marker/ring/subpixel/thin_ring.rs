//! Black level of a ring so thin that the blur of its rims reaches all of its pixels.
//!
//! The share of white in a pixel depends on its distances d_o and d_i from both rims. For nearly straight rims the level is
//! B + (W - B) x, x = Φ(-d_o/σ) + Φ(-d_i/σ). Means over the pixels around the middle, where x is smallest,
//! each weighted by 1 - |d_o - d_i|/2h, give B = (Ī - x̄ W)/(1 - x̄).
//!
//! The distance from the ellipse q(x) = 1, q(x)² = xᵀ M⁻¹ x, is (q - 1)/|∇q| to first order.

use fearless_simd::Simd;
use fearless_simd_macros::simd;

use crate::{
    marker::ring::pixels::{ellipse_mask::RimEllipse, patch::WORD_PX},
    scratch::reserve_total,
};

/// h: half width of the weights about the middle, pixels.
const HALF_WIDTH_PX: f32 = 1.0;
/// Largest share of white in the black.
const MAX_MIXED: f64 = 0.4;

/// Pixels processed together.
const LANES: usize = 16;

/// Largest number of black pixels across a thin ring.
const MAX_ACROSS: usize = 8;

/// Black pixels.
#[derive(Clone, Copy, Debug, Default)]
struct RimDistances16 {
    /// Distances from the outer and the inner rim, pixels; initially the pixels' positions.
    outer_px: [f32; LANES],
    inner_px: [f32; LANES],
    grey: [f32; LANES],
    weight: [f32; LANES],
}

/// Pixels of the whole roundel and of its white disc.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ThinPixels<'a> {
    pub grey: &'a [[u8; WORD_PX]],
    pub whole: &'a [u64],
    pub white: &'a [u64],
    pub words: usize,
    /// Column and row of the first pixel in the frame.
    pub first: (usize, usize),
}

/// The black pixels of a thin ring, with their distances from the rims.
#[derive(Debug, Default)]
pub(crate) struct RimDistances {
    distances: Vec<RimDistances16>,
}

impl RimDistances {
    /// Reserves memory for the largest thin ring of a frame.
    pub fn reserve(&mut self, width: usize, height: usize) {
        reserve_total(&mut self.distances, 2 * (width + height) * MAX_ACROSS / LANES);
    }

    /// Collects the pixels of the whole roundel that are not in the white disc.
    #[simd]
    pub fn measure<S: Simd>(
        simd: S,
        Self { distances }: &mut Self,
        pixels: &ThinPixels,
        outer: &RimEllipse,
        inner: &RimEllipse,
    ) {
        let _ = simd;
        distances.clear();
        let ThinPixels { grey, whole, white, words, first } = *pixels;
        let mut pixels = RimDistances16::default();
        let mut lane = 0;
        for (at, (grey, (whole, white))) in grey.iter().zip(whole.iter().zip(white)).enumerate() {
            let mut bits = whole & !white;
            let (row, word) = (at / words, at % words);
            while bits != 0 {
                let column = bits.trailing_zeros() as usize;
                bits &= bits - 1;
                pixels.outer_px[lane] = (word * WORD_PX + column) as f32;
                pixels.inner_px[lane] = row as f32;
                pixels.grey[lane] = f32::from(grey[column]);
                pixels.weight[lane] = 1.0;
                lane += 1;
                if lane == LANES {
                    distances.push(pixels);
                    (pixels, lane) = (RimDistances16::default(), 0);
                }
            }
        }
        distances.push(pixels);
        let (outer, inner) = (Rim::new(outer, first), Rim::new(inner, first));
        for pixels in distances {
            for lane in 0..LANES {
                let at = (pixels.outer_px[lane], pixels.inner_px[lane]);
                let (outer_px, inner_px) = (-outer.distance_px(at), inner.distance_px(at));
                let weight = 1.0 - (outer_px - inner_px).abs() / (2.0 * HALF_WIDTH_PX);
                pixels.outer_px[lane] = outer_px;
                pixels.inner_px[lane] = inner_px;
                pixels.weight[lane] *= weight.max(0.0);
            }
        }
    }

    /// B, for this white level, rims (outer, inner) grown by `grown_px` and this blur. NaN without
    /// pixels.
    #[simd]
    pub fn level<S: Simd>(
        simd: S,
        Self { distances }: &Self,
        white: f64,
        grown_px: (f64, f64),
        blur_px: f64,
    ) -> f64 {
        let _ = simd;
        let scale = (1.0 / blur_px) as f32;
        let (by_outer, by_inner) = (grown_px.0 as f32, -grown_px.1 as f32);
        let [mut weights, mut greys, mut mixed] = [[0.0f32; LANES]; 3];
        for pixels in distances {
            for lane in 0..LANES {
                let weight = pixels.weight[lane];
                let share = tail((pixels.outer_px[lane] + by_outer) * scale)
                    + tail((pixels.inner_px[lane] + by_inner) * scale);
                weights[lane] += weight;
                greys[lane] += weight * pixels.grey[lane];
                mixed[lane] += weight * share;
            }
        }
        let sum = |lanes: &[f32; LANES]| f64::from(lanes.iter().sum::<f32>());
        let (weights, greys, mixed) = (sum(&weights), sum(&greys), sum(&mixed));
        let mixed = (mixed / weights).min(MAX_MIXED);
        (greys / weights - mixed * white) / (1.0 - mixed)
    }
}

/// Φ(-z), to 1e-3: a logistic curve of z³ and z (Bowling and others 2009), with eʸ as (1 +
/// y/1024)^1024, which vectorizes.
#[inline(always)]
fn tail(z: f32) -> f32 {
    let y = z * (1.5976 + 0.070_56 * z * z);
    let mut power = (1.0 + y * (1.0 / 1024.0)).max(0.0);
    for _ in 0..10 {
        power *= power;
    }
    1.0 / (1.0 + power)
}

/// A rim for distances.
#[derive(Clone, Copy)]
struct Rim {
    /// Centre, pixels from the first one.
    u: f32,
    v: f32,
    /// M⁻¹.
    uu: f32,
    uv: f32,
    vv: f32,
}

impl Rim {
    fn new(RimEllipse { ellipse, matrix }: &RimEllipse, first: (usize, usize)) -> Self {
        let scale = 1.0 / matrix.determinant();
        Self {
            u: (ellipse.center.u - first.0 as f64) as f32,
            v: (ellipse.center.v - first.1 as f64) as f32,
            uu: (scale * matrix.vv) as f32,
            uv: (-scale * matrix.uv) as f32,
            vv: (scale * matrix.uu) as f32,
        }
    }

    /// Positive outside.
    #[inline(always)]
    fn distance_px(&self, (u, v): (f32, f32)) -> f32 {
        let (x, y) = (u - self.u, v - self.v);
        let (gx, gy) = (self.uu * x + self.uv * y, self.uv * x + self.vv * y);
        let squared = x * gx + y * gy;
        (squared - squared.sqrt()) / (gx * gx + gy * gy).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tail_is_that_of_the_normal_distribution() {
        for (z, valid) in [(0.0, 0.5), (0.5, 0.308_538), (1.0, 0.158_655), (2.0, 0.022_750)] {
            assert!((tail(z) - valid).abs() < 1e-3, "{z}: {}", tail(z));
            assert!((tail(-z) - (1.0 - valid)).abs() < 1e-3, "{z}: {}", tail(-z));
        }
        assert!(tail(40.0) == 0.0 && tail(-40.0) == 1.0);
    }
}
