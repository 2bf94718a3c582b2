//! Tables 3 and 4: precision of roundels on the hall's floor, in space and on the plane.
//!
//! As in the paper, four roundels define the frame. The error of the others is the distance between measured and
//! nominal position, absolute, and relative to the distance from the camera. In space, the camera's pose is estimated
//! from the four poses ([`align`]), and the others' poses follow. On the plane, a [`Homography`] maps their centres.
//! The lens is calibrated, separately for every picture.

use std::sync::{Mutex, PoisonError};

use anyhow::Context;
use nalgebra::{Matrix3, Point3, Vector2, Vector3};
use roundel_core::{
    camera::NormalizedPoint,
    marker::Params,
    world::reference::{Homography, Sighting, align},
};

use super::{
    Aim, Length, Row, Table,
    hall::{Hall, OUTER_M, View},
    lens::{Calibrated, calibrated},
    predictions::{Prediction, predicted},
    scene::{MARGIN, PaperCamera, RATIO},
};
use crate::{
    arena::Kind,
    pipeline::Observer,
    render::{Image, Print},
};

/// One detected roundel or marker: its centre on the plane z = 1 of the camera, and its position if available.
#[derive(Clone, Copy, Debug)]
pub struct Sight {
    /// Undistorted.
    pub image: NormalizedPoint,
    /// In the camera frame.
    pub place: Option<Sighting>,
}

/// Errors in one picture.
#[derive(Clone, Copy, Debug, Default)]
pub struct Errors {
    /// Mean.
    pub mean_m: f64,
    /// Maximum.
    pub max_m: f64,
    /// Mean of the errors relative to the distance.
    pub mean_share: f64,
    /// Maximum of the relative errors.
    pub max_share: f64,
    /// Mean error if the true positions of the roundels were known instead of the nominal ones.
    pub exact_m: f64,
    /// The same relative to the distance.
    pub exact_share: f64,
    /// Number of measured roundels.
    pub found: f64,
    /// Number of roundels to measure.
    pub expected: f64,
}

impl Errors {
    /// Means over pictures.
    pub fn mean(pictures: &[Self]) -> Self {
        let mean = |field: fn(&Self) -> f64| {
            pictures.iter().map(field).sum::<f64>() / pictures.len() as f64
        };
        Self {
            mean_m: mean(|it| it.mean_m),
            max_m: mean(|it| it.max_m),
            mean_share: mean(|it| it.mean_share),
            max_share: mean(|it| it.max_share),
            exact_m: mean(|it| it.exact_m),
            exact_share: mean(|it| it.exact_share),
            found: mean(|it| it.found),
            expected: mean(|it| it.expected),
        }
    }

    fn of(hall: &Hall, sights: &[Option<Sight>], locate: Locate) -> anyhow::Result<Self> {
        let stated = Self::against(hall, &hall.stated_m, &locate(&hall.stated_m, sights)?);
        let exact = Self::against(hall, &hall.true_m, &locate(&hall.true_m, sights)?);
        Ok(Self { exact_m: exact.mean_m, exact_share: exact.mean_share, ..stated })
    }

    fn against(hall: &Hall, places_m: &[Vector3<f64>], found_m: &Found) -> Self {
        let mut errors = Self::default();
        let measured = |(index, _): &(usize, _)| !Hall::is_reference(*index);
        for (index, found_m) in found_m.iter().enumerate().filter(measured) {
            errors.expected += 1.0;
            let Some(found_m) = found_m else { continue };
            let error_m = (found_m - places_m[index]).norm();
            let share = error_m / hall.pose(index).translation.vector.norm();
            errors.found += 1.0;
            errors.mean_m += error_m;
            errors.mean_share += share;
            errors.max_m = errors.max_m.max(error_m);
            errors.max_share = errors.max_share.max(share);
        }
        errors.mean_m /= errors.found;
        errors.mean_share /= errors.found;
        errors
    }
}

/// World positions of roundels, by index.
type Found = Vec<Option<Vector3<f64>>>;

/// Computes them from the positions of those that define the frame.
type Locate = fn(&[Vector3<f64>], &[Option<Sight>]) -> anyhow::Result<Found>;

/// Errors in space.
pub fn in_space(hall: &Hall, sights: &[Option<Sight>]) -> anyhow::Result<Errors> {
    Errors::of(hall, sights, |places_m, sights| {
        let (world_m, seen): (Vec<_>, Vec<_>) = references(places_m, sights)
            .filter_map(|(place_m, sight)| Some((place_m, sight.place?)))
            .unzip();
        let world_from_camera = align(&world_m, &seen)?.world_from_camera;
        let found = |sight: &Option<Sight>| {
            let place = (*sight)?.place?;
            Some((world_from_camera * Point3::from(place.position_m)).coords)
        };
        Ok(sights.iter().map(found).collect())
    })
}

