//! One of the two normals that an ellipse allows, filtered as if it were the right one.
//!
//! A hypothesis takes from each measurement the candidate that fits better and returns how well it fits.
//! [`super::Attitude`] decides between hypotheses.

use nalgebra::{UnitQuaternion, Vector3};

use super::{AttitudeMeasurement, smallest_turn};
use crate::track::{BlockCovariance, Correction, ErrorSource, Innovation, Kalman, MotionModel};
use roundel_vision::{
    id::CameraId,
    rigid::{UNKNOWN_ANGLE_VARIANCE_RAD2, turn_by, vector_of},
};

/// Largest squared Mahalanobis length of a measurement that fits (χ², 2 degrees of freedom, 0.99).
const FITTING_DISTANCE_SQUARED: f64 = 9.2;

/// Share of the process noise's part in the reported covariance of the normal.
const TILT_SHARE: f64 = 1.5;
/// The same for the angular velocity about the normal, whose density is the configured one, an upper limit.
const TURNING_SHARE: f64 = 0.5;
/// A manoeuvre is detected when innovations look as if their covariance were this many times as large.
const MANOEUVRE_INFLATION: f64 = 4.0;

/// Orientation with its filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hypothesis {
    pub(super) orientation: UnitQuaternion<f64>,
    pub(super) kalman: Kalman,
}

/// How well a hypothesis explains a measurement.
#[derive(Clone, Copy)]
pub(super) struct Fit {
    /// Prior probability of the candidate taken, by the measurement.
    probability: f64,
    innovation: Innovation,
    /// Derivative of the log-likelihood over ln of the density.
    pub(super) slope: Vector3<f64>,
}

impl Fit {
    /// ln of the ratio of this likelihood to another's, L² ∝ probability² exp(-d²) / det S.
    pub(super) fn evidence_over(&self, other: &Self) -> f64 {
        let (mine, others) = (&self.innovation, &other.innovation);
        let chances = self.probability / other.probability;
        let ratio = chances * chances * (others.determinant / mine.determinant);
        0.5 * (others.distance_squared - mine.distance_squared + ratio.ln())
    }

    /// The same against a normal at the limit of fitting; at most zero.
    pub(super) fn evidence_over_fitting(&self) -> f64 {
        0.5 * (FITTING_DISTANCE_SQUARED - self.innovation.distance_squared).min(0.0)
    }

    /// ln of the likelihood with all covariances [`MANOEUVRE_INFLATION`] times as large, over the likelihood as
    /// stated.
    pub(super) fn manoeuvre_log_ratio(self) -> f64 {
        0.5 * (self.innovation.distance_squared * (1.0 - 1.0 / MANOEUVRE_INFLATION)
            - 3.0 * MANOEUVRE_INFLATION.ln())
    }
}

/// Upper bound of how well a candidate fits.
struct FitBound {
    /// Lower bound of its innovation's squared length.
    distance_squared: f64,
    /// Upper bound of probability² / det S.
    weight: f64,
}

impl FitBound {
    const UNBOUNDED: Self = Self { distance_squared: 0.0, weight: f64::INFINITY };

    fn is_unbounded(&self) -> bool {
        self.weight == f64::INFINITY
    }

    /// Whether the candidate may fit better than one of this probability with this innovation.
    ///
    /// PERF: mostly it is far from it, and ln x ≥ 1 - 1/x shows that without a logarithm.
    fn may_exceed(&self, probability: f64, innovation: &Innovation) -> bool {
        let further = self.distance_squared - innovation.distance_squared;
        let ratio = self.weight * innovation.determinant / (probability * probability);
        // NaN counts as possibly better.
        let is_certain = |lower_bound: f64| lower_bound >= 0.0;
        !is_certain(further + 1.0 - ratio) && !is_certain(further - ratio.ln())
    }
}

