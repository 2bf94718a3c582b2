//! Bundle adjustment: camera parameters and the board's pose in each view, by damped least squares.
//!
//! The poses are eliminated exactly (Schur complement), so the cost of a step is linear in the number of views. The
//! residual is the observed centre minus the image of the roundel's centre plus the centroid's offset ([`super::rim`]),
//! which hardly depends on the unknowns and is updated between rounds. The dependence of a centre's variance on the rim's
//! radius is estimated from the residuals ([`super::center_noise`]): a weight that is not the inverse variance would cost
//! precision and bias the stated covariance σ² H⁻¹. The first rounds use Huber's loss (1964); afterwards, observations
//! beyond five deviations and views much worse than the others are rejected.

use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix2x6, Matrix2xX, Matrix6, Point2, Point3, Vector2, Vector3,
    Vector6,
};

use super::{
    center_noise::CenterNoise,
    parameters::{CameraJacobian, CameraParameters, pose_jacobian, stepped_pose},
    rim,
};
use crate::{
    least_squares::{LeastSquares, damped, minimize},
    lens::{
        MIN_VIEWS,
        views::view::{MIN_ROUNDELS, Sighting},
    },
    robust::{HUBER, OUTLIER, deviation, huber, median},
};
use roundel_vision::camera::Camera;

/// Rounds with Huber's loss, and maximum number of rounds.
const ROBUST_ROUNDS: usize = 3;
const MAX_ROUNDS: usize = 8;
/// Steps of a round, and the relative gain at which it ends.
const MAX_STEPS: usize = 40;
const TOLERANCE: f64 = 1e-12;
/// A view with a smaller share of consistent points is rejected.
const MIN_KEPT_SHARE: f64 = 0.7;
/// A view is rejected if its residuals exceed the median view's by this factor.
const BAD_VIEW_RATIO: f64 = 3.0;
/// The adjustment ends when no centre's offset changes by more than this in a round, pixels.
const OFFSET_TOLERANCE_PX: f64 = 1e-4;
/// Residuals below this are rounding errors, pixels.
const MIN_PX: f64 = 1e-6;

#[derive(Clone)]
pub(crate) struct BoardView {
    pub(crate) index: usize,
    pub(crate) pose: Isometry3<f64>,
    pub(crate) points: Vec<Point>,
}

#[derive(Clone)]
pub(crate) struct Point {
    board_m: Point2<f64>,
    observed: Vector2<f64>,
    offset: Vector2<f64>,
    radius_px: f64,
    weight: f64,
}

#[derive(Clone)]
pub(crate) struct Bundle {
    pub(crate) parameters: CameraParameters,
    /// Radius of the circles whose centroids are observed; `None` if points are observed.
    pub(crate) rim_m: Option<f64>,
    pub(crate) board_views: Vec<BoardView>,
}

pub(crate) struct Fit {
    pub(crate) camera: Camera,
    pub(crate) board_views: Vec<BoardView>,
    /// Covariance of the free parameters.
    pub(crate) covariance: DMatrix<f64>,
    /// Sum of weighted squares, and number of residuals.
    pub(crate) squares: f64,
    pub(crate) count: usize,
    pub(crate) rms_px: f64,
}

/// Normal equations, one block per view.
pub(crate) struct Normal {
    views: Vec<(Matrix6<f64>, DMatrix<f64>, Vector6<f64>)>,
    camera: DMatrix<f64>,
    gradient: DVector<f64>,
}

impl Bundle {
    /// Returns `None` if it does not converge to a valid camera.
    pub(crate) fn fit(mut self) -> Option<Fit> {
        for round in 0..MAX_ROUNDS {
            let moved_px = self.update_offsets()?;
            let limit_px = if round < ROBUST_ROUNDS { HUBER * self.scale_px()? } else { f64::MAX };
            if round == ROBUST_ROUNDS {
                self.reject_outliers()?;
            }
            minimize(&mut self, limit_px, MAX_STEPS, TOLERANCE)?;
            if round > ROBUST_ROUNDS && moved_px < OFFSET_TOLERANCE_PX {
                break;
            }
            if round >= ROBUST_ROUNDS {
                self.update_weights()?;
            }
        }
        self.finish()
    }

