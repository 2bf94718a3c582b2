//! Measurement noise and innovations.

use nalgebra::{Matrix3, Vector3};

/// Error of a measurement: its whole covariance, and a root of the systematic part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Covariance R of the whole error.
    pub total: Matrix3<f64>,
    /// L with L Lᵀ the covariance of the systematic part; zero if there is none.
    pub systematic_root: Matrix3<f64>,
    /// Standard deviation of the camera's clock against the others', seconds; not contained in `total`.
    pub timing_s: f64,
}

impl Noise {
    /// From the covariances of the whole error and of its systematic part, for an exact clock.
    pub fn from_covariances(total: Matrix3<f64>, systematic: &Matrix3<f64>) -> Self {
        // A zero matrix has no Cholesky root and needs none.
        let systematic_root = cholesky_lower(systematic).unwrap_or_else(Matrix3::zeros);
        Self { total, systematic_root, timing_s: 0.0 }
    }
}

/// Size of an innovation and of its covariance. Comparing two takes one logarithm of their ratio instead of one
/// each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Innovation {
    /// Squared Mahalanobis length.
    pub distance_squared: f64,
    /// det S.
    pub determinant: f64,
}

impl Innovation {
    #[inline(always)]
    pub(super) fn new(residual: &Vector3<f64>, covariance: &Matrix3<f64>) -> Option<Self> {
        let (inverse, determinant) = invert_positive(covariance)?;
        Some(Self { distance_squared: residual.dot(&(inverse * residual)), determinant })
    }

    /// For a covariance that is not positive definite.
    pub(super) fn invalid() -> Self {
        Self { distance_squared: f64::INFINITY, determinant: 1.0 }
    }

    /// ln det S.
    pub fn log_det(&self) -> f64 {
        self.determinant.ln()
    }
}

/// Lower Cholesky factor; `None` if the matrix is not positive definite or not finite.
pub(crate) fn cholesky_lower(matrix: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let positive = |value: f64| (value.is_finite() && value > 0.0).then(|| value.sqrt());
    let l00 = positive(matrix[(0, 0)])?;
    let l10 = matrix[(1, 0)] / l00;
    let l20 = matrix[(2, 0)] / l00;
    let l11 = positive(matrix[(1, 1)] - l10 * l10)?;
    let l21 = (matrix[(2, 1)] - l20 * l10) / l11;
    let l22 = positive(matrix[(2, 2)] - l20 * l20 - l21 * l21)?;
    Some(Matrix3::new(l00, 0., 0., l10, l11, 0., l20, l21, l22))
}

/// Inverse and determinant of a symmetric positive definite matrix by its factors L D Lᵀ; as stable as
/// Cholesky's, without roots.
#[inline(always)]
pub fn invert_positive(matrix: &Matrix3<f64>) -> Option<(Matrix3<f64>, f64)> {
    let per = |pivot: f64| (pivot.is_finite() && pivot > 0.0).then(|| 1.0 / pivot);
    let d0 = matrix.m11;
    let p0 = per(d0)?;
    let (l10, l20) = (matrix.m21 * p0, matrix.m31 * p0);
    let d1 = matrix.m22 - l10 * matrix.m21;
    let p1 = per(d1)?;
    let rest = matrix.m32 - l20 * matrix.m21;
    let l21 = rest * p1;
    let d2 = matrix.m33 - l20 * matrix.m31 - l21 * rest;
    let p2 = per(d2)?;
    // The inverse of L, and from it that of the matrix.
    let i20 = l21 * l10 - l20;
    let (m02, m12) = (i20 * p2, -l21 * p2);
    let m01 = -l10 * p1 - l21 * m02;
    let (m00, m11) = (p0 + l10 * l10 * p1 + i20 * m02, p1 - l21 * m12);
    let inverse = Matrix3::new(m00, m01, m02, m01, m11, m12, m02, m12, p2);
    Some((inverse, d0 * d1 * d2))
}