impl Hypothesis {
    /// Starts from one candidate, with the symmetric orientation nearest to `near`.
    pub(super) fn begin(
        measurement: &AttitudeMeasurement,
        index: usize,
        near: &UnitQuaternion<f64>,
        camera: CameraId,
        model: &MotionModel,
    ) -> Self {
        let normal = measurement.normal(index);
        let noise = measurement.noise_from(index, &normal, UNKNOWN_ANGLE_VARIANCE_RAD2);
        Self {
            orientation: measurement.nearest_symmetric(index, near),
            kalman: Kalman::begin(&noise, camera, &angular_velocity_variance(model)),
        }
    }

    /// Orientation and reported covariance `dt` seconds from now.
    pub(super) fn report(
        &self,
        dt: f64,
        density: &Vector3<f64>,
        model: &MotionModel,
    ) -> (UnitQuaternion<f64>, BlockCovariance) {
        let turn = turn_by(&(self.kalman.rate * dt));
        let (tilt, angular_velocity_variance) =
            if model.learns_rotation_density { (TILT_SHARE, TURNING_SHARE) } else { (1.0, 1.0) };
        let normal = self.normal();
        let along = normal.component_mul(&normal);
        let of_value = along.map(|along| tilt + (1.0 - tilt) * along);
        let of_rate = along.map(|along| 1.0 + (angular_velocity_variance - 1.0) * along);
        let mut covariance = self.kalman.reported_with_shares(&of_value, &of_rate);
        covariance.predict(dt, density);
        (turn * self.orientation, covariance)
    }

    pub(super) fn normal(&self) -> Vector3<f64> {
        self.orientation * Vector3::z()
    }

    /// Resets angle and angular velocity about the normal to unknown.
    pub(super) fn forget_yaw(&mut self, model: &MotionModel) {
        let normal = self.normal();
        let along = normal * normal.transpose();
        self.kalman.covariance.value += along * UNKNOWN_ANGLE_VARIANCE_RAD2;
        self.kalman.covariance.rate +=
            along * angular_velocity_variance(model).dot(&normal.component_mul(&normal));
    }

    /// Takes the candidate that fits better. A measurement without yaw has the variance `unread_rad2` about the
    /// normal. Returns how well it fits and its index.
    pub(super) fn update(
        &mut self,
        measurement: &AttitudeMeasurement,
        unread_rad2: f64,
        camera: CameraId,
        model: &MotionModel,
    ) -> (Fit, usize) {
        let normal = self.normal();
        let rotations = [0, 1].map(|index| self.rotation_to(measurement, index, &normal));
        let near = usize::from(rotations[1].chord_squared() < rotations[0].chord_squared());
        let far = 1 - near;
        let bound = self.bound(measurement, unread_rad2, far, &rotations[far], &normal);
        if bound.is_unbounded() {
            return self.update_with_better(measurement, unread_rad2, &rotations, camera, model);
        }
        let (turn, probability) = (rotations[near].turn(), measurement.probability(near));
        let noise = measurement.noise_from(near, &normal, unread_rad2);
        let taken = self.kalman.update_if(
            |innovation| !bound.may_exceed(probability, innovation),
            &turn,
            ErrorSource { noise: &noise, camera },
            model.robust_distance_squared,
        );
        let Some(Correction { value, innovation, slope }) = taken else {
            return self.update_with_better(measurement, unread_rad2, &rotations, camera, model);
        };
        self.orientation = turn_by(&value) * self.orientation;
        (Fit { probability, innovation, slope }, near)
    }

