//! The model image of a roundel, and what a frame says against it.
//!
//! The frame's pixels are brought together once a fit, all at once: their rows are far apart in memory,
//! and a look that waits for one after the other takes longer than its arithmetic.
//!
//! Scatter: what the contour's nodes add to the pixels (`scatter`), summed from row to row, is d.
//!
//! Gather: with d, the columns of the linear problem (`columns`) go to `super::normal`.

use std::ops::Range;

use fearless_simd::{Level, Simd, dispatch, f64x8, prelude::*};
use fearless_simd_macros::simd;

use super::{
    blur_kernel::{DifferenceWeights, Kernel, PHASES},
    column_products::{COLUMNS, ProductSums},
    columns::{RowSpan, add_row},
    differences::{DIFFERENCE, ImageRows},
    projection::Nodes,
    residual_patches::Patches,
    scatter::scatter,
};
use crate::{ellipse::Chords, frame::Frame, room::make_room};

/// Rows are padded to whole vectors of any width.
pub const LANES: usize = 16;
/// Rows whose spans are found side by side, and their numbers.
const SPAN_ROWS: usize = 8;
const ROW: [f64; SPAN_ROWS] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];

/// Part of a frame round a roundel, with its image.
#[derive(Clone, Debug, Default)]
pub struct Window {
    /// Column and row of the frame at the top left; may be negative.
    pub origin: (i64, i64),
    /// Columns, a multiple of [`LANES`].
    width: usize,
    /// Rows.
    height: usize,
    /// Row by row what nodes add, then d; zero between calls.
    image: Vec<f32>,
    /// Rows and columns, in whole packs of [`LANES`], that the nodes reach.
    touched: [Range<usize>; 2],
    /// The frame's pixels that count; what others hold is of no matter.
    pixels: Vec<u8>,
    /// The first row with pixels that count …
    first: usize,
    /// … and from there on the columns of each row's.
    spans: Vec<(usize, usize)>,
    /// Grey values of the row at hand, then its residuals.
    grey: Vec<f32>,
    patches: Patches,
}

/// Numbers of the model that gather needs, as f32.
#[derive(Clone, Copy, Debug)]
pub struct PixelModel {
    /// W, grey levels.
    pub white: f32,
    /// C = B - W, grey levels.
    pub step: f32,
    /// ½ (σ² - σ²of the table), px².
    pub blur: f32,
    /// What of μ the nodes do not have, over 48, px²; none where the motion is held.
    pub motion: Option<[f32; 2]>,
    /// Weights of the differences.
    pub taps: DifferenceWeights,
    /// Derivative of (u, v) by t, row by row, pixels.
    pub slope: [f32; 4],
    /// ℓ.
    pub light: [f32; 2],
    /// t₁ and t₂ as constant, column and row terms.
    pub t: [[f32; 3]; 2],
    /// Relative inverse depth p₃/Q₃, as constant, t₁ and t₂ terms.
    pub nearness: [f32; 3],
    /// Nearness times the plane's x and y, alike.
    pub plane: [[f32; 3]; 2],
    /// n₁/s, n₂/s, n₃ times R/p₃: how a step along the normal moves t.
    pub lift: [f32; 3],
    /// p₁/(s p₃), p₂/(s p₃): where the middle is.
    pub middle: [f32; 2],
}

impl Window {
    /// Room for windows of so many columns and rows.
    pub fn make_room(&mut self, (columns, rows): (usize, usize)) {
        let width = columns.next_multiple_of(LANES);
        make_room(&mut self.image, width * rows + LANES);
        make_room(&mut self.pixels, width * rows + LANES);
        make_room(&mut self.grey, width + LANES);
        make_room(&mut self.spans, rows);
        self.patches.make_room(width);
    }

