//! Position and velocity of an object, with process noise that adapts to its motion.
//!
//! Two filters run side by side. The adapted filter uses the process noise learned from its innovations
//! ([`super::process_noise`]); it gives the estimate. The agile filter always uses the process noise of the configured
//! capability. It gates measurements, gives the estimate while the object is not observed, and restarts the adapted
//! filter when its likelihood shows a manoeuvre ([`super::cusum`]).
//!
//! Real accelerations are not white, they last. The q with the best predictions then balances lag against noise, and
//! the errors differ from those that a filter with white noise of that q states. For a constant acceleration a the lag
//! is a/ω² in position and √2a/ω in velocity, with the bandwidth ω = (q/r)^¼. The minimum of lag² + noise is at q = 3.7
//! a²/ω. There, of the covariance part M that process noise contributes ([`Kalman::reported_with_shares`]), half is
//! real in velocity and ¾ in position. Reported covariances therefore contain M times [`RATE_SHARE`] and
//! [`VALUE_SHARE`]. The latter exceeds ¾ because accelerations do not last forever and q follows their changes late.
//! Predictions use the present acceleration and grow with its variance ([`super::acceleration`]), not with q.
//! `core/tests/fusion/consistency.rs` and `tests/src/scenario` show the resulting consistency.

use nalgebra::{Matrix3, Vector3};

use super::{
    BlockCovariance, Correction, Ground, Innovation, Kalman, Measurement, MotionModel,
    acceleration::{Acceleration, VelocityEstimate, decay_acceleration, integrate_acceleration},
    cusum::{Cusum, UNOBSERVED_S},
    process_noise::Densities,
};

/// Learned accelerations are at most e^(LOG_CEILING / 2) times the configured capability.
const LOG_CEILING: f64 = 2.8;
/// Shares of the process noise's part in the reported covariances of position and velocity.
const VALUE_SHARE: f64 = 1.5;
const RATE_SHARE: f64 = 0.5;
/// Density over a prediction of an unobserved object: the expected density times this, …
const GROWTH_SHARE: f64 = 0.6;
/// … plus this times bandwidth · horizon.
const GROWTH_PER_PHASE: f64 = 0.2;
/// Typical prediction horizon of subscribers, seconds; the reported density applies to it.
const HORIZON_S: f64 = 0.05;

/// Position with its Kalman filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionFilter {
    /// Roundel's centre, world frame, metres.
    pub position_m: Vector3<f64>,
    /// Velocity and covariance.
    pub kalman: Kalman,
}

/// Estimate of position and velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionEstimate {
    /// Roundel's centre, world frame, metres.
    pub position_m: Vector3<f64>,
    /// World frame, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// Change of the velocity over the next tenths of a second, world frame, m/s². Decays as in
    /// `integrate_acceleration`.
    pub acceleration_m_s2: Vector3<f64>,
    /// Over (position, velocity).
    pub covariance: BlockCovariance,
    /// Spectral density of white acceleration by which the covariance grows over the next hundredths of a second,
    /// m²/s³.
    pub density_m2_s3: Vector3<f64>,
}

/// The adapted and the agile filter of one object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    adapted: PositionFilter,
    agile: PositionFilter,
    /// Mean acceleration by the adapted filter.
    acceleration: Acceleration,
    densities: Densities,
    manoeuvre: Cusum,
    unobserved_s: f64,
}

impl PositionFilter {
    fn predict(&mut self, dt: f64, density: &Vector3<f64>, model: &MotionModel) {
        self.position_m += self.kalman.rate * dt;
        self.kalman.predict(dt, density, model.systematic_time_s);
    }

    /// Position and covariance `dt` seconds from now, with `share` of the expected process noise counted as real.
    /// Also returns the density of the covariance's further growth; `growth` gives the density by horizon.
    fn report(
        &self,
        dt: f64,
        share: &Vector3<f64>,
        growth: impl Fn(f64) -> Vector3<f64>,
    ) -> (Vector3<f64>, BlockCovariance, Vector3<f64>) {
        let value_share = share * VALUE_SHARE;
        let rate_share = share * RATE_SHARE;
        let mut covariance = self.kalman.reported_with_shares(&value_share, &rate_share);
        covariance.predict(dt, &growth(dt.abs()));
        let position_m = self.position_m + self.kalman.rate * dt;
        (position_m, covariance, growth(dt.abs() + HORIZON_S))
    }

    fn update(&mut self, measurement: &Measurement, model: &MotionModel) -> Correction {
        let correction = self.kalman.update(
            &(measurement.position_m - self.position_m),
            &measurement.position_noise,
            measurement.camera,
            model.robust_distance_squared,
        );
        self.position_m += correction.value;
        correction
    }
}

impl Motion {
    /// State after a first measurement.
    pub fn begin(measurement: &Measurement, model: &MotionModel) -> Self {
        let speed = model.speed_m_s.component_mul(&model.speed_m_s);
        let kalman = Kalman::begin(&measurement.position_noise, measurement.camera, &speed);
        let filter = PositionFilter { position_m: measurement.position_m, kalman };
        Self {
            adapted: filter,
            agile: filter,
            acceleration: Acceleration::begin(&model.acceleration_density_m2_s3),
            densities: Densities::begin(&model.acceleration_density_m2_s3, LOG_CEILING),
            manoeuvre: Cusum::default(),
            unobserved_s: 0.0,
        }
    }

