//! The model image of a roundel, and what a frame says against it.
//!
//! The frame's pixels are brought together once a fit, all at once: their rows are far apart in memory,
//! and a look that waits for one after the other takes longer than its arithmetic.
//!
//! Scatter: each contour node adds e(y - q) k(x - p) dx to the 8 × 8 (or 16 × 16) pixels (p, q) round it,
//! with the kernel's functions (`super::blur`); summed from row to row this is d(p, q).
//!
//! Gather: the model is (W + C (d + ½ Δσ² ∇²d + Δμ·h/48)) (1 + ℓ·t), and the columns of the linear problem
//! go to `super::normal`. h = (∂²d/∂u² - ∂²d/∂v², 2 ∂²d/∂u∂v) is how d follows the motion's square μ
//! (`super::motion`), of which the nodes have all, or nothing. How d follows the contour's motion is -∇d, carried over to t. ∇d and ∇²d are central
//! differences of d over two pixels each way, weighted by `super::blur` for what the blur leaves of fine
//! detail: they miss 6 % of a column (root mean square) at a blur of 0.7 px, 14 % at 0.5 px, and what they
//! miss is orthogonal to what they give, so that the estimate's variance grows by the square of that.

use std::ops::Range;

use fearless_simd::{Level, Simd, dispatch, f32x8, f64x8, prelude::*};
use fearless_simd_macros::simd;

use super::{
    blur::{FUNCTIONS, Kernel, PHASES, Taps, fall_shift},
    differences::{DIFFERENCE, Differences, Lines, differences},
    normal::{COLUMNS, Sums},
    patches::Patches,
    view::Nodes,
};
use crate::{ellipse::Chords, frame::Frame, room::make_room};

/// Rows are padded to whole vectors of any width.
const LANES: usize = 16;
/// Rows whose spans are found side by side, and their numbers.
const ABREAST_ROWS: usize = 8;
const ROW: [f64; ABREAST_ROWS] = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];
/// The lanes' numbers.
const COUNT: [f32; LANES] = [0., 1., 2., 3., 4., 5., 6., 7., 8., 9., 10., 11., 12., 13., 14., 15.];

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
pub struct Model {
    /// W, grey levels.
    pub white: f32,
    /// C = B - W, grey levels.
    pub step: f32,
    /// ½ (σ² - σ²of the table), px².
    pub blur: f32,
    /// What of μ the nodes do not have, over 48, px²; none where the motion is held.
    pub motion: Option<[f32; 2]>,
    /// Weights of the differences.
    pub taps: Taps,
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
    pub fn lay(
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
        self.patches.lay(self.width);
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
                copy(
                    &frame.row(v as usize)[first..],
                    &mut self.pixels[row * self.width + from..],
                    to - from,
                );
            }
        }
    }

    /// Rows and columns that nodes reach; `None` unless every node's pixels lie in the window.
    fn reached(&self, level: Level, nodes: &Nodes, reach: usize) -> Option<[Range<usize>; 2]> {
        let half = (reach / 2) as i32;
        let [(left, right), (top, bottom)] = [0, 1].map(|axis| {
            let steps = &nodes.steps[axis][..];
            let (least, most) = dispatch!(level, simd => bounds(simd, steps));
            // What is no number has become a step below the window or above.
            (least >> PHASES.ilog2(), most >> PHASES.ilog2())
        });
        let within = left >= half
            && top >= half
            && right < self.width as i32 - half - 1
            && bottom < self.height as i32 - half - 1;
        let range = |least: i32, most: i32| (least + 1 - half) as usize..(most + half + 2) as usize;
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
        let image = &mut self.image[..];
        let (width, table) = (self.width, &kernel.table[..]);
        match kernel.width {
            8 => dispatch!(level, simd => scatter_all::<_, 1>(simd, nodes, table, image, width)),
            _ => dispatch!(level, simd => scatter_all::<_, 2>(simd, nodes, table, image, width)),
        }
        true
    }

    /// Sums the frame against the model over the pixels that count, and clears the image. All products
    /// of the columns, or only those with the residual.
    pub fn gather(&mut self, level: Level, model: &Model, sums: &mut Sums, products: bool) {
        let free = model.motion.is_some();
        if products {
            sums.clear();
            match free {
                true => {
                    dispatch!(level, simd => gather_all::<_, true, true>(simd, self, model, sums))
                }
                false => {
                    dispatch!(level, simd => gather_all::<_, true, false>(simd, self, model, sums))
                }
            }
            sums.finish(level, free);
        } else {
            match free {
                true => {
                    dispatch!(level, simd => gather_all::<_, false, true>(simd, self, model, sums))
                }
                false => {
                    dispatch!(level, simd => gather_all::<_, false, false>(simd, self, model, sums))
                }
            }
            sums.finish_gradient(free);
        }
    }
}

