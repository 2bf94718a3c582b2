//! Adaptive process noise: learns the spectral density q of an object's accelerations from its innovations.
//!
//! A robot at rest and a robot that dodges need different q: one q for both makes the covariance of one of them wrong.
//! q is learned from the slope of the measurements' log-likelihood over ln q. With an innovation ν of covariance S, w =
//! S⁻¹ν, Λ = S⁻¹, A the state's part of S, and dp = ∂p̂/∂ln q the sensitivity of the predicted value, the slope of
//! component i is
//!
//! sᵢ = wᵢ dpᵢ + ½ ∂Aᵢᵢ/∂ln q (wᵢ² - Λᵢᵢ)
//!
//! The first term measures lag, the second the size of the innovations. In the steady state of a filter whose rate is
//! driven by white noise, A is proportional to q^¼, and the gains of value and rate to q^¼ and q^½ (Kalata, *The
//! tracking index*, 1984, for slow filters), so that
//!
//! dp ← dp + Kp (¼ν - dp), dv ← dv + Kv (½ν - dp), and dp ← dp + dv·dt over time
//!
//! ([`super::Kalman`]). Using the steady state's exponents throughout only slows learning: at the true q innovations
//! are white with covariance S, so E[sᵢ] = 0 whatever the factors (an unbiased estimating equation: Godambe, 1960).
//! With v the variance of ln q,
//!
//! v ← 1/(1/v + s²), ln q ← ln q + v s
//!
//! (one step of stochastic Newton with the squared slope as curvature). v grows with time, so old evidence fades.
//! Horizontal and vertical motion have densities of their own, since robots on a floor never leave it: one uses the sum
//! of the slopes over x and y, the other that over z. For rotations only the density across the normal is learned, from
//! Σ sᵢ (1 - nᵢ²); about the normal the configured density applies.
//!
//! The squared slope is the curvature at the true q. Where q is far too large, the slope is constantly negative and ln
//! q falls only as ln t, since the squares add up. The observed curvature is smaller there: for a measurement without
//! noise, whose S is proportional to q, it is s² + ½s on average (½ at the true q, zero far above it). This form is
//! used for normals, which mostly stay upright, and for the variance of accelerations ([`super::acceleration`]). It is
//! not used for the q of motion: there it lowers the share of velocities inside their 95 % from 84 % to 79 % for a
//! robot that localizes itself with a persistent error.
//!
//! Accuracy: for white noise, ln q is found within -0.4 to 0.7, from 10⁻⁴ to 0.2 m²/s³ and with one to eight cameras
//! whose errors are fresh or half systematic (the test below). Known limit: with one camera, its systematic error looks
//! like slow motion, and a q of 10⁻⁴ m²/s³ is estimated three times too large.

use nalgebra::Vector3;

use super::kalman::decayed;

/// ln of the smallest ratio of the expected density to the configured one.
const LOG_FLOOR: f64 = -12.0;
/// ln of the smallest ratio that is learned.
const LOG_MIN: f64 = -20.0;
/// Initial and largest variance of ln q, and its growth per second.
const LOG_VARIANCE: f64 = 4.0;
const LOG_DRIFT_PER_S: f64 = 0.5;
/// Time constant with which ln q returns to the configured density, so that a distant object at rest is not
/// assumed to rest forever.
const LOG_DECAY_S: f64 = 30.0;
/// Limit of a single measurement's slope.
const MAX_SLOPE: f64 = 4.0;
/// Coefficient of the slope in the observed curvature.
const SLOPE_CURVATURE: f64 = 0.5;

/// Estimate of ln q.
#[derive(Clone, Copy, Debug, PartialEq)]
struct LogDensity {
    /// Configured density.
    capability: f64,
    /// ln of the ratio of q to the configured density, and its variance.
    mean: f64,
    variance: f64,
}

/// Densities along the axes of the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Densities {
    level: LogDensity,
    upright: LogDensity,
    ceiling: f64,
}