    /// The same where deciding needs both innovations.
    fn update_with_better(
        &mut self,
        measurement: &AttitudeMeasurement,
        unread_rad2: f64,
        rotations: &[RotationTo; 2],
        camera: CameraId,
        model: &MotionModel,
    ) -> (Fit, usize) {
        let turns = [0, 1].map(|index| rotations[index].turn());
        let normal = self.normal();
        let noises = [0, 1].map(|index| measurement.noise_from(index, &normal, unread_rad2));
        let prepared = [0, 1].map(|index| {
            let source = ErrorSource { noise: &noises[index], camera };
            self.kalman.prepare_update(&turns[index], source)
        });
        let fit = |index: usize| {
            let innovation = prepared[index].as_ref()?.innovation;
            Some(Fit {
                probability: measurement.probability(index),
                innovation,
                slope: Vector3::zeros(),
            })
        };
        let index = match (fit(0), fit(1)) {
            (Some(first), Some(other)) => usize::from(other.evidence_over(&first) > 0.0),
            (first, _) => usize::from(first.is_none()),
        };
        let (Some(fit), Some(prepared)) = (fit(index), &prepared[index]) else {
            let innovation = Innovation { distance_squared: 0.0, determinant: 1.0 };
            return (Fit { probability: 1.0, innovation, slope: Vector3::zeros() }, 0);
        };
        let robust = model.robust_distance_squared;
        let correction = self.kalman.correct(&turns[index], &noises[index], prepared, robust);
        self.orientation = turn_by(&correction.value) * self.orientation;
        (Fit { slope: correction.slope, ..fit }, index)
    }

    /// Upper bound of the fit of a candidate with rotation vector r and angle θ. For the innovation's covariance
    /// S: rᵀS⁻¹r ≥ |r|⁴ / rᵀSr (Cauchy, Schwarz); S ≤ 2 (A + R) (A: the state's covariance), however A and R are
    /// correlated; and S is at least the fresh part of R, whose determinant does not change with rotation. θ is
    /// at least its chord.
    ///
    /// PERF: the mirrored candidate is mostly far off, and then needs no innovation, noise or angle.
    fn bound(
        &self,
        measurement: &AttitudeMeasurement,
        unread_rad2: f64,
        index: usize,
        rotation: &RotationTo,
        normal: &Vector3<f64>,
    ) -> FitBound {
        let noise =
            measurement.other_noise.as_ref().filter(|_| index == 1).unwrap_or(&measurement.noise);
        let fresh = noise.total - noise.systematic_root * noise.systematic_root.transpose();
        let determinant = fresh.determinant();
        let axis = rotation.axis();
        let mut variance = axis.dot(&(self.kalman.covariance.value * axis));
        variance += measurement.variance_along(index, &axis);
        if measurement.yaw_symmetry.is_none() {
            variance += axis.dot(normal).powi(2) * unread_rad2;
        }
        // The bound does not cover clock errors.
        if noise.timing_s > 0.0 || !(determinant > 0.0 && variance > 0.0) {
            return FitBound::UNBOUNDED;
        }
        let probability = measurement.probability(index);
        FitBound {
            distance_squared: rotation.chord_squared() * axis.norm_squared() / (2.0 * variance),
            weight: probability * probability / determinant,
        }
    }

    /// Rotation from this orientation, with this normal, to the candidate's.
    fn rotation_to(
        &self,
        measurement: &AttitudeMeasurement,
        index: usize,
        normal: &Vector3<f64>,
    ) -> RotationTo {
        if measurement.yaw_symmetry.is_some() {
            RotationTo::Rotation(
                measurement.nearest_symmetric(index, &self.orientation)
                    * self.orientation.inverse(),
            )
        } else {
            RotationTo::Tilt { from: *normal, to: measurement.normal(index) }
        }
    }
}

/// Rotation between an orientation and a candidate.
enum RotationTo {
    Rotation(UnitQuaternion<f64>),
    /// Smallest rotation from one normal to another.
    Tilt {
        from: Vector3<f64>,
        to: Vector3<f64>,
    },
}

impl RotationTo {
    /// Rotation vector.
    fn turn(&self) -> Vector3<f64> {
        match self {
            Self::Rotation(rotation) => vector_of(rotation),
            Self::Tilt { from, to } => smallest_turn(from, to),
        }
    }

    /// Direction of the rotation vector, not normalized.
    fn axis(&self) -> Vector3<f64> {
        match self {
            Self::Rotation(rotation) => rotation.imag(),
            Self::Tilt { from, to } => from.cross(to),
        }
    }

