//! Falls and rises of the light along a row: two bits per pixel, by SIMD.
//!
//! Bit u of `falls` is set if pixel u + 1 is darker than pixel u - 1 by at least a step, bit u of
//! `rises` if it is brighter. A difference needs no brightness threshold, so shadows and lighting
//! gradients have no effect, and a disc that blur leaves at half its contrast still
//! rises from its ring: for a 10 px ring with a disc of 3 px, blurred by 1.1 px, by a quarter of the
//! contrast over two pixels.
//!
//! Rows are averaged in pairs: less noise, and half the work.

use fearless_simd::{Level, dispatch, prelude::*, u8x64};
use fearless_simd_macros::simd;

use crate::frame::{Frame, Window};

/// Rows of a pair.
pub(crate) const ROW_STEP: usize = 2;

/// One pair of rows.
#[derive(Debug, Default)]
pub(crate) struct RowEdges {
    /// The mean of the rows, with one pixel of padding before and some after.
    line: Vec<u8>,
    width: usize,
    /// Position of the first pixel in the frame.
    pub left: usize,
    pub v: usize,
    /// A bit a pixel: the light falls there.
    pub falls: Vec<u64>,
    /// A bit a pixel: the light rises there.
    pub rises: Vec<u64>,
}

impl RowEdges {
    /// Reads the rows `v` and `v + 1` (row `v` alone at the bottom) between the window's sides.
    pub fn read(&mut self, level: Level, frame: &Frame, v: usize, window: &Window, step: u8) {
        let columns = window.left..window.right;
        let upper = &frame.row(v)[columns.clone()];
        let lower = &frame.row((v + 1).min(frame.height() - 1))[columns];
        (self.width, self.left, self.v) = (upper.len(), window.left, v);
        let words = self.width.div_ceil(64);
        // Never shrinks: bytes behind the newest row are not read.
        if self.line.len() < words * 64 + 2 {
            self.line.resize(words * 64 + 2, 0);
        }
        self.falls.resize(words, 0);
        self.rises.resize(words, 0);
        let line = &mut self.line[..words * 64 + 2];
        dispatch!(level, simd =>
            edges(simd, [upper, lower], step, line, &mut self.falls, &mut self.rises));
    }

    /// The mean grey levels.
    pub fn line(&self) -> &[u8] {
        &self.line[1..=self.width]
    }
}

#[simd]
fn edges<S: Simd>(
    simd: S,
    [upper, lower]: [&[u8]; 2],
    step: u8,
    line: &mut [u8],
    falls: &mut [u64],
    rises: &mut [u64],
) {
    let width = upper.len();
    for ((mean, &a), &b) in line[1..].iter_mut().zip(upper).zip(lower) {
        *mean = (u16::from(a) + u16::from(b)).div_ceil(2) as u8;
    }
    // The row is extended by its end pixels, so that its ends are not edges.
    line[0] = line[1];
    let last = line[width];
    line[width + 1..].fill(last);
    let step = u8x64::splat(simd, step);
    for ((word, fall), rise) in falls.iter_mut().enumerate().zip(rises) {
        let before = u8x64::from_slice(simd, &line[64 * word..64 * word + 64]);
        let after = u8x64::from_slice(simd, &line[64 * word + 2..64 * word + 66]);
        *fall = before.saturating_sub(after).simd_ge(step).to_bitmask();
        *rise = after.saturating_sub(before).simd_ge(step).to_bitmask();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn bits_equal_differences(
            width in 1usize..200,
            values in proptest::collection::vec(any::<u8>(), 600),
            left in 0usize..20,
            step in 1u8..60,
        ) {
            let frame = Frame::new(&values, width, 3, width).unwrap();
            let left = left.min(width - 1);
            let window = Window { left, ..Window::of(&frame) };
            let mut edges = RowEdges::default();
            // A longer row first, so that stale bytes would show.
            for level in [Level::new(), Level::baseline()] {
                for v in [0, 2] {
                    edges.read(level, &frame, v, &window, step);
                    let (upper, lower) = (frame.row(v), frame.row((v + 1).min(2)));
                    let mean = |u: usize| {
                        let u = u.clamp(left, width - 1);
                        (i32::from(upper[u]) + i32::from(lower[u]) + 1) / 2
                    };
                    for u in left..width {
                        let rise = mean(u + 1) - mean((u.max(left + 1)) - 1);
                        let (word, bit) = ((u - left) / 64, (u - left) % 64);
                        let step = i32::from(step);
                        prop_assert_eq!(edges.line()[u - left], mean(u) as u8);
                        prop_assert_eq!(edges.rises[word] >> bit & 1 == 1, rise >= step);
                        prop_assert_eq!(edges.falls[word] >> bit & 1 == 1, -rise >= step);
                    }
                    let beyond = (width - left) % 64;
                    if beyond > 0 {
                        prop_assert_eq!(edges.rises.last().unwrap() >> beyond, 0);
                        prop_assert_eq!(edges.falls.last().unwrap() >> beyond, 0);
                    }
                }
            }
        }
    }
}
