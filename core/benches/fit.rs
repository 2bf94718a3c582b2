//! Time of the photometric fit by size of the roundel, from a start as a tracker has it:
//! `cargo bench -p roundel-core --bench fit`.

#[path = "../tests/drawing/mod.rs"]
mod drawing;

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use drawing::{Drawing, Roundel, ellipse, frame};
use roundel_core::{
    camera::{Camera, Intrinsics, Lens},
    marker::{Kind, Ring},
    pose::{
        RimNoise, locate,
        photometry::{FitScratch, Start, fit},
    },
};

const SIDE: usize = 240;

fn fits(criterion: &mut Criterion) {
    let kind = Kind::plain("robot", 0.16, 0.064);
    let camera = Camera::new(Intrinsics {
        width: SIDE,
        height: SIDE,
        fx_px: 1100.0,
        fy_px: 1100.0,
        cx_px: 119.5,
        cy_px: 119.5,
        lens: Lens::PlumbBob([-0.08, 0.02, 0.0003, -0.0004, 0.0]),
    })
    .expect("the intrinsics above are valid");
    for diameter_px in [15.0, 30.0, 60.0, 110.0] {
        let radius = 0.5 * diameter_px;
        let outer = ellipse((118.3, 121.4), (radius, 0.8 * radius), 0.4);
        let mut drawing = Drawing::new(SIDE, SIDE, 110.0, 0.7);
        drawing.add(&Roundel { outer, ratio: 0.4, margin: 1.6, black: 40.0, white: 200.0 }, 110.0);
        let pixels = drawing.picture(2.0, 7);
        let frame = frame(&pixels, SIDE);
        let inner = ellipse((118.3, 121.4), (0.4 * radius, 0.32 * radius), 0.4);
        let ring = Ring { black: 40.0, white: 200.0, ..Ring::of_rims(outer, inner) };
        let pose = locate(&camera, &kind, &ring, &RimNoise::default()).expect("a roundel's rims");
        let mut scratch = FitScratch::default();
        let mut start = Start { pose, blur_px: 0.7 };
        let first = fit(&frame, &camera, &kind, &ring, &start, &mut scratch).expect("it is drawn");
        start.blur_px = first.blur_px;
        criterion.bench_function(&format!("fit/{diameter_px} px"), |bencher| {
            bencher.iter(|| fit(&frame, &camera, &kind, &ring, black_box(&start), &mut scratch));
        });
    }
}

criterion_group!(benches, fits);
criterion_main!(benches);
