//! Robots on a floor under one camera ("2D mode"): by homography, or by the plane in the filter.
//!
//! Both methods are calibrated from the same four roundels with known positions at the robots' height, observed for a
//! second, and process the same observations. The homography (the paper's section 4.4.2) maps the four image points
//! to the plane, and each observation's line of sight to a point on it. The covariance of that point is that of the
//! line of sight where it meets a floor of fusion's assumed flatness, and a filter of free motion tracks it. In the
//! other method, the camera's pose is estimated from the four roundels ([`align`]), observations keep their depths,
//! and the filter restricts ground robots to their floor (`MotionClass::Ground`). Free motion without a floor is
//! shown for comparison.
//!
//! Rms in the plane, filter's plane against homography: 1.45 and 1.41 mm at 0.1 px, 4.45 and 4.48 at 0.5 px, 2.83 and
//! 2.89 where robots are up to 10 mm higher or lower than configured; 5.5 to 26 without a plane. So the filter's
//! plane is used: it is as good, works with one camera and with several, and needs no other calibration.
//!
//! If calibration and heights are as exact as stated, both methods intersect the same line of sight with the same
//! plane. They differ in three ways: the size of a ring adds information about its distance; four image points
//! determine eight numbers, while a camera with a known lens has six; and a camera's pose comes with its covariance.
//! Errors of several calibrations are pooled. Shares inside 95 % are not given: a calibration has the same error for
//! all observations.
//!
//! [`align`]: roundel_core::world::reference::align

use std::collections::BTreeMap;

use anyhow::Context;
use nalgebra::{Matrix3, Vector2, Vector3};
use roundel_core::{
    camera::NormalizedPoint,
    id::{CameraId, KindId},
    pose::RoundelPose,
    world::{
        CameraPlacement, FrameObservations, Fusion, FusionParams, MotionClass,
        reference::{Homography, Sighting, align},
    },
};

use super::{
    Length, Row,
    run::{Run, Ticks},
};
use crate::{
    arena::{Arena, Kind, Path, Site},
    random::Random,
    score::Score,
    sensor::{Sensing, Stream},
};

/// Height of the robots' roundels.
const HEIGHT_M: f64 = 0.3;
/// Assumed flatness of the floor.
const FLATNESS_M: f64 = 0.003;
/// The camera's view: the floor point at its centre, and the floor directions to the right and away from the camera.
const VIEW_CENTER_M: [f64; 2] = [-1.3, -1.05];
const RIGHT: [f64; 2] = [0.62, -0.78];
const AHEAD: [f64; 2] = [0.78, 0.62];
/// The four reference roundels: to the right of the centre and away from the camera.
const CORNERS_M: [[f64; 2]; 4] = [[-2.6, -1.4], [2.6, -1.4], [2.6, 1.4], [-2.6, 1.4]];
/// Duration of the calibration.
const CALIBRATION_S: f64 = 1.0;
const ROBOTS: usize = 12;
/// Bar for the error of the filter's plane over that of the homography.
const MAX_RATIO: f64 = 1.05;
/// Calibrations whose errors are pooled.
const CALIBRATIONS: u64 = 6;

/// Calibration of one camera from the four roundels.
struct Calibrated {
    homography: Homography,
    placement: CameraPlacement,
}

#[derive(Clone, Copy)]
enum Method {
    Homography,
    Floor,
    Free,
}

fn one_camera(seed: u64, paths: Vec<Path>) -> Arena {
    // The same camera for every seed, which determines its errors.
    let mut arena = Arena::under_r4(1, Kind::robot(), paths);
    arena.seed = seed;
    arena.sites.truncate(1);
    arena
}

/// A floor position by its place in the camera's view.
fn in_view(right_m: f64, ahead_m: f64, height_m: f64) -> Vector3<f64> {
    let place = |axis: usize| VIEW_CENTER_M[axis] + RIGHT[axis] * right_m + AHEAD[axis] * ahead_m;
    Vector3::new(place(0), place(1), height_m)
}

fn calibrate(seed: u64, sensing: Sensing) -> anyhow::Result<Calibrated> {
    let places_m = CORNERS_M.map(|[right_m, ahead_m]| in_view(right_m, ahead_m, HEIGHT_M));
    let arena = one_camera(seed, places_m.map(Path::still).to_vec());
    // Detections are grouped by track number; tracks are numbered in the order of robots.
    let mut seen: BTreeMap<u64, Vec<RoundelPose>> = BTreeMap::new();
    for frame in Stream::new(&arena, Sensing { dropout: 0.0, ..sensing }, CALIBRATION_S) {
        for detection in frame.detections {
            seen.entry(detection.track.0).or_default().extend(detection.pose);
        }
    }
    anyhow::ensure!(seen.len() == places_m.len(), "{} of four roundels seen", seen.len());
    let mean = |poses: &Vec<RoundelPose>| {
        let count = poses.len() as f64;
        let sum: Vector3<f64> = poses.iter().map(|pose| pose.position_m).sum();
        // The systematic share is not reduced by averaging.
        let share = sensing.systematic_share + (1.0 - sensing.systematic_share) / count;
        let covariance = poses[0].covariance.fixed_view::<3, 3>(0, 0) * share;
        Sighting { position_m: sum / count, covariance }
    };
    let sightings: Vec<Sighting> = seen.values().map(mean).collect();
    let image: Vec<NormalizedPoint> =
        sightings.iter().map(|sighting| bearing(&sighting.position_m)).collect();
    let plane_m: Vec<Vector2<f64>> = places_m.iter().map(|place_m| place_m.xy()).collect();
    let placed = align(&places_m, &sightings)?;
    Ok(Calibrated {
        homography: Homography::new(&plane_m, &image)?,
        placement: CameraPlacement {
            world_from_camera: placed.world_from_camera,
            covariance: placed.covariance,
        },
    })
}

