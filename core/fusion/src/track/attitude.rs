//! How an object is turned: orientation and angular velocity, with both normals kept in play.
//!
//! The error state is a small rotation δθ on the left (true R = exp([δθ]×) R, world frame) and the
//! angular velocity's error; [`super::Kernel`] filters them, and each correction goes into the quaternion
//! at once (a multiplicative Kalman filter: Lefferts, Markley, Shuster, 1982).
//!
//! A plain roundel shows its normal only ([`AttitudeMeasurement`]). A coded one whose code is not read now and
//! then is measured as a plain one then; its yaw goes on from before, and is told until it is too old or its
//! covariance has grown too large.
//!
//! An elliptical disc looks the same turned by half a turn about its normal. Of both orientations each
//! measurement is the one nearer to the prediction, so that a heading once taken up is kept.
//!
//! How strongly a normal is turned is learned ([`super::density`]): most objects stay upright. A heading is not: it
//! turns and stops within a second, and what is learned would follow too late. Where a normal is turned, that
//! lasts, so that more of it is told than white noise would leave (`hypothesis`; the argument is
//! [`super::Motion`]'s). Of bodies with a yaw nothing is learned: where a single plain roundel shows one, its place hangs
//! on its orientation, and with learned normals places lie in 90 % of cases inside their 95 % instead of 92.
//!
//! An ellipse allows two normals, mirrored at the line of sight. The wrong one changes with the
//! view, the right one does not. So up to two hypotheses are filtered, each taking from every
//! measurement the normal that suits it better; the log-odds between them gather
//! w · (e₀ - e₁), eₕ = max over normals k of (ln Lₖ - d²ₕₖ/2 - ½ ln det Sₕ), and forget with a
//! second's time constant towards the prior that printed faces look up, so that no verdict stands
//! without views to hold it. When only one hypothesis is left and it fits badly, or its verdict has
//! grown old, the normal it did not take stands up as its rival again. Both are shown by the
//! covariance, as long as the second is not negligible (moments of the mixture).

mod hypothesis;
mod measurement;

use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3};

use super::{
    Ground, MotionModel, Spread,
    cusum::{Alarm, UNSEEN_S},
    kalman::decayed,
    process_noise::Densities,
};
use hypothesis::{Fit, Hypothesis, begin};
pub use measurement::AttitudeMeasurement;
use roundel_vision::{
    id::CameraId,
    rigid::{
        SMALL_SQUARED, UNKNOWN_ANGLE_VARIANCE_RAD2, arc_sine_share, orientation_of_normal, turn_by,
    },
};

/// Successive frames share most of their error, so each counts only for this part of a fresh one.
const EVIDENCE_WEIGHT: f64 = 0.25;
/// What a single measurement may say at most, before its weight.
const EVIDENCE_LIMIT: f64 = 8.0;
/// Log-odds never exceed this, so that a mistake can be undone.
const ODDS_LIMIT: f64 = 12.0;
/// Above these odds the rival is let go; below the lower ones it may stand up again.
const SETTLED_ODDS: f64 = 8.0;
const RIVAL_ODDS: f64 = 5.0;
/// Verdicts fade with this time constant.
const VERDICT_TIME_S: f64 = 1.0;
/// Variance about the normal of an unread code while the yaw is known from before: that of an unknown angle would
/// be information, which averages sixty times a second, and the yaw would never be forgotten. (Without a yaw
/// to forget, an unknown angle's keeps the filter from drifting about it.)
const UNREAD_VARIANCE_RAD2: f64 = 300.0;
/// The yaw is told while its deviation is below this and the newest measurement that had one is no older.
const KNOWN_YAW_RAD: f64 = 0.3;
const KNOWN_YAW_S: f64 = 0.5;

/// Orientation and angular velocity of one object, with both normals while both are possible.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attitude {
    best: Hypothesis,
    rival: Option<Hypothesis>,
    /// ln(likelihood of `best` / likelihood of the other normal).
    log_odds: f64,
    /// Of the newest measurement that had a yaw …
    yaw_symmetry: Option<u32>,
    /// … and how old it is, seconds.
    yaw_age_s: f64,
    /// How strongly it is turned.
    densities: Densities,
    alarm: Alarm,
    unseen_s: f64,
}

/// What is told about an orientation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AttitudeEstimate {
    /// world_from_roundel.
    pub orientation: UnitQuaternion<f64>,
    /// `None` while only the normal is known; else in how many evenly spaced yaws it looks the same, of
    /// which this is the one nearest to those before.
    pub yaw_symmetry: Option<u32>,
    /// World frame, rad/s; across the normal only while the yaw is not observed.
    pub angular_velocity_rad_s: Vector3<f64>,
    /// Over (rotation, angular velocity), world frame, left perturbation.
    pub covariance: Matrix6<f64>,
    /// Spectral density of the white angular acceleration that it grows by, rad²/s³.
    pub density_rad2_s3: Vector3<f64>,
}

