//! Where a roundel is in the camera frame: from two rims, as imaged, to position, normal and their
//! covariance.
//!
//! 1. Points of both rims are carried through the lens, and the ellipses through their images are
//!    turned into the frame of the outer rim's cone (`rim`).
//! 2. The outer rim's ellipse gives two circles in closed form (`cone`; paper, eqs. 9 and 10 and
//!    section 4.3 as corrected in [`crate::errata`]).
//! 3. One step of Gauss and Newton brings each onto both rims at once, weighted by what is known of
//!    their errors, which also gives the covariance and how well each explains the rims (`refine`).
//! 4. A roundel that nearly faces the camera is no matter of one step: its tilt is the mean of all that
//!    the rims leave open (`upright`, `facing`), one broad normal rather than two.
//!
//! Accuracy on exact rims (`tests/golden.rs`, against OpenCV's projection): position to 1e-9 of the
//! distance without distortion; under strong distortion the image of a circle is no ellipse, and what
//! the ellipse loses remains. On rims with errors (`tests::covariance_is_that_of_the_errors`): 95 ± 3 %
//! of position and rotation inside their 95 % ellipsoid from 12 to 120 px and from 0 to 60°, and the
//! depth's bias below a third of its rms. Time: `cargo bench -p roundel-core --bench pose`, alone and among
//! others, since a frame's rings are located side by side (`closed`).
//!
//! Rims that contradict each other by more than their errors explain (a ring partly covered, a lens
//! less sharp than thought) widen the covariance by as much.
//!
//! Under a rolling shutter a ring that moves is put back to where all of it was at the instant of its pose
//! (`shutter`).
//!
//! Limits: a plain ring says which of two normals is right only by the difference of its rims' centres,
//! a fraction of a pixel: `normal_likelihood` near 0.5 means just that.

mod circle;
mod locator;
pub mod photometry;
mod recent_tracks;
mod rim;
mod shutter;
#[cfg(test)]
mod tests;
mod yaw;

use nalgebra::{Matrix3, Vector3};
use thiserror::Error;

use crate::{
    camera::{Camera, LensError},
    ellipse::Ellipse,
    id::TrackNumber,
    lanes::Vec3,
    marker::{Kind, Pattern, Ring},
    rigid::Covariance6,
    time::Timestamp,
};
use circle::{closed_form, elliptical_disc};
pub use locator::{ImageQuality, Located, Locator};
pub use rim::noise::RimNoise;
use rim::rim_pair::RingMeasurement;
pub use shutter::Skew;

/// Pose of a roundel in the camera frame.
#[derive(Clone, Debug, PartialEq)]
pub struct RoundelPose {
    /// Centre, metres.
    pub position_m: Vector3<f64>,
    /// Unit normal out of the printed face, the more likely one.
    pub normal: Vector3<f64>,
    /// Likelihood of `normal` against `other_normal`, 0.5 to 1.
    pub normal_likelihood: f64,
    /// The other normal that the same ellipse allows.
    pub other_normal: Vector3<f64>,
    /// Angle about the normal of the code's zero, or of an elliptical disc's longer axis, in (-π/2, π/2]
    /// since the opposite looks the same; `None` for a plain roundel.
    pub yaw_rad: Option<f64>,
    /// In how many evenly spaced yaws it looks the same, if it has one: 2 with an elliptical disc, else 1.
    pub yaw_symmetry: u32,
    /// Over (position, rotation), camera frame, left perturbation.
    pub covariance: Covariance6,
}

impl RoundelPose {
    /// The yaw that it has if `other_normal` is the right one: the print's x points the same way in the
    /// picture.
    pub fn other_yaw_rad(&self) -> Option<f64> {
        self.yaw_rad.map(|yaw_rad| yaw::transferred_rad(self, yaw_rad, &self.other_normal))
    }

    /// Where the print's x points then, if this is where it points with `normal`; camera frame.
    pub fn other_x(&self, x: &Vector3<f64>) -> Vector3<f64> {
        yaw::x_with_normal(x, &self.position_m, &self.other_normal)
    }
}

/// One roundel found in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Detection {
    /// The camera's own number for it.
    pub track: TrackNumber,
    /// As imaged.
    pub ring: Ring,
    /// Middle of the exposure at its own row.
    pub capture_time: Timestamp,
    /// `None` without a camera model or a known diameter.
    pub pose: Option<RoundelPose>,
}

/// Why a ring has no pose.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum PoseError {
    /// The ring is of no kind that is known here, so that nothing says its size.
    #[error("expected a ring of a known kind, found one of none")]
    UnknownKind,
    /// An ellipse is not one.
    #[error(
        "{rim} rim: expected finite numbers and semiaxes of at least {} px, found {semi_major_px} and {semi_minor_px} px",
        MIN_SEMIAXIS_PX
    )]
    Ellipse {
        /// `outer` or `inner`.
        rim: &'static str,
        /// Its longer semiaxis.
        semi_major_px: f64,
        /// Its shorter semiaxis.
        semi_minor_px: f64,
    },
    /// The print's size makes no sense.
    #[error(
        "expected diameters with 0 < inner < outer, found inner {inner_m} m and outer {outer_m} m"
    )]
    Diameter {
        /// White disc's.
        inner_m: f64,
        /// Black ring's.
        outer_m: f64,
    },
    /// The noise is no positive number.
    #[error("expected positive rim noise, found edge {edge_px} px and floor {floor_px} px")]
    Noise {
        /// As given.
        edge_px: f64,
        /// As given.
        floor_px: f64,
    },
    /// Part of a rim lies where the lens model gives no ray.
    #[error("{rim} rim: {source}")]
    Lens {
        /// `outer` or `inner`.
        rim: &'static str,
        /// What the lens says.
        source: LensError,
    },
    /// The rims fit no circle in front of the camera.
    #[error("expected rims that a circle in front of the camera can have, found others")]
    NoCircle,
}

