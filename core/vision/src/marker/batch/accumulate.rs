//! All sums over the pixels of a tracked ring, in one pass over their rows.
//!
//! The pixel sets are those of [`crate::marker::ring::pixels::edge_band`]. If one word holds a row, sums
//! can be taken before the levels that weigh them are known: with w = α + γ I in a band and 1 in the core,
//!
//!   Σ w uᵃ vᵇ = γ Σ_band I uᵃ vᵇ + α Σ_band uᵃ vᵇ + Σ_core uᵃ vᵇ,
//!
//! where the last two follow from the ends of each row ([`crate::marker::ring::pixels::ellipse_mask`]): for n columns with
//! the middle m/2, Σ u = n m/2 and Σ u² = n (3 m² + n² - 1)/12. All sums are integers, without rounding.

use fearless_simd::{Simd, f32x16, i16x32, i32x16, prelude::*, u8x64};
use fearless_simd_macros::simd;

use crate::{
    frame::Frame,
    marker::{
        batch::{
            planes::{HALF_PX, MAX_ROWS, Planes},
            row_sums::{ColumnFactors, PixelSource, RowSums},
            table::{RingSums, Row, TOTALS},
        },
        kind::Polarity,
        ring::pixels::{
            edge_band::{MIN_BLACK, MIN_WHITE},
            ellipse_mask::{
                Area, LANE_NUMBERS, LANES as ROWS_AT_ONCE, PatchEllipse, RowBits, RowSpans,
            },
            patch::{Patch, WORD_PX},
            predicted::{PredictedRims, band_ellipses},
        },
    },
};
/// The vector whose total is in each lane: the lane's index with its four bits reversed.
const REVERSED: [usize; 16] = [0, 8, 4, 12, 2, 10, 6, 14, 1, 9, 5, 13, 3, 11, 7, 15];

/// Accumulates the ring with these predicted rims, moved to the disc found. `None`, as in
/// [`crate::marker::ring::pixels::predicted::bands_about`], if there is no such ring, or it is too
/// large.
#[simd]
pub(super) fn accumulate_ring<S: Simd>(
    simd: S,
    frame: &Frame,
    patch: &Patch,
    polarity: Polarity,
    predicted: &PredictedRims,
    planes: &mut Planes,
) -> Option<RingSums> {
    let DrawnBands { top, bottom, disc, disc_column, middle, ellipse_sums, half_counts } =
        draw(simd, patch, predicted, planes)?;
    let window = &patch.window;
    let (pixels, stride) = frame.pixels();
    let pixels = &pixels[(window.top + top) * stride + window.left..];
    let flip = polarity.flip();
    let source = PixelSource {
        pixels,
        stride,
        flip: u8x64::splat(simd, flip),
        disc_flip: i16x32::splat(simd, flip.into()),
        disc_column,
        ones: i16x32::splat(simd, 1),
        even: ColumnFactors::new(simd, 2, -(middle.0 as i16)),
        odd: ColumnFactors::new(simd, 2, 1 - middle.0 as i16),
        disc: ColumnFactors::new(simd, 1, disc_column as i16 - middle.0 as i16),
    };
    let rows = bottom - top;
    let mut sums = RowSums::new(simd);
    sums.add::<false>(simd, &source, planes, 0..disc.0);
    sums.add::<true>(simd, &source, planes, disc.0..middle.1);
    let of_top = sums;
    sums.add::<true>(simd, &source, planes, middle.1..disc.1);
    sums.add::<false>(simd, &source, planes, disc.1..rows);

    let of_grey = sums.vectors(simd, &of_top, middle.0);
    let mut all = [i32x16::splat(simd, 0); TOTALS];
    all[..21].copy_from_slice(&of_grey);
    all[21..24].copy_from_slice(&half_counts);
    for ellipse in 0..4 {
        for k in 0..6 {
            all[Row::Ellipses as usize + 6 * ellipse + k] = ellipse_sums[ellipse][k].to_int();
        }
    }
    let mut totals = [0; TOTALS];
    for (totals, vectors) in totals.chunks_exact_mut(16).zip(all.chunks_exact(16)) {
        let mut sums = [0; 16];
        total(vectors.try_into().expect("sixteen of them")).store_slice(&mut sums);
        for (lane, vector) in REVERSED.into_iter().enumerate() {
            totals[vector] = sums[lane];
        }
    }
    let pixels = |ellipse: usize| totals[Row::Ellipses as usize + 6 * ellipse] as u32;
    if pixels(0) < MIN_WHITE || pixels(2) - pixels(1) < MIN_BLACK {
        return None;
    }
    Some(RingSums {
        totals,
        outer_reach: (rows - middle.1) as f64,
        inner_reach: (disc.1 - middle.1) as f64,
        middle_u: (window.left + middle.0) as f64,
        middle_v: (window.top + top + middle.1) as f64,
        polarity,
    })
}

