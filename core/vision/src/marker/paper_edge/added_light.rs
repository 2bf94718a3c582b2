//! What the paper's edge adds to the level of a pixel.

use super::{PaperEdge, SECTORS};
use crate::{ellipse::Ellipse, normal_distribution::normal_each};

/// Variance that interpolation has added to the blur of the fit, px².
const INTERPOLATION_PX2: f64 = 1.0 / 6.0;
/// Distances from the rim in the table, pixels: the first one, their step, and their number.
const FIRST_PX: f64 = -4.0;
const STEP_PX: f64 = 0.25;
const STEPS: usize = 36;
/// Blurs before the margin's end from which the paper's edge counts.
const REACH: f64 = 3.0;

/// Levels by sector and distance from the outer rim.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AddedLight {
    outer: Ellipse,
    /// Cosine and sine of the ellipse's angle.
    axis: (f64, f64),
    /// Square of the size, relative to the rim, inside of which nothing is added.
    unaffected: f64,
    levels: [[f32; STEPS]; SECTORS],
}

impl PaperEdge {
    /// A table of what the paper's edge adds.
    pub fn added_light(&self) -> AddedLight {
        let blur_px = (self.blur_px * self.blur_px - INTERPOLATION_PX2).sqrt();
        let levels = self.margins.each_ref().map(|margin| {
            std::array::from_fn(|index| {
                let away_px = FIRST_PX + STEP_PX * index as f64;
                let beyond = (away_px - margin.width_px) / blur_px;
                margin.step as f32 * normal_each(beyond as f32).1
            })
        });
        let first_px = self.narrowest_px() - REACH * blur_px;
        let semiaxis_px =
            if first_px > 0.0 { self.outer.semi_major_px } else { self.outer.semi_minor_px };
        let size = (1.0 + first_px.max(FIRST_PX) / semiaxis_px).max(0.0);
        let (sin, cos) = self.outer.angle_rad.sin_cos();
        AddedLight { outer: self.outer, axis: (cos, sin), unaffected: size * size, levels }
    }
}

impl AddedLight {
    /// Grey levels at a point.
    pub fn at(&self, u: f64, v: f64) -> f64 {
        let outer = &self.outer;
        let (cos, sin) = self.axis;
        let (du, dv) = (u - outer.center.u, v - outer.center.v);
        let x = (du * cos + dv * sin) / outer.semi_major_px;
        let y = (dv * cos - du * sin) / outer.semi_minor_px;
        let square = x * x + y * y;
        if square <= self.unaffected {
            return 0.0;
        }
        let size = square.sqrt();
        let (per_a, per_b) = (x / outer.semi_major_px, y / outer.semi_minor_px);
        let away_px = (size - 1.0) * size / (per_a * per_a + per_b * per_b).sqrt();
        let (first, share) = split(((away_px - FIRST_PX) / STEP_PX).clamp(0.0, (STEPS - 2) as f64));
        let turns = y.atan2(x) / std::f64::consts::TAU;
        let (sector, sector_share) = split((turns + 2.0) * SECTORS as f64 - 0.5);
        let level = |sector: usize| {
            let levels = &self.levels[sector % SECTORS];
            let (here, next) = (f64::from(levels[first]), f64::from(levels[first + 1]));
            here + (next - here) * share
        };
        let here = level(sector);
        here + (level(sector + 1) - here) * sector_share
    }
}

/// The whole part of a positive number, and the rest.
fn split(number: f64) -> (usize, f64) {
    let whole = number as usize;
    (whole, number - whole as f64)
}
