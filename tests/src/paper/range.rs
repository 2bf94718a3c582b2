//! Table 1: the largest distance at which a roundel is reliably found.
//!
//! The camera moves away from the roundel in steps of one per cent, starting where it appears with twice the diameter
//! that the model requires, and takes a number of pictures at each distance. In each, the roundel has another
//! subpixel position and is slanted in another direction. The first distance at which a search of the single picture
//! finds fewer than [`RELIABLE`](super::scene::RELIABLE) of them ends the run.

use std::f64::consts::TAU;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::{
    Aim, Length, Row, Table, model,
    scene::{Finder, PaperCamera, RELIABLE, slanted},
};
use crate::random::Random;

/// Camera, diameter in centimetres, tilt in degrees, and the paper's distances in metres: measured, predicted.
const CASES: [(CameraName, f64, f64, f64, f64); 12] = [
    (CameraName::Logitech, 2.5, 0.0, 1.4, 1.6),
    (CameraName::Logitech, 2.5, 40.0, 1.3, 1.3),
    (CameraName::Logitech, 5.0, 0.0, 3.3, 3.2),
    (CameraName::Logitech, 5.0, 40.0, 2.8, 2.5),
    (CameraName::Logitech, 7.5, 0.0, 4.4, 4.9),
    (CameraName::Logitech, 7.5, 40.0, 3.9, 3.7),
    (CameraName::Olympus, 2.5, 0.0, 6.8, 6.7),
    (CameraName::Olympus, 2.5, 40.0, 6.2, 5.1),
    (CameraName::Olympus, 5.0, 0.0, 13.2, 13.4),
    (CameraName::Olympus, 5.0, 40.0, 11.4, 10.3),
    (CameraName::Olympus, 7.5, 0.0, 19.8, 20.1),
    (CameraName::Olympus, 7.5, 40.0, 16.8, 15.4),
];

#[derive(Clone, Copy)]
enum CameraName {
    Logitech,
    Olympus,
}

impl CameraName {
    fn camera(self) -> PaperCamera {
        match self {
            Self::Logitech => PaperCamera::logitech(),
            Self::Olympus => PaperCamera::olympus(),
        }
    }
}

/// Ratio of consecutive distances.
pub(super) const STEP: f64 = 1.01;

/// The last of increasing distances, from `start_m` on, at which `finds` is reliable over the pictures. The arguments
/// of `finds` are the distance and the number of the picture.
pub(super) fn farthest_m(
    start_m: f64,
    pictures: usize,
    mut finds: impl FnMut(f64, usize) -> bool,
) -> f64 {
    let max_misses = ((1.0 - RELIABLE) * pictures as f64) as usize;
    let mut last_m = 0.0;
    let mut distance_m = start_m;
    loop {
        let mut misses = 0;
        // Stops once too many are missed.
        let reliable = (0..pictures).all(|picture| {
            misses += usize::from(!finds(distance_m, picture));
            misses <= max_misses
        });
        if !reliable {
            return last_m;
        }
        last_m = distance_m;
        distance_m *= STEP;
    }
}

/// The note on why distances differ: the shorter diameters there, pixels, here and in the paper.
pub(super) fn found_down_to([here_px, paper_px]: [f64; 2]) -> String {
    format!("found down to {here_px:.1} px across, in the paper to {paper_px:.1}")
}

/// The paper's table 1.
pub fn table(length: Length) -> anyhow::Result<Table> {
    let pictures = length.pick(25, 100);
    let case_row = |(index, &(which, outer_cm, tilt_deg, paper, paper_model)): (
        usize,
        &(CameraName, f64, f64, f64, f64),
    )| {
        let camera = which.camera();
        let (outer_m, tilt_rad) = (outer_cm / 100.0, tilt_deg.to_radians());
        let model_m = model::pinhole(&camera.optics, outer_m, tilt_rad, [1.0; 2]).max_distance_m();
        let mut finder = Finder::new(&camera, outer_m);
        let mut random = Random::new(1, index as u64);
        let here = farthest_m(model_m / 2.0, pictures, |z, _| {
            // A random subpixel position near the centre of the image.
            let mut aside = || random.uniform(-8.0, 8.0) * z / camera.optics.focal_px[0];
            let place = Vector3::new(aside(), aside(), z);
            let axis_rad = random.uniform(0.0, TAU);
            finder.finds(&slanted(place, tilt_rad, axis_rad), &mut random)
        });
        let across_px =
            |distance_m: f64| camera.optics.focal_px[0] * outer_m * tilt_rad.cos() / distance_m;
        Row::new(format!("{}, {outer_cm} cm, {tilt_deg}°: m", camera.name), here)
            .paper(paper, Aim::More)
            .paper_model(paper_model)
            .model(model_m)
            .note(found_down_to([across_px(here), across_px(paper)]))
    };
    let rows = CASES.par_iter().enumerate().map(case_row).collect();
    let remarks = vec![
        format!(
            "Largest distance at which at least {:.0} % of {pictures} independent pictures are searched \
             successfully. Model: equation 14, with D = 12 px in the paper and D = {} px here, the smallest \
             diameter at which the detector finds all 5,000 roundels of another test.",
            100.0 * RELIABLE,
            model::MIN_DIAMETER_PX
        ),
        "The distances are greater because D is smaller: rings are tested with moments that account for blur. In \
         less sharp pictures (the Olympus) D is larger than in the model; for tilted roundels it is smaller, \
         since it refers to the shorter diameter and the longer one helps. The focal lengths follow from the \
         paper's predictions. Real lenses and light are worse than rendered ones."
            .to_owned(),
    ];
    let title = "Table 1: maximal distance".to_owned();
    Ok(Table { title, rows, remarks, skipped: Vec::new() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_range_ends_where_too_many_pictures_are_missed() {
        // Two of a hundred may be missed: the seventh always is, the eighth and ninth from 1.5 m on.
        let last_m = farthest_m(1.0, 100, |distance_m, picture| match picture {
            7 => false,
            8 | 9 => distance_m < 1.5,
            _ => true,
        });
        assert!((1.48..1.5).contains(&last_m), "{last_m}");
        assert_eq!(farthest_m(1.0, 100, |_, _| false), 0.0);
    }
}
