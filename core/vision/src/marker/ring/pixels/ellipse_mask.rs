//! Filled ellipses as bits of a patch, sixteen rows at a time.
//!
//! Row v of the ellipse with the centre c and the matrix M ([`crate::ellipse::Ellipse::matrix`]) extends
//! from c_u + s dv - h to c_u + s dv + h, with dv = v - c_v, s = M_uv/M_vv and
//! h = √(det M / M_vv · (1 - dv²/M_vv)). Each vector lane holds a row.
//!
//! Grown by x along its normals, an ellipse has both semiaxes longer by x, so M' = M + 2x √M + x² I, and
//! √M = (M + ab I)/(a + b) does not need the directions of the axes.

use fearless_simd::{Simd, f32x16, i32x16, mask32x16, prelude::*, u32x16, u64x8};

use crate::{
    ellipse::{Ellipse, Symmetric2},
    marker::ring::pixels::patch::{PADDING_ROWS, Patch, WORD_PX},
};

/// Rows processed together.
pub(crate) const LANES: usize = PADDING_ROWS;
/// Indices of the lanes.
pub(crate) const LANE_NUMBERS: [f32; LANES] =
    [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0];

/// Rows and columns, each (first, end).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Area {
    pub rows: (usize, usize),
    pub columns: (usize, usize),
}

/// A rim with its [`Ellipse::matrix`], which is expensive to recompute.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RimEllipse {
    pub ellipse: Ellipse,
    pub matrix: Symmetric2,
}

impl RimEllipse {
    pub fn new(ellipse: &Ellipse) -> Self {
        Self { ellipse: *ellipse, matrix: ellipse.matrix() }
    }

    /// Half the sides of its bounding box, along u and v, pixels.
    pub fn half_box_px(&self) -> (f64, f64) {
        (self.matrix.uu.sqrt(), self.matrix.vv.sqrt())
    }
}

/// A rim in patch coordinates.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PatchEllipse {
    pub u: f64,
    pub v: f64,
    matrix: Symmetric2,
    /// Two over the sum of the semiaxes, and their product.
    twice_per_sum: f64,
    product: f64,
}

impl PatchEllipse {
    pub fn new(rim: &RimEllipse, patch: &Patch) -> Self {
        let RimEllipse { ellipse, matrix } = *rim;
        Self {
            u: ellipse.center.u - patch.window.left as f64,
            v: ellipse.center.v - patch.window.top as f64,
            matrix,
            twice_per_sum: 2.0 / (ellipse.semi_major_px + ellipse.semi_minor_px),
            product: ellipse.semi_major_px * ellipse.semi_minor_px,
        }
    }

    /// The filled ellipse, grown by `by_px`.
    #[inline(always)]
    pub fn grown(&self, by_px: f64) -> FilledEllipse {
        let per_sum = by_px * self.twice_per_sum;
        let (scale, more) = (1.0 + per_sum, per_sum * self.product + by_px * by_px);
        let (uu, vv) = (self.matrix.uu * scale + more, self.matrix.vv * scale + more);
        let uv = self.matrix.uv * scale;
        let determinant = (uu * vv - uv * uv) as f32;
        let (uu, uv, vv) = (uu as f32, uv as f32, vv as f32);
        let inverse_vv = 1.0 / vv;
        let (v, half_v) = (self.v as f32, vv.sqrt());
        FilledEllipse {
            u: self.u as f32,
            v,
            slope: uv * inverse_vv,
            half_max: (determinant * inverse_vv).sqrt(),
            inverse_vv,
            first: v - half_v,
            last: v + half_v,
            uu,
        }
    }
}

/// A filled ellipse by rows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FilledEllipse {
    u: f32,
    v: f32,
    slope: f32,
    half_max: f32,
    inverse_vv: f32,
    /// Range of its rows.
    first: f32,
    last: f32,
    /// Square of half the width of its bounding box.
    uu: f32,
}

