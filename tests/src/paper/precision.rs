//! Tables 3 and 4: how exactly roundels on the hall's floor are located, in space and on the plane.
//!
//! As in the paper: four roundels define the frame, and of the others the distance between where they are
//! found and where they are said to be is the error, absolute, and relative to their distance from the
//! camera. In space the camera is placed by the four poses ([`align`]) and the others' poses follow; on the plane a
//! [`Homography`] takes their middles there. The lens is the one that was calibrated, and every picture has its own.

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
    foretold::{Predicted, predicted},
    hall::{Hall, OUTER_M, View},
    lens::{Calibrated, calibrated},
    scene::{MARGIN, PaperCamera, RATIO},
};
use crate::{
    arena::Kind,
    pipeline::Observer,
    render::{Image, Print},
};

/// One roundel or marker as seen: its middle on the plane z = 1 of the camera, and its place where that is known.
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
    /// Mean, metres.
    pub mean_m: f64,
    /// Greatest, metres.
    pub most_m: f64,
    /// Mean of the shares of the distance.
    pub mean_share: f64,
    /// Greatest of them.
    pub most_share: f64,
    /// Mean, metres, if where the roundels truly are were known to who judges and to who defines the frame.
    pub exact_m: f64,
    /// The same as a share of the distance.
    pub exact_share: f64,
    /// Measured ones.
    pub found: f64,
    /// That were to be.
    pub of: f64,
}

impl Errors {
    /// Means over pictures.
    pub fn mean(pictures: &[Self]) -> Self {
        let of = |field: fn(&Self) -> f64| {
            pictures.iter().map(field).sum::<f64>() / pictures.len() as f64
        };
        Self {
            mean_m: of(|it| it.mean_m),
            most_m: of(|it| it.most_m),
            mean_share: of(|it| it.mean_share),
            most_share: of(|it| it.most_share),
            exact_m: of(|it| it.exact_m),
            exact_share: of(|it| it.exact_share),
            found: of(|it| it.found),
            of: of(|it| it.of),
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
            errors.of += 1.0;
            let Some(found_m) = found_m else { continue };
            let error_m = (found_m - places_m[index]).norm();
            let share = error_m / hall.pose(index).translation.vector.norm();
            errors.found += 1.0;
            errors.mean_m += error_m;
            errors.mean_share += share;
            errors.most_m = errors.most_m.max(error_m);
            errors.most_share = errors.most_share.max(share);
        }
        errors.mean_m /= errors.found;
        errors.mean_share /= errors.found;
        errors
    }
}

/// Where roundels are found in the world, by their numbers.
type Found = Vec<Option<Vector3<f64>>>;

/// Finds them, by the places of those that define the frame.
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

/// The four that define the frame, as far as they are seen.
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

/// What the detector and the locator make of a picture of the hall, by the roundels' numbers.
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

/// A place of which only so much is stated: looser along the line of sight.
pub fn loose(position_m: Vector3<f64>, across_m: f64, along_m: f64) -> Sighting {
    let ray = position_m.normalize();
    let along = ray * ray.transpose();
    let covariance = along * along_m.powi(2) + (Matrix3::identity() - along) * across_m.powi(2);
    Sighting { position_m, covariance }
}

/// What the paper tells of one of its five pictures: mean and greatest error in centimetres, predicted, mean and
/// greatest share in per cent.
type Told = [f64; 5];

/// Camera and view; table 3, table 4.
type Picture = (fn() -> PaperCamera, View, Told, Told);

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

/// Mean errors in one of the pictures, repeated, and what the model predicts; in space, on the plane.
type Measured = [(Errors, Predicted); 2];

/// Both tables are of the same pictures, which are taken once.
static MEASURED: Mutex<Vec<(Length, Vec<Measured>)>> = Mutex::new(Vec::new());

fn measured(length: Length) -> anyhow::Result<Vec<Measured>> {
    let mut measured = MEASURED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, all)) = measured.iter().find(|(of, _)| *of == length) {
        return Ok(all.clone());
    }
    // One after the other: a picture of 18 megapixels takes memory, and its parts run in parallel.
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
    let mut foretold: [Vec<Predicted>; 2] = Default::default();
    let repeats = length.pick(1, 5);
    for seed in (0..repeats).map(|index| 100 * picture as u64 + index) {
        let hall = Hall::new(camera, view, seed);
        let lens = calibrated(&camera, length, seed)?;
        let sights = roundels(&hall, &lens, &hall.picture(&|_| print()))?;
        let told = || format!("{}, {}: roundels that define the frame", camera.name, view.name());
        errors[0].push(in_space(&hall, &sights).with_context(told)?);
        errors[1].push(on_plane(&hall, &sights).with_context(told)?);
        foretold[0].push(predicted(&hall, &lens, false));
        foretold[1].push(predicted(&hall, &lens, true));
    }
    let mean = |mode: usize| (Errors::mean(&errors[mode]), Predicted::mean(&foretold[mode]));
    Ok([0, 1].map(mean))
}

