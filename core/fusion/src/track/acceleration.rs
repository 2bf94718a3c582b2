//! Present acceleration of an object, for predictions beyond the newest measurement.
//!
//! A constant-velocity filter follows an acceleration a through its corrections: in the steady state they add a dt to
//! the velocity in every dt. With Δv the velocity correction by one measurement,
//!
//! â ← (â + Δv / T) / (1 + dt/T)
//!
//! is the mean over the last T. The velocity's own error has a correlation time of about 1/ω (ω: bandwidth of the
//! filter), so T is [`MEMORY_PHASE`]/ω, at least [`MIN_MEMORY_S`], within which accelerations hardly change.
//!
//! The filters do not use â (they would follow their own errors). Snapshots do: they lie some hundredths of a second
//! ahead of the newest measurement, where a dt is the largest error of velocity. Predictions assume that the
//! acceleration decays as â e^(-t/L), which adds
//!
//! Δv = â L (1 - e^(-t/L)), Δp = â L (t - L (1 - e^(-t/L))), L = [`DECAY_S`].
//!
//! The variance A of accelerations about â is learned from past predictions. A prediction made τ ago
//! ([`PREDICTION_AGE_S`]) differs from the filter's present velocity by d, of variance
//!
//! A τ² + 2 N (1 - r), r = e^(-x) (cos x - sin x), x = ωτ/√2,
//!
//! with N the part of the velocity's variance that measurement noise contributes, and r its autocorrelation: that of
//! white noise through the steady filter, s ω² / (s² + √2 ω s + ω²). ln A follows the slope of d's log-likelihood, as
//! densities do ([`super::process_noise`], with the observed curvature: d is evaluated only some twenty times a second,
//! and a start far above the true value would take seconds to fall). The mean of d² less noise grows as τ² from 0.03 to
//! 0.13 s, for robots on sines and for robots with random accelerations. Noise in â counts as A.
//!
//! The velocity's lag is the effect of accelerations within the last √2/ω. Lag and prediction err in the same
//! direction, so over t the variance of the velocity grows by A t (t + √2/ω).
//!
//! Effect on R4's robots under four cameras (`-- scenarios r4`): rms error of velocity 32 → 18 mm/s, of position
//! 1.18 → 1.07 mm.

use std::f64::consts::{FRAC_1_SQRT_2, SQRT_2};

use nalgebra::Vector3;

use super::process_noise::Densities;

/// T times ω.
const MEMORY_PHASE: f64 = 2.0;
/// Smallest T, seconds.
const MIN_MEMORY_S: f64 = 0.1;
/// Smallest bandwidth used, 1/s; slower filters hardly follow.
const MIN_BANDWIDTH_HZ: f64 = 1.0;
/// Time constant with which accelerations decay, seconds.
const DECAY_S: f64 = 0.4;
/// Age at which a prediction is compared with the present velocity, seconds.
const PREDICTION_AGE_S: f64 = 0.05;
/// Predictions older than this are discarded: the object was not observed in between.
const MAX_PREDICTION_AGE_S: f64 = 0.15;
/// Initial A, (m/s²)², over the configured density of accelerations.
const CAPABILITY_RATE_HZ: f64 = 10.0;
/// ln of the largest ratio of A to its initial value.
const LOG_CEILING: f64 = 2.8;

/// Mean acceleration and the variance of accelerations about it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Acceleration {
    /// â.
    mean_m_s2: Vector3<f64>,
    /// T, along each axis.
    memory_s: Vector3<f64>,
    /// Share of â kept by the last time step; also the weight of the next correction.
    kept: Vector3<f64>,
    /// A, along each axis, (m/s²)².
    variance: Densities,
    prediction: Prediction,
}

/// Filter output at an earlier time.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Prediction {
    velocity_m_s: Vector3<f64>,
    acceleration_m_s2: Vector3<f64>,
    /// Infinite before the first prediction.
    age_s: f64,
}