impl FilledEllipse {
    /// First row and one past the last, if inside `rows` rows.
    #[inline(always)]
    pub fn rows(&self, rows: usize) -> Option<(usize, usize)> {
        (self.first >= 0.0 && self.last + 1.0 < rows as f32)
            .then_some((self.first.ceil() as usize, self.last as usize + 1))
    }

    /// Its rows, from `top` on, and columns, if inside the patch.
    #[inline(always)]
    pub fn area(&self, patch: &Patch, top: usize) -> Option<Area> {
        let rows = self.rows(patch.rows())?;
        let half = self.uu.sqrt();
        let (left, right) = (self.u - half, self.u + half);
        (left >= 0.0 && right + 1.0 < patch.columns() as f32).then_some(Area {
            rows: (rows.0 - top, rows.1 - top),
            columns: (left as usize, right as usize + 1),
        })
    }

    /// Intersections with sixteen rows of the patch; `None` if there are none.
    #[inline(always)]
    fn crossed<S: Simd>(&self, simd: S, first_row: usize) -> Option<Crossed<S>> {
        let first_row = first_row as f32;
        if first_row > self.last || first_row + (LANES as f32) <= self.first {
            return None;
        }
        let (zero, one) = (f32x16::splat(simd, 0.0), f32x16::splat(simd, 1.0));
        let dv = f32x16::load_array(simd, LANE_NUMBERS) + (first_row - self.v);
        let share = one - dv * dv * self.inverse_vv;
        let middle = dv.mul_add(f32x16::splat(simd, self.slope), self.u);
        let half = share.max(zero).sqrt() * self.half_max;
        Some(Crossed { middle, half, is_crossed: share.simd_gt(zero) })
    }

    /// As [`FilledEllipse::row_spans`], for an ellipse inside the first word: empty rows begin and
    /// end at 0.
    #[inline(always)]
    pub fn row_spans_in_word<S: Simd>(&self, simd: S, first_row: usize) -> RowSpans<S> {
        let none = i32x16::splat(simd, 0);
        let Some(Crossed { middle, half, is_crossed }) = self.crossed(simd, first_row) else {
            return RowSpans { first: none, end: none };
        };
        let first = (middle - half).ceil().to_int::<i32x16<S>>();
        let end = (middle + half).to_int::<i32x16<S>>() + 1;
        RowSpans { first: is_crossed.select(first, none), end: is_crossed.select(end, none) }
    }

    /// First column and one past the last in sixteen rows of the patch.
    #[inline(always)]
    pub fn row_spans<S: Simd>(&self, simd: S, first_row: usize, columns: usize) -> RowSpans<S> {
        let Some(Crossed { middle, half, is_crossed }) = self.crossed(simd, first_row) else {
            let none = i32x16::splat(simd, 0);
            return RowSpans { first: none, end: none };
        };
        let zero = f32x16::splat(simd, 0.0);
        let end = is_crossed.select((middle + half).floor() + 1.0, zero);
        let max = columns as f32;
        let (first, end) = ((middle - half).ceil().max(zero).min(max), end.max(zero).min(max));
        RowSpans { first: first.to_int(), end: end.to_int() }
    }
}

/// Middles and half lengths of sixteen rows' chords, and which rows have one.
struct Crossed<S: Simd> {
    middle: f32x16<S>,
    half: f32x16<S>,
    is_crossed: mask32x16<S>,
}

/// First columns of sixteen rows, and one past the last.
#[derive(Clone, Copy)]
pub(crate) struct RowSpans<S: Simd> {
    first: i32x16<S>,
    end: i32x16<S>,
}

impl<S: Simd> RowSpans<S> {
    /// First columns, and one past the last.
    #[inline(always)]
    pub fn ends(&self) -> (i32x16<S>, i32x16<S>) {
        (self.first, self.end)
    }

    /// Number of columns; for [`FilledEllipse::row_spans_in_word`] only.
    #[inline(always)]
    pub fn pixels(&self) -> i32x16<S> {
        self.end - self.first
    }

