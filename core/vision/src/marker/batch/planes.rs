//! Pixel sets of one ring, a word per row.

use fearless_simd::Simd;

use crate::marker::ring::pixels::ellipse_mask::{RowBits, RowSpans};

/// Columns available for a disc's band.
pub(super) const HALF_PX: usize = 32;
/// Largest number of rows of a ring's bands and margin: the sums then fit into 32 bits.
pub(super) const MAX_ROWS: usize = 64;
/// Pixel sets, a word per row.
#[derive(Clone, Debug)]
pub(super) struct Planes {
    pub disc_core: [u64; MAX_ROWS],
    pub disc_band: [u64; MAX_ROWS],
    pub ring_band: [u64; MAX_ROWS],
    pub black: [u64; MAX_ROWS],
    pub near: [u64; MAX_ROWS],
    pub far: [u64; MAX_ROWS],
}

impl Default for Planes {
    fn default() -> Self {
        let none = [0; MAX_ROWS];
        let (disc_core, disc_band, ring_band) = (none, none, none);
        Self { disc_core, disc_band, ring_band, black: none, near: none, far: none }
    }
}

impl Planes {
    /// Stores sixteen rows of the sets bounded by the ellipses; returns the pixels with the wrong
    /// colour.
    #[inline(always)]
    pub fn store<S: Simd>(
        &mut self,
        simd: S,
        row_spans: [&RowSpans<S>; 6],
        white: RowBits<S>,
        row: usize,
    ) -> RowBits<S> {
        let [core, disc, ring, whole, beside, beyond] = row_spans;
        let (core, disc) = (core.word(simd), disc.word(simd));
        let (ring, whole) = (ring.word(simd), whole.word(simd));
        let (beside, beyond) = (beside.word(simd), beyond.word(simd));
        let (black, near) = (ring.without(disc), beside.without(whole));
        core.store(&mut self.disc_core, (row, 1));
        disc.without(core).store(&mut self.disc_band, (row, 1));
        whole.without(ring).store(&mut self.ring_band, (row, 1));
        black.store(&mut self.black, (row, 1));
        near.store(&mut self.near, (row, 1));
        beyond.without(beside).store(&mut self.far, (row, 1));
        core.with(near).without(white).with(black.within(white)).with(disc.without(ring))
    }
}
