//! Table 7: precision beside ArUco's and SimpleBlobDetector's, in the same hall with the Olympus.
//!
//! Each sees its own markers at the same places, square ones of the roundels' diameter and plain discs, through the
//! same calibrated lens; ArUco with its corners refined and OpenCV's solvePnP. Frames and errors are computed alike for
//! all. Blobs give no distance that would do for a place in space, as the paper found.

use nalgebra::{Vector2, Vector3};
use roundel_core::camera::PixelPoint;

use super::{
    Aim, Length, Row, Table,
    foretold::{Predicted, predicted},
    hall::{Hall, OUTER_M, View},
    lens::{Calibrated, calibrated},
    others::{Detector, Found, Job, Others, numbers},
    precision::{Errors, Sight, in_space, loose, on_plane, print, roundels},
    scene::PaperCamera,
};
use crate::{
    pipeline::core_camera,
    rival::{disc, marker},
};

/// In per cent, mean and greatest: WhyCon's, ArUco's, OpenCV's blobs'.
type Told = [Option<[f64; 2]>; 3];

const CASES: [(&str, View, Told); 4] = [
    ("2D", View::Side, [Some([0.12, 0.19]), Some([0.20, 0.41]), Some([0.52, 1.03])]),
    ("2D", View::Top, [Some([0.12, 0.32]), Some([0.22, 0.37]), Some([0.77, 1.62])]),
    ("3D", View::Side, [Some([0.31, 1.10]), Some([0.63, 2.52]), None]),
    ("3D", View::Top, [Some([0.33, 1.04]), Some([1.08, 2.90]), None]),
];

/// Errors on the plane and in space of one view, by method; `None` where a method was not there or fails.
type Result2 = [Option<Errors>; 2];

/// The paper's table 7.
pub fn table(length: Length) -> anyhow::Result<Table> {
    let (others, skipped) = match Others::ready() {
        Ok(others) => (Some(others), Vec::new()),
        Err(why) => (None, vec![format!("ArUco and SimpleBlobDetector: {why:#}")]),
    };
    let mut rows = Vec::new();
    let views = [View::Side, View::Top].map(|view| of_view(view, length, others.as_ref()));
    let [side, top] = views;
    let ((side, of_side), (top, of_top)) = (side?, top?);
    for (mode, view, told) in CASES {
        let (methods, model) = if view == View::Side { (&side, &of_side) } else { (&top, &of_top) };
        let which = usize::from(mode == "3D");
        let model = model[which];
        let ours = methods[0][which];
        for (method, name) in ["Roundel", "ArUco", "SimpleBlobDetector"].into_iter().enumerate() {
            let (Some(errors), Some([mean, most])) = (methods[method][which], told[method]) else {
                continue;
            };
            let row = |what: &str, [here, foretold]: [f64; 2], paper: f64| {
                let case = format!("{mode}, {}, {name}, {what}: %", view.name());
                let row = Row::new(case, 100.0 * here);
                match method {
                    0 => row.paper(paper, Aim::Less).model(100.0 * foretold),
                    _ => row.paper(paper, Aim::Neither),
                }
            };
            let exact = 100.0 * errors.exact_share;
            let found =
                format!("{:.0} of {} found; {exact:.5} with exact tiles", errors.found, errors.of);
            let note = match ours {
                Some(ours) if method > 0 => {
                    format!("{found}, {:.1} times ours", errors.exact_share / ours.exact_share)
                }
                _ => found,
            };
            rows.push(row("mean", [errors.mean_share, model.mean_share], mean).note(note));
            let times = errors.most_share / errors.mean_share;
            rows.push(
                row("greatest", [errors.most_share, model.most_share], most)
                    .note(format!("{times:.1} times the mean, by the paper {:.1}", most / mean)),
            );
        }
    }
    let remarks = vec![
        "As tables 3 and 4, with the Olympus; for ArUco (4x4 cells, corners refined) and SimpleBlobDetector (areas of any \
         size) the same places with their own markers of the same size, the same lens, and the same frames. \"better by\" \
         compares Roundel here with WhyCon in the paper; the ratio to the others here is in the last column. Model: as for \
         tables 3 and 4; it knows of no other method."
            .to_owned(),
        "The tiles' 0.6 mm, one hundredth of a per cent, are in all of these errors, and on the plane they are most of it \
         with every method: the last column has what each method leaves if the tiles' corners are known exactly. What \
         is left of others' errors in the paper are its lens, and versions of ten years ago."
            .to_owned(),
    ];
    let title = "Table 7: precision beside others (Olympus VR-340)".to_owned();
    Ok(Table { title, rows, remarks, skipped })
}

