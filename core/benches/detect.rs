//! Times of detection: one roundel followed, a whole frame searched, and the search that goes on
//! while roundels are followed. `cargo bench -p roundel-core --bench detect`.

#[path = "../tests/drawing/mod.rs"]
mod drawing;

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use drawing::{Drawing, Roundel, ellipse, frame};
use roundel_core::marker::{Detector, Kind, Params, Scratch, Tracker};

const WIDTH: usize = 1280;
const HEIGHT: usize = 720;

fn detector(max_roundels: usize) -> Detector {
    let kind = Kind::plain("robot", 0.16, 0.064);
    Detector::new(vec![kind], Params { max_roundels, ..Params::default() }).unwrap()
}

/// Roundels of one diameter in a grid over the frame, with a background of squares and stripes that
/// makes candidates.
fn picture(count: usize, diameter_px: f64, clutter: bool) -> Vec<u8> {
    let columns = (count as f64 * 16.0 / 9.0).sqrt().ceil().max(1.0) as usize;
    let rows = count.div_ceil(columns).max(1);
    let place = |index: usize| {
        (
            (0.5 + (index % columns) as f64) * WIDTH as f64 / columns as f64 + 0.3,
            (0.5 + (index / columns) as f64) * HEIGHT as f64 / rows as f64 - 0.2,
        )
    };
    let mut drawing = Drawing::new(WIDTH, HEIGHT, 110.0, 0.7);
    if clutter {
        drawing.stripe(|u, v| {
            let free = |(x, y): (f64, f64)| (x - u as f64).hypot(y - v as f64) > diameter_px;
            if !(0..count).map(place).all(free) {
                return 0.0;
            }
            let checks = if (u / 40 + v / 28) % 2 == 0 { 35.0 } else { 0.0 };
            let text =
                if v % 60 < 9 && (u * 7919 + v / 3 * 104_729) % 13 < 5 { -60.0 } else { 0.0 };
            checks + text
        });
    }
    for at in (0..count).map(place) {
        let radius = 0.5 * diameter_px;
        let outer = ellipse(at, (radius, 0.9 * radius), 0.4);
        let roundel = Roundel { outer, ratio: 0.4, margin: 1.4, black: 40.0, white: 200.0 };
        drawing.add(&roundel, 110.0);
    }
    drawing.picture(2.0, 7)
}

fn followed(c: &mut Criterion) {
    for (count, diameter_px) in [(1, 15.0), (1, 30.0), (1, 60.0), (1, 110.0), (100, 30.0)] {
        let picture = picture(count, diameter_px, false);
        let frame = frame(&picture, WIDTH);
        // As many as are there: nothing further is searched for.
        let mut tracker = Tracker::new(detector(count));
        assert_eq!(tracker.process(&frame).len(), count);
        c.bench_function(&format!("followed/{count} of {diameter_px} px"), |b| {
            b.iter(|| tracker.process(black_box(&frame)).len());
        });
    }
}

fn searched(c: &mut Criterion) {
    for (count, clutter) in [(0, false), (0, true), (1, true), (100, true)] {
        let picture = picture(count, 30.0, clutter);
        let frame = frame(&picture, WIDTH);
        let detector = detector(400);
        let mut scratch = Scratch::default();
        assert_eq!(detector.detect(&frame, &mut scratch).len(), count);
        let name = if clutter { "clutter" } else { "plain" };
        c.bench_function(&format!("searched 1280x720/{count} in {name}"), |b| {
            b.iter(|| detector.detect(black_box(&frame), &mut scratch).len());
        });
    }
}

fn searched_in_parts(c: &mut Criterion) {
    let picture = picture(10, 30.0, true);
    let frame = frame(&picture, WIDTH);
    let mut tracker = Tracker::new(detector(400));
    assert_eq!(tracker.process(&frame).len(), 10);
    c.bench_function("searched in parts 1280x720/10 followed in clutter", |b| {
        b.iter(|| tracker.process(black_box(&frame)).len());
    });
}

criterion_group!(benches, followed, searched, searched_in_parts);
criterion_main!(benches);
