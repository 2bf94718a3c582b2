//! The covariance of a value in three dimensions and its rate.

use nalgebra::{Matrix3, Matrix6, Vector3};

/// Covariance over (value, rate) in blocks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Of the value: A.
    pub value: Matrix3<f64>,
    /// Between value (rows) and rate (columns): B.
    pub cross: Matrix3<f64>,
    /// Of the rate: D.
    pub rate: Matrix3<f64>,
}

impl Spread {
    /// F P Fᵀ + Q over `dt` seconds (either sign; the noise grows with |dt|), with the noise's
    /// density along each axis.
    pub fn predict(&mut self, dt: f64, density: &Vector3<f64>) {
        let squared = dt * dt;
        for row in 0..3 {
            for column in 0..=row {
                let both = self.cross[(row, column)] + self.cross[(column, row)];
                let sum =
                    self.value[(row, column)] + (both * dt + self.rate[(row, column)] * squared);
                self.value[(row, column)] = sum;
                self.value[(column, row)] = sum;
            }
        }
        self.cross += self.rate * dt;
        self.disturb(dt, density);
    }

    /// The value's part of that; nothing else is computed.
    pub fn value_after(&self, dt: f64, density: &Vector3<f64>) -> Matrix3<f64> {
        let (squared, span) = (dt * dt, dt.abs());
        let mut value = Matrix3::zeros();
        for row in 0..3 {
            for column in 0..=row {
                let both = self.cross[(row, column)] + self.cross[(column, row)];
                let sum =
                    self.value[(row, column)] + (both * dt + self.rate[(row, column)] * squared);
                value[(row, column)] = sum;
                value[(column, row)] = sum;
            }
            value[(row, row)] += density[row] * span * span * span / 3.0;
        }
        value
    }

    /// What process noise of this density adds over `dt` seconds.
    pub fn disturb(&mut self, dt: f64, density: &Vector3<f64>) {
        let span = dt.abs();
        for axis in 0..3 {
            let q = density[axis];
            self.value[(axis, axis)] += q * span * span * span / 3.0;
            self.cross[(axis, axis)] += q * dt * span / 2.0;
            self.rate[(axis, axis)] += q * span;
        }
    }

    /// The whole 6×6.
    pub fn matrix(&self) -> Matrix6<f64> {
        let mut whole = Matrix6::zeros();
        whole.fixed_view_mut::<3, 3>(0, 0).copy_from(&self.value);
        whole.fixed_view_mut::<3, 3>(0, 3).copy_from(&self.cross);
        whole.fixed_view_mut::<3, 3>(3, 0).copy_from(&self.cross.transpose());
        whole.fixed_view_mut::<3, 3>(3, 3).copy_from(&self.rate);
        whole
    }

    /// The blocks of a symmetric 6×6.
    pub fn from_matrix(whole: &Matrix6<f64>) -> Self {
        Self {
            value: whole.fixed_view::<3, 3>(0, 0).into_owned(),
            cross: whole.fixed_view::<3, 3>(0, 3).into_owned(),
            rate: whole.fixed_view::<3, 3>(3, 3).into_owned(),
        }
    }
}
