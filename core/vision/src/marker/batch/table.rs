//! Sums over the pixels of the rings of a batch: a row per quantity, a column per ring.

/// Rings per batch.
pub(super) const RINGS: usize = 8;
/// Accumulated rows, three of which hold two counts each.
pub(super) const TOTALS: usize = 48;

/// Sums of a batch, a column per ring.
#[derive(Clone, Debug)]
pub(super) struct Table {
    rows: [[f64; RINGS]; ROWS],
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
    /// The row `after` rows past another.
    #[inline(always)]
    pub fn row(&self, row: Row, after: usize) -> &[f64; RINGS] {
        &self.rows[row as usize + after]
    }

    #[inline(always)]
    pub fn set(&mut self, row: Row, ring: usize, value: f64) {
        self.rows[row as usize][ring] = value;
    }

    /// Sets all sums of a ring.
    #[inline(always)]
    pub fn set_totals(&mut self, ring: usize, mut totals: [i32; TOTALS]) {
        for both in 0..3 {
            let at = Row::NearPixels as usize + both;
            self.rows[TOTALS + both][ring] = f64::from(totals[at] >> 16);
            totals[at] &= 0xffff;
        }
        for (row, total) in self.rows.iter_mut().zip(totals) {
            row[ring] = f64::from(total);
        }
    }
}
