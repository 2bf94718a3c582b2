//! Pose of a roundel in the camera frame: from two imaged rims to position, normal and covariance.
//!
//! 1. `rim`: points of both rims pass through the lens, and the ellipses through their images are
//!    expressed in the frame of the outer rim's cone.
//! 2. `print_estimate`: how the ratio of diameters differs in print and image from the design.
//! 3. `circle`: the outer rim's ellipse gives two circles in closed form (paper, eqs. 9 and 10
//!    and section 4.3 as corrected in [`crate::errata`]). One Gauss-Newton step fits each to both
//!    rims, weighted by their errors, and gives covariance and likelihood. A roundel that nearly
//!    faces the camera gets the mean of the posterior of its tilt instead: one broad normal rather
//!    than two.
//! 4. [`photometry`]: in precise mode, a least-squares fit of the grey levels that starts from
//!    there.
//! 5. `shutter`: under a rolling shutter, the rims of a moving ring are first transformed to one
//!    instant.
//!
//! [`Locator`] runs these steps for the rings of a frame; `tracked_fit` bounds the work of step 4.
//!
//! Accuracy on exact rims (`tests/golden.rs`, against OpenCV's projection): position to 1e-9 of the
//! distance without distortion. Under strong distortion the image of a circle is no ellipse, and
//! what the ellipse omits remains as an error. On rims with errors
//! (`tests::covariance_matches_the_errors`): 95 ± 3 % of position and rotation inside their 95 %
//! ellipsoid from 12 to 120 px and from 0 to 60°, depth bias below a third of its rms. Time: `cargo
//! bench -p roundel-core --bench pose`, alone and in a batch (`circle::closed_form`).
//!
//! Rims that contradict each other by more than their errors explain (partial occlusion, more blur
//! than assumed) widen the covariance accordingly.
//!
//! Limits: for a plain ring only the difference of its rims' centres, a fraction of a pixel,
//! distinguishes the two normals. A `normal_likelihood` near 0.5 means that they are ambiguous. Paper that is not flat
//! limits it far from the camera (`bend`).

mod bend;
mod circle;
mod locator;
pub mod photometry;
mod print_estimate;
mod recent_tracks;
mod rim;
mod shutter;
#[cfg(test)]
mod tests;
mod tracked_fit;
mod yaw;

use nalgebra::{Matrix3, Vector3};
use thiserror::Error;

use crate::{
    camera::{Camera, LensError},
    ellipse::Ellipse,
    id::TrackNumber,
    marker::{Kind, Pattern, Ring},
    rigid::Covariance6,
    simd::Vec3,
    time::Timestamp,
};
pub use bend::flatness_m;
use circle::{closed_form, elliptical_disc};
pub use locator::{ImageQuality, Located, Locator};
pub use print_estimate::PrintDeviation;
use print_estimate::PrintedRing;
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
    /// Angle about the normal, radians: of the code's zero, or of an elliptical disc's longer axis
    /// in (-π/2, π/2], whose opposite looks the same. `None` for a plain roundel.
    pub yaw_rad: Option<f64>,
    /// Number of evenly spaced yaws at which the roundel looks the same: 2 with an elliptical disc,
    /// else 1.
    pub yaw_symmetry: u32,
    /// Over (position, rotation), camera frame, left perturbation.
    pub covariance: Covariance6,
}

impl RoundelPose {
    /// The yaw if `other_normal` is the right one: the print's x points the same way in the image.
    pub fn other_yaw_rad(&self) -> Option<f64> {
        self.yaw_rad.map(|yaw_rad| yaw::transferred_rad(self, yaw_rad, &self.other_normal))
    }

    /// Adds the relative standard deviation of the imaged size to the covariance.
    fn add_size_deviation(&mut self, deviation: f64) {
        let along = self.position_m * deviation;
        let mut position = self.covariance.fixed_view_mut::<3, 3>(0, 0);
        position += along * along.transpose();
    }

    /// Direction of the print's x with `other_normal`, given that with `normal`; camera frame.
    pub fn other_x(&self, x: &Vector3<f64>) -> Vector3<f64> {
        yaw::x_with_normal(x, &self.position_m, &self.other_normal)
    }
}

/// A roundel found in a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Detection {
    /// Track number of this camera.
    pub track: TrackNumber,
    /// The ring in the image.
    pub ring: Ring,
    /// Middle of the exposure of the row of its centre.
    pub capture_time: Timestamp,
    /// `None` without a camera model or a known diameter.
    pub pose: Option<RoundelPose>,
}

