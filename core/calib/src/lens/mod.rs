//! A lens from views of a board: focal lengths, principal point, distortion, and how well each is known.
//!
//! In: the board's roundels as ellipses in raw pixels, or a chessboard's corners as points ([`Target`]), in some ten views
//! from different sides (`views`). Out: a [`Camera`] with the covariance of its parameters.
//!
//! The method is Zhang's (2000): a homography of each view (`views::homography`) gives the focal length
//! and where the board was (`fit::initial`); then all is refined together (`fit::bundle`) until the *ellipses' centres* are
//! where they should be. The image of a circle's centre is not its ellipse's centre, and a lens bends the ellipse as
//! well; so what is predicted is the centroid of the circle's image under the whole camera model
//! (`fit::rim`), exact to a thousandth of a pixel. Which distortion model is right is decided by its evidence, Schwarz's
//! criterion (`fit::model_selection`). Views that are blurred beside the others are left out (`views::blur`); roundels whose code was misread, and
//! views that were smeared, fall out by their errors.
//!
//! With 30 rendered views of 35 roundels (noise 2/255, blur 0.8 px) see `tests/tests/lens.rs` for what is
//! reached. Limits: the board is flat, and the shutter's time from row to row is not modelled, so the board should be
//! held still under a rolling shutter.

mod fit;
pub mod moving;
mod views;

use std::fmt;

use nalgebra::{DMatrix, Isometry3};
use thiserror::Error;

pub use self::{
    fit::{
        distortion_model::Model,
        model_selection::{Evidence, STRONG},
        size_check::Width,
    },
    views::{
        coverage::{Coverage, Side, VISITED, Want, ZONES},
        selection::{Chooser, Verdict},
        target::Target,
        view::{Sighting, View},
    },
};
use self::{
    fit::{initial, model_selection, size_check},
    views::{blur, layout_check},
};
use super::board::Board;
use roundel_vision::camera::Camera;

/// Fewest views that a lens is told from.
pub const LEAST_VIEWS: usize = 5;

/// A lens that was found.
#[derive(Clone, Debug)]
pub struct LensCalibration {
    /// The camera.
    pub camera: Camera,
    /// The model that was taken, and which of its coefficients were estimated; others are zero.
    pub model: Model,
    /// Covariance of fx, fy, cx, cy (pixels) and the estimated coefficients, in the model's order.
    pub covariance: DMatrix<f64>,
    /// Rms distance between seen and predicted centres, pixels.
    pub rms_px: f64,
    /// Each view as given, in order, or why it was left out.
    pub views: Vec<Result<ViewFit, LeftOut>>,
    /// Roundels, or corners, that were left out of the views that were used.
    pub outliers: usize,
    /// What speaks for each model, the likeliest first; a simpler one may have been taken ([`STRONG`]).
    pub evidence: Vec<Evidence>,
    /// How wide the roundels look beside their pitch, where that can be told.
    pub width: Option<Width>,
}

/// One view as it was fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewFit {
    /// camera_from_board, metres.
    pub pose: Isometry3<f64>,
    /// Rms distance between seen and predicted centres, pixels.
    pub rms_px: f64,
    /// Roundels, or corners, that were used.
    pub roundels: usize,
}

/// Why a view was left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeftOut {
    /// It is blurred beside the others.
    Blurred,
    /// It contradicts the others: smeared, bent, or of something else.
    Contradicts,
}

impl fmt::Display for LeftOut {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Blurred => "blurred beside the others",
            Self::Contradicts => "it contradicts the others",
        })
    }
}

impl LensCalibration {
    /// Standard deviations in the covariance's order.
    pub fn deviations(&self) -> Vec<f64> {
        self.covariance.diagonal().iter().map(|variance| variance.max(0.0).sqrt()).collect()
    }
}

