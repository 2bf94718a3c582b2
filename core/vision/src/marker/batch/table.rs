//! What is known of rings side by side before their levels are: sums, in rows of which each ring has a column.

/// Rings side by side.
pub(super) const RINGS: usize = 8;
/// Sums, three of which hold two counts each.
pub(super) const TOTALS: usize = 48;

/// Sums of rings side by side, each in its column.
#[derive(Clone, Debug)]
pub(super) struct Table {
    rows: [[f64; RINGS]; ROWS],
}

/// What [`Table`] has rows of. A moment's six sums are those of 1, v, v², u, uv, u² as they are added up.
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
    /// Of the four ellipses that end disc's core and band, and the roundel's.
    Ellipses,
    FarPixels = TOTALS,
    BlackTopPixels,
    MarginTopPixels,
    /// RowBits from the middle to the last one of the outer band.
    OuterReach,
    InnerReach,
    /// The middle's place in the frame.
    MiddleU,
    MiddleV,
    /// 1 of a white ring.
    IsWhite,
}

const ROWS: usize = Row::IsWhite as usize + 1;

impl Default for Table {
    fn default() -> Self {
        Self { rows: [[0.0; RINGS]; ROWS] }
    }
}

impl Table {
    /// A row, the so many-th after another.
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
