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

use fearless_simd::{Level, Simd, dispatch, prelude::*};
use fearless_simd_macros::simd;

use super::{
    blur_kernel::{Kernel, PHASES},
    column_products::{COLUMNS, ProductSums},
    columns::{LANES, Pack, PixelModel, RowSpan, add_row},
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

/// Margin of the window around the counted pixels, into which contours may move.
const SLACK_PX: f64 = 9.0;

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
    /// Number of counted pixels.
    pub counted: usize,
    /// Grey values of the current row, then its residuals.
    grey: Vec<f32>,
    patches: Patches,
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

    /// Places the window around an ellipse, whose pixels in the frame are counted.
    pub fn set_region(&mut self, frame: &Frame, counted: &Ellipse) {
        let (half_u, half_v) = counted.half_box_px();
        let range = |center: f64, half: f64| {
            let first = (center - half - SLACK_PX).floor() as i64;
            (first, ((center + half + SLACK_PX).ceil() as i64 - first + 1) as usize)
        };
        let (left, width) = range(counted.center.u, half_u);
        let (top, height) = range(counted.center.v, half_v);
        self.origin = (left, top);
        self.width = width.next_multiple_of(LANES);
        self.height = height;
        // Gather leaves zeros behind, so only the extension needs filling. The last vector of a row
        // may extend beyond it.
        let needed = self.width * self.height + LANES;
        if self.image.len() < needed {
            self.image.resize(needed, 0.0);
            self.pixels.resize(needed, 0);
        }
        self.grey.resize((self.width + LANES).max(self.grey.len()), 0.0);
        self.patches.set_width(self.width);
        self.copy_counted(frame, &Chords::new(counted));
    }

    fn copy_counted(&mut self, frame: &Frame, chords: &Chords) {
        let (left, top) = self.origin;
        let (begin, end) = chords.rows();
        let inner = DIFFERENCE as i64..self.height as i64 - DIFFERENCE as i64 - 1;
        let row_of = |v: f64| (ceil(v) - top).clamp(inner.start, inner.end) as usize;
        self.first = row_of(begin);
        // The window's margin exceeds what the differences need.
        let min = (-left).max(DIFFERENCE as i64);
        let max = frame.width() as i64 - left;
        let max = max.clamp(min, (self.width - DIFFERENCE) as i64);
        self.spans.clear();
        self.counted = 0;
        for row in self.first..=row_of(end) {
            let v = top + row as i64;
            if !(0..frame.height() as i64).contains(&v) {
                self.spans.push((0, 0));
                continue;
            }
            let (begin, end) = chords.span(v as f64);
            let from = (ceil(begin) - left).clamp(min, max);
            let to = (ceil(end) - left).clamp(from, max) as usize;
            let (first, from) = ((left + from) as usize, from as usize);
            self.spans.push((from, to));
            self.counted += to - from;
            self.pixels[row * self.width..][from..to]
                .copy_from_slice(&frame.row(v as usize)[first..][..to - from]);
        }
    }

    /// Subtracts a level from the counted pixels, given their place in the frame.
    pub fn subtract(&mut self, level: impl Fn(f64, f64) -> f64) {
        let (left, top) = self.origin;
        for (row, &(from, to)) in (self.first..).zip(&self.spans) {
            let v = (top + row as i64) as f64;
            let pixels = &mut self.pixels[row * self.width..][from..to];
            for (column, pixel) in (from..).zip(pixels) {
                let u = (left + column as i64) as f64;
                *pixel = (f64::from(*pixel) - level(u, v)).round().clamp(0.0, 255.0) as u8;
            }
        }
    }

    /// Rows and columns that the nodes reach; `None` if a node reaches beyond the window.
    fn reached(&self, level: Level, nodes: &Nodes, reach: usize) -> Option<[Range<usize>; 2]> {
        let half = (reach / 2) as i32;
        let [(left, right), (top, bottom)] = [0, 1].map(|axis| {
            let steps = &nodes.steps[axis][..];
            let (min, max) = dispatch!(level, _ => bounds(steps));
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

#[derive(Clone, Copy)]
pub struct CountedRow<'a> {
    pub row: usize,
    pub first_column: usize,
    pub grey: &'a [u8],
}

impl Window {
    pub fn counted_rows(&self) -> impl Iterator<Item = CountedRow<'_>> {
        let spans = (self.first..).zip(&self.spans).filter(|(_, (from, to))| from < to);
        spans.map(|(row, &(from, to))| {
            let start = row * self.width;
            CountedRow { row, first_column: from, grey: &self.pixels[start + from..start + to] }
        })
    }

    /// Passes each row with counted pixels to `take`, after [`Self::draw`]: its image and grey values,
    /// and the counted pixels themselves.
    #[inline(always)]
    pub fn for_each_row(&mut self, mut take: impl FnMut(&mut RowSpan, &[u8])) {
        let width = self.width;
        for (row, &(from, to)) in (self.first..).zip(&self.spans) {
            if from == to {
                continue;
            }
            let pixels = &self.pixels[row * width + from..][..(to - from).next_multiple_of(LANES)];
            let packs = pixels.chunks_exact(LANES);
            for (grey, pixels) in self.grey[from..].chunks_exact_mut(LANES).zip(packs) {
                for (grey, &pixel) in grey.iter_mut().zip(pixels) {
                    *grey = f32::from(pixel);
                }
            }
            let mut line = RowSpan {
                row,
                span: (from, to),
                grey: &mut self.grey,
                around: ImageRows { image: &self.image[around(row, width)], width },
            };
            take(&mut line, &pixels[..to - from]);
        }
    }

    /// Sums the contributions of the scattered nodes to d.
    #[inline(always)]
    pub fn draw<S: Simd>(&mut self, simd: S) {
        let rows = self.rows_in_use();
        let image = &mut self.image[rows.start * self.width..rows.end * self.width];
        add_up(simd, image, self.width, self.touched[1].clone());
    }

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

#[inline(always)]
fn bounds(steps: &[i32]) -> (i32, i32) {
    let (mut min, mut max) = (i32::MAX, i32::MIN);
    for &step in steps {
        (min, max) = (min.min(step), max.max(step));
    }
    (min, max)
}

/// That of the standard library is a function call without SSE 4.1.
#[inline(always)]
fn ceil(value: f64) -> i64 {
    let cut = value as i64;
    cut + i64::from(value > cut as f64)
}

#[simd]
fn gather_all<S: Simd, const PRODUCTS: bool, const MOTION: bool>(
    simd: S,
    window: &mut Window,
    model: &PixelModel,
    sums: &mut ProductSums,
) {
    if PRODUCTS {
        sums.clear();
    }
    window.draw(simd);
    let mut gradient = [S::f32s::splat(simd, 0.0); COLUMNS];
    let levels = [model.white, model.step].map(|level| S::f32s::splat(simd, level));
    let mut patches = std::mem::take(&mut window.patches);
    window.for_each_row(|line, _| {
        add_row::<S, MOTION, false>(
            simd,
            line,
            model,
            |_| levels,
            |columns, Pack { count, .. }| {
                if PRODUCTS {
                    sums.push::<S, MOTION>(simd, columns, count);
                } else {
                    for (sum, column) in gradient.iter_mut().zip(columns) {
                        *sum = column.mul_add(columns[0], *sum);
                    }
                }
            },
        );
        let (from, to) = line.span;
        let whole = (to - from).next_multiple_of(S::f32s::LEN);
        patches.add_row(simd, &line.grey[from..from + whole], from, to);
    });
    window.patches = patches;
    if PRODUCTS {
        sums.finish::<S, MOTION>(simd);
    } else {
        sums.set_gradient::<S, MOTION>(&gradient);
    }
    window.clear(simd);
    sums.patches = window.patches.finish(simd);
}

/// Sums rows from the top down, in these columns.
#[inline(always)]
fn add_up<S: Simd>(simd: S, image: &mut [f32], width: usize, columns: Range<usize>) {
    let lanes = S::f32s::LEN;
    for row in (width..image.len()).step_by(width) {
        let (above, below) = image.split_at_mut(row);
        let above = above[row - width..][columns.clone()].chunks_exact(lanes);
        for (sum, above) in below[columns.clone()].chunks_exact_mut(lanes).zip(above) {
            (S::f32s::from_slice(simd, sum) + S::f32s::from_slice(simd, above)).store_slice(sum);
        }
    }
}