/// Why there is no lens.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum LensCalibrationError {
    /// Not enough to tell anything.
    #[error("expected at least {LEAST_VIEWS} different views of the board, found {found}; {}", wants(.missing))]
    TooFew {
        /// Views that could be used.
        found: usize,
        /// What would help most.
        missing: Vec<Want>,
    },
    /// All from nearly the same side.
    #[error("the {found} views are too much alike to tell the focal length; {}", wants(.missing))]
    TooSimilar {
        /// Views that could be used.
        found: usize,
        /// What would help most.
        missing: Vec<Want>,
    },
    /// The print has other columns or rows than is said.
    #[error(
        "the print looks like {found_columns} x {found_rows} roundels, not {columns} x {rows}: describe it as it was \
         printed (`--board {found_columns}x{found_rows}`)"
    )]
    OtherBoard {
        /// As described.
        columns: usize,
        /// As described.
        rows: usize,
        /// As it looks.
        found_columns: usize,
        /// As it looks; there may be more beyond the pictures.
        found_rows: usize,
    },
    /// The print's roundels are wider or narrower, beside their pitch, than is said.
    #[error(
        "the roundels look {found_outer_mm:.1} mm wide, not {outer_mm:.1}, if they are {pitch_mm:.1} mm from one to the \
         next (or those {found_pitch_mm:.1} mm apart if {outer_mm:.1} mm wide): measure both on the print, and say them \
         (`--marker`, `--pitch`)"
    )]
    OtherWidth {
        /// Diameter, as described.
        outer_mm: f64,
        /// From centre to centre, as described.
        pitch_mm: f64,
        /// Diameter as it looks, beside the pitch.
        found_outer_mm: f64,
        /// From centre to centre as it looks, beside the diameter.
        found_pitch_mm: f64,
    },
    /// The picture has no such size.
    #[error("expected pictures of 16 to 16384 pixels a side, found {width} x {height}")]
    Size {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// No model explains what was seen.
    #[error(
        "no lens explains the views: is the board flat, printed at 100 %, and described as it was printed \
         ({columns} x {rows}, {pitch_mm} mm from one to the next)?"
    )]
    Unexplained {
        /// The board's.
        columns: usize,
        /// The board's.
        rows: usize,
        /// The board's.
        pitch_mm: f64,
    },
}

fn wants(missing: &[Want]) -> String {
    if missing.is_empty() {
        return "move the board about".to_owned();
    }
    let wants: Vec<String> = missing.iter().map(Want::to_string).collect();
    format!("still missing: {}", wants.join("; "))
}

/// [`LensCalibrationError::OtherBoard`], if the views are those of another board than is described.
fn other_board(board: &Board, views: &[View]) -> Option<LensCalibrationError> {
    let others: Vec<_> =
        views.iter().filter_map(|view| layout_check::other_sides(board, view)).collect();
    let fewer = || Some((board.columns(), layout_check::fewer_rows(board, views.iter())?));
    let (found_columns, found_rows) = if others.len() > views.len() / 2 {
        // The view that shows most of it.
        others.into_iter().max_by_key(|&(_, rows)| rows)?
    } else {
        fewer()?
    };
    let (columns, rows) = (board.columns(), board.rows());
    Some(LensCalibrationError::OtherBoard { columns, rows, found_columns, found_rows })
}

