//! Table 6: targets that move at up to 1.2 m/s before the Logitech.
//!
//! Stated in the paper: four references that define the frame, four sequences, the webcam's long exposure and rolling
//! shutter, errors against an exact reference system. Chosen here: an exposure of 20 ms, rows 30 µs apart, 30 frames
//! a second, three roundels of 15 cm on level circles at 0.4, 0.8 and 1.2 m/s, three metres away. The frame is
//! determined once, from the first picture, with a calibrated lens.
//!
//! An error is the distance to the roundel's true position at the detection's stated time.

use anyhow::Context;
use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use rayon::prelude::*;
use roundel_core::{
    camera::NormalizedPoint,
    marker::{Mode, Params},
    plan::{
        Imaging as PlannedImaging, Sensor, TrialCache,
        paper::{lens_share, range_share},
        precision::predict,
    },
    pose::Detection,
    world::reference::{Homography, Sighting, align},
};

use super::{
    Aim, Length, Row, Table,
    hall::OUTER_M,
    lens::{Calibrated, calibrated},
    model,
    precision::print,
    scene::{PaperCamera, RATIO, printed},
};
use crate::{
    arena::{Kind, Path, look_at},
    pipeline::{Observer, core_camera},
    random::Random,
    render::{Canvas, MovingPrint, Renderer},
};

const RATE_HZ: f64 = 30.0;
const EXPOSURE_S: f64 = 0.02;
const LINE_TIME_S: f64 = 30e-6;
const SPEEDS_M_S: [f64; 3] = [0.4, 0.8, 1.2];
const SEQUENCES: u64 = 4;
const REFERENCES_M: [[f64; 2]; 4] = [[-1.3, -0.8], [1.3, -0.8], [1.3, 0.8], [-1.3, 0.8]];

/// Errors of one detection of a target: metres, and shares of its distance.
#[derive(Clone, Copy)]
struct TargetError {
    space_m: f64,
    plane_m: f64,
    distance_m: f64,
    /// Number of the picture, and the target's speed.
    number: usize,
    speed_m_s: f64,
}

/// Mapping from the camera's pictures to the world.
struct Frame {
    world_from_camera: Isometry3<f64>,
    homography: Homography,
}

fn camera() -> PaperCamera {
    let mut camera = PaperCamera::logitech();
    camera.imaging.exposure_s = EXPOSURE_S;
    camera.imaging.line_time_s = LINE_TIME_S;
    camera
}

fn paths(random: &mut Random) -> Vec<Path> {
    let still = REFERENCES_M.map(|[x, y]| Path::still(Vector3::new(x, y, 0.0)));
    let target = |(index, &speed_m_s): (usize, &f64)| {
        let center_m = Vector3::new(0.8 * (index as f64 - 1.0), 0.0, 0.0);
        let phase_rad = random.uniform(0.0, std::f64::consts::TAU);
        Path::circuit(center_m, 0.28, speed_m_s, phase_rad)
    };
    let targets: Vec<_> = SPEEDS_M_S.iter().enumerate().map(target).collect();
    still.into_iter().chain(targets).collect()
}

