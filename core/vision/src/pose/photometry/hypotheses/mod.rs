//! Choice among the poses that fit the pixels: Gauss-Newton from the start, then the mirrored
//! normal, face-on poses, and the robust fit of disturbed rings.

mod disc_heading;
mod frontal;
mod teeth_yaw;

use super::{
    FitError, FitScratch,
    model::ModelScratch,
    robust::{self, RobustState},
    solver::{
        gauss_newton,
        linearize::linearize,
        mirror::{MirrorEstimate, evaluate_mirrored},
        solution::{PoseEstimate, Solution},
        state::{Problem, State},
    },
};
use crate::marker::Pattern;
use disc_heading::YawEstimate;
use frontal::{FrontalPose, FrontalResult};

/// The path that a fit took, which the next one of the ring tries first.
#[derive(Clone, Copy, Debug, Default)]
pub struct FitPath {
    /// State of the robust fit, if one was needed lately.
    pub robust: Option<RobustState>,
    /// Whether the roundel nearly faced the camera.
    pub faces: bool,
}

/// The best pose from a start, and its path for the next frame. `deviation_rad` is the standard
/// deviation of an elliptical disc's heading there, `before` the path of the frame before.
pub fn estimate_pose(
    problem: &Problem,
    first: State,
    deviation_rad: Option<f64>,
    before: &FitPath,
    scratch: &mut FitScratch,
) -> Result<(PoseEstimate, FitPath), FitError> {
    let resumable = before.robust.as_ref().filter(|robust| !robust.expects_plain());
    if problem.teeth.is_none() && deviation_rad.is_none() {
        if let Some(resumable) = resumable {
            if let Ok((estimate, path)) = resume_robust(problem, &first, resumable, scratch) {
                return Ok((estimate, path));
            }
        } else if before.faces
            && let Some(estimate) = still_facing(problem, &first, &mut scratch.model)
        {
            return Ok((estimate, before.after_plain(true)));
        }
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
    if let Some(resumable) = resumable
        && let Some(heading) = heading
        && !solution.is_plain()
        && let Ok((mut estimate, path)) =
            resume_robust(problem, &solution.state, resumable, scratch)
    {
        heading.inflated(&solution).add_to(problem, &mut estimate);
        return Ok((estimate, path));
    }
    if problem.is_still && !solution.is_plain() {
        let moving = Problem { is_still: false, ..*problem };
        let before = FitPath { faces: false, ..*before };
        return estimate_pose(&moving, solution.state, deviation_rad, &before, scratch);
    }
    let mut path = before.after_plain(false);
    let mut found = frontal::estimate(problem, &solution, &mut scratch.model);
    if let FrontalResult::Further(state) = found {
        solution = gauss_newton::solve(problem, state, &mut scratch.model)?;
        found = frontal::estimate(problem, &solution, &mut scratch.model);
    }
    let (mut estimate, heading) = match found {
        FrontalResult::Facing(first, other, likelihood) if solution.is_plain() => {
            let estimate = frontal_pose(problem, &solution, first, other, likelihood);
            path.faces = true;
            (estimate, heading.map(YawEstimate::decorrelated))
        }
        _ => {
            let heading = match heading {
                Some(heading) if !solution.is_plain() => Some(heading.inflated(&solution)),
                _ => heading,
            };
            let robust = before.robust.as_ref();
            let (estimate, next) = tilted_pose(problem, solution, robust, scratch)?;
            path.robust = next.or(path.robust);
            (estimate, heading)
        }
    };
    if let Some(heading) = heading {
        heading.add_to(problem, &mut estimate);
    }
    Ok((estimate, path))
}

impl FitPath {
    /// After a frame for which the plain fit sufficed.
    fn after_plain(&self, faces: bool) -> Self {
        Self { robust: self.robust.map(RobustState::after_plain), faces }
    }
}

/// The pose of a roundel that still nearly faces the camera, without steps to a minimum, which is
/// flat there; `None` if it does not.
fn still_facing(
    problem: &Problem,
    start: &State,
    scratch: &mut ModelScratch,
) -> Option<PoseEstimate> {
    let mut equations = linearize(problem, start, None, scratch).ok()?;
    let change = equations.bounded_step(start, equations.noise2(), 0.0)?;
    let misfit = (equations.misfit - equations.gain(&change)).max(0.0);
    let noise2 = equations.noise2_for(misfit);
    let solution = Solution { state: start.clone(), misfit, noise2, iterations: 1, equations };
    let found = frontal::estimate(problem, &solution, scratch);
    let FrontalResult::Facing(first, other, likelihood) = found else { return None };
    let equations = linearize(problem, &first.state, Some(&solution.equations), scratch).ok()?;
    let (misfit, noise2) = (equations.misfit, equations.noise2());
    let state = first.state.clone();
    let solution = Solution { state, misfit, noise2, iterations: 4, equations };
    let is_plain = solution.is_plain();
    is_plain.then(|| frontal_pose(problem, &solution, first, other, likelihood))
}

/// The robust fit from the state of an earlier frame.
fn resume_robust(
    problem: &Problem,
    start: &State,
    before: &RobustState,
    scratch: &mut FitScratch,
) -> Result<(PoseEstimate, FitPath), FitError> {
    let still = Problem { is_still: true, ..*problem };
    let found = robust::solve(&still, &start.without_motion(), Some(before), scratch)?;
    check_disc(problem, scratch)?;
    let (estimate, next) = found;
    Ok((estimate, FitPath { robust: Some(next), faces: false }))
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
    before: Option<&RobustState>,
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
        let (estimate, next) = robust::solve(&still, &start, before, scratch)?;
        check_disc(problem, scratch)?;
        return Ok((estimate, Some(next)));
    }
    let factor = solution.factor().ok_or(FitError::Uninformative)?;
    let own = factor.inverse_of_last() * solution.noise2;
    Ok((solution.estimate(problem, &own, other), None))
}
