//! Time of a pose and of the lens models: `cargo bench -p roundel-core --bench pose`.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::Vector3;
use roundel_core::{
    camera::{Camera, Intrinsics, Lens, PixelPoint},
    ellipse::Ellipse,
    marker::{Kind, Ring},
    pose::{RimNoise, locate},
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

fn lens(criterion: &mut Criterion) {
    for (name, camera) in cameras() {
        let points: Vec<_> = (0..64)
            .map(|k| Vector3::new(0.02 * k as f64 - 0.6, 0.01 * (k % 7) as f64, 1.7))
            .collect();
        let pixels: Vec<PixelPoint> =
            points.iter().map(|p| camera.project(p).expect("in front of the camera")).collect();
        criterion.bench_function(&format!("project 64 points, {name}"), |bencher| {
            bencher.iter(|| {
                points
                    .iter()
                    .filter_map(|p| camera.project(black_box(p)).ok())
                    .map(|p| p.u)
                    .sum::<f64>()
            });
        });
        criterion.bench_function(&format!("undistort 64 points, {name}"), |bencher| {
            bencher.iter(|| {
                pixels
                    .iter()
                    .filter_map(|p| camera.undistort(black_box(*p)).ok())
                    .map(|p| p.x)
                    .sum::<f64>()
            });
        });
    }
}

fn pose(criterion: &mut Criterion) {
    let kind = Kind::plain("robot", 0.16, 0.064);
    // A ring of 30 px, tilted by 40°, with rims off by a few hundredths of a pixel.
    let rim = |scale: f64, off_px: f64| Ellipse {
        center: PixelPoint { u: 1300.2 + off_px, v: 702.6 - off_px },
        semi_major_px: 15.0 * scale + off_px,
        semi_minor_px: 11.5 * scale - off_px,
        angle_rad: 0.4,
    };
    let ring = Ring::of_rims(rim(1.0, 0.02), rim(0.4, -0.03));
    let noise = RimNoise::default();
    for (name, camera) in cameras() {
        criterion.bench_function(&format!("locate, {name}"), |bencher| {
            bencher.iter(|| locate(&camera, &kind, black_box(&ring), &noise));
        });
    }
}

criterion_group!(benches, lens, pose);
criterion_main!(benches);
