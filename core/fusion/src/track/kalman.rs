//! Constant-velocity Kalman filter of a three-dimensional value and its rate, with systematic camera errors as consider
//! states.
//!
//! A measurement of camera c is z = p + L β_c + w. The noise w is fresh in each frame, the systematic part L β_c is
//! not. β_c (three numbers of unit variance) has an exponential autocorrelation with time constant τ: averaging a
//! thousand frames of one camera does not remove it, a second camera with its own β helps. β is not estimated but
//! considered (Schmidt, *Application of state-space methods to navigation problems*, 1966): the filter carries its
//! correlation with the state, and the gain accounts for it.
//!
//! With x = (p, v), P = [A B; Bᵀ D] and C_c = E[x̃ β_cᵀ] = [Cp; Cv]:
//!
//! - predict: P ← F P Fᵀ + Q, C ← ρ F C, ρ = exp(-dt/τ);
//! - update by camera c: M = A + Cp Lᵀ, N = Bᵀ + Cv Lᵀ (covariances of p̃ and ṽ with the innovation), S = A + Cp Lᵀ + L
//!   Cpᵀ + R, K = [M; N] S⁻¹, P ← P - K S Kᵀ, C_j ← C_j - K (Cp_j + [j = c] L).
//!
//! Clock errors are considered as well. A stamp t of a camera whose clock is off by ε belongs to the time t - ε, so
//! that z = p - v ε. ε has the standard deviation σ (the measurement's `timing_s`), is common to all measurements of
//! the camera, and does not decay. Since σ shrinks as the clocks are estimated, P is the covariance for known clocks,
//! and the sensitivity q_c = ∂x̃/∂ε_c is carried separately:
//!
//! - predict: q ← F q;
//! - update: with u_j = qp_j - [j = c] v, the innovation's sensitivity to ε_j, q_j ← q_j - K u_j; the gain is that of M
//!   + Σ σ_j² qp_j u_jᵀ, N + Σ σ_j² qv_j u_jᵀ and S + Σ σ_j² u_j u_jᵀ + σ_c² D (v has the covariance D), and P ← P - K
//!   Mᵀ - M Kᵀ + K (S + σ_c² D) Kᵀ, as for any gain.
//!
//! The reported covariance is P + Σ σ_j² q_j q_jᵀ ([`Kalman::reported`]).
//!
//! An innovation longer than the robust limit k (Mahalanobis) gets Huber's weight w = k/d; the covariance is then that
//! of the gain w K: P ← P - (2w - w²) K S Kᵀ.
//!
//! For adapting the process noise the filter also carries the sensitivity of value and rate to its density
//! ([`Correction::slope`], [`super::process_noise`]) and the part of P that process noise contributes
//! ([`Kalman::reported_with_shares`]).
//!
//! P stays positive definite: S ≥ R, R has a floor and P a ceiling (see `world::measurement`), so that the subtraction
//! keeps more than six digits. A property test drives it through the extremes.

mod block;
mod consider;
mod innovation;
mod process_noise_share;
mod update;

use fearless_simd::{Level, Simd, dispatch};
use fearless_simd_macros::simd;
use nalgebra::{Matrix3, Vector3};

use super::{BlockCovariance, MotionModel};
use block::Block;
use consider::ConsideredErrors;
pub(crate) use innovation::cholesky_lower;
pub use innovation::invert_positive;
pub use innovation::{Innovation, Noise};
use process_noise_share::ProcessNoiseShare;
use roundel_vision::id::CameraId;

/// Largest number of cameras with a considered error; the one without a measurement for longest is replaced.
pub const MAX_SOURCES: usize = 8;

/// Effect of a measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correction {
    /// Correction of the value.
    pub value: Vector3<f64>,
    /// Innovation of the measurement.
    pub innovation: Innovation,
    /// Derivative of the log-likelihood over ln q, along each axis.
    pub slope: Vector3<f64>,
}

/// Rate, covariance and considered errors. The value itself is held by the caller, who knows whether it is a
/// vector or a rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kalman {
    /// Rate of the value, per second.
    pub rate: Vector3<f64>,
    /// Covariance for known clocks.
    pub spread: BlockCovariance,
    /// Derivatives dp and dv of value and rate over ln q.
    value_slope: Vector3<f64>,
    rate_slope: Vector3<f64>,
    process_noise: ProcessNoiseShare,
    considered: ConsideredErrors,
}

impl Kalman {
    /// Filter after one measurement of the value. The rate is zero with this variance along each axis.
    pub fn begin(noise: &Noise, camera: CameraId, rate_variance: &Vector3<f64>) -> Self {
        Self {
            rate: Vector3::zeros(),
            spread: BlockCovariance {
                // The rate is unknown, and with it the effect of the clock error.
                value: noise.total
                    + Matrix3::from_diagonal(&(rate_variance * noise.timing_s.powi(2))),
                cross: Matrix3::zeros(),
                rate: Matrix3::from_diagonal(rate_variance),
            },
            value_slope: Vector3::zeros(),
            rate_slope: Vector3::zeros(),
            process_noise: ProcessNoiseShare::default(),
            considered: ConsideredErrors::begin(
                camera,
                &noise.systematic_root,
                noise.timing_s > 0.0,
            ),
        }
    }

