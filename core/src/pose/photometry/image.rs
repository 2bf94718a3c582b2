//! The model image of a roundel, and what a frame says against it.
//!
//! Scatter: each contour node adds to four images, over the 8 × 8 (or 16 × 16) pixels (p, q) round it,
//! with the kernel (`super::blur`) K = k(x - p) k(y - q):
//!
//! | image | a node adds | sums up to |
//! | --- | --- | --- |
//! | fall | e(y - q) k(x - p) dx | d(p, q) - d(p, q - 1), the black share from row to row |
//! | 2 gradients | K dy, -K dx, carried over to t | how d follows the contour's motion |
//! | curvature | k'(x - p) k(y - q) dy - k(x - p) k'(y - q) dx | ∇²d = 2 ∂d/∂σ² |
//!
//! Gather: row by row the running sum of falls is d, the model is (W + C (d + ½ Δσ² ∇²d)) (1 + ℓ·t),
//! and the columns of the linear problem go to `super::normal`.

use fearless_simd::{Level, Simd, dispatch, f32x8, prelude::*};
use fearless_simd_macros::simd;

use super::{
    blur::{FUNCTIONS, Kernel, PHASES, fall_shift},
    normal::Sums,
    view::Nodes,
};
use crate::{ellipse::Chords, frame::Frame};

/// Images that a node adds to.
const IMAGES: usize = 4;
/// Rows are padded to whole vectors of any width.
const LANES: usize = 16;
/// The lanes' numbers.
const COUNT: [f32; LANES] = [0., 1., 2., 3., 4., 5., 6., 7., 8., 9., 10., 11., 12., 13., 14., 15.];

/// Part of a frame round a roundel, with its four images.
#[derive(Clone, Debug, Default)]
pub struct Window {
    /// Column and row of the frame at the top left; may be negative.
    pub origin: (i64, i64),
    /// Columns, a multiple of [`LANES`].
    width: usize,
    /// Rows.
    height: usize,
    /// Row by row, the four images side by side; zero between calls.
    images: Vec<f32>,
    /// First and last row that the nodes reach.
    touched: (usize, usize),
    /// d of the row at hand.
    share: Vec<f32>,
    /// Grey values of the row at hand.
    grey: Vec<f32>,
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
    /// Lays the window over columns and rows of the frame; all are included.
    pub fn lay(&mut self, columns: (i64, i64), rows: (i64, i64)) {
        self.origin = (columns.0, rows.0);
        self.width = ((columns.1 - columns.0 + 1) as usize).next_multiple_of(LANES);
        self.height = (rows.1 - rows.0 + 1) as usize;
        // Gather leaves zeros behind, so what is added is all that needs filling.
        let needed = self.width * self.height * IMAGES;
        if self.images.len() < needed {
            self.images.resize(needed, 0.0);
        }
        self.share.resize(self.width.max(self.share.len()), 0.0);
        self.grey.resize(self.width.max(self.grey.len()), 0.0);
    }

    /// First and last row that nodes reach; `None` unless every node's pixels lie in the window.
    fn rows(&self, nodes: &Nodes, reach: usize) -> Option<(usize, usize)> {
        let bounds = |steps: &[i32]| {
            let least = steps.iter().fold(i32::MAX, |a, &b| a.min(b));
            let most = steps.iter().fold(i32::MIN, |a, &b| a.max(b));
            // What is no number has become a step below the window or above.
            (least >> PHASES.ilog2(), most >> PHASES.ilog2())
        };
        let half = (reach / 2) as i32;
        let (left, right) = bounds(&nodes.steps[0]);
        let (top, bottom) = bounds(&nodes.steps[1]);
        let within = left >= half
            && top >= half
            && right < self.width as i32 - half - 1
            && bottom < self.height as i32 - half - 1;
        within.then(|| ((top + 1 - half) as usize, (bottom + half + 1) as usize))
    }

