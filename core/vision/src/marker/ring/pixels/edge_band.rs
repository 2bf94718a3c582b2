//! Edge bands of both rims, and the pixels that determine the levels.
//!
//! A rim's *edge band* is the set of pixels within about two pixels of it, the blurred edge. Everything inside
//! counts as one, everything outside as zero, so noise enters from the band alone. The
//! band extends equally to either side, so the light that blur carries beyond it on one side is missing on the other.
//!
//! | pixels | from the inside out | for |
//! | --- | --- | --- |
//! | `disc_core` | the disc, two pixels within | white level of the disc |
//! | `disc_band` | two pixels to either side of the disc's rim | the disc's moments |
//! | `ring_core` | black and disc, two pixels within the outer rim | the roundel's moments |
//! | `black` | `ring_core` beyond the disc's band | black level |
//! | `ring_band` | two pixels to either side of the outer rim | the roundel's moments |
//! | `thin_core`, `thin_band` | one pixel to either side of the outer rim | the same, with a narrow margin |
//! | `half_band` | the part of that inside the rim | the same, with hardly any margin |
//! | `near`, `far` | one pixel each, beyond that band | white level of the margin |
//!
//! Where the black is so thin that none of it lies beyond the bands, its level is that of the pixels
//! closest to its middle.
//!
//! Distances are built by dilation and erosion, alternately with the eight and the four nearest
//! neighbours, which makes an octagon: two pixels along the axes, 2.1 diagonally. Where the black is too
//! thin for two bands, they end in its middle.

use fearless_simd::Simd;
use fearless_simd_macros::simd;

use crate::marker::ring::pixels::{
    patch::{PADDING_ROWS, Patch},
    segment_fill::FilledSegment,
};

/// Rows around a roundel that belong to its bands and the margin.
const REACH: usize = 5;
/// Width of a band beyond its segment along the axes, pixels.
pub(crate) const BAND_PX: usize = 2;
/// Mean distance over all directions of a dilation by the four nearest neighbours …
pub(crate) const CROSS_PX: f64 = 0.90;
/// … by the eight nearest …
pub(crate) const THIN_PX: f64 = 1.27;
/// … and by both.
pub const WIDE_PX: f64 = 2.17;
/// Smallest number of pixels for a level of the disc …
pub(crate) const MIN_WHITE: u32 = 4;
/// … and of the black.
pub(crate) const MIN_BLACK: u32 = 8;

/// Pixel sets as bits, row by row, from row `top` of the patch on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EdgeBands<'a> {
    pub top: usize,
    /// The disc, and the roundel, by threshold.
    pub white: &'a [u64],
    pub whole: &'a [u64],
    pub disc_core: &'a [u64],
    pub disc_band: &'a [u64],
    pub ring_core: &'a [u64],
    pub ring_band: &'a [u64],
    pub thin_core: &'a [u64],
    pub thin_band: &'a [u64],
    pub half_band: &'a [u64],
    pub black: &'a [u64],
    pub near: &'a [u64],
    pub far: &'a [u64],
    /// Distance of the disc's core from its rim.
    pub core_px: f64,
    /// Width of the bands' parts in the black.
    pub inside_px: f64,
    /// Distance of `black` from both rims.
    pub black_px: f64,
}

/// Memory of [`EdgeBands::round`].
pub(crate) type BandScratch = Vec<u64>;

const PLANES: usize = 13;

/// Words of the bands of a patch; those of predicted rims need fewer.
pub(crate) fn max_words(words: usize, rows: usize) -> usize {
    PLANES * (rows + PADDING_ROWS) * words
}

