//! Whether the outer rim is complete.
//!
//! Moments see a rim as a whole: a neighbouring sheet that covers a little of it shifts them by a
//! fraction of a pixel, too little for the tests of shape and many times more than the pose's
//! covariance allows for. Along a correct rim, every point has the level halfway between black and white; where the rim
//! is covered, the level is one or the other.
//!
//! The pose adds this unevenness to its covariance. It is the rms over the rim of (level - mean level) / contrast,
//! without its first harmonic, which is that of a lighting gradient. With M = L Lᵀ (Cholesky) of the rim's matrix,
//! c + L (cos t, sin t) runs along the rim as evenly as along the circle, without an angle.

use fearless_simd::{Simd, f32x16, prelude::*};
use fearless_simd_macros::simd;

use crate::{
    camera::PixelPoint,
    ellipse::Symmetric2,
    frame::{Frame, Window},
    marker::{
        reject::Reject,
        ring::pixels::patch::{Patch, WORD_PX},
    },
};

/// Points along the rim.
const POINTS: usize = 32;
/// Beyond this share too much of the rim is covered.
const MAX_UNEVENNESS: f64 = 0.25;

/// The pixels around a rim.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RimPixels<'a> {
    /// From the window's first pixel on.
    grey: &'a [u8],
    stride: usize,
    window: Window,
}

impl<'a> RimPixels<'a> {
    /// The pixels of a patch.
    pub fn of(patch: &'a Patch) -> Self {
        // A row's words are contiguous.
        let (grey, stride) = (patch.grey.as_flattened(), patch.words * WORD_PX);
        Self { grey, stride, window: patch.window }
    }

    /// The pixels of a frame's window. The polarity does not affect the unevenness.
    pub fn within(frame: &Frame<'a>, window: Window) -> Self {
        let (pixels, stride) = frame.pixels();
        Self { grey: &pixels[window.top * stride + window.left..], stride, window }
    }
}

/// The unevenness ([`deviation`]) of the rim with this centre and
/// [`crate::ellipse::Ellipse::matrix`], or a rejection if it is covered.
///
/// Complete rendered rings (contrast 120, noise 2) have 0.011, at most 0.017 of 3,000, which is two
/// thirds of the noise's share of the contrast. Prints on bent paper or after JPEG have up to 0.09;
/// rings partly covered by a neighbouring sheet have 0.03 to 0.23.
#[simd]
pub(crate) fn unevenness<S: Simd>(
    simd: S,
    pixels: &RimPixels,
    center: PixelPoint,
    matrix: &Symmetric2,
    contrast: f64,
) -> Result<f64, Reject> {
    let uneven = deviation(simd, &levels(simd, pixels, center, matrix)) / contrast;
    // False for NaN, without contrast.
    if uneven <= MAX_UNEVENNESS { Ok(uneven) } else { Err(Reject::Covered) }
}

/// cos(k π/16) for k = 0..=8; the rest of the circle follows by symmetry.
const QUARTER: [f32; 9] = [
    1.0,
    0.980_785_25,
    0.923_879_5,
    0.831_469_6,
    std::f32::consts::FRAC_1_SQRT_2,
    0.555_570_24,
    0.382_683_43,
    0.195_090_32,
    0.0,
];

const fn circle(quarter_turns_back: usize) -> [f32; POINTS] {
    let mut cosines = [0.0; POINTS];
    let mut point = 0;
    while point < POINTS {
        let k = (point + POINTS - quarter_turns_back * POINTS / 4) % POINTS;
        cosines[point] = match k {
            0..=8 => QUARTER[k],
            9..=16 => -QUARTER[16 - k],
            17..=24 => -QUARTER[k - 16],
            _ => QUARTER[32 - k],
        };
        point += 1;
    }
    cosines
}

/// At the points of the circle.
const COS: [f32; POINTS] = circle(0);
const SIN: [f32; POINTS] = circle(1);

/// Half of the points' cosines or sines.
#[inline(always)]
fn half<S: Simd>(simd: S, values: &[f32; POINTS], half: usize) -> f32x16<S> {
    f32x16::from_slice(simd, &values[half * 16..half * 16 + 16])
}

/// GreySum levels along the rim, bilinear between pixels.
#[simd]
fn levels<S: Simd>(
    simd: S,
    pixels: &RimPixels,
    center: PixelPoint,
    matrix: &Symmetric2,
) -> [f32x16<S>; 2] {
    let along_u = matrix.uu.sqrt() as f32;
    let shear = matrix.uv as f32 / along_u;
    let along_v = (matrix.vv as f32 - shear * shear).max(0.0).sqrt();
    let RimPixels { grey, stride, window } = *pixels;
    let center_u = (center.u - window.left as f64) as f32;
    let center_v = (center.v - window.top as f64) as f32;
    let zero = f32x16::splat(simd, 0.0);
    let last_u = f32x16::splat(simd, window.width().saturating_sub(2) as f32);
    let last_v = f32x16::splat(simd, window.height().saturating_sub(2) as f32);
    let mut levels = [zero; 2];
    for (part, level) in levels.iter_mut().enumerate() {
        let (cos, sin) = (half(simd, &COS, part), half(simd, &SIN, part));
        let u = (cos * along_u + center_u).max(zero).min(last_u);
        let v = (cos * shear + sin * along_v + center_v).max(zero).min(last_v);
        let (column, row) = (u.floor(), v.floor());
        // Both pixels of a row at once, the right one in the high byte.
        let [mut above, mut below] = [[0u16; 16]; 2];
        for point in 0..16 {
            let at = row[point] as u32 as usize * stride + column[point] as u32 as usize;
            let pair = |at: usize| u16::from_le_bytes([grey[at], grey[at + 1]]);
            (above[point], below[point]) = (pair(at), pair(at + stride));
        }
        let low = |pairs: &[u16; 16]| f32x16::from_fn(simd, |point| f32::from(pairs[point] as u8));
        let high = |pairs: &[u16; 16]| f32x16::from_fn(simd, |point| f32::from(pairs[point] >> 8));
        let (du, dv) = (u - column, v - row);
        let (upper, lower) = (low(&above), low(&below));
        let upper = (high(&above) - upper).mul_add(du, upper);
        let lower = (high(&below) - lower).mul_add(du, lower);
        *level = (lower - upper).mul_add(dv, upper);
    }
    levels
}

/// Rms deviation of the levels from their mean, without the first harmonic.
#[simd]
fn deviation<S: Simd>(simd: S, levels: &[f32x16<S>; 2]) -> f64 {
    let mean = (levels[0] + levels[1]).reduce_sum() / POINTS as f32;
    let zero = f32x16::splat(simd, 0.0);
    let [mut squares, mut along, mut across] = [zero; 3];
    for (part, &level) in levels.iter().enumerate() {
        let level = level - mean;
        squares += level * level;
        along += level * half(simd, &COS, part);
        across += level * half(simd, &SIN, part);
    }
    let n = POINTS as f64;
    let (squares, along, across) = (
        f64::from(squares.reduce_sum()) / n,
        f64::from(along.reduce_sum()) / n,
        f64::from(across.reduce_sum()) / n,
    );
    // Parseval: the mean square minus that of the first harmonic.
    (squares - 2.0 * (along * along + across * across)).max(0.0).sqrt()
}
