//! Grey levels of a roundel's parts, and their gradient.
//!
//! Black, disc and margin each have a level, the mean over pixels that the blur of the rims hardly
//! reaches ([`crate::marker::ring::pixels::edge_band`]). The margin's is used if nothing else lies there; otherwise it is
//! assumed to be as white as the disc.
//!
//! Under a lighting gradient γ, weights rise by γ·x / contrast on one side of a rim and fall on
//! the other, which preserves the area but shifts the centre: for a disc with the area A and the matrix M
//! ([`crate::ellipse::Ellipse::matrix`]), whose band has n pixels and thus the second moments n M / 2, by
//! n M γ / (2 A contrast); for the roundel, whose weights are those of black, in the opposite direction.
//!
//! Pixels in a ring similar to the rim and ρ times as large lie at ρ √M_uu cos t along u, so the means
//! of its right and left halves differ by Δ_u = (4/π) ρ (M γ)_u / √M_uu. That gives M γ directly,
//! for any angle of the ellipse.

use fearless_simd::Simd;
use fearless_simd_macros::simd;

use crate::{
    camera::PixelPoint,
    marker::ring::{
        pixels::{
            edge_band::{EdgeBands, pixels_in},
            patch::WORD_PX,
        },
        subpixel::{
            blur::WeighedRim,
            moments::{GreySum, count, levels, total},
        },
    },
    simd::Lane,
};

/// Limit of the margin's fall outwards: a share of the contrast, plus grey levels …
pub(crate) const MARGIN_FALL: (f64, f64) = (0.012, 0.6);
/// … and of its deviation, likewise.
pub(crate) const MARGIN_DEVIATION: (f64, f64) = (0.1, 3.0);
/// Smallest level of the margin two or three pixels from the rim, as a share of the contrast, for a
/// margin wider than that.
const NEAR_MARGIN: f64 = 0.5;
/// Sum of squared differences due to noise alone, grey levels squared.
const NOISE_SQUARES: f64 = 1.0;

/// Differences of the means of two halves, grey levels: along u and v.
pub(crate) type Slope<T = f64> = (T, T);

/// Pixels of a set: all, those before a column, and those in the first words.
#[inline(always)]
fn pixels(set: &[u64], words: usize, column: usize, first: usize) -> [u32; 3] {
    let (all, left) = count(set, words, column);
    [all, left, pixels_in(&set[..first])]
}

/// Right minus left and bottom minus top, from pixels and sums of all, the left and the top ones.
#[inline(always)]
fn slope(pixels: &[u32; 3], sums: &[u64; 3]) -> Slope {
    let half = |half: usize| {
        let first = GreySum { pixels: pixels[half], sum: sums[half] };
        let other = GreySum { pixels: pixels[0] - pixels[half], sum: sums[0] - sums[half] };
        other.mean() - first.mean()
    };
    (half(1), half(2))
}

/// Levels of a roundel's parts.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Levels {
    pub disc: GreySum,
    pub black: GreySum,
    near: GreySum,
    far: GreySum,
    /// Σ I² over `far`.
    far_square: u64,
    /// Slopes of black and margin.
    slopes: (Slope, Slope),
}

impl Levels {
    /// Halves are split at column `middle.0` of the patch, which is even, and at row `middle.1` of
    /// the bands.
    #[simd]
    pub fn new<S: Simd>(
        simd: S,
        grey: &[[u8; WORD_PX]],
        bands: &EdgeBands,
        words: usize,
        middle: (usize, usize),
    ) -> Self {
        let (top, bottom) = grey.split_at(middle.1 * words);
        let sets = [bands.disc_core, bands.black, bands.near, bands.far];
        let upper = levels(simd, top, sets, words, middle.0);
        let lower = levels(simd, bottom, sets.map(|set| &set[top.len()..]), words, middle.0);
        let first = top.len();
        let of_black = pixels(bands.black, words, middle.0, first);
        let of_near = pixels(bands.near, words, middle.0, first);
        let of_far = pixels(bands.far, words, middle.0, first);
        let near = total(upper.all[2] + lower.all[2]);
        let far = total(upper.all[3] + lower.all[3]);
        let black = [
            total(upper.all[1] + lower.all[1]),
            total(upper.left[1] + lower.left[1]),
            total(upper.all[1]),
        ];
        let margin = [
            near + far,
            total((upper.left[2] + lower.left[2]) + (upper.left[3] + lower.left[3])),
            total(upper.all[2] + upper.all[3]),
        ];
        let of_margin = [of_near[0] + of_far[0], of_near[1] + of_far[1], of_near[2] + of_far[2]];
        Self {
            disc: GreySum {
                pixels: pixels_in(bands.disc_core),
                sum: total(upper.all[0] + lower.all[0]),
            },
            black: GreySum { pixels: of_black[0], sum: black[0] },
            near: GreySum { pixels: of_near[0], sum: near },
            far: GreySum { pixels: of_far[0], sum: far },
            far_square: total(upper.square + lower.square),
            slopes: (slope(&of_black, &black), slope(&of_margin, &margin)),
        }
    }