/// Means over pictures, by method: Roundel, ArUco, blobs; each on the plane and in space; and what is predicted of Roundel.
fn of_view(
    view: View,
    length: Length,
    others: Option<&Others>,
) -> anyhow::Result<([Result2; 3], [Predicted; 2])> {
    let camera = PaperCamera::olympus();
    let mut errors: [[Vec<Errors>; 2]; 3] = Default::default();
    let mut foretold: [Vec<Predicted>; 2] = Default::default();
    for seed in 0..length.pick(1, 3) {
        let hall = Hall::new(camera, view, 700 + seed);
        let lens = calibrated(&camera, length, 700 + seed)?;
        for (plane, foretold) in [true, false].into_iter().zip(&mut foretold) {
            foretold.push(predicted(&hall, &lens, plane));
        }
        let ours = roundels(&hall, &lens, &hall.picture(&|_| print()))?;
        let mut sights = vec![ours];
        if let Some(others) = others {
            sights.extend(rivals(&hall, &lens, others)?);
        }
        for (method, sights) in sights.iter().enumerate() {
            errors[method][0].extend(on_plane(&hall, sights).ok());
            errors[method][1].extend(in_space(&hall, sights).ok());
        }
    }
    let errors = errors.map(|both| both.map(|all| (!all.is_empty()).then(|| Errors::mean(&all))));
    Ok((errors, foretold.map(|all| Predicted::mean(&all))))
}

fn rivals(
    hall: &Hall,
    lens: &Calibrated,
    others: &Others,
) -> anyhow::Result<Vec<Vec<Option<Sight>>>> {
    let squares = hall.picture(&|index| marker(&others.markers[index], OUTER_M));
    let squares = others.write("squares", &squares)?;
    let discs = others.write("discs", &hall.picture(&|_| disc(OUTER_M)))?;
    let job = |detector, image| Job {
        detector,
        size_m: OUTER_M,
        camera: Some(numbers(&lens.optics)),
        repetitions: 1,
        images: vec![image],
    };
    let judged = others.judge(&[job(Detector::Refined, squares), job(Detector::Blob, discs)])?;
    let of_job = |job: &Vec<super::others::Judged>| {
        let mut sights = vec![None; hall.true_m.len()];
        for found in job.iter().flat_map(|image| &image.found) {
            if let Some(index) = hall.at(Vector2::from(found.center_px)) {
                sights[index] = sight(lens, found)?;
            }
        }
        anyhow::Ok(sights)
    };
    judged.iter().map(of_job).collect()
}

fn sight(lens: &Calibrated, found: &Found) -> anyhow::Result<Option<Sight>> {
    let [u, v] = found.center_px;
    let Ok(image) = core_camera(&lens.optics)?.undistort(PixelPoint { u, v }) else {
        return Ok(None);
    };
    let place = found.position_m.map(|position_m| {
        let position_m = Vector3::from(position_m);
        // What a corner's tenth of a pixel says: ten times less along the line of sight.
        let across_m = 0.1 * position_m.norm() / lens.optics.focal_px[0];
        loose(position_m, across_m, 10.0 * across_m)
    });
    Ok(Some(Sight { image, place }))
}
