//! Where a camera stands, from roundels with known places.
//!
//! [`identify`] finds out which seen roundel is which reference, by their mutual distances alone;
//! [`align`] gives `world_from_camera` from three or more pairs by weighted least squares, with
//! covariance, and is the method of choice; [`mean_over_triplets`] is the paper's (section 4.4.1, made
//! rigid: see [`roundel_vision::errata`] on eq. 11); [`Homography`] is the 2D case (section 4.4.2).
//! [`place_camera`] does both steps.
//!
//! Everything here is in metres; indices in results and errors count from 0 in the order given.

mod align;
mod homography;
mod identify;
mod kabsch;

use nalgebra::{Matrix3, Vector3};
use thiserror::Error;

pub use align::{align, align_stated, mean_over_triplets};
pub use homography::{Homography, HomographyError};
pub use identify::identify;
pub use kabsch::{kabsch, spread};
use roundel_vision::{
    pose::RoundelPose,
    rigid::{Covariance6, Rigid},
};

/// Standard deviation of a reference's stated place, each coordinate, metres: a tape's millimetre.
pub const PLACE_SIGMA_M: f64 = 0.001;

/// A roundel whose place in the world is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reference {
    /// Centre, world frame, metres.
    pub position_m: Vector3<f64>,
    /// Unit normal of the printed face, world frame, where known (+z on a floor). It tells layouts
    /// apart that are one another's mirror image, such as three roundels in an isosceles triangle:
    /// a camera sees only faces that look towards it.
    pub normal: Option<Vector3<f64>>,
}

/// A roundel that the camera sees, perhaps a reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Centre, camera frame, metres.
    pub position_m: Vector3<f64>,
    /// Of the position, camera frame, m².
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

/// A camera's place with how well the references agree on it.
#[derive(Clone, Debug, PartialEq)]
pub struct Placement {
    /// The camera in the world.
    pub world_from_camera: Rigid,
    /// Over (position, rotation), world frame, left perturbation.
    pub covariance: Covariance6,
    /// Distance of each reference from where the camera sees it, metres, in the order given.
    pub residuals_m: Vec<f64>,
    /// Their root mean square, metres.
    pub rms_m: f64,
    /// How much larger the world is than the camera sees it; 1 but for errors of focal length,
    /// diameter or reference places, which it gives away. Not applied.
    pub scale: f64,
}

/// Why references give no place.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ReferenceError {
    /// Less than a plane is known.
    #[error("expected at least 3 references with a place, found {found}")]
    TooFew {
        /// How many there are.
        found: usize,
    },
    /// Numbers of pairs differ.
    #[error("expected as many sightings as references, {references}, found {sightings}")]
    Unpaired {
        /// References given.
        references: usize,
        /// Sightings given.
        sightings: usize,
    },
    /// A coordinate is not a number, or a covariance not positive definite.
    #[error("reference {index}: expected finite coordinates and a positive definite covariance")]
    NotFinite {
        /// Which pair.
        index: usize,
    },
    /// All in one line: the camera could turn about it.
    #[error(
        "expected references that are not in one line, found all within {spread_m:.4} m of one"
    )]
    Collinear {
        /// Root mean square distance from the line, metres.
        spread_m: f64,
    },
    /// The camera sees too few roundels.
    #[error("expected at least 3 roundels in view, found {found}")]
    TooFewSeen {
        /// How many there are.
        found: usize,
    },
    /// A pair of references has a distance that no two seen roundels have.
    #[error(
        "references {first} and {second} are {expected_m:.3} m apart, and no two roundels in view are (nearest: {nearest_m:.3} m); check their places and that both are in view"
    )]
    NoSuchDistance {
        /// One of the pair.
        first: usize,
        /// The other.
        second: usize,
        /// Their distance, metres.
        expected_m: f64,
        /// The distance in view that comes closest, metres.
        nearest_m: f64,
    },
    /// Distances exist one by one, but no arrangement has them all.
    #[error(
        "no {wanted} roundels in view are arranged like the references; at best reference {index} is {residual_m:.3} m from its place; check it"
    )]
    Inconsistent {
        /// How many references would have to be found.
        wanted: usize,
        /// The reference that fits worst in the best arrangement.
        index: usize,
        /// How far it is off, metres.
        residual_m: f64,
    },
    /// Several arrangements fit alike.
    #[error(
        "references {indices:?} cannot be told apart: the layout looks the same with them exchanged; move one of them, or add a reference off the symmetry"
    )]
    Ambiguous {
        /// References that different arrangements find in different roundels.
        indices: Vec<usize>,
    },
}

/// Identifies the references among what is seen and places the camera: the placement, whose residuals
/// are those of the references found, ascending, and for each reference its sighting's index.
pub fn place_camera(
    references: &[Reference],
    seen: &[Sighting],
) -> Result<(Placement, Vec<Option<usize>>), ReferenceError> {
    let found = identify(references, seen)?;
    let (world_m, paired): (Vec<_>, Vec<_>) = references
        .iter()
        .zip(&found)
        .filter_map(|(reference, &index)| Some((reference.position_m, seen[index?])))
        .unzip();
    Ok((align(&world_m, &paired)?, found))
}
