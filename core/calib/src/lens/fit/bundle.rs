//! All views refined together, by Levenberg and Marquardt's steps.
//!
//! Unknown are the camera's parameters and the board's place in each view. A view's place is eliminated exactly (Schur
//! complement), so a step costs as much as there are views. What is compared is the seen centre and
//! the image of the roundel's centre plus [`offset_px`], which hardly depends on the unknowns and is
//! brought up to date between rounds. How a centre's variance depends on its rim's radius r is taken
//! from the errors ([`super::center_noise`]): a weight that is not the inverse of the variance costs precision, and makes the stated
//! covariance, σ² H⁻¹, another one than that of the errors. First rounds count large errors linearly (Huber 1964); then what is off by more than
//! five deviations is left out, and so are views that are worse than the others by far.

use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix2x6, Matrix2xX, Matrix6, Point2, Point3, Translation3,
    UnitQuaternion, Vector2, Vector3, Vector6,
};

use super::{
    center_noise::Weighing,
    distortion_model::Model,
    initial::Started,
    parameters::{Candidate, Slopes},
    rim,
    robust::{HUBER, OUTLIER, deviation, huber, median},
};
use crate::{
    least_squares::{Descent, descend},
    lens::{
        LEAST_VIEWS,
        views::view::{LEAST_ROUNDELS, Sighting},
    },
};
use roundel_vision::camera::Camera;

/// Rounds in which large errors count linearly, and most rounds in all.
const ROBUST_ROUNDS: usize = 3;
const MOST_ROUNDS: usize = 8;
/// A view of whose points a smaller share agrees with the others is left out.
const LEAST_KEPT: f64 = 0.7;
/// A view whose errors are this many times the median view's is left out.
const BAD_VIEW: f64 = 3.0;
/// A round that moves every centre's offset by less than this ends it, pixels.
const SETTLED_PX: f64 = 1e-4;
/// Errors below this are rounding, pixels.
const LEAST_PX: f64 = 1e-6;

/// A view with its unknowns.
#[derive(Clone)]
pub(crate) struct Station {
    pub(crate) index: usize,
    pub(crate) pose: Isometry3<f64>,
    pub(crate) points: Vec<Point>,
}

/// A sighting with what it should be.
#[derive(Clone)]
pub(crate) struct Point {
    at: Point2<f64>,
    seen: Vector2<f64>,
    offset: Vector2<f64>,
    radius_px: f64,
    weight: f64,
}

/// A camera with all views.
#[derive(Clone)]
pub(crate) struct Bundle {
    candidate: Candidate,
    /// Of the circles whose images' centres are seen; none: points are seen.
    rim_m: Option<f64>,
    pub(crate) stations: Vec<Station>,
}

/// What was reached.
pub(crate) struct Fit {
    pub(crate) camera: Camera,
    pub(crate) stations: Vec<Station>,
    /// Of the free parameters.
    pub(crate) covariance: DMatrix<f64>,
    /// Sum of weighted squares, and how many numbers went into it.
    pub(crate) squares: f64,
    pub(crate) count: usize,
    pub(crate) rms_px: f64,
}

/// Sums of one step.
pub(crate) struct Normal {
    views: Vec<(Matrix6<f64>, DMatrix<f64>, Vector6<f64>)>,
    camera: DMatrix<f64>,
    gradient: DVector<f64>,
}

impl Bundle {
    pub(crate) fn new(
        size: (usize, usize),
        rim_m: Option<f64>,
        started: &Started,
        model: Model,
    ) -> Self {
        let point = |(at, seen): &(Point2<f64>, Sighting)| Point {
            at: *at,
            seen: Vector2::new(seen.center.u, seen.center.v),
            offset: Vector2::zeros(),
            radius_px: seen.radius_px,
            weight: 1.0,
        };
        let stations = started.views.iter().map(|view| Station {
            index: view.index,
            pose: view.pose,
            points: view.sightings.iter().map(point).collect(),
        });
        Self {
            candidate: Candidate::new(size, started.focal_px, model),
            rim_m,
            stations: stations.collect(),
        }
    }

    /// `None` if it does not converge to a camera.
    pub(crate) fn fit(mut self) -> Option<Fit> {
        for round in 0..MOST_ROUNDS {
            let moved_px = self.renew_offsets()?;
            let limit_px = if round < ROBUST_ROUNDS { HUBER * self.scale_px()? } else { f64::MAX };
            if round == ROBUST_ROUNDS {
                self.leave_out()?;
            }
            descend(&mut self, limit_px)?;
            if round > ROBUST_ROUNDS && moved_px < SETTLED_PX {
                break;
            }
            if round >= ROBUST_ROUNDS {
                self.weigh()?;
            }
        }
        self.told()
    }