/// Columns of the window in its rows up to the last one that counts, within the chords and the frame.
#[simd]
fn spans<S: Simd>(simd: S, window: &mut Window, last: usize, frame: &Frame, chords: &Chords) {
    let (left, top) = window.origin;
    // The window is wider than what counts by more than the differences need.
    let least = (-left).max(DIFFERENCE as i64);
    let most = frame.width() as i64 - left;
    let most = most.clamp(least, (window.width - DIFFERENCE) as i64);
    for first in (window.first..=last).step_by(ABREAST_ROWS) {
        let v = (top + first as i64) as f64;
        let (begin, end) = chords.span_each(f64x8::simd_from(simd, ROW) + v);
        let (mut begins, mut ends) = ([0.0; ABREAST_ROWS], [0.0; ABREAST_ROWS]);
        begin.ceil().store_slice(&mut begins);
        end.ceil().store_slice(&mut ends);
        for (row, (begin, end)) in (first..=last).zip(begins.into_iter().zip(ends)) {
            let is_inside = (0..frame.height() as i64).contains(&(top + row as i64));
            let from = (begin as i64 - left).clamp(least, most);
            let to = (end as i64 - left).clamp(from, most);
            window.spans.push(if is_inside { (from as usize, to as usize) } else { (0, 0) });
        }
    }
}