/// The filter's velocity after a measurement.
pub(super) struct VelocityEstimate {
    /// m/s.
    pub(super) velocity_m_s: Vector3<f64>,
    /// N, along each axis.
    pub(super) noise_m2_s2: Vector3<f64>,
    /// ω, along each axis.
    pub(super) bandwidth_hz: Vector3<f64>,
}

impl Acceleration {
    /// No acceleration, with the variance of the configured density.
    pub(super) fn begin(capability_m2_s3: &Vector3<f64>) -> Self {
        let none = Vector3::zeros();
        Self {
            mean_m_s2: none,
            memory_s: Vector3::repeat(MIN_MEMORY_S),
            kept: Vector3::repeat(1.0),
            variance: Densities::begin(&(capability_m2_s3 * CAPABILITY_RATE_HZ), LOG_CEILING),
            prediction: Prediction {
                velocity_m_s: none,
                acceleration_m_s2: none,
                age_s: f64::INFINITY,
            },
        }
    }

    /// Advances by `dt` seconds, either sign.
    pub(super) fn fade(&mut self, dt: f64) {
        let span_s = dt.abs();
        self.kept = self.memory_s.map(|memory_s| memory_s / (memory_s + span_s));
        self.mean_m_s2.component_mul_assign(&self.kept);
        self.prediction.age_s += span_s;
    }

    /// Adds a measurement's correction of the velocity. Calls `current` only when a prediction is due for
    /// comparison.
    pub(super) fn learn(
        &mut self,
        change_m_s: &Vector3<f64>,
        current: impl FnOnce() -> VelocityEstimate,
    ) {
        self.mean_m_s2 += change_m_s.component_div(&self.memory_s).component_mul(&self.kept);
        if self.prediction.age_s < PREDICTION_AGE_S {
            return;
        }
        let current = current();
        if self.prediction.age_s < MAX_PREDICTION_AGE_S {
            self.learn_variance(&current);
        }
        let slowest_s = MEMORY_PHASE / MIN_BANDWIDTH_HZ;
        self.memory_s =
            current.bandwidth_hz.map(|hz| (MEMORY_PHASE / hz).clamp(MIN_MEMORY_S, slowest_s));
        self.prediction = Prediction {
            velocity_m_s: current.velocity_m_s,
            acceleration_m_s2: self.mean_m_s2,
            age_s: 0.0,
        };
    }

    /// Updates A from the difference between the prediction and the present velocity.
    fn learn_variance(&mut self, current: &VelocityEstimate) {
        let Prediction { velocity_m_s, acceleration_m_s2, age_s } = self.prediction;
        let off_m_s = velocity_m_s + integrate_acceleration(&acceleration_m_s2, age_s).1
            - current.velocity_m_s;
        let expected = self.variance.expected() * (age_s * age_s);
        let slope = Vector3::from_fn(|axis, _| {
            let noise = 2.0
                * current.noise_m2_s2[axis]
                * (1.0 - noise_autocorrelation(current.bandwidth_hz[axis] * age_s));
            let variance = expected[axis] + noise;
            0.5 * expected[axis] / variance * (off_m_s[axis] * off_m_s[axis] / variance - 1.0)
        });
        self.variance.fade(age_s);
        self.variance.learn_observed(&slope);
    }

    pub(super) fn mean_m_s2(&self) -> Vector3<f64> {
        self.mean_m_s2
    }

    /// Density of white acceleration that gives the same variance of velocity after `ahead_s`, m²/s³.
    pub(super) fn growth_m2_s3(&self, ahead_s: f64, bandwidth_hz: &Vector3<f64>) -> Vector3<f64> {
        self.variance.expected().zip_map(bandwidth_hz, |variance, hz| {
            variance * (ahead_s + SQRT_2 / hz.max(MIN_BANDWIDTH_HZ))
        })
    }
}

/// Autocorrelation of the velocity's noise after a phase ωτ.
fn noise_autocorrelation(phase: f64) -> f64 {
    let (sine, cosine) = (phase * FRAC_1_SQRT_2).sin_cos();
    (-phase * FRAC_1_SQRT_2).exp() * (cosine - sine)
}

