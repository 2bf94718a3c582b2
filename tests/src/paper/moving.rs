//! Table 6: targets that move at up to 1.2 m/s before the Logitech.
//!
//! As stated: four references that define the frame, four sequences, the webcam's long exposure and rolling shutter,
//! errors against a reference system that is exact. Chosen: an exposure of 20 ms, rows 30 µs apart, 30 frames a
//! second, three roundels of 15 cm that go round level circles at 0.4, 0.8 and 1.2 m/s, three metres away. The frame
//! is found once, from the first picture, with a lens that was calibrated.
//!
//! An error is the distance from where the roundel was at the time that is stated for the detection.

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
    normal::Random,
    pipeline::{Observer, core_camera},
    render::{Canvas, Renderer, Seen},
};

const RATE_HZ: f64 = 30.0;
const EXPOSURE_S: f64 = 0.02;
const LINE_TIME_S: f64 = 30e-6;
const SPEEDS_M_S: [f64; 3] = [0.4, 0.8, 1.2];
const SEQUENCES: u64 = 4;
const REFERENCES_M: [[f64; 2]; 4] = [[-1.3, -0.8], [1.3, -0.8], [1.3, 0.8], [-1.3, 0.8]];

/// Errors of one detection of a target: metres, and shares of its distance.
#[derive(Clone, Copy)]
struct Miss {
    space_m: f64,
    plane_m: f64,
    distance_m: f64,
    /// In which picture, and how fast it was.
    number: usize,
    speed_m_s: f64,
}

/// How the camera's pictures lie on the world.
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

/// Misses of all targets in all frames of a sequence, and how many there were to be.
fn sequence(lens: &Calibrated, frames: usize, seed: u64) -> anyhow::Result<(Vec<Miss>, usize)> {
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
    let mut misses = Vec::new();
    for number in 0..frames {
        let time_s = number as f64 / RATE_HZ;
        let motions: Vec<_> = paths
            .iter()
            .map(|path| move |offset_s: f64| camera_from_world * path.pose(time_s + offset_s))
            .collect();
        let seen: Vec<_> = motions.iter().map(|motion| Seen { print: &print, motion }).collect();
        let image = renderer.frame(&floor, &seen, &mut random);
        let detections = observer.observe(&image, (time_s * 1e9) as i64)?;
        let placed = match frame.take() {
            Some(placed) => placed,
            None => place(&camera_from_world, &detections).context("the four references")?,
        };
        for (path, speed_m_s) in paths[REFERENCES_M.len()..].iter().zip(SPEEDS_M_S) {
            let miss = miss(&placed, path, &camera_from_world, &detections);
            misses.extend(miss.map(|miss| Miss { number, speed_m_s, ..miss }));
        }
        frame = Some(placed);
    }
    Ok((misses, frames * SPEEDS_M_S.len()))
}

/// The frame by what is seen near where the references are.
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

/// How far a target is from where it is found; `None` if it is not.
fn miss(
    frame: &Frame,
    path: &Path,
    camera_from_world: &Isometry3<f64>,
    detections: &[Detection],
) -> Option<Miss> {
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
        Some(Miss {
            space_m: (found_m - truth_m).norm(),
            plane_m: (on_plane_m - truth_m.xy()).norm(),
            distance_m: in_camera_m.norm(),
            number: 0,
            speed_m_s: 0.0,
        })
    })
}

/// Of the table: its name, an error, what is foretold of its mean, the paper's mean and greatest in centimetres and in
/// per cent; which of its equations says what, and what makes them differ.
type Side = (&'static str, fn(&Miss) -> f64, f64, [[f64; 2]; 2], (&'static str, f64, String));

/// What is predicted of the means of errors.
struct Foretold {
    /// On the plane if nothing moved, metres.
    still_plane_m: f64,
    /// On the plane, metres.
    plane_m: f64,
    /// In space, metres.
    space_m: f64,
    /// Equation 19, a share of the distance, and equation 18.
    by_lens: f64,
    plane_by_lens: f64,
}

/// Of targets at this distance, half way out in the picture. The smear of L pixels is as wide as a blur whose variance is
/// L²/12 along it and nothing across: L²/24 all round.
fn foretold(lens: &Calibrated, distance_m: f64) -> anyhow::Result<Foretold> {
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
            imaging: PlannedImaging {
                noise: imaging.noise,
                blur_px,
                black: imaging.black,
                white: imaging.white,
            },
            mode: Mode::Precise,
            trials: trials.clone(),
        };
        let expected =
            predict(&sensor, None, &kind, &pose).context("a target that would be found")?;
        anyhow::Ok([expected.across_m(), expected.depth_m()])
    };
    // Means of distances on a plane and along a line, and what the four that define the frame add, which between them
    // count 0.48 in squares.
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
    Ok(Foretold { still_plane_m, plane_m, space_m, by_lens, plane_by_lens: lens_share })
}

