//! Orientation and angular velocity of an object, with both normals that an ellipse allows.
//!
//! The error state is a small rotation δθ on the left (true R = exp([δθ]×) R, world frame) and the angular velocity's
//! error. [`super::Kalman`] filters them, and each correction is applied to the quaternion at once (multiplicative
//! Kalman filter: Lefferts, Markley, Shuster, 1982).
//!
//! A plain roundel shows its normal only ([`AttitudeMeasurement`]). A coded roundel whose code is not read in a frame
//! is measured as a plain one. Its yaw is predicted meanwhile and reported until it is too old or too uncertain.
//!
//! An elliptical disc looks the same after half a turn about its normal. Each measurement is taken as the orientation
//! nearer to the prediction, so a heading once adopted is kept.
//!
//! The process noise of the normal is learned ([`super::process_noise`]), since most objects stay upright. That of the
//! heading is not: it turns and stops within a second, too fast for learning. Rotations of the normal last, so the
//! reported covariance contains more of the process noise than for white noise (`hypothesis`; the argument is that of
//! [`super::Motion`]). Nothing is learned for bodies with a yaw: where a single plain roundel shows one, its position
//! depends on its orientation, and with a learned density only 90 % of positions lie inside their 95 % instead of 92.
//!
//! An ellipse allows two normals, mirrored at the line of sight. The wrong one changes with the view, the right one
//! does not. Up to two hypotheses are therefore filtered, each taking from every measurement the normal that fits it
//! better. The log-odds between them accumulate w · (e₀ - e₁), eₕ = max over normals k of (ln Lₖ - d²ₕₖ/2 - ½ ln det
//! Sₕ), and decay with a time constant of a second towards the prior that printed faces look up, so that a decision
//! needs continuing evidence. When only one hypothesis is left and fits badly, or its evidence has decayed, the normal
//! that it rejected becomes its rival again. The reported covariance is that of the mixture while the second hypothesis
//! is not negligible.

mod hypothesis;
mod measurement;

use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3};

use super::{
    BlockCovariance, Ground, MotionModel,
    cusum::{Cusum, UNOBSERVED_S},
    kalman::decayed,
    process_noise::Densities,
};
use hypothesis::{Fit, Hypothesis};
pub use measurement::AttitudeMeasurement;
use roundel_vision::{
    id::CameraId,
    rigid::{
        SMALL_SQUARED, UNKNOWN_ANGLE_VARIANCE_RAD2, arc_sine_share, orientation_of_normal, turn_by,
    },
};

/// Weight of each frame's evidence, since successive frames share most of their error.
const EVIDENCE_WEIGHT: f64 = 0.25;
/// Limit of a single measurement's evidence, before its weight.
const MAX_EVIDENCE: f64 = 8.0;
/// Limit of the log-odds, so that a wrong decision can be reversed.
const MAX_LOG_ODDS: f64 = 12.0;
/// The rival is dropped above the first log-odds, and created again below the second.
const DECIDED_LOG_ODDS: f64 = 8.0;
const RIVAL_LOG_ODDS: f64 = 5.0;
/// Time constant with which log-odds decay to the prior, seconds.
const VERDICT_TIME_S: f64 = 1.0;
/// Variance about the normal of an unread code while the yaw is predicted. The variance of an unknown angle would
/// be information, averaged sixty times a second, and the yaw would never become uncertain. (Without a yaw, that
/// variance keeps the filter from drifting about the normal.)
const UNREAD_VARIANCE_RAD2: f64 = 300.0;
/// The yaw is reported while its standard deviation is below the first and its newest measurement not older than
/// the second.
const MAX_YAW_DEVIATION_RAD: f64 = 0.3;
const MAX_YAW_AGE_S: f64 = 0.5;