    /// The filter with the process noise of the configured capability.
    pub fn agile(&self) -> &PositionFilter {
        &self.agile
    }

    /// Restarts the adapted filter from the agile one and discards the learned process noise.
    pub fn reset_adaptation(&mut self, model: &MotionModel) {
        self.manoeuvre.reset();
        self.adapted = self.agile;
        self.acceleration = Acceleration::begin(&model.acceleration_density_m2_s3);
        self.densities = Densities::begin(&model.acceleration_density_m2_s3, LOG_CEILING);
    }

    /// Predicts by `dt` seconds, either sign.
    pub fn predict(&mut self, dt: f64, model: &MotionModel) {
        let density = self.densities.expected();
        self.adapted.predict(dt, &density, model);
        self.agile.predict(dt, &density.sup(&model.acceleration_density_m2_s3), model);
        self.acceleration.fade(dt);
        self.densities.fade(dt);
        self.unobserved_s += dt;
    }

    /// Adds a measurement at the present time; returns the adapted filter's innovation.
    pub fn update(&mut self, measurement: &Measurement, model: &MotionModel) -> Innovation {
        self.unobserved_s = 0.0;
        let previous_m_s = self.adapted.kalman.rate;
        let Correction { innovation, slope, .. } = self.adapted.update(measurement, model);
        let kalman = &self.adapted.kalman;
        self.acceleration.learn(&(kalman.rate - previous_m_s), || VelocityEstimate {
            velocity_m_s: kalman.rate,
            noise_m2_s2: kalman.rate_measurement_noise(),
            bandwidth_hz: kalman.bandwidth_hz(),
        });
        let agile = self.agile.update(measurement, model).innovation;
        self.densities.learn(&slope);
        if self.manoeuvre.is_raised_by(agile.log_ratio(&innovation)) {
            self.reset_adaptation(model);
        }
        innovation
    }

    /// Applies the height constraint.
    pub fn constrain_to_floor(&mut self, ground: &Ground) {
        for filter in [&mut self.adapted, &mut self.agile] {
            filter.position_m += ground.constrain_height(&mut filter.kalman, filter.position_m.z);
        }
    }

    /// Estimate `dt` seconds from now, either sign.
    pub fn estimate(&self, dt: f64, model: &MotionModel) -> MotionEstimate {
        if self.unobserved_s + dt > UNOBSERVED_S {
            return self.estimate_unobserved(dt, model);
        }
        let share = self.densities.share();
        let bandwidth_hz = self.adapted.kalman.bandwidth_hz();
        let growth = |ahead_s: f64| self.acceleration.growth_m2_s3(ahead_s, &bandwidth_hz);
        let (position_m, covariance, density_m2_s3) = self.adapted.report(dt, &share, growth);
        let acceleration_m_s2 = self.acceleration.mean_m_s2();
        let (moved_m, gained_m_s) = integrate_acceleration(&acceleration_m_s2, dt);
        MotionEstimate {
            position_m: position_m + moved_m,
            velocity_m_s: self.adapted.kalman.rate + gained_m_s,
            acceleration_m_s2: decay_acceleration(&acceleration_m_s2, dt),
            covariance,
            density_m2_s3,
        }
    }

    /// Estimate of an object that was not observed lately and may be manoeuvring.
    fn estimate_unobserved(&self, dt: f64, model: &MotionModel) -> MotionEstimate {
        let density = self.densities.expected().sup(&model.acceleration_density_m2_s3);
        let bandwidth_share = self.agile.kalman.bandwidth_hz() * GROWTH_PER_PHASE;
        let growth = |ahead_s: f64| {
            density.component_mul(&(bandwidth_share * ahead_s).add_scalar(GROWTH_SHARE))
        };
        let (position_m, covariance, density_m2_s3) =
            self.agile.report(dt, &Vector3::repeat(1.0), growth);
        let velocity_m_s = self.agile.kalman.rate;
        let acceleration_m_s2 = Vector3::zeros();
        MotionEstimate { position_m, velocity_m_s, acceleration_m_s2, covariance, density_m2_s3 }
    }

    /// Part of the position's covariance that stems from the cameras' systematic errors.
    pub fn systematic_covariance(&self) -> Matrix3<f64> {
        let filter = if self.unobserved_s > UNOBSERVED_S { &self.agile } else { &self.adapted };
        filter.kalman.systematic_covariance()
    }
}

impl Innovation {
    /// ln of the ratio of this likelihood to the other. 0 if a covariance was not positive definite.
    fn log_ratio(&self, other: &Innovation) -> f64 {
        let ratio = 0.5
            * (other.distance_squared - self.distance_squared
                + (other.determinant / self.determinant).ln());
        if ratio.is_finite() { ratio } else { 0.0 }
    }
}
