//! One of the two normals that an ellipse allows, filtered as if it were the right one.
//!
//! From each measurement it takes the candidate that suits it better, and says how well that fits; which of two
//! hypotheses is right is for [`super::Attitude`] to tell.

use nalgebra::{UnitQuaternion, Vector3};

use super::{AttitudeMeasurement, smallest_turn};
use crate::{
    id::CameraId,
    rigid::{UNKNOWN_ANGLE_VARIANCE_RAD2, turn_by, vector_of},
    track::{Kernel, MotionModel, Spread},
};

/// Squared Mahalanobis length that a fitting measurement of the normal has at most (χ², 2 degrees
/// of freedom, 0.99).
const FITTING_DISTANCE_SQUARED: f64 = 9.2;

/// Share of the process noise's part in the covariance of the normal that is told.
const TILT_SHARE: f64 = 1.5;
/// The same of the angular velocity about it, where the density is what objects are capable of at most.
const TURNING_SHARE: f64 = 0.5;
/// A manoeuvre has begun when innovations are as if their covariance were so many times as large.
const SURPRISE: f64 = 4.0;

/// A normal and what turns it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hypothesis {
    pub(super) orientation: UnitQuaternion<f64>,
    pub(super) kernel: Kernel,
}

/// How well a hypothesis explains a measurement.
#[derive(Clone, Copy)]
pub(super) struct Fit {
    pub(super) evidence: f64,
    distance_squared: f64,
    /// Of the log-likelihood over the logarithm of the density.
    pub(super) slope: Vector3<f64>,
}

impl Fit {
    /// ln of the likelihood if all covariances were [`SURPRISE`] times as large, over that stated.
    pub(super) fn surprise(self) -> f64 {
        0.5 * (self.distance_squared * (1.0 - 1.0 / SURPRISE) - 3.0 * SURPRISE.ln())
    }

    /// That of a normal which fits as it should at worst.
    pub(super) fn fitting(self) -> Self {
        let excess = (self.distance_squared - FITTING_DISTANCE_SQUARED).max(0.0);
        Self { evidence: self.evidence + excess / 2.0, ..self }
    }
}

impl Hypothesis {
    /// Orientation and covariance `dt` seconds from now.
    pub(super) fn told(
        &self,
        dt: f64,
        density: &Vector3<f64>,
        model: &MotionModel,
    ) -> (UnitQuaternion<f64>, Spread) {
        let turn = turn_by(&(self.kernel.rate * dt));
        let (tilt, turning) =
            if model.learns_turning { (TILT_SHARE, TURNING_SHARE) } else { (1.0, 1.0) };
        let normal = self.normal();
        let along = normal.component_mul(&normal);
        let of_value = along.map(|along| tilt + (1.0 - tilt) * along);
        let of_rate = along.map(|along| 1.0 + (turning - 1.0) * along);
        let mut spread = self.kernel.told_sharing(&of_value, &of_rate);
        spread.predict(dt, density);
        (turn * self.orientation, spread)
    }

    pub(super) fn normal(&self) -> Vector3<f64> {
        self.orientation * Vector3::z()
    }

    /// Makes the angle about the normal unknown, and how it turns about it.
    pub(super) fn forget_yaw(&mut self, model: &MotionModel) {
        let normal = self.normal();
        let along = normal * normal.transpose();
        self.kernel.spread.value += along * UNKNOWN_ANGLE_VARIANCE_RAD2;
        self.kernel.spread.rate += along * turning(model).dot(&normal.component_mul(&normal));
    }

