//! Heading of an elliptical disc from grey levels, by the profile of the misfit.
//!
//! The contour is an ellipse within a circle that rotates with the print. With the heading ψ held,
//! the fit of all else leaves the misfit S(ψ), which near the truth is
//!
//!   S(ψ) = S₀ + σ² (ψ - ψ₀)²/σ_ψ²
//!
//! with σ² the variance of a pixel and σ_ψ² that of the heading with all else unknown. Three fits,
//! at ψ and some standard deviations to either side, give the heading and its variance, and the
//! differences of their positions and normals show how these depend on it. The last fit is that at
//! ψ₀. A column for the heading would slow down the loops of all roundels.
//!
//! Where residuals are correlated, the robust fit keeps this heading, with a variance that grows
//! with the correlation. With part of the disc's rim occluded there is no heading.
//!
//! Time: three times that of a plain roundel (`benches/fit.rs`: 37 µs instead of 12 µs, at 30 px).
//! Accuracy against the Cramér-Rao bound: `tests/elliptical.rs` of the tests crate.

use nalgebra::Vector3;

use crate::{
    pose::photometry::{
        FitError,
        model::ModelScratch,
        solver::{
            gauss_newton,
            solution::{PoseEstimate, Solution},
            state::{Problem, State},
        },
    },
    rigid::UNKNOWN_ANGLE_VARIANCE_RAD2,
};

/// Distance of the compared headings, in standard deviations of the start …
const SPACING_SIGMA: f64 = 2.5;
/// … and its limits, radians.
const LIMITS_RAD: (f64, f64) = (2e-3, 0.12);
/// A heading farther from the middle one than this, in units of the distance, becomes the new
/// middle …
const MAX_EXTRAPOLATION: f64 = 1.5;
/// … and no farther than this.
const MAX_STEP: f64 = 3.0;
const MAX_ITERATIONS: usize = 4;

/// Error of the yaw, and how position and rotation depend on it.
#[derive(Clone, Copy, Debug)]
pub struct YawEstimate {
    variance_rad2: f64,
    /// Derivatives of position and rotation by the yaw, local frame.
    position_m: Vector3<f64>,
    rotation: Vector3<f64>,
}

/// Finds all unknowns and the heading. `deviation_rad` is the standard deviation of the start's
/// heading.
pub fn solve(
    problem: &Problem,
    start: State,
    deviation_rad: f64,
    scratch: &mut ModelScratch,
) -> Result<(Solution, YawEstimate), FitError> {
    let spacing_rad = (SPACING_SIGMA * deviation_rad).clamp(LIMITS_RAD.0, LIMITS_RAD.1);
    let mut middle = gauss_newton::solve(problem, start, scratch)?;
    for _ in 0..MAX_ITERATIONS {
        let mut beside =
            |by_rad: f64| gauss_newton::solve(problem, middle.state.rotated(by_rad), scratch);
        let (ahead, behind) = (beside(spacing_rad)?, beside(-spacing_rad)?);
        let slope = 0.5 * (ahead.misfit - behind.misfit) / spacing_rad;
        let bend =
            (ahead.misfit + behind.misfit - 2.0 * middle.misfit) / (spacing_rad * spacing_rad);
        let falls = slope.abs() / spacing_rad;
        let by_rad = if bend > falls / MAX_STEP {
            -slope / bend
        } else {
            -slope.signum() * MAX_STEP * spacing_rad
        };
        let found = gauss_newton::solve(problem, middle.state.rotated(by_rad), scratch)?;
        if by_rad.abs() <= MAX_EXTRAPOLATION * spacing_rad {
            let heading = YawEstimate::between(
                &ahead.state,
                &behind.state,
                spacing_rad,
                2.0 * found.noise2 / bend,
            );
            return Ok((found, heading));
        }
        middle = found;
    }
    Err(FitError::NotConverged)
}

impl State {
    /// Rotated about the normal.
    pub fn rotated(&self, by_rad: f64) -> Self {
        let mut next = self.clone();
        let axes = &self.pose.axes;
        let (sin, cos) = by_rad.sin_cos();
        let (a, b) = (axes.column(0).into_owned(), axes.column(1).into_owned());
        next.pose.axes.set_column(0, &(a * cos + b * sin));
        next.pose.axes.set_column(1, &(b * cos - a * sin));
        next
    }
}

impl YawEstimate {
    pub fn new(variance_rad2: f64, position_m: Vector3<f64>, rotation: Vector3<f64>) -> Self {
        Self { variance_rad2, position_m, rotation }
    }

    fn between(ahead: &State, behind: &State, spacing_rad: f64, variance_rad2: f64) -> Self {
        let per = 0.5 / spacing_rad;
        let normal = |state: &State| state.pose.axes.column(2).into_owned();
        let position_m = (ahead.pose.position_m - behind.pose.position_m) * per;
        Self::new(variance_rad2, position_m, normal(behind).cross(&normal(ahead)) * per)
    }

    /// With the variance of residuals that are correlated over patches of pixels.
    pub fn inflated(self, solution: &Solution) -> Self {
        let growth = solution.equations.patch_ratio.max(1.0);
        Self { variance_rad2: self.variance_rad2 * growth, ..self }
    }

    /// Without dependence of the pose: near face-on the errors of the tilt dominate.
    pub fn decorrelated(self) -> Self {
        Self { position_m: Vector3::zeros(), rotation: Vector3::zeros(), ..self }
    }

    /// Replaces the variance of an unknown yaw by this one.
    pub fn add_to(&self, problem: &Problem, estimate: &mut PoseEstimate) {
        let camera_from_local = problem.lens.local_from_camera.transpose();
        let normal = estimate.state.pose.axes.column(2);
        let mut by_heading = nalgebra::Vector6::zeros();
        let (pose, turn) = (self.position_m, self.rotation + normal);
        by_heading.fixed_rows_mut::<3>(0).copy_from(&(camera_from_local * pose));
        by_heading.fixed_rows_mut::<3>(3).copy_from(&(camera_from_local * turn));
        let normal = camera_from_local * normal;
        let mut rotation = estimate.covariance.fixed_view_mut::<3, 3>(3, 3);
        rotation -= normal * normal.transpose() * UNKNOWN_ANGLE_VARIANCE_RAD2;
        estimate.covariance += by_heading * by_heading.transpose() * self.variance_rad2;
    }
}