    /// Returns the largest change, pixels.
    fn update_offsets(&mut self) -> Option<f64> {
        let Some(rim_m) = self.rim_m else { return Some(0.0) };
        let camera = self.parameters.camera()?;
        let mut moved_px: f64 = 0.0;
        for view in &mut self.board_views {
            for point in &mut view.points {
                let image = rim::project_rim(&camera, &view.pose, &point.board_m, rim_m);
                let offset = image.ok()?.offset_px;
                moved_px = moved_px.max((offset - point.offset).norm());
                point.offset = offset;
            }
        }
        Some(moved_px)
    }

    /// Weights the points by the estimated noise of their size.
    fn update_weights(&mut self) -> Option<()> {
        let camera = self.parameters.camera()?;
        let mut errors = Vec::new();
        for view in &self.board_views {
            for point in &view.points {
                errors.push((point.radius_px, point.error(&camera, &view.pose)?.norm_squared()));
            }
        }
        let center_noise = CenterNoise::fit(&errors);
        for point in self.board_views.iter_mut().flat_map(|view| &mut view.points) {
            point.weight = center_noise.weight(point.radius_px);
        }
        Some(())
    }

    /// Weighted residual norms by view.
    fn errors(&self) -> Option<Vec<Vec<f64>>> {
        let camera = self.parameters.camera()?;
        let of = |view: &BoardView| -> Option<Vec<f64>> {
            let error = |point: &Point| {
                Some(point.error(&camera, &view.pose)?.norm() * point.weight.sqrt())
            };
            view.points.iter().map(error).collect()
        };
        self.board_views.iter().map(of).collect()
    }

    /// Standard deviation of one coordinate at mean weight.
    fn scale_px(&self) -> Option<f64> {
        Some(deviation(&mut self.errors()?.concat())?.max(MIN_PX))
    }

    /// Rejects inconsistent points and views; returns `None` if too few remain.
    fn reject_outliers(&mut self) -> Option<()> {
        let limit_px = OUTLIER * self.scale_px()?;
        let errors = self.errors()?;
        for (view, errors) in self.board_views.iter_mut().zip(&errors) {
            let given = view.points.len();
            let mut errors = errors.iter();
            view.points.retain(|_| errors.next().is_some_and(|error| *error <= limit_px));
            // A few roundels of a bad view are consistent by chance.
            if (view.points.len() as f64) < MIN_KEPT_SHARE * given as f64 {
                view.points.clear();
            }
        }
        self.board_views.retain(|view| view.points.len() >= MIN_ROUNDELS);
        let squares: Vec<f64> = self.errors()?.iter().map(|errors| mean_square(errors)).collect();
        let median = median(&mut squares.clone())?;
        let limit = BAD_VIEW_RATIO * BAD_VIEW_RATIO * median.max(MIN_PX * MIN_PX);
        let mut squares = squares.iter();
        self.board_views.retain(|_| squares.next().is_some_and(|square| *square <= limit));
        (self.board_views.len() >= MIN_VIEWS).then_some(())
    }

    fn finish(self) -> Option<Fit> {
        let camera = self.parameters.camera()?;
        let errors = self.errors()?;
        let squares: f64 = errors.iter().flatten().map(|error| error * error).sum();
        let count = 2 * errors.iter().map(Vec::len).sum::<usize>();
        let normal = self.normal(f64::MAX)?;
        let unknowns = normal.gradient.len() + 6 * self.board_views.len();
        let mut information = normal.camera.clone();
        for (pose_block, cross_block, _) in &normal.views {
            information -= cross_block.transpose() * pose_block.cholesky()?.solve(cross_block);
        }
        let variance = squares / count.saturating_sub(unknowns).max(1) as f64;
        let covariance = information.cholesky()?.inverse() * variance;
        let errors_px = self.board_views.iter().flat_map(|view| {
            view.points.iter().filter_map(|point| point.error(&camera, &view.pose))
        });
        let squares_px: f64 = errors_px.map(|error| error.norm_squared()).sum();
        let rms_px = (squares_px / (count / 2).max(1) as f64).sqrt();
        Some(Fit { camera, board_views: self.board_views, covariance, squares, count, rms_px })
    }
}

impl LeastSquares for Bundle {
    type Normal = Normal;

    fn cost(&self, limit_px: f64) -> Option<f64> {
        Some(self.errors()?.iter().flatten().map(|&error| huber(error, limit_px)).sum())
    }