/// Errors on the plane.
pub fn on_plane(hall: &Hall, sights: &[Option<Sight>]) -> anyhow::Result<Errors> {
    Errors::of(hall, sights, |places_m, sights| {
        let (plane_m, image): (Vec<Vector2<f64>>, Vec<_>) = references(places_m, sights)
            .map(|(place_m, sight)| (place_m.xy(), sight.image))
            .unzip();
        let homography = Homography::new(&plane_m, &image)?;
        let found = |sight: &Option<Sight>| Some(homography.apply((*sight)?.image)?.push(0.0));
        Ok(sights.iter().map(found).collect())
    })
}

/// The detected ones among the four that define the frame.
fn references<'a>(
    places_m: &'a [Vector3<f64>],
    sights: &'a [Option<Sight>],
) -> impl Iterator<Item = (Vector3<f64>, Sight)> + 'a {
    let is_reference = |(index, _): &(usize, _)| Hall::is_reference(*index);
    let pairs = places_m.iter().zip(sights).enumerate().filter(is_reference);
    pairs.filter_map(|(_, (place_m, sight))| Some((*place_m, (*sight)?)))
}

/// The roundels' print.
pub fn print() -> Print {
    Print::plain(OUTER_M, RATIO * OUTER_M, MARGIN)
}

/// Detections in a picture of the hall, by the roundels' indices.
pub fn roundels(
    hall: &Hall,
    lens: &Calibrated,
    image: &Image,
) -> anyhow::Result<Vec<Option<Sight>>> {
    let kind = Kind {
        name: "roundel".into(),
        outer_diameter_m: OUTER_M,
        inner_diameter_m: RATIO * OUTER_M,
        ..Kind::robot()
    };
    let mut observer = Observer::with_params(&lens.optics, &[kind], 0.0, Params::default())?;
    let mut sights = vec![None; hall.true_m.len()];
    for detection in observer.observe(image, 0)? {
        let center = detection.ring.outer.center;
        let index = hall.at(Vector2::new(center.u, center.v));
        if let (Some(index), Some(pose)) = (index, &detection.pose) {
            let [x, y, z] = pose.position_m.into();
            let image = NormalizedPoint { x: x / z, y: y / z };
            sights[index] = Some(Sight { image, place: Some(Sighting::from(pose)) });
        }
    }
    Ok(sights)
}

/// A position with these deviations, across and along the line of sight.
pub fn loose(position_m: Vector3<f64>, across_m: f64, along_m: f64) -> Sighting {
    let ray = position_m.normalize();
    let along = ray * ray.transpose();
    let covariance = along * along_m.powi(2) + (Matrix3::identity() - along) * across_m.powi(2);
    Sighting { position_m, covariance }
}

/// The paper's figures for one of its five pictures: mean and maximum error in centimetres, predicted, mean and
/// maximum share in per cent.
type PaperFigures = [f64; 5];

/// Camera and view; table 3, table 4.
type Picture = (fn() -> PaperCamera, View, PaperFigures, PaperFigures);

const PICTURES: [Picture; 5] = [
    (
        PaperCamera::creative,
        View::Side,
        [5.7, 19.5, 1.04, 0.90, 2.96],
        [0.23, 0.62, 0.03, 0.04, 0.08],
    ),
    (
        PaperCamera::creative,
        View::Top,
        [3.7, 12.1, 0.68, 0.61, 1.83],
        [0.18, 0.68, 0.04, 0.03, 0.09],
    ),
    (
        PaperCamera::olympus,
        View::Side,
        [1.9, 6.5, 0.47, 0.35, 1.02],
        [0.64, 1.40, 0.11, 0.12, 0.22],
    ),
    (
        PaperCamera::olympus,
        View::Top,
        [3.2, 11.0, 0.54, 0.50, 1.39],
        [0.68, 2.08, 0.19, 0.11, 0.32],
    ),
    (PaperCamera::canon, View::Top, [2.5, 7.4, 0.30, 0.43, 1.46], [0.15, 0.33, 0.03, 0.03, 0.07]),
];

/// Mean errors over repetitions of one picture, and the model's prediction; in space, on the plane.
type Measured = [(Errors, Prediction); 2];

/// Both tables use the same pictures, which are rendered once.
static MEASURED: Mutex<Vec<(Length, Vec<Measured>)>> = Mutex::new(Vec::new());

fn measured(length: Length) -> anyhow::Result<Vec<Measured>> {
    let mut measured = MEASURED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, all)) = measured.iter().find(|(of, _)| *of == length) {
        return Ok(all.clone());
    }
    // Sequentially: a picture of 18 megapixels needs much memory, and is rendered in parallel.
    let all: Vec<Measured> = (0..PICTURES.len())
        .map(|picture| repeated(picture, length))
        .collect::<anyhow::Result<_>>()?;
    measured.push((length, all.clone()));
    Ok(all)
}