/// Orientation and angular velocity of one object, with up to two hypotheses about the normal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attitude {
    best: Hypothesis,
    rival: Option<Hypothesis>,
    /// ln(likelihood of `best` / likelihood of the other normal).
    log_odds: f64,
    /// Symmetry of the newest measurement with a yaw.
    yaw_symmetry: Option<u32>,
    /// Age of that measurement, seconds.
    yaw_age_s: f64,
    /// Learned process noise.
    densities: Densities,
    manoeuvre: Cusum,
    unobserved_s: f64,
}

/// Estimate of orientation and angular velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AttitudeEstimate {
    /// world_from_roundel.
    pub orientation: UnitQuaternion<f64>,
    /// `None` while only the normal is known; else the number of evenly spaced yaws that look the same, of which
    /// this is the one nearest to earlier ones.
    pub yaw_symmetry: Option<u32>,
    /// World frame, rad/s; only across the normal while the yaw is not observed.
    pub angular_velocity_rad_s: Vector3<f64>,
    /// Over (rotation, angular velocity), world frame, left perturbation.
    pub covariance: Matrix6<f64>,
    /// Spectral density of white angular acceleration by which the covariance grows, rad²/s³.
    pub density_rad2_s3: Vector3<f64>,
}

impl Attitude {
    /// State after a first measurement.
    pub fn begin(measurement: &AttitudeMeasurement, camera: CameraId, model: &MotionModel) -> Self {
        let near = measurement.full_orientation(0);
        let hypothesis = |index: usize| Hypothesis::begin(measurement, index, &near, camera, model);
        let mut attitude = Self {
            best: hypothesis(0),
            rival: Some(hypothesis(1)),
            log_odds: 0.0,
            yaw_symmetry: measurement.yaw_symmetry,
            yaw_age_s: 0.0,
            densities: Densities::begin(&model.angular_density_rad2_s3, 0.0),
            manoeuvre: Cusum::default(),
            unobserved_s: 0.0,
        };
        attitude.log_odds =
            attitude.prior(model) + (measurement.probability(0) / measurement.probability(1)).ln();
        attitude.resolve();
        attitude
    }

    /// Copies without the kilobytes of an absent rival.
    pub(super) fn copy_from(&mut self, other: &Self) {
        self.best = other.best;
        match &other.rival {
            Some(rival) => self.rival = Some(*rival),
            None => self.rival = None,
        }
        (self.log_odds, self.yaw_symmetry, self.yaw_age_s) =
            (other.log_odds, other.yaw_symmetry, other.yaw_age_s);
        (self.densities, self.manoeuvre, self.unobserved_s) =
            (other.densities, other.manoeuvre, other.unobserved_s);
    }

    /// Predicts by `dt` seconds, either sign.
    pub fn predict(&mut self, dt: f64, model: &MotionModel) {
        let density = self.density(0.0, model);
        for hypothesis in std::iter::once(&mut self.best).chain(self.rival.as_mut()) {
            let turn = turn_by(&(hypothesis.kalman.rate * dt));
            hypothesis.orientation = turn * hypothesis.orientation;
            hypothesis.kalman.predict(dt, &density, model.systematic_time_s);
        }
        self.densities.fade(dt);
        self.unobserved_s += dt;
        self.yaw_age_s += dt;
        self.log_odds = decay_log_odds(self.log_odds, dt, self.prior(model));
    }

