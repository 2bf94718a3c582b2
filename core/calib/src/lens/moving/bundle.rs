//! Joint estimate of a camera's intrinsics, pose and clock, by damped least squares.
//!
//! The residual is the predicted minus the observed centre of a rim. The prediction is the image of the roundel's
//! interpolated position at the corrected stamp, plus the centroid's offset ([`super::super::fit::rim`]), which is updated
//! between rounds. Its covariance is J Σ Jᵀ + s² r̄/r + τ² v vᵀ: Σ is the uncertainty of the position, s the error of the
//! centre of a rim of mean radius r̄, and τ the jitter of stamps (v: image velocity); s and τ are estimated from the
//! residuals ([`super::noise_model`]). The first rounds use Huber's loss (1964), so that swapped roundels get little
//! weight; then residuals beyond five deviations are rejected.

use nalgebra::{DMatrix, DVector, Matrix2, Matrix2x3, Matrix2xX, Point2, Vector2, Vector3};

use super::{
    super::fit::{
        parameters::{CameraJacobian, CameraParameters, pose_jacobian, stepped_pose},
        rim,
    },
    jackknife::{Jackknife, Linearized, jackknife},
    noise_model::{NoiseModel, NoiseSample},
    trajectory::{Trajectory, Waypoint},
};
use crate::{
    least_squares::{LeastSquares, NormalEquations, minimize},
    robust::{HUBER, OUTLIER, deviation, huber},
};
use roundel_vision::{camera::Camera, rigid::Rigid};

/// Rounds with Huber's loss, and rounds in all.
const ROBUST_ROUNDS: usize = 4;
const ROUNDS: usize = 8;
/// Steps of a round, and the relative gain at which it ends.
const MAX_STEPS: usize = 30;
const TOLERANCE: f64 = 1e-9;
/// Cost of a point without image during the robust rounds, deviations.
const UNSEEN: f64 = 1e4;
/// Whitened residuals below this are rounding errors.
const LEAST: f64 = 1e-9;
/// Unknowns of pose and clock.
const POSE_COUNT: usize = 6;
const CLOCK: usize = 2;

#[derive(Clone)]
pub(super) struct Observation {
    pub(super) trajectory: usize,
    pub(super) stamp_s: f64,
    pub(super) observed: Vector2<f64>,
    pub(super) radius_px: f64,
    /// Centroid minus image of the centre, pixels.
    pub(super) offset: Vector2<f64>,
    /// W, with Wᵀ W the inverse covariance.
    pub(super) whitener: Matrix2<f64>,
}

#[derive(Clone)]
pub(super) struct Bundle<'a> {
    pub(super) parameters: CameraParameters,
    pub(super) trajectories: &'a [Trajectory],
    pub(super) observations: Vec<Observation>,
    pub(super) camera_from_world: Rigid,
    /// Delay of the stamps, seconds, and its change per second.
    pub(super) clock: [f64; CLOCK],
    /// Prior standard deviations of these.
    pub(super) clock_prior: [f64; CLOCK],
    pub(super) noise: NoiseModel,
    /// Whether the noise model was estimated by another fit and must not change.
    pub(super) is_noise_fixed: bool,
}

pub(super) struct Fit<'a> {
    pub(super) bundle: Bundle<'a>,
    pub(super) camera: Camera,
    /// Over free parameters, pose (rotation, then translation: camera_from_world, left perturbation) and clock.
    pub(super) covariance: DMatrix<f64>,
    /// Factor by which the parameters' variances exceed those for independent errors.
    pub(super) inflation: f64,
    /// Sum of whitened squares.
    pub(super) squares: f64,
    /// Rms distance, pixels.
    pub(super) rms_px: f64,
}

/// An observation at the current state.
struct Residual {
    at: Waypoint,
    /// Predicted minus observed.
    error: Vector2<f64>,
    /// Derivative of the pixel by the position in the camera.
    jacobian: Matrix2x3<f64>,
    /// Position before and after the translation of camera_from_world, camera axes.
    rotated_m: Vector3<f64>,
    position_m: Vector3<f64>,
}

impl<'a> Bundle<'a> {
    /// Runs a few robust rounds without rejections; returns the median whitened distance, or `None` if there is no
    /// valid camera.
    pub(super) fn fit_roughly(&mut self) -> Option<f64> {
        for _ in 0..2 {
            self.update_weights()?;
            let limit = HUBER * self.scale()?;
            minimize(self, limit, MAX_STEPS, TOLERANCE)?;
        }
        self.scale()
    }

