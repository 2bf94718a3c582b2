//! Time of the photometric fit of plain, elliptical and coded roundels by size, from a tracker's initial pose:
//! `cargo bench -p roundel-core --bench fit`.

#[path = "../tests/drawing/mod.rs"]
mod drawing;

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use drawing::{Drawing, frame, projected};
use nalgebra::{Vector2, Vector3};
use roundel_core::{
    camera::{Camera, Intrinsics, Lens, PixelPoint},
    marker::{CodeLayout, CodeReader, Kind, Pattern, Ring, Tooth},
    pose::{
        PrintDeviation, RimNoise, locate,
        photometry::{FitInput, FitScratch, Start, fit},
    },
    rigid::orientation_of_normal,
};

const SIDE: usize = 240;

fn camera(focal_px: f64) -> Camera {
    Camera::new(Intrinsics {
        width: SIDE,
        height: SIDE,
        fx_px: focal_px,
        fy_px: focal_px,
        cx_px: 119.5,
        cy_px: 119.5,
        lens: Lens::PlumbBob([-0.08, 0.02, 0.0003, -0.0004, 0.0]),
    })
    .expect("the intrinsics above are valid")
}

/// Share of black in a pixel of a coded print with yaw 0, for a blur of 0.7 px.
fn black_share(
    camera: &Camera,
    (position_m, normal): (&Vector3<f64>, &Vector3<f64>),
    teeth: &[Tooth],
    (u, v): (usize, usize),
) -> f64 {
    const FINE: usize = 24;
    let turn = orientation_of_normal(normal);
    let is_black = |u: f64, v: f64| {
        let ray = camera.bearing(PixelPoint { u, v }).expect("a pixel of the picture");
        let on_plane = ray * (normal.dot(position_m) / normal.dot(&ray)) - position_m;
        let place = turn.inverse() * on_plane / 0.08;
        let angle_rad = place.y.atan2(place.x).rem_euclid(std::f64::consts::TAU);
        let in_tooth = teeth.iter().any(|t| t.from_rad <= angle_rad && angle_rad < t.to_rad);
        let white = 0.6 * if in_tooth { CodeLayout::CORE_SHARE } else { 1.0 };
        (white..1.0).contains(&place.norm())
    };
    let away = |k: usize| 5.0 * ((k as f64 + 0.5) / FINE as f64 - 0.5);
    // Variance of the blur and the pixel.
    let weight = |x: f64| (-0.5 * x * x / (0.49 + 1.0 / 12.0)).exp();
    let (mut black, mut all) = (0.0, 0.0);
    for k in 0..FINE * FINE {
        let (x, y) = (away(k % FINE), away(k / FINE));
        let weight = weight(x) * weight(y);
        all += weight;
        if is_black(u as f64 + x, v as f64 + y) {
            black += weight;
        }
    }
    black / all
}

