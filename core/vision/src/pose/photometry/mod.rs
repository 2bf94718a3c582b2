//! A roundel's pose from the grey levels of its pixels: the precise mode.
//!
//! In: a frame, a ring found in it and a pose from its rims. Out: the pose whose image, through the
//! lens, is nearest to the pixels in the sense of least squares, which for even Gaussian noise is the
//! maximum of the likelihood, with the covariance of its errors.
//!
//! **Image.** A pixel at (p, q) sees the print through K = k(x - p) k(y - q), the pixel's box blurred
//! by a Gaussian of deviation σ (`blur`). With the black area Ω as imaged, whose contour runs so that
//! black is positive, its black share is by Green's theorem
//!
//!   d(p, q) = ∬_Ω K = -∮ A(y - q) k(x - p) dx,   A' = k,
//!
//! and its grey level W + C d: exact for any size and tilt, where a local edge fails for a disc as
//! small as the blur. Nodes at 1.3 σ along the contour are enough (`contour`, `view`, `scatter`).
//!
//! **Motion.** If a parameter moves the contour by v, d changes by -v·∇d where v varies slowly, which it
//! does over the width of a rim. So ∇d and ∇²d = 2 ∂d/∂σ², differences of the image itself (`columns`), give
//! all columns. Only these are approximate, and they cost precision only in second order, since the
//! residual, which is exact, averages to nothing at the truth.
//!
//! **Unknowns.** Shift across the line of sight, logarithm of the range, two tilts; white level, step
//! to black, σ², the motion within the exposure (`motion`), and the light's gradient over the ring (expected
//! within a tenth), which otherwise would pass for tilt. Gauss and Newton's steps, damped where they fail (`descend`).
//!
//! **Frames.** Of a followed ring that hardly changes the columns' products are those of a frame before
//! (`recalled`), and only their products with the residual are summed.
//!
//! **Two normals.** Mirrored along the line of sight, the roundel looks nearly the same. The mirrored
//! place's residual is projected with the information of the first; if it promises a smaller misfit, it
//! is fitted too. The likelihoods of the two follow from the difference of their misfits over the noise.
//! Face-on the image depends on the tilt's square only; a curvature of the elongation's information
//! keeps steps finite there, and the pose is the posterior's mean (`upright`), as in [`super::locate`].
//!
//! **Noise.** A pixel's variance is that of the residuals. Where these hang together over patches of
//! pixels (`patches`), or white or black come near an end of the scale, the ring is fitted again with
//! cut off levels, bloom, and levels of each stretch of the rims (`careful`), or refused.
//!
//! **Accuracy** (`roundel-tests`, `tests/photometry.rs`: tilt 15° to 60°, blur 0.5 to 1.1 px and noise 1
//! to 4 unknown, contrast 160): rms of the depth over the Cramér-Rao bound 1.23 at 12 to 20 px, 1.13 at
//! 20 to 30, 0.94 at 30 to 60, 0.83 at 60 to 110 (80 roundels each, so to 8 %); no bias; normals alike;
//! 96 to 98 % of the positions inside the stated 95 % ellipsoid. Time: `benches/fit.rs`.
//!
//! **Heading.** An elliptical disc's contour turns with the print; its heading is found by the profile of
//! the misfit (`heading`).
//!
//! **Teeth.** Where a coded print has been read, its contour is known whole: arcs and radial edges (`teeth`),
//! from the reading's yaw, which is fitted along (`turn`): depth 1.0 to 1.1 times the bound from 36 to 110 px and
//! the yaw 1.0 times (`tests/coded.rs`). A frame that does not read it has the teeth of those before (`memory`), and
//! is as exact.
//!
//! **Limits.** Refused are coded prints whose teeth no frame has read, and elliptical discs of whose rim a part is
//! covered. Paper is expected to go on for 3 px, or 3.5 blurs, round the outer rim.

pub(super) mod history;
mod hypotheses;
mod model;
mod robust;
mod scratch;
mod solver;
#[cfg(test)]
mod tests;

