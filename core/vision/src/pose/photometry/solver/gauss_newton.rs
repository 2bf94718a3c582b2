//! Damped Gauss-Newton (Levenberg-Marquardt) from a start to the unknowns.
//!
//! Steps are undamped until one fails to decrease the misfit. After a small step the information is
//! kept and only the residual evaluated again. If the first step is large, the mirrored pose is
//! tested as well ([`super::mirror`]).

use super::{
    linearize::linearize,
    mirror::{evaluate_mirrored, is_linear},
    solution::Solution,
    state::{Problem, State},
};
use crate::pose::photometry::{FitError, model::ModelScratch};

const MAX_STEPS: usize = 16;
/// A step that decreases the misfit by fewer variances is the last one.
const LAST_STEP: f64 = 0.5;
/// After a step that promises fewer variances the information is reused.
const SMALL_STEP: f64 = 100.0;
const MIN_DAMPING: f64 = 0.01;
/// A step that promises fewer variances, and does not deliver them, is ignored.
pub const SETTLED: f64 = 4.0;
/// Decrease of the misfit, in variances, for which the fit continues from the mirrored pose.
const MIRRORED: f64 = 10.0;
/// Minimum contrast, grey levels.
const MIN_STEP: f64 = 5.0;

/// Levenberg-Marquardt damping of the information's diagonal.
#[derive(Clone, Copy, Debug, Default)]
pub struct Damping(pub f64);

impl Damping {
    pub fn is_none(self) -> bool {
        self.0 == 0.0
    }

    /// After a step that decreased the misfit.
    pub fn relax(&mut self) {
        self.0 = if self.0 > MIN_DAMPING { 0.1 * self.0 } else { 0.0 };
    }

    /// After a step that failed.
    pub fn tighten(&mut self) {
        self.0 = (10.0 * self.0).max(MIN_DAMPING);
    }
}

pub fn solve(
    problem: &Problem,
    start: State,
    scratch: &mut ModelScratch,
) -> Result<Solution, FitError> {
    let mut state = start;
    let mut equations = linearize(problem, &state, None, scratch)?;
    let mut damping = Damping::default();
    for step in 1..=MAX_STEPS {
        let noise2 = equations.noise2();
        let change =
            equations.bounded_step(&state, noise2, damping.0).ok_or(FitError::Uninformative)?;
        let gain = equations.gain(&change);
        let next = state.moved(equations.ring.unit_m, &change).ok_or(FitError::OutOfWindow)?;
        let left = (equations.misfit - gain).max(0.0);
        let settled = gain < LAST_STEP * equations.noise2_for(left);
        let last = damping.is_none() && (settled || equations.is_converged_by(&state, &change));
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
            // A start at the wrong one of two poses shows in the first step.
            if let Some(other) = evaluate_mirrored(problem, &next, &behind, left2, scratch)
                && other.misfit < left - MIRRORED * left2
                && let Ok(found) = linearize(problem, &other.state, None, scratch)
            {
                (state, equations) = (other.state, found);
                continue;
            }
        }
        // The information hardly changes over a small step; the residual does.
        let radius_px = equations.ring.radius_px;
        let small = gain < SMALL_STEP * noise2
            && damping.is_none()
            && state.is_small_turn(&change, radius_px);
        let reused = (small && !equations.reused).then_some(&equations);
        match linearize(problem, &next, reused, scratch) {
            // A change of the kernel table moves the misfit by less than a variance.
            Ok(found) if found.misfit <= equations.misfit + noise2 => {
                (state, equations) = (next, found);
                damping.relax();
            }
            Err(FitError::Uninformative) => return Err(FitError::Uninformative),
            // Rounding, not the model, prevents so small a decrease.
            Ok(_) if gain < SETTLED * noise2 => {
                let misfit = equations.misfit;
                return Ok(Solution { state, misfit, noise2, iterations: step, equations });
            }
            _ => damping.tighten(),
        }
    }
    Err(FitError::NotConverged)
}