/// Changes of position and velocity over `dt` seconds by a decaying acceleration; zero for negative `dt`.
pub(crate) fn integrate_acceleration(
    acceleration_m_s2: &Vector3<f64>,
    dt: f64,
) -> (Vector3<f64>, Vector3<f64>) {
    let dt = dt.max(0.0);
    let effective_s = DECAY_S * -(-dt / DECAY_S).exp_m1();
    (acceleration_m_s2 * (DECAY_S * (dt - effective_s)), acceleration_m_s2 * effective_s)
}

/// The acceleration after `dt` seconds of decay.
pub(crate) fn decay_acceleration(acceleration_m_s2: &Vector3<f64>, dt: f64) -> Vector3<f64> {
    acceleration_m_s2 * (-dt.max(0.0) / DECAY_S).exp()
}

#[cfg(test)]
mod tests {
    use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    const STEP_S: f64 = 1.0 / 240.0;
    const CAPABILITY_M2_S3: f64 = 0.225;

    fn begin() -> Acceleration {
        Acceleration::begin(&Vector3::repeat(CAPABILITY_M2_S3))
    }

    /// A velocity without noise.
    fn exactly(velocity_m_s: Vector3<f64>) -> VelocityEstimate {
        let bandwidth_hz = Vector3::repeat(1e3);
        VelocityEstimate { velocity_m_s, noise_m2_s2: Vector3::zeros(), bandwidth_hz }
    }

    fn gaussian(rng: &mut ChaCha8Rng) -> Vector3<f64> {
        Vector3::from_fn(|_, _| StandardNormal.sample(rng))
    }

    #[test]
    fn a_constant_acceleration_is_estimated() {
        let (acceleration_m_s2, mut velocity) = (Vector3::new(1.5, -0.3, 0.0), Vector3::zeros());
        let mut acceleration = begin();
        let mut simulate =
            |acceleration: &mut Acceleration, acceleration_m_s2: Vector3<f64>, seconds: f64| {
                for _ in 0..(seconds / STEP_S) as usize {
                    acceleration.fade(STEP_S);
                    velocity += acceleration_m_s2 * STEP_S;
                    acceleration.learn(&(acceleration_m_s2 * STEP_S), || exactly(velocity));
                }
            };
        simulate(&mut acceleration, acceleration_m_s2, 1.0);
        assert!((acceleration.mean_m_s2() - acceleration_m_s2).norm() < 1e-3, "{acceleration:?}");
        simulate(&mut acceleration, acceleration_m_s2, 5.0);
        let max_variance = acceleration.variance.expected().amax();
        assert!(max_variance < 0.02, "initial {}, now {max_variance}", 10.0 * CAPABILITY_M2_S3);
        simulate(&mut acceleration, Vector3::zeros(), 1.0);
        assert!(
            acceleration.mean_m_s2().norm() < 1e-3,
            "expected no acceleration: {acceleration:?}"
        );
    }

    /// Stated variances of predicted velocities match the errors, for accelerations that last 0.1 to 2 s.
    #[test]
    fn prediction_errors_match_their_variance() {
        const AHEAD: usize = 7;
        for lasts_s in [0.1, 0.4, 2.0] {
            let mut rng = ChaCha8Rng::seed_from_u64(5);
            let kept = f64::exp(-STEP_S / lasts_s);
            let (mut acceleration_m_s2, mut velocity) = (Vector3::zeros(), Vector3::<f64>::zeros());
            let mut acceleration = begin();
            let mut predictions = std::collections::VecDeque::new();
            let (mut square, mut count) = (0.0, 0.0);
            for step in 0..240 * 60 {
                acceleration_m_s2 = acceleration_m_s2 * kept
                    + gaussian(&mut rng) * (0.7 * (1.0 - kept * kept).sqrt());
                acceleration.fade(STEP_S);
                velocity += acceleration_m_s2 * STEP_S;
                acceleration.learn(&(acceleration_m_s2 * STEP_S), || exactly(velocity));
                let ahead_s = AHEAD as f64 * STEP_S;
                let predicted =
                    velocity + integrate_acceleration(&acceleration.mean_m_s2(), ahead_s).1;
                let density = acceleration.growth_m2_s3(ahead_s, &Vector3::repeat(1e3));
                predictions.push_back((predicted, density * ahead_s));
                if predictions.len() > AHEAD
                    && let Some((predicted, variance)) = predictions.pop_front()
                    && step > 240 * 5
                {
                    let off: Vector3<f64> = predicted - velocity;
                    square += off.component_mul(&off).component_div(&variance).mean();
                    count += 1.0;
                }
            }
            let ratio = square / count;
            println!("accelerations that last {lasts_s} s: {ratio:.2}");
            assert!((0.7..1.4).contains(&ratio), "{lasts_s} s: {ratio}");
        }
    }

