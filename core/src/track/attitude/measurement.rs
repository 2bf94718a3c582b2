//! How one detection says that its roundel is turned, in the world.
//!
//! Two candidates, of the two normals that an ellipse allows. A plain roundel shows its normal only. Its
//! measured orientation is then the predicted one turned by the smallest rotation onto the measured normal:
//! nothing is said about the rest, so that the variance about the *predicted* normal is a large one. (About the
//! measured one it would be in the tilt as well, as soon as the two differ.)

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::smallest_turn;
use crate::{
    rigid::{orientation_of_normal, smallest_rotation},
    track::{Noise, positive_root},
};

/// How one detection says that the roundel is turned, world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AttitudeMeasurement {
    /// The orientations of both normals, the likelier first; of plain roundels only the z axes count.
    pub candidates: [UnitQuaternion<f64>; 2],
    /// Of the first one, 0.5 to 1.
    pub likelihood: f64,
    /// In how many evenly spaced yaws it looks the same; `None` where the rotation about the normal is not
    /// measured.
    pub yaw_symmetry: Option<u32>,
    /// Errors of the small rotation, of each candidate; where no yaw is measured, of the tilt alone.
    pub noises: [Noise; 2],
}

impl AttitudeMeasurement {
    /// `noise` belongs to the first candidate; the second one's is the same, turned along.
    pub fn new(
        candidates: [UnitQuaternion<f64>; 2],
        likelihood: f64,
        yaw_symmetry: Option<u32>,
        noise: Noise,
    ) -> Self {
        let normals = candidates.map(|candidate| candidate * Vector3::z());
        let noise = if yaw_symmetry.is_none() { of_tilt(&noise, &normals[0]) } else { noise };
        let turn = smallest_rotation(&normals[0], &normals[1]).unwrap_or_else(|| {
            UnitQuaternion::from_scaled_axis(smallest_turn(&normals[0], &normals[1]))
                .to_rotation_matrix()
                .into_inner()
        });
        let turned = Noise {
            total: turn * noise.total * turn.transpose(),
            // Turned from both sides, so that the same part of the systematic error goes on meaning
            // nearly the same direction when the candidates change places.
            systematic_root: turn * noise.systematic_root * turn.transpose(),
            timing_s: noise.timing_s,
        };
        Self { candidates, likelihood, yaw_symmetry, noises: [noise, turned] }
    }

    /// Error of a candidate's small rotation from what has the normal `from`; about it, where no yaw is measured,
    /// with that variance.
    pub(super) fn noise(&self, index: usize, (from, variance): (&Vector3<f64>, f64)) -> Noise {
        let mut noise = self.noises[index];
        if self.yaw_symmetry.is_none() {
            noise.total += from * from.transpose() * variance;
        }
        noise
    }

    /// A candidate's normal.
    pub(super) fn normal(&self, index: usize) -> Vector3<f64> {
        self.candidates[index] * Vector3::z()
    }

    /// A candidate's, of being the right one.
    pub(super) fn log_likelihood(&self, index: usize) -> f64 {
        // A pose estimator's certainty is not believed beyond a thousand to one.
        let first = self.likelihood.clamp(1e-3, 1.0 - 1e-3);
        if index == 0 { first.ln() } else { (1.0 - first).ln() }
    }

    /// A candidate's orientation; some orientation of its normal where no yaw is measured.
    pub(super) fn completed(&self, index: usize) -> UnitQuaternion<f64> {
        if self.yaw_symmetry.is_some() {
            self.candidates[index]
        } else {
            orientation_of_normal(&self.normal(index))
        }
    }

    /// Of the orientations in which the candidate looks the same, the one nearest to another.
    pub(super) fn nearest(&self, index: usize, to: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
        let candidate = self.completed(index);
        let symmetry = self.yaw_symmetry.unwrap_or(1);
        let part = std::f64::consts::TAU / f64::from(symmetry);
        let turned = |step: u32| {
            candidate * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), f64::from(step) * part)
        };
        (1..symmetry).map(turned).fold(candidate, |best, other| {
            if other.angle_to(to) < best.angle_to(to) { other } else { best }
        })
    }
}

/// What is left of a rotation's error without the angle about the normal. That angle is unknown, and so by far the
/// largest: in the triangular root of the whole it would be in all columns, and mean something else with every
/// little lean of the normal, so that tilts that stay would look like fresh ones.
fn of_tilt(noise: &Noise, normal: &Vector3<f64>) -> Noise {
    let along = normal * normal.transpose();
    let across = Matrix3::identity() - along;
    let tilt = |whole: &Matrix3<f64>| across * whole * across;
    let filled = |tilt: Matrix3<f64>| tilt + along * (0.5 * tilt.trace());
    let systematic = noise.systematic_root * noise.systematic_root.transpose();
    let root = positive_root(&filled(tilt(&systematic))).unwrap_or_else(Matrix3::zeros);
    Noise {
        // Positive definite, whatever the predicted normal.
        total: filled(tilt(&noise.total)),
        systematic_root: across * root,
        timing_s: noise.timing_s,
    }
}
