//! Gauss and Newton's steps from a start to the unknowns, damped where they fail.

use super::{
    linearize::{begin, linearize},
    mirror::{glance, is_linear},
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
const LEAST_DAMPING: f64 = 0.01;
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
    let mut linear = begin(problem, &state, scratch)?;
    let mut damping = 0.0;
    for step in 1..=MAX_STEPS {
        let noise2 = linear.noise2();
        let mut change = linear.step(&state, noise2, damping).ok_or(FitError::Flat)?;
        if state.blur_ends(change[BLUR]) {
            linear.hold(BLUR);
            change = linear.step(&state, noise2, damping).ok_or(FitError::Flat)?;
        }
        let gain: f64 = change.iter().zip(&linear.gradient).map(|(x, g)| x * g).sum();
        let next = state.moved(&linear, &change).ok_or(FitError::Away)?;
        let left = (linear.misfit - gain).max(0.0);
        let settled = gain < LAST_STEP * linear.noise2_of(left);
        let last = damping == 0.0 && (settled || linear.holds_over(&state, &change));
        if last && next.step.abs() < MIN_STEP {
            return Err(FitError::Flat);
        }
        if last {
            let noise2 = linear.noise2_of(left);
            linear.carry(&change, left);
            return Ok(Solution { state: next, misfit: left, noise2, iterations: step, linear });
        }
        if step == 1 && gain > SMALL_STEP * noise2 && next.is_tilted() && is_linear(&state, &linear)
        {
            let mut behind = linear.clone();
            behind.carry(&change, left);
            let left2 = linear.noise2_of(left);
            // From the wrong place of two, the first step already says so.
            if let Some(other) = glance(problem, &next, (&behind, left2, None), scratch)
                && other.misfit < left - MIRRORED * left2
                && let Ok(found) = linearize(problem, &other.state, None, scratch)
            {
                (state, linear) = (other.state, found);
                continue;
            }
        }
        // The information hardly changes over a small step; the residual does.
        let small = gain < SMALL_STEP * noise2 && damping == 0.0 && state.is_turned_little(&change);
        // What was recalled is as good at the second look as at the first.
        let is_fresh = !linear.reused || (linear.recalled && step == 1);
        let known = (small && is_fresh).then_some(&linear);
        match linearize(problem, &next, known, scratch) {
            // Another blur's table moves the misfit by less than a variance.
            Ok(found) if found.misfit <= linear.misfit + noise2 => {
                (state, linear) = (next, found);
                damping = if damping > LEAST_DAMPING { 0.1 * damping } else { 0.0 };
            }
            Err(FitError::Flat) => return Err(FitError::Flat),
            // Rounding, not the model, stands in the way of so little.
            Ok(_) if gain < SETTLED * noise2 => {
                let misfit = linear.misfit;
                return Ok(Solution { state, misfit, noise2, iterations: step, linear });
            }
            _ => damping = (10.0 * damping).max(LEAST_DAMPING),
        }
    }
    Err(FitError::Restless)
}
