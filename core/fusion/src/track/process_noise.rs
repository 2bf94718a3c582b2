//! How strongly an object is disturbed: the density q of the process noise that suits what is seen of it.
//!
//! A robot that stands still deserves another q than one that dodges: with one q for both, the covariance of
//! one of them is wrong. q is learned by the slope of the measurements' log-likelihood over ln q. With an
//! innovation ν of covariance S, w = S⁻¹ν, Λ = S⁻¹, A the state's part of S, and dp = ∂p̂/∂ln q how much
//! further the predicted value would lie with a larger q, the slope of component i is
//!
//! sᵢ = wᵢ dpᵢ + ½ ∂Aᵢᵢ/∂ln q (wᵢ² - Λᵢᵢ)
//!
//! The first part asks whether the filter lags behind, the second whether it is surprised. In the steady state
//! of a filter whose rate is disturbed by white noise, A goes as q to the ¼, and the gains of value and rate
//! as q to the ¼ and the ½ (Kalata, *The tracking index*, 1984, for slow filters), so that
//!
//! dp ← dp + Kp (¼ν - dp), dv ← dv + Kv (½ν - dp), and dp ← dp + dv·dt over time
//!
//! ([`super::Kernel`]). That these are the steady state's costs speed of learning only: at the true q
//! innovations are white and as large as S says, so that E[sᵢ] = 0 whatever the factors (an unbiased
//! estimating equation: Godambe, 1960). With v the variance of ln q,
//!
//! v ← 1/(1/v + s²), ln q ← ln q + v s
//!
//! (one step of stochastic Newton, the curvature taken as the slope's square), and v grows with time, so that
//! what was learned long ago is forgotten. Level and upright motion have densities of their own, since
//! robots on a floor never leave it: the slopes' sum over x and y, and that of z. Of rotations what is learned
//! is that across the normal, Σ sᵢ (1 - nᵢ²); about it they have their capability.
//!
//! The square is the curvature at the true q. Where q is far too large the slope is steadily negative, and ln q falls
//! as ln t only, since the squares add up. Observed there is less: of a measurement without noise of its own, whose S
//! goes as q, the curvature is s² + ½s on average (½ at the true q, none far above it). That is taken for normals, which
//! mostly stay upright, and for how unsteady accelerations are ([`super::acceleration`]). Not for motion's own q: with it
//! velocities of a robot that sees its own place, whose error stays, are 79 % inside their 95 % instead of 84 %.
//!
//! Accuracy: of white noise ln q is found within -0.4 to 0.7, from 10⁻⁴ to 0.2 m²/s³ and with one to eight cameras
//! whose errors are fresh or stay by half (the test below). Known limit: of one camera alone what stays of
//! its error passes for slow motion, and q of 10⁻⁴ m²/s³ comes out three times too large.

use nalgebra::Vector3;

use super::kalman::decayed;

/// ln of the least that a filter expects, over the capability …
const LOG_FLOOR: f64 = -12.0;
/// … and of the least that there may be.
const LOG_LEAST: f64 = -20.0;
/// Variance of ln q when nothing was learned yet, and its growth per second.
const LOG_VARIANCE: f64 = 4.0;
const LOG_DRIFT_PER_S: f64 = 0.5;
/// Without measurements that contradict, it returns to the capability in about this time: what stands, seen
/// from far, is not believed to stand for ever.
const LOG_RETURN_S: f64 = 30.0;
/// A single measurement's say.
const SLOPE_LIMIT: f64 = 4.0;
/// As much of the slope belongs to the curvature that is observed.
const OBSERVED_BEND: f64 = 0.5;

/// What is known of ln q.
#[derive(Clone, Copy, Debug, PartialEq)]
struct LogDensity {
    /// q that objects are capable of.
    capability: f64,
    /// ln q less that of the capability, and its variance.
    mean: f64,
    variance: f64,
}

/// Densities along the world's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Densities {
    level: LogDensity,
    upright: LogDensity,
    ceiling: f64,
}

impl Densities {
    /// Those that objects are capable of; they never grow beyond e to the `ceiling` times that.
    pub(super) fn begin(capability: &Vector3<f64>, ceiling: f64) -> Self {
        let [level, upright] = [capability.x, capability.z].map(LogDensity::begin);
        Self { level, upright, ceiling }
    }

    /// Moves on by `dt` seconds, either way.
    pub(super) fn forget(&mut self, dt: f64) {
        let kept = decayed(dt.abs() / LOG_RETURN_S);
        self.level.forget(dt, kept);
        self.upright.forget(dt, kept);
    }

    /// Learns from a measurement's slope of the log-likelihood.
    pub(super) fn learn(&mut self, slope: &Vector3<f64>) {
        self.learn_bent(slope, 0.0);
    }

    /// The same with the curvature that is observed, quicker where too much is expected.
    pub(super) fn learn_observed(&mut self, slope: &Vector3<f64>) {
        self.learn_bent(slope, OBSERVED_BEND);
    }

    fn learn_bent(&mut self, slope: &Vector3<f64>, bend: f64) {
        self.level.learn((slope.x + slope.y, bend), self.ceiling);
        self.upright.learn((slope.z, bend), self.ceiling);
    }

    /// The same of a rotation, of which only what turns the normal counts.
    pub(super) fn learn_across(&mut self, slope: &Vector3<f64>, normal: &Vector3<f64>) {
        let along = slope.dot(&normal.component_mul(normal));
        self.level.learn((slope.sum() - along, OBSERVED_BEND), self.ceiling);
    }

