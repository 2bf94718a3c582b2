//! Camera intrinsics from views of a board: focal lengths, principal point and distortion, with covariance.
//!
//! Input: some ten views from different directions ([`View`]) of a board of roundels (ellipses in raw pixels) or of a
//! chessboard (corners), described by a [`Target`]. Output: a [`Camera`] with the covariance of its parameters
//! ([`LensCalibration`]). [`moving`] calibrates from moving roundels instead.
//!
//! Method (Zhang 2000): homographies of the views (`views::homography`) give the focal length and the board poses
//! (`fit::initial`); bundle adjustment (`fit::bundle`) then minimizes the distances between observed and predicted
//! *ellipse centres*. The image of a circle's centre is not the centre of its ellipse, and distortion bends the ellipse;
//! the prediction is therefore the centroid of the circle's image under the whole camera model (`fit::rim`), exact to a
//! thousandth of a pixel. Schwarz's criterion selects the distortion model (`fit::model_selection`). Views that are
//! blurred relative to the others are left out (`views::blur`); misread codes and smeared views are rejected by their
//! residuals.
//!
//! Accuracy: `tests/tests/lens.rs`, with 30 rendered views of 35 roundels (noise 2/255, blur 0.8 px). Limits: the board is
//! flat, and the rolling shutter is not modelled, so the board must be held still in front of one.

mod fit;
pub mod moving;
mod views;

use std::fmt;

use nalgebra::{DMatrix, Isometry3};
use thiserror::Error;

use self::{
    fit::{diameter_check, initial, model_selection},
    views::{blur, layout_check},
};
pub use self::{
    fit::{
        diameter_check::DiameterCheck,
        distortion_model::DistortionModel,
        model_selection::{Evidence, STRONG_EVIDENCE},
    },
    views::{
        coverage::{Coverage, MIN_ZONE_SIGHTINGS, MissingView, Side, ZONES},
        selection::{ViewSelector, ViewVerdict},
        target::Target,
        view::{Sighting, View},
    },
};
use super::board::Board;
use roundel_vision::camera::{Camera, MAX_SIDE_PX};

/// Minimum number of views.
pub const MIN_VIEWS: usize = 5;

/// Result of a lens calibration.
#[derive(Clone, Debug)]
pub struct LensCalibration {
    /// The calibrated camera.
    pub camera: Camera,
    /// Selected model with its estimated coefficients; all others are zero.
    pub model: DistortionModel,
    /// Covariance of fx, fy, cx, cy (pixels) and of the estimated coefficients, in the model's order.
    pub covariance: DMatrix<f64>,
    /// Rms distance of observed and predicted centres, pixels.
    pub rms_px: f64,
    /// The fit of each given view, in order, or the reason for its rejection.
    pub views: Vec<Result<ViewFit, ViewRejection>>,
    /// Roundels or corners rejected from the views that were used.
    pub outliers: usize,
    /// Evidence for each model, best first; a simpler one may have been selected ([`STRONG_EVIDENCE`]).
    pub evidence: Vec<Evidence>,
    /// Comparison of the roundels' apparent and stated diameter; `None` if the views do not determine it.
    pub diameter_check: Option<DiameterCheck>,
}

/// Fit of one view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewFit {
    /// camera_from_board, metres.
    pub pose: Isometry3<f64>,
    /// Rms distance of observed and predicted centres, pixels.
    pub rms_px: f64,
    /// Number of roundels or corners used.
    pub roundels: usize,
}

/// Reason for the rejection of a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ViewRejection {
    /// Blurred relative to the other views.
    Blurred,
    /// Inconsistent with the other views: smeared, bent, or of another object.
    Contradicts,
}

impl fmt::Display for ViewRejection {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Blurred => "blurred beside the others",
            Self::Contradicts => "it contradicts the others",
        })
    }
}

