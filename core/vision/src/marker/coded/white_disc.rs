//! A coded roundel's white disc, from its rim between the teeth.
//!
//! In the middle of each slot without a tooth, the half level is located along a ray of the
//! print. Teeth on both sides reduce the white by blur: at distances a and b from their sides,
//! in blurs, a share Φ(a) + Φ(b) - 1 remains, and the half level is lower accordingly. The level of a gap is
//! sampled well inside it, corrected for the light of core and ring.
//!
//! Blur with deviation σ shifts the half level of a rim of curvature κ inwards by κ/2 times the mean square
//! distance along the rim of the mixed light. Between teeth that is a truncated normal distribution,
//!
//!   σ² (1 - (a φ(a) + b φ(b)) / (Φ(a) + Φ(b) - 1)).
//!
//! Half of the light at the rim comes from its white side, on average √(2/π) σ further in, where gaps are
//! narrower. Size and centre are fitted; the shape is that of the outer rim under the plane map.

use nalgebra::{Matrix3, Vector3};

use crate::{
    marker::{
        code::CodeLayout,
        coded::{outer_rim::OuterRim, plane_map::PlaneMap, rim_points::crossing, sampler::Sampler},
    },
    normal_distribution::normal_each,
};

/// Largest number of iterations …
const TURNS: usize = 2;
/// … which end when the rim moves by less than this, pixels.
const SETTLED_PX: f64 = 0.05;
/// Where the level of a gap is sampled, as a share of the white disc's radius.
const LEVEL_AT: f64 = 0.8;
/// Step of the plane map's numerical derivatives, as a share of the radius.
const STEP: f64 = 0.02;
/// Search range of the edge, pixels.
const REACH_PX: f64 = 3.0;
/// √(2/π): mean distance inside of an edge of the light seen at it, in deviations.
const MEAN_INSIDE: f64 = 0.797_884_560_8;
/// Largest shift of the disc's middle, in units of the outer rim's radius.
const MAX_SHIFT: f64 = 0.1;
/// Smallest share of white that blur leaves in a usable gap.
const MIN_OPEN: f64 = 0.2;

/// A gap between teeth, or one slot of it, in the plane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Gap {
    /// cos and sin of its middle's angle.
    pub direction: (f64, f64),
    /// Angles to the next teeth on both sides, radians.
    pub to_teeth_rad: (f64, f64),
}

/// The white disc's rim, in the plane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Disc {
    /// In units of the outer rim's radius.
    pub radius: f64,
    /// Displacement of its middle from that of the plane map.
    pub shift: (f64, f64),
}

/// Fits the white disc's rim to the gaps between teeth. `None` without
/// enough gaps.
pub(crate) fn disc(
    sampler: &Sampler,
    plane: &PlaneMap,
    ratio: f64,
    gaps: impl Iterator<Item = Gap> + Clone,
    rim: &OuterRim,
) -> Option<Disc> {
    let mut radius = ratio;
    let mut shift = (0.0, 0.0);
    for _ in 0..TURNS {
        let mut normal = Matrix3::<f64>::zeros();
        let mut right = Vector3::<f64>::zeros();
        for gap in gaps.clone() {
            let imaged = ImagedGap::new(plane, radius, shift, &gap);
            let Some((share, weight)) = imaged.outwards(sampler, rim.black, rim.blur_px) else {
                continue;
            };
            let (cos, sin) = gap.direction;
            let row = Vector3::new(1.0, cos, sin);
            normal += row * row.transpose() * weight;
            right += row * (share * weight);
        }
        let change = normal.cholesky()?.solve(&right);
        let moved_px = change.amax() * radius * plane.reach_px();
        shift = (shift.0 + radius * change[1], shift.1 + radius * change[2]);
        radius *= 1.0 + change[0];
        if moved_px < SETTLED_PX {
            break;
        }
    }
    let fits =
        radius > 0.5 * ratio && radius < 0.5 * (1.0 + ratio) && shift.0.hypot(shift.1) < MAX_SHIFT;
    fits.then_some(Disc { radius, shift })
}

/// A gap as imaged.
struct ImagedGap {
    to_teeth_rad: (f64, f64),
    /// Where its middle meets the rim, and where its level is sampled, pixels.
    rim: (f64, f64),
    inside: (f64, f64),
    /// Along the ray, per radius.
    along: (f64, f64),
    /// Along the rim, per radian.
    aside: (f64, f64),
}

impl ImagedGap {
    fn new(plane: &PlaneMap, radius: f64, shift: (f64, f64), gap: &Gap) -> Self {
        let (cos, sin) = gap.direction;
        let at = |x: f64, y: f64| {
            let image = plane.image((radius * x + shift.0, radius * y + shift.1));
            (image.u, image.v)
        };
        let rim = at(cos, sin);
        let by = |to: (f64, f64)| ((to.0 - rim.0) / STEP, (to.1 - rim.1) / STEP);
        Self {
            to_teeth_rad: gap.to_teeth_rad,
            rim,
            inside: at(LEVEL_AT * cos, LEVEL_AT * sin),
            along: by(at((1.0 + STEP) * cos, (1.0 + STEP) * sin)),
            aside: by(at(cos - STEP * sin, sin + STEP * cos)),
        }
    }

    /// Distance of the edge outwards as a share of the radius, and its weight; `None` without an
    /// edge.
    fn outwards(&self, sampler: &Sampler, black: f64, blur_px: f64) -> Option<(f64, f64)> {
        let length = |(u, v): (f64, f64)| (u * u + v * v).sqrt();
        let (along_px, aside_px) = (length(self.along), length(self.aside));
        let area = (self.along.0 * self.aside.1 - self.along.1 * self.aside.0).abs();
        if !(along_px > 0.0 && aside_px > 0.0 && area > 0.0) {
            return None;
        }
        // Across the rim, per radius, and across a ray, per radian, in blurs.
        let (size, turn) = (area / aside_px / blur_px, area / along_px / blur_px);
        let (one, other) = (self.to_teeth_rad.0 * turn, self.to_teeth_rad.1 * turn);
        let normal = |z: f64| {
            let (density, share) = normal_each(z as f32);
            (f64::from(density), f64::from(share))
        };
        let open = |at: f64| normal(one * at).1 + normal(other * at).1 - 1.0;
        let cut_off = one * normal(one).0 + other * normal(other).0;
        let at_rim = open(1.0) - MEAN_INSIDE * cut_off / size;
        if at_rim < MIN_OPEN {
            return None;
        }
        // The sampled level has lost light to the ring, and gained from the core.
        let from_core = normal((CodeLayout::CORE_SHARE - LEVEL_AT) * size).1;
        let from_ring = normal((LEVEL_AT - 1.0) * size).1;
        let expected = open(LEVEL_AT) * (1.0 - from_ring - from_core) + from_core;
        let level = sampler.at(self.inside.0, self.inside.1) - black;
        let half = black + 0.5 * level * at_rim / expected;
        let (du, dv) = (self.along.0 / along_px, self.along.1 / along_px);
        let dark =
            |out_px: f64| half - sampler.at(self.rim.0 + out_px * du, self.rim.1 + out_px * dv);
        let (out_px, _) = crossing(dark, REACH_PX)?;
        // The rim's second derivative by its angle is a radius, inwards: κ = area/aside³.
        let drawn_px = 0.5 * blur_px * blur_px * (1.0 - cut_off / at_rim) * area / aside_px.powi(3);
        let share = out_px / along_px + drawn_px * aside_px / area;
        Some((share, (at_rim * size).powi(2)))
    }
}
