//! A constant-velocity Kalman filter for a value in three dimensions and its rate, that knows that
//! part of each camera's error is the same from frame to frame.
//!
//! A measurement of camera c is z = p + L β_c + w: the noise w is fresh each time, the systematic
//! part L β_c is not. β_c (three numbers of unit variance) forgets itself with a time constant τ, so
//! averaging a thousand frames of one camera does not average it away, while a second camera, with
//! its own β, does help. β is not estimated but considered (Schmidt, *Application of state-space
//! methods to navigation problems*, 1966): its correlation with the state is carried along, and the
//! gain takes it into account.
//!
//! With x = (p, v), P = [A B; Bᵀ D] and C_c = E[x̃ β_cᵀ] = [Cp; Cv]:
//!
//! - predict: P ← F P Fᵀ + Q, C ← ρ F C, ρ = exp(-dt/τ);
//! - update by camera c: M = A + Cp Lᵀ, N = Bᵀ + Cv Lᵀ (covariances of p̃ and ṽ with the
//!   innovation), S = A + Cp Lᵀ + L Cpᵀ + R, K = [M; N] S⁻¹, P ← P - K S Kᵀ,
//!   C_j ← C_j - K (Cp_j + [j = c] L).
//!
//! A camera's clock may be off: what it stamps t was seen at t - ε, so that z = p - v ε. ε (a deviation
//! σ, the measurement's `timing_s`) is the same for all that the camera sees and forgets nothing; it is
//! considered as well, but apart, since what is known of it grows. P is what would be if the clocks were
//! known, and q_c = ∂x̃/∂ε_c, the state's error by each camera's ε, is carried along:
//!
//! - predict: q ← F q;
//! - update: with u_j = qp_j - [j = c] v, the innovation's error by ε_j, q_j ← q_j - K u_j; the gain is
//!   that of M + Σ σ_j² qp_j u_jᵀ, N + Σ σ_j² qv_j u_jᵀ and S + Σ σ_j² u_j u_jᵀ + σ_c² D (v itself is
//!   known with the covariance D), and P ← P - K Mᵀ - M Kᵀ + K (S + σ_c² D) Kᵀ, as for any gain.
//!
//! What is told is P + Σ σ_j² q_j q_jᵀ ([`Kernel::told`]).
//!
//! An innovation longer than the robust limit k (Mahalanobis) is held back with Huber's weight
//! w = k/d; the covariance is then that of the gain w K: P ← P - (2w - w²) K S Kᵀ.
//!
//! P stays positive definite: S ≥ R, R has a floor and P a ceiling (see `world::params`), so that
//! the subtraction keeps more than six digits; a property test drives it through the extremes.

mod innovation;

use nalgebra::{Matrix3, Vector3};

use super::{MotionModel, Spread};
use crate::id::CameraId;
pub use innovation::{Innovation, Noise};
use innovation::{Joint, NO_SOURCE, Source};
pub(crate) use innovation::{invert_positive, positive_root};

/// Cameras whose systematic error is carried at most; the one not heard of longest gives way.
pub const MAX_SOURCES: usize = 8;

/// Sources whose correlation has decayed below exp(-this) are let go.
const FORGOTTEN_TIMES: f64 = 6.0;

/// Rate, covariance and systematic correlations; the value itself lies with the caller, who knows
/// whether it is a vector or a rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kernel {
    /// Rate of the value, per second.
    pub rate: Vector3<f64>,
    /// Covariance.
    pub spread: Spread,
    sources: [Source; MAX_SOURCES],
    len: usize,
    /// Whether a clock is considered; until then nothing is computed for it.
    is_timed: bool,
}

impl Kernel {
    /// After one measurement of the value, with a rate of which only the variance along each axis is known.
    pub fn begin(noise: &Noise, camera: CameraId, rate_variance: &Vector3<f64>) -> Self {
        let mut kernel = Self {
            rate: Vector3::zeros(),
            spread: Spread {
                // The rate is not known yet, and neither is what the clock's error does.
                value: noise.total
                    + Matrix3::from_diagonal(&(rate_variance * noise.timing_s.powi(2))),
                cross: Matrix3::zeros(),
                rate: Matrix3::from_diagonal(rate_variance),
            },
            sources: [NO_SOURCE; MAX_SOURCES],
            len: 1,
            is_timed: noise.timing_s > 0.0,
        };
        kernel.sources[0] = Source { camera, value: noise.systematic_root, ..NO_SOURCE };
        kernel
    }