    /// Along each axis what a rotation's filter should expect: across the normal what was learned, about it the
    /// capability.
    pub(super) fn across(&self, normal: &Vector3<f64>, capability: &Vector3<f64>) -> Vector3<f64> {
        let along = normal.component_mul(normal);
        let level = self.level.expected();
        let about = along.dot(capability);
        along.map(|along| level + (about - level) * along)
    }

    /// Along each axis, what a filter that can follow should expect.
    pub(super) fn expected(&self) -> Vector3<f64> {
        self.each(LogDensity::expected)
    }

    /// Along each axis, how much of that there is.
    pub(super) fn share(&self) -> Vector3<f64> {
        self.each(|log| (log.mean - LOG_FLOOR).min(0.0).exp())
    }

    fn each(&self, value: impl Fn(&LogDensity) -> f64) -> Vector3<f64> {
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

    /// Moves on by `dt` seconds, of which so much is left of what was learned.
    fn forget(&mut self, dt: f64, kept: f64) {
        let grown = self.variance + LOG_DRIFT_PER_S * dt.abs();
        self.variance = grown.min(LOG_VARIANCE);
        self.mean *= kept;
    }

    /// With a curvature of the slope's square and so much of the slope.
    fn learn(&mut self, (slope, bend): (f64, f64), ceiling: f64) {
        if !slope.is_finite() {
            return;
        }
        let slope = slope.clamp(-SLOPE_LIMIT, SLOPE_LIMIT);
        let precision = 1.0 / self.variance + slope * (slope + bend);
        self.variance = 1.0 / precision.max(1.0 / LOG_VARIANCE);
        self.mean = (self.mean + self.variance * slope).clamp(LOG_LEAST, ceiling);
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::track::{Kernel, Noise};
    use roundel_vision::id::CameraId;

    /// Numbers of a normal distribution, nearly: sums of twelve even ones.
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

    /// What is seen of something that white noise disturbs.
    struct Trial {
        cameras: u32,
        systematic_share: f64,
        density: f64,
    }

    const STEP_S: f64 = 1.0 / 240.0;
    const STEPS: u32 = 240 * 40;

    impl Trial {
        /// Each camera sees one axis three times worse than the others.
        fn noise(&self, camera: u32) -> Noise {
            let mut deviation = Vector3::repeat(0.003);
            deviation[camera as usize % 3] *= 3.0;
            let root = Matrix3::from_diagonal(&deviation);
            let systematic_root = root * self.systematic_share.sqrt();
            Noise { total: root * root, systematic_root, timing_s: 0.0 }
        }

        /// By how much ln q is off in the mean, and mean normalized squares of value and rate, by degrees of
        /// freedom, of what is told without any share.
        fn run(&self) -> (f64, [f64; 2]) {
            let mut random = Random(0x2545_F491_4F6C_DD1D);
            let capability = Vector3::repeat(0.225);
            let [mut place, mut speed, mut value] = [Vector3::zeros(); 3];
            let mut biases = vec![Vector3::zeros(); self.cameras as usize];
            let kept = (-STEP_S).exp();
            let root = (self.density * STEP_S).sqrt();
            let mut kernel = Kernel::begin(&self.noise(0), CameraId(0), &Vector3::repeat(9.0));
            let mut densities = Densities::begin(&capability, 2.8);
            let (mut off, mut squares) = (0.0, [0.0; 2]);
            for step in 0..STEPS {
                let (push, jolt) = (random.gaussian(), random.gaussian() / 12f64.sqrt());
                place += speed * STEP_S + (push * 0.5 + jolt) * (root * STEP_S);
                speed += push * root;
                for bias in &mut biases {
                    *bias = *bias * kept + random.gaussian() * (1.0 - kept * kept).sqrt();
                }
                value += kernel.rate * STEP_S;
                kernel.predict(STEP_S, &densities.expected(), 1.0);
                densities.forget(STEP_S);
                let camera = step % self.cameras;
                let noise = self.noise(camera);
                let stays = noise.systematic_root * biases[camera as usize];
                let fresh = (noise.total * (1.0 - self.systematic_share)).map(f64::sqrt);
                let seen = place + stays + fresh * random.gaussian();
                let correction = kernel.update(&(seen - value), &noise, CameraId(camera), 16.3);
                value += correction.value;
                densities.learn(&correction.slope);
                if step >= STEPS / 4 {
                    off += densities.expected().map(f64::ln).mean() - self.density.ln();
                    let told = kernel.told();
                    let errors = [(value - place, told.value), (kernel.rate - speed, told.rate)];
                    for (square, (error, covariance)) in squares.iter_mut().zip(errors) {
                        *square += error.dot(&(covariance.try_inverse().unwrap() * error)) / 3.0;
                    }
                }
            }
            let count = f64::from(STEPS - STEPS / 4);
            (off / count, squares.map(|square| square / count))
        }
    }

    #[test]
    fn the_density_of_white_noise_is_learned_and_errors_are_as_told() {
        for (cameras, systematic_share) in [(1, 0.0), (4, 0.0), (4, 0.5), (8, 0.5)] {
            for density in [1e-4, 1e-2, 0.2] {
                let trial = Trial { cameras, systematic_share, density };
                let (off, squares) = trial.run();
                println!("{cameras} {systematic_share} {density}: {off:.2} {squares:.2?}");
                // Of one camera alone what stays of its error passes for slow motion, and what is calm is
                // believed to be a little less so.
                assert!(
                    (-0.4..1.2).contains(&off),
                    "{cameras} {systematic_share} {density}: {off}"
                );
                assert!(
                    squares.iter().all(|square| (0.7..1.2).contains(square)),
                    "{cameras} {systematic_share} {density}: {squares:?}"
                );
            }
        }
    }
}
