//! Where the pixels put the roundel: descent from the start, then whichever of both normals, face-on poses and
//! disturbed rings they speak for.

mod disc_heading;
mod frontal;
mod teeth_yaw;

use nalgebra::Vector3;

use super::{
    FitError, FitScratch, robust,
    solver::{
        gauss_newton,
        mirror::{Glance, glance},
        normal_equation_cache::RecalledProducts,
        solution::Solution,
        state::{Problem, State},
    },
};
use crate::{ellipse::Ellipse, marker::Pattern, rigid::Covariance6};
use disc_heading::Heading;
use frontal::{Leaning, Upright};

/// What a fit comes to, in the local frame but for the covariance, which is the camera's.
pub struct Placed {
    pub state: State,
    pub other_normal: Vector3<f64>,
    pub likelihood: f64,
    /// From this position to that of the other normal.
    pub apart_m: Vector3<f64>,
    /// With this normal.
    pub covariance: Covariance6,
    pub noise2: f64,
    /// Of either part of the motion's square by noise, px⁴.
    pub motion_variance: Option<f64>,
    pub iterations: usize,
    /// For later frames.
    pub recalled: Option<RecalledProducts>,
}

/// The place that the pixels within `counted` tell, from a start; of an elliptical disc its heading's
/// deviation is that of the start.
pub fn placed(
    problem: &Problem,
    first: State,
    deviation_rad: Option<f64>,
    counted: &Ellipse,
    scratch: &mut FitScratch,
) -> Result<Placed, FitError> {
    let mut heading = None;
    let mut solution = match (problem.teeth, deviation_rad) {
        (Some(_), _) => {
            let (solution, found) = teeth_yaw::solve(problem, first, scratch)?;
            heading = Some(found);
            solution
        }
        (None, Some(deviation_rad)) => {
            let (solution, found) = disc_heading::solve(problem, first, deviation_rad, scratch)?;
            heading = Some(found);
            solution
        }
        (None, None) => gauss_newton::solve(problem, first, scratch)?,
    };
    if problem.is_still && !solution.is_plain() {
        let moving = Problem { is_still: false, ..*problem };
        return placed(&moving, solution.state, deviation_rad, counted, scratch);
    }
    let mut found = frontal::estimate(problem, &solution, scratch);
    if let Upright::Further(state) = found {
        solution = gauss_newton::solve(problem, state, scratch)?;
        found = frontal::estimate(problem, &solution, scratch);
    }
    let (mut placed, heading) = match found {
        Upright::Facing(first, other, likelihood) if solution.is_plain() => {
            let placed = upright(problem, &solution, (first, other, likelihood));
            (placed, heading.map(Heading::alone))
        }
        _ => {
            let heading = match heading {
                Some(heading) if !solution.is_plain() => Some(heading.disturbed(&solution)),
                _ => heading,
            };
            (tilted(problem, &mut solution, counted, scratch)?, heading)
        }
    };
    if let Some(heading) = heading {
        heading.add_to(problem, &mut placed);
    }
    Ok(placed)
}

/// One lean, or two, of a roundel that nearly faces the camera.
fn upright(
    problem: &Problem,
    solution: &Solution,
    (first, other, likelihood): (Leaning, Option<Leaning>, f64),
) -> Placed {
    let Leaning { state, covariance, turns } = first;
    let covariance = solution.carried(problem, &state, &covariance, &turns);
    let second = other.map_or(state.place, |other| other.state.place);
    Placed {
        other_normal: second.axes.column(2).into_owned(),
        likelihood,
        apart_m: second.position_m - state.place.position_m,
        covariance,
        noise2: solution.noise2,
        motion_variance: solution.motion_variance(),
        iterations: solution.iterations,
        recalled: None,
        state,
    }
}

/// The solution, or that of the mirrored place if it is nearer to the pixels; the careful one where
/// noise explains neither.
fn tilted(
    problem: &Problem,
    solution: &mut Solution,
    counted: &Ellipse,
    scratch: &mut FitScratch,
) -> Result<Placed, FitError> {
    let mut factor = solution.factor();
    let at = (&solution.linear, solution.noise2, factor.as_ref());
    let mut other = glance(problem, &solution.state, at, scratch);
    if let Some(better) = &other
        && better.misfit < solution.misfit
        && let Ok(found) = gauss_newton::solve(problem, better.state.clone(), scratch)
    {
        let normal = |solution: &Solution| solution.state.place.axes.column(2).into_owned();
        let back = normal(&found).dot(&normal(solution));
        // Near face-on the mirrored place may have no minimum of its own; then it counts as it is.
        let own = back < normal(&found).dot(&solution.state.mirrored().place.axes.column(2));
        let apart_m = found.state.place.position_m - solution.state.place.position_m;
        let misfit = match &other {
            Some(other) if !own => other.unmoved,
            _ => found.misfit.max(solution.misfit),
        };
        let better = found.misfit < solution.misfit;
        other = Some(Glance { misfit, unmoved: misfit, apart_m, state: found.state.clone() });
        if better {
            *solution = found;
            factor = solution.factor();
        }
    }
    if !solution.is_plain() {
        // Other teeth than presumed, or another yaw, would pass for a cover.
        if problem.is_presumed && solution.linear.is_of_another() {
            return Err(FitError::Disturbed);
        }
        // What disturbs the ring may have passed for motion, and taken the pose along.
        let still = Problem { is_still: true, ..*problem };
        let stopped = solution.state.stopped();
        let start = gauss_newton::solve(&still, stopped.clone(), scratch);
        let start = start.map_or(stopped, |solution| solution.state);
        let placed = robust::solve(&still, &start, counted, scratch)?;
        // With part of it covered, the disc's rim would be turned.
        let is_elliptical = matches!(problem.kind.pattern, Pattern::Elliptical { .. });
        if is_elliptical && !scratch.careful.keeps_disc() {
            return Err(FitError::Disturbed);
        }
        return Ok(placed);
    }
    let likelihood = other.as_ref().map_or(1.0, |other| {
        let worse = (other.misfit - solution.misfit).max(0.0) / solution.noise2;
        1.0 / (1.0 + (-0.5 * worse).exp())
    });
    Ok(Placed {
        other_normal: solution.state.mirrored().place.axes.column(2).into_owned(),
        likelihood,
        apart_m: other.map_or(Vector3::zeros(), |other| other.apart_m),
        covariance: solution.covariance(problem, &factor.ok_or(FitError::Flat)?),
        noise2: solution.noise2,
        motion_variance: solution.motion_variance(),
        iterations: solution.iterations,
        recalled: solution.recalled(problem),
        state: solution.state.clone(),
    })
}
