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
//! process noise has made ([`Kernel::told_sharing`]) half is true in velocity, ¾ in position; and over a
//! horizon dt the velocity's variance grows by (0.76 + 0.27 ω dt) q dt, the first from the lag, the second
//! from the acceleration. So the filter goes on as it does, but what is told has such shares of M and
//! grows so. Their values ([`VALUE_SHARE`] to [`GROWTH_LASTING`]) are those at which scenarios are consistent:
//! accelerations last neither for ever nor equally long, which q follows late, so that position takes more.
//! `core/tests/fusion/consistency.rs` and `tests/src/scenario` show the result: positions and velocities of
//! robots that drive at random or between places lie in 92 to 98.6 % of cases inside their 95 % ellipsoids.
//! Errors of the latter have long tails (they cruise mostly, and brake hard), so that one scale cannot suit all.

use nalgebra::{Matrix3, Vector3};

use super::{
    Correction, Ground, Innovation, Kernel, Measurement, MotionModel, Spread,
    alarm::{Alarm, UNSEEN_S},
    density::Densities,
};

/// Accelerations may be e to half of this times what objects are said to be capable of.
const LOG_CEILING: f64 = 2.8;
/// Shares of the process noise's part in the covariances of position and velocity that are told.
const VALUE_SHARE: f64 = 1.5;
const RATE_SHARE: f64 = 0.45;
/// Over a horizon the density is that expected times this …
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
    /// what it expects only this share is there.
    fn told(
        &self,
        dt: f64,
        (density, share): (&Vector3<f64>, &Vector3<f64>),
    ) -> (Vector3<f64>, Spread, Vector3<f64>) {
        let of_value = share * VALUE_SHARE;
        let of_rate = share * RATE_SHARE;
        let mut spread = self.kernel.told_sharing(&of_value, &of_rate);
        let present = density.component_mul(share);
        let bandwidth_hz = self.kernel.bandwidth_hz();
        let growth = |ahead_s: f64| {
            let lasting = bandwidth_hz * (GROWTH_LASTING * ahead_s);
            present.component_mul(&lasting.add_scalar(GROWTH_SHARE))
        };
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
        self.densities = Densities::begin(&model.acceleration_density_m2_s3, LOG_CEILING);
    }

    /// Moves on by `dt` seconds, either way.
    pub fn predict(&mut self, dt: f64, model: &MotionModel) {
        let density = self.densities.expected();
        self.adapted.predict(dt, &density, model);
        self.agile.predict(dt, &density.sup(&model.acceleration_density_m2_s3), model);
        self.densities.forget(dt);
        self.unseen_s += dt;
    }

    /// Takes in a measurement at the present time; gives how the adapted filter had foreseen it.
    pub fn update(&mut self, seen: &Measurement, model: &MotionModel) -> Innovation {
        self.unseen_s = 0.0;
        let Correction { innovation, slope, .. } = self.adapted.update(seen, model);
        let agile = self.agile.update(seen, model).innovation;
        self.densities.learn(&slope);
        if self.alarm.is_raised_by(agile.log_ratio(&innovation)) {
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
        let mut density = self.densities.expected();
        let mut share = self.densities.share();
        let mut filter = &self.adapted;
        if self.unseen_s + dt > UNSEEN_S {
            density = density.sup(&model.acceleration_density_m2_s3);
            share = Vector3::repeat(1.0);
            filter = &self.agile;
        }
        let (position_m, spread, density_m2_s3) = filter.told(dt, (&density, &share));
        let velocity_m_s = filter.kernel.rate;
        MotionEstimate { position_m, velocity_m_s, spread, density_m2_s3 }
    }

    /// Of the estimate's covariance of position, what the cameras' systematic errors have made.
    pub fn systematic(&self) -> Matrix3<f64> {
        let filter = if self.unseen_s > UNSEEN_S { &self.agile } else { &self.adapted };
        filter.kernel.systematic()
    }
}

impl Innovation {
    /// ln of this one's likelihood over the other's. Infinite distances (no covariance) say nothing.
    fn log_ratio(&self, other: &Innovation) -> f64 {
        let ratio = 0.5
            * (other.distance_squared - self.distance_squared
                + (other.determinant / self.determinant).ln());
        if ratio.is_finite() { ratio } else { 0.0 }
    }
}
