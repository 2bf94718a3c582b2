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
    marker::ring::{
        pixels::{
            edge_band::{EdgeBands, WIDE_PX, pixels_in},
            patch::WORD_PX,
        },
        subpixel::moments::{count, levels, total},
        weighed_rim::WeighedRim,
    },
    simd::Lane,
};

/// Limit of the margin's fall outwards: a share of the contrast, plus grey levels …
const MARGIN_FALL: (f64, f64) = (0.012, 0.6);
/// … and of its deviation, likewise.
const MARGIN_DEVIATION: (f64, f64) = (0.1, 3.0);
/// Smallest level of the margin two or three pixels from the rim, as a share of the contrast, for a
/// margin wider than that.
const NEAR_MARGIN: f64 = 0.5;
/// Sum of squared differences due to noise alone, grey levels squared.
const NOISE_SQUARES: f64 = 1.0;

/// Differences of the means of two halves, grey levels: along u and v.
type Slope<T> = (T, T);

/// Sum and number of the pixels of a set, or of its left or upper half.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PartSum<T> {
    pub sum: T,
    pub pixels: T,
}

impl<T: Lane> PartSum<T> {
    /// NaN without pixels.
    #[inline(always)]
    fn mean(&self) -> T {
        self.sum / self.pixels
    }

    /// Mean of the rest minus that of `half`.
    #[inline(always)]
    fn slope(&self, half: &Self) -> T {
        (self.sum - half.sum) / (self.pixels - half.pixels) - half.mean()
    }
}

impl PartSum<f64> {
    fn of(sum: u64, pixels: u32) -> Self {
        Self { sum: sum as f64, pixels: f64::from(pixels) }
    }
}

/// Sums over the parts of a roundel, each exact.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PartSums<T> {
    pub disc: PartSum<T>,
    pub black: PartSum<T>,
    pub black_left: PartSum<T>,
    pub black_top: PartSum<T>,
    pub near: PartSum<T>,
    pub far: PartSum<T>,
    /// Σ I² over `far`.
    pub far_square: T,
    /// Halves of `near` and `far` together.
    pub margin_left: PartSum<T>,
    pub margin_top: PartSum<T>,
}

impl PartSums<f64> {
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
        // Neither vectors nor bit counts may pass through `array::map`, which is compiled for the
        // baseline processor.
        let disc = total(upper.all[0] + lower.all[0]);
        let black = total(upper.all[1] + lower.all[1]);
        let near = total(upper.all[2] + lower.all[2]);
        let far = total(upper.all[3] + lower.all[3]);
        let black_left = total(upper.left[1] + lower.left[1]);
        let margin_left = total((upper.left[2] + lower.left[2]) + (upper.left[3] + lower.left[3]));
        let of_black = pixels(bands.black, words, middle.0, top.len());
        let of_near = pixels(bands.near, words, middle.0, top.len());
        let of_far = pixels(bands.far, words, middle.0, top.len());
        Self {
            disc: PartSum::of(disc, pixels_in(bands.disc_core)),
            black: PartSum::of(black, of_black[0]),
            black_left: PartSum::of(black_left, of_black[1]),
            black_top: PartSum::of(total(upper.all[1]), of_black[2]),
            near: PartSum::of(near, of_near[0]),
            far: PartSum::of(far, of_far[0]),
            far_square: total(upper.square + lower.square) as f64,
            margin_left: PartSum::of(margin_left, of_near[1] + of_far[1]),
            margin_top: PartSum::of(total(upper.all[2] + upper.all[3]), of_near[2] + of_far[2]),
        }
    }
}

/// Pixels of a set: all, those before a column, and those in the first words.
#[inline(always)]
fn pixels(set: &[u64], words: usize, column: usize, first: usize) -> [u32; 3] {
    let (all, left) = count(set, words, column);
    [all, left, pixels_in(&set[..first])]
}

/// A level, and its distance from a rim.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LevelSample<T> {
    pub level: T,
    pub pixels: T,
    pub distance_px: f64,
}

impl<T: Lane> LevelSample<T> {
    #[inline(always)]
    fn new(part: &PartSum<T>, distance_px: f64) -> Self {
        Self { level: part.mean(), pixels: part.pixels, distance_px }
    }
}