    /// Squared chord of the angle.
    fn chord_squared(&self) -> f64 {
        match self {
            Self::Rotation(rotation) => 4.0 * rotation.imag().norm_squared(),
            Self::Tilt { from, to } => (to - from).norm_squared(),
        }
    }
}

/// Variance of the initial angular velocity about each axis.
fn angular_velocity_variance(model: &MotionModel) -> Vector3<f64> {
    model.angular_speed_rad_s.component_mul(&model.angular_speed_rad_s)
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;
    use proptest::prelude::*;

    use super::*;
    use crate::track::Noise;

    /// Free rotation.
    fn model() -> MotionModel {
        MotionModel {
            acceleration_density_m2_s3: Vector3::repeat(1.0),
            angular_density_rad2_s3: Vector3::repeat(2.0),
            speed_m_s: Vector3::repeat(2.0),
            angular_speed_rad_s: Vector3::repeat(3.0),
            systematic_time_s: 1.0,
            robust_distance_squared: 16.0,
            upright_log_odds: 1.0,
            learns_rotation_density: true,
            ground: None,
        }
    }

    fn vector(size: f64) -> impl Strategy<Value = Vector3<f64>> {
        [-size..size, -size..size, -size..size].prop_map(Vector3::from)
    }

    /// Candidates rotated by `turn`, and by `apart` from there.
    fn measurement(
        turn: &Vector3<f64>,
        apart: &Vector3<f64>,
        likelihood: f64,
        yaw_symmetry: Option<u32>,
        deviation_rad: f64,
    ) -> AttitudeMeasurement {
        let first = turn_by(turn);
        let noise = Noise {
            total: Matrix3::identity() * deviation_rad.powi(2),
            systematic_root: Matrix3::identity() * (0.7 * deviation_rad),
            timing_s: 0.0,
        };
        AttitudeMeasurement::new([first, turn_by(apart) * first], likelihood, yaw_symmetry, noise)
    }

    proptest! {
        #[test]
        fn the_better_candidate_is_taken(
            steps in proptest::collection::vec(
                (vector(0.2), vector(1.0), 0.5..1.0f64, 0.01..0.2f64, 0..3u32),
                2..12,
            ),
            yaw_symmetry in prop_oneof![Just(None), Just(Some(1)), Just(Some(2))],
            unread_rad2 in prop_oneof![Just(300.0), Just(UNKNOWN_ANGLE_VARIANCE_RAD2)],
        ) {
            let model = model();
            let measured = |(turn, apart, likelihood, deviation_rad, camera): &(_, _, _, _, u32)| {
                (measurement(turn, apart, *likelihood, yaw_symmetry, *deviation_rad), CameraId(*camera))
            };
            let (first, camera) = measured(&steps[0]);
            let near = first.full_orientation(0);
            let mut quick = Hypothesis::begin(&first, 0, &near, camera, &model);
            for step in &steps[1..] {
                let (measurement, camera) = measured(step);
                let density = model.angular_density_rad2_s3;
                quick.kalman.predict(0.01, &density, model.systematic_time_s);
                let mut plain = quick;
                let normal = plain.normal();
                let rotations = [0, 1].map(|index| plain.rotation_to(&measurement, index, &normal));
                let (fit, taken) = quick.update(&measurement, unread_rad2, camera, &model);
                let (expected, better) =
                    plain.update_with_better(&measurement, unread_rad2, &rotations, camera, &model);
                prop_assert_eq!(taken, better);
                prop_assert!(fit.evidence_over(&expected).abs() < 1e-9);
                prop_assert!(quick.orientation.angle_to(&plain.orientation) < 1e-9);
                prop_assert!((quick.kalman.rate - plain.kalman.rate).norm() < 1e-9);
                let apart = quick.kalman.covariance.matrix() - plain.kalman.covariance.matrix();
                prop_assert!(apart.amax() < 1e-9);
            }
        }
    }
}
