//! How an object's velocity changes just now, for what is told of a moment that nobody has measured yet.
//!
//! A filter of constant velocity follows an acceleration a by its corrections alone: once it keeps up with it, they
//! add a dt to the velocity in every dt. With Δv what a measurement adds,
//!
//! â ← (â + Δv / T) / (1 + dt/T)
//!
//! is the mean over the last T. The velocity's own error lasts about 1/ω, ω how quickly the filter follows, so that
//! T is [`MEMORY`]/ω, and at least [`LEAST_MEMORY_S`], within which accelerations hardly change.
//!
//! The filters go on without it (they would follow their own errors); a snapshot is some hundredths of a second ahead
//! of the newest measurement, and there velocities erred by a dt more than by anything else. Accelerations end:
//! what is told counts on â e^(-t/L) from now on, which adds
//!
//! Δv = â L (1 - e^(-t/L)), Δp = â L (t - L (1 - e^(-t/L))), L = [`LASTS_S`].
//!
//! How far that can be trusted is learned from what was told itself. Let A be the variance by which accelerations are
//! other than â. What would have been told τ ago of now ([`PROMISED_S`]) is off from what the filter says now by d, of
//! variance
//!
//! A τ² + 2 N (1 - r), r = e^(-x) (cos x - sin x), x = ωτ/√2,
//!
//! N being what measurements' noise makes of the velocity's variance, and r how much of its error is still the same:
//! the autocorrelation of white noise through the steady filter, s ω² / (s² + √2 ω s + ω²). ln A then follows the slope
//! of d's log-likelihood as the densities do ([`super::density`], with the curvature that is observed: d is compared some
//! twenty times a second, and what begins far above would fall for seconds). The mean of d² less that noise goes as τ²
//! from 0.03 to 0.13 s, for robots on sines as for those that are pushed at random. What noise makes of â counts as A.
//!
//! The velocity's own lag is what accelerations did within the last √2/ω and is not known yet, so that both err in the
//! same direction: over t the variance of the velocity grows by A t (t + √2/ω).
//!
//! R4's robots under four cameras (`--bin scenarios -- r4`): rms of velocities 32 → 18 mm/s, of positions 1.18 → 1.07 mm.

use std::f64::consts::{FRAC_1_SQRT_2, SQRT_2};

use nalgebra::Vector3;

use super::process_noise::Densities;

/// T times ω …
const MEMORY: f64 = 2.0;
/// … but no less than this.
const LEAST_MEMORY_S: f64 = 0.1;
/// What follows more slowly than this hardly follows at all, 1/s.
const LEAST_BANDWIDTH_HZ: f64 = 1.0;
/// Time constant in which accelerations end.
const LASTS_S: f64 = 0.4;
/// After so long what would have been told is held against what is known …
const PROMISED_S: f64 = 0.05;
/// … but not after so long, when nothing was seen in between.
const OVERDUE_S: f64 = 0.15;
/// (m/s²)² over the density that objects are capable of.
const CAPABILITY_RATE_HZ: f64 = 10.0;
/// ln of how much greater than that A may be.
const LOG_CEILING: f64 = 2.8;

/// The estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Acceleration {
    /// â.
    mean_m_s2: Vector3<f64>,
    /// T, along each axis.
    memory_s: Vector3<f64>,
    /// What was kept of â when time last went on: as much counts of what comes in.
    kept: Vector3<f64>,
    /// A, along each axis, (m/s²)².
    unsteady: Densities,
    promise: Promise,
}

/// What the filter said some time ago.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Promise {
    velocity_m_s: Vector3<f64>,
    acceleration_m_s2: Vector3<f64>,
    /// How long ago; infinite before there is any.
    age_s: f64,
}

/// A filter's velocity after a measurement.
pub(super) struct Known {
    /// m/s.
    pub(super) velocity_m_s: Vector3<f64>,
    /// N.
    pub(super) noise_m2_s2: Vector3<f64>,
    /// ω.
    pub(super) bandwidth_hz: Vector3<f64>,
}

impl Acceleration {
    /// Nothing is known but the density of what objects are capable of.
    pub(super) fn begin(capability_m2_s3: &Vector3<f64>) -> Self {
        let none = Vector3::zeros();
        Self {
            mean_m_s2: none,
            memory_s: Vector3::repeat(LEAST_MEMORY_S),
            kept: Vector3::repeat(1.0),
            unsteady: Densities::begin(&(capability_m2_s3 * CAPABILITY_RATE_HZ), LOG_CEILING),
            promise: Promise { velocity_m_s: none, acceleration_m_s2: none, age_s: f64::INFINITY },
        }
    }

    /// Moves on by `dt` seconds, either way.
    pub(super) fn forget(&mut self, dt: f64) {
        let span_s = dt.abs();
        self.kept = self.memory_s.map(|memory_s| memory_s / (memory_s + span_s));
        self.mean_m_s2.component_mul_assign(&self.kept);
        self.promise.age_s += span_s;
    }

