//! Poses from rendered pixels: the default `RimNoise` must be that of the detector.

use nalgebra::{Isometry3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use roundel_core::{
    camera::{Camera, Intrinsics, Lens, PixelPoint},
    frame::Frame,
    marker::{Detector, Kind, Params, Scratch},
    pose::{RimNoise, locate},
    rigid::{mahalanobis_squared, orientation_of_normal},
};

/// Side of a rendered image, pixels, and subpixels along a pixel's side.
const SIDE_PX: usize = 96;
const FINE: usize = 12;
const BLUR_PX: f64 = 0.7;
const NOISE: f64 = 2.0;

fn camera() -> Camera {
    Camera::new(Intrinsics {
        width: SIDE_PX,
        height: SIDE_PX,
        fx_px: 1100.0,
        fy_px: 1100.0,
        // The roundels appear at the side of the field of view, where perspective gives more information.
        cx_px: -250.0,
        cy_px: 310.0,
        lens: Lens::PlumbBob([-0.08, 0.02, 0.0003, -0.0004, 0.0]),
    })
    .unwrap()
}

fn kind() -> Kind {
    Kind::plain("robot", 0.16, 0.064)
}

/// A sheet of twice the ring's size, blurred, with noise.
fn render(rays: &[Vector3<f64>], pose: &Isometry3<f64>, random: &mut ChaCha8Rng) -> Vec<u8> {
    let kind = kind();
    let normal = pose.rotation * Vector3::z();
    let center = pose.translation.vector;
    let grey = |ray: &Vector3<f64>| {
        let diameter_m = 2.0 * (ray * (normal.dot(&center) / normal.dot(ray)) - center).norm();
        if diameter_m < kind.inner_diameter_m {
            200.0
        } else if diameter_m < kind.outer_diameter_m {
            40.0
        } else if diameter_m < 1.5 * kind.outer_diameter_m {
            200.0
        } else {
            110.0
        }
    };
    let sharp: Vec<f64> = rays
        .chunks(FINE * FINE)
        .map(|pixel| pixel.iter().map(grey).sum::<f64>() / (FINE * FINE) as f64)
        .collect();
    let weights: Vec<f64> =
        (-3i32..=3).map(|k| (-0.5 * (f64::from(k) / BLUR_PX).powi(2)).exp()).collect();
    let total: f64 = weights.iter().sum();
    let blur = |image: &[f64], stride: usize, along: fn(usize) -> usize| -> Vec<f64> {
        (0..SIDE_PX * SIDE_PX)
            .map(|index| {
                let place = along(index) as i32;
                let sum: f64 = weights
                    .iter()
                    .zip(-3i32..)
                    .map(|(weight, k)| {
                        let there = (place + k).clamp(0, SIDE_PX as i32 - 1) - place;
                        weight * image[(index as i64 + i64::from(there) * stride as i64) as usize]
                    })
                    .sum();
                sum / total
            })
            .collect()
    };
    let rows = blur(&sharp, 1, |index| index % SIDE_PX);
    let both = blur(&rows, SIDE_PX, |index| index / SIDE_PX);
    both.iter()
        .map(|grey| {
            let noise: f64 = StandardNormal.sample(random);
            (grey + NOISE * noise).round().clamp(0.0, 255.0) as u8
        })
        .collect()
}

/// Bearings of all subpixels, pixel by pixel.
fn rays(camera: &Camera) -> Vec<Vector3<f64>> {
    let at = |k: usize| (k as f64 + 0.5) / FINE as f64 - 0.5;
    (0..SIDE_PX * SIDE_PX)
        .flat_map(|index| (0..FINE * FINE).map(move |k| (index, k)))
        .map(|(index, k)| {
            let (u, v) = ((index % SIDE_PX) as f64, (index / SIDE_PX) as f64);
            camera.bearing(PixelPoint { u: u + at(k % FINE), v: v + at(k / FINE) }).unwrap()
        })
        .collect()
}

/// Results for roundels of one size and a range of tilts.
#[derive(Debug, Default)]
struct Tally {
    found: usize,
    /// Positions within their 95 % ellipsoid.
    inside: usize,
    /// Sum of squared errors of depth, over their stated variance.
    depth: f64,
    /// Sum of squared errors across the line of sight, over their stated variance.
    lateral: f64,
}

fn tally(radius_px: f64, tilts_rad: std::ops::Range<f64>, runs: usize) -> Tally {
    let (camera, kind) = (camera(), kind());
    let rays = rays(&camera);
    let detector = Detector::new(vec![kind.clone()], Params::default()).unwrap();
    let mut scratch = Scratch::default();
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut tally = Tally::default();
    for _ in 0..runs {
        let pixel =
            PixelPoint { u: random.random_range(47.0..48.0), v: random.random_range(47.0..48.0) };
        let bearing = camera.bearing(pixel).unwrap();
        let position_m = bearing * (0.5 * kind.outer_diameter_m * 1100.0 / radius_px);
        let cos: f64 = random.random_range(tilts_rad.end.cos()..tilts_rad.start.cos());
        let turn_rad: f64 = random.random_range(-3.1..3.1);
        let across = (1.0 - cos * cos).sqrt();
        let tilted = Vector3::new(across * turn_rad.cos(), across * turn_rad.sin(), cos);
        let normal = orientation_of_normal(&-bearing) * tilted;
        let truth = Isometry3::from_parts(position_m.into(), orientation_of_normal(&normal));
        let pixels = render(&rays, &truth, &mut random);
        let frame = Frame::new(&pixels, SIDE_PX, SIDE_PX, SIDE_PX).unwrap();
        let [ring] = *detector.detect(&frame, &mut scratch) else { continue };
        let pose = locate(&camera, &kind, &ring, &RimNoise::default()).unwrap();
        tally.found += 1;
        let off_m = position_m - pose.position_m;
        let covariance = pose.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        tally.inside += usize::from(mahalanobis_squared(&off_m, &covariance).unwrap() < 7.815);
        let depth_m = off_m.dot(&bearing);
        let depth_variance = bearing.dot(&(covariance * bearing));
        tally.depth += depth_m * depth_m / depth_variance;
        tally.lateral +=
            (off_m.norm_squared() - depth_m * depth_m) / (covariance.trace() - depth_variance);
    }
    tally
}

#[test]
fn stated_covariances_match_the_detectors_errors() {
    let degrees = |range: std::ops::Range<f64>| range.start.to_radians()..range.end.to_radians();
    for radius_px in [8.0, 12.0, 16.0, 24.0] {
        for tilts in [0.0..10.0, 10.0..30.0, 30.0..55.0] {
            let runs = 60;
            let tally = tally(radius_px, degrees(tilts.clone()), runs);
            let name = format!("{radius_px} px, {tilts:?} degrees: {tally:?}");
            let found = tally.found as f64;
            assert_eq!(tally.found, runs, "{name}");
            assert!(tally.inside as f64 >= 0.9 * found, "{name}");
            // Stated deviations must be right within a factor of two; of the smallest, tilted rings, whose margin counts as
            // narrow, within 2.9.
            assert!((0.12..2.5).contains(&(tally.depth / found)), "{name}");
            assert!((0.1..2.0).contains(&(tally.lateral / found)), "{name}");
        }
    }
}