/// The paper's table 6.
pub fn table(length: Length) -> anyhow::Result<Table> {
    let frames = length.pick(12, 90);
    let lens = calibrated(&camera(), length, 6)?;
    let sequences: Vec<_> = (0..SEQUENCES)
        .into_par_iter()
        .map(|seed| sequence(&lens, frames, seed))
        .collect::<anyhow::Result<_>>()?;
    let of: usize = sequences.iter().map(|(_, of)| of).sum();
    let misses: Vec<Miss> = sequences.into_iter().flat_map(|(misses, _)| misses).collect();
    let mean =
        |value: fn(&Miss) -> f64| misses.iter().map(value).sum::<f64>() / misses.len() as f64;
    let distance_m = mean(|miss| miss.distance_m);
    let Foretold { still_plane_m, plane_m, space_m, by_lens, plane_by_lens } =
        foretold(&lens, distance_m)?;
    let found = format!(
        "{} of {of} found; {:.5} by noise if they stood still, {:.1} times that by the smear",
        misses.len(),
        100.0 * still_plane_m,
        plane_m / still_plane_m
    );
    let of_mean = |most: f64, mean: f64, told: [f64; 2]| {
        format!("{:.1} times the mean, by the paper {:.1}", most / mean, told[1] / told[0])
    };
    // Of the same length, so that the greatest of them is that of so many draws.
    let greatest = |mean_m: f64| model::greatest(&vec![mean_m; misses.len()]);
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
    for (name, error_m, model_m, [told_cm, told_percent], (equation, alone, note)) in sides {
        let share = move |miss: &Miss| error_m(miss) / miss.distance_m;
        let all = |of: &dyn Fn(&Miss) -> f64| {
            let mean = misses.iter().map(of).sum::<f64>() / misses.len() as f64;
            (mean, misses.iter().map(of).fold(0.0, f64::max))
        };
        let ((mean_m, most_m), (mean_share, most_share)) = (all(&error_m), all(&share));
        let row = |what: &str, here: f64, model: f64, told: f64| {
            Row::new(format!("{name}, {what}"), 100.0 * here)
                .paper(told, Aim::Less)
                .model(100.0 * model)
        };
        let most_model_m = greatest(model_m);
        let worst = misses.iter().max_by(|one, other| error_m(one).total_cmp(&error_m(other)));
        let worst = worst.context("a target that was found")?;
        let searched = match worst.number {
            0 => ", which is searched, with no motion known from before",
            _ => "",
        };
        let when = format!(
            "at {} m/s in picture {} of {frames}{searched}",
            worst.speed_m_s,
            worst.number + 1
        );
        rows.extend([
            row("mean: cm", mean_m, model_m, told_cm[0]).note(note),
            row("greatest: cm", most_m, most_model_m, told_cm[1])
                .note(format!("{}; {when}", of_mean(most_m, mean_m, told_cm))),
            row("mean: %", mean_share, model_m / distance_m, told_percent[0]).note(format!(
                "over the distance; {equation} alone says {:.7} %, {:.1} times less",
                100.0 * alone,
                mean_share / alone
            )),
            row("greatest: %", most_share, most_model_m / distance_m, told_percent[1])
                .note(of_mean(most_share, mean_share, told_percent)),
        ]);
    }
    let remarks = vec![
        format!(
            "{SEQUENCES} sequences of {frames} frames, three roundels of 15 cm at 0.4, 0.8 and 1.2 m/s three metres away, \
             exposed for {:.0} ms (at 1.2 m/s a smear of 6 px) by a rolling shutter of {:.0} µs a row. The camera's shutter \
             is known, as it has to be in a configuration.",
            1e3 * EXPOSURE_S,
            1e6 * LINE_TIME_S
        ),
        "Equations 18 and 19 know of no motion and, on the plane, of no noise: the lens' coefficients alone, which the \
         frame's four roundels were seen through as well, leave next to nothing. Our model is therefore that of the plan: noise through the rims, with the smear as a wider blur, of a target and of the four that define the \
         frame, beside the lens; the greatest are those of as many that vary about its mean (Rayleigh). It does not know that the fit \
         finds smear and speed as well, which costs precision."
            .to_owned(),
        "The paper's error is blur, and the delay and shutter of a camera whose times it did not know; here each detection has \
         the time of its own row, the smear is fitted with the rims, and the camera's times are right. What is not found is a \
         white disc of 15 px, smeared by 6 px, whose ratio of areas is then no longer that of its kind."
            .to_owned(),
    ];
    let title = "Table 6: precision of a moving target (Logitech QC Pro)".to_owned();
    Ok(Table { title, rows, remarks, skipped: Vec::new() })
}
