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
    normal::{COLUMNS, Sums, column},
    view::Nodes,
};
use crate::{ellipse::Chords, frame::Frame};

/// Images that a node adds to.
const IMAGES: usize = 4;
/// Rows are padded to whole vectors of any width.
const LANES: usize = 16;

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
    /// a and b, alike: how steps in the plane move t. `None` without yaw.
    pub turn: Option<[[f32; 3]; 2]>,
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

    /// Whether every node's pixels lie in the window.
    fn holds(&self, nodes: &Nodes, reach: usize) -> bool {
        let within = |list: &[f32], size: usize| {
            let (low, high) = ((reach / 2) as f32, size as f32 - (reach / 2 + 2) as f32);
            // Also false for what is no number.
            list.iter().all(|&at| at >= low && at < high)
        };
        within(&nodes.x, self.width) && within(&nodes.y, self.height)
    }

    /// Scatters the nodes; false, with nothing done, if one lies outside the window.
    pub fn scatter(&mut self, level: Level, nodes: &Nodes, kernel: &Kernel) -> bool {
        if !self.holds(nodes, kernel.width) {
            return false;
        }
        let images = &mut self.images[..];
        let (width, table) = (self.width, &kernel.table[..]);
        match kernel.width {
            8 => dispatch!(level, simd => scatter_all::<_, 1>(simd, nodes, table, images, width)),
            _ => dispatch!(level, simd => scatter_all::<_, 2>(simd, nodes, table, images, width)),
        }
        true
    }

    /// Sums the frame against the model over the pixels within `chords`, and clears the images.
    pub fn gather(
        &mut self,
        level: Level,
        frame: &Frame,
        chords: &Chords,
        model: &Model,
        sums: &mut Sums,
    ) {
        self.share[..self.width].fill(0.0);
        sums.clear();
        for row in 0..self.height {
            let v = self.origin.1 + row as i64;
            let span = if (0..frame.height() as i64).contains(&v) {
                span(frame, chords, v)
            } else {
                (0, 0)
            };
            let images = &mut self.images[row * self.width * IMAGES..][..self.width * IMAGES];
            for (share, fall) in self.share[..self.width].iter_mut().zip(&images[..]) {
                *share += fall;
            }
            if span.0 < span.1 {
                // Whole vectors from the frame; beyond its edges weights are zero.
                let (from, to) = (span.0 - self.origin.0, span.1 - self.origin.0);
                let (from, to) = (from.max(0) as usize, (to.max(0) as usize).min(self.width));
                let pixels = &frame.row(v as usize)[span.0 as usize..span.1 as usize];
                for (grey, &pixel) in self.grey[from..to].iter_mut().zip(pixels) {
                    *grey = f32::from(pixel);
                }
                let line = Line {
                    row,
                    span: (from, to),
                    grey: &self.grey[..self.width],
                    share: &self.share[..self.width],
                    images,
                };
                dispatch!(level, simd => add_row(simd, &line, model, sums));
            }
            images.fill(0.0);
        }
        sums.finish(level);
    }
}

/// Columns of row `v` within the chords and the frame.
fn span(frame: &Frame, chords: &Chords, v: i64) -> (i64, i64) {
    let (from, to) = chords.span(v as f64);
    let from = (from.ceil() as i64).clamp(0, frame.width() as i64);
    let to = (to.ceil() as i64).clamp(from, frame.width() as i64);
    (from, to)
}

/// One row of the window.
struct Line<'a> {
    row: usize,
    span: (usize, usize),
    grey: &'a [f32],
    share: &'a [f32],
    images: &'a [f32],
}

/// The order of the nodes: quarters side by side, since two neighbours in a row would write to the
/// pixels that the one before has just written, and wait for it.
fn interleaved(count: usize) -> impl Iterator<Item = usize> {
    let quarter = count / 4;
    (0..quarter).flat_map(move |i| (0..4).map(move |k| i + k * quarter))
}