/// RowSums of each vector's lanes; [`REVERSED`] gives their order.
#[inline(always)]
fn total<S: Simd>(vectors: &[i32x16<S>; 16]) -> i32x16<S> {
    let mut sums = *vectors;
    let mut count = 16;
    while count > 1 {
        count /= 2;
        for pair in 0..count {
            let (a, b) = (sums[2 * pair], sums[2 * pair + 1]);
            sums[pair] = a.zip_low(b) + a.zip_high(b);
        }
    }
    sums[0]
}

/// The bands as drawn, with sums over them.
struct DrawnBands<S: Simd> {
    /// Rows of all bands, in the patch.
    top: usize,
    bottom: usize,
    /// First row of the disc's band and one past its last, from `top` on.
    disc: (usize, usize),
    /// First of [`HALF_PX`] columns that contain the disc's band.
    disc_column: usize,
    /// A pixel in the middle, its column even.
    middle: (usize, usize),
    ellipse_sums: [[f32x16<S>; 6]; 4],
    /// Pixels of near and far margin, and those to the left of and above the middle in black and
    /// margin; the second counts are in the upper halves.
    half_counts: [i32x16<S>; 3],
}

/// Draws the bands of predicted rims.
#[simd]
fn draw<S: Simd>(
    simd: S,
    patch: &Patch,
    predicted: &PredictedRims,
    planes: &mut Planes,
) -> Option<DrawnBands<S>> {
    let (outer, inner) =
        (PatchEllipse::new(&predicted.outer, patch), PatchEllipse::new(&predicted.inner, patch));
    let ellipses = band_ellipses(&outer, &inner);
    let (top, bottom) = ellipses[5].rows(patch.rows())?;
    ellipses[5].area(patch, top)?;
    if bottom - top > MAX_ROWS {
        return None;
    }
    let rows = ellipses[1].rows(patch.rows())?;
    if rows.0 < top || rows.1 > bottom {
        return None;
    }
    let Area { rows: disc, columns } = ellipses[1].area(patch, top)?;
    let disc_column = columns.0.min(WORD_PX - HALF_PX);
    if columns.1 > disc_column + HALF_PX {
        return None;
    }
    let middle = (outer.u as usize & !1, outer.v as usize - top);
    if middle.1 < disc.0 || middle.1 > disc.1 {
        return None;
    }
    let mut wrong = RowBits::none(simd);
    let mut ellipse_sums = [[f32x16::splat(simd, 0.0); 6]; 4];
    let none = i32x16::splat(simd, 0);
    let mut half_counts = [none; 3];
    let left = middle.0 as i32;
    for row in (0..bottom - top).step_by(ROWS_AT_ONCE) {
        let v = f32x16::load_array(simd, LANE_NUMBERS) + (row as f32 - middle.1 as f32);
        let first = top + row;
        let core = ellipses[0].row_spans_in_word(simd, first);
        let inside = ellipses[1].row_spans_in_word(simd, first);
        let ring = ellipses[2].row_spans_in_word(simd, first);
        let whole = ellipses[3].row_spans_in_word(simd, first);
        let beside = ellipses[4].row_spans_in_word(simd, first);
        let beyond = ellipses[5].row_spans_in_word(simd, first);
        add_chords(&mut ellipse_sums[0], &core, v, left);
        add_chords(&mut ellipse_sums[1], &inside, v, left);
        add_chords(&mut ellipse_sums[2], &ring, v, left);
        add_chords(&mut ellipse_sums[3], &whole, v, left);
        let is_above = v.simd_lt(f32x16::splat(simd, 0.0));
        let black_above = is_above.select(ring.pixels() - inside.pixels(), none);
        let margin_above = is_above.select(beyond.pixels() - whole.pixels(), none);
        let black_before = ring.pixels_before(left) - inside.pixels_before(left);
        let margin_before = beyond.pixels_before(left) - whole.pixels_before(left);
        let far = beyond.pixels() - beside.pixels();
        half_counts[0] += beside.pixels() - whole.pixels() + (far << 16);
        half_counts[1] += black_before + (black_above << 16);
        half_counts[2] += margin_before + (margin_above << 16);

        let white = RowBits::load(simd, &patch.white, (first, 1));
        let row_spans = [&core, &inside, &ring, &whole, &beside, &beyond];
        wrong = wrong.with(planes.store(simd, row_spans, white, row));
    }
    (!wrong.any()).then_some(DrawnBands {
        top,
        bottom,
        disc,
        disc_column,
        middle,
        ellipse_sums,
        half_counts,
    })
}

