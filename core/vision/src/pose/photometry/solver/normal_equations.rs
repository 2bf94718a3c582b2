//! The linear problem at a state: information, gradient, steps, and when a step is the last one.

use std::ops::Range;

use super::{
    cholesky::{Cholesky, MAX_UNKNOWNS},
    state::{BLUR, LIGHT, MOTION, Problem, SHIFT, STEP, State, TILT, UNKNOWNS, WHITE, column_of},
};
use crate::pose::photometry::model::{
    column_products::{COLUMNS, Products, column},
    window::PixelModel,
};

/// The linear problem at a state.
#[derive(Clone, Debug)]
pub struct NormalEquations {
    pub information: [[f64; MAX_UNKNOWNS]; MAX_UNKNOWNS],
    /// From columns to unknowns.
    pub scale: [f64; MAX_UNKNOWNS],
    pub gradient: [f64; MAX_UNKNOWNS],
    /// Sum of squared residuals, grey levels².
    pub misfit: f64,
    pub pixels: f64,
    /// How far residuals hang together ([`patches::share`]).
    pub patch_ratio: f64,
    /// Products of what tells the mirrored place from this one: with the unknowns, with the residual and
    /// with itself.
    pub mirror: ([f64; MAX_UNKNOWNS], f64, f64),
    /// How far the mirrored place moves the outer rim, pixels.
    pub apart_px: f64,
    /// Whether the information is that of an earlier state …
    pub reused: bool,
    /// … and of an earlier frame.
    pub cache: bool,
    /// Variance of μ beforehand besides its own size, px⁴; none where the motion is held.
    pub motion_prior: Option<f64>,
    /// Information of a move of both rims.
    edge_information: f64,
    /// The outer rim's radius, pixels.
    radius_px: f64,
    /// Information of a rim's elongation, both rims.
    pub elongation: f64,
    /// p₃ s: metres that a unit of shift is.
    pub unit_m: f64,
}

/// Column of the mirrored place.
const MIRROR: usize = column::MIRROR;
/// A step is the last one if it moves the rims by less than this on average, pixels …
const LAST_MOVE_PX: f64 = 0.03;
/// … which the pixels tell with a misfit of no more variances: what the columns miss of it is far below
/// the noise …
const LAST_MOVE: f64 = 25.0;
/// … by no more through the square of its turn …
const LAST_BEND_PX: f64 = 0.002;
/// … and σ² by less than this share of the radius, px² to px: the smaller the rims, the less they tell blur
/// from size and levels, and the further the columns' errors carry.
const LAST_BLUR_PX: f64 = 8e-4;
/// μ may move as far as the pixels tell with [`LAST_MOVE`] variances, and no more than this, px²: the columns'
/// errors carry far less of it than its own noise.
const LAST_MOTION_PX2: f64 = 1.0;
/// Deviation of the light's gradient: relative change over a radius.
const LIGHT_PRIOR: f64 = 0.1;
/// [`patches::share`] of noise exceeds 1 by no more than this over the root of the number of pixels: more than
/// three deviations of 5.3 beyond its mean of 1 (of 15,000 rendered rings), since a clean ring that is taken for a
/// disturbed one costs as much as a hundred others.
const PATCH_SLACK: f64 = 18.0;
/// By so many times as much it is neither noise nor what the model leaves out of a clean ring.
const MISMATCH_FACTOR: f64 = 1.7;

