//! How a measurement errs, and how far it lies from what was predicted.

use nalgebra::{Matrix3, Vector3};

use super::super::spread::Spread;
use crate::id::CameraId;

/// A measurement's error: everything, and the root of the part that stays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Covariance R of the whole error.
    pub total: Matrix3<f64>,
    /// L with L Lᵀ the covariance of the systematic part; zero where nothing is systematic.
    pub systematic_root: Matrix3<f64>,
    /// Deviation of the camera's clock from the others', seconds; comes on top of `total`.
    pub timing_s: f64,
}

/// A camera's systematic error and the state, E[x̃ βᵀ], and its clock's error and the state, q.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Source {
    pub(super) camera: CameraId,
    pub(super) age_s: f64,
    pub(super) value: Matrix3<f64>,
    pub(super) rate: Matrix3<f64>,
    pub(super) value_by_clock: Vector3<f64>,
    pub(super) rate_by_clock: Vector3<f64>,
    /// σ.
    pub(super) timing_s: f64,
}

pub(super) const NO_SOURCE: Source = Source {
    camera: CameraId(u32::MAX),
    age_s: 0.0,
    value: Matrix3::new(0., 0., 0., 0., 0., 0., 0., 0., 0.),
    rate: Matrix3::new(0., 0., 0., 0., 0., 0., 0., 0., 0.),
    value_by_clock: Vector3::new(0., 0., 0.),
    rate_by_clock: Vector3::new(0., 0., 0.),
    timing_s: 0.0,
};

impl Source {
    /// What the clock's error adds to an innovation, each second; `own` the rate if it is the clock of
    /// the measurement's camera.
    pub(super) fn by_clock(&self, own: Option<&Vector3<f64>>) -> Vector3<f64> {
        own.map_or(self.value_by_clock, |rate| self.value_by_clock - rate)
    }

    /// `dt` seconds later, when the systematic error has kept this share.
    #[inline]
    pub(super) fn predict(&mut self, dt: f64, kept: f64) {
        self.age_s += dt.abs();
        self.value = (self.value + self.rate * dt) * kept;
        self.rate *= kept;
    }

    /// The same of the clock's error, which forgets nothing.
    #[inline]
    pub(super) fn predict_clock(&mut self, dt: f64) {
        self.value_by_clock += self.rate_by_clock * dt;
    }
}

/// How far a measurement lies from what was predicted. No logarithms here: who compares two takes
/// one of their ratio.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Innovation {
    /// Squared Mahalanobis length.
    pub distance_squared: f64,
    /// det S.
    pub determinant: f64,
    /// Of each component given the two others: squared length over variance, (Λν)ᵢ²/Λᵢᵢ, Λ = S⁻¹.
    pub conditional_squared: Vector3<f64>,
    /// And the reciprocal of that variance, Λᵢᵢ.
    pub conditional_precision: Vector3<f64>,
}

impl Innovation {
    pub(super) fn new(
        residual: &Vector3<f64>,
        weighted: &Vector3<f64>,
        inverse: &Matrix3<f64>,
        determinant: f64,
    ) -> Self {
        let precision = inverse.diagonal();
        Self {
            distance_squared: residual.dot(weighted),
            determinant,
            conditional_squared: weighted.component_mul(weighted).component_div(&precision),
            conditional_precision: precision,
        }
    }

    /// ln det S.
    pub fn log_det(&self) -> f64 {
        self.determinant.ln()
    }
}

/// Covariances of the errors of value and rate with an innovation, M and N, and of that, S.
#[derive(Clone, Copy)]
pub(super) struct Joint {
    pub(super) value: Matrix3<f64>,
    pub(super) rate: Matrix3<f64>,
    pub(super) innovation: Matrix3<f64>,
}

impl Joint {
    /// As if the clocks were known.
    #[inline]
    pub(super) fn of(spread: &Spread, source: Option<&Source>, noise: &Noise) -> Self {
        let mut joint = Self {
            value: spread.value,
            rate: spread.cross.transpose(),
            innovation: spread.value + noise.total,
        };
        if let Some(source) = source {
            let root_transposed = noise.systematic_root.transpose();
            let shared = source.value * root_transposed;
            joint.value += shared;
            joint.rate += source.rate * root_transposed;
            joint.innovation += shared + shared.transpose();
        }
        if noise.timing_s > 0.0 {
            joint.innovation += spread.rate * noise.timing_s.powi(2);
        }
        joint
    }

    /// With what a clock may add: `own` the rate if it is that of the measurement's camera.
    #[inline]
    fn add_clock(&mut self, source: &Source, timing_s: f64, own: Option<&Vector3<f64>>) {
        let by_clock = source.by_clock(own);
        let weighted = by_clock.transpose() * (timing_s * timing_s);
        self.value += source.value_by_clock * weighted;
        self.rate += source.rate_by_clock * weighted;
        self.innovation += by_clock * weighted;
    }

    /// With what all clocks may add, that of the measurement's camera among them.
    #[inline]
    pub(super) fn add_clocks(
        &mut self,
        sources: impl Iterator<Item = Source>,
        rate: &Vector3<f64>,
        (camera, timing_s): (CameraId, f64),
    ) {
        let mut known = false;
        for source in sources {
            let own = source.camera == camera;
            known |= own;
            let timing_s = if own { timing_s } else { source.timing_s };
            self.add_clock(&source, timing_s, own.then_some(rate));
        }
        if !known {
            self.add_clock(&NO_SOURCE, timing_s, Some(rate));
        }
    }

    pub(super) fn innovation(&self, residual: &Vector3<f64>) -> Option<Innovation> {
        let (inverse, determinant) = invert_positive(&self.innovation)?;
        Some(Innovation::new(residual, &(inverse * residual), &inverse, determinant))
    }
}

/// Lower Cholesky factor; `None` if the matrix is not positive definite (or not finite).
pub(crate) fn positive_root(matrix: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let positive = |value: f64| (value.is_finite() && value > 0.0).then(|| value.sqrt());
    let l00 = positive(matrix[(0, 0)])?;
    let l10 = matrix[(1, 0)] / l00;
    let l20 = matrix[(2, 0)] / l00;
    let l11 = positive(matrix[(1, 1)] - l10 * l10)?;
    let l21 = (matrix[(2, 1)] - l20 * l10) / l11;
    let l22 = positive(matrix[(2, 2)] - l20 * l20 - l21 * l21)?;
    Some(Matrix3::new(l00, 0., 0., l10, l11, 0., l20, l21, l22))
}

/// Inverse and determinant of a symmetric positive definite matrix, by its factors L D Lᵀ: as stable as
/// Cholesky's, without roots.
pub(crate) fn invert_positive(matrix: &Matrix3<f64>) -> Option<(Matrix3<f64>, f64)> {
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
    // The inverse of L, and from it that of the whole.
    let i20 = l21 * l10 - l20;
    let (m02, m12) = (i20 * p2, -l21 * p2);
    let m01 = -l10 * p1 - l21 * m02;
    let (m00, m11) = (p0 + l10 * l10 * p1 + i20 * m02, p1 - l21 * m12);
    let inverse = Matrix3::new(m00, m01, m02, m01, m11, m12, m02, m12, p2);
    Some((inverse, d0 * d1 * d2))
}