fn repeated(picture: usize, length: Length) -> anyhow::Result<Measured> {
    let (camera, view, ..) = PICTURES[picture];
    let camera = camera();
    let mut errors: [Vec<Errors>; 2] = Default::default();
    let mut predictions: [Vec<Prediction>; 2] = Default::default();
    let repeats = length.pick(1, 5);
    for seed in (0..repeats).map(|index| 100 * picture as u64 + index) {
        let hall = Hall::new(camera, view, seed);
        let lens = calibrated(&camera, length, seed)?;
        let sights = roundels(&hall, &lens, &hall.picture(&|_| print()))?;
        let paper_figures =
            || format!("{}, {}: roundels that define the frame", camera.name, view.name());
        errors[0].push(in_space(&hall, &sights).with_context(paper_figures)?);
        errors[1].push(on_plane(&hall, &sights).with_context(paper_figures)?);
        predictions[0].push(predicted(&hall, &lens, false));
        predictions[1].push(predicted(&hall, &lens, true));
    }
    let mean = |mode: usize| (Errors::mean(&errors[mode]), Prediction::mean(&predictions[mode]));
    Ok([0, 1].map(mean))
}

fn rows(length: Length, plane: bool) -> anyhow::Result<Vec<Row>> {
    let picture_rows = |(picture, measured): (usize, &Measured)| {
        let (camera, view, space_figures, plane_figures) = PICTURES[picture];
        let paper_figures = if plane { plane_figures } else { space_figures };
        let (errors, model) = measured[usize::from(plane)];
        let row = |what: &str, [here, predictions, paper]: [f64; 3]| {
            Row::new(format!("{}, {}, {what}", camera().name, view.name()), here)
                .paper(paper, Aim::Less)
                .model(predictions)
        };
        let missed = match errors.expected - errors.found {
            0.0 => String::new(),
            missed => format!("; {missed:.1} of {} not found", errors.expected),
        };
        let exactly = format!("{:.3} cm with exact tiles{missed}", 100.0 * errors.exact_m);
        let relative_to_mean = |max: f64, mean: f64, paper_max: f64, paper_mean: f64| {
            format!("{:.1} times the mean, in the paper {:.1}", max / mean, paper_max / paper_mean)
        };
        [
            row("mean: cm", [100.0 * errors.mean_m, 100.0 * model.mean_m, paper_figures[0]])
                .note(exactly),
            row("maximum: cm", [100.0 * errors.max_m, 100.0 * model.max_m, paper_figures[1]]).note(
                relative_to_mean(errors.max_m, errors.mean_m, paper_figures[1], paper_figures[0]),
            ),
            row(
                "mean: % of the distance",
                [100.0 * errors.mean_share, 100.0 * model.mean_share, paper_figures[3]],
            )
            .paper_model(paper_figures[2])
            .note(model.contributions(plane)),
            row(
                "maximum: %",
                [100.0 * errors.max_share, 100.0 * model.max_share, paper_figures[4]],
            )
            .note(relative_to_mean(
                errors.max_share,
                errors.mean_share,
                paper_figures[4],
                paper_figures[3],
            )),
        ]
    };
    Ok(measured(length)?.iter().enumerate().flat_map(picture_rows).collect())
}

fn method(length: Length) -> String {
    format!(
        "25 roundels of {:.0} cm on the corners of tiles, of which four define the frame; mean over {} pictures, \
         each with another camera pose, other tile errors (0.6 mm along each axis, unknown to the ground truth, \
         as in the paper), other noise, and another lens calibration from {} rendered views.",
        100.0 * OUTER_M,
        length.pick(1, 5),
        length.pick(16, 30)
    )
}

/// The paper's table 3.
pub fn space(length: Length) -> anyhow::Result<Table> {
    let remarks = vec![
        method(length),
        "Model: equation 19 with the stated deviations of the calibration and the axis error caused by noise. The \
         paper's axis error of 0.15 px is that of moments of thresholded pixels; a fit to the grey levels reaches \
         a few thousandths of a pixel. The remaining error comes from the lens, the tiles (0.09 cm), and the \
         frame defined by four roundels, which the model ignores. \"With exact tiles\" excludes the tile errors. \
         The model's maximum error assumes a Rayleigh distribution about its mean. Real lenses, unlike rendered \
         ones, also differ from their model. The components of the model's mean are given in per cent of the \
         distance."
            .to_owned(),
    ];
    let title = "Table 3: precision of 3D position estimation".to_owned();
    Ok(Table { title, rows: rows(length, false)?, remarks, skipped: Vec::new() })
}

/// The paper's table 4.
pub fn plane(length: Length) -> anyhow::Result<Table> {
    let remarks = vec![
        method(length),
        "Model: equations 17 and 18 with the stated deviations of the calibration, and the tile errors: 0.6 mm \
         along each axis give a mean of 0.09 cm, including the four roundels that define the frame. They \
         dominate; the last column gives the mean without them. Maximum errors are predicted as in table 3. The \
         paper's errors are those of its lenses."
            .to_owned(),
    ];
    let title = "Table 4: precision of 2D position estimation".to_owned();
    Ok(Table { title, rows: rows(length, true)?, remarks, skipped: Vec::new() })
}
