//! All views refined together, by Levenberg and Marquardt's steps.
//!
//! Unknown are the camera's parameters and the board's place in each view. A view's place is eliminated exactly (Schur
//! complement), so a step costs as much as there are views. What is compared is the seen centre and
//! the image of the roundel's centre plus [`offset_px`], which hardly depends on the unknowns and is
//! brought up to date between rounds. How a centre's variance depends on its rim's radius r is taken
//! from the errors ([`super::weighing`]): a weight that is not the inverse of the variance costs precision, and makes the stated
//! covariance, σ² H⁻¹, another one than that of the errors. First rounds count large errors linearly (Huber 1964); then what is off by more than
//! five deviations is left out, and so are views that are worse than the others by far.

use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix2x6, Matrix6, Point2, Point3, Translation3, UnitQuaternion,
    Vector2, Vector3, Vector6,
};

use super::{
    model::Model,
    rim::offset_px,
    start::Started,
    view::{LEAST_ROUNDELS, Sighting},
    weighing::Weighing,
};
use crate::camera::{Camera, Intrinsics};

/// Rounds in which large errors count linearly, and most rounds in all.
const ROBUST_ROUNDS: usize = 3;
const MOST_ROUNDS: usize = 8;
const MOST_STEPS: usize = 40;
/// Errors beyond this many deviations count linearly, and are left out at last.
const HUBER: f64 = 2.5;
const OUTLIER: f64 = 5.0;
/// A view of whose roundels a smaller share agrees with the others is left out.
const LEAST_KEPT: f64 = 0.7;
/// A view whose errors are this many times the median view's is left out.
const BAD_VIEW: f64 = 3.0;
/// A round that moves every centre's offset by less than this ends it, pixels.
const SETTLED_PX: f64 = 1e-4;
/// Errors below this are rounding, pixels.
const LEAST_PX: f64 = 1e-6;
/// Parameters beside the coefficients: fx, fy, cx, cy.
pub(super) const PINHOLE: usize = 4;
const COEFFICIENT_STEP: f64 = 1e-6;

/// A view with its unknowns.
#[derive(Clone)]
pub(super) struct Station {
    pub(super) index: usize,
    pub(super) pose: Isometry3<f64>,
    pub(super) points: Vec<Point>,
}

/// A sighting with what it should be.
#[derive(Clone)]
pub(super) struct Point {
    at: Point2<f64>,
    seen: Vector2<f64>,
    offset: Vector2<f64>,
    radius_px: f64,
    weight: f64,
}

/// A camera with all views.
#[derive(Clone)]
pub(super) struct Bundle {
    size: (usize, usize),
    model: Model,
    radius_m: f64,
    /// fx, fy, cx, cy, then all coefficients of the lens in ROS' order.
    parameters: Vec<f64>,
    pub(super) stations: Vec<Station>,
}

/// What was reached.
pub(super) struct Fit {
    pub(super) camera: Camera,
    pub(super) stations: Vec<Station>,
    /// Of the free parameters.
    pub(super) covariance: DMatrix<f64>,
    /// Sum of weighted squares, and how many numbers went into it.
    pub(super) squares: f64,
    pub(super) count: usize,
    pub(super) rms_px: f64,
}

/// Sums of one step.
struct Normal {
    views: Vec<(Matrix6<f64>, DMatrix<f64>, Vector6<f64>)>,
    camera: DMatrix<f64>,
    gradient: DVector<f64>,
}

impl Bundle {
    pub(super) fn new(
        size: (usize, usize),
        radius_m: f64,
        started: &Started,
        model: Model,
    ) -> Self {
        let mut parameters = vec![
            started.focal_px,
            started.focal_px,
            (size.0 as f64 - 1.0) / 2.0,
            (size.1 as f64 - 1.0) / 2.0,
        ];
        parameters.resize(PINHOLE + model.coefficients(), 0.0);
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
        Self { size, model, radius_m, parameters, stations: stations.collect() }
    }