    /// Moves the covariance on by `dt` seconds; the caller moves the value by `rate` · dt.
    pub fn predict(&mut self, dt: f64, density: &Vector3<f64>, systematic_time_s: f64) {
        self.spread.predict(dt, density);
        let kept = (-dt.abs() / systematic_time_s).exp();
        let mut live = 0;
        for index in 0..self.len {
            if self.sources[index].age_s + dt.abs() > FORGOTTEN_TIMES * systematic_time_s {
                continue;
            }
            if live < index {
                self.sources[live] = self.sources[index];
            }
            let source = &mut self.sources[live];
            source.predict(dt, kept);
            if self.is_timed {
                source.predict_clock(dt);
            }
            live += 1;
        }
        self.len = live;
    }

    /// How far `residual` (measured less predicted value) would be from zero, `dt` seconds from
    /// now. `None` if the innovation's covariance is not positive definite.
    pub fn innovation_after(
        &self,
        dt: f64,
        model: &MotionModel,
        residual: &Vector3<f64>,
        (noise, camera): (&Noise, CameraId),
    ) -> Option<Innovation> {
        let mut spread = self.spread;
        spread.predict(dt, &model.acceleration_density_m2_s3);
        let kept = (-dt.abs() / model.systematic_time_s).exp();
        let own = self.source(camera);
        let predicted = |source: &Source, kept: f64| {
            let mut source = *source;
            source.predict(dt, kept);
            source.predict_clock(dt);
            source
        };
        let source = own.map(|index| predicted(&self.sources[index], kept));
        let mut joint = Joint::of(&spread, source.as_ref(), noise);
        if noise.timing_s > 0.0 {
            let sources = self.sources[..self.len].iter().map(|source| predicted(source, 1.0));
            joint.add_clocks(sources, &self.rate, (camera, noise.timing_s));
        }
        joint.innovation(residual)
    }

    /// How far `residual` (measured less predicted value) is from zero, by a camera's noise.
    /// `None` if the innovation's covariance is not positive definite.
    pub fn innovation(
        &self,
        residual: &Vector3<f64>,
        noise: &Noise,
        camera: CameraId,
    ) -> Option<Innovation> {
        self.joint(camera, noise).1.innovation(residual)
    }

    /// The covariance with what the clocks may add.
    pub fn told(&self) -> Spread {
        let mut spread = self.spread;
        for source in self.sources[..self.len].iter().filter(|source| source.timing_s > 0.0) {
            let square = source.timing_s * source.timing_s;
            let weighted = source.value_by_clock.transpose() * square;
            spread.value += source.value_by_clock * weighted;
            spread.cross += source.value_by_clock * source.rate_by_clock.transpose() * square;
            spread.rate += source.rate_by_clock * source.rate_by_clock.transpose() * square;
        }
        spread
    }

    /// Traces of [`Kernel::told`]'s blocks: of value, of both, of rate.
    pub fn told_traces(&self) -> (f64, f64, f64) {
        let spread = &self.spread;
        let mut traces = (spread.value.trace(), spread.cross.trace(), spread.rate.trace());
        for source in self.sources[..self.len].iter().filter(|source| source.timing_s > 0.0) {
            let square = source.timing_s * source.timing_s;
            traces.0 += source.value_by_clock.norm_squared() * square;
            traces.1 += source.value_by_clock.dot(&source.rate_by_clock) * square;
            traces.2 += source.rate_by_clock.norm_squared() * square;
        }
        traces
    }

    /// Of the value's covariance, what systematic errors have made: Σ Cp Cpᵀ.
    pub fn systematic(&self) -> Matrix3<f64> {
        let sources = self.sources[..self.len].iter();
        sources.map(|source| source.value * source.value.transpose()).sum()
    }

    /// As if the clocks were known, and with what they may add.
    fn joint(&self, camera: CameraId, noise: &Noise) -> (Joint, Joint) {
        let source = self.source(camera).map(|index| &self.sources[index]);
        let joint = Joint::of(&self.spread, source, noise);
        if noise.timing_s <= 0.0 {
            return (joint, joint);
        }
        let mut whole = joint;
        let sources = self.sources[..self.len].iter().copied();
        whole.add_clocks(sources, &self.rate, (camera, noise.timing_s));
        (joint, whole)
    }