/// A rim thinner than this, pixels, has no usable shape.
const MIN_SEMIAXIS_PX: f64 = 0.5;
/// The pose of a roundel of a known kind from its rims, with covariance.
///
/// `kind` gives the diameters of the two rims of `ring`, `noise` how exactly they were found. The
/// pose is that of a plain roundel: without yaw, and with the variance about the normal that stands
/// for an unknown angle, unless the disc is elliptical (`elliptical`). The covariance is positive
/// definite.
pub fn locate(
    camera: &Camera,
    kind: &Kind,
    ring: &Ring,
    noise: &RimNoise,
) -> Result<RoundelPose, PoseError> {
    match found(kind, ring, noise)? {
        Some(found) => closed_form::locate(camera, &found),
        None => elliptical_disc::locate(camera, kind, ring, noise),
    }
}

/// From where the likelier of both normals puts the centre to where the other one does, camera frame, metres; nothing of
/// an elliptical disc, whose heading tells them apart.
pub fn other_offset_m(
    camera: &Camera,
    kind: &Kind,
    ring: &Ring,
    noise: &RimNoise,
) -> Result<Vector3<f64>, PoseError> {
    match found(kind, ring, noise)? {
        Some(found) => closed_form::other_offset_m(camera, &found),
        None => Ok(Vector3::zeros()),
    }
}

/// As [`locate`], of up to [`circle::closed_form::LANES`] rings of one camera at once, each in its place.
fn locate_each<'a>(
    camera: &Camera,
    rings: impl Iterator<Item = Result<(&'a Kind, &'a Ring), PoseError>>,
    noise: &RimNoise,
    poses: &mut [Result<RoundelPose, PoseError>; closed_form::LANES],
) {
    let mut lanes = [None; closed_form::LANES];
    for ((ring, lanes), pose) in rings.zip(&mut lanes).zip(&mut *poses) {
        match ring.and_then(|(kind, ring)| Ok((found(kind, ring, noise)?, kind, ring))) {
            Ok((Some(found), ..)) => *lanes = Some(found),
            Ok((None, kind, ring)) => *pose = elliptical_disc::locate(camera, kind, ring, noise),
            Err(error) => *pose = Err(error),
        }
    }
    closed_form::locate_each(camera, &lanes, poses);
}

/// What the closed form sees of a ring; `None` of one with an elliptical disc.
fn found(kind: &Kind, ring: &Ring, noise: &RimNoise) -> Result<Option<RingMeasurement>, PoseError> {
    check(kind, ring, noise)?;
    if let Pattern::Elliptical { .. } = kind.pattern {
        return Ok(None);
    }
    let radii_m = [0.5 * kind.outer_diameter_m, 0.5 * kind.inner_diameter_m];
    let noise = if let Pattern::Coded(layout) = kind.pattern {
        noise.for_coded_ring(ring, layout.bits)
    } else {
        let disc_px = ring.inner.semi_minor_px;
        noise.for_ring(ring, disc_px, ring.outer.semi_minor_px - disc_px)
    };
    Ok(Some(RingMeasurement::new(ring, radii_m, noise)))
}

/// Rows of a right-handed frame whose z lies along `axis`, of any length.
fn frame_along(axis: &Vector3<f64>) -> Matrix3<f64> {
    rim::projection::frame_along(Vec3::new(axis.x, axis.y, axis.z)).into()
}

fn check(kind: &Kind, ring: &Ring, noise: &RimNoise) -> Result<(), PoseError> {
    for (rim, ellipse) in [("outer", &ring.outer), ("inner", &ring.inner)] {
        let Ellipse { center, semi_major_px, semi_minor_px, angle_rad } = *ellipse;
        let finite = [center.u, center.v, semi_major_px, semi_minor_px, angle_rad];
        if !finite.iter().all(|value| value.is_finite())
            || semi_minor_px < MIN_SEMIAXIS_PX
            || semi_major_px < semi_minor_px
        {
            return Err(PoseError::Ellipse { rim, semi_major_px, semi_minor_px });
        }
    }
    let (inner_m, outer_m) = (kind.inner_diameter_m, kind.outer_diameter_m);
    if !(inner_m > 0.0 && inner_m < outer_m && outer_m.is_finite()) {
        return Err(PoseError::Diameter { inner_m, outer_m });
    }
    let RimNoise { edge_px, floor_px, .. } = *noise;
    if !(edge_px > 0.0 && edge_px.is_finite() && floor_px > 0.0 && floor_px.is_finite()) {
        return Err(PoseError::Noise { edge_px, floor_px });
    }
    Ok(())
}
