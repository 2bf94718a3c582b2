//! A camera's lens, place and clock refined together, by Levenberg and Marquardt's steps.
//!
//! What is compared is the centre of a roundel's rim as seen and as predicted: the image of where the others had it at
//! the camera's own time, less what the camera's clock is off, plus the centroid's offset from it
//! ([`super::super::rim`]), brought up to date between rounds. Of its covariance J Σ Jᵀ + s² r̄/r + τ² v vᵀ the first
//! part is what the others do not know of the place; s, the error of a rim's centre of the mean radius r̄, and
//! τ, by which stamps are off from frame to frame (v: pixels a second), are estimated from the errors themselves ([`super::spread`]).
//! First rounds count large errors linearly (Huber 1964), so that roundels taken for another's fall out; then what is off by
//! more than five deviations is left out.

use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix2, Matrix2x3, Matrix2xX, Point2, UnitQuaternion, Vector2,
    Vector3,
};

use super::{
    super::{bundle::PINHOLE, model::Model, rim::offset_px},
    jackknife::{Jackknife, jackknife},
    spread::{Apart, Spread},
    way::{Way, Waypoint},
};
use crate::{
    camera::{Camera, Intrinsics},
    rigid::Rigid,
};

/// Rounds in which large errors count linearly, and rounds in all.
const ROBUST_ROUNDS: usize = 4;
const ROUNDS: usize = 8;
const MOST_STEPS: usize = 30;
/// Errors beyond this many deviations count linearly, and are left out at last.
const HUBER: f64 = 2.5;
const OUTLIER: f64 = 5.0;
/// What cannot be seen at all is as far off as this while a camera is looked for, deviations.
const UNSEEN: f64 = 1e4;
/// Rayleigh's median, in deviations.
const MEDIAN: f64 = 1.1774;
const COEFFICIENT_STEP: f64 = 1e-6;
/// Pose and clock.
const PLACE: usize = 6;
const CLOCK: usize = 2;

/// A sighting of the camera.
#[derive(Clone)]
pub(super) struct Pair {
    /// Index of the way.
    pub(super) way: usize,
    pub(super) stamp_s: f64,
    pub(super) seen: Vector2<f64>,
    pub(super) radius_px: f64,
    /// The centroid less the centre's image, pixels.
    offset: Vector2<f64>,
    /// Of the inverse covariance Wᵀ W.
    whitener: Matrix2<f64>,
}

impl Pair {
    pub(super) fn new(way: usize, stamp_s: f64, seen: Vector2<f64>, radius_px: f64) -> Self {
        let (offset, whitener) = (Vector2::zeros(), Matrix2::identity());
        Self { way, stamp_s, seen, radius_px, offset, whitener }
    }
}

/// A camera with all that it saw.
#[derive(Clone)]
pub(super) struct Bundle<'a> {
    pub(super) size: (usize, usize),
    pub(super) model: Model,
    pub(super) ways: &'a [Way],
    pub(super) pairs: Vec<Pair>,
    /// fx, fy, cx, cy, then all coefficients of the lens in ROS' order.
    pub(super) parameters: Vec<f64>,
    pub(super) camera_from_world: Rigid,
    /// By how much its stamps are late, and by how much more each second.
    pub(super) clock: [f64; CLOCK],
    /// Deviations of these beforehand.
    pub(super) clock_prior: [f64; CLOCK],
    pub(super) spread: Spread,
    /// Whether the spread is that of another bundle and stays.
    pub(super) keeps_spread: bool,
}

/// What was reached.
pub(super) struct Fit<'a> {
    pub(super) bundle: Bundle<'a>,
    pub(super) camera: Camera,
    /// Of the free parameters, the pose (rotation, then place: camera_from_world, left) and the clock.
    pub(super) covariance: DMatrix<f64>,
    /// By how much the parameters' variances are larger than independent errors would make them.
    pub(super) inflation: f64,
    /// Sum of whitened squares.
    pub(super) squares: f64,
    /// Rms distance, pixels.
    pub(super) rms_px: f64,
}

/// A pair at the state of now.
struct Look {
    at: Waypoint,
    /// Predicted less seen.
    error: Vector2<f64>,
    /// Of the pixel by the place in the camera.
    jacobian: Matrix2x3<f64>,
    /// From the camera's origin, the world's axes turned into the camera's.
    turned_m: Vector3<f64>,
}

/// A pair's whitened derivatives by all unknowns, and its error; `None` of what cannot be seen.
pub(super) type Part = Option<(Matrix2xX<f64>, Vector2<f64>)>;

