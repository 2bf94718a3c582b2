//! Table 7: precision compared with ArUco and SimpleBlobDetector, in the same hall with the Olympus.
//!
//! Each detector sees its own markers at the same positions (squares with the roundels' diameter as side, and plain
//! discs) through the same calibrated lens. ArUco runs with corner refinement and OpenCV's solvePnP. Frames and
//! errors are computed in the same way for all. As in the paper, blobs give no distance accurate enough for a
//! position in space.

use nalgebra::{Vector2, Vector3};
use roundel_core::camera::PixelPoint;

use super::{
    Aim, Length, Row, Table,
    hall::{Hall, OUTER_M, View},
    lens::{Calibrated, calibrated},
    opencv::{Detector, Found, Job, OpenCv, numbers},
    precision::{Errors, Sight, in_space, loose, on_plane, print, roundels},
    predictions::{Prediction, predicted},
    scene::PaperCamera,
};
use crate::{
    other_markers::{disc, marker},
    pipeline::core_camera,
};

/// Per cent, mean and maximum: of WhyCon, ArUco, OpenCV's blobs.
type PaperFigures = [Option<[f64; 2]>; 3];

const CASES: [(&str, View, PaperFigures); 4] = [
    ("2D", View::Side, [Some([0.12, 0.19]), Some([0.20, 0.41]), Some([0.52, 1.03])]),
    ("2D", View::Top, [Some([0.12, 0.32]), Some([0.22, 0.37]), Some([0.77, 1.62])]),
    ("3D", View::Side, [Some([0.31, 1.10]), Some([0.63, 2.52]), None]),
    ("3D", View::Top, [Some([0.33, 1.04]), Some([1.08, 2.90]), None]),
];

/// Errors on the plane and in space of one view, by method; `None` where a method is missing or fails.
type PlaneAndSpace = [Option<Errors>; 2];

/// The paper's table 7.
pub fn table(length: Length) -> anyhow::Result<Table> {
    let (others, skipped) = match OpenCv::ready() {
        Ok(others) => (Some(others), Vec::new()),
        Err(why) => (None, vec![format!("ArUco and SimpleBlobDetector: {why:#}")]),
    };
    let mut rows = Vec::new();
    let views = [View::Side, View::Top].map(|view| measure_view(view, length, others.as_ref()));
    let [side, top] = views;
    let ((side, side_model), (top, top_model)) = (side?, top?);
    for (mode, view, paper_figures) in CASES {
        let (methods, model) =
            if view == View::Side { (&side, &side_model) } else { (&top, &top_model) };
        let which = usize::from(mode == "3D");
        let model = model[which];
        let ours = methods[0][which];
        for (method, name) in ["Roundel", "ArUco", "SimpleBlobDetector"].into_iter().enumerate() {
            let (Some(errors), Some([mean, max])) = (methods[method][which], paper_figures[method])
            else {
                continue;
            };
            let row = |what: &str, [here, predicted]: [f64; 2], paper: f64| {
                let case = format!("{mode}, {}, {name}, {what}: %", view.name());
                let row = Row::new(case, 100.0 * here);
                match method {
                    0 => row.paper(paper, Aim::Less).model(100.0 * predicted),
                    _ => row.paper(paper, Aim::Neither),
                }
            };
            let exact = 100.0 * errors.exact_share;
            let found = format!(
                "{:.0} of {} found; {exact:.5} with exact tiles",
                errors.found, errors.expected
            );
            let note = match ours {
                Some(ours) if method > 0 => {
                    format!("{found}, {:.1} times ours", errors.exact_share / ours.exact_share)
                }
                _ => found,
            };
            rows.push(row("mean", [errors.mean_share, model.mean_share], mean).note(note));
            let times = errors.max_share / errors.mean_share;
            rows.push(
                row("maximum", [errors.max_share, model.max_share], max)
                    .note(format!("{times:.1} times the mean, in the paper {:.1}", max / mean)),
            );
        }
    }
    let remarks = vec![
        "As tables 3 and 4, with the Olympus. ArUco (4x4 cells, corners refined) and SimpleBlobDetector (areas of \
         any size) use their own markers of the same size at the same places, with the same lens and frame. \
         \"better by\" compares Roundel here with WhyCon in the paper; the last column gives the ratio to the \
         others here. Model: as for tables 3 and 4; it does not cover other methods."
            .to_owned(),
        "The tile errors of 0.6 mm, a hundredth of a per cent, are part of all errors, and max of those on the \
         plane; the last column gives each method's error without them. The other methods' errors in the paper \
         also include its lens, and versions of ten years ago."
            .to_owned(),
    ];
    let title = "Table 7: precision compared with other detectors (Olympus VR-340)".to_owned();
    Ok(Table { title, rows, remarks, skipped })
}

/// Means over pictures, by method (Roundel, ArUco, blobs), each on the plane and in space, and the prediction for
/// Roundel.
fn measure_view(
    view: View,
    length: Length,
    others: Option<&OpenCv>,
) -> anyhow::Result<([PlaneAndSpace; 3], [Prediction; 2])> {
    let camera = PaperCamera::olympus();
    let mut errors: [[Vec<Errors>; 2]; 3] = Default::default();
    let mut predictions: [Vec<Prediction>; 2] = Default::default();
    for seed in 0..length.pick(1, 3) {
        let hall = Hall::new(camera, view, 700 + seed);
        let lens = calibrated(&camera, length, 700 + seed)?;
        for (plane, all) in [true, false].into_iter().zip(&mut predictions) {
            all.push(predicted(&hall, &lens, plane));
        }
        let ours = roundels(&hall, &lens, &hall.picture(&|_| print()))?;
        let mut sights = vec![ours];
        if let Some(others) = others {
            sights.extend(other_detectors(&hall, &lens, others)?);
        }
        for (method, sights) in sights.iter().enumerate() {
            errors[method][0].extend(on_plane(&hall, sights).ok());
            errors[method][1].extend(in_space(&hall, sights).ok());
        }
    }
    let errors = errors.map(|both| both.map(|all| (!all.is_empty()).then(|| Errors::mean(&all))));
    Ok((errors, predictions.map(|all| Prediction::mean(&all))))
}

fn other_detectors(
    hall: &Hall,
    lens: &Calibrated,
    others: &OpenCv,
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
    let read_job = |job: &Vec<super::opencv::SearchResult>| {
        let mut sights = vec![None; hall.true_m.len()];
        for found in job.iter().flat_map(|image| &image.found) {
            if let Some(index) = hall.at(Vector2::from(found.center_px)) {
                sights[index] = locate(lens, found)?;
            }
        }
        anyhow::Ok(sights)
    };
    judged.iter().map(read_job).collect()
}

fn locate(lens: &Calibrated, found: &Found) -> anyhow::Result<Option<Sight>> {
    let [u, v] = found.center_px;
    let Ok(image) = core_camera(&lens.optics)?.undistort(PixelPoint { u, v }) else {
        return Ok(None);
    };
    let place = found.position_m.map(|position_m| {
        let position_m = Vector3::from(position_m);
        // A corner's tenth of a pixel; ten times more along the line of locate.
        let across_m = 0.1 * position_m.norm() / lens.optics.focal_px[0];
        loose(position_m, across_m, 10.0 * across_m)
    });
    Ok(Some(Sight { image, place }))
}
