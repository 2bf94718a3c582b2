//! Rotation about the normal of a print with teeth, fitted with all other unknowns.
//!
//! With the pose fitted at a yaw ψ₀, two further linearizations at ψ₀ ± δ show how the residual r
//! changes: r∓ - r± = 2 δ m′, with m′ the derivative of the image by the yaw. Without a column of
//! its own, which would slow down the loops of all roundels,
//!
//!   Jᵀm′ = (Jᵀr₋ - Jᵀr₊)/(2δ)    m′·r = (|r₋|² - |r₊|²)/(4δ)    |m′|² = (|r₊|² + |r₋|² - 2 |r|²)/(2δ²)
//!
//! This is what a Gauss-Newton step over all unknowns needs, yaw included, and its covariance: that
//! of the yaw by Schur's complement, with position and normal depending on it by -(JᵀJ)⁻¹ Jᵀm′.
//!
//! A yaw that is predicted from the frame before may be off by much more; it is first corrected
//! alone, by m′·r/|m′|².
//!
//! Time: 23 µs for 8 bits at 36 px, 38 µs at 60 px (`benches/fit.rs`). Accuracy: `tests/coded.rs`
//! of the tests crate.

use nalgebra::Vector3;

use super::disc_heading::YawEstimate;
use crate::pose::photometry::{
    FitError,
    model::ModelScratch,
    solver::{
        cholesky::Unknowns,
        gauss_newton, linearize,
        normal_equations::NormalEquations,
        solution::Solution,
        state::{BLUR, Problem, RANGE, SHIFT, State, TILT},
    },
};

/// δ as a displacement of the white disc's rim, pixels: far above the noise, and well within the
/// blur.
const OFFSET_PX: f64 = 0.1;
/// A step of at most this many δ is the last one.
const LAST_STEP: f64 = 1.5;
const MAX_STEPS: usize = 4;
/// Longest step of the yaw alone, in δ.
const MAX_STEP: f64 = 5.0;
const MAX_YAW_STEPS: usize = 4;

/// Finds all unknowns and the yaw, from a start with about the right yaw.
pub fn solve(
    problem: &Problem,
    start: State,
    scratch: &mut ModelScratch,
) -> Result<(Solution, YawEstimate), FitError> {
    let mut start =
        if problem.teeth_are_predicted { align_yaw(problem, start, scratch)? } else { start };
    for _ in 0..MAX_STEPS {
        let solution = gauss_newton::solve(problem, start, scratch)?;
        let radius_px = problem.kind.ratio() * linearize::radius_px(problem, &solution.state);
        let offset_rad = OFFSET_PX / radius_px;
        let turn = YawStep::new(problem, &solution, offset_rad, scratch)?;
        if turn.by_rad.abs() <= LAST_STEP * offset_rad {
            let (mut solution, heading) = turn.applied(solution).ok_or(FitError::OutOfWindow)?;
            // A wrong yaw leaves correlated residuals, too.
            if !solution.equations.is_noise_only() {
                solution = relinearized(problem, solution, scratch)?;
            }
            return Ok((solution, heading));
        }
        start = solution.state.rotated(turn.by_rad);
    }
    Err(FitError::NotConverged)
}

/// Corrects the yaw of the start alone.
///
/// Steps over all unknowns from a yaw that is off by far more than its standard deviation can
/// converge, near face-on, to a lean that compensates for it.
fn align_yaw(
    problem: &Problem,
    mut start: State,
    scratch: &mut ModelScratch,
) -> Result<State, FitError> {
    for _ in 0..MAX_YAW_STEPS {
        let equations = linearize::linearize(problem, &start, None, scratch)?;
        let radius_px = problem.kind.ratio() * linearize::radius_px(problem, &start);
        let offset_rad = OFFSET_PX / radius_px;
        let mut misfit = |by_rad: f64| -> Result<f64, FitError> {
            let turned = start.rotated(by_rad);
            Ok(linearize::linearize(problem, &turned, Some(&equations), scratch)?.misfit)
        };
        let (ahead, behind) = (misfit(offset_rad)?, misfit(-offset_rad)?);
        let own = 0.25 * (behind - ahead) / offset_rad;
        let square = 0.5 * (ahead + behind - 2.0 * equations.misfit) / (offset_rad * offset_rad);
        if square.is_nan() || square <= 0.0 {
            break;
        }
        let by_rad = (own / square).clamp(-MAX_STEP * offset_rad, MAX_STEP * offset_rad);
        start = start.rotated(by_rad);
        if by_rad.abs() <= LAST_STEP * offset_rad {
            break;
        }
    }
    Ok(start)
}

