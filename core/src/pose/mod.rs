//! Where a roundel is in the camera frame: from two rims, as imaged, to position, normal and their
//! covariance.
//!
//! 1. Points of both rims are carried through the lens as rays (`rim`).
//! 2. The outer rim's rays lie on a cone; its conic is fitted in the plane across the ray through the
//!    rim's middle, and the two planes that cut it in circles give two poses (`cone`; paper, eqs. 9 and
//!    10 and section 4.3 as corrected in [`crate::errata`]).
//! 3. Each is refined on both rims at once, weighted by what is known of their errors, which also
//!    gives the covariance and how well each explains the rims (`refine`).
//!
//! Accuracy on exact rims (`tests/golden.rs`, against OpenCV's projection): position to 1e-9 of the
//! distance without distortion; under strong distortion the image of a circle is no ellipse, and what
//! the ellipse loses remains.
//!
//! Rims that contradict each other by more than their errors explain (a ring partly covered, a lens
//! less sharp than thought) widen the covariance by as much.
//!
//! Limits: nearly face-on, an ellipse says little of the tilt, since its shape changes with the tilt's
//! square; the covariance then says so. A plain ring says which of two normals is right only by the
//! difference of its rims' centres, a fraction of a pixel: `normal_likelihood` near 0.5 means just
//! that.

mod cone;
mod locator;
pub mod photometry;
mod refine;
mod rim;
#[cfg(test)]
mod tests;

use nalgebra::{Matrix3, Vector3};
use thiserror::Error;

use crate::{
    camera::{Camera, LensError},
    ellipse::Ellipse,
    id::TrackNumber,
    marker::{Kind, Ring},
    rigid::{Covariance6, UNKNOWN_ANGLE_VARIANCE_RAD2},
    time::Timestamp,
};
pub use locator::{Located, Locator};
use refine::Estimate;
use rim::Rim;

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
    /// Angle of the code's zero about the normal; `None` for a plain roundel.
    pub yaw_rad: Option<f64>,
    /// Over (position, rotation), camera frame, left perturbation.
    pub covariance: Covariance6,
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

/// How far rims as found stray from rims as they are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RimNoise {
    /// Standard deviation of one pixel's worth of rim, across the rim, pixels; it averages out along
    /// the rim.
    pub edge_px: f64,
    /// Standard deviation of a shift of the whole rim across itself (blur, bloom), pixels, which no
    /// averaging removes; a quarter of it is also counted for the rim's centre and shape.
    pub floor_px: f64,
}

impl Default for RimNoise {
    /// What the detector reaches at a blur of 0.5 to 0.9 px and noise of a 60th of the contrast
    /// (`tests/pixels.rs`); other noise is told by the ring itself.
    fn default() -> Self {
        Self { edge_px: 0.03, floor_px: 0.0065 }
    }
}

impl RimNoise {
    /// The noise of a ring whose white disc is so thin: a disc hardly wider than the blur is washed
    /// out, and with it, by compensation, both rims are found worse. From rendered rings: double at a
    /// semiaxis of 3 px, sixfold at 2.3 px.
    ///
    /// What the levels along the rim stray is the image's noise, up to a point, and moves the rim's
    /// edge in proportion; beyond that the rim is partly another's, and all its numbers may be off.
    fn of_ring(&self, ring: &Ring) -> RingNoise {
        let growth = 1.0 + (THIN_DISC_PX / ring.inner.semi_minor_px).powi(6).min(MAX_GROWTH);
        let quiet = QUIET.0 + QUIET.1 / (ring.white - ring.black).max(1.0);
        let noise = (ring.unevenness.min(quiet) / CLEAN_UNEVENNESS).clamp(NOISE.0, NOISE.1);
        RingNoise {
            edge_px: self.edge_px * growth * noise,
            floor_px: self.floor_px * growth,
            uneven_px: UNEVEN_PX * (ring.unevenness - quiet).max(0.0),
        }
    }
}

