//! Camera pose from roundels at known positions.
//!
//! [`identify`] finds the references among the detected roundels by their mutual distances; [`align`] gives
//! `world_from_camera` from three or more pairs by weighted least squares, with covariance, and is the method of
//! choice; [`mean_over_triplets`] is the paper's (section 4.4.1, as a rigid motion: see [`roundel_vision::errata`] on
//! eq. 11); [`Homography`] is the 2D case (section 4.4.2). [`place_camera`] does both steps.
//!
//! All lengths are in metres; indices in results and errors count from 0 in the order given.

mod align;
mod homography;
mod identify;

use nalgebra::{Matrix3, Vector3};
use thiserror::Error;

pub use align::{align, align_stated, kabsch, mean_over_triplets, spread};
pub use homography::{Homography, HomographyError};
pub use identify::identify;
use roundel_vision::{
    pose::RoundelPose,
    rigid::{Covariance6, Rigid},
};

/// Standard deviation of a reference's stated coordinates, metres: the millimetre of a tape measure.
pub const PLACE_SIGMA_M: f64 = 0.001;

/// A roundel at a known position in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reference {
    /// Centre, world frame, metres.
    pub position_m: Vector3<f64>,
    /// Unit normal of the printed face, world frame, if known (+z on a floor). It distinguishes layouts that are
    /// mirror images of each other, such as three roundels in an isosceles triangle, since a camera sees only
    /// faces that look towards it.
    pub normal: Option<Vector3<f64>>,
}

/// A detected roundel, possibly a reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Centre, camera frame, metres.
    pub position_m: Vector3<f64>,
    /// Covariance of the position, camera frame, m².
    pub covariance: Matrix3<f64>,
}

impl From<&RoundelPose> for Sighting {
    fn from(pose: &RoundelPose) -> Self {
        Self {
            position_m: pose.position_m,
            covariance: pose.covariance.fixed_view::<3, 3>(0, 0).into_owned(),
        }
    }
}

/// Pose of a camera, with the residuals of the references.
#[derive(Clone, Debug, PartialEq)]
pub struct Placement {
    /// Pose of the camera.
    pub world_from_camera: Rigid,
    /// Over (position, rotation), world frame, left perturbation.
    pub covariance: Covariance6,
    /// Distance of each reference from its detection, metres, in the order given.
    pub residuals_m: Vec<f64>,
    /// Their root mean square, metres.
    pub rms_m: f64,
    /// Scale of the world against the detections. Differs from 1 by errors of focal length, diameter or reference
    /// positions. Not applied.
    pub scale: f64,
}

/// Reason why references give no camera pose.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ReferenceError {
    /// Fewer than three references.
    #[error("expected at least 3 references with a place, found {found}")]
    TooFew {
        /// Number of references.
        found: usize,
    },
    /// The numbers of references and detections differ.
    #[error("expected as many sightings as references, {references}, found {sightings}")]
    Unpaired {
        /// Number of references.
        references: usize,
        /// Number of detections.
        sightings: usize,
    },
    /// A coordinate is not finite, or a covariance not positive definite.
    #[error("reference {index}: expected finite coordinates and a positive definite covariance")]
    NotFinite {
        /// Index of the pair.
        index: usize,
    },
    /// All on one line, so the rotation about it is undetermined.
    #[error(
        "expected references that are not in one line, found all within {spread_m:.4} m of one"
    )]
    Collinear {
        /// Root mean square distance from the line, metres.
        spread_m: f64,
    },
    /// Fewer than three detections.
    #[error("expected at least 3 roundels in view, found {found}")]
    TooFewSeen {
        /// Number of detections.
        found: usize,
    },
    /// No two detections have the distance of a pair of references.
    #[error(
        "references {first} and {second} are {expected_m:.3} m apart, and no two roundels in view are (nearest: {nearest_m:.3} m); check their places and that both are in view"
    )]
    NoSuchDistance {
        /// Index of one reference.
        first: usize,
        /// Index of the other.
        second: usize,
        /// Their distance, metres.
        expected_m: f64,
        /// Nearest distance between detections, metres.
        nearest_m: f64,
    },
    /// All distances exist, but no arrangement has them together.
    #[error(
        "no {wanted} roundels in view are arranged like the references; at best reference {index} is {residual_m:.3} m from its place; check it"
    )]
    Inconsistent {
        /// Number of references that must be identified.
        wanted: usize,
        /// Index of the reference that fits worst in the best arrangement.
        index: usize,
        /// Its residual, metres.
        residual_m: f64,
    },
    /// Several arrangements fit.
    #[error(
        "references {indices:?} cannot be distinguished: the layout looks the same with them exchanged; move one of them, or add a reference off the symmetry"
    )]
    Ambiguous {
        /// References that these arrangements assign to different detections.
        indices: Vec<usize>,
    },
}

/// Identifies the references among the detections and computes the camera's pose. Returns the placement, whose
/// residuals are those of the identified references, ascending, and for each reference the index of its
/// detection.
pub fn place_camera(
    references: &[Reference],
    sightings: &[Sighting],
) -> Result<(Placement, Vec<Option<usize>>), ReferenceError> {
    let found = identify(references, sightings)?;
    let (world_m, paired): (Vec<_>, Vec<_>) = references
        .iter()
        .zip(&found)
        .filter_map(|(reference, &index)| Some((reference.position_m, sightings[index?])))
        .unzip();
    Ok((align(&world_m, &paired)?, found))
}