use nalgebra::{Matrix3, Vector2, Vector3};
use thiserror::Error;

use crate::{
    camera::{Camera, LensError},
    ellipse::{Chords, Ellipse},
    frame::Frame,
    marker::{Kind, Pattern, Ring},
    pose::{RoundelPose, Skew, frame_along, yaw},
};
use hypotheses::{PoseEstimate, estimate_pose};
use model::{blur_kernel::BLUR_LIMITS_PX, local_lens::LocalLens, motion, projection::PrintPose};
pub use model::{blur_kernel::normal_distribution, teeth::Teeth};
pub use scratch::FitScratch;
pub use solver::normal_equation_cache::NormalEquationCache;
use solver::{
    solution,
    state::{Problem, State},
};

/// Where a fit starts.
#[derive(Clone, Debug, PartialEq)]
pub struct Start {
    /// From [`super::locate`], or predicted; right to a third of a pixel and some degrees.
    pub pose: RoundelPose,
    /// Deviation of the blur, pixels: the track's last one, or [`DEFAULT_BLUR_PX`].
    pub blur_px: f64,
    /// Motion within the exposure, pixels: the track's last one, or none.
    pub motion_px: Vector2<f64>,
    /// How far the ring has moved since the frame before, pixels, which it hardly exceeds within an
    /// exposure; infinite where it is not known.
    pub moved_px: f64,
    /// Whether the motion is held at none, which takes less time; where noise does not explain what is left
    /// then, it is free all the same.
    pub is_still: bool,
    /// What a rolling shutter does to it.
    pub skew: Option<Skew>,
    /// The teeth that a coded print had in earlier frames, for one that is not read in this one; with them the
    /// pose has a yaw, right to a part of a slot.
    pub teeth: Option<Teeth>,
    /// What a fit of the same ring in an earlier frame gave to be recalled, which takes less time.
    pub cache: Option<NormalEquationCache>,
}

/// The blur to start from where nothing is known, pixels.
pub const DEFAULT_BLUR_PX: f64 = 0.7;

/// A pose fitted to grey levels.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// The pose.
    pub pose: RoundelPose,
    /// Rims as this pose images them; black and white as fitted.
    pub ring: Ring,
    /// Deviation of the blur, pixels.
    pub blur_px: f64,
    /// Motion within the exposure, pixels, or its opposite, which looks the same. The pose is that of the
    /// exposure's middle.
    pub motion_px: Vector2<f64>,
    /// Variance that noise gives either part of the motion's square, px⁴; none where the motion was held.
    pub motion_variance_px4: Option<f64>,
    /// Deviation of what the model leaves, grey levels: the image's noise, if the model is right.
    pub noise: f64,
    /// Of a coded print.
    pub teeth: Option<Teeth>,
    /// Iterations that were needed.
    pub iterations: usize,
    /// For fits in later frames.
    pub cache: Option<NormalEquationCache>,
}

/// Why a ring has no fitted pose.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum FitError {
    /// The start is no pose in front of the camera.
    #[error("expected a start in front of the camera and facing it, found another")]
    Start,
    /// What is printed is not known.
    #[error(
        "expected a coded ring whose teeth are known, and the start of an elliptical one with a yaw"
    )]
    Pattern,
    /// The lens gives no pixels there.
    #[error("round the start: {0}")]
    Lens(#[from] LensError),
    /// The rims reach outside of what is looked at.
    #[error("expected rims near those that were found, the fit went elsewhere")]
    OutOfWindow,
    /// No minimum was found in the steps there are.
    #[error("expected a start from which the fit settles, found one from which it does not")]
    NotConverged,
    /// The pixels do not tell the pose.
    #[error("expected pixels that tell a pose, found too few or too flat ones")]
    Uninformative,
    /// Too much of the rims is covered or otherwise not as printed.
    #[error("expected rims that agree with each other, found too many stretches that do not")]
    Obstructed,
}