fn bearing(position_m: &Vector3<f64>) -> NormalizedPoint {
    NormalizedPoint { x: position_m.x / position_m.z, y: position_m.y / position_m.z }
}

/// Replaces each position by that of the homography. The detour through the camera's true pose cancels: the
/// homography itself does not use it.
fn on_plane(
    mut frame: FrameObservations,
    homography: &Homography,
    site: &Site,
    noise_px: f64,
) -> anyhow::Result<FrameObservations> {
    let place = &site.world_from_camera;
    for pose in frame.detections.iter_mut().filter_map(|detection| detection.pose.as_mut()) {
        let found = homography.apply(bearing(&pose.position_m)).context("beyond the horizon")?;
        let point_m = found.push(HEIGHT_M);
        let eye_m = place.translation.vector;
        let sight = (point_m - eye_m).normalize();
        // An error across the line of sight moves the point along the floor, an error of the height moves it along
        // the line of sight.
        let across_m = noise_px * (point_m - eye_m).norm() / site.optics.focal_px[0];
        let slide = Matrix3::identity() - sight * Vector3::z().transpose() / sight.z;
        let along_m = FLATNESS_M / sight.z;
        let covariance = slide * slide.transpose() * across_m.powi(2)
            + sight * sight.transpose() * along_m.powi(2);
        let turn = place.rotation.to_rotation_matrix().into_inner();
        let seen = turn.transpose() * covariance * turn;
        pose.position_m = place.inverse_transform_point(&point_m.into()).coords;
        pose.covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&seen);
    }
    Ok(frame)
}

/// Robots whose roundels deviate from the configured height by up to `uneven_m`.
fn robots(seed: u64, uneven_m: f64) -> Arena {
    let mut random = Random::new(seed, 2);
    let paths = (0..ROBOTS).map(|index| {
        let place = |number: usize, count: usize, step_m: f64| {
            (number as f64 - (count as f64 - 1.0) / 2.0) * step_m
        };
        let height_m = HEIGHT_M + random.uniform(-uneven_m, uneven_m);
        let center_m = in_view(place(index % 4, 4, 1.2), place(index / 4, 3, 1.0), height_m);
        Path::wandering(center_m, 0.4, None, &mut random)
    });
    one_camera(seed, paths.collect())
}

fn run(
    arena: &Arena,
    way: Method,
    found: &Calibrated,
    sensing: Sensing,
    seconds: f64,
) -> anyhow::Result<Score> {
    let mut fusion = Fusion::new(FusionParams::default());
    let (camera, kind) = (CameraId(0), KindId(0));
    let placement = match way {
        Method::Homography => CameraPlacement {
            world_from_camera: arena.sites[0].world_from_camera,
            covariance: nalgebra::Matrix6::zeros(),
        },
        Method::Floor | Method::Free => found.placement,
    };
    fusion.set_camera(camera, Some(placement));
    if matches!(way, Method::Floor) {
        fusion.set_motion(kind, MotionClass::Ground { height_m: Some(HEIGHT_M) });
    }
    let ticks = Ticks { rate_hz: 60.0, judged_from_s: 1.0 };
    let frames: anyhow::Result<Vec<_>> = Stream::new(arena, sensing, seconds)
        .map(|frame| match way {
            Method::Homography => {
                on_plane(frame, &found.homography, &arena.sites[0], sensing.noise_px)
            }
            Method::Floor | Method::Free => Ok(frame),
        })
        .collect();
    Ok(Run::with(arena, ticks, fusion).take_all(frames?).finish().score)
}

/// Rms errors in the plane over all calibrations.
fn errors_m(uneven_m: f64, sensing: Sensing, seconds: f64) -> anyhow::Result<[f64; 3]> {
    let mut squares = [0.0; 3];
    for seed in 0..CALIBRATIONS {
        let found = calibrate(100 + seed, sensing)?;
        let arena = robots(200 + seed, uneven_m);
        for (sum, way) in squares.iter_mut().zip([Method::Homography, Method::Floor, Method::Free])
        {
            let score = run(&arena, way, &found, sensing, seconds)?;
            anyhow::ensure!(score.ids == ROBOTS && score.swaps == 0, "{} ids", score.ids);
            *sum += score.plane.rms().powi(2) / CALIBRATIONS as f64;
        }
    }
    Ok(squares.map(f64::sqrt))
}

/// Flat and uneven floors, with low and high noise.
pub fn plane(length: Length) -> Vec<Row> {
    let seconds = length.seconds(10.0, 3.0);
    let cases = [
        ("at the configured height, 0.1 px", 0.0, Sensing::DEFAULT),
        ("at the configured height, 0.5 px", 0.0, Sensing { noise_px: 0.5, ..Sensing::DEFAULT }),
        ("10 mm higher or lower, 0.1 px", 0.01, Sensing::DEFAULT),
    ];
    let row = |(what, uneven_m, sensing): (&str, f64, Sensing)| {
        let row = Row::new(
            format!("2D mode: 12 plain robots under one camera of R4, {what}"),
            "the plane in the filter as good as a homography, within 5 %",
        );
        match errors_m(uneven_m, sensing, seconds) {
            Ok([homography_m, floor_m, free_m]) => row
                .check(
                    format!("rms in the plane {:.2} mm by the filter's plane", floor_m * 1e3),
                    floor_m <= MAX_RATIO * homography_m,
                )
                .note(format!("{:.2} mm by homography", homography_m * 1e3))
                .note(format!("{:.2} mm without a plane", free_m * 1e3)),
            Err(error) => row.check(format!("{error:#}"), false),
        }
    };
    cases.into_iter().map(row).collect()
}
