//! Columns of each counted pixel, summed over the cells.
//!
//! Image and derivatives are those of the plain fit ([`window`](super::super::model::window)). Here
//! each cell has its own levels, clipped pixels have their own likelihood, and two columns are the
//! derivatives by a motion of either rim into black. Across an edge that is much longer than its
//! blur, this is the gradient's length.

use fearless_simd::{Level, dispatch, prelude::*};
use fearless_simd_macros::simd;

use super::{
    RobustScratch,
    cells::{Cell, WIDTH},
};
use crate::{
    normal_distribution,
    pose::photometry::model::{
        columns::{LANES, PixelModel},
        differences::{Differences, differences},
        window::Window,
    },
};

/// Sums the counted pixels of a window, whose image is scattered, over the cells, with noise of
/// this standard deviation.
pub fn add_all(
    level: Level,
    model: &PixelModel,
    deviation: f64,
    window: &mut Window,
    robust: &mut RobustScratch,
) {
    dispatch!(level, simd => add_each(simd, model, deviation, window, robust));
}

#[simd]
fn add_each<S: Simd>(
    simd: S,
    model: &PixelModel,
    deviation: f64,
    window: &mut Window,
    robust: &mut RobustScratch,
) {
    let RobustScratch { assignment, cells, .. } = robust;
    for cell in cells.iter_mut() {
        cell.sums = Default::default();
    }
    window.draw(simd);
    let lanes = S::f32s::LEN;
    let mut assignment = assignment.iter();
    for row in window.counted_rows() {
        let around = window.image_rows(row.row);
        for (pack, grey) in row.grey.chunks(lanes).enumerate() {
            let start = row.first_column + pack * lanes;
            let Differences { share, slope, curvature, .. } =
                differences::<S, false>(simd, &around, start, &model.taps);
            let share = curvature.mul_add(S::f32s::splat(simd, model.blur), share);
            let mut image = [[0.0; LANES]; 4];
            for (list, values) in image.iter_mut().zip([share, slope[0], slope[1], curvature]) {
                values.store_slice(&mut list[..lanes]);
            }
            for ((lane, &grey), &cell) in grey.iter().enumerate().zip(&mut assignment) {
                let pixel = Pixel {
                    column: (start + lane) as f32,
                    row: row.row as f32,
                    share: image[0][lane],
                    slope: [image[1][lane], image[2][lane]],
                    curvature: image[3][lane],
                };
                let cell = &mut cells[usize::from(cell)];
                let (columns, level) = pixel.columns(model, cell);
                let term = pixel_term(f64::from(grey), f64::from(level), deviation);
                let mut weighted = columns.map(|column| column * term.root as f32);
                weighted[0] = term.residual as f32;
                cell.add(simd, &weighted);
                cell.sums[0][0] += (term.misfit - term.residual * term.residual) as f32;
            }
        }
    }
    window.clear(simd);
}

/// The image at a pixel.
struct Pixel {
    /// In the window.
    column: f32,
    row: f32,
    /// d.
    share: f32,
    /// ∇d.
    slope: [f32; 2],
    /// ∇²d.
    curvature: f32,
}

impl Pixel {
    /// Columns, and the level of the model.
    #[inline(always)]
    fn columns(&self, model: &PixelModel, cell: &Cell) -> ([f32; WIDTH], f32) {
        let Self { share, curvature, .. } = *self;
        // d changes by -v·∇d where the contour moves by v.
        let [right, down] = self.slope.map(|part| -part);
        let [t1, t2] = model.t.map(|[c, by_u, by_v]| c + by_u * self.column + by_v * self.row);
        let [m11, m12, m21, m22] = model.slope;
        let (g1, g2) = (right * m11 + down * m21, right * m12 + down * m22);
        let light = 1.0 + model.light[0] * t1 + model.light[1] * t2;
        let [white, step] = cell.levels.map(|level| level as f32);
        let level = (white + step * share) * light;
        let of = |terms: &[f32; 3]| terms[0] + terms[1] * t1 + terms[2] * t2;
        let (near, x, y) = (of(&model.nearness), of(&model.plane[0]), of(&model.plane[1]));
        let radial = t1 * g1 + t2 * g2;
        let along = |v: &[f32; 3]| v[0] * g1 + v[1] * g2 - v[2] * radial;
        let lift = along(&model.lift);
        let to_middle = along(&[model.middle[0], model.middle[1], 1.0]);
        let mut spread = [0.0; 2];
        spread[cell.rim] = -(right * right + down * down).sqrt() * light;
        let columns = [
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
            spread[0],
            spread[1],
            0.0,
            0.0,
            0.0,
        ];
        (columns, level)
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

/// Term of a grey value against a level, with noise of this standard deviation.
#[inline]
fn pixel_term(grey: f64, level: f64, deviation: f64) -> PixelTerm {
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
    let tail = normal_distribution::tail(z);
    let root = (tail.hazard * (tail.hazard - z)).max(0.0).sqrt();
    let variance = deviation * deviation;
    PixelTerm {
        residual: sign * deviation * tail.hazard / root,
        root,
        misfit: variance * tail.minus_two_ln,
    }
}
