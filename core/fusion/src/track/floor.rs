//! What drives keeps to its floor: height and upright normal as measurements of their own.
//!
//! The floor's error (it is uneven, and so are robots) stays where it is, so that it is one of the
//! systematic kind, and is taken in only while the cameras know less: an object that several cameras
//! measure better than the floor is even is not held at all.

use nalgebra::{Matrix3, Vector3};

use super::{Ground, Kernel, Noise};
use roundel_vision::id::CameraId;

/// Whose systematic error the floor's is.
const FLOOR: CameraId = CameraId(u32::MAX - 1);
/// It is taken in where the variance is above this share of the floor's.
const NEEDED: f64 = 0.8;
/// Of the floor's variance so much is systematic: all but what keeps matrices positive.
const SYSTEMATIC: f64 = 0.98;
/// Variance of what the floor says nothing of.
const OPEN: f64 = 1e4;

impl Ground {
    /// Holds the height; gives the correction of the position.
    pub(super) fn hold_height(&self, kernel: &mut Kernel, height_m: f64) -> Vector3<f64> {
        let Some(held_m) = self.height_m else { return Vector3::zeros() };
        if kernel.spread.value.m33 < NEEDED * self.deviation_m.powi(2) {
            return Vector3::zeros();
        }
        let noise = noise(Vector3::z(), self.deviation_m);
        let off_m = Vector3::new(0.0, 0.0, held_m - height_m);
        kernel.update(&off_m, &noise, FLOOR, f64::INFINITY).value
    }

    /// Holds the normal; `turn` would turn it upright. Gives the rotation that corrects it.
    pub(super) fn hold_upright(&self, kernel: &mut Kernel, turn: &Vector3<f64>) -> Vector3<f64> {
        let known = kernel.spread.value.m11.max(kernel.spread.value.m22);
        if known < NEEDED * self.tilt_rad.powi(2) {
            return Vector3::zeros();
        }
        let noise = noise(Vector3::new(1.0, 1.0, 0.0), self.tilt_rad);
        kernel.update(turn, &noise, FLOOR, f64::INFINITY).value
    }
}

/// Of the components where `held` is 1.
fn noise(held: Vector3<f64>, deviation: f64) -> Noise {
    let variance = deviation * deviation;
    let total = held.map(|held| if held > 0.0 { variance } else { OPEN });
    Noise {
        total: Matrix3::from_diagonal(&total),
        systematic_root: Matrix3::from_diagonal(&(held * (deviation * SYSTEMATIC.sqrt()))),
        timing_s: 0.0,
    }
}