    /// Returns `None` if it does not converge to a valid camera.
    pub(super) fn fit(mut self) -> Option<Fit<'a>> {
        for round in 0..ROUNDS {
            self.update_weights()?;
            if round == ROBUST_ROUNDS {
                self.reject_outliers()?;
            }
            let limit = if round < ROBUST_ROUNDS { HUBER * self.scale()? } else { f64::MAX };
            minimize(&mut self, limit, MAX_STEPS, TOLERANCE)?;
            if !self.is_noise_fixed {
                let camera = self.parameters.camera()?;
                let observations = self.observations.iter();
                let samples = observations.filter_map(|it| self.noise_sample(&camera, it));
                self.noise = NoiseModel::fit(&samples.collect::<Vec<_>>());
            }
        }
        self.update_weights()?;
        self.finish()
    }

    /// Time of a stamp on the clock of the other cameras.
    fn time_s(&self, stamp_s: f64) -> f64 {
        stamp_s - self.clock[0] - self.clock[1] * stamp_s
    }

    /// Returns `None` if the trajectory has a gap at this time or the point has no image.
    fn residual(&self, camera: &Camera, observation: &Observation) -> Option<Residual> {
        let at = self.trajectories[observation.trajectory].at(self.time_s(observation.stamp_s))?;
        let rotated_m = self.camera_from_world.rotation * at.position_m;
        let position_m = rotated_m + self.camera_from_world.translation.vector;
        let (pixel, jacobian) = camera.project_with_jacobian(&position_m).ok()?;
        let error = Vector2::new(pixel.u, pixel.v) + observation.offset - observation.observed;
        Some(Residual { at, error, jacobian, rotated_m, position_m })
    }

    fn update_weights(&mut self) -> Option<()> {
        let camera = self.parameters.camera()?;
        let mut observations = std::mem::take(&mut self.observations);
        let sum_px: f64 = observations.iter().map(|observation| observation.radius_px).sum();
        let mean_px = sum_px / observations.len().max(1) as f64;
        for observation in &mut observations {
            let Some(residual) = self.residual(&camera, observation) else { continue };
            let orientation = self.camera_from_world.rotation * residual.at.orientation;
            let pose = Rigid::from_parts(residual.position_m.into(), orientation);
            let radius_m = self.trajectories[observation.trajectory].radius_m();
            if let Ok(image) = rim::project_rim(&camera, &pose, &Point2::origin(), radius_m) {
                observation.offset = image.offset_px;
            }
            let size = mean_px / observation.radius_px;
            let image_velocity = self.image_velocity(&residual);
            let covariance = self.position_covariance_px2(&residual)
                + Matrix2::identity() * (self.noise.pixel_px.powi(2) * size)
                + image_velocity * image_velocity.transpose() * self.noise.stamp_s.powi(2);
            observation.whitener = covariance.cholesky()?.l().try_inverse()?;
        }
        self.observations = observations;
        Some(())
    }

    /// Covariance of the image that the position's uncertainty causes.
    fn position_covariance_px2(&self, residual: &Residual) -> Matrix2<f64> {
        let by_world =
            residual.jacobian * self.camera_from_world.rotation.to_rotation_matrix().into_inner();
        by_world * residual.at.covariance_m2 * by_world.transpose()
    }

    /// Pixels per second.
    fn image_velocity(&self, residual: &Residual) -> Vector2<f64> {
        residual.jacobian * (self.camera_from_world.rotation * residual.at.velocity_m_s)
    }

    /// A residual along and across the motion.
    fn noise_sample(&self, camera: &Camera, observation: &Observation) -> Option<NoiseSample> {
        let residual = self.residual(camera, observation)?;
        let image_velocity = self.image_velocity(&residual);
        let along = image_velocity.try_normalize(1e-9).unwrap_or_else(Vector2::x);
        let across = Vector2::new(-along.y, along.x);
        let prior = self.position_covariance_px2(&residual);
        let of =
            |axis: Vector2<f64>| (axis.dot(&residual.error).powi(2), axis.dot(&(prior * axis)));
        Some(NoiseSample {
            along: of(along),
            across: of(across),
            px_per_s: image_velocity.norm(),
            radius_px: observation.radius_px,
        })
    }

    /// Whitened distances; infinite for points without image.
    fn distances(&self) -> Option<Vec<f64>> {
        let camera = self.parameters.camera()?;
        let distance = |observation: &Observation| {
            let residual = self.residual(&camera, observation)?;
            Some((observation.whitener * residual.error).norm()).filter(|it| it.is_finite())
        };
        let distances = self.observations.iter().map(|it| distance(it).unwrap_or(f64::INFINITY));
        Some(distances.collect())
    }

    /// Standard deviation of a whitened coordinate.
    fn scale(&self) -> Option<f64> {
        let deviation = deviation(&mut self.distances()?)?;
        deviation.is_finite().then(|| deviation.max(LEAST))
    }

    fn reject_outliers(&mut self) -> Option<()> {
        let limit = OUTLIER * self.scale()?;
        let mut distances = self.distances()?.into_iter();
        self.observations.retain(|_| distances.next().is_some_and(|it| it <= limit));
        Some(())
    }

    fn unknowns(&self) -> usize {
        self.parameters.unknowns() + POSE_COUNT + CLOCK
    }

    /// Prior information about the clock.
    fn prior(&self) -> DMatrix<f64> {
        let size = self.unknowns();
        let mut information = DMatrix::zeros(size, size);
        for i in 0..CLOCK {
            let at = size - CLOCK + i;
            information[(at, at)] = self.clock_prior[i].powi(-2);
        }
        information
    }

    /// Linearized observations, weighted by Huber's loss, and the sum of squares.
    fn linearized(&self, limit: f64) -> Option<(Vec<Linearized>, f64)> {
        let camera_jacobian = self.parameters.jacobian()?;
        let mut squares = 0.0;
        let part = |observation: &Observation| {
            let residual = self.residual(&camera_jacobian.camera, observation)?;
            let mut error = observation.whitener * residual.error;
            let norm = error.norm();
            if !norm.is_finite() {
                return None;
            }
            squares += norm * norm;
            let mut slopes = self.slopes(&camera_jacobian, observation, &residual)?;
            if norm > limit {
                let root = (limit / norm).sqrt();
                error *= root;
                slopes *= root;
            }
            let Observation { trajectory, stamp_s, .. } = *observation;
            Some(Linearized { trajectory, stamp_s, slopes, error })
        };
        let linearized = self.observations.iter().filter_map(part).collect();
        Some((linearized, squares))
    }

    /// Whitened derivatives by all unknowns.
    fn slopes(
        &self,
        camera_jacobian: &CameraJacobian,
        observation: &Observation,
        residual: &Residual,
    ) -> Option<Matrix2xX<f64>> {
        let by_lens = camera_jacobian.at(&residual.position_m)?;
        let first = by_lens.ncols();
        let mut slopes = by_lens.resize_horizontally(self.unknowns(), 0.0);
        let by_pose = pose_jacobian(&residual.jacobian, &residual.rotated_m);
        slopes.fixed_columns_mut::<POSE_COUNT>(first).copy_from(&by_pose);
        let image_velocity = -self.image_velocity(residual);
        slopes.set_column(first + POSE_COUNT, &image_velocity);
        slopes.set_column(first + POSE_COUNT + 1, &(image_velocity * observation.stamp_s));
        Some(observation.whitener * slopes)
    }

    fn finish(self) -> Option<Fit<'a>> {
        let camera = self.parameters.camera()?;
        let (linearized, squares) = self.linearized(f64::MAX)?;
        let Jackknife { covariance, plain } = jackknife(&linearized, &self.prior())?;
        let lens = self.parameters.unknowns();
        let ratio = (0..lens).map(|i| covariance[(i, i)] / plain[(i, i)]).sum::<f64>();
        let residuals = self.observations.iter().filter_map(|it| self.residual(&camera, it));
        let squares_px: f64 = residuals.map(|residual| residual.error.norm_squared()).sum();
        let rms_px = (squares_px / self.observations.len().max(1) as f64).sqrt();
        let inflation = (ratio / lens as f64).max(1.0);
        Some(Fit { bundle: self, camera, covariance, inflation, squares, rms_px })
    }
}

