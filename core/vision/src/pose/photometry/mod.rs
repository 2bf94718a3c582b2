//! Pose of a roundel from the grey levels of its pixels: the precise mode.
//!
//! In: a frame, a ring found in it, and a pose from its rims. Out: the pose whose image, through
//! the lens, is closest to the pixels in the least-squares sense, which is the maximum of the
//! likelihood for uniform Gaussian noise, with covariance.
//!
//! **Image** (`model`). A pixel at (p, q) sees the print through K = k(x - p) k(y - q), the pixel's
//! box blurred by a Gaussian of standard deviation σ. With the imaged black area Ω, whose contour
//! is oriented so that black is positive, its black share follows by Green's theorem:
//!
//!   d(p, q) = ∬_Ω K = -∮ A(y - q) k(x - p) dx,   A' = k,
//!
//! and its grey level is W + C d. This is exact for any size and tilt, where a local edge model
//! fails for a disc as small as the blur. Nodes 1.3 σ apart along the contour are enough.
//!
//! **Derivatives.** A parameter that moves the contour by v changes d by -v·∇d where v varies
//! slowly, as it does over the width of a rim. ∇d and ∇²d = 2 ∂d/∂σ², differences of the image
//! itself, therefore give all columns. Only the columns are approximate, which costs precision to
//! second order, since the exact residual averages to zero at the truth.
//!
//! **Unknowns** (`solver`). Shift across the line of sight, logarithm of the range, two tilts;
//! white level, step to black, σ², motion within the exposure, and the gradient of the light over
//! the ring (prior of a tenth), which would otherwise pass for tilt. Gauss-Newton steps, damped
//! where they fail.
//!
//! **Two normals** (`hypotheses`). Mirrored along the line of sight, a roundel looks nearly the
//! same. The residual of the mirrored pose is projected with the information of the first; if it
//! promises a smaller misfit, it is fitted as well. The likelihoods of the two follow from the
//! difference of their misfits over the noise. Face-on the image depends only on the square of the
//! tilt; the curvature of the elongation's information keeps steps finite there, and the pose is
//! the mean of the posterior, as in [`super::locate`].
//!
//! **Noise.** The variance of a pixel is that of the residuals. Where these are correlated over
//! patches of pixels, or white or black is near an end of the scale, the ring is fitted again with
//! clipped levels, bloom, and levels of each stretch of the rims (`robust`), or rejected.
//!
//! **Heading, teeth.** The contour of an elliptical disc rotates with the print; its heading is
//! found by the profile of the misfit. Where a coded print has been read, its contour is known
//! completely, arcs and radial edges, from the yaw of the reading, which is fitted along. A frame
//! without a reading uses the teeth of earlier frames (`history`).
//!
//! **Accuracy** (`roundel-tests`, `tests/photometry.rs`: tilt 15° to 60°, unknown blur of 0.5 to
//! 1.1 px and noise of 1 to 4, contrast 160): rms of the depth over the Cramér-Rao bound 1.23 at 12
//! to 20 px, 1.13 at 20 to 30, 0.94 at 30 to 60, 0.83 at 60 to 110 (80 roundels each, so to 8 %);
//! no bias; the same for normals; 96 to 98 % of the positions inside the stated 95 % ellipsoid.
//! Coded (`tests/coded.rs`): depth 1.0 to 1.1 times the bound from 36 to 110 px, yaw 1.0 times.
//! Time: `benches/fit.rs`.
//!
//! **Limits.** Rejected are coded prints whose teeth no frame has read, and elliptical discs whose
//! rim is partly occluded. The counted pixels reach 3 px, or 3.5 blurs,
//! beyond the outer rim, less where the paper ends before (`margin`). Its edge is fitted and subtracted
//! (`marker::paper_edge`).

mod history;
mod hypotheses;
mod margin;
mod model;
mod robust;
mod solver;
#[cfg(test)]
mod tests;

use fearless_simd::Level;
use nalgebra::{Matrix3, Vector2, Vector3};
use thiserror::Error;

use crate::{
    camera::{Camera, LensError},
    frame::Frame,
    marker::{CODED_SHARE, Kind, PaperEdge, Pattern, Ring},
    pose::{PrintDeviation, RoundelPose, Skew, frame_along, yaw},
};
pub(super) use history::FitHistory;
use hypotheses::{FitPath, estimate_pose};
pub use model::teeth::Teeth;
use model::{
    ModelScratch, blur_kernel::BLUR_LIMITS_PX, local_lens::LocalLens, motion, projection::PrintPose,
};
use robust::RobustScratch;
use solver::{
    solution::{self, PoseEstimate},
    state::{Problem, State},
};

