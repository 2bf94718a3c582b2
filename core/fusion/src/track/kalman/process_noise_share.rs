//! The part of a filter's covariance that process noise contributes.
//!
//! With the gain K, P ← (I - K H) P (I - K H)ᵀ + K R Kᵀ is linear in the process noise Q and the measurement noise R,
//! so that P = N + M, each obeying its half of the recursion. M, the part by process noise, is carried along each axis
//! separately, with the diagonals of the gains.

use nalgebra::Vector3;

use crate::track::BlockCovariance;

/// Largest bandwidth over the ratio of the gains of rate and value, which is ω/√2 in the steady state.
const MAX_GAIN_RATIO: f64 = 2.0;

/// Diagonal of M: value, between value and rate, rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ProcessNoiseShare {
    pub(super) value: Vector3<f64>,
    cross: Vector3<f64>,
    pub(super) rate: Vector3<f64>,
    /// Ratio of the newest gains, rate over value, 1/s.
    gains_hz: Vector3<f64>,
}

impl Default for ProcessNoiseShare {
    fn default() -> Self {
        let none = Vector3::zeros();
        Self { value: none, cross: none, rate: none, gains_hz: Vector3::repeat(f64::INFINITY) }
    }
}

impl ProcessNoiseShare {
    /// As [`BlockCovariance::predict`].
    #[inline]
    pub(super) fn predict(&mut self, dt: f64, density: &Vector3<f64>) {
        self.value += self.cross * (2.0 * dt) + self.rate * (dt * dt);
        self.cross += self.rate * dt;
        self.add_process_noise(dt, density);
    }

    /// As [`BlockCovariance::add_process_noise`].
    #[inline]
    pub(super) fn add_process_noise(&mut self, dt: f64, density: &Vector3<f64>) {
        let span = dt.abs();
        self.value += density * (span * span * span / 3.0);
        self.cross += density * (dt * span / 2.0);
        self.rate += density * span;
    }

    /// Update by a measurement with these gains.
    #[inline]
    pub(super) fn update(&mut self, value_gain: &Vector3<f64>, rate_gain: &Vector3<f64>) {
        self.gains_hz = value_gain.zip_map(rate_gain, |value, rate| {
            if value > 0.0 && rate > 0.0 { rate / value } else { f64::INFINITY }
        });
        let kept = value_gain.map(|gain| 1.0 - gain);
        let from_value = rate_gain.component_mul(&self.value);
        self.rate += rate_gain.component_mul(&(from_value - self.cross * 2.0));
        self.cross = kept.component_mul(&(self.cross - from_value));
        self.value = kept.component_mul(&kept).component_mul(&self.value);
    }

    /// `whole` with only these shares of the process noise's part in value and rate.
    pub(super) fn with_shares(
        &self,
        whole: &BlockCovariance,
        value_share: &Vector3<f64>,
        rate_share: &Vector3<f64>,
    ) -> BlockCovariance {
        let factor = |part: &Vector3<f64>, whole: Vector3<f64>, share: &Vector3<f64>| {
            let part = part.zip_map(&whole, |part, whole| (part / whole).clamp(0.0, 1.0));
            part.zip_map(share, |part, share| (1.0 - part * (1.0 - share)).sqrt())
        };
        let value = factor(&self.value, whole.value.diagonal(), value_share);
        let rate = factor(&self.rate, whole.rate.diagonal(), rate_share);
        BlockCovariance {
            value: whole.value.component_mul(&(value * value.transpose())),
            cross: whole.cross.component_mul(&(value * rate.transpose())),
            rate: whole.rate.component_mul(&(rate * rate.transpose())),
        }
    }

    /// Bandwidth of the filter, 1/s: in the steady state M is [¼√2 ω r, …; …, ¾√2 ω³ r].
    ///
    /// This holds while ω is small against the measurement rate. With exact measurements M of the value is zero
    /// and this ω would be infinite. What happened since the measurement before, dt ago, is unknown though, so ω
    /// is limited to 2 to 4/dt: the gains are then 1 and 1.27/dt (steady state of the discrete filter as R → 0).
    pub(super) fn bandwidth_hz(&self) -> Vector3<f64> {
        let followed = self.rate.zip_map(&self.value, |rate, value| {
            if value > 0.0 { (rate / (3.0 * value)).sqrt() } else { 0.0 }
        });
        followed.inf(&(self.gains_hz * MAX_GAIN_RATIO))
    }
}