#[simd]
fn scatter_all<S: Simd, const HALVES: usize>(
    simd: S,
    nodes: &Nodes,
    table: &[f32],
    images: &mut [f32],
    width: usize,
) {
    let reach = 8 * HALVES;
    // One of the table's functions at a phase, `rest` of a step beyond it.
    let look = |phase: usize, rest: f32, which: usize| -> [f32x8<S>; HALVES] {
        let values = &table[(phase * FUNCTIONS + which) * 2 * reach..][..2 * reach];
        std::array::from_fn(|half| {
            let low = f32x8::from_slice(simd, &values[8 * half..8 * half + 8]);
            let rise = f32x8::from_slice(simd, &values[reach + 8 * half..reach + 8 * half + 8]);
            rise.mul_add(rest, low)
        })
    };
    let phase = |rest: f32| {
        let place = rest * PHASES as f32;
        let phase = (place as usize).min(PHASES - 1);
        (phase, place - phase as f32)
    };
    for i in interleaved(nodes.x.len()) {
        let (x, y) = (nodes.x[i], nodes.y[i]);
        let (column, row) = (x as usize, y as usize);
        let (phase_x, rest_x) = phase(x - column as f32);
        let (phase_y, rest_y) = phase(y - row as f32);
        let (kx, slope_x) = (look(phase_x, rest_x, 0), look(phase_x, rest_x, 2));
        let ky = look(phase_y, rest_y, 0);
        let fall = look(phase_y, rest_y, 1);
        let slope_y = look(phase_y, rest_y, 2);
        let (dx, dy) = (nodes.dx[i], nodes.dy[i]);
        let (g1, g2) = (nodes.by_t[0][i], nodes.by_t[1][i]);
        let mut factors = [[[0.0; 8]; 5]; HALVES];
        for half in 0..HALVES {
            (fall[half] * dx).store_slice(&mut factors[half][0]);
            (ky[half] * g1).store_slice(&mut factors[half][1]);
            (ky[half] * g2).store_slice(&mut factors[half][2]);
            (ky[half] * dy).store_slice(&mut factors[half][3]);
            (slope_y[half] * -dx).store_slice(&mut factors[half][4]);
        }
        let left = column + 1 - reach / 2;
        let top = row + 1 - reach / 2;
        let fall_top = top + fall_shift(phase_y);
        for j in 0..reach {
            let at = |which: usize| factors[j / 8][which][j % 8];
            for half in 0..HALVES {
                let mut add = |row: usize, image: usize, terms: &[(f32x8<S>, f32)]| {
                    let start = (row * IMAGES + image) * width + left + 8 * half;
                    let place = &mut images[start..start + 8];
                    let mut sum = f32x8::from_slice(simd, place);
                    for (value, factor) in terms {
                        sum = value.mul_add(*factor, sum);
                    }
                    sum.store_slice(place);
                };
                add(fall_top + j, 0, &[(kx[half], at(0))]);
                add(top + j, 1, &[(kx[half], at(1))]);
                add(top + j, 2, &[(kx[half], at(2))]);
                add(top + j, 3, &[(slope_x[half], at(3)), (kx[half], at(4))]);
            }
        }
    }
}

#[simd]
fn add_row<S: Simd>(simd: S, line: &Line, model: &Model, sums: &mut Sums) {
    let lanes = S::f32s::LEN;
    let width = line.grey.len();
    let splat = |value: f32| S::f32s::splat(simd, value);
    let counted = S::f32s::from_fn(simd, |lane| lane as f32);
    let v = line.row as f32;
    let (from, to) = (line.span.0 as f32, line.span.1 as f32);
    let first = line.span.0 / LANES * LANES;
    let end = line.span.1.next_multiple_of(LANES).min(width);
    let (one, zero) = (splat(1.0), splat(0.0));
    for start in (first..end).step_by(lanes) {
        let u = counted + start as f32;
        let weight = (splat(to) - u).min(one).max(zero) * (u - (from - 1.0)).min(one).max(zero);
        let load = |list: &[f32], at: usize| S::f32s::from_slice(simd, &list[at..at + lanes]);
        let grey = load(line.grey, start);
        let share = load(line.share, start);
        let g1 = load(line.images, width + start) * weight;
        let g2 = load(line.images, 2 * width + start) * weight;
        let curvature = load(line.images, 3 * width + start);
        let [t1, t2] = model.t.map(|[c, by_u, by_v]| u.mul_add(by_u, splat(v.mul_add(by_v, c))));
        let plane = |[c, by_1, by_2]: [f32; 3]| t1.mul_add(by_1, t2.mul_add(by_2, splat(c)));
        let level = (share + curvature * model.blur).mul_add(model.step, splat(model.white));
        let shade = t1.mul_add(model.light[0], t2 * model.light[1]);
        let level = level.mul_add(shade, level);
        let near = plane(model.nearness);
        let (x, y) = (plane(model.plane[0]), plane(model.plane[1]));
        let radial = t1.mul_add(g1, t2 * g2);
        let moved = |[along_1, along_2, away]: [f32; 3]| {
            g1.mul_add(along_1, g2.mul_add(along_2, radial * -away))
        };
        let lift = moved(model.lift);
        let to_middle = g1.mul_add(model.middle[0], g2.mul_add(model.middle[1], -radial));
        let mut columns = sums.next(lanes);
        columns.put(column::RESIDUAL, ((grey - level) * weight).as_slice());
        columns.put(column::WHITE, weight.as_slice());
        columns.put(column::STEP, (share * weight).as_slice());
        columns.put(column::BLUR, (curvature * weight).as_slice());
        let lit = level * weight;
        columns.put(column::LIGHT, (lit * t1).as_slice());
        columns.put(column::LIGHT + 1, (lit * t2).as_slice());
        columns.put(column::SHIFT, (near * g1).as_slice());
        columns.put(column::SHIFT + 1, (near * g2).as_slice());
        columns.put(column::RANGE, (near * to_middle).as_slice());
        columns.put(column::TILT, (y * lift).as_slice());
        columns.put(column::TILT + 1, (x * -lift).as_slice());
        if let Some([along_a, along_b]) = model.turn {
            columns.put(column::YAW, (x * moved(along_b) - y * moved(along_a)).as_slice());
        }
        columns.done(simd);
    }
    const { assert!(COLUMNS == 12) };
}