/// Errors of all targets in all frames of a sequence, and their expected number.
fn sequence(
    lens: &Calibrated,
    frames: usize,
    seed: u64,
) -> anyhow::Result<(Vec<TargetError>, usize)> {
    let camera = camera();
    let mut random = Random::new(seed, 6);
    let paths = paths(&mut random);
    let camera_from_world = look_at(Vector3::new(0.0, -1.2, 2.8), Vector3::zeros()).inverse();
    let renderer = Renderer::new(camera.optics, camera.imaging);
    let floor = Canvas::flat(camera.optics.width, camera.optics.height, 120.0);
    let kind =
        Kind { outer_diameter_m: OUTER_M, inner_diameter_m: RATIO * OUTER_M, ..Kind::robot() };
    let mut observer =
        Observer::with_params(&lens.optics, &[kind], LINE_TIME_S, Params::default())?;
    let print = print();
    let mut frame = None;
    let mut errors = Vec::new();
    for number in 0..frames {
        let time_s = number as f64 / RATE_HZ;
        let motions: Vec<_> = paths
            .iter()
            .map(|path| move |offset_s: f64| camera_from_world * path.pose(time_s + offset_s))
            .collect();
        let moving: Vec<_> =
            motions.iter().map(|motion| MovingPrint { print: &print, motion }).collect();
        let image = renderer.frame(&floor, &moving, &mut random);
        let detections = observer.observe(&image, (time_s * 1e9) as i64)?;
        let placed = match frame.take() {
            Some(placed) => placed,
            None => place(&camera_from_world, &detections).context("the four references")?,
        };
        for (path, speed_m_s) in paths[REFERENCES_M.len()..].iter().zip(SPEEDS_M_S) {
            let error = error(&placed, path, &camera_from_world, &detections);
            errors.extend(error.map(|error| TargetError { number, speed_m_s, ..error }));
        }
        frame = Some(placed);
    }
    Ok((errors, frames * SPEEDS_M_S.len()))
}

/// Determines the frame from the detections near the references.
fn place(camera_from_world: &Isometry3<f64>, detections: &[Detection]) -> anyhow::Result<Frame> {
    let world_m = REFERENCES_M.map(|[x, y]| Vector3::new(x, y, 0.0));
    let poses = world_m.iter().map(|place_m| {
        let there = (camera_from_world * Point3::from(*place_m)).coords;
        let poses = detections.iter().filter_map(|detection| detection.pose.as_ref());
        let near = |pose: &&roundel_core::pose::RoundelPose| (pose.position_m - there).norm() < 0.2;
        poses.into_iter().find(near).context("one of them is not found")
    });
    let poses = poses.collect::<anyhow::Result<Vec<_>>>()?;
    let seen: Vec<_> = poses.iter().map(|pose| Sighting::from(*pose)).collect();
    let image: Vec<_> = poses.iter().map(|pose| on_image(&pose.position_m)).collect();
    let plane_m: Vec<_> = world_m.iter().map(|place_m| place_m.xy()).collect();
    Ok(Frame {
        world_from_camera: align(&world_m, &seen)?.world_from_camera,
        homography: Homography::new(&plane_m, &image)?,
    })
}

fn on_image(position_m: &Vector3<f64>) -> NormalizedPoint {
    NormalizedPoint { x: position_m.x / position_m.z, y: position_m.y / position_m.z }
}

/// Error of a target, or `None` if it is not detected.
fn error(
    frame: &Frame,
    path: &Path,
    camera_from_world: &Isometry3<f64>,
    detections: &[Detection],
) -> Option<TargetError> {
    detections.iter().find_map(|detection| {
        let pose = detection.pose.as_ref()?;
        let time_s = detection.capture_time.as_ns() as f64 * 1e-9;
        let truth_m = path.pose(time_s).translation.vector;
        let in_camera_m = (camera_from_world * Point3::from(truth_m)).coords;
        if (pose.position_m - in_camera_m).norm() > 0.2 {
            return None;
        }
        let found_m = (frame.world_from_camera * Point3::from(pose.position_m)).coords;
        let on_plane_m: Vector2<f64> = frame.homography.apply(on_image(&pose.position_m))?;
        Some(TargetError {
            space_m: (found_m - truth_m).norm(),
            plane_m: (on_plane_m - truth_m.xy()).norm(),
            distance_m: in_camera_m.norm(),
            number: 0,
            speed_m_s: 0.0,
        })
    })
}

/// One side of the table: its name, an error, its predicted mean, the paper's mean and maximum in centimetres and in
/// per cent, the equation, and the causes of differences.
type Side =
    (&'static str, fn(&TargetError) -> f64, f64, [[f64; 2]; 2], (&'static str, f64, String));

/// Predicted mean errors.
struct PredictedErrors {
    /// On the plane, for a static target.
    still_plane_m: f64,
    /// On the plane.
    plane_m: f64,
    space_m: f64,
    /// Equation 19, relative to the distance, and equation 18.
    by_lens: f64,
    plane_by_lens: f64,
}

