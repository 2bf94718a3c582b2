//! Section 6.5.3: the smallest markers that are reliably found.
//!
//! Roundels, ArUco markers and plain discs of 5 to 40 px face the Logitech, with another subpixel position and
//! rotation in each picture. The result is the smallest size from which on all sizes are found in [`RELIABLE`] of the
//! pictures.

use nalgebra::{Isometry3, UnitQuaternion, Vector2, Vector3};
use rayon::prelude::*;

use super::{
    Aim, Length, Row, Table, model,
    opencv::{Detector, Found, Job, OpenCv},
    scene::{FLOOR, Finder, PaperCamera, RELIABLE, Studio, WINDOW_PX, slanted},
};
use crate::{
    other_markers::{disc, marker},
    random::Random,
    render::{Image, Print},
};

const SIDE_M: f64 = 0.1;
const SIZES_PX: std::ops::RangeInclusive<u32> = 5..=40;
/// Pictures in a row of a mosaic for other detectors, 960x768 in total.
const COLUMNS: usize = 10;
/// Pictures in a mosaic.
const PER_MOSAIC: usize = 80;
/// Maximum distance between a detection and the true position.
const NEAR_PX: f64 = 2.0;

/// Makes the note on why a smallest size differs, from the size here and the paper's.
type Reason = fn(f64, f64) -> String;

/// Pose of a marker of this size in one of the pictures.
fn pose(camera: &PaperCamera, size_px: u32, number: usize) -> Isometry3<f64> {
    let mut random = Random::new(u64::from(size_px), number as u64);
    let z = camera.optics.focal_px[0] * SIDE_M / f64::from(size_px);
    let mut aside = || random.uniform(-8.0, 8.0) * z / camera.optics.focal_px[0];
    let place = Vector3::new(aside(), aside(), z);
    let turn = random.uniform(0.0, std::f64::consts::TAU);
    slanted(place, 0.0, 0.0) * UnitQuaternion::from_scaled_axis(Vector3::z() * turn)
}

/// The smallest size from which on all sizes are reliably found, from the found shares by size.
fn smallest(shares: &[(u32, f64)]) -> Option<u32> {
    let reliable = shares.iter().rev().take_while(|(_, share)| *share >= RELIABLE);
    reliable.last().map(|(size_px, _)| *size_px)
}

fn roundels(camera: &PaperCamera, pictures: usize) -> Vec<(u32, f64)> {
    let found_share = |size_px: u32| {
        let mut finder = Finder::new(camera, SIDE_M);
        let found = (0..pictures).filter(|&number| {
            let mut random = Random::new(u64::from(size_px), 1000 + number as u64);
            finder.finds(&pose(camera, size_px, number), &mut random)
        });
        (size_px, found.count() as f64 / pictures as f64)
    };
    SIZES_PX.into_par_iter().map(found_share).collect()
}

/// Shares found by one of OpenCV's detectors of its own prints.
fn found_by_opencv(
    camera: &PaperCamera,
    others: &OpenCv,
    detector: Detector,
    pictures: usize,
    print: &(dyn Fn(usize) -> Print + Sync),
) -> anyhow::Result<Vec<(u32, f64)>> {
    let shown: Vec<(u32, usize)> =
        SIZES_PX.flat_map(|size_px| (0..pictures).map(move |number| (size_px, number))).collect();
    let studio = Studio::new(camera);
    let take = |studio: &mut Studio, &(size_px, number): &(u32, usize)| {
        let mut random = Random::new(u64::from(size_px), 1000 + number as u64);
        studio.picture(&print(number), &pose(camera, size_px, number), &mut random)
    };
    let rendered: Vec<_> = shown.par_iter().map_init(|| studio.clone(), take).collect();
    let write = |(sheet, pictures): (usize, &[(Image, Vector2<f64>)])| {
        others.write(&format!("{detector:?}-{sheet:03}"), &mosaic(pictures))
    };
    let sheets = rendered.chunks(PER_MOSAIC).enumerate().map(write);
    let images = sheets.collect::<anyhow::Result<_>>()?;
    let job = Job { detector, size_m: SIDE_M, camera: None, repetitions: 1, images };
    let judged = others.judge(&[job])?.remove(0);
    let mut shares: Vec<(u32, f64)> = SIZES_PX.map(|size_px| (size_px, 0.0)).collect();
    for (index, ((size_px, _), (_, at))) in shown.iter().zip(&rendered).enumerate() {
        let (left, top) = corner(index % PER_MOSAIC);
        let at = at + Vector2::new(left as f64, top as f64);
        let is_near = |found: &Found| (Vector2::from(found.center_px) - at).norm() < NEAR_PX;
        if judged[index / PER_MOSAIC].found.iter().any(is_near) {
            shares[(size_px - SIZES_PX.start()) as usize].1 += 1.0 / pictures as f64;
        }
    }
    Ok(shares)
}

