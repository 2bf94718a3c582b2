//! Pixels that belong to a roundel already found. The paper paints them over (section 3.6), which
//! would change the caller's image.
//!
//! Claims are kept as one bit per pixel of each pair of rows, so that a hit or a ring costs one lookup instead of one test
//! per roundel of the frame.

use std::ops::Range;

use crate::{
    camera::PixelPoint,
    ellipse::{Chords, Ellipse},
    marker::{Ring, search::row_edges::ROW_STEP},
};

/// The claimed pixels of a frame, in the first row of each pair of rows.
#[derive(Debug, Default)]
pub(crate) struct ClaimedPixels {
    bits: Vec<u64>,
    /// Words per row.
    words: usize,
    /// Width and height of the frame.
    size: (usize, usize),
    /// Pairs of rows with claims.
    pairs: Range<usize>,
}

impl ClaimedPixels {
    /// Begins a frame without claims.
    pub fn clear(&mut self, size: (usize, usize)) {
        if self.size == size {
            self.bits[self.pairs.start * self.words..self.pairs.end * self.words].fill(0);
        } else {
            self.size = size;
            self.words = size.0.div_ceil(64);
            self.bits.clear();
            self.bits.resize(self.words * size.1.div_ceil(ROW_STEP), 0);
        }
        self.pairs = 0..0;
    }

    /// Claims the pixels of a roundel; `half_v` is half the height of its bounding box.
    pub fn add(&mut self, outer: &Ellipse, half_v: f64) {
        let (width, height) = (self.size.0 as f64, self.size.1 as f64);
        let top = (outer.center.v - half_v).ceil().clamp(0.0, height) as usize;
        let bottom = ((outer.center.v + half_v).floor() + 1.0).clamp(0.0, height) as usize;
        let chords = Chords::new(outer);
        let pairs = top / ROW_STEP..bottom.div_ceil(ROW_STEP);
        self.pairs = if self.pairs.is_empty() {
            pairs.clone()
        } else {
            self.pairs.start.min(pairs.start)..self.pairs.end.max(pairs.end)
        };
        for pair in pairs {
            let (from, to) = chords.span((pair * ROW_STEP) as f64);
            let from = from.ceil().clamp(0.0, width) as usize;
            let to = (to.floor() + 1.0).clamp(0.0, width) as usize;
            if from >= to {
                continue;
            }
            let row = &mut self.bits[pair * self.words..(pair + 1) * self.words];
            for (word, bits) in (from / 64..).zip(&mut row[from / 64..to.div_ceil(64)]) {
                let low = from.saturating_sub(64 * word);
                let high = (to - 64 * word).min(64);
                *bits |= (u64::MAX >> (64 - (high - low))) << low;
            }
        }
    }

    /// Whether a pixel is claimed, by the first row of its pair.
    pub fn contains(&self, u: usize, v: usize) -> bool {
        self.bits[v / ROW_STEP * self.words + u / 64] >> (u % 64) & 1 == 1
    }

    /// Whether a ring's centre, which lies in the frame, is claimed.
    pub fn covers(&self, ring: &Ring) -> bool {
        let PixelPoint { u, v } = ring.outer.center;
        self.contains(u as usize, v as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn bits_equal_the_ellipse(
            u in -20.0..220.0f64,
            v in -20.0..120.0f64,
            major in 1.0..60.0f64,
            flat in 0.3..1.0f64,
            angle_rad in -1.5..1.5f64,
        ) {
            let center = PixelPoint { u, v };
            let outer =
                Ellipse { center, semi_major_px: major, semi_minor_px: major * flat, angle_rad };
            let mut claimed = ClaimedPixels::default();
            claimed.clear((300, 200));
            claimed.clear((200, 101));
            claimed.add(&outer.grown(2.0), outer.grown(2.0).half_box_px().1);
            claimed.clear((200, 101));
            claimed.add(&outer, outer.half_box_px().1);
            for v in (0..101).step_by(ROW_STEP) {
                for u in 0..200 {
                    // Either result is right on the rim itself.
                    let at = PixelPoint { u: u as f64, v: v as f64 };
                    if outer.grown(1e-6).contains(at) == outer.grown(-1e-6).contains(at) {
                        prop_assert_eq!(claimed.contains(u, v), outer.contains(at));
                    }
                }
            }
        }
    }
}
