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
    marker::Params,
    plan::paper::{lens_share, range_share},
    pose::Detection,
    world::reference::{Homography, Sighting, align},
};

use super::{
    Aim, Length, Row, Table,
    hall::OUTER_M,
    lens::{Calibrated, calibrated},
    model,
    precision::print,
    scene::{PaperCamera, RATIO},
};
use crate::{
    arena::{Kind, Path, look_at},
    normal::Random,
    pipeline::Observer,
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
        for path in &paths[REFERENCES_M.len()..] {
            misses.extend(miss(&placed, path, &camera_from_world, &detections));
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
        })
    })
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
    let most = |value: fn(&Miss) -> f64| misses.iter().map(value).fold(0.0, f64::max);
    let distance_m = mean(|miss| miss.distance_m);
    let semi_major_px = lens.optics.focal_px[0] * OUTER_M / (2.0 * distance_m);
    let axis_error_px =
        model::axis_error_px(&camera().imaging, [semi_major_px, 0.9 * semi_major_px]);
    // The middle of what the targets cover.
    let plane = lens_share(lens.coefficients, [0.2, 0.1]);
    let space = range_share(lens.focal_share, axis_error_px, semi_major_px, plane);
    let found = format!("{} of {of} found", misses.len());
    let rows = vec![
        Row::new("2D, mean: cm", 100.0 * mean(|it| it.plane_m)).paper(1.2, Aim::Less).note(found),
        Row::new("2D, greatest: cm", 100.0 * most(|it| it.plane_m)).paper(4.2, Aim::Less),
        Row::new("2D, mean: %", 100.0 * mean(|it| it.plane_m / it.distance_m))
            .paper(0.4, Aim::Less)
            .model(100.0 * plane),
        Row::new("2D, greatest: %", 100.0 * most(|it| it.plane_m / it.distance_m))
            .paper(1.5, Aim::Less),
        Row::new("3D, mean: cm", 100.0 * mean(|it| it.space_m)).paper(3.1, Aim::Less),
        Row::new("3D, greatest: cm", 100.0 * most(|it| it.space_m)).paper(11.2, Aim::Less),
        Row::new("3D, mean: %", 100.0 * mean(|it| it.space_m / it.distance_m))
            .paper(1.2, Aim::Less)
            .model(100.0 * space),
        Row::new("3D, greatest: %", 100.0 * most(|it| it.space_m / it.distance_m))
            .paper(4.4, Aim::Less),
    ];
    let remarks = vec![
        format!(
            "{SEQUENCES} sequences of {frames} frames, three roundels of 15 cm at 0.4, 0.8 and 1.2 m/s three metres away, \
             exposed for {:.0} ms (at 1.2 m/s a smear of 6 px) by a rolling shutter of {:.0} µs a row. The camera's shutter \
             is known, as it has to be in a configuration.",
            1e3 * EXPOSURE_S,
            1e6 * LINE_TIME_S
        ),
        "Model: equations 18 and 19, which know of no motion. The paper's error is blur, and the delay and shutter of a \
         camera whose times it did not know; here each detection has the time of its own row, the smear is fitted with \
         the rims, and the camera's times are right. What is not found is a white disc of 15 px, \
         smeared by 6 px, whose ratio of areas is then no longer that of its kind."
            .to_owned(),
    ];
    let title = "Table 6: precision of a moving target (Logitech QC Pro)".to_owned();
    Ok(Table { title, rows, remarks, skipped: Vec::new() })
}