impl NormalEquations {
    /// From the products of all columns, or of those without the motion's.
    pub fn new<const COUNT: usize>(
        problem: &Problem,
        state: &State,
        (products, model): (&Products<COUNT>, &PixelModel),
        radius_px: f64,
    ) -> Self {
        let mut scale = [1.0; MAX_UNKNOWNS];
        scale[BLUR] = 0.5 * state.step;
        scale[MOTION..MOTION + 2].fill(state.step / 48.0);
        scale[SHIFT..UNKNOWNS].fill(state.step);
        let mut information = [[0.0; MAX_UNKNOWNS]; MAX_UNKNOWNS];
        let (mut gradient, mut mirror) = ([0.0; MAX_UNKNOWNS], [0.0; MAX_UNKNOWNS]);
        let step = state.step;
        let is_free = COUNT == COLUMNS && !problem.is_still;
        let first = if is_free { MOTION } else { WHITE };
        for i in first..UNKNOWNS {
            let column = column_of(i);
            for j in first..UNKNOWNS {
                information[i][j] = products[(column, column_of(j))] * scale[i] * scale[j];
            }
            gradient[i] = products[(0, column)] * scale[i];
            mirror[i] = products[(column, MIRROR)] * scale[i] * step;
        }
        // A straight edge of deviation τ tells its place by C²/(2 √π τ) a pixel's length.
        let spread_px = state.edge_px();
        let edge = state.step * state.step / (2.0 * std::f64::consts::PI.sqrt() * spread_px);
        let ratio = problem.kind.mean_ratio();
        let around = std::f64::consts::TAU * edge * radius_px;
        Self {
            edge_information: around * (1.0 + ratio),
            radius_px,
            information,
            scale,
            gradient,
            misfit: products[(0, 0)],
            mirror: (
                mirror,
                products[(0, MIRROR)] * step,
                products[(MIRROR, MIRROR)] * step * step,
            ),
            apart_px: 2.0 * radius_px * model.nearness[1].hypot(model.nearness[2]) as f64,
            pixels: products[(column::WHITE, column::WHITE)],
            patch_ratio: 1.0,
            reused: false,
            cache: false,
            motion_prior: is_free.then_some(problem.motion_prior),
            elongation: around * radius_px * (1.0 + ratio * ratio),
            unit_m: state.pose.position_m.z * problem.lens.spread,
        }
    }

    /// The same information, with the residual's products of another state near by.
    pub fn updated(&self, products: &Products) -> Self {
        let mut next = self.clone();
        for i in self.free_unknowns() {
            next.gradient[i] = products[(0, column_of(i))] * self.scale[i];
        }
        next.misfit = products[(0, 0)];
        next.mirror.1 = products[(0, MIRROR)] * self.scale[SHIFT];
        next.reused = true;
        next
    }

    /// Whether the problem is as good as linear over a change, and its residual all noise already.
    pub fn is_converged_by(&self, state: &State, change: &[f64; MAX_UNKNOWNS]) -> bool {
        let shape = SHIFT..UNKNOWNS;
        let moved: f64 = shape
            .clone()
            .map(|i| {
                change[i] * shape.clone().map(|j| self.information[i][j] * change[j]).sum::<f64>()
            })
            .sum();
        let turn2 = change[TILT].powi(2) + change[TILT + 1].powi(2);
        let motion2 = change[MOTION].powi(2) + change[MOTION + 1].powi(2);
        moved < (LAST_MOVE * self.noise2()).min(LAST_MOVE_PX * LAST_MOVE_PX * self.edge_information)
            && 0.5 * turn2 * self.radius_px < LAST_BEND_PX
            && change[BLUR].abs() < LAST_BLUR_PX * self.radius_px
            && motion2 < LAST_MOTION_PX2 * LAST_MOTION_PX2
            && motion2 * self.information[MOTION][MOTION] < LAST_MOVE * self.noise2()
            && self.is_noise_only()
            && state.is_small_turn(change)
    }

    /// Whether noise explains the residual.
    pub fn is_noise_only(&self) -> bool {
        self.patch_ratio < 1.0 + PATCH_SLACK / self.pixels.sqrt()
    }

    /// Whether what is left is far more than noise would ever leave.
    pub fn contradicts_model(&self) -> bool {
        self.patch_ratio > 1.0 + MISMATCH_FACTOR * PATCH_SLACK / self.pixels.sqrt()
    }

    /// Carries what depends on the residual over a change that leaves this misfit.
    pub fn advance(&mut self, change: &[f64; MAX_UNKNOWNS], misfit: f64) {
        for (gradient, row) in self.gradient.iter_mut().zip(&self.information) {
            *gradient -= row.iter().zip(change).map(|(a, b)| a * b).sum::<f64>();
        }
        self.mirror.1 -= self.mirror.0.iter().zip(change).map(|(a, b)| a * b).sum::<f64>();
        self.misfit = misfit;
    }

    /// Holds an unknown where it is.
    pub fn hold(&mut self, unknown: usize) {
        for other in self.free_unknowns() {
            self.information[unknown][other] = 0.0;
            self.information[other][unknown] = 0.0;
        }
        self.information[unknown][unknown] = 1.0;
        self.gradient[unknown] = 0.0;
        self.mirror.0[unknown] = 0.0;
    }

