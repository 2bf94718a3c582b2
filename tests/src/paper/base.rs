//! Table 2 and the end of section 6.1.1: the area that a camera covers.
//!
//! The Logitech faces a wall with a roundel in each corner of its image, with its paper just inside. As in table 1,
//! it moves away until one of them is no longer found reliably. The positions of the four roundels on the wall then
//! form the base.

use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

use super::{
    Aim, Length, Row, Table, model,
    range::{farthest_m, found_down_to},
    scene::{Finder, MARGIN, PaperCamera, RELIABLE, slanted},
};
use crate::random::Random;

/// Diameter in centimetres; v_max, v_y, v_z in metres, measured and predicted.
const CASES: [(f64, [f64; 3], [f64; 3]); 3] = [
    (2.5, [1.6, 2.1, 1.6], [1.5, 1.9, 1.4]),
    (5.0, [3.0, 3.9, 3.0], [3.0, 4.0, 3.0]),
    (7.5, [4.5, 5.9, 4.5], [4.4, 5.8, 4.4]),
];
/// Reduction of the paper's distances in the corners, per cent.
const REDUCTION: f64 = 7.0;
/// Distance between the paper's edge and the image's edge.
const EDGE_PX: f64 = 2.0;

/// Positions on the wall, relative to its distance, that appear in the image's corners: left, top, right, bottom.
fn corners(
    camera: &PaperCamera,
    outer_m: f64,
    distance_m: f64,
    jitter_px: Vector2<f64>,
) -> [Vector3<f64>; 4] {
    let optics = &camera.optics;
    let reach_px = optics.focal_px[0] * outer_m / distance_m * (0.5 + MARGIN) + EDGE_PX;
    let [right, bottom] = [optics.width, optics.height].map(|side| side as f64 - 1.0 - reach_px);
    let inwards = |u: f64, v: f64| {
        let sign = |at: f64| if at > reach_px { -1.0 } else { 1.0 };
        let pixel = Vector2::new(u + sign(u) * jitter_px.x, v + sign(v) * jitter_px.y);
        optics.ray(&pixel).expect("a pixel of the image")
    };
    [
        inwards(reach_px, reach_px),
        inwards(right, reach_px),
        inwards(right, bottom),
        inwards(reach_px, bottom),
    ]
}

/// Largest distance at which roundels in all four corners are found.
fn farthest_in_corners_m(camera: &PaperCamera, outer_m: f64, pictures: usize, seed: u64) -> f64 {
    let mut finder = Finder::new(camera, outer_m);
    let mut random = Random::new(2, seed);
    let start_m = model::pinhole(&camera.optics, outer_m, 0.0, [0.5; 2]).max_corner_distance_m();
    farthest_m(start_m, 4 * pictures, |distance_m, number| {
        let jitter_px = Vector2::new(random.uniform(0.0, 1.0), random.uniform(0.0, 1.0));
        let ray = corners(camera, outer_m, distance_m, jitter_px)[number % 4];
        finder.finds(&slanted(ray * distance_m, 0.0, 0.0), &mut random)
    })
}

/// Largest distance at which a roundel at the centre is found.
fn farthest_in_middle_m(camera: &PaperCamera, outer_m: f64, pictures: usize, seed: u64) -> f64 {
    let mut finder = Finder::new(camera, outer_m);
    let mut random = Random::new(3, seed);
    let start_m = model::pinhole(&camera.optics, outer_m, 0.0, [0.5; 2]).max_corner_distance_m();
    farthest_m(start_m, 4 * pictures, |z, _| {
        let mut aside = || random.uniform(-8.0, 8.0) * z / camera.optics.focal_px[0];
        let place = Vector3::new(aside(), aside(), z);
        finder.finds(&slanted(place, 0.0, 0.0), &mut random)
    })
}

fn base(index: usize, pictures: usize) -> Vec<Row> {
    let (outer_cm, paper, paper_model) = CASES[index];
    let (camera, outer_m) = (PaperCamera::logitech(), outer_cm / 100.0);
    let farthest_m = farthest_in_corners_m(&camera, outer_m, pictures, index as u64);
    let [top_left, top_right, bottom_right, _] =
        corners(&camera, outer_m, farthest_m, Vector2::zeros());
    let across_m = (top_right - top_left).norm() * farthest_m;
    let down_m = (bottom_right - top_right).norm() * farthest_m;
    let corner = top_left.xy();
    let shrinking = model::shrinking(&camera.optics, corner.x, corner.y);
    let pinhole = model::pinhole(&camera.optics, outer_m, 0.0, shrinking);
    let model_m = pinhole.max_corner_distance_m();
    let [model_across_m, model_down_m] = pinhole.base_m();
    let here = [farthest_m, across_m, down_m];
    let model = [model_m, model_across_m, model_down_m];
    let shrunk_px = camera.optics.focal_px[0] * outer_m * shrinking[0].min(shrinking[1]);
    let further = farthest_m / paper[0];
    let row = |at: usize| {
        let name = ["v_max", "v_y", "v_z"][at];
        let note = match at {
            0 => found_down_to([shrunk_px / farthest_m, shrunk_px / paper[0]]),
            _ => format!(
                "seen from {further:.2} times as far, through a lens that sees {:.2} times as much as a pinhole",
                here[at] / (pinhole.base_m()[at - 1] * farthest_m / model_m)
            ),
        };
        Row::new(format!("{outer_cm} cm, {name}: m"), here[at])
            .paper(paper[at], Aim::More)
            .paper_model(paper_model[at])
            .model(model[at])
            .note(note)
    };
    (0..3).map(row).collect()
}

fn reduction(camera: &PaperCamera, pictures: usize, seed: u64) -> Row {
    const OUTER_M: f64 = 0.025;
    let corner_m = farthest_in_corners_m(camera, OUTER_M, pictures, seed);
    let middle_m = farthest_in_middle_m(camera, OUTER_M, pictures, seed);
    let [corner, ..] = corners(camera, OUTER_M, corner_m, Vector2::zeros());
    let [k_x, k_y] = model::shrinking(&camera.optics, corner.x, corner.y);
    Row::new(
        format!("{}, 2.5 cm, loss in the corners: %", camera.name),
        100.0 * (1.0 - corner_m / middle_m),
    )
    .paper(REDUCTION, Aim::Neither)
    .model(100.0 * (1.0 - k_x.min(k_y)))
    .note("the lens shrinks the longer diameter less, as with slanted roundels")
}

/// The paper's table 2, and the reduction in the corners of section 6.1.1.
pub fn table(length: Length) -> anyhow::Result<Table> {
    let pictures = length.pick(25, 100);
    let mut rows: Vec<Row> =
        (0..CASES.len()).into_par_iter().flat_map(|index| base(index, pictures)).collect();
    let cameras = [PaperCamera::logitech(), PaperCamera::olympus()];
    rows.par_extend(
        cameras
            .par_iter()
            .enumerate()
            .map(|(index, camera)| reduction(camera, pictures, 10 + index as u64)),
    );
    let remarks = vec![
        format!(
            "A wall that fills the image, with roundels in its four corners: largest distance at which {:.0} % \
             of the roundels of {pictures} pictures are found, and the distances between their centres. Model: \
             equations 15 (as corrected) and 16.",
            100.0 * RELIABLE
        ),
        "Greater for the same reason as in table 1. The base is wider than the model's because the distorted lens \
         covers more than w/f and h/f, which equation 16 ignores."
            .to_owned(),
    ];
    let title = "Table 2: dimensions of the operational space (Logitech QC Pro)".to_owned();
    Ok(Table { title, rows, remarks, skipped: Vec::new() })
}