/// Top left corner of a mosaic's picture.
fn corner(index: usize) -> (usize, usize) {
    (index % COLUMNS * WINDOW_PX, index / COLUMNS * WINDOW_PX)
}

/// Pictures side by side in an image of the usual size, since some of ArUco's limits depend on it.
fn mosaic(pictures: &[(Image, Vector2<f64>)]) -> Image {
    let (width, height) = (COLUMNS * WINDOW_PX, PER_MOSAIC / COLUMNS * WINDOW_PX);
    let mut pixels = vec![FLOOR as u8; width * height];
    for (index, (picture, _)) in pictures.iter().enumerate() {
        let (left, top) = corner(index);
        for (row, line) in picture.pixels.chunks(WINDOW_PX).enumerate() {
            let start = (top + row) * width + left;
            pixels[start..start + WINDOW_PX].copy_from_slice(line);
        }
    }
    Image { width, height, pixels }
}

/// The smallest sizes of section 6.5.3.
pub fn table(length: Length) -> anyhow::Result<Table> {
    let pictures = length.pick(20, 100);
    let camera = PaperCamera::logitech();
    let row = |name: &str, shares: &[(u32, f64)], paper: f64, aim: Aim, reason: Reason| {
        // No size is reliable: the next larger one is a lower limit.
        let (size_px, note) = match smallest(shares) {
            Some(size_px) => (size_px, reason(f64::from(size_px), paper)),
            None => (SIZES_PX.end() + 1, "none of the sizes is reliably found".to_owned()),
        };
        Row::new(name, f64::from(size_px)).paper(paper, aim).note(note)
    };
    let ours = roundels(&camera, pictures);
    let mut rows = vec![
        row("Roundel, diameter: px", &ours, 12.0, Aim::Less, |_, _| {
            "tested by moments that account for blur, by boxes in the paper".to_owned()
        })
        .paper_model(12.0)
        .model(model::MIN_DIAMETER_PX),
    ];
    let mut skipped = Vec::new();
    match OpenCv::ready() {
        Ok(others) => {
            let square =
                |number: usize| marker(&others.markers[number % others.markers.len()], SIDE_M);
            let aruco = found_by_opencv(&camera, &others, Detector::Aruco, pictures, &square)?;
            let blobs =
                found_by_opencv(&camera, &others, Detector::Blob, pictures, &|_| disc(SIDE_M))?;
            // With the black border, today's 4x4 markers are 6 cells across, the paper's 5x5 ones 7.
            rows.push(row("ArUco, side: px", &aruco, 25.0, Aim::Neither, |here_px, paper_px| {
                format!("{:.1} px a cell, the paper's {:.1}", here_px / 6.0, paper_px / 7.0)
            }));
            rows.push(row(
                "SimpleBlobDetector, diameter: px",
                &blobs,
                12.0,
                Aim::Neither,
                |_, _| "a single disc, like many other objects".to_owned(),
            ));
        }
        Err(why) => skipped.push(format!("ArUco and SimpleBlobDetector: {why:#}")),
    }
    let remarks = vec![
        format!(
            "Smallest size in whole pixels from which all larger sizes are found in {:.0} % of {pictures} \
             pictures, facing the camera, with a blur of 0.7 px and noise of 3 grey levels. Model: D.",
            100.0 * RELIABLE
        ),
        "ArUco is that of current OpenCV with markers of 4x4 cells and default parameters; the paper's had 5x5 \
         cells. A blob has no ring, so much else is detected as one."
            .to_owned(),
    ];
    let title = "Section 6.5.3: minimal sizes".to_owned();
    Ok(Table { title, rows, remarks, skipped })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_larger_sizes_must_be_found_too() {
        let shares = [(5, 1.0), (6, 0.5), (7, 1.0), (8, 0.99)];
        assert_eq!(smallest(&shares), Some(7));
        assert_eq!(smallest(&[(5, 1.0), (6, 0.9)]), None);
    }
}
