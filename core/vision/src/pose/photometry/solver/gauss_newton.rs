//! Gauss and Newton's steps from a start to the unknowns, damped where they fail.

use super::{
    linearize::{linearize, linearize_start},
    mirror::{evaluate_mirrored, is_linear},
    solution::Solution,
    state::{BLUR, Problem, State},
};
use crate::pose::photometry::{FitError, FitScratch};

/// Steps at most.
const MAX_STEPS: usize = 16;
/// A step that lowers the misfit by less than this many variances is the last one.
const LAST_STEP: f64 = 0.5;
/// After a step that was to lower the misfit by less than this many variances the information is
/// not taken anew.
const SMALL_STEP: f64 = 100.0;
/// The least damping, other than none.
const MIN_DAMPING: f64 = 0.01;
/// A step that promises less than this many variances, and does not keep it, is left out.
const SETTLED: f64 = 4.0;
/// The mirrored place's misfit is to be smaller by so many variances for the fit to go on there.
const MIRRORED: f64 = 10.0;
/// Least difference of black and white, grey levels.
const MIN_STEP: f64 = 5.0;

/// Finds the unknowns from a start.
pub fn solve(
    problem: &Problem,
    start: State,
    scratch: &mut FitScratch,
) -> Result<Solution, FitError> {
    let mut state = start;
    let mut equations = linearize_start(problem, &state, scratch)?;
    let mut damping = 0.0;
    for step in 1..=MAX_STEPS {
        let noise2 = equations.noise2();
        let mut change = equations.step(&state, noise2, damping).ok_or(FitError::Uninformative)?;
        if state.blur_at_limit(change[BLUR]) {
            equations.hold(BLUR);
            change = equations.step(&state, noise2, damping).ok_or(FitError::Uninformative)?;
        }
        let gain: f64 = change.iter().zip(&equations.gradient).map(|(x, g)| x * g).sum();
        let next = state.moved(&equations, &change).ok_or(FitError::OutOfWindow)?;
        let left = (equations.misfit - gain).max(0.0);
        let settled = gain < LAST_STEP * equations.noise2_for(left);
        let last = damping == 0.0 && (settled || equations.is_converged_by(&state, &change));
        if last && next.step.abs() < MIN_STEP {
            return Err(FitError::Uninformative);
        }
        if last {
            let noise2 = equations.noise2_for(left);
            equations.advance(&change, left);
            return Ok(Solution { state: next, misfit: left, noise2, iterations: step, equations });
        }
        if step == 1
            && gain > SMALL_STEP * noise2
            && next.is_tilted()
            && is_linear(&state, &equations)
        {
            let mut behind = equations.clone();
            behind.advance(&change, left);
            let left2 = equations.noise2_for(left);
            // From the wrong place of two, the first step already says so.
            if let Some(other) = evaluate_mirrored(problem, &next, (&behind, left2, None), scratch)
                && other.misfit < left - MIRRORED * left2
                && let Ok(found) = linearize(problem, &other.state, None, scratch)
            {
                (state, equations) = (other.state, found);
                continue;
            }
        }
        // The information hardly changes over a small step; the residual does.
        let small = gain < SMALL_STEP * noise2 && damping == 0.0 && state.is_small_turn(&change);
        // What was recalled is as good at the second look as at the first.
        let is_fresh = !equations.reused || (equations.cache && step == 1);
        let reused = (small && is_fresh).then_some(&equations);
        match linearize(problem, &next, reused, scratch) {
            // Another blur's table moves the misfit by less than a variance.
            Ok(found) if found.misfit <= equations.misfit + noise2 => {
                (state, equations) = (next, found);
                damping = if damping > MIN_DAMPING { 0.1 * damping } else { 0.0 };
            }
            Err(FitError::Uninformative) => return Err(FitError::Uninformative),
            // Rounding, not the model, stands in the way of so little.
            Ok(_) if gain < SETTLED * noise2 => {
                let misfit = equations.misfit;
                return Ok(Solution { state, misfit, noise2, iterations: step, equations });
            }
            _ => damping = (10.0 * damping).max(MIN_DAMPING),
        }
    }
    Err(FitError::NotConverged)
}
