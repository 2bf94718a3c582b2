//! Normal equations at a state: information, gradient, steps, and the criterion of the last step.

use std::ops::Range;

use super::{
    cholesky::{Cholesky, Information, Unknowns},
    state::{BLUR, LIGHT, MOTION, SHIFT, STEP, State, TILT, UNKNOWNS, WHITE, column_of},
};
use crate::pose::photometry::model::column_products::{Products, column};

#[derive(Clone, Debug)]
pub struct NormalEquations {
    pub information: Information,
    /// From columns to unknowns.
    pub scale: Unknowns,
    pub gradient: Unknowns,
    /// Sum of squared residuals, grey levels².
    pub misfit: f64,
    pub pixels: f64,
    /// Correlation of the residuals ([`residual_patches`](super::super::model::residual_patches)).
    pub patch_ratio: f64,
    pub mirror: MirrorProducts,
    pub ring: RingScale,
    /// Whether the information is that of an earlier state.
    pub reused: bool,
    /// Information about a displacement of both rims.
    edge_information: f64,
    /// Information about the elongation of both rims.
    pub elongation: f64,
}

/// Products of the mirrored pose's column.
#[derive(Clone, Debug)]
pub struct MirrorProducts {
    pub with_unknowns: Unknowns,
    pub with_residual: f64,
    pub own: f64,
}

/// Size of a ring in the image, and prior of its motion.
#[derive(Clone, Copy, Debug)]
pub struct RingScale {
    /// Radius of the outer rim.
    pub radius_px: f64,
    /// Radius of the disc over that of the outer rim.
    pub disc_ratio: f64,
    /// Displacement of the outer rim by the mirrored pose.
    pub mirror_px: f64,
    /// p₃ s: metres per unit of shift.
    pub unit_m: f64,
    /// Variance of μ besides its own size, px⁴; `None` where the motion is held.
    pub motion_prior: Option<f64>,
}

const MIRROR: usize = column::MIRROR;
/// Limits of the last step. Mean displacement of the rims, pixels …
const LAST_MOVE_PX: f64 = 0.03;
/// … and its effect on the misfit, in variances. The error of the columns is then far below the
/// noise.
const LAST_MOVE: f64 = 25.0;
/// Displacement by the square of the rotation, pixels.
const LAST_BEND_PX: f64 = 0.002;
/// Change of σ² over the radius, px² per px: the smaller the rims, the less they separate blur from
/// size and levels, and the more the errors of the columns matter.
const LAST_BLUR_PX: f64 = 8e-4;
/// Change of μ, px², besides [`LAST_MOVE`]: the errors of the columns matter far less for it than
/// its own noise.
const LAST_MOTION_PX2: f64 = 1.0;
/// Standard deviation of the light's gradient: relative change over a radius.
const LIGHT_PRIOR: f64 = 0.1;
/// [`correlation_ratio`](super::super::model::residual_patches::correlation_ratio) of noise exceeds
/// 1 by at most this over the root of the number of pixels: more than three standard deviations of
/// 5.3 (over 15,000 rendered rings), since a clean ring taken for a disturbed one costs as much
/// time as a hundred others.
const PATCH_SLACK: f64 = 18.0;
/// Beyond this multiple of [`PATCH_SLACK`] the residual is not that of a clean ring.
const MISMATCH_FACTOR: f64 = 1.7;