/// For targets at this distance, halfway out in the picture. A smear of L pixels has the variance L²/12 along it and
/// none across: L²/24 on average.
fn predict_errors(lens: &Calibrated, distance_m: f64) -> anyhow::Result<PredictedErrors> {
    let semi_major_px = lens.optics.focal_px[0] * OUTER_M / (2.0 * distance_m);
    let semiaxes_px = [semi_major_px, 0.9 * semi_major_px];
    let imaging = camera().imaging;
    let axis_error_px = model::axis_error_px(&imaging, semiaxes_px);
    let lens_share = lens_share(lens.coefficients, [0.2, 0.1]);
    let (kind, _) = printed(OUTER_M);
    let camera_from_world = look_at(Vector3::new(0.0, -1.2, 2.8), Vector3::zeros()).inverse();
    let pose = camera_from_world * Isometry3::translation(0.4, 0.2, 0.0);
    let trials = TrialCache::default();
    let deviations = |speed_m_s: f64| {
        let smear_px = speed_m_s * EXPOSURE_S * lens.optics.focal_px[0] / distance_m;
        let blur_px = (imaging.blur_px.powi(2) + smear_px * smear_px / 24.0).sqrt();
        let sensor = Sensor {
            camera: core_camera(&lens.optics)?,
            lens_uncertainty: None,
            imaging: PlannedImaging {
                noise: imaging.noise,
                blur_px,
                black: imaging.black,
                white: imaging.white,
            },
            mode: Mode::Precise,
            trials: trials.clone(),
        };
        let expected = predict(&sensor, &kind, &pose).context("a target that would be found")?;
        anyhow::Ok([expected.across_m(), expected.depth_m()])
    };
    // Means of distances on a plane and along a line, with the contribution of the four that define the frame, 0.48
    // in squares.
    let frame = 1.48f64.sqrt();
    let on_plane = |across_m: f64| (1.253 * frame * across_m).hypot(lens_share * distance_m);
    let [mut plane_m, mut space_m] = [0.0; 2];
    for speed_m_s in SPEEDS_M_S {
        let [across_m, depth_m] = deviations(speed_m_s)?;
        plane_m += on_plane(across_m) / SPEEDS_M_S.len() as f64;
        let along_m = (0.798 * depth_m).hypot(lens.focal_share * distance_m);
        space_m += along_m / SPEEDS_M_S.len() as f64;
    }
    let [still_m, _] = deviations(0.0)?;
    let by_lens = range_share(lens.focal_share, axis_error_px, semi_major_px, lens_share);
    let still_plane_m = on_plane(still_m);
    Ok(PredictedErrors { still_plane_m, plane_m, space_m, by_lens, plane_by_lens: lens_share })
}

