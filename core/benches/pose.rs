//! Time of a pose and of the lens models: `cargo bench -p roundel-core --bench pose`.
//!
//! Prints the minimum of many repetitions, since other load only increases times.

use std::{hint::black_box, time::Instant};

use nalgebra::Vector3;
use roundel_core::{
    camera::{Camera, Intrinsics, Lens, PixelPoint},
    ellipse::Ellipse,
    frame::Frame,
    id::{KindId, TrackNumber},
    marker::{Kind, Mode, Ring, TrackedRing},
    pose::{Locator, RimNoise, locate},
};

fn cameras() -> [(&'static str, Camera); 3] {
    let lenses = [
        Lens::PlumbBob([-0.08, 0.02, 0.0003, -0.0004, 0.0]),
        Lens::Rational([8.1, 5.2, 0.0004, -0.0002, 0.21, 8.4, 8.0, 1.3]),
        Lens::Equidistant([-0.02, 0.011, -0.007, 0.0013]),
    ];
    lenses.map(|lens| {
        let intrinsics = Intrinsics {
            width: 1920,
            height: 1080,
            fx_px: 1100.0,
            fy_px: 1100.0,
            cx_px: 959.5,
            cy_px: 539.5,
            lens,
        };
        (lens.name(), Camera::new(intrinsics).expect("the intrinsics above are valid"))
    })
}

/// Calls per repetition.
const CALLS: u32 = 200;
/// Number of repetitions.
const REPETITIONS: usize = 1000;

fn min_us(mut call: impl FnMut()) -> f64 {
    let repetition = |_| {
        let start = Instant::now();
        for _ in 0..CALLS {
            call();
        }
        start.elapsed().as_secs_f64()
    };
    let min_s = (0..REPETITIONS).map(repetition).fold(f64::INFINITY, f64::min);
    1e6 * min_s / f64::from(CALLS)
}

fn lens() {
    for (name, camera) in cameras() {
        let point = Vector3::new(0.35, 0.1, 1.7);
        let pixel = camera.project(&point).expect("in front of the camera");
        let project = min_us(|| {
            let _ = black_box(camera.project(black_box(&point)));
        });
        let undistort = min_us(|| {
            let _ = black_box(camera.undistort(black_box(pixel)));
        });
        println!("project a point, {name}: {project:.3} µs; undistort one: {undistort:.3} µs");
    }
}

/// Rings of a frame that are located together.
const RINGS: usize = 64;

/// Rings of 30 px with rim errors of a few hundredths of a pixel.
fn pose() {
    let kind = Kind::plain("robot", 0.16, 0.064);
    let noise = RimNoise::default();
    for (tilt, minor) in [("tilted by 40°", 11.5), ("face-on", 14.96)] {
        let rim = |scale: f64, off_px: f64| Ellipse {
            center: PixelPoint { u: 1300.2 + off_px, v: 702.6 - off_px },
            semi_major_px: 15.0 * scale + off_px,
            semi_minor_px: minor * scale - off_px,
            angle_rad: 0.4,
        };
        let ring = Ring::of_rims(rim(1.0, 0.01), rim(0.4, 0.005));
        for (name, camera) in cameras() {
            let time_us = min_us(|| {
                let _ = black_box(locate(&camera, &kind, black_box(&ring), &noise));
            });
            let all_us = min_all_us(camera, &kind, &ring) / RINGS as f64;
            println!(
                "pose of a ring of 30 px {tilt}, {name}: alone {time_us:.3} µs, \
                 one of {RINGS} {all_us:.3} µs"
            );
        }
    }
}

fn min_all_us(camera: Camera, kind: &Kind, ring: &Ring) -> f64 {
    let ring = Ring { kind: Some(KindId(0)), ..*ring };
    let rings: Vec<_> = (0..RINGS as u64)
        .map(|number| TrackedRing { track: TrackNumber(number), ring, code: None })
        .collect();
    let pixels = [0; 4];
    let frame = Frame::new(&pixels, 2, 2, 2).expect("as many pixels as it says");
    let mut locator = Locator::new(camera, vec![kind.clone()], Mode::Fast);
    let mut located = Vec::new();
    min_us(|| {
        locator.locate_all(&frame, black_box(&rings), &mut located);
        black_box(&located);
    })
}

fn main() {
    lens();
    pose();
}