impl NormalEquations {
    /// From the products of all columns, or of those without motion.
    pub fn new<const COUNT: usize>(
        state: &State,
        products: &Products<COUNT>,
        ring: RingScale,
    ) -> Self {
        let RingScale { radius_px, disc_ratio, motion_prior, .. } = ring;
        let step = state.step;
        let mut scale = Unknowns::repeat(1.0);
        scale[BLUR] = 0.5 * step;
        scale.fixed_rows_mut::<2>(MOTION).fill(step / 48.0);
        scale.fixed_rows_mut::<5>(SHIFT).fill(step);
        let mut information = Information::zeros();
        let (mut gradient, mut mirror) = (Unknowns::zeros(), Unknowns::zeros());
        let first = if motion_prior.is_some() { MOTION } else { WHITE };
        for i in first..UNKNOWNS {
            let column = column_of(i);
            for j in first..UNKNOWNS {
                information[(i, j)] = products[(column, column_of(j))] * scale[i] * scale[j];
            }
            gradient[i] = products[(0, column)] * scale[i];
            mirror[i] = products[(column, MIRROR)] * scale[i] * step;
        }
        // A straight edge of standard deviation τ has the information C²/(2 √π τ) per pixel of
        // length about its position.
        let edge = step * step / (2.0 * std::f64::consts::PI.sqrt() * state.edge_px());
        let around = std::f64::consts::TAU * edge * radius_px;
        Self {
            edge_information: around * (1.0 + disc_ratio),
            information,
            scale,
            gradient,
            misfit: products[(0, 0)],
            mirror: MirrorProducts {
                with_unknowns: mirror,
                with_residual: products[(0, MIRROR)] * step,
                own: products[(MIRROR, MIRROR)] * step * step,
            },
            ring,
            pixels: products[(column::WHITE, column::WHITE)],
            patch_ratio: 1.0,
            reused: false,
            elongation: around * radius_px * (1.0 + disc_ratio * disc_ratio),
        }
    }

    /// With the same information, and the gradient at a state nearby.
    pub fn updated(&self, products: &Products) -> Self {
        let mut next = self.clone();
        for i in self.free_unknowns() {
            next.gradient[i] = products[(0, column_of(i))] * self.scale[i];
        }
        next.misfit = products[(0, 0)];
        next.mirror.with_residual = products[(0, MIRROR)] * self.scale[SHIFT];
        next.reused = true;
        next
    }

    /// Whether a step is the last: the problem is linear over it, and the residual is noise.
    pub fn is_converged_by(&self, state: &State, change: &Unknowns) -> bool {
        self.is_noise_only() && self.is_linear_over(state, change)
    }

    /// Whether the columns hold over a step.
    pub fn is_linear_over(&self, state: &State, change: &Unknowns) -> bool {
        let shape = change.fixed_rows::<5>(SHIFT);
        let moved = shape.dot(&(self.information.fixed_view::<5, 5>(SHIFT, SHIFT) * shape));
        let turn2 = change[TILT].powi(2) + change[TILT + 1].powi(2);
        let motion2 = change[MOTION].powi(2) + change[MOTION + 1].powi(2);
        moved < (LAST_MOVE * self.noise2()).min(LAST_MOVE_PX * LAST_MOVE_PX * self.edge_information)
            && 0.5 * turn2 * self.ring.radius_px < LAST_BEND_PX
            && change[BLUR].abs() < LAST_BLUR_PX * self.ring.radius_px
            && motion2 < LAST_MOTION_PX2 * LAST_MOTION_PX2
            && motion2 * self.information[(MOTION, MOTION)] < LAST_MOVE * self.noise2()
            && state.is_small_turn(change, self.ring.radius_px)
    }

    /// Whether noise explains the residual.
    pub fn is_noise_only(&self) -> bool {
        self.patch_ratio < 1.0 + PATCH_SLACK / self.pixels.sqrt()
    }

    /// Whether the residual is far more than noise leaves.
    pub fn contradicts_model(&self) -> bool {
        self.patch_ratio > 1.0 + MISMATCH_FACTOR * PATCH_SLACK / self.pixels.sqrt()
    }

    /// Updates gradient and misfit for a step.
    pub fn advance(&mut self, change: &Unknowns, misfit: f64) {
        self.gradient -= self.information * change;
        self.mirror.with_residual -= self.mirror.with_unknowns.dot(change);
        self.misfit = misfit;
    }