    /// The margin's level, if nothing but margin lies beside the band: its level does not fall
    /// outwards, and varies little.
    #[inline(always)]
    pub fn margin(&self) -> Option<GreySum> {
        let contrast = self.disc.mean() - self.black.mean();
        let (near, far) = (self.near.mean(), self.far.mean());
        let variance = self.far_square as f64 / f64::from(self.far.pixels) - far * far;
        let limit = (MARGIN_DEVIATION.0 * contrast).powi(2) + MARGIN_DEVIATION.1.powi(2);
        let falls = near - far > MARGIN_FALL.0 * contrast + MARGIN_FALL.1;
        // False for NaN, without pixels. If it falls at all, the blur of the margin's outer edge
        // may reach `far`.
        let level = if near > far { self.near } else { self.near.joined(self.far) };
        (variance <= limit && !falls).then_some(level)
    }

    /// Whether the margin is wide enough to keep the blur of its outer edge out of the rim's.
    pub fn has_near_margin(&self) -> bool {
        let (black, white) = (self.black.mean(), self.disc.mean());
        self.near.mean() - black > NEAR_MARGIN * (white - black)
    }

    /// Shift of the centres of outer and inner rim by the lighting gradient, from the pixels in
    /// their bands.
    #[inline(always)]
    pub fn movement(
        &self,
        (outer, inner): (&WeighedRim, &WeighedRim),
        (of_outer, of_inner): (u32, u32),
        contrast: f64,
    ) -> (PixelPoint, PixelPoint) {
        let (r_o, r_i) = (outer.rim.mean_radius_px(), inner.rim.mean_radius_px());
        let gradient = gradient(self.slopes, (r_o, r_i));
        let moved = |weighed: &WeighedRim, radius_px: f64, pixels: u32, contrast: f64| {
            let matrix = weighed.shape.matrix_of(&weighed.rim);
            let scale = f64::from(pixels) * radius_px / (contrast * weighed.shape.area_px2);
            PixelPoint {
                u: scale * matrix.uu.sqrt() * gradient.0,
                v: scale * matrix.vv.sqrt() * gradient.1,
            }
        };
        (moved(outer, r_o, of_outer, -contrast), moved(inner, r_i, of_inner, contrast))
    }
}

/// Half the gradient's product with a rim's matrix, as a share of √M_uu and √M_vv and of the rim's
/// radius: γ/2 for a circle. From the slopes of black and margin, and the radii of both rims.
#[inline(always)]
pub(crate) fn gradient<T: Lane>((b, m): (Slope<T>, Slope<T>), (r_o, r_i): (T, T)) -> (T, T) {
    // Radii of the pixels of black and margin.
    let (black_px, margin_px) = ((r_o + r_i) * 0.5, r_o + MARGIN_PX);
    let squares = b.0 * b.0 + b.1 * b.1 + m.0 * m.0 + m.1 * m.1;
    // Attenuates slopes of the size of noise; zero for NaN.
    let sure = squares / (squares + NOISE_SQUARES);
    let is_number = sure.at_most(sure);
    let scale = sure * (0.25 * std::f64::consts::FRAC_PI_4);
    let none = scale.splat(0.0);
    let along = (b.0 / black_px + m.0 / margin_px, b.1 / black_px + m.1 / margin_px);
    (T::choose(is_number, scale * along.0, none), T::choose(is_number, scale * along.1, none))
}

/// Distance of the margin's pixels from the outer rim.
const MARGIN_PX: f64 = 3.3;