/// A ring in a frame.
#[derive(Clone, Copy, Debug)]
pub struct FitInput<'a> {
    /// The frame.
    pub frame: &'a Frame<'a>,
    /// Model of the camera.
    pub camera: &'a Camera,
    /// Kind of the ring.
    pub kind: &'a Kind,
    /// The ring as detected in the frame.
    pub ring: &'a Ring,
    /// How the print differs from its kind.
    pub print: PrintDeviation,
    /// Effect of a rolling shutter.
    pub skew: Option<Skew>,
}

/// Start of a fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Start {
    /// From [`super::locate`] or predicted; accurate to a third of a pixel and some degrees.
    pub pose: RoundelPose,
    /// Standard deviation of the blur, pixels, or [`DEFAULT_BLUR_PX`].
    pub blur_px: f64,
    /// Motion within the exposure, pixels, or zero.
    pub motion_px: Vector2<f64>,
    /// Displacement of the ring since the frame before, pixels, an upper bound of the motion within
    /// an exposure; infinite if unknown.
    pub moved_px: f64,
    /// Holds the motion at zero, which is faster. It is free nevertheless where noise does not
    /// explain the residual.
    pub is_still: bool,
    /// Teeth of a coded print from earlier frames, for a frame without a reading. The pose then has
    /// a yaw, accurate to a fraction of a slot.
    pub teeth: Option<Teeth>,
}

/// Blur of a start about which nothing is known, pixels.
pub const DEFAULT_BLUR_PX: f64 = 0.7;

/// A pose fitted to grey levels.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// The pose.
    pub pose: RoundelPose,
    /// Rims that this pose implies; black and white as fitted.
    pub ring: Ring,
    /// Standard deviation of the blur, pixels.
    pub blur_px: f64,
    /// Motion within the exposure, pixels, or its opposite, which looks the same. The pose is that
    /// at the middle of the exposure.
    pub motion_px: Vector2<f64>,
    /// Standard deviation of the residual, grey levels: the noise of the image, if the model holds.
    pub noise: f64,
    /// Number of iterations.
    pub iterations: usize,
}

/// A fit with what [`FitHistory`] keeps of it.
struct Outcome {
    fit: Fit,
    /// Variance by noise of either component of the motion's square, px⁴; `None` where the motion
    /// was held.
    motion_variance_px4: Option<f64>,
    teeth: Option<Teeth>,
    path: FitPath,
    /// As in [`Memory`].
    clear_px: f64,
}

/// What an earlier frame tells a fit besides its start.
#[derive(Clone, Copy, Debug, Default)]
struct Memory {
    path: FitPath,
    /// Distance from the outer rim up to which there is margin alone, pixels; measured if `None`.
    clear_px: Option<f64>,
}

/// Why a ring has no fitted pose.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum FitError {
    /// The start is behind the camera or faces away from it.
    #[error("expected a start in front of the camera and facing it, found another")]
    Start,
    /// The printed pattern is unknown.
    #[error(
        "expected a coded ring whose teeth are known, and the start of an elliptical one with a yaw"
    )]
    Pattern,
    /// The lens model gives no pixels there.
    #[error("near the start: {0}")]
    Lens(#[from] LensError),
    /// The rims left the window.
    #[error("expected rims near those that were found, the fit went elsewhere")]
    OutOfWindow,
    /// The steps did not converge.
    #[error("expected a start from which the fit converges, found one from which it does not")]
    NotConverged,
    /// The pixels do not determine the pose.
    #[error("expected pixels that determine a pose, found too few or too uniform ones")]
    Uninformative,
    /// Too much of the rims is occluded or otherwise not as printed.
    #[error("expected rims that agree with each other, found too many stretches that do not")]
    Obstructed,
}

/// Working memory of fits, reused from fit to fit. The first fit reserves memory for rings as large
/// as the frame, so that later ones allocate nothing (`tests/allocation.rs`).
#[derive(Clone, Debug)]
pub struct FitScratch {
    model: ModelScratch,
    robust: RobustScratch,
    /// Width and height of the frames that memory is reserved for.
    size: [usize; 2],
}

impl Default for FitScratch {
    fn default() -> Self {
        Self::with_level(Level::new())
    }
}

/// Margin of the window around a ring as large as the frame.
const MARGIN_PX: usize = 64;

impl FitScratch {
    fn with_level(level: Level) -> Self {
        Self { model: ModelScratch::new(level), robust: RobustScratch::default(), size: [0; 2] }
    }