impl Densities {
    /// Starts at the configured densities; learned ones are at most e^`ceiling` times those.
    pub(super) fn begin(capability: &Vector3<f64>, ceiling: f64) -> Self {
        let [level, upright] = [capability.x, capability.z].map(LogDensity::begin);
        Self { level, upright, ceiling }
    }

    /// Advances by `dt` seconds, either sign.
    pub(super) fn fade(&mut self, dt: f64) {
        let kept = decayed(dt.abs() / LOG_DECAY_S);
        self.level.fade(dt, kept);
        self.upright.fade(dt, kept);
    }

    /// Learns from the slope of a measurement's log-likelihood.
    pub(super) fn learn(&mut self, slope: &Vector3<f64>) {
        self.learn_with(slope, 0.0);
    }

    /// The same with the observed curvature, which falls faster from a density that is too large.
    pub(super) fn learn_observed(&mut self, slope: &Vector3<f64>) {
        self.learn_with(slope, SLOPE_CURVATURE);
    }

    fn learn_with(&mut self, slope: &Vector3<f64>, curvature: f64) {
        self.level.learn(slope.x + slope.y, curvature, self.ceiling);
        self.upright.learn(slope.z, curvature, self.ceiling);
    }

    /// The same for a rotation; only components that tilt the normal count.
    pub(super) fn learn_tilt(&mut self, slope: &Vector3<f64>, normal: &Vector3<f64>) {
        let along = slope.dot(&normal.component_mul(normal));
        self.level.learn(slope.sum() - along, SLOPE_CURVATURE, self.ceiling);
    }

    /// Density of a rotation's process noise along each axis: the learned one across the normal, the configured
    /// one about it.
    pub(super) fn expected_for_rotation(
        &self,
        normal: &Vector3<f64>,
        capability: &Vector3<f64>,
    ) -> Vector3<f64> {
        let along = normal.component_mul(normal);
        let level = self.level.expected();
        let about = along.dot(capability);
        along.map(|along| level + (about - level) * along)
    }

    /// Density along each axis that the filter uses.
    pub(super) fn expected(&self) -> Vector3<f64> {
        self.per_axis(LogDensity::expected)
    }

    /// Ratio of the learned density to [`Self::expected`] along each axis; below 1 only where the floor applies.
    pub(super) fn share(&self) -> Vector3<f64> {
        self.per_axis(|log| (log.mean - LOG_FLOOR).min(0.0).exp())
    }

    fn per_axis(&self, value: impl Fn(&LogDensity) -> f64) -> Vector3<f64> {
        let [level, upright] = [&self.level, &self.upright].map(value);
        Vector3::new(level, level, upright)
    }
}

impl LogDensity {
    fn begin(capability: f64) -> Self {
        Self { capability, mean: 0.0, variance: LOG_VARIANCE }
    }

    fn expected(&self) -> f64 {
        self.capability * self.mean.max(LOG_FLOOR).exp()
    }

    /// Advances by `dt` seconds, with the share `kept` of what was learned.
    fn fade(&mut self, dt: f64, kept: f64) {
        let grown = self.variance + LOG_DRIFT_PER_S * dt.abs();
        self.variance = grown.min(LOG_VARIANCE);
        self.mean *= kept;
    }