/// How far outside the outer rim pixels count: pixels, and in blurs.
const REACH: (f64, f64) = (3.0, 3.5);
/// Besides half of the motion, of which this is the most, pixels.
const MAX_MOTION_PX: f64 = 8.0;
/// They end before the white margin does, which may be as narrow as this share of the outer semiaxis,
/// less so many pixels for the blur of its own edge: what lies beyond is not in the model …
const MARGIN: (f64, f64) = (0.3, 0.8);
/// … but never nearer than this.
const MIN_REACH_PX: f64 = 0.6;
/// Nodes stand this many blurs apart.
const SPACING: f64 = 1.45;
/// The window is so much wider than the pixels that count, so that contours may move.
const SLACK_PX: f64 = 9.0;

/// Fits the pose of a roundel of a known kind, from a start, to the frame's pixels.
pub fn fit(
    frame: &Frame,
    camera: &Camera,
    kind: &Kind,
    ring: &Ring,
    start: &Start,
    scratch: &mut FitScratch,
) -> Result<Fit, FitError> {
    let range_m = start.pose.position_m.norm();
    let facing = start.pose.normal.dot(&start.pose.position_m) < 0.0;
    if !(facing && range_m.is_finite() && ring.outer.is_valid() && start.blur_px.is_finite()) {
        return Err(FitError::Start);
    }
    let mut teeth_are_predicted = false;
    let (heading_rad, teeth) = match kind.pattern {
        Pattern::Plain => (None, None),
        Pattern::Elliptical { .. } => (Some(start.pose.yaw_rad.ok_or(FitError::Pattern)?), None),
        Pattern::Coded(_) => {
            let read_code = read_code(start, camera, ring);
            let (yaw_rad, teeth) =
                read_code.or(start.pose.yaw_rad.zip(start.teeth)).ok_or(FitError::Pattern)?;
            teeth_are_predicted = read_code.is_none();
            (Some(yaw_rad), Some(teeth))
        }
    };
    scratch.make_room(frame);
    let radius_m = 0.5 * kind.outer_diameter_m;
    let local_from_camera = frame_along(&(start.pose.position_m / range_m));
    let spread = 1.05 * radius_m / range_m;
    let skew = start.skew.as_ref();
    let with = (scratch.level, &scratch.plan);
    let lens = LocalLens::new(camera, local_from_camera, spread, skew, with)?;
    let blur_px = start.blur_px.clamp(BLUR_LIMITS_PX.0, BLUR_LIMITS_PX.1);
    let margin_px = (MARGIN.0 * ring.outer.semi_minor_px - MARGIN.1).max(MIN_REACH_PX);
    let max_px = if start.is_still { 0.0 } else { MAX_MOTION_PX };
    let motion_px = start.motion_px.cap_magnitude(max_px);
    let reach_px = (REACH.0.max(REACH.1 * blur_px) + 0.5 * motion_px.norm()).min(margin_px);
    let counted = ring.outer.grown(reach_px);
    let chords = Chords::new(&counted);
    scratch.window.set_region(window_of(&counted), (scratch.level, frame), &chords);
    let motion_prior = motion::prior(start.moved_px);
    let is_still = start.is_still;
    let problem = Problem {
        frame,
        kind,
        teeth,
        teeth_are_predicted,
        radius_m,
        lens: &lens,
        chords,
        motion_prior,
        is_still,
        cache: start.cache.as_ref(),
    };
    let normal = &start.pose.normal;
    let axes = match heading_rad {
        None => axes_of(&(local_from_camera * normal).normalize()),
        Some(yaw_rad) => local_from_camera * yaw::axes(normal, yaw_rad),
    };
    let place = PrintPose { position_m: Vector3::new(0.0, 0.0, range_m), axes };
    let first = State::new(place, ring, blur_px, &motion_px);
    let deviation_rad = heading_rad.map(|_| yaw::deviation_rad(&start.pose));
    let estimate_pose = estimate_pose(&problem, first, deviation_rad, &counted, scratch)?;
    let fit = finish(&problem, ring, &estimate_pose, scratch);
    match problem.teeth {
        Some(teeth) if teeth_are_predicted && !fit.resolves(teeth) => Err(FitError::Uninformative),
        _ => Ok(fit),
    }
}