/// The paper's table 6.
pub fn table(length: Length) -> anyhow::Result<Table> {
    let frames = length.pick(12, 90);
    let lens = calibrated(&camera(), length, 6)?;
    let sequences: Vec<_> = (0..SEQUENCES)
        .into_par_iter()
        .map(|seed| sequence(&lens, frames, seed))
        .collect::<anyhow::Result<_>>()?;
    let expected: usize = sequences.iter().map(|(_, expected)| expected).sum();
    let errors: Vec<TargetError> = sequences.into_iter().flat_map(|(errors, _)| errors).collect();
    let mean = |value: fn(&TargetError) -> f64| {
        errors.iter().map(value).sum::<f64>() / errors.len() as f64
    };
    let distance_m = mean(|error| error.distance_m);
    let PredictedErrors { still_plane_m, plane_m, space_m, by_lens, plane_by_lens } =
        predict_errors(&lens, distance_m)?;
    let found = format!(
        "{} of {expected} found; {:.5} from noise without motion, {:.1} times as much with smear",
        errors.len(),
        100.0 * still_plane_m,
        plane_m / still_plane_m
    );
    let relative_to_mean = |max: f64, mean: f64, paper: [f64; 2]| {
        format!("{:.1} times the mean, in the paper {:.1}", max / mean, paper[1] / paper[0])
    };
    // As many draws as measurements, for the same expected maximum.
    let expected_max = |mean_m: f64| model::expected_max(&vec![mean_m; errors.len()]);
    let sides: [Side; 2] = [
        (
            "2D",
            |it| it.plane_m,
            plane_m,
            [[1.2, 4.2], [0.4, 1.5]],
            ("equation 18", plane_by_lens, found),
        ),
        (
            "3D",
            |it| it.space_m,
            space_m,
            [[3.1, 11.2], [1.2, 4.4]],
            ("equation 19", by_lens, "noise, and the lens' focal length".to_owned()),
        ),
    ];
    let mut rows = Vec::new();
    for (name, error_m, model_m, [paper_cm, paper_percent], (equation, alone, note)) in sides {
        let share = move |error: &TargetError| error_m(error) / error.distance_m;
        let mean_and_max = |value: &dyn Fn(&TargetError) -> f64| {
            let mean = errors.iter().map(value).sum::<f64>() / errors.len() as f64;
            (mean, errors.iter().map(value).fold(0.0, f64::max))
        };
        let ((mean_m, max_m), (mean_share, max_share)) =
            (mean_and_max(&error_m), mean_and_max(&share));
        let row = |what: &str, here: f64, model: f64, paper: f64| {
            Row::new(format!("{name}, {what}"), 100.0 * here)
                .paper(paper, Aim::Less)
                .model(100.0 * model)
        };
        let max_model_m = expected_max(model_m);
        let largest = errors.iter().max_by(|one, other| error_m(one).total_cmp(&error_m(other)));
        let largest = largest.context("a target that was found")?;
        let searched = match largest.number {
            0 => ", which is searched, without a known motion",
            _ => "",
        };
        let when = format!(
            "at {} m/s in picture {} of {frames}{searched}",
            largest.speed_m_s,
            largest.number + 1
        );
        rows.extend([
            row("mean: cm", mean_m, model_m, paper_cm[0]).note(note),
            row("maximum: cm", max_m, max_model_m, paper_cm[1])
                .note(format!("{}; {when}", relative_to_mean(max_m, mean_m, paper_cm))),
            row("mean: %", mean_share, model_m / distance_m, paper_percent[0]).note(format!(
                "over the distance; {equation} alone predicts {:.7} %, {:.1} times less",
                100.0 * alone,
                mean_share / alone
            )),
            row("maximum: %", max_share, max_model_m / distance_m, paper_percent[1])
                .note(relative_to_mean(max_share, mean_share, paper_percent)),
        ]);
    }
    let remarks = vec![
        format!(
            "{SEQUENCES} sequences of {frames} frames: three roundels of 15 cm at 0.4, 0.8 and 1.2 m/s, three \
             metres away, exposed for {:.0} ms (at 1.2 m/s a smear of 6 px) with a rolling shutter of {:.0} µs \
             per row. The shutter is configured.",
            1e3 * EXPOSURE_S,
            1e6 * LINE_TIME_S
        ),
        "Equations 18 and 19 do not model motion, nor noise on the plane, and the lens errors nearly cancel with \
         those of the frame's four roundels. Our model is therefore that of `roundel plan`: noise of the rims, \
         with the smear as a wider blur, of the target and of the four roundels that define the frame, plus the \
         lens; maximum errors assume a Rayleigh distribution. It ignores that the fit estimates smear and speed \
         too, which costs precision."
            .to_owned(),
        "The paper's errors come from blur, and from the unknown delay and shutter of its camera. Here each \
         detection has the time of its own row, the smear is fitted with the rims, and the camera's times are \
         exact. The missed detections are white discs of 15 px smeared by 6 px, whose ratio of areas no longer \
         fits their kind."
            .to_owned(),
    ];
    let title = "Table 6: precision of a moving target (Logitech QC Pro)".to_owned();
    Ok(Table { title, rows, remarks, skipped: Vec::new() })
}
