//! What of a filter's covariance its process noise has made.
//!
//! With the gain K, P ← (I - K H) P (I - K H)ᵀ + K R Kᵀ is linear in the process noise Q and in the measurements'
//! R, so that P = N + M, each obeying its own half of it. M, the noise's part, is carried along each axis by
//! itself, with the diagonals of the gains.

use nalgebra::Vector3;

use crate::track::Spread;

/// A filter follows no quicker than by this times the ratio of its gains of rate and value, which is ω/√2 in the
/// steady state.
const QUICKEST: f64 = 2.0;

/// Along each axis, of value, between value and rate, and of rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Disturbed {
    pub(super) value: Vector3<f64>,
    cross: Vector3<f64>,
    pub(super) rate: Vector3<f64>,
    /// The newest gains' ratio, rate by value, 1/s.
    gains_hz: Vector3<f64>,
}

impl Default for Disturbed {
    fn default() -> Self {
        let none = Vector3::zeros();
        Self { value: none, cross: none, rate: none, gains_hz: Vector3::repeat(f64::INFINITY) }
    }
}

impl Disturbed {
    /// As [`Spread::predict`] has it.
    #[inline]
    pub(super) fn predict(&mut self, dt: f64, density: &Vector3<f64>) {
        self.value += self.cross * (2.0 * dt) + self.rate * (dt * dt);
        self.cross += self.rate * dt;
        self.disturb(dt, density);
    }

    /// As [`Spread::disturb`] has it.
    #[inline]
    pub(super) fn disturb(&mut self, dt: f64, density: &Vector3<f64>) {
        let span = dt.abs();
        self.value += density * (span * span * span / 3.0);
        self.cross += density * (dt * span / 2.0);
        self.rate += density * span;
    }

    /// By a measurement with the gains of value and rate.
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

    /// The covariance if the process noise had made only these shares of value and rate.
    pub(super) fn without(
        &self,
        whole: &Spread,
        (of_value, of_rate): (&Vector3<f64>, &Vector3<f64>),
    ) -> Spread {
        let factor = |part: &Vector3<f64>, whole: Vector3<f64>, share: &Vector3<f64>| {
            let part = part.zip_map(&whole, |part, whole| (part / whole).clamp(0.0, 1.0));
            part.zip_map(share, |part, share| (1.0 - part * (1.0 - share)).sqrt())
        };
        let value = factor(&self.value, whole.value.diagonal(), of_value);
        let rate = factor(&self.rate, whole.rate.diagonal(), of_rate);
        Spread {
            value: whole.value.component_mul(&(value * value.transpose())),
            cross: whole.cross.component_mul(&(value * rate.transpose())),
            rate: whole.rate.component_mul(&(rate * rate.transpose())),
        }
    }

    /// How quickly the filter follows, 1/s: in the steady state M is [¼√2 ω r, …; …, ¾√2 ω³ r].
    ///
    /// That is so while ω is small against the measurements' rate. Of a value that each measurement tells exactly M has
    /// nothing left, and ω would have no end; but what has happened since the one before, dt ago, is not known, so that
    /// it is 2 to 4/dt, and the gains are 1 and 1.27/dt (the discrete filter's steady state as R → 0).
    pub(super) fn bandwidth_hz(&self) -> Vector3<f64> {
        let followed = self.rate.zip_map(&self.value, |rate, value| {
            if value > 0.0 { (rate / (3.0 * value)).sqrt() } else { 0.0 }
        });
        followed.inf(&(self.gains_hz * QUICKEST))
    }
}