/// How far one ring's rims stray.
#[derive(Clone, Copy, Debug)]
struct RingNoise {
    /// As in [`RimNoise`].
    edge_px: f64,
    /// As in [`RimNoise`].
    floor_px: f64,
    /// Standard deviation of each of a rim's five numbers from what does not belong to it, pixels.
    uneven_px: f64,
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
/// The unevenness that [`RimNoise`] is stated for …
const CLEAN_UNEVENNESS: f64 = 0.011;
/// … how much quieter and noisier a rim can be …
const NOISE: (f64, f64) = (0.6, 3.0);
/// … and the unevenness that noise and pixels alone come to: a share of the contrast, and grey levels.
const QUIET: (f64, f64) = (0.02, 1.0);
/// Pixels that a rim's numbers are off for each unit of its unevenness; from rendered rings partly
/// covered by their neighbours' sheets.
const UNEVEN_PX: f64 = 4.0;
/// At this semiaxis of the white disc the errors of both rims have doubled, pixels.
const THIN_DISC_PX: f64 = 3.0;
/// They grow no further than by this factor; such rings are hardly found.
const MAX_GROWTH: f64 = 10.0;
/// What two rims' ten numbers say beyond the five of a pose.
const FREEDOMS: f64 = 5.0;
/// Squared misfit that their errors explain in 95 of 100 rings (χ² of that many degrees of freedom).
const EXPLAINED_MISFIT: f64 = 11.07;

/// The pose of a roundel of a known kind from its rims, with covariance.
///
/// `kind` gives the diameters of the two rims of `ring`, `noise` how exactly they were found. The
/// pose is that of a plain roundel: without yaw, and with the variance about the normal that stands
/// for an unknown angle. The covariance is positive definite.
pub fn locate(
    camera: &Camera,
    kind: &Kind,
    ring: &Ring,
    noise: &RimNoise,
) -> Result<RoundelPose, PoseError> {
    let (local_from_camera, estimates) = estimate(camera, kind, ring, noise)?;
    finish(&local_from_camera, &estimates).ok_or(PoseError::NoCircle)
}

/// Both poses, the likelier first, in a local frame along the line of sight.
fn estimate(
    camera: &Camera,
    kind: &Kind,
    ring: &Ring,
    noise: &RimNoise,
) -> Result<(Matrix3<f64>, [Estimate; 2]), PoseError> {
    check(kind, ring, noise)?;
    let lens = |rim| move |source| PoseError::Lens { rim, source };
    let axis = camera.bearing(ring.outer.center).map_err(lens("outer"))?;
    let local_from_camera = frame_along(&axis);
    let outer_m = 0.5 * kind.outer_diameter_m;
    let inner_m = 0.5 * kind.inner_diameter_m;
    let noise = &noise.of_ring(ring);
    let rims = [
        Rim::new(camera, &local_from_camera, &ring.outer, outer_m, noise).map_err(lens("outer"))?,
        Rim::new(camera, &local_from_camera, &ring.inner, inner_m, noise).map_err(lens("inner"))?,
    ];
    let conic = cone::fit(&rims[0].points).ok_or(PoseError::NoCircle)?;
    let circles = cone::circles(&conic, outer_m).ok_or(PoseError::NoCircle)?;
    let [a, b] = circles.map(|circle| refine::refine(&circle, &rims));
    let estimates = match (a, b) {
        (Some(a), Some(b)) if b.misfit < a.misfit => [b, a],
        (Some(a), Some(b)) => [a, b],
        // One of the two has left the space of circles in front of the camera: it is no candidate.
        (Some(only), None) | (None, Some(only)) => [only.clone(), only],
        (None, None) => return Err(PoseError::NoCircle),
    };
    Ok((local_from_camera, estimates))
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
    let RimNoise { edge_px, floor_px } = *noise;
    if !(edge_px > 0.0 && edge_px.is_finite() && floor_px > 0.0 && floor_px.is_finite()) {
        return Err(PoseError::Noise { edge_px, floor_px });
    }
    Ok(())
}

/// Rows of a right-handed frame whose z lies along the unit vector `axis`: in it a small roundel is
/// near the middle of the plane z = 1, whatever the lens, even beyond 90°.
fn frame_along(axis: &Vector3<f64>) -> Matrix3<f64> {
    let across = if axis.y.abs() < 0.9 { Vector3::y() } else { Vector3::x() };
    let x = across.cross(axis).normalize();
    let y = axis.cross(&x);
    Matrix3::from_rows(&[x.transpose(), y.transpose(), axis.transpose()])
}

/// How much wider than stated errors must be, as a factor of the variance, for rims of this squared
/// misfit: 1 for what is explained, then steadily up to the misfit over its degrees of freedom.
fn growth(misfit: f64) -> f64 {
    1.0 + (misfit - EXPLAINED_MISFIT).max(0.0) / FREEDOMS
}

/// The first estimate in the camera frame, with what the second leaves in doubt.
fn finish(
    local_from_camera: &Matrix3<f64>,
    [first, second]: &[Estimate; 2],
) -> Option<RoundelPose> {
    let camera_from_local = local_from_camera.transpose();
    let normal = (camera_from_local * first.normal).normalize();
    let normal_likelihood = 1.0 / (1.0 + (0.5 * (first.misfit - second.misfit)).exp());
    let mut covariance = first.covariance * growth(first.misfit);
    // The two normals put the centre at slightly different places, and which is right is not known.
    let apart = second.position_m - first.position_m;
    let mut position = covariance.fixed_view_mut::<3, 3>(0, 0);
    position += apart * apart.transpose() * (1.0 - normal_likelihood);
    let mut turn = Covariance6::zeros();
    turn.fixed_view_mut::<3, 3>(0, 0).copy_from(&camera_from_local);
    turn.fixed_view_mut::<3, 3>(3, 3).copy_from(&camera_from_local);
    let mut covariance = turn * covariance * turn.transpose();
    let mut rotation = covariance.fixed_view_mut::<3, 3>(3, 3);
    rotation += normal * normal.transpose() * UNKNOWN_ANGLE_VARIANCE_RAD2;
    let covariance = 0.5 * (covariance + covariance.transpose());
    covariance.cholesky()?;
    Some(RoundelPose {
        position_m: camera_from_local * first.position_m,
        normal,
        normal_likelihood,
        other_normal: (camera_from_local * second.normal).normalize(),
        yaw_rad: None,
        covariance,
    })
}
