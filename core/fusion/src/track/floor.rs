//! Floor constraint of objects that drive: height and upright normal as measurements.
//!
//! The error of the floor's height at a place (unevenness of floor and robot) does not average out, so it is a
//! systematic one. The constraint is applied only while the cameras are less certain than the floor: an object that
//! several cameras measure better than the floor is even is not constrained.

use nalgebra::{Matrix3, Vector3};

use super::{Ground, Kalman, Noise};
use roundel_vision::id::CameraId;

/// Pseudo camera that owns the floor's systematic error.
const FLOOR_SOURCE: CameraId = CameraId(u32::MAX - 1);
/// The constraint applies while the variance exceeds this share of the floor's.
const MIN_VARIANCE_RATIO: f64 = 0.8;
/// Systematic share of the floor's variance; below 1 to keep matrices positive definite.
const SYSTEMATIC_SHARE: f64 = 0.98;
/// Variance along unconstrained axes.
const UNCONSTRAINED: f64 = 1e4;

impl Ground {
    /// Constrains the height; returns the correction of the position.
    pub(super) fn constrain_height(&self, kalman: &mut Kalman, height_m: f64) -> Vector3<f64> {
        let Some(floor_m) = self.height_m else { return Vector3::zeros() };
        if kalman.covariance.value.m33 < MIN_VARIANCE_RATIO * self.deviation_m.powi(2) {
            return Vector3::zeros();
        }
        let noise = noise(Vector3::z(), self.deviation_m);
        let error_m = Vector3::new(0.0, 0.0, floor_m - height_m);
        kalman.update(&error_m, &noise, FLOOR_SOURCE, f64::INFINITY).value
    }

    /// Constrains the normal. `turn` is the rotation vector from the normal to vertical; returns the correction
    /// as a rotation vector.
    pub(super) fn constrain_tilt(&self, kalman: &mut Kalman, turn: &Vector3<f64>) -> Vector3<f64> {
        let variance = kalman.covariance.value.m11.max(kalman.covariance.value.m22);
        if variance < MIN_VARIANCE_RATIO * self.tilt_rad.powi(2) {
            return Vector3::zeros();
        }
        let noise = noise(Vector3::new(1.0, 1.0, 0.0), self.tilt_rad);
        kalman.update(turn, &noise, FLOOR_SOURCE, f64::INFINITY).value
    }
}

/// Noise of the components where `held` is 1.
fn noise(held: Vector3<f64>, deviation: f64) -> Noise {
    let variance = deviation * deviation;
    let total = held.map(|held| if held > 0.0 { variance } else { UNCONSTRAINED });
    Noise {
        total: Matrix3::from_diagonal(&total),
        systematic_root: Matrix3::from_diagonal(&(held * (deviation * SYSTEMATIC_SHARE.sqrt()))),
        timing_s: 0.0,
    }
}