    /// Whether an unknown is held: the level of black hangs together with all others.
    pub fn is_held(&self, unknown: usize) -> bool {
        self.information[unknown][STEP] == 0.0
    }

    /// The unknowns but for a motion that is held.
    pub fn free_unknowns(&self) -> Range<usize> {
        if self.motion_prior.is_some() { MOTION..UNKNOWNS } else { WHITE..UNKNOWNS }
    }

    pub fn noise2(&self) -> f64 {
        self.noise2_for(self.misfit)
    }

    /// Variance of a pixel for a sum of squares; never below that of rounding.
    pub fn noise2_for(&self, misfit: f64) -> f64 {
        (misfit / (self.pixels - self.free_unknowns().len() as f64).max(1.0)).max(1.0 / 12.0)
    }

    /// Information and gradient with what is known beforehand.
    pub fn with_prior(
        &self,
        state: &State,
        noise2: f64,
    ) -> ([[f64; MAX_UNKNOWNS]; MAX_UNKNOWNS], [f64; MAX_UNKNOWNS]) {
        let (mut information, mut gradient) = (self.information, self.gradient);
        let prior = noise2 / (LIGHT_PRIOR * LIGHT_PRIOR);
        for axis in 0..2 {
            information[LIGHT + axis][LIGHT + axis] += prior;
            gradient[LIGHT + axis] -= prior * state.light[axis];
        }
        if let Some(prior) = self.motion_prior {
            let prior = noise2 / (prior + state.motion2.norm_squared());
            for axis in 0..2 {
                information[MOTION + axis][MOTION + axis] += prior;
                gradient[MOTION + axis] -= prior * state.motion2[axis];
            }
        }
        (information, gradient)
    }

    /// The information for a step, and the gradient.
    fn with_curvature(
        &self,
        state: &State,
        noise2: f64,
    ) -> ([[f64; MAX_UNKNOWNS]; MAX_UNKNOWNS], [f64; MAX_UNKNOWNS]) {
        let (mut information, gradient) = self.with_prior(state, noise2);
        let curvature = self.tilt_curvature(state, noise2);
        for axis in 0..2 {
            information[TILT + axis][TILT + axis] += curvature;
        }
        (information, gradient)
    }

    /// The factor of the information for a step, and the gradient.
    pub fn factor(
        &self,
        state: &State,
        noise2: f64,
        damping: f64,
    ) -> Option<(Cholesky, [f64; MAX_UNKNOWNS])> {
        let (mut information, gradient) = self.with_curvature(state, noise2);
        for (i, row) in information.iter_mut().enumerate() {
            row[i] *= 1.0 + damping;
        }
        Some((Cholesky::new(&information, self.free_unknowns())?, gradient))
    }

    /// A step, damped or not.
    pub fn step(&self, state: &State, noise2: f64, damping: f64) -> Option<[f64; MAX_UNKNOWNS]> {
        let (factor, gradient) = self.factor(state, noise2, damping)?;
        Some(factor.solve(&gradient))
    }

    /// A step, from the factor of information that differs from this one in the tilts alone.
    pub fn step_beside(
        &self,
        state: &State,
        noise2: f64,
        neighbor: &Cholesky,
    ) -> Option<[f64; MAX_UNKNOWNS]> {
        let (information, gradient) = self.with_curvature(state, noise2);
        Some(neighbor.with_last::<2>(&information)?.solve(&gradient))
    }

    /// Information, over that of one grey level, about the tilt about either axis.
    pub fn tilt_information(&self, state: &State) -> f64 {
        let pose = &state.pose;
        let cosine = pose.axes.column(2).dot(&pose.position_m.normalize());
        self.elongation * (1.0 - cosine * cosine) / 8.0
    }

    /// What the curvature of the elongation adds to the tilt's information.
    fn tilt_curvature(&self, state: &State, noise2: f64) -> f64 {
        let (tilt, elongation) = (self.tilt_information(state) / noise2, self.elongation / noise2);
        let variance = 2.0 / ((tilt * tilt + elongation).sqrt() + tilt);
        0.25 * variance * elongation * noise2
    }
}