    /// Newton step with the curvature slope² + `curvature` · slope.
    fn learn(&mut self, slope: f64, curvature: f64, ceiling: f64) {
        if !slope.is_finite() {
            return;
        }
        let slope = slope.clamp(-MAX_SLOPE, MAX_SLOPE);
        let precision = 1.0 / self.variance + slope * (slope + curvature);
        self.variance = 1.0 / precision.max(1.0 / LOG_VARIANCE);
        self.mean = (self.mean + self.variance * slope).clamp(LOG_MIN, ceiling);
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::track::{Kalman, Noise};
    use roundel_vision::id::CameraId;

    /// Approximately normal numbers: sums of twelve uniform ones.
    struct Random(u64);

    impl Random {
        fn even(&mut self) -> f64 {
            self.0 ^= self.0 << 13;
            self.0 ^= self.0 >> 7;
            self.0 ^= self.0 << 17;
            (self.0 >> 11) as f64 / (1u64 << 53) as f64
        }

        fn gaussian(&mut self) -> Vector3<f64> {
            Vector3::from_fn(|_, _| (0..12).map(|_| self.even()).sum::<f64>() - 6.0)
        }
    }

    /// Measurements of an object driven by white noise.
    struct Trial {
        cameras: u32,
        systematic_share: f64,
        density: f64,
    }

    const STEP_S: f64 = 1.0 / 240.0;
    const STEPS: u32 = 240 * 40;

    impl Trial {
        /// Each camera measures one axis with three times the deviation.
        fn noise(&self, camera: u32) -> Noise {
            let mut deviation = Vector3::repeat(0.003);
            deviation[camera as usize % 3] *= 3.0;
            let root = Matrix3::from_diagonal(&deviation);
            let systematic_root = root * self.systematic_share.sqrt();
            Noise { total: root * root, systematic_root, timing_s: 0.0 }
        }

        /// Mean error of ln q, and mean normalized squared errors of value and rate by degrees of freedom for the
        /// covariance without share.
        fn run(&self) -> (f64, [f64; 2]) {
            let mut random = Random(0x2545_F491_4F6C_DD1D);
            let capability = Vector3::repeat(0.225);
            let [mut place, mut speed, mut value] = [Vector3::zeros(); 3];
            let mut biases = vec![Vector3::zeros(); self.cameras as usize];
            let kept = (-STEP_S).exp();
            let root = (self.density * STEP_S).sqrt();
            let mut kalman = Kalman::begin(&self.noise(0), CameraId(0), &Vector3::repeat(9.0));
            let mut densities = Densities::begin(&capability, 2.8);
            let (mut log_error, mut squares) = (0.0, [0.0; 2]);
            for step in 0..STEPS {
                let (push, jolt) = (random.gaussian(), random.gaussian() / 12f64.sqrt());
                place += speed * STEP_S + (push * 0.5 + jolt) * (root * STEP_S);
                speed += push * root;
                for bias in &mut biases {
                    *bias = *bias * kept + random.gaussian() * (1.0 - kept * kept).sqrt();
                }
                value += kalman.rate * STEP_S;
                kalman.predict(STEP_S, &densities.expected(), 1.0);
                densities.fade(STEP_S);
                let camera = step % self.cameras;
                let noise = self.noise(camera);
                let systematic = noise.systematic_root * biases[camera as usize];
                let fresh = (noise.total * (1.0 - self.systematic_share)).map(f64::sqrt);
                let measured = place + systematic + fresh * random.gaussian();
                let correction = kalman.update(&(measured - value), &noise, CameraId(camera), 16.3);
                value += correction.value;
                densities.learn(&correction.slope);
                if step >= STEPS / 4 {
                    log_error += densities.expected().map(f64::ln).mean() - self.density.ln();
                    let reported = kalman.reported();
                    let errors =
                        [(value - place, reported.value), (kalman.rate - speed, reported.rate)];
                    for (square, (error, covariance)) in squares.iter_mut().zip(errors) {
                        *square += error.dot(&(covariance.try_inverse().unwrap() * error)) / 3.0;
                    }
                }
            }
            let count = f64::from(STEPS - STEPS / 4);
            (log_error / count, squares.map(|square| square / count))
        }
    }

    #[test]
    fn the_density_of_white_noise_is_learned_and_errors_match() {
        for (cameras, systematic_share) in [(1, 0.0), (4, 0.0), (4, 0.5), (8, 0.5)] {
            for density in [1e-4, 1e-2, 0.2] {
                let trial = Trial { cameras, systematic_share, density };
                let (log_error, squares) = trial.run();
                println!("{cameras} {systematic_share} {density}: {log_error:.2} {squares:.2?}");
                // With one camera, systematic error looks like slow motion, so a low q is overestimated.
                assert!(
                    (-0.4..1.2).contains(&log_error),
                    "{cameras} {systematic_share} {density}: {log_error}"
                );
                assert!(
                    squares.iter().all(|square| (0.7..1.2).contains(square)),
                    "{cameras} {systematic_share} {density}: {squares:?}"
                );
            }
        }
    }
}