    fn normal(&self, limit_px: f64) -> Option<Normal> {
        let (jacobian, width) = (self.parameters.jacobian()?, self.parameters.unknowns());
        let mut normal = Normal {
            views: Vec::with_capacity(self.board_views.len()),
            camera: DMatrix::zeros(width, width),
            gradient: DVector::zeros(width),
        };
        for board_view in &self.board_views {
            let mut view_normal = (Matrix6::zeros(), DMatrix::zeros(6, width), Vector6::zeros());
            for point in &board_view.points {
                let error = point.error(&jacobian.camera, &board_view.pose)?;
                let norm = error.norm() * point.weight.sqrt();
                let weight = point.weight * if norm > limit_px { limit_px / norm } else { 1.0 };
                let (by_pose, by_camera) = point.jacobian(&jacobian, &board_view.pose)?;
                view_normal.0 += by_pose.transpose() * by_pose * weight;
                view_normal.1 += by_pose.transpose() * &by_camera * weight;
                view_normal.2 -= by_pose.transpose() * error * weight;
                normal.camera += by_camera.transpose() * &by_camera * weight;
                normal.gradient -= by_camera.transpose() * error * weight;
            }
            normal.views.push(view_normal);
        }
        Some(normal)
    }

    fn stepped(&self, normal: &Normal, damping: f64) -> Option<Self> {
        let mut camera = damped(normal.camera.clone(), damping);
        let mut gradient = normal.gradient.clone();
        let mut views = Vec::with_capacity(normal.views.len());
        for (pose_block, cross_block, pose_gradient) in &normal.views {
            let factor = damped(*pose_block, damping).cholesky()?;
            let carried = factor.solve(cross_block);
            let moved = factor.solve(pose_gradient);
            camera -= cross_block.transpose() * &carried;
            gradient -= cross_block.transpose() * moved;
            views.push((carried, moved));
        }
        let step = camera.cholesky()?.solve(&gradient);
        let mut stepped = self.clone();
        stepped.parameters.step(step.as_slice());
        for (board_view, (carried, moved)) in stepped.board_views.iter_mut().zip(views) {
            board_view.pose = stepped_pose(&board_view.pose, &(moved - carried * &step));
        }
        Some(stepped)
    }
}

impl BoardView {
    pub(crate) fn new(
        index: usize,
        pose: Isometry3<f64>,
        sightings: &[(Point2<f64>, Sighting)],
    ) -> Self {
        let point = |(board_m, observed): &(Point2<f64>, Sighting)| Point {
            board_m: *board_m,
            observed: Vector2::new(observed.center.u, observed.center.v),
            offset: Vector2::zeros(),
            radius_px: observed.radius_px,
            weight: 1.0,
        };
        Self { index, pose, points: sightings.iter().map(point).collect() }
    }

    /// Rms distance of observed and predicted centres, pixels.
    pub(crate) fn rms_px(&self, camera: &Camera) -> f64 {
        let errors = self.points.iter().filter_map(|point| point.error(camera, &self.pose));
        let squares: f64 = errors.map(|error| error.norm_squared()).sum();
        (squares / self.points.len().max(1) as f64).sqrt()
    }
}

impl Point {
    /// Predicted minus observed; `None` if the point has no image.
    fn error(&self, camera: &Camera, pose: &Isometry3<f64>) -> Option<Vector2<f64>> {
        let board_m = pose * Point3::new(self.board_m.x, self.board_m.y, 0.0);
        let pixel = camera.project(&board_m.coords).ok()?;
        Some(Vector2::new(pixel.u, pixel.v) + self.offset - self.observed)
    }

    /// Derivatives of the image by the view's pose (left perturbation of the rotation, then translation) and by the
    /// camera's free parameters.
    fn jacobian(
        &self,
        by_camera: &CameraJacobian,
        pose: &Isometry3<f64>,
    ) -> Option<(Matrix2x6<f64>, Matrix2xX<f64>)> {
        let rotated = pose.rotation * Vector3::new(self.board_m.x, self.board_m.y, 0.0);
        let place = rotated + pose.translation.vector;
        let (_, jacobian) = by_camera.camera.project_with_jacobian(&place).ok()?;
        Some((pose_jacobian(&jacobian, &rotated), by_camera.at(&place)?))
    }
}

fn mean_square(errors: &[f64]) -> f64 {
    errors.iter().map(|error| error * error).sum::<f64>() / errors.len().max(1) as f64
}
