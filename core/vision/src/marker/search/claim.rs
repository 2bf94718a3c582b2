//! Pixels that belong to a roundel already found. The paper paints them over (section 3.6), which
//! would change the caller's image.
//!
//! Claims are kept as ellipses, and as one bit per pixel of each searched pair of rows, so that a hit costs one lookup
//! instead of one test per roundel of the frame.

use crate::{
    ellipse::{Chords, Ellipse},
    frame::Window,
    marker::{Ring, search::row_edges::ROW_STEP},
};

/// The pixels of one roundel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Claim {
    outer: Ellipse,
    half_box_px: (f64, f64),
}

impl Claim {
    pub fn new(ring: &Ring) -> Self {
        Self::with_box(ring, ring.outer.half_box_px())
    }

    /// With half the sides of the ring's bounding box.
    pub fn with_box(ring: &Ring, half_box_px: (f64, f64)) -> Self {
        Self { outer: ring.outer, half_box_px }
    }

    /// Whether the ring's centre lies in the claim.
    pub fn covers(&self, ring: &Ring) -> bool {
        let (from, to) = (self.outer.center, ring.outer.center);
        let near = (to.u - from.u).abs() <= self.half_box_px.0
            && (to.v - from.v).abs() <= self.half_box_px.1;
        near && self.outer.contains(to)
    }
}

/// The claimed pixels of a window.
#[derive(Debug, Default)]
pub(crate) struct ClaimedPixels {
    bits: Vec<u64>,
    words: usize,
    window: Option<Window>,
}

impl ClaimedPixels {
    /// Begins a window without claims.
    pub fn clear(&mut self, window: Window) {
        self.words = window.width().div_ceil(64);
        self.bits.clear();
        self.bits.resize(self.words * window.height().div_ceil(ROW_STEP), 0);
        self.window = Some(window);
    }

    pub fn add(&mut self, claim: &Claim) {
        let Some(window) = self.window else { return };
        let (center, half_v) = (claim.outer.center, claim.half_box_px.1);
        let top = (center.v - half_v).ceil().max(window.top as f64) as usize;
        let bottom = ((center.v + half_v).floor() + 1.0).clamp(0.0, window.bottom as f64) as usize;
        let (left, right) = (window.left as f64, window.right as f64);
        let chords = Chords::new(&claim.outer);
        let first = (top - window.top) / ROW_STEP;
        for pair in first..bottom.saturating_sub(window.top).div_ceil(ROW_STEP) {
            let (from, to) = chords.span((window.top + pair * ROW_STEP) as f64);
            let from = (from.ceil().clamp(left, right) - left) as usize;
            let to = ((to.floor() + 1.0).clamp(left, right) - left) as usize;
            let row = &mut self.bits[pair * self.words..(pair + 1) * self.words];
            if from >= to {
                continue;
            }
            for (word, bits) in (from / 64..).zip(&mut row[from / 64..to.div_ceil(64)]) {
                let low = from.saturating_sub(64 * word);
                let high = (to - 64 * word).min(64);
                *bits |= (u64::MAX >> (64 - (high - low))) << low;
            }
        }
    }

    /// Whether a pixel is claimed; `v` is the first row of a pair in the window.
    pub fn contains(&self, u: usize, v: usize) -> bool {
        let Some(window) = self.window else { return false };
        let (u, pair) = (u - window.left, (v - window.top) / ROW_STEP);
        self.bits[pair * self.words + u / 64] >> (u % 64) & 1 == 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::PixelPoint;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn bits_equal_the_ellipse(
            u in -20.0..220.0f64,
            v in -20.0..120.0f64,
            major in 1.0..60.0f64,
            flat in 0.3..1.0f64,
            angle_rad in -1.5..1.5f64,
            left in 0usize..150,
            top in 0usize..80,
        ) {
            let center = PixelPoint { u, v };
            let outer =
                Ellipse { center, semi_major_px: major, semi_minor_px: major * flat, angle_rad };
            let claim = Claim::new(&Ring::of_rims(outer, outer.grown(-0.5)));
            let window = Window { left, top, right: 200, bottom: 100 };
            let mut claimed = ClaimedPixels::default();
            claimed.clear(Window { left: 0, top: 0, right: 300, bottom: 200 });
            claimed.clear(window);
            claimed.add(&claim);
            for v in (top..100).step_by(ROW_STEP) {
                for u in left..200 {
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
