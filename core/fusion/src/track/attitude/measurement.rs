//! Orientation measurement by one detection, world frame.
//!
//! It has two candidates, from the two normals that an ellipse allows. A plain roundel shows its normal only. Its
//! measured orientation is the predicted one rotated by the smallest rotation onto the measured normal; the rest is
//! unknown, expressed by a large variance about the *predicted* normal. (About the measured normal it would leak into
//! the tilt as soon as the two differ.)

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::smallest_turn;
use crate::track::Noise;
use roundel_vision::rigid::{
    orientation_of_normal, smallest_rotation, smallest_rotation_of, turned_covariance,
};

/// Orientation of a roundel by one detection, world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AttitudeMeasurement {
    /// Orientations by both normals, the likelier first; only the z axes count for plain roundels.
    pub candidates: [UnitQuaternion<f64>; 2],
    /// Probability of the first one, 0.5 to 1.
    pub likelihood: f64,
    /// Number of evenly spaced yaws that look the same; `None` where the rotation about the normal is not
    /// measured.
    pub yaw_symmetry: Option<u32>,
    /// Error of the first candidate as a small rotation; without a measured yaw, of the tilt only.
    pub noise: Noise,
    /// Error of the second candidate; `None`: that of the first one, rotated to the second normal.
    pub other_noise: Option<Noise>,
}

impl AttitudeMeasurement {
    /// `noise` belongs to the first candidate; the second one's is the same, rotated to its normal.
    pub fn new(
        candidates: [UnitQuaternion<f64>; 2],
        likelihood: f64,
        yaw_symmetry: Option<u32>,
        mut noise: Noise,
    ) -> Self {
        if yaw_symmetry.is_none() {
            let systematic = noise.systematic_root * noise.systematic_root.transpose();
            let tilt = tilt_noise(&candidates[0], &noise.total, &systematic);
            noise = Noise { timing_s: noise.timing_s, ..tilt };
        }
        Self { candidates, likelihood, yaw_symmetry, noise, other_noise: None }
    }

    /// From the covariances of the whole error and of its systematic part, for an exact clock.
    pub(crate) fn from_covariances(
        candidates: [UnitQuaternion<f64>; 2],
        likelihood: f64,
        yaw_symmetry: Option<u32>,
        total: &Matrix3<f64>,
        systematic: &Matrix3<f64>,
    ) -> Self {
        let noise = if yaw_symmetry.is_none() {
            tilt_noise(&candidates[0], total, systematic)
        } else {
            Noise::from_covariances(*total, systematic)
        };
        Self { candidates, likelihood, yaw_symmetry, noise, other_noise: None }
    }

    /// Error of a candidate as a small rotation. PERF: computed on demand for the second one, since the mirrored
    /// normal is mostly not used.
    pub fn candidate_noise(&self, index: usize) -> Noise {
        match &self.other_noise {
            _ if index == 0 => self.noise,
            Some(noise) => *noise,
            None => self.mirrored_noise(),
        }
    }

    /// Applies `change` to the errors of both candidates.
    pub(crate) fn map_noises(&mut self, change: impl Fn(&mut Noise)) {
        let mut other = self.candidate_noise(1);
        change(&mut other);
        change(&mut self.noise);
        self.other_noise = Some(other);
    }

    /// Sets the standard deviation of the camera's clock, seconds.
    pub(crate) fn set_timing(&mut self, timing_s: f64) {
        self.noise.timing_s = timing_s;
        if let Some(other) = &mut self.other_noise {
            other.timing_s = timing_s;
        }
    }

    /// rᵀRr of a candidate's error. PERF: for a rotated error, r is rotated back instead of R.
    pub(super) fn variance_along(&self, index: usize, turn: &Vector3<f64>) -> f64 {
        if index == 0 {
            return turn.dot(&(self.noise.total * turn));
        }
        if let Some(noise) = &self.other_noise {
            return turn.dot(&(noise.total * turn));
        }
        let back = smallest_rotation_of(&self.normal(1), &self.normal(0), turn);
        back.map_or(f64::INFINITY, |back| back.dot(&(self.noise.total * back)))
    }

    fn mirrored_noise(&self) -> Noise {
        let normals = [0, 1].map(|index| self.normal(index));
        let turn = smallest_rotation(&normals[0], &normals[1]).unwrap_or_else(|| {
            UnitQuaternion::from_scaled_axis(smallest_turn(&normals[0], &normals[1]))
                .to_rotation_matrix()
                .into_inner()
        });
        Noise {
            total: turned_covariance(&turn, &self.noise.total),
            // Rotated from both sides, so that a component of the systematic error keeps nearly the same meaning
            // when the candidates change places.
            systematic_root: turn * self.noise.systematic_root * turn.transpose(),
            timing_s: self.noise.timing_s,
        }
    }

    /// Error against a state with the normal `from`. Without a measured yaw, it has that variance about the
    /// normal.
    pub(super) fn noise_from(&self, index: usize, from: &Vector3<f64>, variance: f64) -> Noise {
        let mut noise = self.candidate_noise(index);
        if self.yaw_symmetry.is_none() {
            noise.total += from * from.transpose() * variance;
        }
        noise
    }

    pub(super) fn normal(&self, index: usize) -> Vector3<f64> {
        self.candidates[index] * Vector3::z()
    }

    /// Probability that a candidate is the right one.
    pub(super) fn probability(&self, index: usize) -> f64 {
        // A pose estimator's certainty is limited to a thousand to one.
        let first = self.likelihood.clamp(1e-3, 1.0 - 1e-3);
        if index == 0 { first } else { 1.0 - first }
    }

    /// Orientation of a candidate; without a measured yaw, any orientation of its normal.
    pub(super) fn full_orientation(&self, index: usize) -> UnitQuaternion<f64> {
        if self.yaw_symmetry.is_some() {
            self.candidates[index]
        } else {
            orientation_of_normal(&self.normal(index))
        }
    }

    /// The orientation nearest to another among those in which the candidate looks the same.
    pub(super) fn nearest_symmetric(
        &self,
        index: usize,
        to: &UnitQuaternion<f64>,
    ) -> UnitQuaternion<f64> {
        let candidate = self.full_orientation(index);
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

/// Error of a rotation without the angle about the normal. That angle is unknown, so its variance is by far the
/// largest: in the triangular root of the whole covariance it would appear in all columns and change meaning with
/// every small tilt, and systematic tilts would look fresh.
fn tilt_noise(
    candidate: &UnitQuaternion<f64>,
    total: &Matrix3<f64>,
    systematic: &Matrix3<f64>,
) -> Noise {
    let normal = candidate * Vector3::z();
    let along = normal * normal.transpose();
    let across = Matrix3::identity() - along;
    // Positive definite for any predicted normal.
    let filled = |whole: &Matrix3<f64>| {
        let tilt = turned_covariance(&across, whole);
        tilt + along * (0.5 * tilt.trace())
    };
    let noise = Noise::from_covariances(filled(total), &filled(systematic));
    Noise { systematic_root: across * noise.systematic_root, ..noise }
}