    /// Takes the candidate that suits better, where about the normal nothing better than `unread_rad2` is known from
    /// a measurement without yaw; says how well it fits and which one it was.
    pub(super) fn update(
        &mut self,
        (seen, unread_rad2): (&AttitudeMeasurement, f64),
        camera: CameraId,
        model: &MotionModel,
    ) -> (Fit, usize) {
        let turns = [0, 1].map(|index| self.turn_to(seen, index));
        let near = usize::from(turns[1].norm_squared() < turns[0].norm_squared());
        let about = (&self.normal(), unread_rad2);
        let fit = |kernel: &mut Kernel, index: usize| {
            let noise = seen.noise_from(index, about);
            let foreseen = kernel.foresee(&turns[index], &noise, camera)?;
            let distance_squared = foreseen.innovation.distance_squared;
            let evidence = seen.log_likelihood(index)
                - 0.5 * (distance_squared + foreseen.innovation.log_det());
            let fit = Fit { evidence, distance_squared, slope: Vector3::zeros() };
            Some((fit, index, noise, foreseen))
        };
        let mut chosen = fit(&mut self.kernel, near);
        let far = 1 - near;
        let evidence = chosen.as_ref().map_or(f64::NEG_INFINITY, |(fit, ..)| fit.evidence);
        if evidence < self.most_evidence((seen, unread_rad2), far, &turns[far])
            && let Some(other) = fit(&mut self.kernel, far)
        {
            let is_better =
                if far == 1 { other.0.evidence > evidence } else { other.0.evidence >= evidence };
            if is_better {
                chosen = Some(other);
            }
        }
        let Some((mut fit, index, noise, foreseen)) = chosen else {
            return (Fit { evidence: 0.0, distance_squared: 0.0, slope: Vector3::zeros() }, 0);
        };
        let robust = model.robust_distance_squared;
        let correction = self.kernel.correct(&turns[index], &noise, &foreseen, robust);
        fit.slope = correction.slope;
        self.orientation = turn_by(&correction.value) * self.orientation;
        (fit, index)
    }

    /// More than any evidence for a candidate that is off by `turn` = r. Of the innovation's covariance S it is known
    /// that rᵀS⁻¹r ≥ |r|⁴ / rᵀSr (Cauchy, Schwarz), that S ≤ 2 (A + R) (A the state's covariance), since whatever A and R
    /// share is at most as large as they are, and that S is no less than what of R is fresh each time, whose determinant
    /// stays the same where it is turned.
    /// PERF: the mirrored candidate is mostly far off, and needs no innovation and no error of its own then.
    fn most_evidence(
        &self,
        (seen, unread_rad2): (&AttitudeMeasurement, f64),
        index: usize,
        turn: &Vector3<f64>,
    ) -> f64 {
        let noise = seen.other_noise.as_ref().filter(|_| index == 1).unwrap_or(&seen.noise);
        let fresh = noise.total - noise.systematic_root * noise.systematic_root.transpose();
        let determinant = fresh.determinant();
        let mut both = turn.dot(&(self.kernel.spread.value * turn));
        both += seen.variance_along(index, turn);
        if seen.yaw_symmetry.is_none() {
            both += turn.dot(&self.normal()).powi(2) * unread_rad2;
        }
        // What clocks add is not in it.
        if noise.timing_s > 0.0 || !(determinant > 0.0 && both > 0.0) {
            return f64::INFINITY;
        }
        let distance_squared = turn.norm_squared().powi(2) / (2.0 * both);
        seen.log_likelihood(index) - 0.5 * (distance_squared + determinant.ln())
    }

    /// The rotation from this orientation to the candidate's.
    fn turn_to(&self, seen: &AttitudeMeasurement, index: usize) -> Vector3<f64> {
        if seen.yaw_symmetry.is_some() {
            vector_of(&(seen.nearest(index, &self.orientation) * self.orientation.inverse()))
        } else {
            smallest_turn(&self.normal(), &seen.normal(index))
        }
    }
}

/// A filter of one candidate.
pub(super) fn begin(
    seen: &AttitudeMeasurement,
    index: usize,
    camera: CameraId,
    model: &MotionModel,
) -> Kernel {
    let about = (&seen.normal(index), UNKNOWN_ANGLE_VARIANCE_RAD2);
    Kernel::begin(&seen.noise_from(index, about), camera, &turning(model))
}

/// Variance of an unseen angular velocity about each axis.
fn turning(model: &MotionModel) -> Vector3<f64> {
    model.angular_speed_rad_s.component_mul(&model.angular_speed_rad_s)
}
