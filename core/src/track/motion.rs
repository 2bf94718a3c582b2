//! Where an object is and how it moves, with the process noise that suits what is seen of it.
//!
//! A robot that stands still deserves another density q of the white acceleration than one that
//! dodges: with one q for both, the covariance of one of them is wrong. So three filters run side by
//! side. Two of them, calm and lively, use q/2 and 2q; which one foresees the measurements better
//! says where q should go. With s = (ln p_lively - ln p_calm)/ln 4, the slope of the log-likelihood
//! over ln q, and v the variance of ln q,
//!
//! v ← 1/(1/v + s²), ln q ← ln q + v s
//!
//! (one step of stochastic Newton, the curvature taken as the slope's square), and v grows with
//! time, so that what was learned long ago is forgotten. The estimate is the mean of the two, with
//! the moments of their mixture.
//!
//! Level and upright motion have densities of their own, since robots on a floor never leave it: the
//! slopes are those of the likelihoods of each component given the others (Besag's
//! pseudo-likelihood, 1975), summed over x and y, and for z.
//!
//! The third filter, agile, always expects what objects are capable of. It decides which
//! measurements can be the object's, it stands in when the object is not seen (it may have begun to
//! move), and when it has foreseen the measurements better than the lively one by
//! [`ALARM_LOG_RATIO`] (Page's cumulative sum, *Continuous inspection schemes*, 1954), a manoeuvre
//! has begun: the others start again from it.

use nalgebra::{Matrix3, Vector3};

use super::{Ground, Innovation, Kernel, Measurement, MotionModel, Spread};

/// The lively filter's density over the calm one's is e to this.
const LOG_RATIO: f64 = 1.386_294_361_119_890_6;
/// The density stays within these factors of the capability's, as logarithms.
const LOG_FLOOR: f64 = -12.0;
const LOG_CEILING: f64 = 2.8;
/// Weight of the lively filter in the estimate. The velocity's variance goes as q to the 3/4, so
/// 0.38 would give the mean of both variances that of q; less, since the distance between the two
/// adds to it. `core/tests/fusion/consistency.rs` holds the result.
const LIVELY_SHARE: f64 = 0.3;
/// Variance of ln q when nothing was learned yet, and its growth per second.
const LOG_VARIANCE: f64 = 4.0;
const LOG_DRIFT_PER_S: f64 = 0.1;
/// A single measurement's say on the log-likelihood's difference.
const LOG_LIMIT: f64 = 6.0;
/// Evidence for a manoeuvre, e⁸ to one.
const ALARM_LOG_RATIO: f64 = 8.0;
/// Unseen for so long, the agile filter stands in.
const UNSEEN_S: f64 = 0.15;

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
    /// Spectral density of the white acceleration that it grows by, m²/s³.
    pub density_m2_s3: Vector3<f64>,
}

/// What is known of ln q.
#[derive(Clone, Copy, Debug, PartialEq)]
struct LogDensity {
    mean: f64,
    variance: f64,
}

/// The three filters of one object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    calm: Filter,
    lively: Filter,
    agile: Filter,
    level: LogDensity,
    upright: LogDensity,
    alarm: f64,
    unseen_s: f64,
}

impl Filter {
    fn predict(&mut self, dt: f64, density: &Vector3<f64>, model: &MotionModel) {
        self.position_m += self.kernel.rate * dt;
        self.kernel.predict(dt, density, model.systematic_time_s);
    }

    /// Position and covariance `dt` seconds from now.
    fn told(&self, dt: f64, density: &Vector3<f64>) -> (Vector3<f64>, Spread) {
        let mut spread = self.kernel.told();
        spread.predict(dt, density);
        (self.position_m + self.kernel.rate * dt, spread)
    }

    fn update(&mut self, seen: &Measurement, model: &MotionModel) -> Innovation {
        let (correction_m, innovation) = self.kernel.update(
            &(seen.position_m - self.position_m),
            &seen.position_noise,
            seen.camera,
            model.robust_distance_squared,
        );
        self.position_m += correction_m;
        innovation
    }
}

impl Motion {
    /// What one measurement tells.
    pub fn begin(seen: &Measurement, model: &MotionModel) -> Self {
        let speed = model.speed_m_s.component_mul(&model.speed_m_s);
        let kernel = Kernel::begin(&seen.position_noise, seen.camera, &speed);
        let filter = Filter { position_m: seen.position_m, kernel };
        Self {
            calm: filter,
            lively: filter,
            agile: filter,
            level: LogDensity::begin(model.acceleration_density_m2_s3.x),
            upright: LogDensity::begin(model.acceleration_density_m2_s3.z),
            alarm: 0.0,
            unseen_s: 0.0,
        }
    }

    /// The filter that expects everything objects are capable of.
    pub fn agile(&self) -> &Filter {
        &self.agile
    }

    /// Moves on by `dt` seconds, either way.
    pub fn predict(&mut self, dt: f64, model: &MotionModel) {
        let lively = self.density(0.5 * LOG_RATIO);
        self.calm.predict(dt, &(lively * (-LOG_RATIO).exp()), model);
        self.lively.predict(dt, &lively, model);
        self.agile.predict(dt, &lively.sup(&model.acceleration_density_m2_s3), model);
        self.level.forget(dt);
        self.upright.forget(dt);
        self.unseen_s += dt;
    }