    /// The largest change, pixels.
    fn renew_offsets(&mut self) -> Option<f64> {
        let Some(rim_m) = self.rim_m else { return Some(0.0) };
        let camera = self.candidate.camera()?;
        let mut moved_px: f64 = 0.0;
        for station in &mut self.stations {
            for point in &mut station.points {
                let (u, v) = rim::image(&camera, &station.pose, &point.at, rim_m).ok()?.offset_px;
                let offset = Vector2::new(u, v);
                moved_px = moved_px.max((offset - point.offset).norm());
                point.offset = offset;
            }
        }
        Some(moved_px)
    }

    /// Weighs the points by what their errors say of rims of their size.
    fn weigh(&mut self) -> Option<()> {
        let camera = self.candidate.camera()?;
        let mut errors = Vec::new();
        for station in &self.stations {
            for point in &station.points {
                let square = point.error(&camera, &station.pose)?.norm_squared();
                errors.push((point.radius_px, square));
            }
        }
        let weighing = Weighing::of(&errors);
        for point in self.stations.iter_mut().flat_map(|station| &mut station.points) {
            point.weight = weighing.weight(point.radius_px);
        }
        Some(())
    }

    /// Weighted distances of all points.
    fn errors(&self, camera: &Camera) -> Option<Vec<Vec<f64>>> {
        let of = |station: &Station| -> Option<Vec<f64>> {
            let error = |point: &Point| {
                Some(point.error(camera, &station.pose)?.norm() * point.weight.sqrt())
            };
            station.points.iter().map(error).collect()
        };
        self.stations.iter().map(of).collect()
    }

    /// Deviation of one coordinate of a sighting of mean weight.
    fn scale_px(&self) -> Option<f64> {
        let mut errors = self.errors(&self.candidate.camera()?)?.concat();
        Some(deviation(&mut errors)?.max(LEAST_PX))
    }

    /// Leaves out what the others contradict. `None`: too little is left.
    fn leave_out(&mut self) -> Option<()> {
        let limit_px = OUTLIER * self.scale_px()?;
        let errors = self.errors(&self.candidate.camera()?)?;
        for (station, errors) in self.stations.iter_mut().zip(&errors) {
            let given = station.points.len();
            let mut errors = errors.iter();
            station.points.retain(|_| errors.next().is_some_and(|error| *error <= limit_px));
            // Of a view that is bad as a whole some roundels are right by chance.
            if (station.points.len() as f64) < LEAST_KEPT * given as f64 {
                station.points.clear();
            }
        }
        self.stations.retain(|station| station.points.len() >= LEAST_ROUNDELS);
        let camera = self.candidate.camera()?;
        let errors = self.errors(&camera)?;
        let squares: Vec<f64> = errors.iter().map(|errors| mean_square(errors)).collect();
        let median = median(&mut squares.clone())?;
        let limit = BAD_VIEW * BAD_VIEW * median.max(LEAST_PX * LEAST_PX);
        let mut squares = squares.iter();
        self.stations.retain(|_| squares.next().is_some_and(|square| *square <= limit));
        (self.stations.len() >= LEAST_VIEWS).then_some(())
    }

    fn told(self) -> Option<Fit> {
        let camera = self.candidate.camera()?;
        let errors = self.errors(&camera)?;
        let squares: f64 = errors.iter().flatten().map(|error| error * error).sum();
        let count = 2 * errors.iter().map(Vec::len).sum::<usize>();
        let normal = self.normal(f64::MAX)?;
        let unknowns = normal.gradient.len() + 6 * self.stations.len();
        let mut information = normal.camera.clone();
        for (own, mixed, _) in &normal.views {
            information -= mixed.transpose() * own.cholesky()?.solve(mixed);
        }
        let variance = squares / count.saturating_sub(unknowns).max(1) as f64;
        let covariance = information.cholesky()?.inverse() * variance;
        let rms_px = {
            let distances = self.stations.iter().flat_map(|station| {
                station.points.iter().map(|point| {
                    point.error(&camera, &station.pose).map_or(0.0, |error| error.norm_squared())
                })
            });
            (distances.sum::<f64>() / (count / 2).max(1) as f64).sqrt()
        };
        Some(Fit { camera, stations: self.stations, covariance, squares, count, rms_px })
    }
}

impl Descent for Bundle {
    type Normal = Normal;
    const MOST_STEPS: usize = 40;
    const SETTLED: f64 = 1e-12;

