//! Functions of time with their first three derivatives (jets).
//!
//! Velocity, acceleration and jerk of a closed-form path follow from the same expression by the product and chain rules, so
//! they are consistent.

use std::ops::{Add, Mul};

/// Value and first three derivatives at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Jet(pub [f64; 4]);

/// A sinusoid, amplitude · sin(rate · t + phase).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Wave {
    /// In the unit of the value.
    pub amplitude: f64,
    /// Angular rate, rad/s.
    pub rate_rad_s: f64,
    /// Phase at time zero, radians.
    pub phase_rad: f64,
}

impl Jet {
    pub fn constant(value: f64) -> Self {
        Self([value, 0.0, 0.0, 0.0])
    }

    /// offset + rate · t at time `t`.
    pub fn linear(offset: f64, rate: f64, t: f64) -> Self {
        Self([offset + rate * t, rate, 0.0, 0.0])
    }

    pub fn scale(self, factor: f64) -> Self {
        Self(self.0.map(|x| x * factor))
    }

    /// By Faà di Bruno's formula to third order.
    pub fn sin_cos(self) -> (Self, Self) {
        let [u, u1, u2, u3] = self.0;
        let (s, c) = u.sin_cos();
        let sine = [s, c * u1, c * u2 - s * u1 * u1, c * (u3 - u1.powi(3)) - 3.0 * s * u1 * u2];
        let cosine =
            [c, -s * u1, -s * u2 - c * u1 * u1, -s * (u3 - u1.powi(3)) - 3.0 * c * u1 * u2];
        (Self(sine), Self(cosine))
    }
}

impl Wave {
    /// Value and derivatives at time `t`.
    pub fn at(&self, t: f64) -> Jet {
        Jet::linear(self.phase_rad, self.rate_rad_s, t).sin_cos().0.scale(self.amplitude)
    }
}

impl Add for Jet {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + other.0[i]))
    }
}

impl Mul for Jet {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        let ([a, a1, a2, a3], [b, b1, b2, b3]) = (self.0, other.0);
        Self([
            a * b,
            a1 * b + a * b1,
            a2 * b + 2.0 * a1 * b1 + a * b2,
            a3 * b + 3.0 * (a2 * b1 + a1 * b2) + a * b3,
        ])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn expression(t: f64) -> Jet {
        let wave = Wave { amplitude: 0.4, rate_rad_s: 1.7, phase_rad: 0.3 };
        let angle = Jet::linear(0.2, 0.9, t) + wave.at(t);
        let (sine, cosine) = angle.sin_cos();
        (Jet::constant(2.0) + sine.scale(0.5)) * cosine
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let step = 1e-4;
        for t in [-3.0, 0.0, 0.7, 12.5] {
            let (before, here, after) = (expression(t - step), expression(t), expression(t + step));
            for order in 0..3 {
                let difference = (after.0[order] - before.0[order]) / (2.0 * step);
                assert!(
                    (difference - here.0[order + 1]).abs() < 1e-6,
                    "order {order} at {t}: {difference} against {}",
                    here.0[order + 1]
                );
            }
        }
    }
}
