//! Contributions of contour nodes to the pixels around them.
//!
//! Each node adds e(y - q) k(x - p) dx to the 8 × 8 (or 16 × 16) pixels (p, q) around it, with the
//! functions of [`super::blur_kernel`]. The sum over the rows above is d(p, q).

use fearless_simd::{Level, Simd, dispatch, f32x8, prelude::*};
use fearless_simd_macros::simd;

use super::{
    blur_kernel::{FUNCTIONS, Kernel, PHASES, fall_shift},
    projection::Nodes,
};

/// Adds the contributions of the nodes, whose pixels all lie in the image.
pub fn scatter(level: Level, nodes: &Nodes, kernel: &Kernel, image: &mut [f32], width: usize) {
    let table = &kernel.table[..];
    match kernel.width {
        8 => dispatch!(level, simd => scatter_all::<_, 1>(simd, nodes, table, image, width)),
        _ => dispatch!(level, simd => scatter_all::<_, 2>(simd, nodes, table, image, width)),
    }
}

/// One of the table's functions at a phase plus `rest`; `values` are followed by their increases.
#[inline(always)]
fn interpolate<S: Simd>(simd: S, values: &[f32], half: usize, rest: f32) -> f32x8<S> {
    let reach = values.len() / 2;
    let low = f32x8::from_slice(simd, &values[8 * half..8 * half + 8]);
    let rise = f32x8::from_slice(simd, &values[reach + 8 * half..reach + 8 * half + 8]);
    rise.mul_add(f32x8::splat(simd, rest), low)
}

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
        // Four quarters in turn: neighbouring nodes would write to pixels that the one before has
        // just written, and wait for it.
        for k in 0..4 {
            scatter_one::<S, HALVES>(simd, nodes, i + k * quarter, table, image, width);
        }
    }
}

#[inline(always)]
fn scatter_one<S: Simd, const HALVES: usize>(
    simd: S,
    nodes: &Nodes,
    i: usize,
    table: &[f32],
    image: &mut [f32],
    width: usize,
) {
    let reach = 8 * HALVES;
    let phase_len = FUNCTIONS * 2 * reach;
    // Not negative: the nodes lie in the window.
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
        (interpolate(simd, &along_y[2 * reach..], upper, rest_y) * dx).store_slice(&mut falls);
        for half in 0..HALVES {
            let k = interpolate(simd, &along_x[..2 * reach], half, rest_x);
            let left = left + 8 * half;
            for (j, fall) in falls.into_iter().enumerate() {
                let start = (top + 8 * upper + j) * width + left;
                add(simd, &mut image[start..start + 8], k, fall);
            }
        }
    }
}