    /// Takes in a measurement; gives the correction of the value. A measurement whose innovation
    /// has no positive definite covariance changes nothing and has an infinite distance.
    pub fn update(
        &mut self,
        residual: &Vector3<f64>,
        noise: &Noise,
        camera: CameraId,
        robust_distance_squared: f64,
    ) -> (Vector3<f64>, Innovation) {
        let own = self.source_or_new(camera);
        self.sources[own].timing_s = noise.timing_s;
        self.is_timed |= noise.timing_s > 0.0;
        let (given, whole) = self.joint(camera, noise);
        let Joint { value: value_cov, rate: rate_cov, innovation: covariance } = whole;
        let Some((inverse, determinant)) = invert_positive(&covariance) else {
            let nothing = Innovation {
                distance_squared: f64::INFINITY,
                determinant: 1.0,
                conditional_squared: Vector3::zeros(),
                conditional_precision: Vector3::repeat(1.0),
            };
            return (Vector3::zeros(), nothing);
        };
        let weighted = inverse * residual;
        let innovation = Innovation::new(residual, &weighted, &inverse, determinant);
        let distance_squared = innovation.distance_squared;
        let weight = if distance_squared > robust_distance_squared {
            (robust_distance_squared / distance_squared).sqrt()
        } else {
            1.0
        };
        let value_gain = value_cov * inverse;
        let rate_gain = rate_cov * inverse;
        if noise.timing_s > 0.0 {
            self.shrink_by_any(&given, &(value_gain * weight), &(rate_gain * weight));
        } else {
            let share = 2.0 * weight - weight * weight;
            let spread = &mut self.spread;
            spread.value = symmetric(spread.value - value_gain * value_cov.transpose() * share);
            spread.cross -= value_gain * rate_cov.transpose() * share;
            spread.rate = symmetric(spread.rate - rate_gain * rate_cov.transpose() * share);
        }
        let rate = self.rate;
        let (value_gain, rate_gain) = (value_gain * weight, rate_gain * weight);
        for (index, source) in self.sources[..self.len].iter_mut().enumerate() {
            let mut with_innovation = source.value;
            if index == own {
                with_innovation += noise.systematic_root;
                source.age_s = 0.0;
            }
            source.value -= value_gain * with_innovation;
            source.rate -= rate_gain * with_innovation;
            if self.is_timed {
                let by_clock = source.by_clock((index == own).then_some(&rate));
                source.value_by_clock -= value_gain * by_clock;
                source.rate_by_clock -= rate_gain * by_clock;
            }
        }
        self.rate += rate_cov * weighted * weight;
        (value_cov * weighted * weight, innovation)
    }

    /// P after an update with any gain.
    fn shrink_by_any(
        &mut self,
        given: &Joint,
        value_gain: &Matrix3<f64>,
        rate_gain: &Matrix3<f64>,
    ) {
        let spread = &mut self.spread;
        let of_value = value_gain * given.innovation;
        let of_rate = rate_gain * given.innovation;
        let value = value_gain * given.value.transpose();
        spread.value =
            symmetric(spread.value - value - value.transpose() + of_value * value_gain.transpose());
        spread.cross += of_value * rate_gain.transpose()
            - value_gain * given.rate.transpose()
            - given.value * rate_gain.transpose();
        let rate = rate_gain * given.rate.transpose();
        spread.rate =
            symmetric(spread.rate - rate - rate.transpose() + of_rate * rate_gain.transpose());
    }

    fn source(&self, camera: CameraId) -> Option<usize> {
        self.sources[..self.len].iter().position(|source| source.camera == camera)
    }

    fn source_or_new(&mut self, camera: CameraId) -> usize {
        if let Some(index) = self.source(camera) {
            return index;
        }
        let index = if self.len < MAX_SOURCES {
            self.len += 1;
            self.len - 1
        } else {
            let mut oldest = 0;
            for index in 1..MAX_SOURCES {
                if self.sources[index].age_s > self.sources[oldest].age_s {
                    oldest = index;
                }
            }
            oldest
        };
        self.sources[index] = Source { camera, ..NO_SOURCE };
        index
    }
}

fn symmetric(matrix: Matrix3<f64>) -> Matrix3<f64> {
    (matrix + matrix.transpose()) * 0.5
}

#[cfg(test)]
mod tests;
