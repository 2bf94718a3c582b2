//! Time to search a frame: rendered roundels on plain and cluttered backgrounds, and photographs if
//! `../shared/data/real` exists.
//! `cargo bench -p roundel-core --bench search`.

#[path = "../tests/drawing/mod.rs"]
mod drawing;
#[path = "../tests/picture/mod.rs"]
mod picture;

use std::{hint::black_box, path::Path};

use criterion::{Criterion, criterion_group, criterion_main};
use drawing::{Drawing, Roundel, ellipse, frame};
use picture::Picture;
use roundel_core::marker::{Detector, Kind, Mode, Params, Scratch};

const DIAMETER_PX: f64 = 30.0;

fn detector(kinds: Vec<Kind>) -> Detector {
    let params = Params { mode: Mode::Fast, max_roundels: 1000, ..Params::default() };
    Detector::new(kinds, params).unwrap()
}

/// Roundels in a grid, optionally with squares and stripes like small print between them.
fn scene((width, height): (usize, usize), count: usize, clutter: bool) -> Vec<u8> {
    let columns = (count as f64 * 16.0 / 9.0).sqrt().ceil().max(1.0) as usize;
    let rows = count.div_ceil(columns).max(1);
    let (cell_u, cell_v) = (width as f64 / columns as f64, height as f64 / rows as f64);
    let place = |column: usize, row: usize| {
        ((column as f64 + 0.5) * cell_u + 0.3, (row as f64 + 0.5) * cell_v - 0.2)
    };
    let mut drawing = Drawing::new(width, height, 110.0, 0.7);
    if clutter {
        drawing.stripe(|u, v| {
            let (column, row) = ((u as f64 / cell_u) as usize, (v as f64 / cell_v) as usize);
            let at = place(column.min(columns - 1), row.min(rows - 1));
            if count > 0 && (at.0 - u as f64).hypot(at.1 - v as f64) <= DIAMETER_PX {
                return 0.0;
            }
            let squares = if (u / 40 + v / 28) % 2 == 0 { 35.0 } else { 0.0 };
            let print =
                if v % 60 < 9 && (u * 7919 + v / 3 * 104_729) % 13 < 5 { -60.0 } else { 0.0 };
            squares + print
        });
    }
    for index in 0..count {
        let radius = 0.5 * DIAMETER_PX;
        let outer = ellipse(place(index % columns, index / columns), (radius, 0.9 * radius), 0.4);
        let roundel = Roundel { outer, ratio: 0.4, margin: 1.4, black: 40.0, white: 200.0 };
        drawing.add(&roundel, 110.0);
    }
    drawing.picture(2.0, 7)
}

fn drawn(c: &mut Criterion) {
    let detector = detector(vec![Kind::plain("robot", 0.16, 0.064)]);
    let mut scratch = Scratch::default();
    let (full_hd, ultra_hd) = ((1920, 1080), (3840, 2160));
    for (size, count, clutter) in [
        (full_hd, 0, false),
        (full_hd, 100, false),
        (full_hd, 400, false),
        (full_hd, 0, true),
        (full_hd, 100, true),
        (full_hd, 400, true),
        (ultra_hd, 100, false),
        (ultra_hd, 100, true),
    ] {
        let picture = scene(size, count, clutter);
        let frame = frame(&picture, size.0);
        assert_eq!(detector.detect(&frame, &mut scratch).len(), count);
        let where_to = if clutter { "clutter" } else { "plain" };
        c.bench_function(&format!("searched {}x{}/{count} in {where_to}", size.0, size.1), |b| {
            b.iter(|| detector.detect(black_box(&frame), &mut scratch).len());
        });
    }
}

fn photographs(c: &mut Criterion) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/real");
    let detector = detector(Vec::new());
    let mut scratch = Scratch::default();
    for name in [
        "negatives/vf_squareC1.jpeg",
        "negatives/vf_squareC4.jpeg",
        "negatives/vf_square_G2.jpeg",
        "negatives/vf_square_G3.jpeg",
        "whycon/many_gray.png",
    ] {
        let path = folder.join(name);
        if !path.is_file() {
            println!("skipped: {name} needs ../shared");
            continue;
        }
        let picture = Picture::read(&path);
        let frame = picture.frame();
        c.bench_function(&format!("searched {}x{}/{name}", frame.width(), frame.height()), |b| {
            b.iter(|| detector.detect(black_box(&frame), &mut scratch).len());
        });
    }
}

criterion_group!(benches, drawn, photographs);
criterion_main!(benches);