    /// Work of all fits so far: pixels of all linearizations, those of the robust fit, which take longer, four times. A measure of
    /// cost that is the same in each run.
    pub fn work(&self) -> u64 {
        self.model.work
    }

    /// Reserves memory for any ring in the frame; pages that no ring uses are not touched.
    fn reserve(&mut self, frame: &Frame) {
        let size = [frame.width(), frame.height()];
        if self.size == size {
            return;
        }
        self.size = size;
        let [columns, rows] = size.map(|side| side + MARGIN_PX);
        self.model.window.reserve(columns, rows);
        self.robust.reserve(columns * rows);
    }
}

/// Reach of the counted pixels beyond the outer rim: pixels, and in blurs.
const REACH: (f64, f64) = (3.0, 3.5);
/// Half of the motion adds to the reach, up to this.
const MAX_MOTION_PX: f64 = 8.0;
/// Reach by the usual margin of small rings: a share of the outer semiaxis, less pixels for the blur of
/// the paper's edge …
const USUAL_MARGIN: (f64, f64) = (0.3, 0.8);
/// … but at least this.
const MIN_REACH_PX: f64 = 0.6;
/// Width up to which a margin is searched, pixels.
const MAX_CLEAR_PX: f64 = 6.0;
/// A margin that is known up to less than the first distance, pixels, shifts the outer rim by the
/// second one, a standard deviation: what remains of the paper's edge.
const NARROW: (f64, f64) = (0.5, 0.02);
/// Fits the pose of a single roundel of a known kind to the frame's pixels.
pub fn fit(input: &FitInput, start: &Start, scratch: &mut FitScratch) -> Result<Fit, FitError> {
    fit_outcome(input, start, &Memory::default(), scratch).map(|outcome| outcome.fit)
}

/// Fits a tracked roundel, whose rims have this pose, from the state that its last fit left.
/// Returns the state for the next frame as well.
pub(super) fn fit_tracked(
    input: &FitInput,
    pose: &RoundelPose,
    history: Option<&FitHistory>,
    scratch: &mut FitScratch,
) -> Result<(Fit, FitHistory), FitError> {
    let start = history::start(pose, &input.ring.outer.center, history);
    let memory = history.map_or(Memory::default(), FitHistory::memory);
    let outcome = fit_outcome(input, &start, &memory, scratch)?;
    let next = FitHistory::new(&outcome, start.moved_px, history);
    Ok((outcome.fit, next))
}

fn fit_outcome(
    input: &FitInput,
    start: &Start,
    memory: &Memory,
    scratch: &mut FitScratch,
) -> Result<Outcome, FitError> {
    let FitInput { frame, camera, kind, ring, print, skew } = *input;
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
            let reading = read_code(input, &start.pose);
            teeth_are_predicted = reading.is_none();
            let (yaw_rad, teeth) =
                reading.or(start.pose.yaw_rad.zip(start.teeth)).ok_or(FitError::Pattern)?;
            (Some(yaw_rad), Some(teeth))
        }
    };
    scratch.reserve(frame);
    let model = &mut scratch.model;
    let radius_m = 0.5 * kind.outer_diameter_m;
    let local_from_camera = frame_along(&(start.pose.position_m / range_m));
    let spread = 1.05 * radius_m / range_m;
    let skew = skew.as_ref();
    let lens = LocalLens::new(camera, local_from_camera, spread, skew, model.level, &model.plan)?;
    let blur_px = start.blur_px.clamp(BLUR_LIMITS_PX.0, BLUR_LIMITS_PX.1);
    let max_px = if start.is_still { 0.0 } else { MAX_MOTION_PX };
    let motion_px = start.motion_px.cap_magnitude(max_px);
    let reach_px = REACH.0.max(REACH.1 * blur_px) + 0.5 * motion_px.norm();
    let clear_px =
        memory.clear_px.unwrap_or_else(|| margin::clear_px(frame, ring, MAX_CLEAR_PX, blur_px));
    let narrow_px = (USUAL_MARGIN.0 * ring.outer.semi_minor_px - USUAL_MARGIN.1).max(MIN_REACH_PX);
    let reach_px = reach_px.min(narrow_px);
    let disc_share = if teeth.is_some() { CODED_SHARE } else { 1.0 };
    let edge = if clear_px < reach_px {
        PaperEdge::around(model.level, frame, ring, disc_share)
    } else {
        None
    };
    let known_px = edge.as_ref().map_or(clear_px, PaperEdge::clear_px);
    let reach_px = reach_px.min(known_px);
    model.window.set_region(frame, &ring.outer.grown(reach_px));
    if let Some(edge) = &edge {
        model.work += PaperEdge::WORK + model.window.counted as u64;
        let light = edge.added_light();
        model.window.subtract(|u, v| light.at(u, v));
    }
    let problem = Problem {
        kind,
        print,
        teeth,
        teeth_are_predicted,
        radius_m,
        lens: &lens,
        motion_prior: motion::prior(start.moved_px),
        is_still: start.is_still,
    };
    let normal = &start.pose.normal;
    let axes = match heading_rad {
        None => axes_of(&(local_from_camera * normal).normalize()),
        Some(yaw_rad) => local_from_camera * yaw::axes(normal, yaw_rad),
    };
    let pose = PrintPose { position_m: Vector3::new(0.0, 0.0, range_m), axes };
    let first = State::new(pose, ring, blur_px, &motion_px);
    let deviation_rad = heading_rad.map(|_| yaw::deviation_rad(&start.pose));
    let (estimate, path) = estimate_pose(&problem, first, deviation_rad, &memory.path, scratch)?;
    let mut fit = finish(&problem, ring, &estimate, scratch);
    if known_px < NARROW.0 {
        fit.pose.add_size_deviation(NARROW.1 / ring.outer.mean_radius_px());
    }
    match teeth {
        Some(teeth) if teeth_are_predicted && !fit.resolves(teeth) => Err(FitError::Uninformative),
        _ => {
            let motion_variance_px4 = estimate.motion_variance;
            Ok(Outcome { fit, motion_variance_px4, teeth, path, clear_px })
        }
    }
}

