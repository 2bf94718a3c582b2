//! Sums over the pixels of the rings of a batch: a row per quantity, a column per ring.

use crate::{
    marker::{
        kind::Polarity,
        ring::{
            pixels::edge_band::WIDE_PX,
            subpixel::levels::{PartSum, PartSums},
            weighed_rim::{Cuts, WeighedRim, WeighedSums},
        },
    },
    simd::Lane,
};

/// Rings per batch.
pub(super) const RINGS: usize = 8;
/// Accumulated rows, three of which hold two counts each.
pub(super) const TOTALS: usize = 48;

/// Sums of a batch, a column per ring.
#[derive(Clone, Debug)]
pub(super) struct Table {
    pub rows: [[f64; RINGS]; ROWS],
}

/// Rows of a [`Table`]. The six sums of a moment are those of 1, v, v², u, uv, u² as accumulated.
#[derive(Clone, Copy, Debug)]
#[repr(usize)]
pub(super) enum Row {
    OuterBand = 0,
    InnerBand = 6,
    FarSquare = 12,
    Disc,
    Black,
    BlackLeft,
    BlackTop,
    Near,
    Far,
    MarginLeft,
    MarginTop,
    NearPixels,
    BlackLeftPixels,
    MarginLeftPixels,
    /// The four ellipses that bound the disc's core and band, and the roundel's.
    Ellipses,
    FarPixels = TOTALS,
    BlackTopPixels,
    MarginTopPixels,
    /// Rows from the middle to the last one of the outer band.
    OuterReach,
    InnerReach,
    /// Position of the middle in the frame.
    MiddleU,
    MiddleV,
    /// 1 for a white ring.
    IsWhite,
}

const ROWS: usize = Row::IsWhite as usize + 1;

impl Default for Table {
    fn default() -> Self {
        Self { rows: [[0.0; RINGS]; ROWS] }
    }
}

impl Table {
    /// Stores the sums of a ring in its column.
    #[inline(always)]
    pub fn store(&mut self, ring: usize, sums: &RingSums) {
        let mut totals = sums.totals;
        for both in 0..3 {
            let at = Row::NearPixels as usize + both;
            self.rows[TOTALS + both][ring] = f64::from(totals[at] >> 16);
            totals[at] &= 0xffff;
        }
        for (row, total) in self.rows.iter_mut().zip(totals) {
            row[ring] = f64::from(total);
        }
        let is_white = sums.polarity == Polarity::WhiteRing;
        for (row, value) in [
            (Row::OuterReach, sums.outer_reach),
            (Row::InnerReach, sums.inner_reach),
            (Row::MiddleU, sums.middle_u),
            (Row::MiddleV, sums.middle_v),
            (Row::IsWhite, f64::from(u8::from(is_white))),
        ] {
            self.rows[row as usize][ring] = value;
        }
    }
}

/// The sums over the pixels of one ring.
#[derive(Clone, Copy, Debug)]
pub(super) struct RingSums {
    /// In the order of [`Row`]; three of them hold a second count in their upper halves.
    pub totals: [i32; TOTALS],
    /// Rows from the middle to the last one of each band.
    pub outer_reach: f64,
    pub inner_reach: f64,
    /// Position of the middle in the frame.
    pub middle_u: f64,
    pub middle_v: f64,
    pub polarity: Polarity,
}

/// Where the sums of a rim are.
#[derive(Clone, Copy, Debug)]
pub(super) struct RimRows {
    band: Row,
    reach: Row,
    /// The ellipses that bound its core and its band.
    ellipses: (usize, usize),
}

impl RimRows {
    pub const OUTER: Self = Self { band: Row::OuterBand, reach: Row::OuterReach, ellipses: (2, 3) };
    pub const INNER: Self = Self { band: Row::InnerBand, reach: Row::InnerReach, ellipses: (0, 1) };
}

impl Table {
    /// The row `after` rows past another; as many lanes as `zero` has.
    #[inline(always)]
    pub fn read<T: Lane>(&self, zero: T, row: Row, after: usize) -> T {
        let row = &self.rows[row as usize + after];
        let [value] = zero.each(
            #[inline(always)]
            |lane| [row[lane]],
        );
        value
    }

    #[inline(always)]
    fn read_six<T: Lane>(&self, zero: T, row: Row, after: usize) -> [T; 6] {
        let mut six = [zero; 6];
        for (k, to) in six.iter_mut().enumerate() {
            *to = self.read(zero, row, after + k);
        }
        six
    }

    /// Sums over an ellipse's pixels.
    #[inline(always)]
    fn ellipse<T: Lane>(&self, zero: T, index: usize) -> WeighedSums<T> {
        let [n, nv, nvv, nm, nmv, squares] = self.read_six(zero, Row::Ellipses, 6 * index);
        [n, nv, nvv, nm * 0.5, nmv * 0.5, squares * (1.0 / 12.0)]
    }

    #[inline(always)]
    pub fn part_sums<T: Lane>(&self, zero: T) -> PartSums<T> {
        let disc = self.read(zero, Row::Ellipses, 0);
        let black = self.read(zero, Row::Ellipses, 12) - self.read(zero, Row::Ellipses, 6);
        PartSums {
            disc: PartSum { sum: self.read(zero, Row::Disc, 0), pixels: disc },
            black: PartSum { sum: self.read(zero, Row::Black, 0), pixels: black },
            black_left: self.part(zero, Row::BlackLeft, Row::BlackLeftPixels),
            black_top: self.part(zero, Row::BlackTop, Row::BlackTopPixels),
            near: self.part(zero, Row::Near, Row::NearPixels),
            far: self.part(zero, Row::Far, Row::FarPixels),
            far_square: self.read(zero, Row::FarSquare, 0),
            margin_left: self.part(zero, Row::MarginLeft, Row::MarginLeftPixels),
            margin_top: self.part(zero, Row::MarginTop, Row::MarginTopPixels),
        }
    }

    #[inline(always)]
    fn part<T: Lane>(&self, zero: T, sum: Row, pixels: Row) -> PartSum<T> {
        PartSum { sum: self.read(zero, sum, 0), pixels: self.read(zero, pixels, 0) }
    }

    /// The rim with weight 0 at the first level and 1 at the second, and the pixels of its band.
    #[inline(always)]
    pub fn weighed_rim<T: Lane>(&self, rows: RimRows, (from, to): (T, T)) -> (WeighedRim<T>, T) {
        let gain = (to - from).under(1.0);
        let offset = -(gain * from);
        let reach = self.read(gain, rows.reach, 0);
        // From rows counted from the last one to rows counted from the middle.
        let [n, t, tt, nu, tu, uu] = self.read_six(gain, rows.band, 0);
        let vv = reach * reach * n - reach * t * 2.0 + tt * 2.0 - t;
        let grey = [n, reach * n - t, vv, nu, reach * nu - tu, uu];
        let core = self.ellipse(gain, rows.ellipses.0);
        let both = self.ellipse(gain, rows.ellipses.1);
        let mut sums = core;
        for (k, sum) in sums.iter_mut().enumerate() {
            *sum = grey[k] * gain + (both[k] - core[k]) * offset + core[k];
        }
        let origin = (self.read(gain, Row::MiddleU, 0), self.read(gain, Row::MiddleV, 0));
        let cuts = Cuts { inside_px: WIDE_PX, outside_px: WIDE_PX };
        (WeighedRim::new(sums, origin, cuts), both[0] - core[0])
    }
}