impl<'a> EdgeBands<'a> {
    /// The sets of a disc and the ring around it.
    #[simd]
    pub fn round<S: Simd>(
        simd: S,
        patch: &Patch,
        disc: FilledSegment,
        ring: FilledSegment,
        scratch: &'a mut BandScratch,
    ) -> Self {
        let top = ring.extent.top.saturating_sub(REACH);
        let bottom = (ring.extent.bottom + REACH).min(patch.rows());
        let words = patch.words;
        // With an empty row before and after, so that every row has two neighbours.
        let length = (bottom - top + 2) * words;
        if scratch.len() < PLANES * length {
            scratch.resize(PLANES * length, 0);
        }
        let mut planes = scratch.chunks_exact_mut(length);
        let [
            white,
            whole,
            disc_core,
            disc_band,
            ring_core,
            ring_band,
            black,
            near,
            far,
            more,
            less,
            thin,
            half,
        ] = std::array::from_fn(|_| planes.next().expect("the scratch holds all planes"));
        let pixels = top * words..bottom * words;
        fill(white, disc, top, words);
        let inner = words..length - words;
        for (disc, white) in white[inner.clone()].iter_mut().zip(&patch.white[pixels.clone()]) {
            *disc &= white;
        }
        fill(whole, ring, top, words);

        let grid = Grid { words };
        grid.shrink::<SQUARE>(white, less);
        grid.shrink::<CROSS>(less, disc_core);
        let mut core_px = WIDE_PX;
        if pixels_in(disc_core) < MIN_WHITE {
            grid.shrink::<CROSS>(white, disc_core);
            core_px = CROSS_PX;
        }
        if pixels_in(disc_core) < MIN_WHITE {
            disc_core.copy_from_slice(white);
            core_px = 0.0;
        }
        grid.grow::<SQUARE>(white, more);
        grid.grow::<CROSS>(more, disc_band);
        grid.shrink::<SQUARE>(whole, less);
        grid.shrink::<CROSS>(less, ring_core);
        let mut inside_px = WIDE_PX;
        if disc_band.iter().zip(&*ring_core).fold(0, |all, (disc, core)| all | disc & !core) != 0 {
            disc_band.copy_from_slice(more);
            combine(ring_core, less, more, |less, more| less | more);
            inside_px = THIN_PX;
        }
        let mut black_px = inside_px;
        combine(black, ring_core, disc_band, |core, disc| core & !disc);
        if pixels_in(black) < MIN_BLACK {
            grid.grow::<CROSS>(white, near);
            grid.shrink::<CROSS>(whole, far);
            combine(black, far, near, |whole, white| whole & !white);
            black_px = CROSS_PX;
        }
        if pixels_in(black) < MIN_BLACK {
            combine(black, whole, white, |whole, white| whole & !white);
            black_px = 0.0;
        }
        disc_band.iter_mut().zip(&*disc_core).for_each(|(band, core)| *band &= !core);

        // From the outer rim outwards, each without the ones inside it and the outside of the
        // frame.
        grid.grow::<SQUARE>(whole, more);
        grid.grow::<CROSS>(more, ring_band);
        grid.grow::<CROSS>(ring_band, near);
        grid.grow::<SQUARE>(near, far);
        far.iter_mut().zip(&*near).for_each(|(far, near)| *far &= !near);
        near.iter_mut().zip(&*ring_band).for_each(|(near, band)| *near &= !band);
        ring_band.iter_mut().zip(&*ring_core).for_each(|(band, core)| *band &= !core);
        combine(thin, more, less, |more, less| more & !less);
        combine(half, whole, less, |whole, less| whole & !less);
        for plane in [&mut *ring_band, thin, near, far] {
            let valid = patch.white[pixels.clone()].iter().zip(&patch.black[pixels.clone()]);
            for (bits, (white, black)) in plane[inner.clone()].iter_mut().zip(valid) {
                *bits &= white | black;
            }
        }
        let rows = |plane: &'a mut [u64]| -> &'a [u64] { &plane[words..length - words] };
        Self {
            top,
            white: rows(white),
            whole: rows(whole),
            disc_core: rows(disc_core),
            disc_band: rows(disc_band),
            ring_core: rows(ring_core),
            ring_band: rows(ring_band),
            thin_core: rows(less),
            thin_band: rows(thin),
            half_band: rows(half),
            black: rows(black),
            near: rows(near),
            far: rows(far),
            core_px,
            inside_px,
            black_px,
        }
    }
}

/// Number of pixels in a set.
#[inline(always)]
pub(crate) fn pixels_in(set: &[u64]) -> u32 {
    set.iter().map(|bits| bits.count_ones()).sum()
}

#[inline(always)]
fn combine(to: &mut [u64], a: &[u64], b: &[u64], with: impl Fn(u64, u64) -> u64) {
    to.iter_mut().zip(a.iter().zip(b)).for_each(|(to, (&a, &b))| *to = with(a, b));
}

/// A segment's spans as bits.
#[inline(always)]
fn fill(plane: &mut [u64], segment: FilledSegment, top: usize, words: usize) {
    let extent = segment.extent;
    let (before, rest) = plane.split_at_mut((extent.top - top + 1) * words);
    let (rows, after) = rest.split_at_mut(extent.height() * words);
    before.fill(0);
    after.fill(0);
    if words == 1 {
        rows.iter_mut().zip(segment.rows()).for_each(|(bits, span)| *bits = span.bits(0));
    } else {
        for (row, span) in rows.chunks_exact_mut(words).zip(segment.rows()) {
            row.iter_mut().enumerate().for_each(|(word, bits)| *bits = span.bits(word));
        }
    }
}

/// The eight nearest neighbours.
const SQUARE: bool = true;
/// The four nearest neighbours.
const CROSS: bool = false;

/// The layout of rows in words.
#[derive(Clone, Copy, Debug)]
struct Grid {
    words: usize,
}

impl Grid {
    /// Dilation.
    #[inline(always)]
    fn grow<const ALL: bool>(self, from: &[u64], to: &mut [u64]) {
        self.each(from, to, |at, left, right| at | left | right, |a, b| a | b, ALL);
    }

    /// Erosion.
    #[inline(always)]
    fn shrink<const ALL: bool>(self, from: &[u64], to: &mut [u64]) {
        self.each(from, to, |at, left, right| at & left & right, |a, b| a & b, ALL);
    }

    #[inline(always)]
    fn each(
        self,
        from: &[u64],
        to: &mut [u64],
        along: impl Fn(u64, u64, u64) -> u64,
        across: impl Fn(u64, u64) -> u64,
        all: bool,
    ) {
        let (words, length) = (self.words, to.len());
        let from = &from[..length];
        to[..words].fill(0);
        to[length - words..].fill(0);
        if words == 1 {
            let side = |bits: u64| along(bits, bits << 1, bits >> 1);
            for v in 1..length - 1 {
                let (above, here, below) = (from[v - 1], from[v], from[v + 1]);
                to[v] = if all {
                    across(across(side(above), side(here)), side(below))
                } else {
                    across(across(above, side(here)), below)
                };
            }
            return;
        }
        let row = |v: usize| &from[v * words..(v + 1) * words];
        let side = |row: &[u64], at: usize| {
            let before = if at == 0 { 0 } else { row[at - 1] >> 63 };
            let after = if at + 1 == words { 0 } else { row[at + 1] << 63 };
            along(row[at], row[at] << 1 | before, row[at] >> 1 | after)
        };
        for (v, to) in to.chunks_exact_mut(words).enumerate().skip(1).take(length / words - 2) {
            let (above, here, below) = (row(v - 1), row(v), row(v + 1));
            for (at, to) in to.iter_mut().enumerate() {
                *to = if all {
                    across(across(side(above, at), side(here, at)), side(below, at))
                } else {
                    across(across(above[at], side(here, at)), below[at])
                };
            }
        }
    }
}
