//! The turn about the normal of a print with teeth, fitted along with all else.
//!
//! With the pose fitted at a yaw ψ₀, two further looks, at ψ₀ ± δ, see the residual r - and not only its
//! columns J - change: r∓ - r± = 2 δ m′, with m′ how the image turns. So without a column of its own in
//! the loops that all roundels go through,
//!
//!   Jᵀm′ = (Jᵀr₋ - Jᵀr₊)/(2δ)    m′·r = (|r₋|² - |r₊|²)/(4δ)    |m′|² = (|r₊|² + |r₋|² - 2 |r|²)/(2δ²)
//!
//! which is what Gauss and Newton's step over all unknowns needs, yaw included, and its covariance:
//! that of the yaw is Schur's complement, and position and normal follow it by -(JᵀJ)⁻¹ Jᵀm′.
//!
//! A yaw that is not read in this frame but carried on from the one before is off by much more. From there the
//! yaw is turned alone first, by m′·r/|m′|².
//!
//! Time: 23 µs for 8 bits at 36 px, 38 µs at 60 (`benches/fit.rs`). Accuracy: `tests/coded.rs` of the tests crate.

use nalgebra::Vector3;

use super::disc_heading::Heading;
use crate::pose::photometry::{
    FitError, FitScratch,
    solver::{
        cholesky::MOST,
        gauss_newton, linearize,
        normal_equations::Linear,
        solution::Solution,
        state::{BLUR, Problem, RANGE, SHIFT, State, TILT},
    },
};

/// How far the looks to either side turn the white disc's rim, pixels: far beyond the noise, and far
/// within the blur.
const APART_PX: f64 = 0.1;
/// A step that turns by no more of these is the last one.
const BEYOND: f64 = 1.5;
/// Such steps at most.
const TURNS: usize = 4;
/// Steps of the yaw alone are no longer than so many of these, …
const LONGEST: f64 = 5.0;
/// … and at most so many.
const TURNS_ALONE: usize = 4;

/// Finds all unknowns and the yaw, from a start that has about the right one.
pub fn solve(
    problem: &Problem,
    start: State,
    scratch: &mut FitScratch,
) -> Result<(Solution, Heading), FitError> {
    let mut start =
        if problem.is_presumed { turned_alone(problem, start, scratch)? } else { start };
    for _ in 0..TURNS {
        let solution = gauss_newton::solve(problem, start, scratch)?;
        let radius_px = problem.kind.ratio() * linearize::radius_px(problem, &solution.state);
        let apart_rad = APART_PX / radius_px;
        let turn = Turn::of(problem, &solution, apart_rad, scratch)?;
        if turn.by_rad.abs() <= BEYOND * apart_rad {
            let (mut solution, heading) = turn.taken(solution).ok_or(FitError::Away)?;
            // What a wrong yaw leaves hangs together as well.
            if !solution.linear.is_even() {
                solution = seen_anew(problem, solution, scratch)?;
            }
            return Ok((solution, heading));
        }
        start = solution.state.headed(turn.by_rad);
    }
    Err(FitError::Restless)
}

/// The start with the yaw that fits best there.
///
/// Steps over all unknowns from a yaw that is off by far more than its deviation put up with a lean, near face-on, that
/// makes the best of it, and stay there.
fn turned_alone(
    problem: &Problem,
    mut start: State,
    scratch: &mut FitScratch,
) -> Result<State, FitError> {
    for _ in 0..TURNS_ALONE {
        let linear = linearize::linearize(problem, &start, None, scratch)?;
        let radius_px = problem.kind.ratio() * linearize::radius_px(problem, &start);
        let apart_rad = APART_PX / radius_px;
        let mut misfit = |by_rad: f64| -> Result<f64, FitError> {
            let turned = start.headed(by_rad);
            Ok(linearize::linearize(problem, &turned, Some(&linear), scratch)?.misfit)
        };
        let (ahead, behind) = (misfit(apart_rad)?, misfit(-apart_rad)?);
        let own = 0.25 * (behind - ahead) / apart_rad;
        let square = 0.5 * (ahead + behind - 2.0 * linear.misfit) / (apart_rad * apart_rad);
        if square.is_nan() || square <= 0.0 {
            break;
        }
        let by_rad = (own / square).clamp(-LONGEST * apart_rad, LONGEST * apart_rad);
        start = start.headed(by_rad);
        if by_rad.abs() <= BEYOND * apart_rad {
            break;
        }
    }
    Ok(start)
}

