//! The pixels around one roundel, copied from the frame, with one bit per pixel that is set for white.
//!
//! A row of the patch is one or more words of 64 columns: the grey values are in blocks of 64 bytes, and bit k of a word
//! says whether column k is white (I ≥ τ). The further steps work on words, so a row of a usual roundel costs a few
//! instructions, and thresholding it one vector comparison.
//!
//! A white ring on black is inverted here, so that the further steps see a black one on white.

use fearless_simd::{Simd, prelude::*, u8x64};
use fearless_simd_macros::simd;

use crate::{
    frame::{Frame, Window},
    marker::kind::Polarity,
    scratch::reserve_total,
};

/// Columns of a word.
pub(crate) const WORD_PX: usize = 64;

/// Rows of undefined content after a patch's last, so that this many can be loaded at once.
pub(crate) const PADDING_ROWS: usize = 16;

/// Grey levels from `level` on are white; levels are inverted for white rings.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Threshold {
    /// In the frame's own levels.
    pub level: u8,
    pub polarity: Polarity,
}

/// A window of a frame, thresholded.
#[derive(Debug, Default)]
pub(crate) struct Patch {
    /// Its position in the frame.
    pub window: Window,
    /// Words per row.
    pub words: usize,
    /// Grey values, a block per word, row by row.
    pub grey: Vec<[u8; WORD_PX]>,
    /// I ≥ τ; columns beyond the window are neither white nor black. [`PADDING_ROWS`] longer than
    /// `black`.
    pub white: Vec<u64>,
    /// I < τ.
    pub black: Vec<u64>,
}

impl Patch {
    /// Reserves memory for `rows` rows of `words` words.
    pub fn reserve(&mut self, words: usize, rows: usize) {
        reserve_total(&mut self.grey, words * rows);
        reserve_total(&mut self.white, words * (rows + PADDING_ROWS));
        reserve_total(&mut self.black, words * rows);
    }

    /// RowBits.
    pub fn rows(&self) -> usize {
        self.window.height()
    }

    /// Columns.
    pub fn columns(&self) -> usize {
        self.window.width()
    }

    /// Thresholds `window`, which must not be empty, into one word per row, without copying; only
    /// `white` is valid then. False if the window is wider than a word, or the frame narrower.
    #[simd]
    pub fn threshold<S: Simd>(
        simd: S,
        patch: &mut Patch,
        frame: &Frame,
        window: Window,
        threshold: Threshold,
    ) -> bool {
        if window.width() > WORD_PX || frame.width() < WORD_PX {
            return false;
        }
        let left = window.left.min(frame.width() - WORD_PX);
        patch.window = Window { left, right: left + WORD_PX, ..window };
        patch.words = 1;
        let length = window.height() + PADDING_ROWS;
        if patch.white.len() < length {
            patch.white.resize(length, 0);
        }
        let (flip, limit) = flip_and_limit(simd, threshold);
        let (pixels, stride) = frame.pixels();
        let rows = pixels[window.top * stride + left..].chunks(stride);
        for (row, white) in rows.zip(&mut patch.white[..window.height()]) {
            let row = row.first_chunk().expect("the columns are the frame's");
            *white = (u8x64::load_array(simd, *row) ^ flip).simd_ge(limit).to_bitmask();
        }
        true
    }

    /// Copies and thresholds `window`, which must not be empty. Uses whole words where the frame is
    /// wide enough, so the patch may extend further to the sides than requested.
    #[simd]
    pub fn load<S: Simd>(
        simd: S,
        patch: &mut Patch,
        frame: &Frame,
        window: Window,
        threshold: Threshold,
    ) {
        let words = window.width().div_ceil(WORD_PX);
        let left = window.left.min(frame.width().saturating_sub(words * WORD_PX));
        let right = (left + words * WORD_PX).min(frame.width());
        patch.window = Window { left, right, ..window };
        patch.words = words;
        let blocks = words * window.height();
        if patch.grey.len() < blocks {
            patch.grey.resize(blocks, [0; WORD_PX]);
            patch.black.resize(blocks, 0);
        }
        let length = blocks + PADDING_ROWS * words;
        if patch.white.len() < length {
            patch.white.resize(length, 0);
        }
        let (flip, limit) = flip_and_limit(simd, threshold);
        if words == 1 && right - left == WORD_PX {
            let rows = patch.grey.iter_mut().zip(&mut patch.white).zip(&mut patch.black);
            for (v, ((to, white), black)) in (window.top..window.bottom).zip(rows) {
                let row = frame.row(v)[left..].first_chunk().expect("the columns are the frame's");
                let grey = u8x64::load_array(simd, *row) ^ flip;
                grey.store_array(to);
                *white = grey.simd_ge(limit).to_bitmask();
                *black = !*white;
            }
            return;
        }
        let mut block = 0;
        for v in window.top..window.bottom {
            let row = &frame.row(v)[left..right];
            for word in 0..words {
                let part = &row[word * WORD_PX..];
                let (grey, inside) = match part.first_chunk::<WORD_PX>() {
                    Some(whole) => (*whole, u64::MAX),
                    None => {
                        let mut grey = [0; WORD_PX];
                        grey[..part.len()].copy_from_slice(part);
                        (grey, (1u64 << part.len()) - 1)
                    }
                };
                let grey = u8x64::load_array(simd, grey) ^ flip;
                let white = grey.simd_ge(limit).to_bitmask();
                patch.grey[block] = grey.to_array();
                patch.white[block] = white & inside;
                patch.black[block] = !white & inside;
                block += 1;
            }
        }
    }
}

/// The mask that inverts grey levels, and the first white level after it.
#[inline(always)]
fn flip_and_limit<S: Simd>(simd: S, threshold: Threshold) -> (u8x64<S>, u8x64<S>) {
    let Threshold { level, polarity } = threshold;
    let limit = match polarity {
        Polarity::BlackRing => level,
        // I < τ becomes 255 - I ≥ 256 - τ.
        Polarity::WhiteRing => 0u8.wrapping_sub(level),
    };
    (u8x64::splat(simd, polarity.flip()), u8x64::splat(simd, limit))
}