    /// Adds a measurement at the present time.
    pub fn update(
        &mut self,
        measurement: &AttitudeMeasurement,
        camera: CameraId,
        model: &MotionModel,
    ) {
        let has_yaw = self.yaw_symmetry.is_some() && self.yaw_age_s < MAX_YAW_AGE_S;
        let unread_rad2 = if has_yaw { UNREAD_VARIANCE_RAD2 } else { UNKNOWN_ANGLE_VARIANCE_RAD2 };
        if measurement.yaw_symmetry.is_some() {
            if !has_yaw {
                // The filter's angle about the normal is arbitrary until the first yaw.
                let hypotheses = std::iter::once(&mut self.best).chain(self.rival.as_mut());
                hypotheses.for_each(|hypothesis| hypothesis.forget_yaw(model));
            }
            (self.yaw_symmetry, self.yaw_age_s) = (measurement.yaw_symmetry, 0.0);
        }
        self.unobserved_s = 0.0;
        let (fit, taken) = self.best.update(measurement, unread_rad2, camera, model);
        if self.rival.is_none() {
            self.adapt(&fit, model);
        }
        let evidence = match &mut self.rival {
            Some(rival) => {
                fit.evidence_over(&rival.update(measurement, unread_rad2, camera, model).0)
            }
            // Without a rival, the reference is a normal that just fits.
            None => fit.evidence_over_fitting(),
        };
        let fresh = evidence.clamp(-MAX_EVIDENCE, MAX_EVIDENCE);
        self.log_odds =
            (self.log_odds + EVIDENCE_WEIGHT * fresh).clamp(-MAX_LOG_ODDS, MAX_LOG_ODDS);
        if self.rival.is_none() && self.log_odds < RIVAL_LOG_ODDS {
            let near = &self.best.orientation;
            self.rival = Some(Hypothesis::begin(measurement, 1 - taken, near, camera, model));
        }
        self.resolve();
    }

    /// Estimate `dt` seconds from now, either sign. The covariance covers both normals while both are possible.
    pub fn estimate(&self, dt: f64, model: &MotionModel) -> AttitudeEstimate {
        let density = self.density(dt, model);
        let (orientation, mut covariance) = self.best.report(dt, &density, model);
        if let Some(rival) = &self.rival {
            let (other, reported) = rival.report(dt, &density, model);
            let [normal, other] = [orientation, other].map(|turned| turned * Vector3::z());
            let weight = 1.0
                / (1.0 + decay_log_odds(self.log_odds, dt, prior(&normal, &other, model)).exp());
            let rotation = smallest_turn(&normal, &other);
            covariance.value +=
                (reported.value - covariance.value + rotation * rotation.transpose()) * weight;
            covariance.rate += (reported.rate - covariance.rate) * weight;
            covariance.cross += (reported.cross - covariance.cross) * weight;
        }
        let normal = orientation * Vector3::z();
        let is_known = self.yaw_age_s + dt < MAX_YAW_AGE_S
            && normal.dot(&(covariance.value * normal))
                < MAX_YAW_DEVIATION_RAD * MAX_YAW_DEVIATION_RAD;
        let mut estimate = AttitudeEstimate {
            orientation,
            yaw_symmetry: self.yaw_symmetry.filter(|_| is_known),
            angular_velocity_rad_s: self.best.kalman.rate,
            covariance: covariance.matrix(),
            density_rad2_s3: density,
        };
        if estimate.yaw_symmetry.is_none() {
            estimate.orientation = orientation_of_normal(&normal);
            estimate.angular_velocity_rad_s -=
                normal * normal.dot(&estimate.angular_velocity_rad_s);
            covariance = without_yaw(&covariance, &normal);
            estimate.covariance = covariance.matrix();
        }
        estimate
    }

    /// Part of the rotation's covariance that stems from the cameras' systematic errors.
    pub fn systematic_covariance(&self) -> Matrix3<f64> {
        let best = self.best.kalman.systematic_covariance();
        let Some(rival) = &self.rival else { return best };
        let weight = 1.0 / (1.0 + self.log_odds.exp());
        best + (rival.kalman.systematic_covariance() - best) * weight
    }

    /// Applies the constraint on the normal.
    pub fn constrain_to_floor(&mut self, ground: &Ground) {
        for hypothesis in std::iter::once(&mut self.best).chain(self.rival.as_mut()) {
            let turn = smallest_turn(&hypothesis.normal(), &Vector3::z());
            let correction = ground.constrain_tilt(&mut hypothesis.kalman, &turn);
            hypothesis.orientation = turn_by(&correction) * hypothesis.orientation;
        }
    }

