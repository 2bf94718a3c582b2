//! One of the two normals that an ellipse allows, filtered as if it were the right one.
//!
//! From each measurement it takes the candidate that suits it better, and says how well that fits; which of two
//! hypotheses is right is for [`super::Attitude`] to tell.

use nalgebra::{UnitQuaternion, Vector3};

use super::{AttitudeMeasurement, smallest_turn};
use crate::track::{Correction, Innovation, Kernel, MotionModel, Spread};
use roundel_vision::{
    id::CameraId,
    rigid::{UNKNOWN_ANGLE_VARIANCE_RAD2, turn_by, vector_of},
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
    /// That the normal it took is the right one, as the measurement has it.
    chance: f64,
    innovation: Innovation,
    /// Of the log-likelihood over the logarithm of the density.
    pub(super) slope: Vector3<f64>,
}

impl Fit {
    /// ln of this one's likelihood over another's, L² ∝ chance² exp(-d²) / det S.
    pub(super) fn evidence_over(&self, other: &Self) -> f64 {
        let (mine, others) = (&self.innovation, &other.innovation);
        let chances = self.chance / other.chance;
        let ratio = chances * chances * (others.determinant / mine.determinant);
        0.5 * (others.distance_squared - mine.distance_squared + ratio.ln())
    }

    /// The same over a normal that fits as it should at worst; none is better.
    pub(super) fn evidence_over_fitting(&self) -> f64 {
        0.5 * (FITTING_DISTANCE_SQUARED - self.innovation.distance_squared).min(0.0)
    }

    /// ln of the likelihood if all covariances were [`SURPRISE`] times as large, over that stated.
    pub(super) fn surprise(self) -> f64 {
        0.5 * (self.innovation.distance_squared * (1.0 - 1.0 / SURPRISE) - 3.0 * SURPRISE.ln())
    }
}

/// How well a candidate fits at most.
struct Most {
    /// Its innovation's squared length is no less …
    distance_squared: f64,
    /// … and chance² / det S no more.
    weight: f64,
}

impl Most {
    /// Nothing is known.
    const OPEN: Self = Self { distance_squared: 0.0, weight: f64::INFINITY };

    fn is_open(&self) -> bool {
        self.weight == f64::INFINITY
    }

    /// Whether it may fit better than one of that chance with that innovation.
    ///
    /// PERF: it mostly does not by far, and ln x ≥ 1 - 1/x says so without a logarithm.
    fn exceeds(&self, chance: f64, innovation: &Innovation) -> bool {
        let further = self.distance_squared - innovation.distance_squared;
        let per_ratio = self.weight * innovation.determinant / (chance * chance);
        // What is not a number may be anything.
        let is_less = |least: f64| least >= 0.0;
        !is_less(further + 1.0 - per_ratio) && !is_less(further - per_ratio.ln())
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
        let normal = self.normal();
        let ways = [0, 1].map(|index| self.way_to(seen, index, &normal));
        let near = usize::from(ways[1].chord_squared() < ways[0].chord_squared());
        let far = 1 - near;
        let most = self.most((seen, unread_rad2), (far, &ways[far]), &normal);
        if most.is_open() {
            return self.update_by_better((seen, unread_rad2), &ways, camera, model);
        }
        let (turn, chance) = (ways[near].turn(), seen.chance(near));
        let noise = seen.noise_from(near, (&normal, unread_rad2));
        let taken = self.kernel.update_if(
            |innovation| !most.exceeds(chance, innovation),
            &turn,
            (&noise, camera),
            model.robust_distance_squared,
        );
        let Some(Correction { value, innovation, slope }) = taken else {
            return self.update_by_better((seen, unread_rad2), &ways, camera, model);
        };
        self.orientation = turn_by(&value) * self.orientation;
        (Fit { chance, innovation, slope }, near)
    }

    /// The same where it takes both innovations to tell which one that is.
    fn update_by_better(
        &mut self,
        (seen, unread_rad2): (&AttitudeMeasurement, f64),
        ways: &[Way; 2],
        camera: CameraId,
        model: &MotionModel,
    ) -> (Fit, usize) {
        let turns = [0, 1].map(|index| ways[index].turn());
        let about = (&self.normal(), unread_rad2);
        let noises = [0, 1].map(|index| seen.noise_from(index, about));
        let foreseen =
            [0, 1].map(|index| self.kernel.foresee(&turns[index], &noises[index], camera));
        let fit = |index: usize| {
            let innovation = foreseen[index].as_ref()?.innovation;
            Some(Fit { chance: seen.chance(index), innovation, slope: Vector3::zeros() })
        };
        let index = match (fit(0), fit(1)) {
            (Some(first), Some(other)) => usize::from(other.evidence_over(&first) > 0.0),
            (first, _) => usize::from(first.is_none()),
        };
        let (Some(fit), Some(foreseen)) = (fit(index), &foreseen[index]) else {
            let innovation = Innovation { distance_squared: 0.0, determinant: 1.0 };
            return (Fit { chance: 1.0, innovation, slope: Vector3::zeros() }, 0);
        };
        let robust = model.robust_distance_squared;
        let correction = self.kernel.correct(&turns[index], &noises[index], foreseen, robust);
        self.orientation = turn_by(&correction.value) * self.orientation;
        (Fit { slope: correction.slope, ..fit }, index)
    }

