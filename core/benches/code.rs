//! Time to read the code of a ring with known rims, and to track a coded roundel:
//! `cargo bench -p roundel-core --bench code`.

#[path = "../tests/drawing/mod.rs"]
mod drawing;

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use drawing::{Drawing, Roundel, ellipse, frame};
use roundel_core::marker::{
    CodeLayout, CodeReader, Detector, Kind, Params, Pattern, Ring, Tracker,
};

const SIDE: usize = 320;

fn coded(c: &mut Criterion) {
    for (bits, diameter_px) in [(8, 36.0), (12, 60.0), (16, 90.0)] {
        let layout = CodeLayout { bits, min_distance: 2 };
        let reader = CodeReader::new(layout, CodeLayout::RATIO).unwrap();
        let teeth = reader.dictionary().teeth(7).unwrap();
        let mut drawing = Drawing::new(SIDE, SIDE, 110.0, 0.7);
        let outer = ellipse((160.3, 159.8), (0.5 * diameter_px, 0.4 * diameter_px), 0.4);
        let roundel = Roundel { outer, ratio: 0.6, margin: 1.28, black: 40.0, white: 200.0 };
        drawing.add_coded(&roundel, 110.0, &teeth);
        let picture = drawing.picture(2.0, 7);
        let frame = frame(&picture, SIDE);
        let ring = Ring { black: 40.0, white: 200.0, ..Ring::of_rims(outer, roundel.inner()) };
        assert_eq!(reader.read(&frame, &ring).unwrap().code.number, 7);
        c.bench_function(&format!("read/{bits} bits at {diameter_px} px"), |b| {
            b.iter(|| reader.read(black_box(&frame), &ring));
        });

        let kind = Kind { pattern: Pattern::Coded(layout), ..Kind::plain("robot", 0.16, 0.096) };
        let params = Params { max_roundels: 1, ..Params::default() };
        let mut tracker = Tracker::new(Detector::new(vec![kind], params).unwrap());
        assert!(tracker.process(&frame)[0].ring.code.is_some());
        c.bench_function(&format!("followed/{bits} bits at {diameter_px} px"), |b| {
            b.iter(|| tracker.process(black_box(&frame)).len());
        });
    }
}

criterion_group!(benches, coded);
criterion_main!(benches);
