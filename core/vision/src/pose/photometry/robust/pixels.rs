//! Columns of each counted pixel, summed over the cells.

use fearless_simd::{Level, Simd, dispatch};
use fearless_simd_macros::simd;

use super::{RobustScratch, image::IMAGES};
use crate::{
    normal_distribution::{Table, Tail},
    pose::photometry::solver::{linearize, problem::Problem, state::State},
};

#[derive(Clone, Copy, Debug)]
pub struct Pixel {
    /// In the window.
    pub column: u16,
    pub row: u16,
    pub cell: u16,
    pub grey: f32,
}

pub fn add_all(
    level: Level,
    problem: &Problem,
    state: &State,
    robust: &mut RobustScratch,
    deviation: f64,
) {
    dispatch!(level, simd => add_each(simd, problem, state, robust, deviation));
}

#[simd]
fn add_each<S: Simd>(
    simd: S,
    problem: &Problem,
    state: &State,
    robust: &mut RobustScratch,
    deviation: f64,
) {
    let RobustScratch { normal: table, images, pixels, cells, .. } = robust;
    let pixel_model = linearize::pixel_model(problem, state, state.blur2.sqrt(), images.origin());
    for cell in cells.iter_mut() {
        cell.sums = Default::default();
    }
    let planes: [&[f32]; IMAGES] = std::array::from_fn(|index| images.plane(index));
    for pixel in pixels.iter() {
        let cell = &mut cells[usize::from(pixel.cell)];
        let index = usize::from(pixel.row) * images.width() + usize::from(pixel.column);
        let [share, right, down, curvature, outer, inner] = planes.map(|plane| plane[index]);
        let (p, q) = (f32::from(pixel.column), f32::from(pixel.row));
        let [t1, t2] = pixel_model.t.map(|[c, by_p, by_q]| c + by_p * p + by_q * q);
        let slope = &problem.lens.slope;
        let g1 = right * slope.m11 as f32 + down * slope.m21 as f32;
        let g2 = right * slope.m12 as f32 + down * slope.m22 as f32;
        let light = 1.0 + pixel_model.light[0] * t1 + pixel_model.light[1] * t2;
        let [white, step] = cell.levels.map(|level| level as f32);
        let level = (white + step * share) * light;
        let pixel_term = pixel_term(table, f64::from(pixel.grey), f64::from(level), deviation);
        let of = |terms: &[f32; 3]| terms[0] + terms[1] * t1 + terms[2] * t2;
        let (near, x, y) =
            (of(&pixel_model.nearness), of(&pixel_model.plane[0]), of(&pixel_model.plane[1]));
        let radial = t1 * g1 + t2 * g2;
        let along = |v: &[f32; 3]| v[0] * g1 + v[1] * g2 - v[2] * radial;
        let lift = along(&pixel_model.lift);
        let to_middle = along(&[pixel_model.middle[0], pixel_model.middle[1], 1.0]);
        let mut columns = [
            0.0,
            light,
            share * light,
            curvature * light,
            level * t1,
            level * t2,
            near * g1 * light,
            near * g2 * light,
            near * to_middle * light,
            y * lift * light,
            -x * lift * light,
            outer * light,
            inner * light,
            0.0,
            0.0,
            0.0,
        ];
        for column in &mut columns {
            *column *= pixel_term.root as f32;
        }
        columns[0] = pixel_term.residual as f32;
        cell.add(simd, &columns);
        cell.sums[0][0] += (pixel_term.misfit - pixel_term.residual * pixel_term.residual) as f32;
    }
}

/// Contribution of a pixel to the likelihood.
struct PixelTerm {
    /// Residual over the root of its weight.
    residual: f64,
    /// Root of the weight.
    root: f64,
    /// -2 s² times the log-likelihood.
    misfit: f64,
}

/// Of a grey value against a level, with noise of this standard deviation.
#[inline]
fn pixel_term(table: &Table, grey: f64, level: f64, deviation: f64) -> PixelTerm {
    let (sign, z) = if grey >= 255.0 {
        (1.0, (254.5 - level) / deviation)
    } else if grey <= 0.0 {
        (-1.0, (level - 0.5) / deviation)
    } else {
        let residual = grey - level;
        return PixelTerm { residual, root: 1.0, misfit: residual * residual };
    };
    if z < -5.0 {
        return PixelTerm { residual: 0.0, root: 0.0, misfit: 0.0 };
    }
    let Tail { hazard: pull, minus_two_ln: misfit } = table.tail(z);
    let root = (pull * (pull - z)).max(0.0).sqrt();
    let variance = deviation * deviation;
    PixelTerm { residual: sign * deviation * pull / root, root, misfit: variance * misfit }
}