fn rows(length: Length, plane: bool) -> anyhow::Result<Vec<Row>> {
    let of_picture = |(picture, measured): (usize, &Measured)| {
        let (camera, view, space_told, plane_told) = PICTURES[picture];
        let told = if plane { plane_told } else { space_told };
        let (errors, model) = measured[usize::from(plane)];
        let row = |what: &str, [here, foretold, paper]: [f64; 3]| {
            Row::new(format!("{}, {}, {what}", camera().name, view.name()), here)
                .paper(paper, Aim::Less)
                .model(foretold)
        };
        let missed = match errors.of - errors.found {
            0.0 => String::new(),
            missed => format!("; {missed:.1} of {} not found", errors.of),
        };
        let exactly = format!("{:.3} cm with exact tiles{missed}", 100.0 * errors.exact_m);
        let of_mean = |most: f64, mean: f64, paper_most: f64, paper_mean: f64| {
            format!(
                "{:.1} times the mean, by the paper {:.1}",
                most / mean,
                paper_most / paper_mean
            )
        };
        [
            row("mean: cm", [100.0 * errors.mean_m, 100.0 * model.mean_m, told[0]]).note(exactly),
            row("greatest: cm", [100.0 * errors.most_m, 100.0 * model.most_m, told[1]])
                .note(of_mean(errors.most_m, errors.mean_m, told[1], told[0])),
            row(
                "mean: % of the distance",
                [100.0 * errors.mean_share, 100.0 * model.mean_share, told[3]],
            )
            .paper_model(told[2])
            .note(model.told(plane)),
            row("greatest: %", [100.0 * errors.most_share, 100.0 * model.most_share, told[4]])
                .note(of_mean(errors.most_share, errors.mean_share, told[4], told[3])),
        ]
    };
    Ok(measured(length)?.iter().enumerate().flat_map(of_picture).collect())
}

fn method(length: Length) -> String {
    format!(
        "25 roundels of {:.0} cm on the corners of tiles, of which four define the frame; mean over {} pictures, each \
         with another place of the camera, other tiles (0.6 mm off along each axis, which the truth that the paper and \
         this table judge by does not know), other noise, and a lens calibrated anew from {} rendered views.",
        100.0 * OUTER_M,
        length.pick(1, 5),
        length.pick(16, 30)
    )
}

/// The paper's table 3.
pub fn space(length: Length) -> anyhow::Result<Table> {
    let remarks = vec![
        method(length),
        "Model: equation 19 with the deviations that the calibration states and the axis's error that noise leaves. The \
         paper's axis error of 0.15 px is that of moments of thresholded pixels; a fit to the grey levels reaches some \
         thousandths, so that what is left is the lens and the tiles (0.09 cm), and the error of the frame by its four roundels, \
         which the model leaves out. \"With exact tiles\": if their corners were known exactly. Its greatest errors are those of as \
         many that vary about its means as distances on a plane do (Rayleigh). The paper's lenses also differed from their \
         model; a rendered one does not. Parts of the model's mean are told in per cent of the distance."
            .to_owned(),
    ];
    let title = "Table 3: precision of 3D position estimation".to_owned();
    Ok(Table { title, rows: rows(length, false)?, remarks, skipped: Vec::new() })
}

/// The paper's table 4.
pub fn plane(length: Length) -> anyhow::Result<Table> {
    let remarks = vec![
        method(length),
        "Model: equations 17 and 18 with the deviations that the calibration states, and the tiles: 0.6 mm along each axis are \
         0.09 cm in the mean, those of the four that define the frame included. They are nearly all that is left: the \
         column of reasons has the mean that would be left if the tiles' corners were known exactly. The greatest are as in \
         table 3. The paper's errors are those of its lenses."
            .to_owned(),
    ];
    let title = "Table 4: precision of 2D position estimation".to_owned();
    Ok(Table { title, rows: rows(length, true)?, remarks, skipped: Vec::new() })
}