/// The solution with the residual that it really leaves.
fn seen_anew(
    problem: &Problem,
    solution: Solution,
    scratch: &mut FitScratch,
) -> Result<Solution, FitError> {
    let linear = linearize::linearize(problem, &solution.state, Some(&solution.linear), scratch)?;
    let (misfit, noise2) = (linear.misfit, linear.noise2());
    Ok(Solution { misfit, noise2, linear, ..solution })
}

/// The step from a solution.
struct Turn {
    /// Of the yaw …
    by_rad: f64,
    /// … and its variance over a pixel's, 1/grey levels².
    variance: f64,
    /// Of all else.
    change: [f64; MOST],
    /// How all else follows the yaw.
    follow: [f64; MOST],
    /// By how much the misfit falls.
    gain: f64,
    /// The mirrored place's product with the residual that is left.
    mirror: f64,
}

impl Turn {
    fn of(
        problem: &Problem,
        solution: &Solution,
        apart_rad: f64,
        scratch: &mut FitScratch,
    ) -> Result<Self, FitError> {
        let Solution { state, linear, noise2, .. } = solution;
        let mut look = |by_rad: f64| {
            linearize::linearize(problem, &state.headed(by_rad), Some(linear), scratch)
        };
        let (ahead, behind) = (look(apart_rad)?, look(-apart_rad)?);
        let half = |of: &dyn Fn(&Linear) -> f64| {
            (0.5 * (of(&ahead) + of(&behind)), 0.5 * (of(&behind) - of(&ahead)) / apart_rad)
        };
        let (factor, _) = linear.factor(state, *noise2, 0.0).ok_or(FitError::Flat)?;
        let (mut gradient, mut with_turn) = ([0.0; MOST], [0.0; MOST]);
        let (_, pulled) = linear.with_prior(state, *noise2);
        for unknown in linear.free().filter(|&unknown| unknown != BLUR || !linear.holds(BLUR)) {
            (gradient[unknown], with_turn[unknown]) = half(&|look| look.gradient[unknown]);
            gradient[unknown] += pulled[unknown] - linear.gradient[unknown];
        }
        let own = 0.5 * half(&|look| look.misfit).1;
        let square = (half(&|look| look.misfit).0 - linear.misfit) / (apart_rad * apart_rad);
        let (step, follow) = (factor.solve(&gradient), factor.solve(&with_turn));
        let dot = |one: &[f64; MOST], other: &[f64; MOST]| -> f64 {
            one.iter().zip(other).map(|(a, b)| a * b).sum()
        };
        let information = square - dot(&with_turn, &follow);
        if information.is_nan() || information <= 0.0 {
            return Err(FitError::Flat);
        }
        let left = own - dot(&with_turn, &step);
        let by_rad = left / information;
        let change: [f64; MOST] = std::array::from_fn(|i| step[i] - follow[i] * by_rad);
        let (mirror, mirror_turn) = half(&|look| look.mirror.1);
        Ok(Self {
            by_rad,
            variance: 1.0 / information,
            mirror: mirror - dot(&linear.mirror.0, &change) - mirror_turn * by_rad,
            gain: dot(&gradient, &step) + left * by_rad,
            change,
            follow: follow.map(|value| -value),
        })
    }

    /// The solution after the step.
    fn taken(&self, solution: Solution) -> Option<(Solution, Heading)> {
        let Solution { state, linear, .. } = &solution;
        let mut next = state.headed(self.by_rad).moved(linear, &self.change)?;
        let mut linear = linear.clone();
        linear.misfit = (linear.misfit - self.gain).max(0.0);
        linear.gradient = [0.0; MOST];
        linear.mirror.1 = self.mirror;
        let noise2 = linear.noise2();
        let place = &mut next.place;
        let along = |axis: usize| place.axes.column(axis).into_owned();
        let follow = &self.follow;
        let across = Vector3::new(follow[SHIFT], follow[SHIFT + 1], 0.0) * linear.unit_m;
        let heading = Heading::new(
            self.variance * noise2,
            across + place.position_m * follow[RANGE],
            along(0) * follow[TILT] + along(1) * follow[TILT + 1],
        );
        let misfit = linear.misfit;
        Some((Solution { state: next, misfit, noise2, linear, ..solution }, heading))
    }
}