impl Attitude {
    /// What one measurement tells.
    pub fn begin(seen: &AttitudeMeasurement, camera: CameraId, model: &MotionModel) -> Self {
        let hypothesis = |index: usize| Hypothesis {
            orientation: seen.nearest(index, &seen.completed(0)),
            kernel: begin(seen, index, camera, model),
        };
        let mut attitude = Self {
            best: hypothesis(0),
            rival: Some(hypothesis(1)),
            log_odds: 0.0,
            yaw_symmetry: seen.yaw_symmetry,
            yaw_age_s: 0.0,
            densities: Densities::begin(&model.angular_density_rad2_s3, 0.0),
            alarm: Alarm::default(),
            unseen_s: 0.0,
        };
        attitude.log_odds = attitude.prior(model) + (seen.chance(0) / seen.chance(1)).ln();
        attitude.settle();
        attitude
    }

    /// Becomes another, without the kilobytes of a rival that is not there.
    pub(super) fn copy_from(&mut self, other: &Self) {
        self.best = other.best;
        match &other.rival {
            Some(rival) => self.rival = Some(*rival),
            None => self.rival = None,
        }
        (self.log_odds, self.yaw_symmetry, self.yaw_age_s) =
            (other.log_odds, other.yaw_symmetry, other.yaw_age_s);
        (self.densities, self.alarm, self.unseen_s) =
            (other.densities, other.alarm, other.unseen_s);
    }

    /// Moves on by `dt` seconds, either way.
    pub fn predict(&mut self, dt: f64, model: &MotionModel) {
        let density = self.density(0.0, model);
        for hypothesis in std::iter::once(&mut self.best).chain(self.rival.as_mut()) {
            let turn = turn_by(&(hypothesis.kernel.rate * dt));
            hypothesis.orientation = turn * hypothesis.orientation;
            hypothesis.kernel.predict(dt, &density, model.systematic_time_s);
        }
        self.densities.forget(dt);
        self.unseen_s += dt;
        self.yaw_age_s += dt;
        self.log_odds = faded(self.log_odds, dt, self.prior(model));
    }

    /// Takes in a measurement at the present time.
    pub fn update(&mut self, seen: &AttitudeMeasurement, camera: CameraId, model: &MotionModel) {
        let knows_yaw = self.yaw_symmetry.is_some() && self.yaw_age_s < KNOWN_YAW_S;
        let unread_rad2 =
            if knows_yaw { UNREAD_VARIANCE_RAD2 } else { UNKNOWN_ANGLE_VARIANCE_RAD2 };
        if seen.yaw_symmetry.is_some() {
            if !knows_yaw {
                // What was held about the normal meanwhile says nothing.
                let hypotheses = std::iter::once(&mut self.best).chain(self.rival.as_mut());
                hypotheses.for_each(|hypothesis| hypothesis.forget_yaw(model));
            }
            (self.yaw_symmetry, self.yaw_age_s) = (seen.yaw_symmetry, 0.0);
        }
        self.unseen_s = 0.0;
        let (fit, taken) = self.best.update((seen, unread_rad2), camera, model);
        if self.rival.is_none() {
            self.adapt(&fit, model);
        }
        let evidence = match &mut self.rival {
            Some(rival) => fit.evidence_over(&rival.update((seen, unread_rad2), camera, model).0),
            // No rival stands: the best one is held against a normal that would just fit.
            None => fit.evidence_over_fitting(),
        };
        let fresh = evidence.clamp(-EVIDENCE_LIMIT, EVIDENCE_LIMIT);
        self.log_odds = (self.log_odds + EVIDENCE_WEIGHT * fresh).clamp(-ODDS_LIMIT, ODDS_LIMIT);
        if self.rival.is_none() && self.log_odds < RIVAL_ODDS {
            self.raise_rival(seen, 1 - taken, camera, model);
        }
        self.settle();
    }

    /// The estimate `dt` seconds from now, either way; both normals show in the covariance while both are
    /// possible.
    pub fn estimate(&self, dt: f64, model: &MotionModel) -> AttitudeEstimate {
        let density = self.density(dt, model);
        let (orientation, mut spread) = self.best.told(dt, &density, model);
        if let Some(rival) = &self.rival {
            let (other, told) = rival.told(dt, &density, model);
            let [normal, other] = [orientation, other].map(|turned| turned * Vector3::z());
            let weight =
                1.0 / (1.0 + faded(self.log_odds, dt, prior(&normal, &other, model)).exp());
            let apart = smallest_turn(&normal, &other);
            spread.value += (told.value - spread.value + apart * apart.transpose()) * weight;
            spread.rate += (told.rate - spread.rate) * weight;
            spread.cross += (told.cross - spread.cross) * weight;
        }
        let normal = orientation * Vector3::z();
        let is_known = self.yaw_age_s + dt < KNOWN_YAW_S
            && normal.dot(&(spread.value * normal)) < KNOWN_YAW_RAD * KNOWN_YAW_RAD;
        let mut estimate = AttitudeEstimate {
            orientation,
            yaw_symmetry: self.yaw_symmetry.filter(|_| is_known),
            angular_velocity_rad_s: self.best.kernel.rate,
            covariance: spread.matrix(),
            density_rad2_s3: density,
        };
        if estimate.yaw_symmetry.is_none() {
            estimate.orientation = orientation_of_normal(&normal);
            estimate.angular_velocity_rad_s -=
                normal * normal.dot(&estimate.angular_velocity_rad_s);
            spread = without_yaw(&spread, &normal);
            estimate.covariance = spread.matrix();
        }
        estimate
    }

