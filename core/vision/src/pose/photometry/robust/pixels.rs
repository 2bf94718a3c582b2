//! Columns of each counted pixel, summed over the cells and over the ring.
//!
//! Image and columns are those of the plain fit ([`columns`](super::super::model::columns)). Here each
//! cell has its own levels, clipped pixels have their own likelihood, and one column is the derivative
//! by a motion of both rims into black.

use fearless_simd::{Level, dispatch, prelude::*};
use fearless_simd_macros::simd;

use super::{
    RobustScratch,
    cells::{Reference, WIDTH},
};
use crate::{
    normal_distribution,
    pose::photometry::model::{
        column_products::{COLUMNS, ProductSums, STILL, column},
        columns::{LANES, Pack, PixelModel, add_row},
        window::Window,
    },
};

/// What the pixels of a cell need.
#[derive(Clone, Copy, Debug)]
pub struct CellLevels {
    white: f32,
    step: f32,
    /// Step over that of the reference.
    contrast: f32,
    /// 1 for a kept cell, else 0.
    kept: f32,
}

/// Where the counted pixels of a window are summed.
pub struct PixelSums<'a> {
    pub reference: Reference,
    /// Standard deviation of a pixel.
    pub deviation: f64,
    pub window: &'a mut Window,
    /// Products over the kept cells.
    pub sums: &'a mut ProductSums,
    pub robust: &'a mut RobustScratch,
}

/// Sums the counted pixels of a window, whose image is scattered.
pub fn add_all(level: Level, model: &PixelModel, sums: PixelSums) {
    dispatch!(level, simd => add_each(simd, model, sums));
}

#[simd]
fn add_each<S: Simd>(simd: S, model: &PixelModel, into: PixelSums) {
    let PixelSums { reference, deviation, window, sums, robust } = into;
    let RobustScratch { assignment, cells, levels, .. } = robust;
    levels.clear();
    for cell in cells.iter_mut() {
        cell.sums = Default::default();
        levels.push(CellLevels {
            white: cell.levels[0] as f32,
            step: cell.levels[1] as f32,
            contrast: (cell.levels[1] / reference.levels[1]) as f32,
            kept: f32::from(u8::from(cell.kept)),
        });
    }
    let levels = &levels[..];
    sums.clear();
    window.draw(simd);
    let mut assignment = &assignment[..];
    window.for_each_row(|line, pixels| {
        let from = line.span.0;
        let (own, rest) = assignment.split_at(pixels.len());
        assignment = rest;
        let of_pack = |pack: Pack| &own[pack.start - from..][..pack.count];
        add_row::<S, false, true>(
            simd,
            line,
            model,
            |pack| {
                let [mut white, mut step] = [[0.0; LANES]; 2];
                for (lane, &cell) in of_pack(pack).iter().enumerate() {
                    let level = &levels[usize::from(cell)];
                    (white[lane], step[lane]) = (level.white, level.step);
                }
                [
                    S::f32s::from_slice(simd, &white[..S::f32s::LEN]),
                    S::f32s::from_slice(simd, &step[..S::f32s::LEN]),
                ]
            },
            |columns, pack| {
                let cells_of = of_pack(pack);
                let grey = &pixels[pack.start - from..][..pack.count];
                let [mut contrast, mut kept] = [[0.0; LANES]; 2];
                for (lane, &cell) in cells_of.iter().enumerate() {
                    let level = &levels[usize::from(cell)];
                    (contrast[lane], kept[lane]) = (level.contrast, level.kept);
                }
                let contrast = S::f32s::from_slice(simd, &contrast[..S::f32s::LEN]);
                let kept = S::f32s::from_slice(simd, &kept[..S::f32s::LEN]);
                let mut columns = *columns;
                for index in (column::BLUR..=column::BLUR).chain(column::SHIFT..STILL) {
                    columns[index] *= contrast;
                }
                if grey.iter().any(|&grey| grey == 0 || grey == 255) {
                    clip(simd, &mut columns, grey, deviation, |lane, excess| {
                        cells[usize::from(cells_of[lane])].sums[0][0] += excess;
                    });
                }
                let by_pixel = transposed(simd, &columns);
                for (own, &cell) in by_pixel.chunks_exact(WIDTH).zip(cells_of) {
                    cells[usize::from(cell)].add(simd, own);
                }
                for values in columns.iter_mut().take(STILL) {
                    *values *= kept;
                }
                sums.push::<S, false>(simd, &columns, pack.count);
            },
        );
    });
    sums.finish::<S, false>(simd);
    window.clear(simd);
}