/// Predicted teeth are confirmed where the standard deviation of the yaw is at most this share of a
/// slot; otherwise the fit may have converged to other ones.
const MAX_YAW_SHARE: f64 = 1.0 / 6.0;

impl Fit {
    fn resolves(&self, teeth: Teeth) -> bool {
        let slot_rad = std::f64::consts::PI / f64::from(teeth.bits);
        yaw::deviation_rad(&self.pose) < MAX_YAW_SHARE * slot_rad
    }
}

/// Yaw and teeth of the ring's reading, for a roundel of this pose.
fn read_code(input: &FitInput, pose: &RoundelPose) -> Option<(f64, Teeth)> {
    let observed = input.ring.code?;
    let reading = input.skew.map_or(observed, |skew| skew.code(&observed));
    let mut turned = pose.clone();
    yaw::add(&mut turned, input.camera, &reading);
    Some((turned.yaw_rad?, Teeth { bits: reading.code.bits, word: reading.word? }))
}

/// Columns a, b, n for a normal; the direction of a is arbitrary.
fn axes_of(normal: &Vector3<f64>) -> Matrix3<f64> {
    let helper = if normal.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    let b = normal.cross(&helper).normalize();
    Matrix3::from_columns(&[b.cross(normal), b, *normal])
}

/// The fit in the camera frame.
fn finish(
    problem: &Problem,
    ring: &Ring,
    estimate: &PoseEstimate,
    scratch: &mut FitScratch,
) -> Fit {
    let state = &estimate.state;
    let camera_from_local = problem.lens.local_from_camera.transpose();
    let mut covariance = estimate.covariance;
    // The two normals give slightly different positions, and which one is right is uncertain.
    let apart = camera_from_local * estimate.other_offset_m;
    let mut position = covariance.fixed_view_mut::<3, 3>(0, 0);
    position += apart * apart.transpose() * (1.0 - estimate.likelihood);
    let axes = camera_from_local * state.pose.axes;
    let (yaw_rad, yaw_symmetry) = match problem.kind.pattern {
        Pattern::Plain => (None, 1),
        Pattern::Elliptical { .. } => (Some(yaw::heading_rad(&axes)), 2),
        Pattern::Coded(_) => (Some(yaw::from_axes_rad(&axes)), 1),
    };
    let pose = RoundelPose {
        position_m: camera_from_local * state.pose.position_m,
        normal: axes.column(2).into_owned(),
        normal_likelihood: estimate.likelihood,
        other_normal: camera_from_local * estimate.other_normal,
        yaw_rad,
        yaw_symmetry,
        covariance,
    };
    let (outer, inner) =
        solution::rims(problem, state, &mut scratch.model).unwrap_or((ring.outer, ring.inner));
    let ring = Ring { outer, inner, black: state.white + state.step, white: state.white, ..*ring };
    Fit {
        pose,
        ring,
        blur_px: state.blur2.sqrt(),
        motion_px: motion::from_square(&state.motion2),
        noise: estimate.noise2.sqrt(),
        iterations: estimate.iterations,
    }
}
