//! Choice among the poses that fit the pixels: Gauss-Newton from the start, then the mirrored
//! normal, face-on poses, and the robust fit of disturbed rings.

mod disc_heading;
mod frontal;
mod teeth_yaw;

use super::{
    FitError, FitScratch,
    robust::{self, RobustState},
    solver::{
        gauss_newton,
        mirror::{MirrorEstimate, evaluate_mirrored},
        solution::{PoseEstimate, Solution},
        state::{Problem, State},
    },
};
use crate::marker::Pattern;
use disc_heading::YawEstimate;
use frontal::{FrontalPose, FrontalResult};

/// The best pose from a start, and the state of the robust fit for the next frame. `deviation_rad` is
/// the standard deviation of an elliptical disc's heading there, `before` the state of the robust fit
/// of an earlier frame.
pub fn estimate_pose(
    problem: &Problem,
    first: State,
    deviation_rad: Option<f64>,
    before: Option<&RobustState>,
    scratch: &mut FitScratch,
) -> Result<(PoseEstimate, Option<RobustState>), FitError> {
    let is_plain_print = problem.teeth.is_none() && deviation_rad.is_none();
    if let Some(before) = before
        && is_plain_print
        && !before.expects_plain()
        && let Ok((estimate, next)) = resume_robust(problem, &first, before, scratch)
    {
        return Ok((estimate, Some(next)));
    }
    let mut heading = None;
    let mut solution = match (problem.teeth, deviation_rad) {
        (Some(_), _) => {
            let (solution, found) = teeth_yaw::solve(problem, first, &mut scratch.model)?;
            heading = Some(found);
            solution
        }
        (None, Some(deviation_rad)) => {
            let (solution, found) =
                disc_heading::solve(problem, first, deviation_rad, &mut scratch.model)?;
            heading = Some(found);
            solution
        }
        (None, None) => gauss_newton::solve(problem, first, &mut scratch.model)?,
    };
    if let Some(before) = before
        && !solution.is_plain()
        && let Ok((mut estimate, next)) = resume_robust(problem, &solution.state, before, scratch)
    {
        if let Some(heading) = heading {
            heading.inflated(&solution).add_to(problem, &mut estimate);
        }
        return Ok((estimate, Some(next)));
    }
    if problem.is_still && !solution.is_plain() {
        let moving = Problem { is_still: false, ..*problem };
        return estimate_pose(&moving, solution.state, deviation_rad, None, scratch);
    }
    let mut robust = before.map(|before| before.after_plain());
    let mut found = frontal::estimate(problem, &solution, &mut scratch.model);
    if let FrontalResult::Further(state) = found {
        solution = gauss_newton::solve(problem, state, &mut scratch.model)?;
        found = frontal::estimate(problem, &solution, &mut scratch.model);
    }
    let (mut estimate, heading) = match found {
        FrontalResult::Facing(first, other, likelihood) if solution.is_plain() => {
            let estimate = frontal_pose(problem, &solution, first, other, likelihood);
            (estimate, heading.map(YawEstimate::decorrelated))
        }
        _ => {
            let heading = match heading {
                Some(heading) if !solution.is_plain() => Some(heading.inflated(&solution)),
                _ => heading,
            };
            let (estimate, next) = tilted_pose(problem, solution, scratch)?;
            robust = next.or(robust);
            (estimate, heading)
        }
    };
    if let Some(heading) = heading {
        heading.add_to(problem, &mut estimate);
    }
    Ok((estimate, robust))
}

/// The robust fit from the state of an earlier frame.
fn resume_robust(
    problem: &Problem,
    start: &State,
    before: &RobustState,
    scratch: &mut FitScratch,
) -> Result<(PoseEstimate, RobustState), FitError> {
    let still = Problem { is_still: true, ..*problem };
    let found = robust::solve(&still, &start.without_motion(), Some(before), scratch)?;
    check_disc(problem, scratch)?;
    Ok(found)
}

/// A partly occluded rim of an elliptical disc would give a wrong heading.
fn check_disc(problem: &Problem, scratch: &FitScratch) -> Result<(), FitError> {
    let is_elliptical = matches!(problem.kind.pattern, Pattern::Elliptical { .. });
    if is_elliptical && !scratch.robust.disc_is_unobstructed() {
        return Err(FitError::Obstructed);
    }
    Ok(())
}

/// One or two leans of a roundel that nearly faces the camera.
fn frontal_pose(
    problem: &Problem,
    solution: &Solution,
    first: FrontalPose,
    other: Option<FrontalPose>,
    likelihood: f64,
) -> PoseEstimate {
    let FrontalPose { state, covariance, turns } = first;
    let covariance = solution.in_camera_frame(problem, &state, &covariance, &turns);
    let second = other.map_or(state.pose, |other| other.state.pose);
    PoseEstimate {
        other_normal: second.axes.column(2).into_owned(),
        likelihood,
        other_offset_m: second.position_m - state.pose.position_m,
        covariance,
        noise2: solution.noise2,
        motion_variance: solution.motion_variance(),
        iterations: solution.iterations,
        state,
    }
}

/// The solution or the mirrored one, whichever has the smaller misfit; the robust fit where noise
/// explains neither.
fn tilted_pose(
    problem: &Problem,
    mut solution: Solution,
    scratch: &mut FitScratch,
) -> Result<(PoseEstimate, Option<RobustState>), FitError> {
    let Solution { state, equations, noise2, .. } = &solution;
    let mut other = evaluate_mirrored(problem, state, equations, *noise2, &mut scratch.model);
    if let Some(better) = &other
        && better.misfit < solution.misfit
        && let Ok(found) = gauss_newton::solve(problem, better.state.clone(), &mut scratch.model)
    {
        let normal = |solution: &Solution| solution.state.pose.axes.column(2).into_owned();
        let back = normal(&found).dot(&normal(&solution));
        // Near face-on the mirrored pose may have no minimum of its own; then its initial misfit
        // counts.
        let own = back < normal(&found).dot(&solution.state.mirrored().pose.axes.column(2));
        let other_offset_m = found.state.pose.position_m - solution.state.pose.position_m;
        let misfit = match &other {
            Some(other) if !own => other.initial_misfit,
            _ => found.misfit.max(solution.misfit),
        };
        let better = found.misfit < solution.misfit;
        other = Some(MirrorEstimate {
            misfit,
            initial_misfit: misfit,
            other_offset_m,
            state: found.state.clone(),
        });
        if better {
            solution = found;
        }
    }
    if !solution.is_plain() {
        // Wrong teeth or a wrong yaw would pass for an occlusion.
        if problem.teeth_are_predicted && solution.equations.contradicts_model() {
            return Err(FitError::Obstructed);
        }
        // A disturbance may have passed for motion and shifted the pose.
        let still = Problem { is_still: true, ..*problem };
        let without_motion = solution.state.without_motion();
        let start = gauss_newton::solve(&still, without_motion.clone(), &mut scratch.model);
        let start = start.map_or(without_motion, |solution| solution.state);
        let (estimate, next) = robust::solve(&still, &start, None, scratch)?;
        check_disc(problem, scratch)?;
        return Ok((estimate, Some(next)));
    }
    let factor = solution.factor().ok_or(FitError::Uninformative)?;
    let own = factor.inverse_of_last() * solution.noise2;
    Ok((solution.estimate(problem, &own, other), None))
}
