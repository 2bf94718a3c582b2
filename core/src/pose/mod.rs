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
//! depth's bias below a third of its rms. Time: `cargo bench -p roundel-core --bench pose`.
//!
//! Rims that contradict each other by more than their errors explain (a ring partly covered, a lens
//! less sharp than thought) widen the covariance by as much.
//!
//! Limits: a plain ring says which of two normals is right only by the difference of its rims' centres,
//! a fraction of a pixel: `normal_likelihood` near 0.5 means just that.

mod bend;
mod cone;
mod elliptical;
mod facing;
mod locator;
pub mod photometry;
mod refine;
mod rim;
#[cfg(test)]
mod tests;
mod upright;
mod yaw;

use fearless_simd::{Level, Simd, dispatch};
use fearless_simd_macros::simd;
use nalgebra::{Matrix3, Vector3};
use thiserror::Error;

use crate::{
    camera::{Camera, LensError},
    ellipse::Ellipse,
    id::TrackNumber,
    marker::{Kind, Pattern, Ring},
    rigid::{Covariance6, UNKNOWN_ANGLE_VARIANCE_RAD2},
    time::Timestamp,
};
use cone::Circle;
pub use locator::{ImageQuality, Located, Locator};
use refine::Estimate;
use rim::frame_along;

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
        self.yaw_rad.map(|yaw_rad| yaw::carried_rad(self, yaw_rad, &self.other_normal))
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
    /// The noise of a ring whose white disc has so short a semiaxis, and whose black is so narrow along it.
    /// A disc hardly wider than the blur is washed out, and with it, by compensation, both rims are found
    /// worse. From rendered rings: double at a semiaxis of 3 px, sixfold at 2.3 px.
    ///
    /// A black ring grown thin adds less: across 4 px of it errors are 1.6 times as large. The larger of the
    /// two counts, which at a ratio of diameters of 0.4 is the disc's, at 0.6 mostly the black's.
    ///
    /// What the levels along the rim stray is the image's noise, up to a point, and moves the rim's
    /// edge in proportion; beyond that the rim is partly another's, and all its numbers may be off.
    fn of_ring(&self, ring: &Ring, disc_px: f64, black_px: f64) -> RingNoise {
        let by_disc = (THIN_DISC_PX / disc_px).powi(6).min(MAX_GROWTH);
        let by_black = (THIN_BLACK_PX / black_px).powi(4).min(MAX_GROWTH_BY_BLACK);
        let growth = 1.0 + by_disc.max(by_black);
        let quiet = QUIET.0 + QUIET.1 / (ring.white - ring.black).max(1.0);
        let noise = (ring.unevenness.min(quiet) / CLEAN_UNEVENNESS).clamp(NOISE.0, NOISE.1);
        RingNoise {
            edge_px: self.edge_px * growth * noise,
            floor_px: self.floor_px * growth,
            uneven_px: UNEVEN_PX * (ring.unevenness - quiet).max(0.0),
            round_disc: true,
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
    /// Whether the disc's rim is a circle's; of another only size and place say something of the pose.
    round_disc: bool,
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
/// The share that the black adds is one at this width of it, along the shorter axis, pixels …
const THIN_BLACK_PX: f64 = 3.5;
/// … if it were not this at most.
const MAX_GROWTH_BY_BLACK: f64 = 0.7;
/// What two rims' ten numbers say beyond the five of a pose.
const FREEDOMS: f64 = 5.0;
/// Squared misfit that their errors explain in 95 of 100 rings (χ² of that many degrees of freedom).
const EXPLAINED_MISFIT: f64 = 11.07;

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
    check(kind, ring, noise)?;
    if let Pattern::Elliptical { .. } = kind.pattern {
        return elliptical::locate(camera, kind, ring, noise);
    }
    let radii_m = [0.5 * kind.outer_diameter_m, 0.5 * kind.inner_diameter_m];
    let disc_px = ring.inner.semi_minor_px;
    let noise = noise.of_ring(ring, disc_px, ring.outer.semi_minor_px - disc_px);
    locate_round(camera, ring, radii_m, &noise)
}

/// As [`locate`], of a disc that is round or taken for it.
fn locate_round(
    camera: &Camera,
    ring: &Ring,
    radii_m: [f64; 2],
    noise: &RingNoise,
) -> Result<RoundelPose, PoseError> {
    dispatch!(Level::new(), simd => locate_with(simd, camera, ring, radii_m, noise))
}

/// As [`locate_round`]; one body for all that the processor can do, in which the loops over a rim's points
/// become vector instructions.
#[simd]
fn locate_with<S: Simd>(
    simd: S,
    camera: &Camera,
    ring: &Ring,
    radii_m: [f64; 2],
    noise: &RingNoise,
) -> Result<RoundelPose, PoseError> {
    let _ = simd;
    Ok(finish(&estimate(camera, ring, radii_m, noise)?))
}

/// Both poses, the likelier first, and the frame along the line of sight that they are in.
struct Estimates {
    local_from_camera: Matrix3<f64>,
    first: Estimate,
    /// The other one, and the likelihood of the first against it; `None` where there is one alone.
    other: Option<(Estimate, f64)>,
}

#[inline(always)]
fn estimate(
    camera: &Camera,
    ring: &Ring,
    radii_m: [f64; 2],
    noise: &RingNoise,
) -> Result<Estimates, PoseError> {
    let (local_from_camera, rims) = rim::carry(camera, ring, radii_m, noise)?;
    let circles = Circle::both(&rims[0]).ok_or(PoseError::NoCircle)?;
    if let Some((first, other)) = upright::estimate(&circles[0], &rims) {
        return Ok(Estimates { local_from_camera, first, other });
    }
    let (first, other) = match refine::refine_both(&circles, &rims) {
        [Some(a), Some(b)] => {
            let (first, other) = if b.misfit < a.misfit { (b, a) } else { (a, b) };
            let likelihood = 1.0 / (1.0 + (0.5 * (first.misfit - other.misfit)).exp());
            // Seen from near, perspective alone tells the tilt, and both starts end in one place.
            let is_apart = facing::are_apart(&first.lean(), &other.lean());
            (first, is_apart.then_some((other, likelihood)))
        }
        // One of the two has left the space of circles in front of the camera: it is no candidate.
        [Some(only), None] | [None, Some(only)] => (only, None),
        [None, None] => return Err(PoseError::NoCircle),
    };
    Ok(Estimates { local_from_camera, first, other })
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

/// How much wider than stated errors must be, as a factor of the variance, for rims of this squared
/// misfit: 1 for what is explained, then steadily up to the misfit over its degrees of freedom.
fn growth(misfit: f64) -> f64 {
    1.0 + (misfit - EXPLAINED_MISFIT).max(0.0) / FREEDOMS
}

/// The first estimate in the camera frame, with what the other leaves in doubt.
#[inline(always)]
fn finish(estimates: &Estimates) -> RoundelPose {
    let Estimates { local_from_camera, first, other } = estimates;
    let camera_from_local = local_from_camera.transpose();
    let normal = camera_from_local * first.circle.normal();
    let mut covariance = covariance(first, &camera_from_local);
    let mut normal_likelihood = 1.0;
    let mut other_normal = normal;
    if let Some((other, likelihood)) = other {
        normal_likelihood = *likelihood;
        other_normal = camera_from_local * other.circle.normal();
        // The two normals put the centre at slightly different places, and which is right is not known.
        let apart = camera_from_local * (other.circle.position_m() - first.circle.position_m());
        for row in 0..3 {
            for column in 0..3 {
                covariance[(row, column)] += apart[row] * apart[column] * (1.0 - likelihood);
            }
        }
    }
    for row in 0..3 {
        for column in 0..3 {
            covariance[(3 + row, 3 + column)] +=
                normal[row] * normal[column] * UNKNOWN_ANGLE_VARIANCE_RAD2;
        }
    }
    RoundelPose {
        position_m: camera_from_local * first.circle.position_m(),
        normal,
        normal_likelihood,
        other_normal,
        yaw_rad: None,
        yaw_symmetry: 1,
        covariance,
    }
}

/// An estimate's covariance in the camera frame, with nothing about the normal.
#[inline(always)]
fn covariance(estimate: &Estimate, camera_from_local: &Matrix3<f64>) -> Covariance6 {
    let (place, turns) = estimate.changes();
    let place = place.map(|change| camera_from_local * change);
    let turns = turns.map(|change| camera_from_local * change);
    let growth = growth(estimate.misfit);
    let c = &estimate.covariance;
    // Rows of the five numbers' covariance, each carried to six.
    let mut carried = [[0.0; 6]; 5];
    for (number, row) in carried.iter_mut().enumerate() {
        for k in 0..3 {
            row[k] = growth
                * (c[(number, 0)] * place[0][k]
                    + c[(number, 1)] * place[1][k]
                    + c[(number, 2)] * place[2][k]);
            row[3 + k] = growth * (c[(number, 3)] * turns[0][k] + c[(number, 4)] * turns[1][k]);
        }
    }
    let mut covariance = Covariance6::zeros();
    for row in 0..3 {
        for column in 0..6 {
            let of_place = place[0][row] * carried[0][column]
                + place[1][row] * carried[1][column]
                + place[2][row] * carried[2][column];
            covariance[(row, column)] = of_place;
            covariance[(column, row)] = of_place;
        }
        for column in 0..3 {
            covariance[(3 + row, 3 + column)] =
                turns[0][row] * carried[3][3 + column] + turns[1][row] * carried[4][3 + column];
        }
    }
    covariance
}