impl LensCalibration {
    /// Standard deviations in the order of the covariance.
    pub fn deviations(&self) -> Vec<f64> {
        self.covariance.diagonal().iter().map(|variance| variance.max(0.0).sqrt()).collect()
    }
}

/// Why a lens calibration failed.
#[derive(Clone, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the comments of the variants cover their fields")]
pub enum LensCalibrationError {
    /// Too few usable views. The views that would help, most important first.
    #[error("expected at least {MIN_VIEWS} different views of the board, found {found}; {}", missing_views(.missing))]
    TooFew { found: usize, missing: Vec<MissingView> },
    /// All usable views are from nearly the same direction. The views that would help, most important first.
    #[error("the {found} views are too similar to determine the focal length; {}", missing_views(.missing))]
    TooSimilar { found: usize, missing: Vec<MissingView> },
    /// The print has other columns or rows than stated. It may have more rows than found, outside the pictures.
    #[error(
        "the print looks like {found_columns} x {found_rows} roundels, not {columns} x {rows}: describe it as it was \
         printed (`--board {found_columns}x{found_rows}`)"
    )]
    OtherBoard { columns: usize, rows: usize, found_columns: usize, found_rows: usize },
    /// The roundels have another ratio of diameter to pitch than stated. Each found dimension matches the other stated
    /// one.
    #[error(
        "the roundels look {found_outer_mm:.1} mm wide, not {outer_mm:.1}, if they are {pitch_mm:.1} mm from one to the \
         next (or those {found_pitch_mm:.1} mm apart if {outer_mm:.1} mm wide): measure both on the print, and pass them \
         (`--marker`, `--pitch`)"
    )]
    OtherWidth { outer_mm: f64, pitch_mm: f64, found_outer_mm: f64, found_pitch_mm: f64 },
    /// Size of the picture out of range.
    #[error("expected pictures of 16 to 16384 pixels a side, found {width} x {height}")]
    Size { width: usize, height: usize },
    /// No model fits the views of this board.
    #[error(
        "no lens explains the views: is the board flat, printed at 100 %, and described as it was printed \
         ({columns} x {rows}, {pitch_mm} mm from one to the next)?"
    )]
    Unexplained { columns: usize, rows: usize, pitch_mm: f64 },
}

fn missing_views(missing: &[MissingView]) -> String {
    if missing.is_empty() {
        return "move the board about".to_owned();
    }
    format!("still missing: {}", list(missing))
}

fn list<T: fmt::Display>(items: &[T]) -> String {
    items.iter().map(T::to_string).collect::<Vec<_>>().join("; ")
}

/// Returns [`LensCalibrationError::OtherBoard`] if the views show another board than described.
fn other_board(board: &Board, views: &[View]) -> Option<LensCalibrationError> {
    let others: Vec<_> =
        views.iter().filter_map(|view| layout_check::other_sides(board, view)).collect();
    let (found_columns, found_rows) = if others.len() > views.len() / 2 {
        // From the view that shows most of the board.
        others.into_iter().max_by_key(|&(_, rows)| rows)?
    } else {
        (board.columns(), layout_check::fewer_rows(board, views)?)
    };
    let (columns, rows) = (board.columns(), board.rows());
    Some(LensCalibrationError::OtherBoard { columns, rows, found_columns, found_rows })
}

fn is_picture_size((width, height): (usize, usize)) -> bool {
    let is_side = |side: usize| (16..=MAX_SIDE_PX).contains(&side);
    is_side(width) && is_side(height)
}