fn coded_fits(criterion: &mut Criterion) {
    let camera = camera(1100.0);
    for (bits, diameter_px) in [(8, 36.0), (8, 60.0), (12, 60.0)] {
        let layout = CodeLayout { bits, min_distance: 2 };
        let kind = Kind { pattern: Pattern::Coded(layout), ..Kind::plain("robot", 0.16, 0.096) };
        let position_m = Vector3::new(-0.001, 0.002, 1.0) * (0.16 * 1100.0 / diameter_px);
        let normal = Vector3::new(0.5, -0.33, -0.8).normalize();
        let [outer, inner] =
            [0.08, 0.048].map(|m| projected::ellipse(&camera, &position_m, &normal, [m; 2]));
        let reader = CodeReader::new(layout, CodeLayout::RATIO).expect("a layout");
        let teeth = reader.dictionary().teeth(7).expect("an identity");
        let mut drawing = Drawing::new(SIDE, SIDE, 200.0, 0.7);
        drawing.stripe(|u, v| {
            let near_px = (u as f64 - outer.center.u).hypot(v as f64 - outer.center.v);
            let is_near = near_px < 0.5 * diameter_px + 4.0;
            if is_near {
                -160.0 * black_share(&camera, (&position_m, &normal), &teeth, (u, v))
            } else {
                0.0
            }
        });
        let pixels = drawing.picture(2.0, 7);
        let frame = frame(&pixels, SIDE);
        let ring = Ring { black: 40.0, white: 200.0, ..Ring::of_rims(outer, inner) };
        let ring = Ring { code: reader.read(&frame, &ring), ..ring };
        let mut pose = locate(&camera, &kind, &ring, &RimNoise::default()).expect("its rims");
        if pose.other_normal.dot(&normal) > pose.normal.dot(&normal) {
            pose.normal = pose.other_normal;
        }
        let mut scratch = FitScratch::default();
        let mut start = Start {
            pose,
            blur_px: 0.7,
            motion_px: Vector2::zeros(),
            moved_px: 1.0,
            is_still: true,
            teeth: None,
        };
        let input = FitInput {
            frame: &frame,
            camera: &camera,
            kind: &kind,
            ring: &ring,
            print: PrintDeviation::NONE,
            skew: None,
        };
        let first = fit(&input, &start, &mut scratch).expect("it is drawn");
        start.blur_px = first.blur_px;
        criterion.bench_function(&format!("fit/coded {bits} bits {diameter_px} px"), |bencher| {
            bencher.iter(|| fit(&input, black_box(&start), &mut scratch));
        });
    }
}

fn fits(criterion: &mut Criterion) {
    let plain = Kind::plain("robot", 0.16, 0.064);
    let pattern = Pattern::Elliptical { minor_diameter_m: 0.064 };
    let elliptical = Kind { pattern, ..Kind::plain("robot", 0.16, 0.096) };
    let camera = camera(1100.0);
    let sizes = [15.0, 30.0, 60.0, 110.0].map(|diameter_px| ("", &plain, diameter_px));
    let others = [30.0, 60.0].map(|diameter_px| ("elliptical ", &elliptical, diameter_px));
    for (name, kind, diameter_px) in sizes.into_iter().chain(others) {
        let (outer_m, inner_m) = (0.5 * kind.outer_diameter_m, 0.5 * kind.inner_diameter_m);
        let minor_m = match kind.pattern {
            Pattern::Elliptical { minor_diameter_m } => 0.5 * minor_diameter_m,
            _ => inner_m,
        };
        let position_m = Vector3::new(-0.001, 0.002, 1.0) * (2.0 * outer_m * 1100.0 / diameter_px);
        let normal = Vector3::new(0.5, -0.33, -0.8).normalize();
        let [outer, inner] = [[outer_m; 2], [inner_m, minor_m]]
            .map(|m| projected::ellipse(&camera, &position_m, &normal, m));
        let mut drawing = Drawing::new(SIDE, SIDE, 200.0, 0.7);
        drawing.add_disc(&outer, -160.0);
        drawing.add_disc(&inner, 160.0);
        let pixels = drawing.picture(2.0, 7);
        let frame = frame(&pixels, SIDE);
        let ring = Ring { black: 40.0, white: 200.0, ..Ring::of_rims(outer, inner) };
        let mut pose = locate(&camera, kind, &ring, &RimNoise::default()).expect("its rims");
        // A tracker has resolved the ambiguity.
        if pose.other_normal.dot(&normal) > pose.normal.dot(&normal) {
            pose.normal = pose.other_normal;
        }
        let mut scratch = FitScratch::default();
        let mut start = Start {
            pose,
            blur_px: 0.7,
            motion_px: Vector2::zeros(),
            moved_px: 1.0,
            is_still: true,
            teeth: None,
        };
        let input = FitInput {
            frame: &frame,
            camera: &camera,
            kind,
            ring: &ring,
            print: PrintDeviation::NONE,
            skew: None,
        };
        let first = fit(&input, &start, &mut scratch).expect("it is drawn");
        (start.blur_px, start.motion_px) = (first.blur_px, first.motion_px);
        criterion.bench_function(&format!("fit/{name}{diameter_px} px"), |bencher| {
            bencher.iter(|| fit(&input, black_box(&start), &mut scratch));
        });
    }
}

criterion_group!(benches, fits, coded_fits);
criterion_main!(benches);