    /// Scatters the nodes; false, with nothing done, if one lies outside the window.
    pub fn scatter(&mut self, level: Level, nodes: &Nodes, kernel: &Kernel) -> bool {
        let Some(rows) = self.rows(nodes, kernel.width) else { return false };
        self.touched = rows;
        let images = &mut self.images[..];
        let (width, table) = (self.width, &kernel.table[..]);
        match kernel.width {
            8 => dispatch!(level, simd => scatter_all::<_, 1>(simd, nodes, table, images, width)),
            _ => dispatch!(level, simd => scatter_all::<_, 2>(simd, nodes, table, images, width)),
        }
        true
    }

    /// Sums the frame against the model over the pixels within `chords`, and clears the images. All
    /// products of the columns, or only those with the residual.
    pub fn gather(
        &mut self,
        level: Level,
        frame: &Frame,
        chords: &Chords,
        model: &Model,
        sums: &mut Sums,
        products: bool,
    ) {
        sums.clear();
        if products {
            dispatch!(level, simd => gather_all::<_, true>(simd, self, (frame, chords), model, sums));
            sums.finish(level);
        } else {
            dispatch!(level, simd => gather_all::<_, false>(simd, self, (frame, chords), model, sums));
            sums.finish_gradient();
        }
    }

    /// Columns of the window, in row `v` of the frame, within the chords and the frame.
    #[inline(always)]
    fn span(&self, frame: &Frame, chords: &Chords, v: i64) -> (usize, usize) {
        if !(0..frame.height() as i64).contains(&v) {
            return (0, 0);
        }
        let (from, to) = chords.span(v as f64);
        let least = (-self.origin.0).max(0);
        let most = (frame.width() as i64 - self.origin.0).clamp(least, self.width as i64);
        let from = (ceil(from) - self.origin.0).clamp(least, most);
        let to = (ceil(to) - self.origin.0).clamp(from, most);
        (from as usize, to as usize)
    }
}

/// The standard library's is a call without SSE 4.1.
#[inline(always)]
fn ceil(value: f64) -> i64 {
    let cut = value as i64;
    cut + i64::from(value > cut as f64)
}

#[simd]
fn gather_all<S: Simd, const PRODUCTS: bool>(
    simd: S,
    window: &mut Window,
    (frame, chords): (&Frame, &Chords),
    model: &Model,
    sums: &mut Sums,
) {
    let width = window.width;
    window.share[..width].fill(0.0);
    let (top, bottom) = window.touched;
    let (begin, end) = chords.rows();
    let first = (ceil(begin) - window.origin.1).clamp(0, top as i64) as usize;
    let last = ceil(end) - window.origin.1;
    let last = last.clamp(bottom as i64, window.height as i64 - 1) as usize;
    for row in first..=last {
        let v = window.origin.1 + row as i64;
        let (from, to) = window.span(frame, chords, v);
        let images = &mut window.images[row * width * IMAGES..][..width * IMAGES];
        for (share, fall) in window.share[..width].iter_mut().zip(&images[..]) {
            *share += fall;
        }
        if from < to {
            let first = (window.origin.0 + from as i64) as usize;
            let pixels = &frame.row(v as usize)[first..first + to - from];
            for (grey, &pixel) in window.grey[from..to].iter_mut().zip(pixels) {
                *grey = f32::from(pixel);
            }
            let line = Line {
                row,
                span: (from, to),
                grey: &window.grey[..width],
                share: &window.share[..width],
                images,
            };
            add_row::<S, PRODUCTS>(simd, &line, model, sums);
        }
        images.fill(0.0);
    }
}

/// One row of the window.
struct Line<'a> {
    row: usize,
    span: (usize, usize),
    grey: &'a [f32],
    share: &'a [f32],
    images: &'a [f32],
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
    images: &mut [f32],
    width: usize,
) {
    let quarter = nodes.x.len() / 4;
    for i in 0..quarter {
        // Quarters side by side: two neighbours in a row would write to the pixels that the one
        // before has just written, and wait for it.
        for k in 0..4 {
            scatter_one::<S, HALVES>(simd, (nodes, i + k * quarter), table, images, width);
        }
    }
}

