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
//! - update: with u_j = qp_j - [j = c] v, the innovation's sensitivity to ε_j, q_j ← q_j - K u_j. The gain is that of
//!   M + Σ σ_j² qp_j u_jᵀ, N + Σ σ_j² qv_j u_jᵀ and S + Σ σ_j² u_j u_jᵀ + σ_c² D (v has the covariance D), and
//!   P ← P - K Mᵀ - M Kᵀ + K (S + σ_c² D) Kᵀ, as for any gain.
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

use super::{BlockCovariance, BlockTraces, MotionModel};
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
    pub covariance: BlockCovariance,
    /// Derivatives dp and dv of value and rate over ln q.
    value_slope: Vector3<f64>,
    rate_slope: Vector3<f64>,
    process_noise: ProcessNoiseShare,
    considered: ConsideredErrors,
}

/// Noise of a measurement and the camera that it belongs to.
#[derive(Clone, Copy, Debug)]
pub struct ErrorSource<'a> {
    /// Error of the measurement.
    pub noise: &'a Noise,
    /// Camera whose systematic error it has.
    pub camera: CameraId,
}

/// Covariance of the value after `dt` seconds, and the share that systematic errors have kept then.
struct PredictedValue {
    covariance: Matrix3<f64>,
    dt: f64,
    kept: f64,
}

impl Kalman {
    /// Filter after one measurement of the value. The rate is zero with this variance along each axis.
    pub fn begin(noise: &Noise, camera: CameraId, rate_variance: &Vector3<f64>) -> Self {
        Self {
            rate: Vector3::zeros(),
            covariance: BlockCovariance {
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
        self.covariance.predict(dt, density);
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
        source: ErrorSource<'_>,
    ) -> Option<Innovation> {
        let ErrorSource { noise, camera } = source;
        let prediction = PredictedValue {
            covariance: self.covariance.value_after(dt, &model.acceleration_density_m2_s3),
            dt,
            kept: decayed(dt.abs() / model.systematic_time_s),
        };
        let own = self.considered.find(camera);
        let mut covariance = dispatch!(Level::new(), simd => {
            self.innovation_with(simd, &prediction, own, noise)
        });
        if noise.timing_s > 0.0 {
            covariance += self.covariance.rate * noise.timing_s.powi(2);
            covariance +=
                self.considered.innovation_clock_covariance(dt, own, noise.timing_s, &self.rate);
        }
        Innovation::new(residual, &covariance)
    }

    /// S for known clocks.
    #[simd]
    fn innovation_with<S: Simd>(
        &self,
        simd: S,
        prediction: &PredictedValue,
        own: Option<usize>,
        noise: &Noise,
    ) -> Matrix3<f64> {
        let PredictedValue { covariance, dt, kept } = prediction;
        let Some(own) = own else { return covariance + noise.total };
        let correlation = self.considered.correlation(simd, own);
        let shared = correlation.value.add_scaled(correlation.rate, *dt).scaled(*kept);
        let with = Block::from_matrix(simd, covariance)
            .add_product(shared, &noise.systematic_root)
            .matrix();
        innovation_covariance(covariance, &with, noise)
    }

    /// Covariance with the clock errors.
    pub fn reported(&self) -> BlockCovariance {
        let mut covariance = self.covariance;
        self.considered.add_clock_covariance(&mut covariance);
        covariance
    }

    /// The same with only these shares of the process noise's part in value and rate.
    pub fn reported_with_shares(
        &self,
        value_share: &Vector3<f64>,
        rate_share: &Vector3<f64>,
    ) -> BlockCovariance {
        let mut covariance =
            self.process_noise.with_shares(&self.covariance, value_share, rate_share);
        self.considered.add_clock_covariance(&mut covariance);
        covariance
    }

    /// Bandwidth along each axis, 1/s.
    pub fn bandwidth_hz(&self) -> Vector3<f64> {
        self.process_noise.bandwidth_hz()
    }

    /// Part of the rate's variance along each axis that stems from measurement noise, for known clocks.
    pub fn rate_measurement_noise(&self) -> Vector3<f64> {
        let noise = self.covariance.rate.diagonal() - self.process_noise.rate;
        noise.map(|variance| variance.max(0.0))
    }

    /// Traces of the blocks of [`Kalman::reported`].
    pub fn reported_traces(&self) -> BlockTraces {
        let covariance = &self.covariance;
        let [value, cross, rate] = self.considered.reported_traces();
        BlockTraces {
            value: covariance.value.trace() + value,
            cross: covariance.cross.trace() + cross,
            rate: covariance.rate.trace() + rate,
        }
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