/// The solution with its actual residual.
fn relinearized(
    problem: &Problem,
    solution: Solution,
    scratch: &mut ModelScratch,
) -> Result<Solution, FitError> {
    let equations =
        linearize::linearize(problem, &solution.state, Some(&solution.equations), scratch)?;
    let (misfit, noise2) = (equations.misfit, equations.noise2());
    Ok(Solution { misfit, noise2, equations, ..solution })
}

struct YawStep {
    by_rad: f64,
    /// Variance of the yaw over that of a pixel, 1/grey levels².
    variance: f64,
    /// Step of all other unknowns.
    change: Unknowns,
    /// Derivatives of all other unknowns by the yaw.
    follow: Unknowns,
    /// Decrease of the misfit.
    gain: f64,
    /// Product of the mirrored pose's column with the remaining residual.
    mirror: f64,
}

impl YawStep {
    fn new(
        problem: &Problem,
        solution: &Solution,
        offset_rad: f64,
        scratch: &mut ModelScratch,
    ) -> Result<Self, FitError> {
        let Solution { state, equations, noise2, .. } = solution;
        let mut probe = |by_rad: f64| {
            linearize::linearize(problem, &state.rotated(by_rad), Some(equations), scratch)
        };
        let (ahead, behind) = (probe(offset_rad)?, probe(-offset_rad)?);
        let half = |of: &dyn Fn(&NormalEquations) -> f64| {
            (0.5 * (of(&ahead) + of(&behind)), 0.5 * (of(&behind) - of(&ahead)) / offset_rad)
        };
        let (factor, _) = equations.factor(state, *noise2, 0.0).ok_or(FitError::Uninformative)?;
        let (mut gradient, mut with_turn) = (Unknowns::zeros(), Unknowns::zeros());
        let (_, pulled) = equations.with_prior(state, *noise2);
        for unknown in
            equations.free_unknowns().filter(|&unknown| unknown != BLUR || !equations.is_held(BLUR))
        {
            (gradient[unknown], with_turn[unknown]) = half(&|probe| probe.gradient[unknown]);
            gradient[unknown] += pulled[unknown] - equations.gradient[unknown];
        }
        let own = 0.5 * half(&|probe| probe.misfit).1;
        let square = (half(&|probe| probe.misfit).0 - equations.misfit) / (offset_rad * offset_rad);
        let (step, follow) = (factor.solve(&gradient), factor.solve(&with_turn));
        let information = square - with_turn.dot(&follow);
        if information.is_nan() || information <= 0.0 {
            return Err(FitError::Uninformative);
        }
        let left = own - with_turn.dot(&step);
        let by_rad = left / information;
        let change = step - follow * by_rad;
        let (mirror, mirror_turn) = half(&|probe| probe.mirror.with_residual);
        Ok(Self {
            by_rad,
            variance: 1.0 / information,
            mirror: mirror - equations.mirror.with_unknowns.dot(&change) - mirror_turn * by_rad,
            gain: gradient.dot(&step) + left * by_rad,
            change,
            follow: -follow,
        })
    }

    fn applied(&self, solution: Solution) -> Option<(Solution, YawEstimate)> {
        let Solution { state, equations, .. } = &solution;
        let mut next = state.rotated(self.by_rad).moved(equations.ring.unit_m, &self.change)?;
        let mut equations = equations.clone();
        equations.misfit = (equations.misfit - self.gain).max(0.0);
        equations.gradient = Unknowns::zeros();
        equations.mirror.with_residual = self.mirror;
        let noise2 = equations.noise2();
        let pose = &mut next.pose;
        let along = |axis: usize| pose.axes.column(axis).into_owned();
        let follow = &self.follow;
        let across = Vector3::new(follow[SHIFT], follow[SHIFT + 1], 0.0) * equations.ring.unit_m;
        let heading = YawEstimate::new(
            self.variance * noise2,
            across + pose.position_m * follow[RANGE],
            along(0) * follow[TILT] + along(1) * follow[TILT + 1],
        );
        let misfit = equations.misfit;
        Some((Solution { state: next, misfit, noise2, equations, ..solution }, heading))
    }
}