/// Calibrates a camera of `size` = (columns, rows) from views of a board, with the given `model` or the one
/// selected by evidence.
pub fn calibrate(
    target: &Target,
    size: (usize, usize),
    views: &[View],
    model: Option<DistortionModel>,
) -> Result<LensCalibration, LensCalibrationError> {
    if !is_picture_size(size) {
        let (width, height) = size;
        return Err(LensCalibrationError::Size { width, height });
    }
    if let Some(other) = target.board().and_then(|board| other_board(board, views)) {
        return Err(other);
    }
    let blurs_px: Vec<Option<f64>> = views.iter().map(|view| view.blur_px).collect();
    let blurred = blur::blurred(&blurs_px);
    let initial = initial::estimate(target, size, views, &blurred)?;
    let models = model.map_or_else(|| DistortionModel::ALL.to_vec(), |model| vec![model]);
    let found = model_selection::select_model(target, size, &initial, &models, &blurred);
    let found = found.ok_or_else(|| LensCalibrationError::Unexplained {
        columns: target.columns(),
        rows: target.rows(),
        pitch_mm: target.pitch_m() * 1e3,
    })?;
    let diameter_check = diameter_check::check(target, views, &found)?;
    Ok(LensCalibration { diameter_check, ..found })
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Translation3, UnitQuaternion, Vector2, Vector3};
    use rand::{RngExt as _, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};

    use super::*;
    use crate::{checkerboard::Checkerboard, test_world};
    use roundel_vision::{
        camera::{Lens, PixelPoint},
        marker::CodeLayout,
    };

    const SIZE: (usize, usize) = (1280, 720);
    const NOISE_PX: f64 = 0.03;

    fn board() -> Target {
        Board::new((7, 5), 0.036, 0.03, CodeLayout { bits: 9, min_distance: 1 }).unwrap().into()
    }

    fn camera(lens: Lens) -> Camera {
        test_world::camera(SIZE, [905.0, 902.0, 652.0, 351.0], lens)
    }

    /// Views from all directions that show at least 20 whole roundels.
    fn views(camera: &Camera, count: usize, tilt_rad: f64, rng: &mut ChaCha8Rng) -> Vec<View> {
        views_of(&board(), camera, count, tilt_rad, rng)
    }

    fn views_of(
        target: &Target,
        camera: &Camera,
        count: usize,
        tilt_rad: f64,
        rng: &mut ChaCha8Rng,
    ) -> Vec<View> {
        let noise = Normal::new(0.0, NOISE_PX).unwrap();
        let mut views = Vec::new();
        while views.len() < count {
            let mut within = |range: f64| rng.random_range(-range..=range);
            let axis = Vector3::new(within(1.0), within(1.0), 0.0);
            let lean = UnitQuaternion::from_scaled_axis(axis.normalize() * within(tilt_rad));
            let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * within(0.4));
            let faced = UnitQuaternion::from_scaled_axis(Vector3::x() * std::f64::consts::PI);
            let place = Vector3::new(within(0.13), within(0.07), 0.32 + within(0.1));
            let pose = Isometry3::from_parts(Translation3::from(place), lean * turn * faced);
            let mut sightings = Vec::new();
            for number in 1..=(target.columns() * target.rows()) as u16 {
                let Some(center) = target.point_m(number) else { continue };
                let at = pose * Point3::new(center.x, center.y, 0.0);
                let Ok(pixel) = camera.project(&at.coords) else { continue };
                let imaged =
                    target.rim_m().map(|it| fit::rim::project_rim(camera, &pose, &center, it));
                let Ok(imaged) = imaged.transpose() else { continue };
                let offset_px = imaged.as_ref().map_or_else(Vector2::zeros, |it| it.offset_px);
                let radius_px = 0.015 * 900.0 / at.z;
                let inside =
                    |place: f64, side: usize| place > radius_px && place < side as f64 - radius_px;
                if inside(pixel.u, SIZE.0) && inside(pixel.v, SIZE.1) {
                    let center = PixelPoint {
                        u: pixel.u + offset_px.x + noise.sample(rng),
                        v: pixel.v + offset_px.y + noise.sample(rng),
                    };
                    let radius_px = imaged.map_or(radius_px, |image| image.radius_px);
                    sightings.push(Sighting { number, center, radius_px });
                }
            }
            if sightings.len() >= 20 {
                views.push(View { sightings, ..View::default() });
            }
        }
        views
    }

    fn check(lens: Lens, expected: &str) {
        let truth = camera(lens);
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut views = views(&truth, 24, 0.7, &mut rng);
        // Two codes misread as each other, and a smeared view.
        let (one, other) = (views[3].sightings[2].center, views[3].sightings[9].center);
        (views[3].sightings[2].center, views[3].sightings[9].center) = (other, one);
        let smear = Normal::new(0.0, 1.0).unwrap();
        for sighting in &mut views[7].sightings {
            sighting.center.u += smear.sample(&mut rng);
        }
        let found = calibrate(&board(), SIZE, &views, None).unwrap();
        assert_eq!(found.model.ros_name(), expected, "{:?}", found.evidence);
        let errors = test_world::pinhole_errors(&found.camera, &truth);
        for (error, deviation) in errors.iter().zip(found.deviations()) {
            assert!(error.abs() < 4.0 * deviation, "{errors:?}, {:?}", found.deviations());
            assert!(deviation < 0.3, "{:?}", found.deviations());
        }
        let views = (found.views[3], found.views[7]);
        assert!(
            views.0.is_ok_and(|view| view.rms_px < 0.1)
                && views.1 == Err(ViewRejection::Contradicts),
            "{views:?}"
        );
        assert!((found.rms_px / (NOISE_PX * 2.0_f64.sqrt()) - 1.0).abs() < 0.1, "{}", found.rms_px);
    }

    #[test]
    fn a_plumb_bob_lens_is_found_with_its_deviations() {
        check(Lens::PlumbBob([-0.12, 0.03, 0.001, -0.0008, 0.0]), "plumb_bob");
    }

    #[test]
    fn a_fisheye_lens_is_identified() {
        check(Lens::Equidistant([0.02, -0.01, 0.0, 0.0]), "equidistant");
    }

    #[test]
    fn deviations_are_consistent() {
        let truth = camera(Lens::PlumbBob([-0.1, 0.02, 0.0, 0.0, 0.0]));
        let mut squares = [0.0; 6];
        const SEEDS: u64 = 30;
        for seed in 0..SEEDS {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let views = views(&truth, 12, 0.7, &mut rng);
            let found = calibrate(&board(), SIZE, &views, Some(DistortionModel::Radial2)).unwrap();
            let k = found.camera.intrinsics().lens.coefficients();
            let errors = test_world::pinhole_errors(&found.camera, &truth);
            let errors = errors.into_iter().chain([k[0] + 0.1, k[1] - 0.02]);
            for ((sum, error), deviation) in squares.iter_mut().zip(errors).zip(found.deviations())
            {
                *sum += (error / deviation).powi(2) / SEEDS as f64;
            }
        }
        // χ² with 30 degrees of freedom, over 30: 99.8 % lie between 0.45 and 1.8 for a single parameter.
        assert!(squares.iter().all(|square| (0.4..1.9).contains(square)), "{squares:?}");
    }

    #[test]
    fn corners_calibrate_as_roundels_do() {
        let target = Target::from(Checkerboard::new((9, 6), 0.025).unwrap());
        let truth = camera(Lens::PlumbBob([-0.12, 0.03, 0.001, -0.0008, 0.0]));
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let views = views_of(&target, &truth, 20, 0.7, &mut rng);
        let found = calibrate(&target, SIZE, &views, None).unwrap();
        let errors = test_world::pinhole_errors(&found.camera, &truth);
        for (error, deviation) in errors.iter().zip(found.deviations()) {
            assert!(error.abs() < 4.0 * deviation && deviation < 0.3, "{errors:?}");
        }
        assert!((found.rms_px / (NOISE_PX * 2.0_f64.sqrt()) - 1.0).abs() < 0.1, "{}", found.rms_px);
    }

    #[test]
    fn too_few_or_similar_views_are_rejected_with_advice() {
        let truth = camera(Lens::PlumbBob([0.0; 5]));
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let few = views(&truth, 3, 0.7, &mut rng);
        let error = calibrate(&board(), SIZE, &few, None).unwrap_err().to_string();
        assert!(error.contains("found 3") && error.contains("still missing"), "{error}");
        let flat = views(&truth, 12, 0.02, &mut rng);
        let error = calibrate(&board(), SIZE, &flat, None).unwrap_err().to_string();
        assert!(error.contains("too similar") && error.contains("nearer to the camera"), "{error}");
    }

    #[test]
    fn a_wrong_pitch_is_rejected() {
        let truth = camera(Lens::PlumbBob([-0.1, 0.02, 0.0, 0.0, 0.0]));
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let views = views(&truth, 12, 0.7, &mut rng);
        let layout = CodeLayout { bits: 9, min_distance: 1 };
        let stated =
            |pitch_m: f64| Target::from(Board::new((7, 5), pitch_m, 0.03, layout).unwrap());
        // An error of a ruler is accepted.
        assert!(calibrate(&stated(0.0365), SIZE, &views, None).is_ok());
        for pitch_m in [0.06, 0.0385] {
            let error = calibrate(&stated(pitch_m), SIZE, &views, None).unwrap_err().to_string();
            assert!(error.contains("(or those 36.0 mm apart"), "{error}");
            let found_mm = format!("look {:.1} mm wide, not 30.0", 30.0 * pitch_m / 0.036);
            assert!(error.contains(&found_mm), "{error}");
        }
    }

    #[test]
    fn a_pitch_some_percent_off_is_measured_despite_blooming() {
        let truth = camera(Lens::PlumbBob([-0.1, 0.02, 0.0, 0.0, 0.0]));
        let layout = CodeLayout { bits: 9, min_distance: 1 };
        for bloom_px in [-0.6, 0.0, 0.6] {
            let mut rng = ChaCha8Rng::seed_from_u64(6);
            let mut views = views(&truth, 12, 0.7, &mut rng);
            for sighting in views.iter_mut().flat_map(|view| &mut view.sightings) {
                sighting.radius_px += bloom_px;
            }
            for (pitch_mm, is_doubtful) in
                [(36.0, false), (36.3, false), (36.5, true), (35.3, true), (37.0, true)]
            {
                let board = Board::new((7, 5), pitch_mm * 1e-3, 0.03, layout).unwrap();
                let found = calibrate(&Target::from(board), SIZE, &views, None).unwrap();
                let check = found.diameter_check.unwrap();
                assert_eq!(check.is_doubtful(), is_doubtful, "{bloom_px} px: {check:?}");
                assert!((check.found_pitch_mm() - 36.0).abs() < 0.1, "{bloom_px} px: {check:?}");
            }
        }
    }

    #[test]
    fn a_selector_keeps_new_still_views() {
        let truth = camera(Lens::PlumbBob([0.0; 5]));
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let views = views(&truth, 3, 0.7, &mut rng);
        let mut selector = ViewSelector::new(board(), SIZE, true);
        assert_eq!(selector.offer(View::default()), ViewVerdict::NoBoard);
        assert_eq!(selector.offer(views[0].clone()), ViewVerdict::Moving);
        assert_eq!(selector.offer(views[0].clone()), ViewVerdict::Taken);
        assert_eq!(selector.offer(views[0].clone()), ViewVerdict::Duplicate(0));
        assert_eq!(selector.offer(views[1].clone()), ViewVerdict::Moving);
        let cut = View { sightings: views[1].sightings[..17].to_vec(), ..View::default() };
        assert_eq!(selector.offer(cut), ViewVerdict::TooLittle, "17 of 35");
        assert_eq!(selector.taken().len(), 1);
        let mut photographs = ViewSelector::new(board(), SIZE, false);
        assert_eq!(photographs.offer(views[0].clone()), ViewVerdict::Taken);
        assert_eq!(photographs.offer(views[1].clone()), ViewVerdict::Taken);
    }
}
