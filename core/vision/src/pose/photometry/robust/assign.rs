//! The cell of each counted pixel.

use fearless_simd::{Level, dispatch, prelude::*};
use fearless_simd_macros::simd;

use crate::pose::photometry::model::{
    columns::{LANES, PixelModel},
    window::Window,
};

/// Appends the cells of the counted pixels in the window's order, those of the inner rim after those
/// of the outer one; returns the number of clipped pixels. `ratio` is that of the rims' radii, and
/// `counts` the numbers of their cells.
pub fn assign(
    level: Level,
    window: &Window,
    model: &PixelModel,
    ratio: f64,
    counts: [usize; 2],
    assignment: &mut Vec<u16>,
) -> usize {
    dispatch!(level, simd => assign_all(simd, window, model, ratio, counts, assignment))
}

#[simd]
fn assign_all<S: Simd>(
    simd: S,
    window: &Window,
    model: &PixelModel,
    ratio: f64,
    counts: [usize; 2],
    assignment: &mut Vec<u16>,
) -> usize {
    // For the instruction set only: the loops over lanes are vectorized by the compiler.
    let _ = simd;
    let middle2 = (0.5 * (1.0 + ratio as f32)).powi(2);
    let [outer, inner] = counts.map(|count| count as f32);
    let last = [outer - 1.0, inner - 1.0];
    let mut clipped = 0;
    for row in window.counted_rows() {
        clipped += row.grey.iter().filter(|&&grey| grey == 0 || grey == 255).count();
        let v = row.row as f32;
        // A function linear in the column: its value at column 0 and its slope.
        let [t1, t2] = model.t.map(|[c, by_u, by_v]| [c + by_v * v, by_u]);
        let of = |terms: &[f32; 3]| {
            let at = |part: usize| terms[1] * t1[part] + terms[2] * t2[part];
            [terms[0] + at(0), at(1)]
        };
        let (near, x, y) = (of(&model.nearness), of(&model.plane[0]), of(&model.plane[1]));
        for start in (0..row.grey.len()).step_by(LANES) {
            let mut cells = [0u16; LANES];
            for (lane, cell) in cells.iter_mut().enumerate() {
                let u = (row.first_column + start + lane) as f32;
                let [near, x, y] = [near, x, y].map(|[at_0, slope]| at_0 + slope * u);
                let is_inner = x * x + y * y < middle2 * near * near;
                let turn = turn(x, y);
                let of_outer = (turn * outer).min(last[0]);
                let of_inner = (turn * inner).min(last[1]) + outer;
                *cell = if is_inner { of_inner } else { of_outer } as u16;
            }
            let count = LANES.min(row.grey.len() - start);
            assignment.extend_from_slice(&cells[..count]);
        }
    }
    clipped
}

/// Direction in turns from 0 to 1, to a thousandth.
#[inline(always)]
fn turn(x: f32, y: f32) -> f32 {
    let (long, short) = (x.abs().max(y.abs()), x.abs().min(y.abs()));
    let tangent = short / long.max(f32::MIN_POSITIVE);
    // Rajan et al. 2006, eq. 7, over 2π.
    let eighth = tangent * (0.125 + 0.043_45 * (1.0 - tangent));
    let quarter = if y.abs() > x.abs() { 0.25 - eighth } else { eighth };
    let half = if x < 0.0 { 0.5 - quarter } else { quarter };
    if y < 0.0 { 1.0 - half } else { half }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_turns() {
        for degree in 0..360 {
            let (sin, cos) = f64::from(degree).to_radians().sin_cos();
            let found = turn(3.0 * cos as f32, 3.0 * sin as f32);
            let off = (f64::from(found) - f64::from(degree) / 360.0 + 0.5).rem_euclid(1.0) - 0.5;
            assert!(off.abs() < 1e-3, "{degree}: {found}");
        }
        assert_eq!(turn(0.0, 0.0), 0.0);
    }
}