    /// Fixes an unknown.
    pub fn hold(&mut self, unknown: usize) {
        self.information.fill_row(unknown, 0.0);
        self.information.fill_column(unknown, 0.0);
        self.information[(unknown, unknown)] = 1.0;
        self.gradient[unknown] = 0.0;
        self.mirror.with_unknowns[unknown] = 0.0;
    }

    /// A free unknown is always correlated with the black level.
    pub fn is_held(&self, unknown: usize) -> bool {
        self.information[(unknown, STEP)] == 0.0
    }

    /// All unknowns, without a held motion.
    pub fn free_unknowns(&self) -> Range<usize> {
        if self.ring.motion_prior.is_some() { MOTION..UNKNOWNS } else { WHITE..UNKNOWNS }
    }

    pub fn noise2(&self) -> f64 {
        self.noise2_for(self.misfit)
    }

    /// Variance of a pixel for a sum of squares; at least that of rounding.
    pub fn noise2_for(&self, misfit: f64) -> f64 {
        (misfit / (self.pixels - self.free_unknowns().len() as f64).max(1.0)).max(1.0 / 12.0)
    }

    /// Information and gradient with the priors.
    pub fn with_prior(&self, state: &State, noise2: f64) -> (Information, Unknowns) {
        let (mut information, mut gradient) = (self.information, self.gradient);
        let prior = noise2 / (LIGHT_PRIOR * LIGHT_PRIOR);
        for axis in 0..2 {
            information[(LIGHT + axis, LIGHT + axis)] += prior;
            gradient[LIGHT + axis] -= prior * state.light[axis];
        }
        if let Some(prior) = self.ring.motion_prior {
            let prior = noise2 / (prior + state.motion2.norm_squared());
            for axis in 0..2 {
                information[(MOTION + axis, MOTION + axis)] += prior;
                gradient[MOTION + axis] -= prior * state.motion2[axis];
            }
        }
        (information, gradient)
    }

    /// Factor of the information for a step, and the gradient.
    pub fn factor(&self, state: &State, noise2: f64, damping: f64) -> Option<(Cholesky, Unknowns)> {
        let (mut information, gradient) = self.with_prior(state, noise2);
        let curvature = self.tilt_curvature(state, noise2);
        for axis in 0..2 {
            information[(TILT + axis, TILT + axis)] += curvature;
        }
        information.set_diagonal(&(information.diagonal() * (1.0 + damping)));
        Some((Cholesky::new(&information, self.free_unknowns())?, gradient))
    }

    pub fn step(&self, state: &State, noise2: f64, damping: f64) -> Option<Unknowns> {
        let (factor, gradient) = self.factor(state, noise2, damping)?;
        Some(factor.solve(&gradient))
    }

    /// A step that keeps the blur within its limits, by holding it there if necessary.
    pub fn bounded_step(&mut self, state: &State, noise2: f64, damping: f64) -> Option<Unknowns> {
        let change = self.step(state, noise2, damping)?;
        if !state.blur_at_limit(change[BLUR]) {
            return Some(change);
        }
        self.hold(BLUR);
        self.step(state, noise2, damping)
    }

    /// Decrease of the misfit that a step promises.
    pub fn gain(&self, change: &Unknowns) -> f64 {
        change.dot(&self.gradient)
    }

    /// Information about the tilt about either axis, for a noise of one grey level.
    pub fn tilt_information(&self, state: &State) -> f64 {
        self.elongation * state.tilt_sine2() / 8.0
    }

    /// Contribution of the elongation's curvature to the information about the tilt.
    fn tilt_curvature(&self, state: &State, noise2: f64) -> f64 {
        let (tilt, elongation) = (self.tilt_information(state) / noise2, self.elongation / noise2);
        let variance = 2.0 / ((tilt * tilt + elongation).sqrt() + tilt);
        0.25 * variance * elongation * noise2
    }
}