    fn cost(&self, limit_px: f64) -> Option<f64> {
        let errors = self.errors(&self.candidate.camera()?)?;
        Some(errors.iter().flatten().map(|&error| huber(error, limit_px)).sum())
    }

    fn normal(&self, limit_px: f64) -> Option<Normal> {
        let (slopes, width) = (self.candidate.slopes()?, self.candidate.unknowns());
        let mut normal = Normal {
            views: Vec::with_capacity(self.stations.len()),
            camera: DMatrix::zeros(width, width),
            gradient: DVector::zeros(width),
        };
        for station in &self.stations {
            let mut of_view = (Matrix6::zeros(), DMatrix::zeros(6, width), Vector6::zeros());
            for point in &station.points {
                let error = point.error(&slopes.camera, &station.pose)?;
                let norm = error.norm() * point.weight.sqrt();
                let weight = point.weight * if norm > limit_px { limit_px / norm } else { 1.0 };
                let (by_pose, by_camera) = point.slopes(&slopes, &station.pose)?;
                of_view.0 += by_pose.transpose() * by_pose * weight;
                of_view.1 += by_pose.transpose() * &by_camera * weight;
                of_view.2 -= by_pose.transpose() * error * weight;
                normal.camera += by_camera.transpose() * &by_camera * weight;
                normal.gradient -= by_camera.transpose() * error * weight;
            }
            normal.views.push(of_view);
        }
        Some(normal)
    }

    fn stepped(&self, normal: &Normal, damping: f64) -> Option<Self> {
        let damped = |mut matrix: Matrix6<f64>| {
            for index in 0..6 {
                matrix[(index, index)] *= 1.0 + damping;
            }
            matrix.cholesky()
        };
        let mut camera = normal.camera.clone();
        for index in 0..camera.nrows() {
            camera[(index, index)] *= 1.0 + damping;
        }
        let mut gradient = normal.gradient.clone();
        let mut views = Vec::with_capacity(normal.views.len());
        for (own, mixed, pull) in &normal.views {
            let factor = damped(*own)?;
            let carried = factor.solve(mixed);
            let moved = factor.solve(pull);
            camera -= mixed.transpose() * &carried;
            gradient -= mixed.transpose() * moved;
            views.push((carried, moved));
        }
        let step = camera.cholesky()?.solve(&gradient);
        let mut stepped = self.clone();
        stepped.candidate.step(step.as_slice());
        for (station, (carried, moved)) in stepped.stations.iter_mut().zip(views) {
            let step: Vector6<f64> = moved - carried * &step;
            let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
            let shift: Vector3<f64> = step.fixed_rows::<3>(3).into_owned();
            station.pose.rotation = turn * station.pose.rotation;
            station.pose.translation = Translation3::from(station.pose.translation.vector + shift);
        }
        Some(stepped)
    }
}

impl Station {
    /// Rms distance of what is seen and what should be, pixels.
    pub(crate) fn rms_px(&self, camera: &Camera) -> f64 {
        let errors = self.points.iter().filter_map(|point| point.error(camera, &self.pose));
        let squares: f64 = errors.map(|error| error.norm_squared()).sum();
        (squares / self.points.len().max(1) as f64).sqrt()
    }
}

impl Point {
    /// Predicted less seen; `None` if the camera cannot see it.
    fn error(&self, camera: &Camera, pose: &Isometry3<f64>) -> Option<Vector2<f64>> {
        let at = pose * Point3::new(self.at.x, self.at.y, 0.0);
        let pixel = camera.project(&at.coords).ok()?;
        Some(Vector2::new(pixel.u, pixel.v) + self.offset - self.seen)
    }

    /// Derivatives of its image by its view's place (a left perturbation of the rotation, then the translation) and
    /// by the camera's estimated parameters.
    fn slopes(
        &self,
        by_camera: &Slopes,
        pose: &Isometry3<f64>,
    ) -> Option<(Matrix2x6<f64>, Matrix2xX<f64>)> {
        let turned = pose.rotation * Vector3::new(self.at.x, self.at.y, 0.0);
        let place = turned + pose.translation.vector;
        let (_, jacobian) = by_camera.camera.project_with_jacobian(&place).ok()?;
        let mut by_pose = Matrix2x6::zeros();
        by_pose.fixed_view_mut::<2, 3>(0, 0).copy_from(&(-jacobian * turned.cross_matrix()));
        by_pose.fixed_view_mut::<2, 3>(0, 3).copy_from(&jacobian);
        Some((by_pose, by_camera.at(&place)?))
    }
}

fn mean_square(errors: &[f64]) -> f64 {
    errors.iter().map(|error| error * error).sum::<f64>() / errors.len().max(1) as f64
}