struct Normal {
    information: DMatrix<f64>,
    gradient: DVector<f64>,
}

impl<'a> Bundle<'a> {
    /// A few robust rounds without leaving anything out: the median whitened distance, or `None` if it is no camera.
    pub(super) fn approach(&mut self) -> Option<f64> {
        for _ in 0..2 {
            self.renew()?;
            let limit = HUBER * self.scale()?;
            self.descend(limit)?;
        }
        self.scale()
    }

    /// `None` if it does not converge to a camera.
    pub(super) fn fit(mut self) -> Option<Fit<'a>> {
        for round in 0..ROUNDS {
            self.renew()?;
            if round == ROBUST_ROUNDS {
                self.leave_out()?;
            }
            let limit = if round < ROBUST_ROUNDS { HUBER * self.scale()? } else { f64::MAX };
            self.descend(limit)?;
            if !self.keeps_spread {
                let camera = self.camera()?;
                let apart: Vec<Apart> =
                    self.pairs.iter().filter_map(|pair| self.apart(&camera, pair)).collect();
                self.spread = Spread::of(&apart);
            }
        }
        self.renew()?;
        self.told()
    }

    pub(super) fn camera(&self) -> Option<Camera> {
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

    /// When a stamp was, by the clock of the others.
    fn time_s(&self, stamp_s: f64) -> f64 {
        stamp_s - self.clock[0] - self.clock[1] * stamp_s
    }

    /// `None`: nobody else saw it then, or this camera cannot see it.
    fn look(&self, camera: &Camera, pair: &Pair) -> Option<Look> {
        let at = self.ways[pair.way].at(self.time_s(pair.stamp_s))?;
        let turned_m = self.camera_from_world.rotation * at.place_m;
        let place_m = turned_m + self.camera_from_world.translation.vector;
        let (pixel, jacobian) = camera.project_with_jacobian(&place_m).ok()?;
        let error = Vector2::new(pixel.u, pixel.v) + pair.offset - pair.seen;
        Some(Look { at, error, jacobian, turned_m })
    }

    /// Centroids' offsets and weights as they are by now.
    fn renew(&mut self) -> Option<()> {
        let camera = self.camera()?;
        let mut pairs = std::mem::take(&mut self.pairs);
        let mean_px =
            pairs.iter().map(|pair| pair.radius_px).sum::<f64>() / pairs.len().max(1) as f64;
        for pair in &mut pairs {
            let Some(look) = self.look(&camera, pair) else { continue };
            let orientation = self.camera_from_world.rotation * look.at.orientation;
            let place_m = look.turned_m + self.camera_from_world.translation.vector;
            let pose = Isometry3::from_parts(place_m.into(), orientation);
            let radius_m = self.ways[pair.way].radius_m();
            if let Ok((u, v)) = offset_px(&camera, &pose, &Point2::origin(), radius_m) {
                pair.offset = Vector2::new(u, v);
            }
            let size = mean_px / pair.radius_px;
            let covariance = self.unknown_place(&look)
                + Matrix2::identity() * (self.spread.pixel_px.powi(2) * size)
                + self.slip(&look) * self.slip(&look).transpose() * self.spread.stamp_s.powi(2);
            let lower = covariance.cholesky()?.l();
            pair.whitener = lower.try_inverse()?;
        }
        self.pairs = pairs;
        Some(())
    }

    /// What the others do not know of the place, in the image.
    fn unknown_place(&self, look: &Look) -> Matrix2<f64> {
        let by_world =
            look.jacobian * self.camera_from_world.rotation.to_rotation_matrix().into_inner();
        by_world * look.at.covariance_m2 * by_world.transpose()
    }

    /// Pixels a second.
    fn slip(&self, look: &Look) -> Vector2<f64> {
        look.jacobian * (self.camera_from_world.rotation * look.at.velocity_m_s)
    }

    /// A pair's error along its motion and across it.
    fn apart(&self, camera: &Camera, pair: &Pair) -> Option<Apart> {
        let look = self.look(camera, pair)?;
        let slip = self.slip(&look);
        let along = slip.try_normalize(1e-9).unwrap_or_else(Vector2::x);
        let across = Vector2::new(-along.y, along.x);
        let known = self.unknown_place(&look);
        let of = |axis: Vector2<f64>| (axis.dot(&look.error).powi(2), axis.dot(&(known * axis)));
        Some(Apart {
            along: of(along),
            across: of(across),
            px_per_s: slip.norm(),
            radius_px: pair.radius_px,
        })
    }

    /// Whitened distance of each pair; infinite of what cannot be seen.
    fn distances(&self, camera: &Camera) -> Vec<f64> {
        let distance = |pair: &Pair| {
            let look = self.look(camera, pair)?;
            Some((pair.whitener * look.error).norm()).filter(|it| it.is_finite())
        };
        self.pairs.iter().map(|pair| distance(pair).unwrap_or(f64::INFINITY)).collect()
    }

    /// Deviation of a whitened coordinate, by the median.
    fn scale(&self) -> Option<f64> {
        let mut distances = self.distances(&self.camera()?);
        if distances.is_empty() {
            return None;
        }
        let middle = distances.len() / 2;
        let (_, median, _) = distances.select_nth_unstable_by(middle, f64::total_cmp);
        median.is_finite().then(|| (*median / MEDIAN).max(1e-9))
    }

    fn leave_out(&mut self) -> Option<()> {
        let limit = OUTLIER * self.scale()?;
        let mut distances = self.distances(&self.camera()?).into_iter();
        self.pairs.retain(|_| distances.next().is_some_and(|it| it <= limit));
        Some(())
    }

    fn cost(&self, limit: f64) -> Option<f64> {
        // At last, a roundel whose way ends just there is no reason to take no step.
        let unseen = if limit < f64::MAX { UNSEEN } else { OUTLIER };
        let seen = self.distances(&self.camera()?).into_iter();
        let seen = seen.map(|it| huber(if it.is_finite() { it } else { unseen }, limit));
        let clock = (0..CLOCK).map(|i| (self.clock[i] / self.clock_prior[i]).powi(2));
        Some(seen.sum::<f64>() + clock.sum::<f64>())
    }

    fn descend(&mut self, limit: f64) -> Option<()> {
        let mut damping = 1e-3;
        let mut cost = self.cost(limit)?;
        for _ in 0..MOST_STEPS {
            let normal = self.normal(limit)?;
            let mut is_done = true;
            while damping < 1e8 {
                let stepped = self.stepped(&normal, damping);
                let stepped_cost = stepped.as_ref().and_then(|it| it.cost(limit));
                if let (Some(stepped), Some(stepped_cost)) = (stepped, stepped_cost)
                    && stepped_cost <= cost
                {
                    is_done = cost - stepped_cost <= 1e-9 * cost;
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

    /// Indices of the lens' estimated parameters.
    fn free(&self) -> Vec<usize> {
        let coefficients = self.model.free().iter().map(|index| PINHOLE + index);
        (0..PINHOLE).chain(coefficients).collect()
    }

    fn unknowns(&self) -> usize {
        PINHOLE + self.model.free().len() + PLACE + CLOCK
    }

    fn normal(&self, limit: f64) -> Option<Normal> {
        let (parts, _) = self.parts(limit)?;
        let size = self.unknowns();
        let mut normal = Normal { information: self.known(), gradient: DVector::zeros(size) };
        for i in 0..CLOCK {
            let at = size - CLOCK + i;
            normal.gradient[at] -= self.clock[i] / self.clock_prior[i].powi(2);
        }
        for part in parts.into_iter().flatten() {
            normal.information += part.0.transpose() * &part.0;
            normal.gradient -= part.0.transpose() * part.1;
        }
        Some(normal)
    }

    /// What is known of the clock beforehand.
    fn known(&self) -> DMatrix<f64> {
        let size = self.unknowns();
        let mut information = DMatrix::zeros(size, size);
        for i in 0..CLOCK {
            let at = size - CLOCK + i;
            information[(at, at)] = self.clock_prior[i].powi(-2);
        }
        information
    }

    /// Whitened derivatives and error of each pair, weighted as large errors are; and the errors' squares.
    fn parts(&self, limit: f64) -> Option<(Vec<Part>, f64)> {
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
        let mut squares = 0.0;
        let parts = self.pairs.iter().map(|pair| {
            let look = self.look(&camera, pair)?;
            let mut error = pair.whitener * look.error;
            let norm = error.norm();
            if !norm.is_finite() {
                return None;
            }
            squares += norm * norm;
            let mut slopes = self.slopes(&camera, &nearby, pair, &look)?;
            if norm > limit {
                let root = (limit / norm).sqrt();
                error *= root;
                slopes *= root;
            }
            Some((slopes, error))
        });
        let parts: Vec<_> = parts.collect();
        Some((parts, squares))
    }

    /// Whitened derivatives by all unknowns.
    fn slopes(
        &self,
        camera: &Camera,
        nearby: &[[Camera; 2]],
        pair: &Pair,
        look: &Look,
    ) -> Option<Matrix2xX<f64>> {
        let mut slopes = Matrix2xX::zeros(self.unknowns());
        let place_m = look.turned_m + self.camera_from_world.translation.vector;
        let intrinsics = camera.intrinsics();
        let pixel = camera.project(&place_m).ok()?;
        slopes[(0, 0)] = (pixel.u - intrinsics.cx_px) / intrinsics.fx_px;
        slopes[(1, 1)] = (pixel.v - intrinsics.cy_px) / intrinsics.fy_px;
        (slopes[(0, 2)], slopes[(1, 3)]) = (1.0, 1.0);
        for (index, [below, above]) in nearby.iter().enumerate() {
            let (below, above) = (below.project(&place_m).ok()?, above.project(&place_m).ok()?);
            slopes[(0, PINHOLE + index)] = (above.u - below.u) / (2.0 * COEFFICIENT_STEP);
            slopes[(1, PINHOLE + index)] = (above.v - below.v) / (2.0 * COEFFICIENT_STEP);
        }
        let first = PINHOLE + nearby.len();
        let by_turn = -look.jacobian * look.turned_m.cross_matrix();
        slopes.fixed_view_mut::<2, 3>(0, first).copy_from(&by_turn);
        slopes.fixed_view_mut::<2, 3>(0, first + 3).copy_from(&look.jacobian);
        let slip = -self.slip(look);
        slopes.fixed_view_mut::<2, 1>(0, first + PLACE).copy_from(&slip);
        slopes.fixed_view_mut::<2, 1>(0, first + PLACE + 1).copy_from(&(slip * pair.stamp_s));
        Some(pair.whitener * slopes)
    }

    /// One step away; `None` if it cannot be computed.
    fn stepped(&self, normal: &Normal, damping: f64) -> Option<Self> {
        let mut damped = normal.information.clone();
        for index in 0..damped.nrows() {
            damped[(index, index)] *= 1.0 + damping;
        }
        let step = damped.cholesky()?.solve(&normal.gradient);
        if !step.iter().all(|it| it.is_finite()) {
            return None;
        }
        let mut stepped = self.clone();
        let free = self.free();
        for (index, by) in free.iter().zip(step.iter()) {
            stepped.parameters[*index] += by;
        }
        let part = |first: usize| Vector3::new(step[first], step[first + 1], step[first + 2]);
        let turn = UnitQuaternion::from_scaled_axis(part(free.len()));
        let place_m = self.camera_from_world.translation.vector + part(free.len() + 3);
        stepped.camera_from_world =
            Rigid::from_parts(place_m.into(), turn * self.camera_from_world.rotation);
        for i in 0..CLOCK {
            stepped.clock[i] += step[free.len() + PLACE + i];
        }
        Some(stepped)
    }

    fn told(self) -> Option<Fit<'a>> {
        let camera = self.camera()?;
        let (parts, squares) = self.parts(f64::MAX)?;
        let Jackknife { covariance, plain } = jackknife(&self.pairs, &parts, &self.known())?;
        let lens = PINHOLE + self.model.free().len();
        let ratio = (0..lens).map(|i| covariance[(i, i)] / plain[(i, i)]).sum::<f64>();
        let distances = self.pairs.iter().filter_map(|pair| Some(self.look(&camera, pair)?.error));
        let rms_px = (distances.map(|error| error.norm_squared()).sum::<f64>()
            / self.pairs.len().max(1) as f64)
            .sqrt();
        let inflation = (ratio / lens as f64).max(1.0);
        Some(Fit { bundle: self, camera, covariance, inflation, squares, rms_px })
    }
}

impl Fit<'_> {
    /// Where the roundels were before the camera, metres: of each pair its depth.
    pub(super) fn depths_m(&self) -> Vec<f64> {
        let looks =
            self.bundle.pairs.iter().filter_map(|pair| self.bundle.look(&self.camera, pair));
        looks.map(|look| look.turned_m.z + self.bundle.camera_from_world.translation.z).collect()
    }
}

/// Half of a square grows linearly beyond the limit.
fn huber(error: f64, limit: f64) -> f64 {
    if error <= limit { error * error } else { limit * (2.0 * error - limit) }
}