    /// Takes in a measurement at the present time; gives how the lively filter had foreseen it.
    pub fn update(&mut self, seen: &Measurement, model: &MotionModel) -> Innovation {
        self.unseen_s = 0.0;
        let calm = self.calm.update(seen, model);
        let lively = self.lively.update(seen, model);
        let agile = self.agile.update(seen, model);
        let squared = calm.conditional_squared - lively.conditional_squared;
        let precision = lively.conditional_precision.component_div(&calm.conditional_precision);
        let level = 0.5 * (squared.x + squared.y + (precision.x * precision.y).ln());
        self.level.learn(level, model.acceleration_density_m2_s3.x);
        let upright = 0.5 * (squared.z + precision.z.ln());
        self.upright.learn(upright, model.acceleration_density_m2_s3.z);
        self.alarm = (self.alarm + agile.log_ratio(&lively).min(LOG_LIMIT)).max(0.0);
        if self.alarm > ALARM_LOG_RATIO {
            self.alarm = 0.0;
            self.calm = self.agile;
            self.lively = self.agile;
            self.level = LogDensity::begin(model.acceleration_density_m2_s3.x);
            self.upright = LogDensity::begin(model.acceleration_density_m2_s3.z);
        }
        lively
    }

    /// Holds it to its floor.
    pub fn hold(&mut self, ground: &Ground) {
        for filter in [&mut self.calm, &mut self.lively, &mut self.agile] {
            filter.position_m += ground.hold_height(&mut filter.kernel, filter.position_m.z);
        }
    }

    /// The estimate `dt` seconds from now, either way.
    pub fn estimate(&self, dt: f64, model: &MotionModel) -> MotionEstimate {
        let spread_density = self.density(0.5 * LOG_RATIO);
        if self.unseen_s + dt > UNSEEN_S {
            let most = model.acceleration_density_m2_s3;
            let (position_m, spread) = self.agile.told(dt, &spread_density.sup(&most));
            return MotionEstimate {
                position_m,
                velocity_m_s: self.agile.kernel.rate,
                spread,
                density_m2_s3: self.density(0.0).sup(&most),
            };
        }
        let (calm, lively) = (&self.calm, &self.lively);
        let mixed = |calm: Vector3<f64>, lively: Vector3<f64>| calm.lerp(&lively, LIVELY_SHARE);
        let (calm_m, a) = calm.told(dt, &(spread_density * (-LOG_RATIO).exp()));
        let (lively_m, b) = lively.told(dt, &spread_density);
        let apart_m = lively_m - calm_m;
        let rate_apart = lively.kernel.rate - calm.kernel.rate;
        let between = LIVELY_SHARE * (1.0 - LIVELY_SHARE);
        MotionEstimate {
            position_m: mixed(calm_m, lively_m),
            velocity_m_s: mixed(calm.kernel.rate, lively.kernel.rate),
            spread: Spread {
                value: blended(&a.value, &b.value) + apart_m * apart_m.transpose() * between,
                cross: blended(&a.cross, &b.cross) + apart_m * rate_apart.transpose() * between,
                rate: blended(&a.rate, &b.rate) + rate_apart * rate_apart.transpose() * between,
            },
            density_m2_s3: self.density(0.0),
        }
    }

    /// Of the estimate's covariance of position, what the cameras' systematic errors have made.
    pub fn systematic(&self) -> Matrix3<f64> {
        if self.unseen_s > UNSEEN_S {
            return self.agile.kernel.systematic();
        }
        blended(&self.calm.kernel.systematic(), &self.lively.kernel.systematic())
    }

    /// Along each axis, e to `log_factor` above the present means.
    fn density(&self, log_factor: f64) -> Vector3<f64> {
        let level = (self.level.mean + log_factor).exp();
        Vector3::new(level, level, (self.upright.mean + log_factor).exp())
    }
}

fn blended(calm: &Matrix3<f64>, lively: &Matrix3<f64>) -> Matrix3<f64> {
    calm + (lively - calm) * LIVELY_SHARE
}

impl LogDensity {
    /// That of the capability.
    fn begin(capability: f64) -> Self {
        Self { mean: capability.ln(), variance: LOG_VARIANCE }
    }

    fn forget(&mut self, dt: f64) {
        self.variance = (self.variance + LOG_DRIFT_PER_S * dt.abs()).min(LOG_VARIANCE);
    }

    /// Learns from the lively filter's ln likelihood less the calm one's.
    fn learn(&mut self, log_ratio: f64, capability: f64) {
        if !log_ratio.is_finite() {
            return;
        }
        let slope = log_ratio.clamp(-LOG_LIMIT, LOG_LIMIT) / LOG_RATIO;
        self.variance = 1.0 / (1.0 / self.variance + slope * slope);
        let capability = capability.ln();
        self.mean = (self.mean + self.variance * slope)
            .clamp(capability + LOG_FLOOR, capability + LOG_CEILING);
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