    /// Takes in what a measurement has added to the filter's velocity; `known` is asked for now and then.
    pub(super) fn learn(&mut self, change_m_s: &Vector3<f64>, known: impl FnOnce() -> Known) {
        self.mean_m_s2 += change_m_s.component_div(&self.memory_s).component_mul(&self.kept);
        if self.promise.age_s < PROMISED_S {
            return;
        }
        let known = known();
        if self.promise.age_s < OVERDUE_S {
            self.hold_against(&known);
        }
        let slowest_s = MEMORY / LEAST_BANDWIDTH_HZ;
        self.memory_s = known.bandwidth_hz.map(|hz| (MEMORY / hz).clamp(LEAST_MEMORY_S, slowest_s));
        self.promise = Promise {
            velocity_m_s: known.velocity_m_s,
            acceleration_m_s2: self.mean_m_s2,
            age_s: 0.0,
        };
    }

    /// Learns A from what was promised.
    fn hold_against(&mut self, known: &Known) {
        let Promise { velocity_m_s, acceleration_m_s2, age_s } = self.promise;
        let off_m_s = velocity_m_s + added_by(&acceleration_m_s2, age_s).1 - known.velocity_m_s;
        let unsteady = self.unsteady.expected() * (age_s * age_s);
        let slope = Vector3::from_fn(|axis, _| {
            let noise = 2.0
                * known.noise_m2_s2[axis]
                * (1.0 - still_there(known.bandwidth_hz[axis] * age_s));
            let variance = unsteady[axis] + noise;
            0.5 * unsteady[axis] / variance * (off_m_s[axis] * off_m_s[axis] / variance - 1.0)
        });
        self.unsteady.forget(age_s);
        self.unsteady.learn_observed(&slope);
    }

    /// Its value now.
    pub(super) fn mean_m_s2(&self) -> Vector3<f64> {
        self.mean_m_s2
    }

    /// The density of the white acceleration that would make velocities as uncertain after so many seconds, m²/s³.
    pub(super) fn growth_m2_s3(&self, ahead_s: f64, bandwidth_hz: &Vector3<f64>) -> Vector3<f64> {
        self.unsteady.expected().zip_map(bandwidth_hz, |variance, hz| {
            variance * (ahead_s + SQRT_2 / hz.max(LEAST_BANDWIDTH_HZ))
        })
    }
}

/// How much of a velocity's error by noise is the same after ωτ.
fn still_there(phase: f64) -> f64 {
    let (sine, cosine) = (phase * FRAC_1_SQRT_2).sin_cos();
    (-phase * FRAC_1_SQRT_2).exp() * (cosine - sine)
}

/// What an acceleration of now adds to position and velocity over so many seconds; nothing to the past.
pub(crate) fn added_by(acceleration_m_s2: &Vector3<f64>, dt: f64) -> (Vector3<f64>, Vector3<f64>) {
    let dt = dt.max(0.0);
    let effective_s = LASTS_S * -(-dt / LASTS_S).exp_m1();
    (acceleration_m_s2 * (LASTS_S * (dt - effective_s)), acceleration_m_s2 * effective_s)
}