    /// Learns the process noise from the fit of an undisputed normal.
    fn adapt(&mut self, fit: &Fit, model: &MotionModel) {
        if model.learns_rotation_density {
            self.densities.learn_tilt(&fit.slope, &self.best.normal());
        } else {
            self.densities.learn(&fit.slope);
        }
        if self.manoeuvre.is_raised_by(fit.manoeuvre_log_ratio()) {
            self.densities = Densities::begin(&model.angular_density_rad2_s3, 0.0);
        }
    }

    /// Density of process noise until `dt` seconds from now. At least the configured one while the object is not
    /// observed, since it may begin to turn, and while two normals are possible, since the wrong one moves as no
    /// object does.
    fn density(&self, dt: f64, model: &MotionModel) -> Vector3<f64> {
        let capability = &model.angular_density_rad2_s3;
        let density = if self.yaw_symmetry.is_none() {
            self.densities.expected()
        } else if model.learns_rotation_density {
            self.densities.expected_for_rotation(&self.best.normal(), capability)
        } else {
            *capability
        };
        if self.rival.is_some() || self.unobserved_s + dt > UNOBSERVED_S {
            density.sup(capability)
        } else {
            density
        }
    }

    /// Prior log-odds of the best normal against the rival's.
    fn prior(&self, model: &MotionModel) -> f64 {
        let of_rival = |rival: &Hypothesis| prior(&self.best.normal(), &rival.normal(), model);
        self.rival.as_ref().map_or(0.0, of_rival)
    }

    /// Puts the likelier hypothesis first and drops a rival that is decided against or equal.
    fn resolve(&mut self) {
        let Some(rival) = self.rival else { return };
        if self.log_odds < 0.0 {
            self.rival = Some(self.best);
            self.best = rival;
            self.log_odds = -self.log_odds;
        }
        let rotation = smallest_turn(&self.best.normal(), &rival.normal());
        let rotation = if self.log_odds >= 0.0 { rotation } else { -rotation };
        let both = self.best.kalman.covariance.value + rival.kalman.covariance.value;
        let length_squared = rotation.norm_squared();
        let variance = if length_squared > 0.0 {
            rotation.dot(&(both * rotation)) / length_squared
        } else {
            0.0
        };
        if length_squared <= variance || self.log_odds > DECIDED_LOG_ODDS {
            self.rival = None;
        }
    }
}

/// Covariance of a rotation and its rate with an unknown angle about `normal`: the variance of an unknown angle
/// there, and no correlation with the rest.
pub(crate) fn without_yaw(covariance: &BlockCovariance, normal: &Vector3<f64>) -> BlockCovariance {
    let along = normal * normal.transpose();
    let across = Matrix3::identity() - along;
    let rate_variance = normal.dot(&(covariance.rate * normal));
    BlockCovariance {
        value: across * covariance.value * across + along * UNKNOWN_ANGLE_VARIANCE_RAD2,
        cross: across * covariance.cross * across,
        rate: across * covariance.rate * across + along * rate_variance,
    }
}

/// Prior log-odds of one normal against another.
fn prior(best: &Vector3<f64>, other: &Vector3<f64>, model: &MotionModel) -> f64 {
    model.upright_log_odds * (best.z - other.z)
}

/// Log-odds `dt` seconds later, after decay towards the prior.
fn decay_log_odds(log_odds: f64, dt: f64, prior: f64) -> f64 {
    prior + (log_odds - prior) * decayed(dt.abs() / VERDICT_TIME_S)
}

/// Rotation vector of the smallest rotation from one unit vector to another.
pub(crate) fn smallest_turn(from: &Vector3<f64>, to: &Vector3<f64>) -> Vector3<f64> {
    let cross = from.cross(to);
    let (square, cosine) = (cross.norm_squared(), from.dot(to));
    if square < SMALL_SQUARED && cosine > 0.0 {
        return cross * arc_sine_share(square);
    }
    let sine = square.sqrt();
    if sine > 1e-12 {
        cross * (sine.atan2(cosine) / sine)
    } else {
        // Opposite vectors: any perpendicular axis is right; this choice is deterministic.
        let axis = if from.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
        from.cross(&axis).normalize() * std::f64::consts::PI
    }
}
