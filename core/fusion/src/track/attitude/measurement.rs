//! How one detection says that its roundel is turned, in the world.
//!
//! Two candidates, of the two normals that an ellipse allows. A plain roundel shows its normal only. Its
//! measured orientation is then the predicted one turned by the smallest rotation onto the measured normal:
//! nothing is said about the rest, so that the variance about the *predicted* normal is a large one. (About the
//! measured one it would be in the tilt as well, as soon as the two differ.)

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::smallest_turn;
use crate::track::Noise;
use roundel_vision::rigid::{
    orientation_of_normal, smallest_rotation, smallest_rotation_of, turned_covariance,
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
    /// Error of the first one's small rotation; where no yaw is measured, of the tilt alone.
    pub noise: Noise,
    /// The same of the second one; `None`: the first one's, turned along.
    pub other_noise: Option<Noise>,
}

impl AttitudeMeasurement {
    /// `noise` belongs to the first candidate; the second one's is the same, turned along.
    pub fn new(
        candidates: [UnitQuaternion<f64>; 2],
        likelihood: f64,
        yaw_symmetry: Option<u32>,
        mut noise: Noise,
    ) -> Self {
        if yaw_symmetry.is_none() {
            let systematic = noise.systematic_root * noise.systematic_root.transpose();
            let of_tilt = of_tilt(&candidates[0], (&noise.total, &systematic));
            noise = Noise { timing_s: noise.timing_s, ..of_tilt };
        }
        Self { candidates, likelihood, yaw_symmetry, noise, other_noise: None }
    }

    /// The same by the covariances of the whole error and of the part that stays, of a camera whose clock is right.
    pub(crate) fn of_covariances(
        candidates: [UnitQuaternion<f64>; 2],
        likelihood: f64,
        yaw_symmetry: Option<u32>,
        (total, systematic): (&Matrix3<f64>, &Matrix3<f64>),
    ) -> Self {
        let noise = if yaw_symmetry.is_none() {
            of_tilt(&candidates[0], (total, systematic))
        } else {
            Noise::of(*total, systematic)
        };
        Self { candidates, likelihood, yaw_symmetry, noise, other_noise: None }
    }

    /// Error of a candidate's small rotation. PERF: the second one's is made when it is asked for, since the mirrored
    /// normal is mostly not looked at.
    pub fn noise_of(&self, index: usize) -> Noise {
        match &self.other_noise {
            _ if index == 0 => self.noise,
            Some(noise) => *noise,
            None => self.turned_along(),
        }
    }

    /// Changes both candidates' errors.
    pub(crate) fn change_noises(&mut self, change: impl Fn(&mut Noise)) {
        let mut other = self.noise_of(1);
        change(&mut other);
        change(&mut self.noise);
        self.other_noise = Some(other);
    }

    /// Says how uncertain its camera's clock is, seconds.
    pub(in crate::track) fn set_timing(&mut self, timing_s: f64) {
        self.noise.timing_s = timing_s;
        if let Some(other) = &mut self.other_noise {
            other.timing_s = timing_s;
        }
    }

    /// rᵀRr of a candidate's error. PERF: of one that is turned along, r is turned back, and not R.
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

    fn turned_along(&self) -> Noise {
        let normals = [0, 1].map(|index| self.normal(index));
        let turn = smallest_rotation(&normals[0], &normals[1]).unwrap_or_else(|| {
            UnitQuaternion::from_scaled_axis(smallest_turn(&normals[0], &normals[1]))
                .to_rotation_matrix()
                .into_inner()
        });
        Noise {
            total: turned_covariance(&turn, &self.noise.total),
            // Turned from both sides, so that the same part of the systematic error goes on meaning
            // nearly the same direction when the candidates change places.
            systematic_root: turn * self.noise.systematic_root * turn.transpose(),
            timing_s: self.noise.timing_s,
        }
    }

    /// The same from what has the normal `from`; about it, where no yaw is measured, with that variance.
    pub(super) fn noise_from(&self, index: usize, (from, variance): (&Vector3<f64>, f64)) -> Noise {
        let mut noise = self.noise_of(index);
        if self.yaw_symmetry.is_none() {
            noise.total += from * from.transpose() * variance;
        }
        noise
    }

    /// A candidate's normal.
    pub(super) fn normal(&self, index: usize) -> Vector3<f64> {
        self.candidates[index] * Vector3::z()
    }

    /// That a candidate is the right one.
    pub(super) fn chance(&self, index: usize) -> f64 {
        // A pose estimator's certainty is not believed beyond a thousand to one.
        let first = self.likelihood.clamp(1e-3, 1.0 - 1e-3);
        if index == 0 { first } else { 1.0 - first }
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
fn of_tilt(
    candidate: &UnitQuaternion<f64>,
    (total, systematic): (&Matrix3<f64>, &Matrix3<f64>),
) -> Noise {
    let normal = candidate * Vector3::z();
    let along = normal * normal.transpose();
    let across = Matrix3::identity() - along;
    // Positive definite, whatever the predicted normal.
    let filled = |whole: &Matrix3<f64>| {
        let tilt = turned_covariance(&across, whole);
        tilt + along * (0.5 * tilt.trace())
    };
    let noise = Noise::of(filled(total), &filled(systematic));
    Noise { systematic_root: across * noise.systematic_root, ..noise }
}