    /// Predicts by `dt` seconds; the caller advances the value by `rate` · dt.
    pub fn predict(&mut self, dt: f64, density: &Vector3<f64>, systematic_time_s: f64) {
        self.spread.predict(dt, density);
        self.process_noise.predict(dt, density);
        self.value_slope += self.rate_slope * dt;
        self.considered.predict(dt, decayed(dt.abs() / systematic_time_s), systematic_time_s);
    }

    /// Innovation of `residual` (measured less predicted value) `dt` seconds from now. `None` if its covariance
    /// is not positive definite.
    pub fn innovation_after(
        &self,
        dt: f64,
        model: &MotionModel,
        residual: &Vector3<f64>,
        (noise, camera): (&Noise, CameraId),
    ) -> Option<Innovation> {
        let value = self.spread.value_after(dt, &model.acceleration_density_m2_s3);
        let kept = decayed(dt.abs() / model.systematic_time_s);
        self.innovation_from(&value, (dt, kept), residual, (noise, camera))
    }

    /// The same for a given predicted covariance of the value; `kept` is the remaining share of systematic
    /// errors.
    fn innovation_from(
        &self,
        value: &Matrix3<f64>,
        (dt, kept): (f64, f64),
        residual: &Vector3<f64>,
        (noise, camera): (&Noise, CameraId),
    ) -> Option<Innovation> {
        let own = self.considered.find(camera);
        let mut covariance = dispatch!(Level::new(), simd => {
            self.innovation_with(simd, value, (own, dt, kept), noise)
        });
        if noise.timing_s > 0.0 {
            covariance += self.spread.rate * noise.timing_s.powi(2);
            covariance +=
                self.considered.innovation_clock_covariance(dt, (own, noise.timing_s), &self.rate);
        }
        Innovation::new(residual, &covariance)
    }

    /// S for known clocks.
    #[simd]
    fn innovation_with<S: Simd>(
        &self,
        simd: S,
        value: &Matrix3<f64>,
        (own, dt, kept): (Option<usize>, f64, f64),
        noise: &Noise,
    ) -> Matrix3<f64> {
        let Some(own) = own else { return value + noise.total };
        let (value_share, rate_share) = self.considered.with(simd, own);
        let shared = value_share.add_scaled(rate_share, dt).scaled(kept);
        let with =
            Block::from_matrix(simd, value).add_product(shared, &noise.systematic_root).matrix();
        innovation_covariance(value, &with, noise)
    }

    /// Covariance with the clock errors.
    pub fn reported(&self) -> BlockCovariance {
        let mut spread = self.spread;
        self.considered.add_clock_covariance(&mut spread);
        spread
    }

    /// The same with only these shares of the process noise's part in value and rate.
    pub fn reported_with_shares(
        &self,
        value_share: &Vector3<f64>,
        rate_share: &Vector3<f64>,
    ) -> BlockCovariance {
        let mut spread = self.process_noise.without(&self.spread, (value_share, rate_share));
        self.considered.add_clock_covariance(&mut spread);
        spread
    }

    /// Bandwidth along each axis, 1/s.
    pub fn bandwidth_hz(&self) -> Vector3<f64> {
        self.process_noise.bandwidth_hz()
    }

    /// Part of the rate's variance along each axis that stems from measurement noise, for known clocks.
    pub fn rate_measurement_noise(&self) -> Vector3<f64> {
        let noise = self.spread.rate.diagonal() - self.process_noise.rate;
        noise.map(|variance| variance.max(0.0))
    }

    /// Traces of the blocks of [`Kalman::reported`].
    pub fn reported_traces(&self) -> (f64, f64, f64) {
        let spread = &self.spread;
        let [value, cross, rate] = self.considered.reported_traces();
        (spread.value.trace() + value, spread.cross.trace() + cross, spread.rate.trace() + rate)
    }

    /// Part of the value's covariance that stems from systematic errors, Σ Cp Cpᵀ.
    pub fn systematic_covariance(&self) -> Matrix3<f64> {
        self.considered.systematic_covariance()
    }
}

/// S = A + Cp Lᵀ + L Cpᵀ + R from A, `with` = A + Cp Lᵀ and R.
#[inline(always)]
fn innovation_covariance(value: &Matrix3<f64>, with: &Matrix3<f64>, noise: &Noise) -> Matrix3<f64> {
    with + (with - value).transpose() + noise.total
}

/// Largest argument for which a series replaces the exponential.
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