    /// `None` if it does not converge to a camera.
    pub(super) fn fit(mut self) -> Option<Fit> {
        for round in 0..MOST_ROUNDS {
            let moved_px = self.renew_offsets()?;
            let limit_px = if round < ROBUST_ROUNDS { HUBER * self.scale_px()? } else { f64::MAX };
            if round == ROBUST_ROUNDS {
                self.leave_out()?;
            }
            self.descend(limit_px)?;
            if round > ROBUST_ROUNDS && moved_px < SETTLED_PX {
                break;
            }
            if round >= ROBUST_ROUNDS {
                self.weigh()?;
            }
        }
        self.told()
    }

    fn camera(&self) -> Option<Camera> {
        self.camera_of(&self.parameters)
    }

    fn camera_of(&self, parameters: &[f64]) -> Option<Camera> {
        let lens = self.model.lens(&parameters[PINHOLE..])?;
        let (width, height) = self.size;
        Camera::new(Intrinsics {
            width,
            height,
            fx_px: parameters[0],
            fy_px: parameters[1],
            cx_px: parameters[2],
            cy_px: parameters[3],
            lens,
        })
        .ok()
    }

    /// The largest change, pixels.
    fn renew_offsets(&mut self) -> Option<f64> {
        let camera = self.camera()?;
        let mut moved_px: f64 = 0.0;
        for station in &mut self.stations {
            for point in &mut station.points {
                let (u, v) = offset_px(&camera, &station.pose, &point.at, self.radius_m).ok()?;
                let offset = Vector2::new(u, v);
                moved_px = moved_px.max((offset - point.offset).norm());
                point.offset = offset;
            }
        }
        Some(moved_px)
    }

