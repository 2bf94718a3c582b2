//! The black level of a ring so thin that the blur of its rims reaches every pixel of it.
//!
//! How much of white a pixel holds depends on where it lies, so each of the ring is asked for its
//! distances d_o and d_i from both rims. For rims that are nearly straight the light there is
//! B + (W - B) x, x = Φ(-d_o/σ) + Φ(-d_i/σ). Means over the pixels round the middle, where x is least,
//! each weighted by 1 - |d_o - d_i|/2h, give B = (Ī - x̄ W)/(1 - x̄).
//!
//! The distance from the ellipse q(x) = 1, q(x)² = xᵀ M⁻¹ x, is (q - 1)/|∇q| to first order.

use crate::{
    camera::PixelPoint,
    ellipse::Symmetric2,
    marker::{blur::Weighed, patch::WORD_PX},
};

/// h: how far from the middle pixels count, pixels.
const HALF_WIDTH_PX: f32 = 1.0;
/// Largest share of white that the black is taken to hold.
const MOST_MIXED: f64 = 0.4;

/// A pixel of the black.
#[derive(Clone, Copy, Debug)]
struct Depth {
    /// Distances from the outer and the inner rim, pixels.
    outer_px: f32,
    inner_px: f32,
    grey: f32,
    weight: f32,
}

/// The black pixels of a thin ring.
#[derive(Debug, Default)]
pub(crate) struct Depths {
    depths: Vec<Depth>,
}

impl Depths {
    /// Those that `sets` says of rows of the frame, the first of them `first.1`, its columns from
    /// `first.0` on.
    pub fn measure(
        &mut self,
        (grey, sets, words): (&[[u8; WORD_PX]], impl Iterator<Item = u64>, usize),
        first: (usize, usize),
        (outer, inner): (&Weighed, &Weighed),
    ) {
        self.depths.clear();
        let (outer, inner) = (Rim::new(outer), Rim::new(inner));
        for (at, (grey, mut bits)) in grey.iter().zip(sets).enumerate() {
            let (row, word) = (at / words, at % words);
            while bits != 0 {
                let column = bits.trailing_zeros() as usize;
                bits &= bits - 1;
                let u = (first.0 + word * WORD_PX + column) as f64;
                let v = (first.1 + row) as f64;
                let outer_px = -outer.distance_px(u, v) as f32;
                let inner_px = inner.distance_px(u, v) as f32;
                let weight = 1.0 - (outer_px - inner_px).abs() / (2.0 * HALF_WIDTH_PX);
                if weight > 0.0 {
                    let grey = f32::from(grey[column]);
                    self.depths.push(Depth { outer_px, inner_px, grey, weight });
                }
            }
        }
    }

    /// B, if white has this level, the rims are further out by so much (outer, inner) and the blur has
    /// this deviation. Not a number without pixels.
    pub fn level(&self, white: f64, grown_px: (f64, f64), blur_px: f64) -> f64 {
        let scale = (1.0 / blur_px) as f32;
        let (by_outer, by_inner) = (grown_px.0 as f32, -grown_px.1 as f32);
        let [mut weights, mut greys, mut mixed] = [0.0; 3];
        for depth in &self.depths {
            let share = tail((depth.outer_px + by_outer) * scale)
                + tail((depth.inner_px + by_inner) * scale);
            weights += depth.weight;
            greys += depth.weight * depth.grey;
            mixed += depth.weight * share;
        }
        let mixed = f64::from(mixed / weights).min(MOST_MIXED);
        (f64::from(greys / weights) - mixed * white) / (1.0 - mixed)
    }
}

/// Φ(-z), to 1e-4 (Bowling and others 2009, a logistic curve of z³ and z).
fn tail(z: f32) -> f32 {
    1.0 / (1.0 + (z * (1.5976 + 0.070_56 * z * z)).exp())
}

/// A rim to take distances from.
struct Rim {
    center: PixelPoint,
    /// M⁻¹.
    inverse: Symmetric2,
}

impl Rim {
    fn new(rim: &Weighed) -> Self {
        let matrix = rim.shape.matrix_of(&rim.rim);
        let scale = 1.0 / matrix.determinant();
        let inverse =
            Symmetric2 { uu: scale * matrix.vv, uv: -scale * matrix.uv, vv: scale * matrix.uu };
        Self { center: rim.shape.center, inverse }
    }

    /// Positive outside.
    fn distance_px(&self, u: f64, v: f64) -> f64 {
        let (x, y) = (u - self.center.u, v - self.center.v);
        let m = &self.inverse;
        let (gx, gy) = (m.uu * x + m.uv * y, m.uv * x + m.vv * y);
        let q = (x * gx + y * gy).sqrt();
        (q - 1.0) * q / (gx * gx + gy * gy).sqrt()
    }
}