/// What is left of one after so many seconds.
pub(crate) fn left_after(acceleration_m_s2: &Vector3<f64>, dt: f64) -> Vector3<f64> {
    acceleration_m_s2 * (-dt.max(0.0) / LASTS_S).exp()
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

    /// A velocity that is known exactly.
    fn exactly(velocity_m_s: Vector3<f64>) -> Known {
        let bandwidth_hz = Vector3::repeat(1e3);
        Known { velocity_m_s, noise_m2_s2: Vector3::zeros(), bandwidth_hz }
    }

    fn gaussian(rng: &mut ChaCha8Rng) -> Vector3<f64> {
        Vector3::from_fn(|_, _| StandardNormal.sample(rng))
    }

    #[test]
    fn an_acceleration_that_stays_is_found_and_trusted() {
        let (push, mut velocity) = (Vector3::new(1.5, -0.3, 0.0), Vector3::zeros());
        let mut acceleration = begin();
        let mut go_on = |acceleration: &mut Acceleration, push: Vector3<f64>, seconds: f64| {
            for _ in 0..(seconds / STEP_S) as usize {
                acceleration.forget(STEP_S);
                velocity += push * STEP_S;
                acceleration.learn(&(push * STEP_S), || exactly(velocity));
            }
        };
        go_on(&mut acceleration, push, 1.0);
        assert!((acceleration.mean_m_s2() - push).norm() < 1e-3, "{acceleration:?}");
        go_on(&mut acceleration, push, 5.0);
        let most = acceleration.unsteady.expected().amax();
        assert!(most < 0.02, "of {}, what it began with, {most}", 10.0 * CAPABILITY_M2_S3);
        go_on(&mut acceleration, Vector3::zeros(), 1.0);
        assert!(acceleration.mean_m_s2().norm() < 1e-3, "it is over: {acceleration:?}");
    }

    /// Velocities go wrong by as much as is said, whether accelerations change within a tenth of a second or slowly.
    #[test]
    fn what_is_not_foreseen_is_as_much_as_is_said() {
        const AHEAD: usize = 7;
        for lasts_s in [0.1, 0.4, 2.0] {
            let mut rng = ChaCha8Rng::seed_from_u64(5);
            let kept = f64::exp(-STEP_S / lasts_s);
            let (mut push, mut velocity) = (Vector3::zeros(), Vector3::<f64>::zeros());
            let mut acceleration = begin();
            let mut told = std::collections::VecDeque::new();
            let (mut square, mut count) = (0.0, 0.0);
            for step in 0..240 * 60 {
                push = push * kept + gaussian(&mut rng) * (0.7 * (1.0 - kept * kept).sqrt());
                acceleration.forget(STEP_S);
                velocity += push * STEP_S;
                acceleration.learn(&(push * STEP_S), || exactly(velocity));
                let ahead_s = AHEAD as f64 * STEP_S;
                let foreseen = velocity + added_by(&acceleration.mean_m_s2(), ahead_s).1;
                let density = acceleration.growth_m2_s3(ahead_s, &Vector3::repeat(1e3));
                told.push_back((foreseen, density * ahead_s));
                if told.len() > AHEAD
                    && let Some((foreseen, variance)) = told.pop_front()
                    && step > 240 * 5
                {
                    let off: Vector3<f64> = foreseen - velocity;
                    square += off.component_mul(&off).component_div(&variance).mean();
                    count += 1.0;
                }
            }
            let ratio = square / count;
            println!("accelerations that last {lasts_s} s: {ratio:.2}");
            assert!((0.7..1.4).contains(&ratio), "{lasts_s} s: {ratio}");
        }
    }

    /// What stands still is seen to jitter. That is not taken for unsteadiness, but for what it makes of â; 2 and more
    /// of the noise's variance would show otherwise.
    #[test]
    fn noise_is_no_acceleration() {
        for bandwidth_hz in [5.0f64, 20.0, 60.0] {
            let mut rng = ChaCha8Rng::seed_from_u64(6);
            let (deviation_m, mut acceleration) = (0.001, begin());
            let (mut place, mut velocity) = (Vector3::zeros(), Vector3::zeros());
            let noise = deviation_m * deviation_m * STEP_S * bandwidth_hz.powi(3) / 8f64.sqrt();
            for _ in 0..240 * 20 {
                acceleration.forget(STEP_S);
                place += velocity * STEP_S;
                let off: Vector3<f64> = gaussian(&mut rng) * deviation_m - place;
                place += off * (SQRT_2 * bandwidth_hz * STEP_S);
                let change = off * (bandwidth_hz * bandwidth_hz * STEP_S);
                velocity += change;
                acceleration.learn(&change, || Known {
                    velocity_m_s: velocity,
                    noise_m2_s2: Vector3::repeat(noise),
                    bandwidth_hz: Vector3::repeat(bandwidth_hz),
                });
            }
            let share = acceleration.unsteady.expected().amax() * PROMISED_S * PROMISED_S / noise;
            println!("{bandwidth_hz} Hz: {share:.3} of the noise");
            assert!(share < 1.4, "{bandwidth_hz} Hz: {share}");
        }
    }

    #[test]
    fn a_filter_that_does_not_follow_tells_of_none() {
        let mut acceleration = begin();
        for bandwidth_hz in [0.0, f64::INFINITY] {
            acceleration.forget(0.06);
            acceleration.learn(&Vector3::repeat(1e-3), || Known {
                bandwidth_hz: Vector3::repeat(bandwidth_hz),
                ..exactly(Vector3::zeros())
            });
            assert!(acceleration.mean_m_s2().iter().all(|mean| mean.is_finite()));
            let growth = acceleration.growth_m2_s3(0.03, &Vector3::repeat(bandwidth_hz));
            assert!(growth.iter().all(|growth| growth.is_finite() && *growth > 0.0), "{growth}");
        }
    }

    #[test]
    fn two_steps_are_one() {
        let push = Vector3::new(1.0, 2.0, -0.5);
        let (once, speed) = added_by(&push, 0.08);
        let (first, gained) = added_by(&push, 0.05);
        let (second, more) = added_by(&left_after(&push, 0.05), 0.03);
        assert!((first + gained * 0.03 + second - once).norm() < 1e-12);
        assert!((gained + more - speed).norm() < 1e-12);
        let short = added_by(&push, 1e-3);
        assert!((short.1 / 1e-3 - push).norm() < 0.01 && (short.0 / 0.5e-6 - push).norm() < 0.01);
        assert_eq!(added_by(&push, -0.1), (Vector3::zeros(), Vector3::zeros()));
    }
}
