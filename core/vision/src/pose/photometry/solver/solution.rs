//! Result of a fit: noise test, covariance, and rims.

use nalgebra::{SMatrix, Vector3};

use super::{
    cholesky::{Cholesky, Unknowns},
    linearize::project,
    mirror::MirrorEstimate,
    normal_equations::NormalEquations,
    state::{MOTION, Problem, State},
};
use crate::{
    ellipse::{Ellipse, Shape},
    pose::photometry::model::ModelScratch,
    rigid::{Covariance6, UNKNOWN_ANGLE_VARIANCE_RAD2},
};

#[derive(Clone, Debug)]
pub struct Solution {
    pub state: State,
    /// Sum of squared residuals, grey levels².
    pub misfit: f64,
    /// Variance of a pixel, grey levels².
    pub noise2: f64,
    pub iterations: usize,
    pub equations: NormalEquations,
}

/// Result of a fit, local frame; the covariance is in the camera frame.
pub struct PoseEstimate {
    pub state: State,
    pub other_normal: Vector3<f64>,
    pub likelihood: f64,
    /// From this position to that with the other normal.
    pub other_offset_m: Vector3<f64>,
    /// Given this normal.
    pub covariance: Covariance6,
    pub noise2: f64,
    /// Variance of either component of the motion's square by noise, px⁴.
    pub motion_variance: Option<f64>,
    pub iterations: usize,
}

/// Over two shifts, logarithm of the range and two rotations.
pub type Covariance5 = SMatrix<f64, 5, 5>;

/// Distance of white and black from the ends of the scale, in standard deviations of the noise.
const ENDS_NOISE: f64 = 3.0;

impl Solution {
    /// Whether noise explains the residual, and white and black are within the scale.
    pub fn is_plain(&self) -> bool {
        let (state, equations) = (&self.state, &self.equations);
        let slack = ENDS_NOISE * self.noise2.sqrt();
        let levels = [state.white, state.white + state.step];
        let (low, high) = (levels[0].min(levels[1]), levels[0].max(levels[1]));
        equations.is_noise_only() && low > slack && high < 255.0 - slack
    }

    /// Factor of the information with priors.
    pub fn factor(&self) -> Option<Cholesky> {
        let (information, _) = self.equations.with_prior(&self.state, self.noise2);
        Cholesky::new(&information, self.equations.free_unknowns())
    }

    /// This pose with its covariance over shift, range and rotations, and the mirrored one.
    pub fn estimate(
        self,
        problem: &Problem,
        own: &Covariance5,
        other: Option<MirrorEstimate>,
    ) -> PoseEstimate {
        let turns = [0, 1].map(|axis| self.state.pose.axes.column(axis).into_owned());
        let worse = other
            .as_ref()
            .map_or(f64::INFINITY, |other| (other.misfit - self.misfit).max(0.0) / self.noise2);
        PoseEstimate {
            other_normal: self.state.mirrored().pose.axes.column(2).into_owned(),
            likelihood: 1.0 / (1.0 + (-0.5 * worse).exp()),
            other_offset_m: other.map_or(Vector3::zeros(), |other| other.other_offset_m),
            covariance: self.in_camera_frame(problem, &self.state, own, &turns),
            noise2: self.noise2,
            motion_variance: self.motion_variance(),
            iterations: self.iterations,
            state: self.state,
        }
    }

    /// Variance by noise of either component of the motion's square, px⁴, without the prior's part;
    /// `None` where the motion was held.
    pub fn motion_variance(&self) -> Option<f64> {
        let prior = self.equations.ring.motion_prior?;
        let factor = self.factor()?;
        let variance = |unknown: usize| {
            let mut unit = Unknowns::zeros();
            unit[unknown] = self.noise2;
            factor.solve(&unit)[unknown]
        };
        let posterior = 0.5 * (variance(MOTION) + variance(MOTION + 1));
        let prior = prior + self.state.motion2.norm_squared();
        Some(posterior * (1.0 - posterior / prior).max(0.0))
    }

    /// Converts a covariance over shift, range and rotations about `turns` to one of (position,
    /// rotation) in the camera frame, with the variance of an unknown angle about the normal.
    pub fn in_camera_frame(
        &self,
        problem: &Problem,
        state: &State,
        own: &Covariance5,
        turns: &[Vector3<f64>; 2],
    ) -> Covariance6 {
        let camera_from_local = problem.lens.local_from_camera.transpose();
        let (unit_m, pose) = (self.equations.ring.unit_m, &state.pose);
        let mut map = SMatrix::<f64, 6, 5>::zeros();
        let along = [Vector3::x() * unit_m, Vector3::y() * unit_m, pose.position_m];
        for (column, along) in along.into_iter().enumerate() {
            map.fixed_view_mut::<3, 1>(0, column).copy_from(&(camera_from_local * along));
        }
        for (axis, turn) in turns.iter().enumerate() {
            map.fixed_view_mut::<3, 1>(3, 3 + axis).copy_from(&(camera_from_local * turn));
        }
        let mut covariance = map * (0.5 * (own + own.transpose())) * map.transpose();
        let normal = camera_from_local * pose.axes.column(2);
        let mut rotation = covariance.fixed_view_mut::<3, 3>(3, 3);
        rotation += normal * normal.transpose() * UNKNOWN_ANGLE_VARIANCE_RAD2;
        covariance
    }
}

/// A blur for which nodes are as sparse as possible: areas and moments need few.
const FEW_NODES_PX: f64 = 1e6;

/// Both rims that a state implies.
pub fn rims(
    problem: &Problem,
    state: &State,
    scratch: &mut ModelScratch,
) -> Option<(Ellipse, Ellipse)> {
    // The disc's rim without teeth.
    let without_teeth = Problem { teeth: None, ..*problem };
    project(&without_teeth, state, FEW_NODES_PX, scratch.window.origin, scratch);
    let nodes = &scratch.nodes;
    let outer = nodes.outer;
    let rim = |from: usize, to: usize| {
        let (x, y, dx, dy) =
            (&nodes.x[from..to], &nodes.y[from..to], &nodes.dx[from..to], &nodes.dy[from..to]);
        ellipse_of(x, y, dx, dy, scratch.window.origin)
    };
    Some((rim(0, outer)?, rim(outer, nodes.x.len())?))
}

/// Ellipse with the area, centre and second moments of a contour.
fn ellipse_of(x: &[f32], y: &[f32], dx: &[f32], dy: &[f32], origin: (i64, i64)) -> Option<Ellipse> {
    let points = (0..x.len()).map(|i| [x[i], y[i], dx[i], dy[i]].map(f64::from));
    let mut shape = Shape::of_contour(points);
    shape.center.u += origin.0 as f64;
    shape.center.v += origin.1 as f64;
    let ellipse = shape.ellipse();
    ellipse.is_valid().then_some(ellipse)
}
