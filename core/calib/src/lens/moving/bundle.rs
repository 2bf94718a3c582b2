//! A camera's lens, place and clock refined together, by Levenberg and Marquardt's steps.
//!
//! What is compared is the centre of a roundel's rim as seen and as predicted: the image of where the others had it at
//! the camera's own time, less what the camera's clock is off, plus the centroid's offset from it
//! ([`super::super::fit::rim`]), brought up to date between rounds. Of its covariance J Σ Jᵀ + s² r̄/r + τ² v vᵀ the first
//! part is what the others do not know of the place; s, the error of a rim's centre of the mean radius r̄, and
//! τ, by which stamps are off from frame to frame (v: pixels a second), are estimated from the errors themselves ([`super::noise_model`]).
//! First rounds count large errors linearly (Huber 1964), so that roundels taken for another's fall out; then what is off by
//! more than five deviations is left out.

use nalgebra::{
    DMatrix, DVector, Isometry3, Matrix2, Matrix2x3, Matrix2xX, Point2, UnitQuaternion, Vector2,
    Vector3,
};

use super::{
    super::fit::{
        parameters::{Candidate, Slopes},
        rim,
        robust::{HUBER, OUTLIER, deviation, huber},
    },
    jackknife::{Jackknife, Part, jackknife},
    noise_model::{Apart, Spread},
    trajectory::{Way, Waypoint},
};
use crate::least_squares::{Descent, descend};
use roundel_vision::{camera::Camera, rigid::Rigid};

/// Rounds in which large errors count linearly, and rounds in all.
const ROBUST_ROUNDS: usize = 4;
const ROUNDS: usize = 8;
/// What cannot be seen at all is as far off as this while a camera is looked for, deviations.
const UNSEEN: f64 = 1e4;
/// Whitened errors below this are rounding.
const LEAST: f64 = 1e-9;
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
    pub(super) candidate: Candidate,
    pub(super) ways: &'a [Way],
    pub(super) pairs: Vec<Pair>,
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

pub(super) struct Normal {
    information: DMatrix<f64>,
    gradient: DVector<f64>,
}