    /// Measurement noise of an object at rest is not taken for acceleration, except for its part in â. Counting
    /// it would give twice the noise's variance or more.
    #[test]
    fn noise_is_not_taken_for_acceleration() {
        for bandwidth_hz in [5.0f64, 20.0, 60.0] {
            let mut rng = ChaCha8Rng::seed_from_u64(6);
            let (deviation_m, mut acceleration) = (0.001, begin());
            let (mut place, mut velocity) = (Vector3::zeros(), Vector3::zeros());
            let noise = deviation_m * deviation_m * STEP_S * bandwidth_hz.powi(3) / 8f64.sqrt();
            for _ in 0..240 * 20 {
                acceleration.fade(STEP_S);
                place += velocity * STEP_S;
                let off: Vector3<f64> = gaussian(&mut rng) * deviation_m - place;
                place += off * (SQRT_2 * bandwidth_hz * STEP_S);
                let change = off * (bandwidth_hz * bandwidth_hz * STEP_S);
                velocity += change;
                acceleration.learn(&change, || VelocityEstimate {
                    velocity_m_s: velocity,
                    noise_m2_s2: Vector3::repeat(noise),
                    bandwidth_hz: Vector3::repeat(bandwidth_hz),
                });
            }
            let share =
                acceleration.variance.expected().amax() * PREDICTION_AGE_S * PREDICTION_AGE_S
                    / noise;
            println!("{bandwidth_hz} Hz: {share:.3} of the noise");
            assert!(share < 1.4, "{bandwidth_hz} Hz: {share}");
        }
    }

    #[test]
    fn extreme_bandwidths_stay_finite() {
        let mut acceleration = begin();
        for bandwidth_hz in [0.0, f64::INFINITY] {
            acceleration.fade(0.06);
            acceleration.learn(&Vector3::repeat(1e-3), || VelocityEstimate {
                bandwidth_hz: Vector3::repeat(bandwidth_hz),
                ..exactly(Vector3::zeros())
            });
            assert!(acceleration.mean_m_s2().iter().all(|mean| mean.is_finite()));
            let growth = acceleration.growth_m2_s3(0.03, &Vector3::repeat(bandwidth_hz));
            assert!(growth.iter().all(|growth| growth.is_finite() && *growth > 0.0), "{growth}");
        }
    }

    #[test]
    fn integration_is_additive() {
        let acceleration_m_s2 = Vector3::new(1.0, 2.0, -0.5);
        let (once, speed) = integrate_acceleration(&acceleration_m_s2, 0.08);
        let (first, gained) = integrate_acceleration(&acceleration_m_s2, 0.05);
        let (second, more) =
            integrate_acceleration(&decay_acceleration(&acceleration_m_s2, 0.05), 0.03);
        assert!((first + gained * 0.03 + second - once).norm() < 1e-12);
        assert!((gained + more - speed).norm() < 1e-12);
        let short = integrate_acceleration(&acceleration_m_s2, 1e-3);
        assert!(
            (short.1 / 1e-3 - acceleration_m_s2).norm() < 0.01
                && (short.0 / 0.5e-6 - acceleration_m_s2).norm() < 0.01
        );
        assert_eq!(
            integrate_acceleration(&acceleration_m_s2, -0.1),
            (Vector3::zeros(), Vector3::zeros())
        );
    }
}