/// Adds to the sums of 1, v, v², m, m v and 3 m² + n² - 1 over an ellipse's pixels.
#[inline(always)]
fn add_chords<S: Simd>(sums: &mut [f32x16<S>; 6], rows: &RowSpans<S>, v: f32x16<S>, middle: i32) {
    let (first, end) = rows.ends();
    let (n, m) = ((end - first).to_float::<f32x16<S>>(), first + end - (2 * middle + 1));
    let m = m.to_float::<f32x16<S>>();
    let (nv, nm) = (n * v, n * m);
    sums[0] += n;
    sums[1] += nv;
    sums[2] = nv.mul_add(v, sums[2]);
    sums[3] += nm;
    sums[4] = nm.mul_add(v, sums[4]);
    sums[5] = n.mul_add((m * 3.0).mul_add(m, n * n - 1.0), sums[5]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        camera::PixelPoint,
        ellipse::Ellipse,
        frame::Window,
        marker::{
            batch::table::Table,
            ring::pixels::{
                edge_band::{BandScratch, EdgeBands},
                patch::Threshold,
                predicted::bands_about,
            },
        },
    };
    use fearless_simd::{Level, dispatch};
    use proptest::prelude::*;
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;

    const SIDE: usize = 100;
    /// Longer than a row; the rest is padding.
    const STRIDE: usize = 107;

    /// A ring with noise, and noise in the padding.
    fn picture(ring: &PredictedRims, polarity: Polarity, seed: u64) -> Vec<u8> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let pixel = |at: usize| {
            let place = PixelPoint { u: (at % STRIDE) as f64, v: (at / STRIDE) as f64 };
            let (outer, inner) = (&ring.outer.ellipse, &ring.inner.ellipse);
            let is_black: bool = outer.contains(place) && !inner.contains(place);
            let level: u8 =
                if is_black { rng.random_range(20..80) } else { rng.random_range(160..=255) };
            if at % STRIDE < SIDE { level ^ polarity.flip() } else { rng.random() }
        };
        (0..STRIDE * SIDE).map(pixel).collect()
    }

    /// (column, row, level) of a set's pixels.
    fn pixels(set: &[u64], grey: &[[u8; WORD_PX]]) -> Vec<(f64, f64, f64)> {
        (0..set.len() * WORD_PX)
            .filter(|at| set[at / WORD_PX] >> (at % WORD_PX) & 1 == 1)
            .map(|at| {
                let (row, column) = (at / WORD_PX, at % WORD_PX);
                (column as f64, row as f64, f64::from(grey[row][column]))
            })
            .collect()
    }

    /// Σ of `of` over pixels.
    fn sum(pixels: &[(f64, f64, f64)], of: impl Fn(f64, f64, f64) -> f64) -> f64 {
        pixels.iter().map(|&(u, v, level)| of(u, v, level)).sum()
    }

    proptest! {
        #[test]
        fn sums_equal_scalar_sums_over_the_bands(
            (u, v) in (45.0..55.0f64, 45.0..55.0f64),
            semi_major_px in 12.0..24.0f64,
            flat in 0.6..1.0f64,
            ratio in 0.45..0.5f64,
            angle_rad in -1.5..1.5f64,
            is_white: bool,
            is_baseline: bool,
            seed: u64,
        ) {
            let rim = |share: f64| Ellipse {
                center: PixelPoint { u, v },
                semi_major_px: semi_major_px * share,
                semi_minor_px: semi_major_px * flat * share,
                angle_rad,
            };
            let predicted = PredictedRims::new(&rim(1.0), &rim(ratio));
            let polarity = if is_white { Polarity::WhiteRing } else { Polarity::BlackRing };
            let bytes = picture(&predicted, polarity, seed);
            let frame = Frame::new(&bytes, SIDE, SIDE, STRIDE).unwrap();
            let bounds = Window { left: 18, top: 15, right: 80, bottom: 85 };
            let threshold = Threshold { level: 120, polarity };
            let (mut patch, mut words) = (Patch::default(), Patch::default());
            let (mut planes, mut table) = (Planes::default(), Table::default());
            let mut scratch = BandScratch::new();
            let level = if is_baseline { Level::baseline() } else { Level::new() };
            let (sums, found) = dispatch!(level, simd => {
                Patch::load(simd, &mut patch, &frame, bounds, threshold);
                assert!(Patch::threshold(simd, &mut words, &frame, bounds, threshold));
                let sums =
                    accumulate_ring(simd, &frame, &words, polarity, &predicted, &mut planes);
                (sums, bands_about(simd, &patch, &predicted, &mut scratch))
            });
            prop_assert_eq!(patch.window, words.window);
            prop_assert_eq!(&patch.white[..patch.rows()], &words.white[..patch.rows()]);
            prop_assert_eq!(sums.is_some(), found.is_some());
            let (Some(sums), Some(found)) = (sums, found) else { return Ok(()) };
            table.store(3, &sums);
            let (middle_u, middle_v) = (found.middle.0 as f64, found.middle.1 as f64);
            let EdgeBands { top, disc_core, disc_band, ring_core, ring_band, black, near, far, .. } =
                found.bands;
            let of = |set: &[u64]| pixels(set, &patch.grey[top..]);
            let at = |row: Row, after: usize| table.rows[row as usize + after][3];
            for (row, band, reach) in [
                (Row::OuterBand, of(ring_band), at(Row::OuterReach, 0)),
                (Row::InnerBand, of(disc_band), at(Row::InnerReach, 0)),
            ] {
                let t = |v: f64| reach - (v - middle_v);
                let plain = [
                    sum(&band, |_, _, level| level),
                    sum(&band, |_, v, level| level * t(v)),
                    sum(&band, |_, v, level| level * t(v) * (t(v) + 1.0) / 2.0),
                    sum(&band, |u, _, level| level * (u - middle_u)),
                    sum(&band, |u, v, level| level * (u - middle_u) * t(v)),
                    sum(&band, |u, _, level| level * (u - middle_u).powi(2)),
                ];
                prop_assert_eq!([0, 1, 2, 3, 4, 5].map(|k| at(row, k)), plain);
            }
            let both = |a: &[u64], b: &[u64]| {
                pixels(&a.iter().zip(b).map(|(a, b)| a | b).collect::<Vec<_>>(), &patch.grey[top..])
            };
            let ellipses =
                [of(disc_core), both(disc_core, disc_band), of(ring_core), both(ring_core, ring_band)];
            for (index, ellipse) in ellipses.iter().enumerate() {
                let plain = [
                    sum(ellipse, |_, _, _| 1.0),
                    sum(ellipse, |_, v, _| v - middle_v),
                    sum(ellipse, |_, v, _| (v - middle_v).powi(2)),
                    sum(ellipse, |u, _, _| 2.0 * (u - middle_u)),
                    sum(ellipse, |u, v, _| 2.0 * (u - middle_u) * (v - middle_v)),
                    sum(ellipse, |u, _, _| 12.0 * (u - middle_u).powi(2)),
                ];
                prop_assert_eq!([0, 1, 2, 3, 4, 5].map(|k| at(Row::Ellipses, 6 * index + k)), plain);
            }
            let margin = both(near, far);
            let is_left = |u: f64, of: f64| if u < middle_u { of } else { 0.0 };
            let is_above = |v: f64, of: f64| if v < middle_v { of } else { 0.0 };
            for (row, plain) in [
                (Row::FarSquare, sum(&of(far), |_, _, level| level * level)),
                (Row::Disc, sum(&of(disc_core), |_, _, level| level)),
                (Row::Black, sum(&of(black), |_, _, level| level)),
                (Row::BlackLeft, sum(&of(black), |u, _, level| is_left(u, level))),
                (Row::BlackTop, sum(&of(black), |_, v, level| is_above(v, level))),
                (Row::Near, sum(&of(near), |_, _, level| level)),
                (Row::Far, sum(&of(far), |_, _, level| level)),
                (Row::MarginLeft, sum(&margin, |u, _, level| is_left(u, level))),
                (Row::MarginTop, sum(&margin, |_, v, level| is_above(v, level))),
                (Row::NearPixels, of(near).len() as f64),
                (Row::FarPixels, of(far).len() as f64),
                (Row::BlackLeftPixels, sum(&of(black), |u, _, _| is_left(u, 1.0))),
                (Row::BlackTopPixels, sum(&of(black), |_, v, _| is_above(v, 1.0))),
                (Row::MarginLeftPixels, sum(&margin, |u, _, _| is_left(u, 1.0))),
                (Row::MarginTopPixels, sum(&margin, |_, v, _| is_above(v, 1.0))),
                (Row::MiddleU, patch.window.left as f64 + middle_u),
                (Row::MiddleV, (patch.window.top + top) as f64 + middle_v),
                (Row::IsWhite, f64::from(u8::from(is_white))),
            ] {
                prop_assert_eq!(at(row, 0), plain, "{:?}", row);
            }
        }
    }
}
