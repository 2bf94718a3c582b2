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
//! Two things are kept for who chooses the process noise: how value and rate depend on it
//! ([`Correction::slope`], [`super::density`]), and how much of P it has made ([`Kernel::told_sharing`]).
//!
//! P stays positive definite: S ≥ R, R has a floor and P a ceiling (see `world::params`), so that
//! the subtraction keeps more than six digits; a property test drives it through the extremes.

mod block;
mod consider;
mod innovation;
mod process_noise_share;
mod update;

use fearless_simd::{Level, Simd, dispatch};
use fearless_simd_macros::simd;
use nalgebra::{Matrix3, Vector3};

use super::{MotionModel, Spread};
use block::Block;
use consider::Sources;
pub use innovation::invert_positive;
pub(crate) use innovation::positive_root;
pub use innovation::{Innovation, Noise};
use process_noise_share::Disturbed;
use roundel_vision::id::CameraId;

/// Cameras whose systematic error is carried at most; the one not heard of longest gives way.
pub const MAX_SOURCES: usize = 8;

/// What a measurement does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correction {
    /// Of the value.
    pub value: Vector3<f64>,
    /// What was not foreseen.
    pub innovation: Innovation,
    /// Of the log-likelihood over the logarithm of the process noise's density, along each axis.
    pub slope: Vector3<f64>,
}

/// Rate, covariance and systematic correlations; the value itself lies with the caller, who knows
/// whether it is a vector or a rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kernel {
    /// Rate of the value, per second.
    pub rate: Vector3<f64>,
    /// Covariance.
    pub spread: Spread,
    /// By how much value and rate would be further with a larger density of the process noise, dp and dv.
    value_slope: Vector3<f64>,
    rate_slope: Vector3<f64>,
    disturbed: Disturbed,
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
            value_slope: Vector3::zeros(),
            rate_slope: Vector3::zeros(),
            disturbed: Disturbed::default(),
            sources: Sources::begin(camera, &noise.systematic_root, noise.timing_s > 0.0),
        }
    }

    /// Moves the covariance on by `dt` seconds; the caller moves the value by `rate` · dt.
    pub fn predict(&mut self, dt: f64, density: &Vector3<f64>, systematic_time_s: f64) {
        self.spread.predict(dt, density);
        self.disturbed.predict(dt, density);
        self.value_slope += self.rate_slope * dt;
        self.sources.predict(dt, decayed(dt.abs() / systematic_time_s), systematic_time_s);
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
        let value = self.spread.value_after(dt, &model.acceleration_density_m2_s3);
        let kept = decayed(dt.abs() / model.systematic_time_s);
        self.innovation_of(&value, (dt, kept), residual, (noise, camera))
    }

    /// With this covariance of the value, so many seconds from now, when systematic errors have kept such a share.
    fn innovation_of(
        &self,
        value: &Matrix3<f64>,
        (dt, kept): (f64, f64),
        residual: &Vector3<f64>,
        (noise, camera): (&Noise, CameraId),
    ) -> Option<Innovation> {
        let own = self.sources.find(camera);
        let mut covariance = dispatch!(Level::new(), simd => {
            self.innovation_with(simd, value, (own, dt, kept), noise)
        });
        if noise.timing_s > 0.0 {
            covariance += self.spread.rate * noise.timing_s.powi(2);
            covariance += self.sources.clocks_of_innovation(dt, (own, noise.timing_s), &self.rate);
        }
        Innovation::of(residual, &covariance)
    }

    /// S as if the clocks were known.
    #[simd]
    fn innovation_with<S: Simd>(
        &self,
        simd: S,
        value: &Matrix3<f64>,
        (own, dt, kept): (Option<usize>, f64, f64),
        noise: &Noise,
    ) -> Matrix3<f64> {
        let Some(own) = own else { return value + noise.total };
        let (of_value, of_rate) = self.sources.with(simd, own);
        let shared = of_value.plus_scaled(of_rate, dt).scaled(kept);
        let with = Block::of(simd, value).plus(shared, &noise.systematic_root).matrix();
        innovation_covariance(value, &with, noise)
    }

    /// The covariance with what the clocks may add.
    pub fn told(&self) -> Spread {
        let mut spread = self.spread;
        self.sources.add_told(&mut spread);
        spread
    }

    /// The same if the process noise had made only these shares of what it has in value and rate.
    pub fn told_sharing(&self, of_value: &Vector3<f64>, of_rate: &Vector3<f64>) -> Spread {
        let mut spread = self.disturbed.without(&self.spread, (of_value, of_rate));
        self.sources.add_told(&mut spread);
        spread
    }

    /// How quickly it follows along each axis, 1/s.
    pub fn bandwidth_hz(&self) -> Vector3<f64> {
        self.disturbed.bandwidth_hz()
    }

    /// What measurements' noise has made of the rate's variance along each axis, were the clocks known.
    pub fn rate_noise(&self) -> Vector3<f64> {
        let noise = self.spread.rate.diagonal() - self.disturbed.rate;
        noise.map(|variance| variance.max(0.0))
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
}

/// S = A + Cp Lᵀ + L Cpᵀ + R, of A, `with` = A + Cp Lᵀ and R.
#[inline(always)]
fn innovation_covariance(value: &Matrix3<f64>, with: &Matrix3<f64>, noise: &Noise) -> Matrix3<f64> {
    with + (with - value).transpose() + noise.total
}

/// Up to here a series stands in for the exponential.
const SMALL_DECAY: f64 = 0.1;

/// exp(-x).
pub(super) fn decayed(x: f64) -> f64 {
    if x > SMALL_DECAY {
        return (-x).exp();
    }
    (1..=9).rev().fold(1.0, |sum, order| 1.0 - x * (1.0 / f64::from(order)) * sum)
}

#[cfg(test)]
mod tests;