    /// Of the estimate's covariance of the rotation, what the cameras' systematic errors have made.
    pub fn systematic(&self) -> Matrix3<f64> {
        let best = self.best.kernel.systematic();
        let Some(rival) = &self.rival else { return best };
        let weight = 1.0 / (1.0 + self.log_odds.exp());
        best + (rival.kernel.systematic() - best) * weight
    }

    /// Holds it upright.
    pub fn hold(&mut self, ground: &Ground) {
        for hypothesis in std::iter::once(&mut self.best).chain(self.rival.as_mut()) {
            let turn = smallest_turn(&hypothesis.normal(), &Vector3::z());
            let correction = ground.hold_upright(&mut hypothesis.kernel, &turn);
            hypothesis.orientation = turn_by(&correction) * hypothesis.orientation;
        }
    }

    /// Learns how strongly it is turned, from how a normal fits that nothing rivals.
    fn adapt(&mut self, fit: &Fit, model: &MotionModel) {
        if model.learns_turning {
            self.densities.learn_across(&fit.slope, &self.best.normal());
        } else {
            self.densities.learn(&fit.slope);
        }
        if self.alarm.is_raised_by(fit.surprise()) {
            self.densities = Densities::begin(&model.angular_density_rad2_s3, 0.0);
        }
    }

    /// What it is turned by until `dt` seconds from now; unseen, it may have begun to turn, and of two normals one
    /// is wrong, and moves as no object does.
    fn density(&self, dt: f64, model: &MotionModel) -> Vector3<f64> {
        let capability = &model.angular_density_rad2_s3;
        let density = if self.yaw_symmetry.is_none() {
            self.densities.expected()
        } else if model.learns_turning {
            self.densities.across(&self.best.normal(), capability)
        } else {
            *capability
        };
        if self.rival.is_some() || self.unseen_s + dt > UNSEEN_S {
            density.sup(capability)
        } else {
            density
        }
    }

    /// Log-odds of the best normal against the rival's before any evidence.
    fn prior(&self, model: &MotionModel) -> f64 {
        let of_rival = |rival: &Hypothesis| prior(&self.best.normal(), &rival.normal(), model);
        self.rival.as_ref().map_or(0.0, of_rival)
    }

    fn raise_rival(
        &mut self,
        seen: &AttitudeMeasurement,
        index: usize,
        camera: CameraId,
        model: &MotionModel,
    ) {
        let kernel = begin(seen, index, camera, model);
        let orientation = seen.nearest(index, &self.best.orientation);
        self.rival = Some(Hypothesis { orientation, kernel });
    }

    /// Puts the likelier hypothesis first and lets go of a rival that is beaten or the same.
    fn settle(&mut self) {
        let Some(rival) = self.rival else { return };
        if self.log_odds < 0.0 {
            self.rival = Some(self.best);
            self.best = rival;
            self.log_odds = -self.log_odds;
        }
        let apart = smallest_turn(&self.best.normal(), &rival.normal());
        let apart = if self.log_odds >= 0.0 { apart } else { -apart };
        let both = self.best.kernel.spread.value + rival.kernel.spread.value;
        let length_squared = apart.norm_squared();
        let variance =
            if length_squared > 0.0 { apart.dot(&(both * apart)) / length_squared } else { 0.0 };
        if length_squared <= variance || self.log_odds > SETTLED_ODDS {
            self.rival = None;
        }
    }
}

/// The covariance of a rotation and its rate when nothing is known about the rotation about
/// `normal`: the variance of an unknown angle there, and no correlation with the rest.
pub(crate) fn without_yaw(spread: &Spread, normal: &Vector3<f64>) -> Spread {
    let along = normal * normal.transpose();
    let across = Matrix3::identity() - along;
    let rate_variance = normal.dot(&(spread.rate * normal));
    Spread {
        value: across * spread.value * across + along * UNKNOWN_ANGLE_VARIANCE_RAD2,
        cross: across * spread.cross * across,
        rate: across * spread.rate * across + along * rate_variance,
    }
}

/// Log-odds of one normal against another before any evidence.
fn prior(best: &Vector3<f64>, other: &Vector3<f64>, model: &MotionModel) -> f64 {
    model.upright_log_odds * (best.z - other.z)
}

/// Log-odds `dt` seconds later, on their way to the prior.
fn faded(log_odds: f64, dt: f64, prior: f64) -> f64 {
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
        // Opposite: any axis across will do; this one is the same every time.
        let axis = if from.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
        from.cross(&axis).normalize() * std::f64::consts::PI
    }
}