#[inline(always)]
fn scatter_one<S: Simd, const HALVES: usize>(
    simd: S,
    (nodes, i): (&Nodes, usize),
    table: &[f32],
    images: &mut [f32],
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
    let (dx, dy) = (nodes.dx[i], nodes.dy[i]);
    let (g1, g2) = (nodes.by_t[0][i], nodes.by_t[1][i]);
    let left = column + 1 - reach / 2;
    let top = row + 1 - reach / 2;
    let fall_top = top + fall_shift(phase_y);
    for upper in 0..HALVES {
        let k = look(simd, &along_y[..2 * reach], upper, rest_y);
        let fall = look(simd, &along_y[2 * reach..4 * reach], upper, rest_y);
        let slope = look(simd, &along_y[4 * reach..], upper, rest_y);
        let [mut falls, mut firsts, mut seconds, mut slants, mut bends] = [[0.0; 8]; 5];
        (fall * dx).store_slice(&mut falls);
        (k * g1).store_slice(&mut firsts);
        (k * g2).store_slice(&mut seconds);
        (k * dy).store_slice(&mut slants);
        (slope * -dx).store_slice(&mut bends);
        for half in 0..HALVES {
            let k = look(simd, &along_x[..2 * reach], half, rest_x);
            let slope = look(simd, &along_x[4 * reach..], half, rest_x);
            let left = left + 8 * half;
            for j in 0..8 {
                let line = 8 * upper + j;
                let fall_start = (fall_top + line) * IMAGES * width + left;
                add(simd, &mut images[fall_start..fall_start + 8], k, falls[j]);
                let start = ((top + line) * IMAGES + 1) * width + left;
                let pixels = &mut images[start..start + 2 * width + 8];
                add(simd, &mut pixels[..8], k, firsts[j]);
                add(simd, &mut pixels[width..width + 8], k, seconds[j]);
                let pixels = &mut pixels[2 * width..2 * width + 8];
                let sum = f32x8::from_slice(simd, pixels);
                let sum = slope.mul_add(f32x8::splat(simd, slants[j]), sum);
                k.mul_add(f32x8::splat(simd, bends[j]), sum).store_slice(pixels);
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
fn add_row<S: Simd, const PRODUCTS: bool>(simd: S, line: &Line, model: &Model, sums: &mut Sums) {
    let lanes = S::f32s::LEN;
    let width = line.grey.len();
    let counted = S::f32s::from_slice(simd, &COUNT[..lanes]);
    let v = line.row as f32;
    let (from, to) = (line.span.0 as f32, line.span.1 as f32);
    let first = line.span.0 / LANES * LANES;
    let end = line.span.1.next_multiple_of(LANES).min(width);
    let (one, zero) = (S::f32s::splat(simd, 1.0), S::f32s::splat(simd, 0.0));
    let row_t1 = S::f32s::splat(simd, model.t[0][0] + v * model.t[0][2]);
    let row_t2 = S::f32s::splat(simd, model.t[1][0] + v * model.t[1][2]);
    for start in (first..end).step_by(lanes) {
        let u = counted + start as f32;
        let before = (S::f32s::splat(simd, to) - u).min(one).max(zero);
        let weight = before * (u - (from - 1.0)).min(one).max(zero);
        let at = |image: usize| &line.images[image * width + start..][..lanes];
        let grey = S::f32s::from_slice(simd, &line.grey[start..start + lanes]);
        let share = S::f32s::from_slice(simd, &line.share[start..start + lanes]);
        let g1 = S::f32s::from_slice(simd, at(1)) * weight;
        let g2 = S::f32s::from_slice(simd, at(2)) * weight;
        let curvature = S::f32s::from_slice(simd, at(3));
        let t1 = u.mul_add(S::f32s::splat(simd, model.t[0][1]), row_t1);
        let t2 = u.mul_add(S::f32s::splat(simd, model.t[1][1]), row_t2);
        let blurred = curvature.mul_add(S::f32s::splat(simd, model.blur), share);
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
        // In the order of `normal::column`; the last makes whole groups.
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
            zero,
        ];
        if PRODUCTS { sums.keep(simd, &columns) } else { sums.add_gradient(simd, &columns) }
    }
}