    /// How well a candidate that is off by r, by an angle of θ, fits at most. Of the innovation's covariance S it is known
    /// that rᵀS⁻¹r ≥ |r|⁴ / rᵀSr (Cauchy, Schwarz), that S ≤ 2 (A + R) (A the state's covariance), since whatever A and R
    /// share is at most as large as they are, and that S is no less than what of R is fresh each time, whose determinant
    /// stays the same where it is turned. θ is no less than its chord.
    /// PERF: the mirrored candidate is mostly far off, and needs no innovation, no error and no angle of its own then.
    fn most(
        &self,
        (seen, unread_rad2): (&AttitudeMeasurement, f64),
        (index, way): (usize, &Way),
        normal: &Vector3<f64>,
    ) -> Most {
        let noise = seen.other_noise.as_ref().filter(|_| index == 1).unwrap_or(&seen.noise);
        let fresh = noise.total - noise.systematic_root * noise.systematic_root.transpose();
        let determinant = fresh.determinant();
        let axis = way.axis();
        let mut both = axis.dot(&(self.kernel.spread.value * axis));
        both += seen.variance_along(index, &axis);
        if seen.yaw_symmetry.is_none() {
            both += axis.dot(normal).powi(2) * unread_rad2;
        }
        // What clocks add is not in it.
        if noise.timing_s > 0.0 || !(determinant > 0.0 && both > 0.0) {
            return Most::OPEN;
        }
        let chance = seen.chance(index);
        Most {
            distance_squared: way.chord_squared() * axis.norm_squared() / (2.0 * both),
            weight: chance * chance / determinant,
        }
    }

    /// From this orientation, with this normal, to the candidate's.
    fn way_to(&self, seen: &AttitudeMeasurement, index: usize, normal: &Vector3<f64>) -> Way {
        if seen.yaw_symmetry.is_some() {
            Way::Rotation(seen.nearest(index, &self.orientation) * self.orientation.inverse())
        } else {
            Way::Lean { from: *normal, to: seen.normal(index) }
        }
    }
}

/// What lies between an orientation and a candidate.
enum Way {
    Rotation(UnitQuaternion<f64>),
    /// The smallest rotation from one normal to another.
    Lean {
        from: Vector3<f64>,
        to: Vector3<f64>,
    },
}

impl Way {
    /// The rotation vector.
    fn turn(&self) -> Vector3<f64> {
        match self {
            Self::Rotation(rotation) => vector_of(rotation),
            Self::Lean { from, to } => smallest_turn(from, to),
        }
    }

    /// Along that, of whatever length.
    fn axis(&self) -> Vector3<f64> {
        match self {
            Self::Rotation(rotation) => rotation.imag(),
            Self::Lean { from, to } => from.cross(to),
        }
    }

    /// Square of its angle's chord.
    fn chord_squared(&self) -> f64 {
        match self {
            Self::Rotation(rotation) => 4.0 * rotation.imag().norm_squared(),
            Self::Lean { from, to } => (to - from).norm_squared(),
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

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;
    use proptest::prelude::*;

    use super::*;
    use crate::track::Noise;

    /// Anything that turns freely.
    fn model() -> MotionModel {
        MotionModel {
            acceleration_density_m2_s3: Vector3::repeat(1.0),
            angular_density_rad2_s3: Vector3::repeat(2.0),
            speed_m_s: Vector3::repeat(2.0),
            angular_speed_rad_s: Vector3::repeat(3.0),
            systematic_time_s: 1.0,
            robust_distance_squared: 16.0,
            upright_log_odds: 1.0,
            learns_turning: true,
            ground: None,
        }
    }

    fn vector(size: f64) -> impl Strategy<Value = Vector3<f64>> {
        [-size..size, -size..size, -size..size].prop_map(Vector3::from)
    }

    /// One that is turned by `turn`, and by `apart` from there.
    fn seen(
        (turn, apart): (&Vector3<f64>, &Vector3<f64>),
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
        fn the_candidate_taken_is_the_better_of_both(
            steps in proptest::collection::vec(
                (vector(0.2), vector(1.0), 0.5..1.0f64, 0.01..0.2f64, 0..3u32),
                2..12,
            ),
            yaw_symmetry in prop_oneof![Just(None), Just(Some(1)), Just(Some(2))],
            unread_rad2 in prop_oneof![Just(300.0), Just(UNKNOWN_ANGLE_VARIANCE_RAD2)],
        ) {
            let model = model();
            let measured = |(turn, apart, likelihood, deviation_rad, camera): &(_, _, _, _, u32)| {
                (seen((turn, apart), *likelihood, yaw_symmetry, *deviation_rad), CameraId(*camera))
            };
            let (first, camera) = measured(&steps[0]);
            let kernel = begin(&first, 0, camera, &model);
            let mut quick = Hypothesis { orientation: first.completed(0), kernel };
            for step in &steps[1..] {
                let (seen, camera) = measured(step);
                let density = model.angular_density_rad2_s3;
                quick.kernel.predict(0.01, &density, model.systematic_time_s);
                let mut plain = quick;
                let normal = plain.normal();
                let ways = [0, 1].map(|index| plain.way_to(&seen, index, &normal));
                let by = (&seen, unread_rad2);
                let (fit, taken) = quick.update(by, camera, &model);
                let (expected, better) = plain.update_by_better(by, &ways, camera, &model);
                prop_assert_eq!(taken, better);
                prop_assert!(fit.evidence_over(&expected).abs() < 1e-9);
                prop_assert!(quick.orientation.angle_to(&plain.orientation) < 1e-9);
                prop_assert!((quick.kernel.rate - plain.kernel.rate).norm() < 1e-9);
                let apart = quick.kernel.spread.matrix() - plain.kernel.spread.matrix();
                prop_assert!(apart.amax() < 1e-9);
            }
        }
    }
}
