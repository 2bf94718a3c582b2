//! Where an object is and how it moves, with the process noise that suits what is seen of it.
//!
//! Two filters run side by side. The adapted one is disturbed as strongly as suits what is seen
//! ([`super::density`]); it is the estimate. The agile one always expects what objects are capable of. It
//! decides which measurements can be the object's, it stands in when the object is not seen (it may have
//! begun to move), and when it has foreseen the measurements so much better than the adapted one that a manoeuvre
//! must have begun (`alarm`), the other starts again from it.
//!
//! What moves is not disturbed by white noise, though: accelerations last. The q that foresees best is then one
//! whose lag and noise are in balance, and errors are other than a filter of white noise with that q believes.
//! For an acceleration a that stays, the filter's lag is a/ω² in position and √2a/ω in velocity, ω = (q/r)^¼
//! how quickly it follows. Least lag² + noise is at q = 3.7 a²/ω; then of the part M of the covariance that
//! process noise has made ([`Kernel::told_sharing`]) half is true in velocity, ¾ in position. So the filter goes on as
//! it does, but what is told has such shares of M: a half of the velocity's ([`RATE_SHARE`]), and more of the
//! position's ([`VALUE_SHARE`]), since accelerations last neither for ever nor equally long, which q follows late.
//! What is told of a later moment counts on the acceleration of now, and grows by how unsteady that is
//! ([`super::acceleration`]), not by q. `core/tests/fusion/consistency.rs` and `tests/src/scenario` show the result.

use nalgebra::{Matrix3, Vector3};

use super::{
    Correction, Ground, Innovation, Kernel, Measurement, MotionModel, Spread,
    acceleration::{Acceleration, Known, added_by, left_after},
    cusum::{Alarm, UNSEEN_S},
    process_noise::Densities,
};

/// Accelerations may be e to half of this times what objects are said to be capable of.
const LOG_CEILING: f64 = 2.8;
/// Shares of the process noise's part in the covariances of position and velocity that are told.
const VALUE_SHARE: f64 = 1.5;
const RATE_SHARE: f64 = 0.5;
/// Of what is not seen, whose acceleration nobody knows, the density over a horizon is that expected times this …
const GROWTH_SHARE: f64 = 0.6;
/// … and this for each unit of bandwidth times horizon.
const GROWTH_LASTING: f64 = 0.2;
/// Subscribers' horizons, seconds, for which the density is told.
const HORIZON_S: f64 = 0.05;

/// Position with velocity and covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Filter {
    /// Roundel's centre, world frame, metres.
    pub position_m: Vector3<f64>,
    /// Velocity and covariance.
    pub kernel: Kernel,
}

/// What is told about a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionEstimate {
    /// Roundel's centre, world frame, metres.
    pub position_m: Vector3<f64>,
    /// World frame, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// By which the velocity goes on to change for some tenths of a second ([`added_by`]), world frame, m/s².
    pub acceleration_m_s2: Vector3<f64>,
    /// Over (position, velocity).
    pub spread: Spread,
    /// Spectral density of the white acceleration that it grows by over the next hundredths of a second, m²/s³.
    pub density_m2_s3: Vector3<f64>,
}

/// The two filters of one object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    adapted: Filter,
    agile: Filter,
    /// Of the adapted one.
    acceleration: Acceleration,
    densities: Densities,
    alarm: Alarm,
    unseen_s: f64,
}

impl Filter {
    fn predict(&mut self, dt: f64, density: &Vector3<f64>, model: &MotionModel) {
        self.position_m += self.kernel.rate * dt;
        self.kernel.predict(dt, density, model.systematic_time_s);
    }

    /// Position and covariance `dt` seconds from now, and the density of the noise that it grows by from then on, if of
    /// the noise that it expects only this share is there; `growth` gives the density by the horizon.
    fn told(
        &self,
        dt: f64,
        share: &Vector3<f64>,
        growth: impl Fn(f64) -> Vector3<f64>,
    ) -> (Vector3<f64>, Spread, Vector3<f64>) {
        let of_value = share * VALUE_SHARE;
        let of_rate = share * RATE_SHARE;
        let mut spread = self.kernel.told_sharing(&of_value, &of_rate);
        spread.predict(dt, &growth(dt.abs()));
        let position_m = self.position_m + self.kernel.rate * dt;
        (position_m, spread, growth(dt.abs() + HORIZON_S))
    }

    fn update(&mut self, seen: &Measurement, model: &MotionModel) -> Correction {
        let correction = self.kernel.update(
            &(seen.position_m - self.position_m),
            &seen.position_noise,
            seen.camera,
            model.robust_distance_squared,
        );
        self.position_m += correction.value;
        correction
    }
}

impl Motion {
    /// What one measurement tells.
    pub fn begin(seen: &Measurement, model: &MotionModel) -> Self {
        let speed = model.speed_m_s.component_mul(&model.speed_m_s);
        let kernel = Kernel::begin(&seen.position_noise, seen.camera, &speed);
        let filter = Filter { position_m: seen.position_m, kernel };
        Self {
            adapted: filter,
            agile: filter,
            acceleration: Acceleration::begin(&model.acceleration_density_m2_s3),
            densities: Densities::begin(&model.acceleration_density_m2_s3, LOG_CEILING),
            alarm: Alarm::default(),
            unseen_s: 0.0,
        }
    }

