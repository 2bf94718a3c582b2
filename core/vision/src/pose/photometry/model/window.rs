//! A window of the frame around a roundel, with the model image and the sums of both.
//!
//! The frame's pixels are copied once per fit: their rows are far apart in memory, and waiting for
//! them in each linearization would take longer than its arithmetic.
//!
//! Scatter: the contributions of the contour's nodes ([`super::scatter`]), summed from row to row,
//! are d.
//!
//! Gather: with d, the columns of the linear problem ([`super::columns`]) go to
//! [`super::column_products`].

use std::ops::Range;

use fearless_simd::{Level, Simd, dispatch, f64x8, prelude::*};
use fearless_simd_macros::simd;

use super::{
    blur_kernel::{Kernel, PHASES},
    column_products::{COLUMNS, ProductSums},
    columns::{LANES, PixelModel, RowSpan, add_row},
    differences::{DIFFERENCE, ImageRows},
    projection::Nodes,
    residual_patches::Patches,
    scatter::scatter,
};
use crate::{
    ellipse::{Chords, Ellipse},
    frame::Frame,
    scratch::reserve_total,
};

/// Rows whose spans are computed at once.
const SPAN_ROWS: usize = 8;
const ROW: [f64; SPAN_ROWS] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];

#[derive(Clone, Debug, Default)]
pub struct Window {
    /// Column and row of the frame at the top left; may be negative.
    pub origin: (i64, i64),
    /// A multiple of [`LANES`].
    width: usize,
    height: usize,
    /// Contributions of the nodes by row, then d; zero between calls.
    image: Vec<f32>,
    /// Rows, and columns in multiples of [`LANES`], that the nodes reach.
    touched: [Range<usize>; 2],
    /// The frame's counted pixels; the others are arbitrary.
    pixels: Vec<u8>,
    /// First row with counted pixels.
    first: usize,
    /// Columns of the counted pixels of each row from `first` on.
    spans: Vec<(usize, usize)>,
    /// Grey values of the current row, then its residuals.
    grey: Vec<f32>,
    patches: Patches,
}

/// Columns and rows of a frame, which may extend beyond it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Region {
    /// Column and row at the top left.
    pub origin: (i64, i64),
    pub width: usize,
    pub height: usize,
}

/// Margin of a region around the counted pixels, into which contours may move.
const SLACK_PX: f64 = 9.0;

impl Region {
    /// Region around the counted pixels.
    pub fn around(counted: &Ellipse) -> Self {
        let (half_u, half_v) = counted.half_box_px();
        let range = |center: f64, half: f64| {
            let first = (center - half - SLACK_PX).floor() as i64;
            (first, ((center + half + SLACK_PX).ceil() as i64 - first + 1) as usize)
        };
        let (left, width) = range(counted.center.u, half_u);
        let (top, height) = range(counted.center.v, half_v);
        Self { origin: (left, top), width, height }
    }
}

impl Window {
    /// Reserves memory for windows of this size.
    pub fn reserve(&mut self, columns: usize, rows: usize) {
        let width = columns.next_multiple_of(LANES);
        reserve_total(&mut self.image, width * rows + LANES);
        reserve_total(&mut self.pixels, width * rows + LANES);
        reserve_total(&mut self.grey, width + LANES);
        reserve_total(&mut self.spans, rows);
        self.patches.reserve(width);
    }

    /// Places the window over columns and rows of the frame, inclusive. Pixels within the chords
    /// are counted.
    pub fn set_region(&mut self, level: Level, frame: &Frame, region: &Region, chords: &Chords) {
        self.origin = region.origin;
        self.width = region.width.next_multiple_of(LANES);
        self.height = region.height;
        // Gather leaves zeros behind, so only the extension needs filling. The last vector of a row
        // may extend beyond it.
        let needed = self.width * self.height + LANES;
        if self.image.len() < needed {
            self.image.resize(needed, 0.0);
            self.pixels.resize(needed, 0);
        }
        self.grey.resize((self.width + LANES).max(self.grey.len()), 0.0);
        self.patches.set_width(self.width);
        let (begin, end) = chords.rows();
        let inner = DIFFERENCE as i64..self.height as i64 - DIFFERENCE as i64 - 1;
        let row_of = |v: f64| (ceil(v) - self.origin.1).clamp(inner.start, inner.end) as usize;
        self.first = row_of(begin);
        let last = row_of(end);
        self.spans.clear();
        dispatch!(level, simd => spans(simd, self, last, frame, chords));
        for (row, &(from, to)) in (self.first..).zip(&self.spans) {
            let v = self.origin.1 + row as i64;
            if from < to {
                let first = (self.origin.0 + from as i64) as usize;
                copy_packed(
                    &frame.row(v as usize)[first..],
                    &mut self.pixels[row * self.width + from..],
                    to - from,
                );
            }
        }
    }

