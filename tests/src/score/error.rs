//! Consistency of errors with their stated covariances.
//!
//! For an unbiased estimate with the right covariance, the normalized estimation error squared (NEES) eᵀ Σ⁻¹ e of n
//! degrees of freedom follows χ²(n) (Bar-Shalom, Li, Kirubarajan 2001, section 5.4): 95 % of those of positions lie
//! below 7.815.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// 95 % of χ² with one degree of freedom.
pub const CHI2_95_1: f64 = 3.841;
/// 95 % of χ² with two degrees of freedom.
pub const CHI2_95_2: f64 = 5.991;
/// 95 % of χ² with three degrees of freedom.
pub const CHI2_95_3: f64 = 7.815;

/// Errors of one quantity, with their normalized squares.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Errors {
    squares: Vec<f64>,
    normalized: Vec<f64>,
}

impl Errors {
    /// Adds one error's length and its normalized square.
    pub fn push(&mut self, length: f64, normalized: f64) {
        self.squares.push(length * length);
        self.normalized.push(normalized);
    }

    pub fn count(&self) -> usize {
        self.squares.len()
    }

    /// Root mean square of the lengths, or NaN without errors.
    pub fn rms(&self) -> f64 {
        (self.squares.iter().sum::<f64>() / self.count() as f64).sqrt()
    }

    /// The largest length, or 0 without errors.
    pub fn max(&self) -> f64 {
        self.squares.iter().copied().fold(0.0, f64::max).sqrt()
    }

    pub fn append(&mut self, mut other: Self) {
        self.squares.append(&mut other.squares);
        self.normalized.append(&mut other.normalized);
    }

    /// Share of normalized squares up to `bound`, or NaN without errors.
    pub fn share_within(&self, bound: f64) -> f64 {
        let inside = self.normalized.iter().filter(|square| **square <= bound).count();
        inside as f64 / self.count() as f64
    }

    /// Mean normalized square; equals the degrees of freedom if the covariances are right.
    pub fn mean_normalized(&self) -> f64 {
        self.normalized.iter().sum::<f64>() / self.count() as f64
    }
}

/// eᵀ Σ⁻¹ e, or `None` unless Σ is positive definite and all numbers are finite.
pub fn normalized3(error: &Vector3<f64>, covariance: &Matrix3<f64>) -> Option<f64> {
    let square = error.dot(&covariance.cholesky()?.solve(error));
    square.is_finite().then_some(square)
}

/// Angle between two unit normals and its normalized square under a rotation's covariance (left perturbation, same
/// frame). Only the two rotations perpendicular to the normal change it.
pub fn normal_error(
    normal: &Vector3<f64>,
    true_normal: &Vector3<f64>,
    rotation: &Matrix3<f64>,
) -> Option<(f64, f64)> {
    let axis = normal.cross(true_normal);
    let angle = axis.norm().atan2(normal.dot(true_normal));
    let turn = axis.try_normalize(0.0).map_or(Vector3::zeros(), |unit| unit * angle);
    let helper = if normal.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
    let across = normal.cross(&helper).normalize();
    let along = normal.cross(&across);
    let seen = |one: &Vector3<f64>, other: &Vector3<f64>| (one.transpose() * rotation * other)[0];
    let covariance = Matrix2::new(
        seen(&across, &across),
        seen(&across, &along),
        seen(&along, &across),
        seen(&along, &along),
    );
    let error = Vector2::new(turn.dot(&across), turn.dot(&along));
    let square = error.dot(&covariance.cholesky()?.solve(&error));
    square.is_finite().then_some((angle, square))
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;

    #[test]
    fn a_normal_error_ignores_rotation_about_the_normal() {
        let covariance = Matrix3::from_diagonal(&Vector3::new(1e-4, 4e-4, 3.3));
        let tilted = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.02) * Vector3::z();
        let (angle, square) = normal_error(&Vector3::z(), &tilted, &covariance).unwrap();
        assert!((angle - 0.02).abs() < 1e-12);
        assert!((square - 1.0).abs() < 1e-9);
    }
}
