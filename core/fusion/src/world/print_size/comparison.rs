//! Scale of a print by two positions of one roundel.

use nalgebra::{Matrix3, Vector3};

use crate::{track::invert_positive, world::Landmark};

/// Standard deviation of an interpolated position, metres.
const INTERPOLATION_M: f64 = 0.002;
/// Largest squared Mahalanobis length of the two spare equations: χ², 2 degrees of freedom, 0.997.
const MAX_MISFIT: f64 = 11.8;
/// Smallest information of a comparison: that of a standard deviation of 2 %.
const MIN_INFORMATION: f64 = 2500.0;
/// Largest |ln k| that is considered.
pub(super) const MAX_LN: f64 = 0.6;

/// A position of a roundel, by a detection or a reference.
#[derive(Clone, Copy, Debug)]
pub(super) struct Position {
    /// The camera, or the reference itself; metres.
    pub origin_m: Vector3<f64>,
    /// Position relative to the origin, along the axes of the world, metres.
    pub arm_m: Vector3<f64>,
    /// Error of the detection.
    pub own: Matrix3<f64>,
    /// Error of the origin and its axes.
    pub origin: Matrix3<f64>,
}

/// Result of comparing two positions.
#[derive(Clone, Copy, Debug)]
pub(super) struct Comparison {
    /// ln k.
    pub ln: f64,
    /// Variance of `ln` by the errors of the detections.
    pub variance: f64,
    /// Variance of `ln` by the errors of the cameras' poses.
    pub pose_variance: f64,
}

impl From<&Landmark> for Position {
    fn from(reference: &Landmark) -> Self {
        let variance_m2 = reference.position_deviation_m.powi(2);
        Self {
            origin_m: reference.position_m,
            arm_m: Vector3::zeros(),
            own: Matrix3::zeros(),
            origin: Matrix3::from_diagonal_element(variance_m2),
        }
    }
}

/// Compares two positions; `None` if they are not of one roundel, or the scale is too uncertain.
pub(super) fn compare(first: &Position, second: &Position) -> Option<Comparison> {
    let across_m = first.arm_m - second.arm_m;
    let baseline_m = second.origin_m - first.origin_m;
    let squared_m2 = across_m.norm_squared();
    let limits = (-MAX_LN).exp()..MAX_LN.exp();
    if squared_m2 == 0.0 || !limits.contains(&(across_m.dot(&baseline_m) / squared_m2)) {
        return None;
    }
    let origins = first.origin + second.origin;
    let interpolation = Matrix3::from_diagonal_element(INTERPOLATION_M * INTERPOLATION_M);
    let covariance = first.own + second.own + origins + interpolation;
    let (weight, _) = invert_positive(&covariance)?;
    let weighted = weight * across_m;
    let information = weighted.dot(&across_m);
    let factor = weighted.dot(&baseline_m) / information;
    if !factor.is_finite() || factor <= 0.0 || information * factor * factor < MIN_INFORMATION {
        return None;
    }
    let rest_m = across_m * factor - baseline_m;
    if rest_m.dot(&(weight * rest_m)) > MAX_MISFIT * factor * factor {
        return None;
    }
    let gain = weighted / (information * factor);
    let pose_variance = gain.dot(&(origins * gain));
    let variance = (1.0 / (information * factor * factor) - pose_variance).max(f64::MIN_POSITIVE);
    Some(Comparison { ln: factor.ln(), variance, pose_variance })
}