    /// The filter that expects everything objects are capable of.
    pub fn agile(&self) -> &Filter {
        &self.agile
    }

    /// What told how strongly it is disturbed was wrong: everything objects are capable of is to be expected.
    pub fn doubt(&mut self, model: &MotionModel) {
        self.alarm.forget();
        self.adapted = self.agile;
        self.acceleration = Acceleration::begin(&model.acceleration_density_m2_s3);
        self.densities = Densities::begin(&model.acceleration_density_m2_s3, LOG_CEILING);
    }

    /// Moves on by `dt` seconds, either way.
    pub fn predict(&mut self, dt: f64, model: &MotionModel) {
        let density = self.densities.expected();
        self.adapted.predict(dt, &density, model);
        self.agile.predict(dt, &density.sup(&model.acceleration_density_m2_s3), model);
        self.acceleration.forget(dt);
        self.densities.forget(dt);
        self.unseen_s += dt;
    }

    /// Takes in a measurement at the present time; gives how the adapted filter had foreseen it.
    pub fn update(&mut self, seen: &Measurement, model: &MotionModel) -> Innovation {
        self.unseen_s = 0.0;
        let before_m_s = self.adapted.kernel.rate;
        let Correction { innovation, slope, .. } = self.adapted.update(seen, model);
        let kernel = &self.adapted.kernel;
        self.acceleration.learn(&(kernel.rate - before_m_s), || Known {
            velocity_m_s: kernel.rate,
            noise_m2_s2: kernel.rate_noise(),
            bandwidth_hz: kernel.bandwidth_hz(),
        });
        let agile = self.agile.update(seen, model).innovation;
        self.densities.learn(&slope);
        let most = agile.most_log_ratio(&innovation);
        if self.alarm.is_raised_at_most(most, || agile.log_ratio(&innovation)) {
            self.doubt(model);
        }
        innovation
    }

    /// Holds it to its floor.
    pub fn hold(&mut self, ground: &Ground) {
        for filter in [&mut self.adapted, &mut self.agile] {
            filter.position_m += ground.hold_height(&mut filter.kernel, filter.position_m.z);
        }
    }

    /// The estimate `dt` seconds from now, either way.
    pub fn estimate(&self, dt: f64, model: &MotionModel) -> MotionEstimate {
        if self.unseen_s + dt > UNSEEN_S {
            return self.unseen(dt, model);
        }
        let share = self.densities.share();
        let bandwidth_hz = self.adapted.kernel.bandwidth_hz();
        let growth = |ahead_s: f64| self.acceleration.growth_m2_s3(ahead_s, &bandwidth_hz);
        let (position_m, spread, density_m2_s3) = self.adapted.told(dt, &share, growth);
        let acceleration_m_s2 = self.acceleration.mean_m_s2();
        let (further_m, faster_m_s) = added_by(&acceleration_m_s2, dt);
        MotionEstimate {
            position_m: position_m + further_m,
            velocity_m_s: self.adapted.kernel.rate + faster_m_s,
            acceleration_m_s2: left_after(&acceleration_m_s2, dt),
            spread,
            density_m2_s3,
        }
    }

    /// That of what was not seen lately, and may have begun to move.
    fn unseen(&self, dt: f64, model: &MotionModel) -> MotionEstimate {
        let density = self.densities.expected().sup(&model.acceleration_density_m2_s3);
        let lasting = self.agile.kernel.bandwidth_hz() * GROWTH_LASTING;
        let growth =
            |ahead_s: f64| density.component_mul(&(lasting * ahead_s).add_scalar(GROWTH_SHARE));
        let (position_m, spread, density_m2_s3) =
            self.agile.told(dt, &Vector3::repeat(1.0), growth);
        let velocity_m_s = self.agile.kernel.rate;
        let acceleration_m_s2 = Vector3::zeros();
        MotionEstimate { position_m, velocity_m_s, acceleration_m_s2, spread, density_m2_s3 }
    }

    /// Of the estimate's covariance of position, what the cameras' systematic errors have made.
    pub fn systematic(&self) -> Matrix3<f64> {
        let filter = if self.unseen_s > UNSEEN_S { &self.agile } else { &self.adapted };
        filter.kernel.systematic()
    }
}

impl Innovation {
    /// No less than [`Self::log_ratio`], without a logarithm: ln x ≤ x - 1.
    fn most_log_ratio(&self, other: &Innovation) -> f64 {
        let determinants = other.determinant / self.determinant;
        let most = 0.5 * (other.distance_squared - self.distance_squared + determinants - 1.0);
        if most.is_finite() { most } else { f64::INFINITY }
    }

    /// ln of this one's likelihood over the other's. Infinite distances (no covariance) say nothing.
    fn log_ratio(&self, other: &Innovation) -> f64 {
        let ratio = 0.5
            * (other.distance_squared - self.distance_squared
                + (other.determinant / self.determinant).ln());
        if ratio.is_finite() { ratio } else { 0.0 }
    }
}