    /// Lays the window over columns and rows of the frame; all are included. Pixels within the chords
    /// count.
    pub fn set_region(
        &mut self,
        (columns, rows): ((i64, i64), (i64, i64)),
        (level, frame): (Level, &Frame),
        chords: &Chords,
    ) {
        self.origin = (columns.0, rows.0);
        self.width = ((columns.1 - columns.0 + 1) as usize).next_multiple_of(LANES);
        self.height = (rows.1 - rows.0 + 1) as usize;
        // Gather leaves zeros behind, so what is added is all that needs filling.
        // A row's last vector may reach beyond it.
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

    /// How many pixels count.
    pub fn pixels(&self) -> usize {
        self.spans.iter().map(|(from, to)| to - from).sum()
    }

    /// Rows and columns that nodes reach; `None` unless every node's pixels lie in the window.
    fn reached(&self, level: Level, nodes: &Nodes, reach: usize) -> Option<[Range<usize>; 2]> {
        let half = (reach / 2) as i32;
        let [(left, right), (top, bottom)] = [0, 1].map(|axis| {
            let steps = &nodes.steps[axis][..];
            let (min, max) = dispatch!(level, simd => bounds(simd, steps));
            // What is no number has become a step below the window or above.
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

    /// Scatters the nodes; false, with nothing done, if one lies outside the window.
    pub fn scatter(&mut self, level: Level, nodes: &Nodes, kernel: &Kernel) -> bool {
        let Some(touched) = self.reached(level, nodes, kernel.width) else { return false };
        self.touched = touched;
        scatter(level, nodes, kernel, &mut self.image, self.width);
        true
    }

    /// Sums the frame against the model over the pixels that count, and clears the image. All products
    /// of the columns, or only those with the residual.
    pub fn gather(
        &mut self,
        level: Level,
        model: &PixelModel,
        sums: &mut ProductSums,
        products: bool,
    ) {
        let with_motion = model.motion.is_some();
        if products {
            sums.clear();
            match with_motion {
                true => {
                    dispatch!(level, simd => gather_all::<_, true, true>(simd, self, model, sums))
                }
                false => {
                    dispatch!(level, simd => gather_all::<_, true, false>(simd, self, model, sums))
                }
            }
            sums.finish(level, with_motion);
        } else {
            match with_motion {
                true => {
                    dispatch!(level, simd => gather_all::<_, false, true>(simd, self, model, sums))
                }
                false => {
                    dispatch!(level, simd => gather_all::<_, false, false>(simd, self, model, sums))
                }
            }
            sums.finish_gradient(with_motion);
        }
    }
}

/// Columns of the window in its rows up to the last one that counts, within the chords and the frame.
#[simd]
fn spans<S: Simd>(simd: S, window: &mut Window, last: usize, frame: &Frame, chords: &Chords) {
    let (left, top) = window.origin;
    // The window is wider than what counts by more than the differences need.
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

/// Least and most.
#[simd]
fn bounds<S: Simd>(simd: S, steps: &[i32]) -> (i32, i32) {
    let lanes = S::i32s::LEN;
    let (mut min, mut max) = (S::i32s::splat(simd, i32::MAX), S::i32s::splat(simd, i32::MIN));
    // Nodes come in whole packs.
    for steps in steps.chunks_exact(lanes) {
        let steps = S::i32s::from_slice(simd, steps);
        (min, max) = (min.min(steps), max.max(steps));
    }
    let (mut low, mut high) = ([i32::MAX; LANES], [i32::MIN; LANES]);
    min.store_slice(&mut low[..lanes]);
    max.store_slice(&mut high[..lanes]);
    (low.into_iter().fold(i32::MAX, i32::min), high.into_iter().fold(i32::MIN, i32::max))
}

/// The standard library's is a call without SSE 4.1.
#[inline(always)]
fn ceil(value: f64) -> i64 {
    let cut = value as i64;
    cut + i64::from(value > cut as f64)
}

/// Copies the first `count` bytes: where there are as many, in whole packs, which takes no call.
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
    let last = window.first + window.spans.len() - 1;
    let [touched, columns] = window.touched.clone();
    let rows = touched.start.min(window.first - DIFFERENCE)..touched.end.max(last + DIFFERENCE + 1);
    let image = &mut window.image[rows.start * width..rows.end * width];
    add_up(simd, image, width, columns.clone());
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
        let around = (row - DIFFERENCE) * width..(row + DIFFERENCE + 1) * width + LANES;
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
        window.patches.add_row(simd, &window.grey[from..from + whole], (from, to));
    }
    if !PRODUCTS {
        sums.take_gradient::<S, MOTION>(&gradient);
    }
    let zero = S::f32s::splat(simd, 0.0);
    for row in rows {
        let pixels = &mut window.image[row * width..][columns.clone()];
        for pixels in pixels.chunks_exact_mut(S::f32s::LEN) {
            zero.store_slice(pixels);
        }
    }
    sums.patches = window.patches.finish(simd);
}

/// Vectors of a row summed side by side: each waits for the one above it.
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
