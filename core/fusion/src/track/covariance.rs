//! Covariance of a three-dimensional value and its rate.

use nalgebra::{Matrix3, Matrix6, Vector3};

/// Covariance over (value, rate) in 3×3 blocks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockCovariance {
    /// Block A of the value.
    pub value: Matrix3<f64>,
    /// Block B between value (rows) and rate (columns).
    pub cross: Matrix3<f64>,
    /// Block D of the rate.
    pub rate: Matrix3<f64>,
}

/// Traces of the blocks of a [`BlockCovariance`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockTraces {
    /// Trace of the value's block.
    pub value: f64,
    /// Trace of the block between value and rate.
    pub cross: f64,
    /// Trace of the rate's block.
    pub rate: f64,
}

impl BlockCovariance {
    /// F P Fᵀ + Q over `dt` seconds (either sign; the noise grows with |dt|). `density` is the process noise's
    /// along each axis.
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
        self.add_process_noise(dt, density);
    }

    /// Value block after [`Self::predict`].
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

    /// Adds process noise of this density over `dt` seconds.
    pub fn add_process_noise(&mut self, dt: f64, density: &Vector3<f64>) {
        let span = dt.abs();
        for axis in 0..3 {
            let q = density[axis];
            self.value[(axis, axis)] += q * span * span * span / 3.0;
            self.cross[(axis, axis)] += q * dt * span / 2.0;
            self.rate[(axis, axis)] += q * span;
        }
    }

    /// The full 6×6 matrix.
    pub fn matrix(&self) -> Matrix6<f64> {
        let mut whole = Matrix6::zeros();
        whole.fixed_view_mut::<3, 3>(0, 0).copy_from(&self.value);
        whole.fixed_view_mut::<3, 3>(0, 3).copy_from(&self.cross);
        whole.fixed_view_mut::<3, 3>(3, 0).copy_from(&self.cross.transpose());
        whole.fixed_view_mut::<3, 3>(3, 3).copy_from(&self.rate);
        whole
    }

    /// Blocks of a symmetric 6×6 matrix.
    pub fn from_matrix(whole: &Matrix6<f64>) -> Self {
        Self {
            value: whole.fixed_view::<3, 3>(0, 0).into_owned(),
            cross: whole.fixed_view::<3, 3>(0, 3).into_owned(),
            rate: whole.fixed_view::<3, 3>(3, 3).into_owned(),
        }
    }
}