    /// Rows and columns that the nodes reach; `None` if a node reaches beyond the window.
    fn reached(&self, level: Level, nodes: &Nodes, reach: usize) -> Option<[Range<usize>; 2]> {
        let half = (reach / 2) as i32;
        let [(left, right), (top, bottom)] = [0, 1].map(|axis| {
            let steps = &nodes.steps[axis][..];
            let (min, max) = dispatch!(level, simd => bounds(simd, steps));
            // NaN has become a step outside the window.
            (min >> PHASES.ilog2(), max >> PHASES.ilog2())
        });
        let within = left >= half
            && top >= half
            && right < self.width as i32 - half - 1
            && bottom < self.height as i32 - half - 1;
        let range = |min: i32, max: i32| (min + 1 - half) as usize..(max + half + 2) as usize;
        within.then(|| {
            let columns = range(left, right);
            let packs = columns.start / LANES * LANES..columns.end.next_multiple_of(LANES);
            [range(top, bottom), packs]
        })
    }

    /// Scatters the nodes; returns false, and changes nothing, if one reaches beyond the window.
    pub fn scatter(&mut self, level: Level, nodes: &Nodes, kernel: &Kernel) -> bool {
        let Some(touched) = self.reached(level, nodes, kernel.width) else { return false };
        self.touched = touched;
        scatter(level, nodes, kernel, &mut self.image, self.width);
        true
    }

    /// Sums the frame against the model over the counted pixels, and clears the image: all products
    /// of the columns, or only those with the residual.
    pub fn gather(
        &mut self,
        level: Level,
        model: &PixelModel,
        sums: &mut ProductSums,
        products: bool,
    ) {
        match (products, model.motion.is_some()) {
            (true, true) => {
                dispatch!(level, simd => gather_all::<_, true, true>(simd, self, model, sums))
            }
            (true, false) => {
                dispatch!(level, simd => gather_all::<_, true, false>(simd, self, model, sums))
            }
            (false, true) => {
                dispatch!(level, simd => gather_all::<_, false, true>(simd, self, model, sums))
            }
            (false, false) => {
                dispatch!(level, simd => gather_all::<_, false, false>(simd, self, model, sums))
            }
        }
    }
}

/// Counted pixels of one row.
#[derive(Clone, Copy)]
pub struct CountedRow<'a> {
    pub row: usize,
    pub first_column: usize,
    pub grey: &'a [u8],
}

impl Window {
    /// The rows that have counted pixels.
    pub fn counted_rows(&self) -> impl Iterator<Item = CountedRow<'_>> {
        let spans = (self.first..).zip(&self.spans).filter(|(_, (from, to))| from < to);
        spans.map(|(row, &(from, to))| {
            let start = row * self.width;
            CountedRow { row, first_column: from, grey: &self.pixels[start + from..start + to] }
        })
    }

    /// d of a row and the rows around it, after [`Self::draw`].
    #[inline(always)]
    pub fn image_rows(&self, row: usize) -> ImageRows<'_> {
        ImageRows { image: &self.image[around(row, self.width)], width: self.width }
    }

    /// Sums the contributions of the scattered nodes to d.
    #[inline(always)]
    pub fn draw<S: Simd>(&mut self, simd: S) {
        let rows = self.rows_in_use();
        let image = &mut self.image[rows.start * self.width..rows.end * self.width];
        add_up(simd, image, self.width, self.touched[1].clone());
    }

    /// Clears the image.
    #[inline(always)]
    pub fn clear<S: Simd>(&mut self, simd: S) {
        let zero = S::f32s::splat(simd, 0.0);
        for row in self.rows_in_use() {
            let pixels = &mut self.image[row * self.width..][self.touched[1].clone()];
            for pixels in pixels.chunks_exact_mut(S::f32s::LEN) {
                zero.store_slice(pixels);
            }
        }
    }

    /// Rows that the nodes reach or that differences read.
    #[inline(always)]
    fn rows_in_use(&self) -> Range<usize> {
        let last = self.first + self.spans.len() - 1;
        let nodes = &self.touched[0];
        nodes.start.min(self.first - DIFFERENCE)..nodes.end.max(last + DIFFERENCE + 1)
    }
}

/// Pixels of a row and of those around it in the image.
#[inline(always)]
fn around(row: usize, width: usize) -> Range<usize> {
    (row - DIFFERENCE) * width..(row + DIFFERENCE + 1) * width + LANES
}

/// Spans of the rows up to `last`, within the chords and the frame.
#[simd]
fn spans<S: Simd>(simd: S, window: &mut Window, last: usize, frame: &Frame, chords: &Chords) {
    let (left, top) = window.origin;
    // The window's margin exceeds what the differences need.
    let min = (-left).max(DIFFERENCE as i64);
    let max = frame.width() as i64 - left;
    let max = max.clamp(min, (window.width - DIFFERENCE) as i64);
    for first in (window.first..=last).step_by(SPAN_ROWS) {
        let v = (top + first as i64) as f64;
        let (begin, end) = chords.span_each(f64x8::simd_from(simd, ROW) + v);
        let (mut begins, mut ends) = ([0.0; SPAN_ROWS], [0.0; SPAN_ROWS]);
        begin.ceil().store_slice(&mut begins);
        end.ceil().store_slice(&mut ends);
        for (row, (begin, end)) in (first..=last).zip(begins.into_iter().zip(ends)) {
            let is_inside = (0..frame.height() as i64).contains(&(top + row as i64));
            let from = (begin as i64 - left).clamp(min, max);
            let to = (end as i64 - left).clamp(from, max);
            window.spans.push(if is_inside { (from as usize, to as usize) } else { (0, 0) });
        }
    }
}