/// Least and most.
#[simd]
fn bounds<S: Simd>(simd: S, steps: &[i32]) -> (i32, i32) {
    let lanes = S::i32s::LEN;
    let (mut least, mut most) = (S::i32s::splat(simd, i32::MAX), S::i32s::splat(simd, i32::MIN));
    // Nodes come in whole packs.
    for steps in steps.chunks_exact(lanes) {
        let steps = S::i32s::from_slice(simd, steps);
        (least, most) = (least.min(steps), most.max(steps));
    }
    let (mut low, mut high) = ([i32::MAX; LANES], [i32::MIN; LANES]);
    least.store_slice(&mut low[..lanes]);
    most.store_slice(&mut high[..lanes]);
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
fn copy(from: &[u8], to: &mut [u8], count: usize) {
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
fn gather_all<S: Simd, const PRODUCTS: bool, const FREE: bool>(
    simd: S,
    window: &mut Window,
    model: &Model,
    sums: &mut Sums,
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
        let mut line = Line {
            row,
            span: (from, to),
            grey: &mut window.grey,
            around: Lines { image: &window.image[around], width },
        };
        add_row::<S, FREE>(simd, &mut line, model, |columns, count| {
            if PRODUCTS {
                sums.keep::<S, FREE>(simd, columns, count);
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
        sums.take_gradient::<S, FREE>(&gradient);
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
const ABREAST: usize = 4;

/// Sums rows from the top down, in these columns.
#[inline(always)]
fn add_up<S: Simd>(simd: S, image: &mut [f32], width: usize, columns: Range<usize>) {
    let lanes = S::f32s::LEN;
    let mut column = columns.start;
    while column + ABREAST * lanes <= columns.end {
        let mut sums = [S::f32s::splat(simd, 0.0); ABREAST];
        for row in image.chunks_exact_mut(width) {
            let pixels = &mut row[column..column + ABREAST * lanes];
            for (sum, pixels) in sums.iter_mut().zip(pixels.chunks_exact_mut(lanes)) {
                *sum += S::f32s::from_slice(simd, pixels);
                sum.store_slice(pixels);
            }
        }
        column += ABREAST * lanes;
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

/// One row of the window.
struct Line<'a> {
    row: usize,
    span: (usize, usize),
    grey: &'a mut [f32],
    around: Lines<'a>,
}

/// One of the table's functions at a phase, `rest` of a step beyond it; `values` are followed by
/// their rise.
#[inline(always)]
fn look<S: Simd>(simd: S, values: &[f32], half: usize, rest: f32) -> f32x8<S> {
    let reach = values.len() / 2;
    let low = f32x8::from_slice(simd, &values[8 * half..8 * half + 8]);
    let rise = f32x8::from_slice(simd, &values[reach + 8 * half..reach + 8 * half + 8]);
    rise.mul_add(f32x8::splat(simd, rest), low)
}

/// Adds `value` times `factor` to eight pixels.
#[inline(always)]
fn add<S: Simd>(simd: S, pixels: &mut [f32], value: f32x8<S>, factor: f32) {
    let sum = f32x8::from_slice(simd, pixels);
    value.mul_add(f32x8::splat(simd, factor), sum).store_slice(pixels);
}

#[simd]
fn scatter_all<S: Simd, const HALVES: usize>(
    simd: S,
    nodes: &Nodes,
    table: &[f32],
    image: &mut [f32],
    width: usize,
) {
    let quarter = nodes.x.len() / 4;
    for i in 0..quarter {
        // Quarters side by side: two neighbours in a row would write to the pixels that the one
        // before has just written, and wait for it.
        for k in 0..4 {
            scatter_one::<S, HALVES>(simd, (nodes, i + k * quarter), table, image, width);
        }
    }
}

#[inline(always)]
fn scatter_one<S: Simd, const HALVES: usize>(
    simd: S,
    (nodes, i): (&Nodes, usize),
    table: &[f32],
    image: &mut [f32],
    width: usize,
) {
    let reach = 8 * HALVES;
    let phase_len = FUNCTIONS * 2 * reach;
    // Never negative, as has been seen to.
    let (step_x, step_y) = (nodes.steps[0][i] as usize, nodes.steps[1][i] as usize);
    let (column, row) = (step_x / PHASES, step_y / PHASES);
    let (phase_x, phase_y) = (step_x % PHASES, step_y % PHASES);
    let (rest_x, rest_y) = (nodes.rest[0][i], nodes.rest[1][i]);
    let along_x = &table[phase_x * phase_len..][..phase_len];
    let along_y = &table[phase_y * phase_len..][..phase_len];
    let dx = nodes.dx[i];
    let left = column + 1 - reach / 2;
    let top = row + 1 - reach / 2 + fall_shift(phase_y);
    for upper in 0..HALVES {
        let mut falls = [0.0; 8];
        (look(simd, &along_y[2 * reach..], upper, rest_y) * dx).store_slice(&mut falls);
        for half in 0..HALVES {
            let k = look(simd, &along_x[..2 * reach], half, rest_x);
            let left = left + 8 * half;
            for (j, fall) in falls.into_iter().enumerate() {
                let start = (top + 8 * upper + j) * width + left;
                add(simd, &mut image[start..start + 8], k, fall);
            }
        }
    }
}

/// A function that is linear in t: constant, t₁ and t₂ terms.
#[inline(always)]
fn linear<S: Simd>(simd: S, terms: &[f32; 3], t1: S::f32s, t2: S::f32s) -> S::f32s {
    let inner = t2.mul_add(S::f32s::splat(simd, terms[2]), S::f32s::splat(simd, terms[0]));
    t1.mul_add(S::f32s::splat(simd, terms[1]), inner)
}

/// How d changes where the plane's points move along a vector: `radial` is g·t.
#[inline(always)]
fn moved<S: Simd>(
    simd: S,
    along: &[f32; 3],
    (g1, g2, radial): (S::f32s, S::f32s, S::f32s),
) -> S::f32s {
    let across = g2.mul_add(S::f32s::splat(simd, along[1]), radial * -along[2]);
    g1.mul_add(S::f32s::splat(simd, along[0]), across)
}

#[inline(always)]
fn add_row<S: Simd, const FREE: bool>(
    simd: S,
    line: &mut Line,
    model: &Model,
    mut take: impl FnMut(&[S::f32s; COLUMNS], usize),
) {
    let lanes = S::f32s::LEN;
    let counted = S::f32s::from_slice(simd, &COUNT[..lanes]);
    let v = line.row as f32;
    let to = line.span.1 as f32;
    let [m11, m12, m21, m22] = model.slope.map(|value| S::f32s::splat(simd, value));
    let [zero, one, two] = [0.0, 1.0, 2.0].map(|value| S::f32s::splat(simd, value));
    let motion = model.motion.unwrap_or_default().map(|value| S::f32s::splat(simd, value));
    let row_t1 = S::f32s::splat(simd, model.t[0][0] + v * model.t[0][2]);
    let row_t2 = S::f32s::splat(simd, model.t[1][0] + v * model.t[1][2]);
    for start in (line.span.0..line.span.1).step_by(lanes) {
        let u = counted + start as f32;
        // What lies beyond the span is finite, and weighs nothing.
        let weight = (S::f32s::splat(simd, to) - u).min(one).max(zero);
        let grey = S::f32s::from_slice(simd, &line.grey[start..start + lanes]);
        let Differences { share, slope, curvature, bend } =
            differences::<S, FREE>(simd, &line.around, start, &model.taps);
        let ([along_u, along_v], [stretch, skew]) = (slope, bend);
        let (fall_u, fall_v) = (along_u * weight, along_v * weight);
        let g1 = zero - fall_u.mul_add(m11, fall_v * m21);
        let g2 = zero - fall_u.mul_add(m12, fall_v * m22);
        let t1 = u.mul_add(S::f32s::splat(simd, model.t[0][1]), row_t1);
        let t2 = u.mul_add(S::f32s::splat(simd, model.t[1][1]), row_t2);
        let blurred = curvature.mul_add(S::f32s::splat(simd, model.blur), share);
        let blurred = if FREE {
            stretch.mul_add(motion[0], skew.mul_add(motion[1], blurred))
        } else {
            blurred
        };
        let step = S::f32s::splat(simd, model.step);
        let level = blurred.mul_add(step, S::f32s::splat(simd, model.white));
        let shade = t1.mul_add(S::f32s::splat(simd, model.light[0]), t2 * model.light[1]);
        let level = level.mul_add(shade, level);
        let near = linear(simd, &model.nearness, t1, t2);
        let x = linear(simd, &model.plane[0], t1, t2);
        let y = linear(simd, &model.plane[1], t1, t2);
        let radial = t1.mul_add(g1, t2 * g2);
        let lift = moved(simd, &model.lift, (g1, g2, radial));
        let [middle_1, middle_2] = model.middle;
        let to_middle = moved(simd, &[middle_1, middle_2, 1.0], (g1, g2, radial));
        let lit = level * weight;
        // Mirrored, a point's ray t grows by 1/(2 nearness - 1), from the middle. With x = 2 nearness - 2
        // this moves it by x/(1 + x); the series serves as well, since x is a tenth or less.
        let x2 = near + near - two;
        let mirror = to_middle * x2 * (x2.mul_add(x2, one) - x2);
        // In the order of `normal::column`.
        let columns = [
            (grey - level) * weight,
            weight,
            share * weight,
            curvature * weight,
            lit * t1,
            lit * t2,
            near * g1,
            near * g2,
            near * to_middle,
            y * lift,
            zero - x * lift,
            mirror,
            stretch * weight,
            skew * weight,
        ];
        columns[0].store_slice(&mut line.grey[start..start + lanes]);
        take(&columns, lanes.min(line.span.1 - start));
    }
}