/// Why a ring has no pose.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum PoseError {
    /// The ring matches no configured kind, so its size is unknown.
    #[error("expected a ring of a known kind, found one of none")]
    UnknownKind,
    /// A rim is not a valid ellipse.
    #[error(
        "{rim} rim: expected finite numbers and semiaxes of at least {} px, found {semi_major_px} and {semi_minor_px} px",
        MIN_SEMIAXIS_PX
    )]
    Ellipse {
        /// `outer` or `inner`.
        rim: &'static str,
        /// Longer semiaxis, pixels.
        semi_major_px: f64,
        /// Shorter semiaxis, pixels.
        semi_minor_px: f64,
    },
    /// The diameters of the kind are invalid.
    #[error(
        "expected diameters with 0 < inner < outer, found inner {inner_m} m and outer {outer_m} m"
    )]
    Diameter {
        /// Diameter of the white disc.
        inner_m: f64,
        /// Diameter of the black ring.
        outer_m: f64,
    },
    /// The rim noise is not positive.
    #[error("expected positive rim noise, found edge {edge_px} px and floor {floor_px} px")]
    Noise {
        /// The given value.
        edge_px: f64,
        /// The given value.
        floor_px: f64,
    },
    /// The lens model gives no ray for part of a rim.
    #[error("{rim} rim: {source}")]
    Lens {
        /// `outer` or `inner`.
        rim: &'static str,
        /// Error of the lens model.
        source: LensError,
    },
    /// No circle in front of the camera has these rims.
    #[error("expected rims that a circle in front of the camera can have, found others")]
    NoCircle,
}

/// Rims with a smaller semiaxis, pixels, have no usable shape.
const MIN_SEMIAXIS_PX: f64 = 0.5;

/// Pose of a roundel from its rims, with covariance.
///
/// `kind` gives the diameters of the rims, `noise` their errors. The pose is that of a plain
/// roundel, without yaw and with the variance of an unknown angle about the normal, unless the disc
/// is elliptical. The covariance is positive definite.
pub fn locate(
    camera: &Camera,
    kind: &Kind,
    ring: &Ring,
    noise: &RimNoise,
) -> Result<RoundelPose, PoseError> {
    locate_printed(camera, kind, &PrintedRing::designed(ring), noise)
}

fn locate_printed(
    camera: &Camera,
    kind: &Kind,
    printed: &PrintedRing,
    noise: &RimNoise,
) -> Result<RoundelPose, PoseError> {
    match measure(kind, printed, noise)? {
        Some(measured) => closed_form::locate(camera, &measured),
        None => elliptical_disc::locate(camera, kind, &printed.ring, noise),
    }
}

/// Vector from the position with the more likely normal to that with the other one, camera frame,
/// metres. Zero for an elliptical disc, whose heading distinguishes the two.
pub fn other_offset_m(
    camera: &Camera,
    kind: &Kind,
    ring: &Ring,
    noise: &RimNoise,
) -> Result<Vector3<f64>, PoseError> {
    match measure(kind, &PrintedRing::designed(ring), noise)? {
        Some(measured) => closed_form::other_offset_m(camera, &measured),
        None => Ok(Vector3::zeros()),
    }
}

/// As [`locate`], for up to [`closed_form::LANES`] rings of one camera.
fn locate_each<'a>(
    camera: &Camera,
    rings: impl Iterator<Item = Result<(&'a Kind, &'a PrintedRing), PoseError>>,
    noise: &RimNoise,
    poses: &mut [Result<RoundelPose, PoseError>; closed_form::LANES],
) {
    let mut measured = [None; closed_form::LANES];
    for ((ring, measured), pose) in rings.zip(&mut measured).zip(&mut *poses) {
        match ring.and_then(|(kind, ring)| Ok((measure(kind, ring, noise)?, kind, ring))) {
            Ok((Some(own), ..)) => *measured = Some(own),
            Ok((None, kind, printed)) => {
                *pose = elliptical_disc::locate(camera, kind, &printed.ring, noise);
            }
            Err(error) => *pose = Err(error),
        }
    }
    closed_form::locate_each(camera, &measured, poses);
}

/// Input of the closed form; `None` for an elliptical disc.
fn measure(
    kind: &Kind,
    printed: &PrintedRing,
    noise: &RimNoise,
) -> Result<Option<RingMeasurement>, PoseError> {
    let ring = &printed.ring;
    check(kind, ring, noise)?;
    if let Pattern::Elliptical { .. } = kind.pattern {
        return Ok(None);
    }
    let inner_diameter_m = printed.print.disc_scale * kind.inner_diameter_m;
    let radii_m = [0.5 * kind.outer_diameter_m, 0.5 * inner_diameter_m];
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