/// Minimum and maximum.
#[simd]
fn bounds<S: Simd>(simd: S, steps: &[i32]) -> (i32, i32) {
    let lanes = S::i32s::LEN;
    let (mut min, mut max) = (S::i32s::splat(simd, i32::MAX), S::i32s::splat(simd, i32::MIN));
    // Nodes are padded to whole packs.
    for steps in steps.chunks_exact(lanes) {
        let steps = S::i32s::from_slice(simd, steps);
        (min, max) = (min.min(steps), max.max(steps));
    }
    let (mut low, mut high) = ([i32::MAX; LANES], [i32::MIN; LANES]);
    min.store_slice(&mut low[..lanes]);
    max.store_slice(&mut high[..lanes]);
    (low.into_iter().fold(i32::MAX, i32::min), high.into_iter().fold(i32::MIN, i32::max))
}

/// That of the standard library is a function call without SSE 4.1.
#[inline(always)]
fn ceil(value: f64) -> i64 {
    let cut = value as i64;
    cut + i64::from(value > cut as f64)
}

/// Copies `count` bytes, rounded up to whole packs where both slices are long enough, which avoids
/// a call.
#[inline(always)]
fn copy_packed(from: &[u8], to: &mut [u8], count: usize) {
    let packs = count.next_multiple_of(LANES);
    if from.len() < packs || to.len() < packs {
        to[..count].copy_from_slice(&from[..count]);
        return;
    }
    let (from, to) = (&from[..packs], &mut to[..packs]);
    for (from, to) in from.chunks_exact(LANES).zip(to.chunks_exact_mut(LANES)) {
        to.copy_from_slice(from);
    }
}

#[simd]
fn gather_all<S: Simd, const PRODUCTS: bool, const MOTION: bool>(
    simd: S,
    window: &mut Window,
    model: &PixelModel,
    sums: &mut ProductSums,
) {
    let width = window.width;
    if PRODUCTS {
        sums.clear();
    }
    window.draw(simd);
    let mut gradient = [S::f32s::splat(simd, 0.0); COLUMNS];
    for (row, &(from, to)) in (window.first..).zip(&window.spans) {
        if from == to {
            continue;
        }
        let pixels = &window.pixels[row * width + from..][..(to - from).next_multiple_of(LANES)];
        let packs = pixels.chunks_exact(LANES);
        for (grey, pixels) in window.grey[from..].chunks_exact_mut(LANES).zip(packs) {
            for (grey, &pixel) in grey.iter_mut().zip(pixels) {
                *grey = f32::from(pixel);
            }
        }
        let around = around(row, width);
        let mut line = RowSpan {
            row,
            span: (from, to),
            grey: &mut window.grey,
            around: ImageRows { image: &window.image[around], width },
        };
        add_row::<S, MOTION>(simd, &mut line, model, |columns, count| {
            if PRODUCTS {
                sums.push::<S, MOTION>(simd, columns, count);
            } else {
                for (sum, column) in gradient.iter_mut().zip(columns) {
                    *sum = column.mul_add(columns[0], *sum);
                }
            }
        });
        let whole = (to - from).next_multiple_of(S::f32s::LEN);
        window.patches.add_row(simd, &window.grey[from..from + whole], from, to);
    }
    if PRODUCTS {
        sums.finish::<S, MOTION>(simd);
    } else {
        sums.set_gradient::<S, MOTION>(&gradient);
    }
    window.clear(simd);
    sums.patches = window.patches.finish(simd);
}

/// Vectors of a row summed at once, since each sum waits for the row above.
const COLUMN_VECTORS: usize = 4;

/// Sums rows from the top down, in these columns.
#[inline(always)]
fn add_up<S: Simd>(simd: S, image: &mut [f32], width: usize, columns: Range<usize>) {
    let lanes = S::f32s::LEN;
    let mut column = columns.start;
    while column + COLUMN_VECTORS * lanes <= columns.end {
        let mut sums = [S::f32s::splat(simd, 0.0); COLUMN_VECTORS];
        for row in image.chunks_exact_mut(width) {
            let pixels = &mut row[column..column + COLUMN_VECTORS * lanes];
            for (sum, pixels) in sums.iter_mut().zip(pixels.chunks_exact_mut(lanes)) {
                *sum += S::f32s::from_slice(simd, pixels);
                sum.store_slice(pixels);
            }
        }
        column += COLUMN_VECTORS * lanes;
    }
    for column in (column..columns.end).step_by(lanes) {
        let mut sum = S::f32s::splat(simd, 0.0);
        for row in image.chunks_exact_mut(width) {
            let pixels = &mut row[column..column + lanes];
            sum += S::f32s::from_slice(simd, pixels);
            sum.store_slice(pixels);
        }
    }
}