impl<'a> Bundle<'a> {
    /// A few robust rounds without leaving anything out: the median whitened distance, or `None` if it is no camera.
    pub(super) fn approach(&mut self) -> Option<f64> {
        for _ in 0..2 {
            self.renew()?;
            let limit = HUBER * self.scale()?;
            descend(self, limit)?;
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
            descend(&mut self, limit)?;
            if !self.keeps_spread {
                let camera = self.candidate.camera()?;
                let apart: Vec<Apart> =
                    self.pairs.iter().filter_map(|pair| self.apart(&camera, pair)).collect();
                self.spread = Spread::of(&apart);
            }
        }
        self.renew()?;
        self.told()
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
        let camera = self.candidate.camera()?;
        let mut pairs = std::mem::take(&mut self.pairs);
        let mean_px =
            pairs.iter().map(|pair| pair.radius_px).sum::<f64>() / pairs.len().max(1) as f64;
        for pair in &mut pairs {
            let Some(look) = self.look(&camera, pair) else { continue };
            let orientation = self.camera_from_world.rotation * look.at.orientation;
            let place_m = look.turned_m + self.camera_from_world.translation.vector;
            let pose = Isometry3::from_parts(place_m.into(), orientation);
            let radius_m = self.ways[pair.way].radius_m();
            if let Ok(image) = rim::image(&camera, &pose, &Point2::origin(), radius_m) {
                let (u, v) = image.offset_px;
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

    /// Deviation of a whitened coordinate.
    fn scale(&self) -> Option<f64> {
        let deviation = deviation(&mut self.distances(&self.candidate.camera()?))?;
        deviation.is_finite().then(|| deviation.max(LEAST))
    }

    fn leave_out(&mut self) -> Option<()> {
        let limit = OUTLIER * self.scale()?;
        let mut distances = self.distances(&self.candidate.camera()?).into_iter();
        self.pairs.retain(|_| distances.next().is_some_and(|it| it <= limit));
        Some(())
    }

    fn unknowns(&self) -> usize {
        self.candidate.unknowns() + PLACE + CLOCK
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

    /// Of each pair that can be seen, weighted as large errors are; and the errors' squares.
    fn parts(&self, limit: f64) -> Option<(Vec<Part>, f64)> {
        let by_lens = self.candidate.slopes()?;
        let mut squares = 0.0;
        let part = |pair: &Pair| {
            let look = self.look(&by_lens.camera, pair)?;
            let mut error = pair.whitener * look.error;
            let norm = error.norm();
            if !norm.is_finite() {
                return None;
            }
            squares += norm * norm;
            let mut slopes = self.slopes(&by_lens, pair, &look)?;
            if norm > limit {
                let root = (limit / norm).sqrt();
                error *= root;
                slopes *= root;
            }
            Some(Part { way: pair.way, stamp_s: pair.stamp_s, slopes, error })
        };
        let parts = self.pairs.iter().filter_map(part).collect();
        Some((parts, squares))
    }

    /// Whitened derivatives by all unknowns.
    fn slopes(&self, by_lens: &Slopes, pair: &Pair, look: &Look) -> Option<Matrix2xX<f64>> {
        let place_m = look.turned_m + self.camera_from_world.translation.vector;
        let mut slopes = by_lens.at(&place_m)?;
        let first = slopes.ncols();
        slopes = slopes.resize_horizontally(self.unknowns(), 0.0);
        let by_turn = -look.jacobian * look.turned_m.cross_matrix();
        slopes.fixed_view_mut::<2, 3>(0, first).copy_from(&by_turn);
        slopes.fixed_view_mut::<2, 3>(0, first + 3).copy_from(&look.jacobian);
        let slip = -self.slip(look);
        slopes.fixed_view_mut::<2, 1>(0, first + PLACE).copy_from(&slip);
        slopes.fixed_view_mut::<2, 1>(0, first + PLACE + 1).copy_from(&(slip * pair.stamp_s));
        Some(pair.whitener * slopes)
    }

    fn told(self) -> Option<Fit<'a>> {
        let camera = self.candidate.camera()?;
        let (parts, squares) = self.parts(f64::MAX)?;
        let Jackknife { covariance, plain } = jackknife(&parts, &self.known())?;
        let lens = self.candidate.unknowns();
        let ratio = (0..lens).map(|i| covariance[(i, i)] / plain[(i, i)]).sum::<f64>();
        let distances = self.pairs.iter().filter_map(|pair| Some(self.look(&camera, pair)?.error));
        let rms_px = (distances.map(|error| error.norm_squared()).sum::<f64>()
            / self.pairs.len().max(1) as f64)
            .sqrt();
        let inflation = (ratio / lens as f64).max(1.0);
        Some(Fit { bundle: self, camera, covariance, inflation, squares, rms_px })
    }
}

impl Descent for Bundle<'_> {
    type Normal = Normal;
    const MOST_STEPS: usize = 30;
    const SETTLED: f64 = 1e-9;

    fn cost(&self, limit: f64) -> Option<f64> {
        // At last, a roundel whose way ends just there is no reason to take no step.
        let unseen = if limit < f64::MAX { UNSEEN } else { OUTLIER };
        let seen = self.distances(&self.candidate.camera()?).into_iter();
        let seen = seen.map(|it| huber(if it.is_finite() { it } else { unseen }, limit));
        let clock = (0..CLOCK).map(|i| (self.clock[i] / self.clock_prior[i]).powi(2));
        Some(seen.sum::<f64>() + clock.sum::<f64>())
    }

    fn normal(&self, limit: f64) -> Option<Normal> {
        let (parts, _) = self.parts(limit)?;
        let size = self.unknowns();
        let mut normal = Normal { information: self.known(), gradient: DVector::zeros(size) };
        for i in 0..CLOCK {
            let at = size - CLOCK + i;
            normal.gradient[at] -= self.clock[i] / self.clock_prior[i].powi(2);
        }
        for Part { slopes, error, .. } in &parts {
            normal.information += slopes.transpose() * slopes;
            normal.gradient -= slopes.transpose() * error;
        }
        Some(normal)
    }

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
        stepped.candidate.step(step.as_slice());
        let place = self.candidate.unknowns();
        let part = |first: usize| Vector3::new(step[first], step[first + 1], step[first + 2]);
        let turn = UnitQuaternion::from_scaled_axis(part(place));
        let place_m = self.camera_from_world.translation.vector + part(place + 3);
        stepped.camera_from_world =
            Rigid::from_parts(place_m.into(), turn * self.camera_from_world.rotation);
        for i in 0..CLOCK {
            stepped.clock[i] += step[place + PLACE + i];
        }
        Some(stepped)
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