/// Finds the lens of a camera of `size` = (columns, rows) from views of a board; with `model` of that one, else of
/// the one for which most speaks.
pub fn calibrate(
    target: &Target,
    size: (usize, usize),
    views: &[View],
    model: Option<Model>,
) -> Result<LensCalibration, LensCalibrationError> {
    let (width, height) = size;
    let is_side = |side: usize| (16..=roundel_vision::camera::MAX_SIDE_PX).contains(&side);
    if !(is_side(width) && is_side(height)) {
        return Err(LensCalibrationError::Size { width, height });
    }
    if let Some(other) = target.board().and_then(|board| other_board(board, views)) {
        return Err(other);
    }
    let blurs_px: Vec<Option<f64>> = views.iter().map(|view| view.blur_px).collect();
    let blurred = blur::blurred(&blurs_px);
    let started = initial::start(target, size, views, &blurred)?;
    let models = model.map_or_else(|| Model::ALL.to_vec(), |model| vec![model]);
    let outcome = model_selection::best(target, size, &started, &models).ok_or_else(|| {
        LensCalibrationError::Unexplained {
            columns: target.columns(),
            rows: target.rows(),
            pitch_mm: target.pitch_m() * 1e3,
        }
    })?;
    let found = outcome.told(&blurred, &started);
    let width = size_check::check(target, views, &found)?;
    Ok(LensCalibration { width, ..found })
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
    use rand::{RngExt as _, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};

    use super::*;
    use crate::checkerboard::Checkerboard;
    use roundel_vision::{
        camera::{Intrinsics, Lens, PixelPoint},
        marker::CodeLayout,
    };

    const SIZE: (usize, usize) = (1280, 720);
    const NOISE_PX: f64 = 0.03;

    fn board() -> Target {
        Board::new((7, 5), 0.036, 0.03, CodeLayout { bits: 9, min_distance: 1 }).unwrap().into()
    }

    fn camera(lens: Lens) -> Camera {
        Camera::new(Intrinsics {
            width: SIZE.0,
            height: SIZE.1,
            fx_px: 905.0,
            fy_px: 902.0,
            cx_px: 652.0,
            cy_px: 351.0,
            lens,
        })
        .unwrap()
    }

    /// Views from all sides, as the camera sees the roundels whole.
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
                let Some(center) = target.at(number) else { continue };
                let at = pose * Point3::new(center.x, center.y, 0.0);
                let Ok(pixel) = camera.project(&at.coords) else { continue };
                let imaged = target.rim_m().map(|it| fit::rim::image(camera, &pose, &center, it));
                let Ok(imaged) = imaged.transpose() else { continue };
                let (u, v) = imaged.as_ref().map_or((0.0, 0.0), |image| image.offset_px);
                let radius_px = 0.015 * 900.0 / at.z;
                let inside =
                    |place: f64, side: usize| place > radius_px && place < side as f64 - radius_px;
                if inside(pixel.u, SIZE.0) && inside(pixel.v, SIZE.1) {
                    let center = PixelPoint {
                        u: pixel.u + u + noise.sample(rng),
                        v: pixel.v + v + noise.sample(rng),
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
        // Two codes misread as each other, and a view that is smeared.
        let (one, other) = (views[3].sightings[2].center, views[3].sightings[9].center);
        (views[3].sightings[2].center, views[3].sightings[9].center) = (other, one);
        let smear = Normal::new(0.0, 1.0).unwrap();
        for sighting in &mut views[7].sightings {
            sighting.center.u += smear.sample(&mut rng);
        }
        let found = calibrate(&board(), SIZE, &views, None).unwrap();
        assert_eq!(found.model.ros_name(), expected, "{:?}", found.evidence);
        let (is, was) = (found.camera.intrinsics(), truth.intrinsics());
        let errors = [
            is.fx_px - was.fx_px,
            is.fy_px - was.fy_px,
            is.cx_px - was.cx_px,
            is.cy_px - was.cy_px,
        ];
        for (error, deviation) in errors.iter().zip(found.deviations()) {
            assert!(error.abs() < 4.0 * deviation, "{errors:?}, {:?}", found.deviations());
            assert!(deviation < 0.3, "{:?}", found.deviations());
        }
        let views = (found.views[3], found.views[7]);
        assert!(
            views.0.is_ok_and(|view| view.rms_px < 0.1) && views.1 == Err(LeftOut::Contradicts),
            "{views:?}"
        );
        assert!((found.rms_px / (NOISE_PX * 2.0_f64.sqrt()) - 1.0).abs() < 0.1, "{}", found.rms_px);
    }

    #[test]
    fn a_plumb_bob_lens_is_found_with_its_deviations() {
        check(Lens::PlumbBob([-0.12, 0.03, 0.001, -0.0008, 0.0]), "plumb_bob");
    }

    #[test]
    fn a_fisheye_is_found_and_told_from_other_lenses() {
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
            let found = calibrate(&board(), SIZE, &views, Some(Model::Radial2)).unwrap();
            let is = found.camera.intrinsics();
            let k = is.lens.coefficients();
            let errors = [
                is.fx_px - 905.0,
                is.fy_px - 902.0,
                is.cx_px - 652.0,
                is.cy_px - 351.0,
                k[0] + 0.1,
                k[1] - 0.02,
            ];
            for ((sum, error), deviation) in squares.iter_mut().zip(errors).zip(found.deviations())
            {
                *sum += (error / deviation).powi(2) / SEEDS as f64;
            }
        }
        // Chi square with 30 degrees of freedom over 30: 0.45 to 1.8 holds 99.8 % for one of them.
        assert!(squares.iter().all(|square| (0.4..1.9).contains(square)), "{squares:?}");
    }

    #[test]
    fn corners_tell_a_lens_as_roundels_do() {
        let target = Target::from(Checkerboard::new((9, 6), 0.025).unwrap());
        let truth = camera(Lens::PlumbBob([-0.12, 0.03, 0.001, -0.0008, 0.0]));
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let views = views_of(&target, &truth, 20, 0.7, &mut rng);
        let found = calibrate(&target, SIZE, &views, None).unwrap();
        let (is, was) = (found.camera.intrinsics(), truth.intrinsics());
        let errors = [is.fx_px - was.fx_px, is.fy_px - was.fy_px, is.cx_px - was.cx_px];
        for (error, deviation) in errors.iter().zip(found.deviations()) {
            assert!(error.abs() < 4.0 * deviation && deviation < 0.3, "{errors:?}");
        }
        assert!((found.rms_px / (NOISE_PX * 2.0_f64.sqrt()) - 1.0).abs() < 0.1, "{}", found.rms_px);
    }

    #[test]
    fn too_few_or_similar_views_end_in_what_is_missing() {
        let truth = camera(Lens::PlumbBob([0.0; 5]));
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let few = views(&truth, 3, 0.7, &mut rng);
        let error = calibrate(&board(), SIZE, &few, None).unwrap_err().to_string();
        assert!(error.contains("found 3") && error.contains("still missing"), "{error}");
        let flat = views(&truth, 12, 0.02, &mut rng);
        let error = calibrate(&board(), SIZE, &flat, None).unwrap_err().to_string();
        assert!(
            error.contains("too much alike") && error.contains("nearer to the camera"),
            "{error}"
        );
    }

    #[test]
    fn a_board_with_another_pitch_than_is_said_is_told() {
        let truth = camera(Lens::PlumbBob([-0.1, 0.02, 0.0, 0.0, 0.0]));
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let views = views(&truth, 12, 0.7, &mut rng);
        let layout = CodeLayout { bits: 9, min_distance: 1 };
        let said = |pitch_m: f64| Target::from(Board::new((7, 5), pitch_m, 0.03, layout).unwrap());
        // What a ruler may be off by is none.
        assert!(calibrate(&said(0.0365), SIZE, &views, None).is_ok());
        for pitch_m in [0.06, 0.0385] {
            let error = calibrate(&said(pitch_m), SIZE, &views, None).unwrap_err().to_string();
            assert!(error.contains("(or those 36.0 mm apart"), "{error}");
            let found_mm = format!("look {:.1} mm wide, not 30.0", 30.0 * pitch_m / 0.036);
            assert!(error.contains(&found_mm), "{error}");
        }
    }

    #[test]
    fn a_pitch_that_is_some_percent_off_is_told_with_numbers_however_pictures_bloom() {
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
                let width = found.width.unwrap();
                assert_eq!(width.is_doubtful(), is_doubtful, "{bloom_px} px: {width:?}");
                assert!((width.found_pitch_mm() - 36.0).abs() < 0.1, "{bloom_px} px: {width:?}");
            }
        }
    }

    #[test]
    fn a_chooser_keeps_what_is_new_and_still() {
        let truth = camera(Lens::PlumbBob([0.0; 5]));
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let views = views(&truth, 3, 0.7, &mut rng);
        let mut chooser = Chooser::new(board(), SIZE, true);
        assert_eq!(chooser.offer(View::default()), Verdict::NoBoard);
        assert_eq!(chooser.offer(views[0].clone()), Verdict::Moving);
        assert_eq!(chooser.offer(views[0].clone()), Verdict::Taken);
        assert_eq!(chooser.offer(views[0].clone()), Verdict::Alike(0));
        assert_eq!(chooser.offer(views[1].clone()), Verdict::Moving);
        let cut = View { sightings: views[1].sightings[..17].to_vec(), ..View::default() };
        assert_eq!(chooser.offer(cut), Verdict::TooLittle, "17 of 35");
        assert_eq!(chooser.taken().len(), 1);
        let mut photographs = Chooser::new(board(), SIZE, false);
        assert_eq!(photographs.offer(views[0].clone()), Verdict::Taken);
        assert_eq!(photographs.offer(views[1].clone()), Verdict::Taken);
    }
}