impl LeastSquares for Bundle<'_> {
    type Normal = NormalEquations;

    fn cost(&self, limit: f64) -> Option<f64> {
        // In the last rounds, a roundel whose trajectory ends here must not prevent a step.
        let unseen_cost = if limit < f64::MAX { UNSEEN } else { OUTLIER };
        let finite = |it: f64| if it.is_finite() { it } else { unseen_cost };
        let observed = self.distances()?.into_iter().map(|it| huber(finite(it), limit));
        let clock = (0..CLOCK).map(|i| (self.clock[i] / self.clock_prior[i]).powi(2));
        Some(observed.sum::<f64>() + clock.sum::<f64>())
    }

    fn normal(&self, limit: f64) -> Option<NormalEquations> {
        let (linearized, _) = self.linearized(limit)?;
        let size = self.unknowns();
        let gradient = DVector::zeros(size);
        let mut normal = NormalEquations { information: self.prior(), gradient };
        for i in 0..CLOCK {
            let at = size - CLOCK + i;
            normal.gradient[at] -= self.clock[i] / self.clock_prior[i].powi(2);
        }
        for Linearized { slopes, error, .. } in &linearized {
            normal.add(slopes, error);
        }
        Some(normal)
    }

    fn stepped(&self, normal: &NormalEquations, damping: f64) -> Option<Self> {
        let step = normal.step(damping)?;
        let mut stepped = self.clone();
        stepped.parameters.step(step.as_slice());
        let place = self.parameters.unknowns();
        let pose_step = step.fixed_rows::<POSE_COUNT>(place).into_owned();
        stepped.camera_from_world = stepped_pose(&self.camera_from_world, &pose_step);
        for i in 0..CLOCK {
            stepped.clock[i] += step[place + POSE_COUNT + i];
        }
        Some(stepped)
    }
}

impl Fit<'_> {
    /// Depths of the observed roundels, metres.
    pub(super) fn depths_m(&self) -> Vec<f64> {
        let observations = self.bundle.observations.iter();
        let residuals = observations.filter_map(|it| self.bundle.residual(&self.camera, it));
        residuals.map(|residual| residual.position_m.z).collect()
    }
}