    /// Weighs the points by what their errors say of rims of their size.
    fn weigh(&mut self) -> Option<()> {
        let camera = self.camera()?;
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

    /// Deviation of one coordinate of a sighting of mean weight, by the median of their distances (Rayleigh's is
    /// 1.1774 deviations).
    fn scale_px(&self) -> Option<f64> {
        let mut errors: Vec<f64> = self.errors(&self.camera()?)?.concat();
        let middle = errors.len() / 2;
        let (_, median, _) = errors.select_nth_unstable_by(middle, f64::total_cmp);
        Some((*median / 1.1774).max(LEAST_PX))
    }

    /// Leaves out what the others contradict. `None`: too little is left.
    fn leave_out(&mut self) -> Option<()> {
        let limit_px = OUTLIER * self.scale_px()?;
        let errors = self.errors(&self.camera()?)?;
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
        let camera = self.camera()?;
        let errors = self.errors(&camera)?;
        let mut squares: Vec<f64> = errors.iter().map(|errors| mean_square(errors)).collect();
        let of_views = squares.clone();
        if squares.is_empty() {
            return None;
        }
        let middle = squares.len() / 2;
        let (_, median, _) = squares.select_nth_unstable_by(middle, f64::total_cmp);
        let limit = BAD_VIEW * BAD_VIEW * median.max(LEAST_PX * LEAST_PX);
        let mut of_views = of_views.iter();
        self.stations.retain(|_| of_views.next().is_some_and(|square| *square <= limit));
        (self.stations.len() >= super::LEAST_VIEWS).then_some(())
    }

    fn cost(&self, camera: &Camera, limit_px: f64) -> Option<f64> {
        let errors = self.errors(camera)?;
        Some(errors.iter().flatten().map(|&error| huber(error, limit_px)).sum())
    }

    fn descend(&mut self, limit_px: f64) -> Option<()> {
        let mut damping = 1e-3;
        let mut cost = self.cost(&self.camera()?, limit_px)?;
        for _ in 0..MOST_STEPS {
            let normal = self.normal(limit_px)?;
            let mut is_done = true;
            while damping < 1e8 {
                let stepped = self.stepped(&normal, damping);
                let stepped_cost = stepped.as_ref().and_then(|it| it.cost(&it.camera()?, limit_px));
                if let (Some(stepped), Some(stepped_cost)) = (stepped, stepped_cost)
                    && stepped_cost <= cost
                {
                    is_done = cost - stepped_cost <= 1e-12 * cost;
                    *self = stepped;
                    cost = stepped_cost;
                    damping = (damping * 0.1).max(1e-12);
                    break;
                }
                damping *= 10.0;
            }
            if is_done {
                break;
            }
        }
        Some(())
    }

    fn free(&self) -> Vec<usize> {
        let coefficients = self.model.free().iter().map(|index| PINHOLE + index);
        (0..PINHOLE).chain(coefficients).collect()
    }

    fn normal(&self, limit_px: f64) -> Option<Normal> {
        let camera = self.camera()?;
        let free = self.free();
        let nearby: Vec<[Camera; 2]> = free[PINHOLE..]
            .iter()
            .map(|&index| {
                let moved = |by: f64| {
                    let mut parameters = self.parameters.clone();
                    parameters[index] += by;
                    self.camera_of(&parameters)
                };
                Some([moved(-COEFFICIENT_STEP)?, moved(COEFFICIENT_STEP)?])
            })
            .collect::<Option<_>>()?;
        let width = free.len();
        let mut normal = Normal {
            views: Vec::with_capacity(self.stations.len()),
            camera: DMatrix::zeros(width, width),
            gradient: DVector::zeros(width),
        };
        for station in &self.stations {
            let mut of_view = (Matrix6::zeros(), DMatrix::zeros(6, width), Vector6::zeros());
            for point in &station.points {
                let error = point.error(&camera, &station.pose)?;
                let norm = error.norm() * point.weight.sqrt();
                let weight = point.weight * if norm > limit_px { limit_px / norm } else { 1.0 };
                let (by_pose, by_camera) = self.slopes(&camera, &nearby, station, point)?;
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

    /// Derivatives of a point's image by its view's place (a left perturbation of the rotation, then the translation)
    /// and by the camera's free parameters.
    fn slopes(
        &self,
        camera: &Camera,
        nearby: &[[Camera; 2]],
        station: &Station,
        point: &Point,
    ) -> Option<(Matrix2x6<f64>, DMatrix<f64>)> {
        let turned = station.pose.rotation * Vector3::new(point.at.x, point.at.y, 0.0);
        let place = turned + station.pose.translation.vector;
        let (pixel, jacobian) = camera.project_with_jacobian(&place).ok()?;
        let mut by_pose = Matrix2x6::zeros();
        by_pose.fixed_view_mut::<2, 3>(0, 0).copy_from(&(-jacobian * turned.cross_matrix()));
        by_pose.fixed_view_mut::<2, 3>(0, 3).copy_from(&jacobian);
        let mut by_camera = DMatrix::zeros(2, PINHOLE + nearby.len());
        let [fx, fy, cx, cy] = [0, 1, 2, 3].map(|index| self.parameters[index]);
        by_camera[(0, 0)] = (pixel.u - cx) / fx;
        by_camera[(1, 1)] = (pixel.v - cy) / fy;
        by_camera[(0, 2)] = 1.0;
        by_camera[(1, 3)] = 1.0;
        for (index, [below, above]) in nearby.iter().enumerate() {
            let (below, above) = (below.project(&place).ok()?, above.project(&place).ok()?);
            by_camera[(0, PINHOLE + index)] = (above.u - below.u) / (2.0 * COEFFICIENT_STEP);
            by_camera[(1, PINHOLE + index)] = (above.v - below.v) / (2.0 * COEFFICIENT_STEP);
        }
        Some((by_pose, by_camera))
    }

    /// One step away; `None` if it cannot be computed.
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
        for (index, by) in self.free().into_iter().zip(step.iter()) {
            stepped.parameters[index] += by;
        }
        for (station, (carried, moved)) in stepped.stations.iter_mut().zip(views) {
            let step: Vector6<f64> = moved - carried * &step;
            let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
            let shift: Vector3<f64> = step.fixed_rows::<3>(3).into_owned();
            station.pose.rotation = turn * station.pose.rotation;
            station.pose.translation = Translation3::from(station.pose.translation.vector + shift);
        }
        Some(stepped)
    }

    fn told(self) -> Option<Fit> {
        let camera = self.camera()?;
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

impl Station {
    /// Rms distance of what is seen and what should be, pixels.
    pub(super) fn rms_px(&self, camera: &Camera) -> f64 {
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
}

fn mean_square(errors: &[f64]) -> f64 {
    errors.iter().map(|error| error * error).sum::<f64>() / errors.len().max(1) as f64
}

/// Half of a square grows linearly beyond the limit.
fn huber(error: f64, limit: f64) -> f64 {
    if error <= limit { error * error } else { limit * (2.0 * error - limit) }
}
