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
mod sources;

use fearless_simd::{Level, Simd, dispatch};
use fearless_simd_macros::simd;
use nalgebra::{Matrix3, Vector3};

use super::{MotionModel, Spread};
use crate::id::CameraId;
use innovation::Joint;
pub use innovation::{Innovation, Noise};
pub(crate) use innovation::{invert_positive, positive_root};
use sources::{Sources, gain_of};

/// Cameras whose systematic error is carried at most; the one not heard of longest gives way.
pub const MAX_SOURCES: usize = 8;

/// Rate, covariance and systematic correlations; the value itself lies with the caller, who knows
/// whether it is a vector or a rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kernel {
    /// Rate of the value, per second.
    pub rate: Vector3<f64>,
    /// Covariance.
    pub spread: Spread,
    sources: Sources,
}

impl Kernel {
    /// After one measurement of the value, with a rate of which only the variance along each axis is known.
    pub fn begin(noise: &Noise, camera: CameraId, rate_variance: &Vector3<f64>) -> Self {
        Self {
            rate: Vector3::zeros(),
            spread: Spread {
                // The rate is not known yet, and neither is what the clock's error does.
                value: noise.total
                    + Matrix3::from_diagonal(&(rate_variance * noise.timing_s.powi(2))),
                cross: Matrix3::zeros(),
                rate: Matrix3::from_diagonal(rate_variance),
            },
            sources: Sources::begin(camera, &noise.systematic_root, noise.timing_s > 0.0),
        }
    }

    /// Moves the covariance on by `dt` seconds; the caller moves the value by `rate` · dt.
    pub fn predict(&mut self, dt: f64, density: &Vector3<f64>, systematic_time_s: f64) {
        self.spread.predict(dt, density);
        let kept = (-dt.abs() / systematic_time_s).exp();
        self.sources.predict(dt, kept, systematic_time_s);
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
        let own = self.sources.find(camera);
        let shared = own.map(|index| {
            let (value, rate) = self.sources.with(index);
            ((value + rate * dt) * kept, rate * kept)
        });
        let mut joint = Joint::of(&spread, shared.as_ref(), noise);
        if noise.timing_s > 0.0 {
            self.sources.add_clocks(&mut joint, dt, (own, noise.timing_s), &self.rate);
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
        self.sources.add_told(&mut spread);
        spread
    }

    /// Traces of [`Kernel::told`]'s blocks: of value, of both, of rate.
    pub fn told_traces(&self) -> (f64, f64, f64) {
        let spread = &self.spread;
        let [value, cross, rate] = self.sources.told_traces();
        (spread.value.trace() + value, spread.cross.trace() + cross, spread.rate.trace() + rate)
    }

    /// Of the value's covariance, what systematic errors have made: Σ Cp Cpᵀ.
    pub fn systematic(&self) -> Matrix3<f64> {
        self.sources.systematic()
    }

    /// As if the clocks were known, and with what they may add.
    #[inline(always)]
    fn joint(&self, camera: CameraId, noise: &Noise) -> (Joint, Joint) {
        let own = self.sources.find(camera);
        let shared = own.map(|index| self.sources.with(index));
        let joint = Joint::of(&self.spread, shared.as_ref(), noise);
        if noise.timing_s <= 0.0 {
            return (joint, joint);
        }
        let mut whole = joint;
        self.sources.add_clocks(&mut whole, 0.0, (own, noise.timing_s), &self.rate);
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
        dispatch!(Level::new(), simd => {
            self.update_with(simd, residual, noise, camera, robust_distance_squared)
        })
    }

    #[simd]
    fn update_with<S: Simd>(
        &mut self,
        simd: S,
        residual: &Vector3<f64>,
        noise: &Noise,
        camera: CameraId,
        robust_distance_squared: f64,
    ) -> (Vector3<f64>, Innovation) {
        let own = self.sources.find_or_new(camera);
        self.sources.set_timing(own, noise.timing_s);
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
        let gain = gain_of(&(value_gain * weight), &(rate_gain * weight));
        self.sources.correct(simd, own, &gain, &noise.systematic_root, &self.rate);
        self.rate += rate_cov * weighted * weight;
        (value_cov * weighted * weight, innovation)
    }

    /// P after an update with any gain.
    #[inline(always)]
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
}

#[inline(always)]
fn symmetric(matrix: Matrix3<f64>) -> Matrix3<f64> {
    (matrix + matrix.transpose()) * 0.5
}

#[cfg(test)]
mod tests;