/// Levels of black, disc and margin; `None` if the margin is assumed to be as white as the disc.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LevelSamples<T> {
    pub black: LevelSample<T>,
    pub white: LevelSample<T>,
    pub margin: Option<LevelSample<T>>,
}

/// Levels of a roundel's parts.
#[derive(Clone, Copy)]
pub(crate) struct Levels<T: Lane> {
    pub black: LevelSample<T>,
    pub white: LevelSample<T>,
    pub margin: LevelSample<T>,
    /// Whether nothing but margin lies beside the band: its level does not fall outwards, and
    /// varies little.
    pub is_margin: T::Mask,
    /// Level of the margin next to the band.
    near: T,
    /// Slopes of black and margin.
    slopes: (Slope<T>, Slope<T>),
}

impl<T: Lane> Levels<T> {
    /// With the distances of the disc's core and of the black from their rims.
    #[inline(always)]
    pub fn new(parts: &PartSums<T>, core_px: f64, black_px: f64) -> Self {
        let PartSums { disc, black, near, far, .. } = parts;
        let contrast = disc.mean() - black.mean();
        let far_mean = far.mean();
        let variance = parts.far_square / far.pixels - far_mean * far_mean;
        let limit = (contrast * MARGIN_DEVIATION.0).squared() + MARGIN_DEVIATION.1.powi(2);
        let fall = near.mean() - far_mean;
        let falls = (contrast * MARGIN_FALL.0 + MARGIN_FALL.1).below(fall);
        let both = PartSum { sum: near.sum + far.sum, pixels: near.pixels + far.pixels };
        // If it falls at all, the blur of the margin's outer edge may reach `far`.
        let is_near = fall.is_positive();
        let margin = PartSum {
            sum: T::choose(is_near, near.sum, both.sum),
            pixels: T::choose(is_near, near.pixels, both.pixels),
        };
        Self {
            black: LevelSample::new(black, black_px),
            white: LevelSample::new(disc, core_px),
            margin: LevelSample::new(&margin, WIDE_PX),
            // False for NaN, without pixels.
            is_margin: variance.at_most(limit) & !falls,
            near: near.mean(),
            slopes: (
                (black.slope(&parts.black_left), black.slope(&parts.black_top)),
                (both.slope(&parts.margin_left), both.slope(&parts.margin_top)),
            ),
        }
    }

    /// Shift of the centres of outer and inner rim by the lighting gradient, from the pixels in
    /// their bands.
    #[inline(always)]
    pub fn movement(
        &self,
        (outer, outer_pixels): (&WeighedRim<T>, T),
        (inner, inner_pixels): (&WeighedRim<T>, T),
    ) -> [(T, T); 2] {
        let contrast = self.white.level - self.black.level;
        let (r_o, r_i) = (outer.rim.mean_radius_px(), inner.rim.mean_radius_px());
        let along = gradient(self.slopes, (r_o, r_i));
        let of_outer = outer_pixels * r_o / (-contrast * outer.area_px2);
        let of_inner = inner_pixels * r_i / (contrast * inner.area_px2);
        [shift(outer, of_outer, along), shift(inner, of_inner, along)]
    }
}

impl Levels<f64> {
    /// Whether the margin is wide enough to keep the blur of its outer edge out of the rim's.
    pub fn has_near_margin(&self) -> bool {
        self.near_share() > NEAR_MARGIN
    }

    /// Level two or three pixels beyond the rim: 0 for black, 1 for white.
    pub fn near_share(&self) -> f64 {
        let (black, white) = (self.black.level, self.white.level);
        (self.near - black) / (white - black)
    }
}

#[inline(always)]
fn shift<T: Lane>(rim: &WeighedRim<T>, scale: T, along: (T, T)) -> (T, T) {
    (scale * rim.matrix[0].root() * along.0, scale * rim.matrix[2].root() * along.1)
}

/// Half the gradient's product with a rim's matrix, as a share of √M_uu and √M_vv and of the rim's
/// radius: γ/2 for a circle. From the slopes of black and margin, and the radii of both rims.
#[inline(always)]
fn gradient<T: Lane>((b, m): (Slope<T>, Slope<T>), (r_o, r_i): (T, T)) -> (T, T) {
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