/// Teeth that are not read are seen where the yaw's deviation is no more than this share of a slot: else the
/// fit may as well have settled at other ones.
const MAX_YAW_SHARE: f64 = 1.0 / 6.0;

impl Fit {
    /// Whether the pixels tell how these teeth are turned.
    fn resolves(&self, teeth: Teeth) -> bool {
        let slot_rad = std::f64::consts::PI / f64::from(teeth.bits);
        yaw::deviation_rad(&self.pose) < MAX_YAW_SHARE * slot_rad
    }
}

/// The yaw and the teeth that a reading gives a start.
fn read_code(start: &Start, camera: &Camera, ring: &Ring) -> Option<(f64, Teeth)> {
    let observed = ring.code?;
    let reading = start.skew.map_or(observed, |skew| skew.code(&observed));
    let mut turned = start.pose.clone();
    yaw::add(&mut turned, camera, &reading);
    Some((turned.yaw_rad?, Teeth { bits: reading.code.bits, word: reading.word? }))
}

/// Columns and rows of the window round the pixels that count.
fn window_of(counted: &Ellipse) -> ((i64, i64), (i64, i64)) {
    let (half_u, half_v) = counted.half_box_px();
    let range = |center: f64, half: f64| {
        ((center - half - SLACK_PX).floor() as i64, (center + half + SLACK_PX).ceil() as i64)
    };
    (range(counted.center.u, half_u), range(counted.center.v, half_v))
}

/// Columns a, b, n for a normal; a is arbitrary.
fn axes_of(normal: &Vector3<f64>) -> Matrix3<f64> {
    let helper = if normal.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    let b = normal.cross(&helper).normalize();
    Matrix3::from_columns(&[b.cross(normal), b, *normal])
}

/// A fit in the camera's frame.
fn finish(
    problem: &Problem,
    ring: &Ring,
    estimate_pose: &PoseEstimate,
    scratch: &mut FitScratch,
) -> Fit {
    let state = &estimate_pose.state;
    let camera_from_local = problem.lens.local_from_camera.transpose();
    let mut covariance = estimate_pose.covariance;
    // The two normals put the centre at slightly different places, and which is right is not known.
    let apart = camera_from_local * estimate_pose.other_offset_m;
    let mut position = covariance.fixed_view_mut::<3, 3>(0, 0);
    position += apart * apart.transpose() * (1.0 - estimate_pose.likelihood);
    let axes = camera_from_local * state.pose.axes;
    let (yaw_rad, yaw_symmetry) = match problem.kind.pattern {
        Pattern::Plain => (None, 1),
        Pattern::Elliptical { .. } => (Some(yaw::heading_rad(&axes)), 2),
        Pattern::Coded(_) => (Some(yaw::from_axes_rad(&axes)), 1),
    };
    let pose = RoundelPose {
        position_m: camera_from_local * state.pose.position_m,
        normal: axes.column(2).into_owned(),
        normal_likelihood: estimate_pose.likelihood,
        other_normal: camera_from_local * estimate_pose.other_normal,
        yaw_rad,
        yaw_symmetry,
        covariance,
    };
    let (outer, inner) =
        solution::rims(problem, state, scratch).unwrap_or((ring.outer, ring.inner));
    let ring = Ring { outer, inner, black: state.white + state.step, white: state.white, ..*ring };
    Fit {
        pose,
        ring,
        blur_px: state.blur2.sqrt(),
        motion_px: motion::from_square(&state.motion2),
        motion_variance_px4: estimate_pose.motion_variance,
        noise: estimate_pose.noise2.sqrt(),
        teeth: problem.teeth,
        iterations: estimate_pose.iterations,
        cache: estimate_pose.cache,
    }
}