    /// Number of columns before `column`; for [`FilledEllipse::row_spans_in_word`] only.
    #[inline(always)]
    pub fn pixels_before(&self, column: i32) -> i32x16<S> {
        self.end.min(column) - self.first.min(column)
    }

    /// The bits of rows of one word with first ≤ end < 64, as the difference of two powers.
    #[inline(always)]
    pub fn word(&self, simd: S) -> RowBits<S> {
        let first = self.first.bitcast::<u32x16<S>>().widen();
        let end = self.end.bitcast::<u32x16<S>>().widen();
        let one = u64x8::splat(simd, 1);
        RowBits((one << end.0) - (one << first.0), (one << end.1) - (one << first.1))
    }

    /// The bits in a word of the rows; `is_only` if it is the only one, and they end before it
    /// does.
    #[inline(always)]
    pub fn bits(&self, simd: S, word: usize, is_only: bool) -> RowBits<S> {
        if is_only {
            let end = self.end.min(WORD_PX as i32 - 1);
            return RowSpans { first: self.first.min(end), end }.word(simd);
        }
        let from = (word * WORD_PX) as i32;
        below(simd, self.end, from).without(below(simd, self.first, from))
    }
}

/// Bits of sixteen rows.
#[derive(Clone, Copy)]
pub(crate) struct RowBits<S: Simd>(pub u64x8<S>, pub u64x8<S>);

impl<S: Simd> RowBits<S> {
    #[inline(always)]
    pub fn none(simd: S) -> Self {
        Self(u64x8::splat(simd, 0), u64x8::splat(simd, 0))
    }

    /// Whether any bit is set.
    #[inline(always)]
    pub fn any(self) -> bool {
        (self.0 | self.1).as_slice().iter().any(|&bits| bits != 0)
    }

    #[inline(always)]
    pub fn load(simd: S, words: &[u64], (first, words_in_row): (usize, usize)) -> Self {
        if words_in_row == 1 {
            let words = &words[first..first + LANES];
            return Self(
                u64x8::from_slice(simd, &words[..8]),
                u64x8::from_slice(simd, &words[8..]),
            );
        }
        let mut rows = [0; LANES];
        for (lane, row) in rows.iter_mut().enumerate() {
            *row = words[first + lane * words_in_row];
        }
        Self(u64x8::from_slice(simd, &rows[..8]), u64x8::from_slice(simd, &rows[8..]))
    }

    #[inline(always)]
    pub fn store(self, words: &mut [u64], (first, words_in_row): (usize, usize)) {
        if words_in_row == 1 {
            let words = &mut words[first..first + LANES];
            self.0.store_slice(&mut words[..8]);
            self.1.store_slice(&mut words[8..]);
            return;
        }
        for lane in 0..8 {
            words[first + lane * words_in_row] = self.0[lane];
            words[first + (lane + 8) * words_in_row] = self.1[lane];
        }
    }

    #[inline(always)]
    pub fn with(self, other: Self) -> Self {
        Self(self.0 | other.0, self.1 | other.1)
    }

    #[inline(always)]
    pub fn within(self, other: Self) -> Self {
        Self(self.0 & other.0, self.1 & other.1)
    }

    #[inline(always)]
    pub fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0, self.1 & !other.1)
    }
}

/// The bits of the columns before these in the word that begins with column `from`. A shift by 64
/// has no effect, so it is done in halves.
#[inline(always)]
fn below<S: Simd>(simd: S, columns: i32x16<S>, from: i32) -> RowBits<S> {
    let columns = (columns - from).max(0).min(WORD_PX as i32).bitcast::<u32x16<S>>();
    let half = (columns >> 1).widen();
    let rest = (columns - (columns >> 1)).widen();
    let one = u64x8::splat(simd, 1);
    RowBits(((one << half.0) << rest.0) - one, ((one << half.1) << rest.1) - one)
}