/// The columns of one pixel after those of another, padded with zeros.
#[inline(always)]
fn transposed<S: Simd>(simd: S, columns: &[S::f32s; COLUMNS]) -> [f32; WIDTH * LANES] {
    let mut rows = [S::f32s::splat(simd, 0.0); WIDTH];
    rows[..STILL].copy_from_slice(&columns[..STILL]);
    // Each round moves the highest bit of the index of row and lane to its lowest place.
    for _ in 0..WIDTH.ilog2() {
        let before = rows;
        for row in 0..WIDTH / 2 {
            (rows[2 * row], rows[2 * row + 1]) = before[row].interleave(before[row + WIDTH / 2]);
        }
    }
    let mut pixels = [0.0; WIDTH * LANES];
    for (row, pixels) in rows.iter().zip(pixels.chunks_exact_mut(S::f32s::LEN)) {
        row.store_slice(pixels);
    }
    pixels
}

/// Replaces residuals and weights of clipped pixels, and passes what their misfit exceeds the square
/// of the residual by.
#[inline(always)]
fn clip<S: Simd>(
    simd: S,
    columns: &mut [S::f32s; COLUMNS],
    grey: &[u8],
    deviation: f64,
    mut add: impl FnMut(usize, f32),
) {
    let lanes = S::f32s::LEN;
    let (mut residuals, mut roots) = ([0.0; LANES], [1.0; LANES]);
    columns[0].store_slice(&mut residuals[..lanes]);
    for (lane, &grey) in grey.iter().enumerate() {
        let grey = f64::from(grey);
        if let Some(term) = ClippedTerm::new(grey, grey - f64::from(residuals[lane]), deviation) {
            residuals[lane] = term.residual as f32;
            roots[lane] = term.root as f32;
            add(lane, (term.misfit - term.residual * term.residual) as f32);
        }
    }
    let roots = S::f32s::from_slice(simd, &roots[..lanes]);
    for values in columns.iter_mut().skip(1) {
        *values *= roots;
    }
    columns[0] = S::f32s::from_slice(simd, &residuals[..lanes]);
}

/// Contribution of a clipped pixel to the likelihood.
struct ClippedTerm {
    /// Residual over the root of its weight.
    residual: f64,
    /// Root of the weight.
    root: f64,
    /// -2 s² times the log-likelihood.
    misfit: f64,
}

impl ClippedTerm {
    /// A grey value against a level, with noise of this standard deviation; `None` within the scale.
    #[inline]
    fn new(grey: f64, level: f64, deviation: f64) -> Option<Self> {
        let (sign, z) = if grey >= 255.0 {
            (1.0, (254.5 - level) / deviation)
        } else if grey <= 0.0 {
            (-1.0, (level - 0.5) / deviation)
        } else {
            return None;
        };
        if z < -5.0 {
            return Some(Self { residual: 0.0, root: 0.0, misfit: 0.0 });
        }
        let tail = normal_distribution::tail(z);
        let root = (tail.hazard * (tail.hazard - z)).max(0.0).sqrt();
        let variance = deviation * deviation;
        Some(Self {
            residual: sign * deviation * tail.hazard / root,
            root,
            misfit: variance * tail.minus_two_ln,
        })
    }
}
