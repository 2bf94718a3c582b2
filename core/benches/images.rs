//! Detections in image files and their time on one thread, for the comparison with other libraries in
//! `tests/compare/run`.
//!
//! `cargo bench -p roundel-core --bench images -- FOCAL_PX OUTER_MM INNER_MM REPETITIONS FILE.pgm…`
//!
//! The camera is a pinhole with its principal point in the middle. Prints one line of JSON for each image and mode, with
//! the minimum time of a search and of tracking the same frame, both with poses.

use std::{env, fs, time::Instant};

use roundel_core::{
    camera::{Camera, Intrinsics, Lens},
    frame::Frame,
    marker::{Detector, Kind, Mode, Params, Scratch, Tracker},
    pose::Locator,
};
use serde_json::json;

struct Picture {
    pixels: Vec<u8>,
    width: usize,
    height: usize,
}

impl Picture {
    /// A binary PGM without comments, as `scenes` and OpenCV write it.
    fn read(path: &str) -> Self {
        let bytes = fs::read(path).unwrap_or_else(|error| panic!("{path}: {error}"));
        let mut fields = bytes.splitn(4, u8::is_ascii_whitespace);
        let mut field = || fields.next().unwrap_or_default();
        assert_eq!(field(), b"P5", "{path}: expected a binary PGM");
        let number = |text: &[u8]| str::from_utf8(text).ok().and_then(|text| text.parse().ok());
        let (width, height): (Option<usize>, Option<usize>) = (number(field()), number(field()));
        let (width, height) = width.zip(height).unwrap_or_else(|| panic!("{path}: no size"));
        let pixels = bytes[bytes.len() - width * height..].to_vec();
        Self { pixels, width, height }
    }
}

/// Minimum time of `repetitions` runs, microseconds.
fn min_us(repetitions: usize, mut run: impl FnMut()) -> f64 {
    let timed = |_| {
        let start = Instant::now();
        run();
        start.elapsed().as_secs_f64() * 1e6
    };
    (0..repetitions.max(1)).map(timed).fold(f64::MAX, f64::min)
}

fn measure(path: &str, mode: Mode, numbers: &[f64; 4]) {
    let [focal_px, outer_mm, inner_mm, repetitions] = *numbers;
    let picture = Picture::read(path);
    let (width, height) = (picture.width, picture.height);
    let frame = Frame::new(&picture.pixels, width, height, width).expect("an image");
    let kinds = vec![Kind::plain("shown", outer_mm * 1e-3, inner_mm * 1e-3)];
    let camera = Camera::new(Intrinsics {
        width,
        height,
        fx_px: focal_px,
        fy_px: focal_px,
        cx_px: (width as f64 - 1.0) / 2.0,
        cy_px: (height as f64 - 1.0) / 2.0,
        lens: Lens::PlumbBob([0.0; 5]),
    })
    .expect("a camera");
    let mut locator = Locator::new(camera, kinds.clone(), mode);

    let params = Params { mode, max_roundels: 1000, ..Params::default() };
    let detector = Detector::new(kinds.clone(), params.clone()).expect("a print");
    let mut scratch = Scratch::default();
    let mut found = Vec::new();
    let first_us = min_us(repetitions as usize, || {
        found.clear();
        for ring in detector.detect(&frame, &mut scratch) {
            found.extend(locator.locate_single(&frame, &kinds[0], ring).ok());
        }
    });
    // Limited to the roundels present, so that nothing is searched.
    let params = Params { max_roundels: found.len(), ..params };
    let mut tracker = Tracker::new(Detector::new(kinds, params).expect("a print"));
    let mut located = Vec::new();
    let tracked_us = min_us(repetitions as usize, || {
        // Includes the time of rings without a pose.
        locator.locate_all(&frame, tracker.process(&frame), &mut located);
    });
    let as_json = |located: &roundel_core::pose::Located| {
        let (center, p) = (located.ring.outer.center, located.pose.position_m);
        json!({ "center_px": [center.u, center.v], "position_m": [p.x, p.y, p.z] })
    };
    let found: Vec<_> = found.iter().map(as_json).collect();
    println!(
        "{}",
        json!({ "image": path, "mode": format!("{mode:?}").to_lowercase(), "first_us": first_us,
                "tracked_us": tracked_us, "found": found })
    );
}

fn main() {
    let arguments: Vec<String> = env::args().skip(1).filter(|text| text != "--bench").collect();
    let numbers: Vec<f64> = arguments.iter().map_while(|text| text.parse().ok()).collect();
    let Ok(numbers) = <[f64; 4]>::try_from(numbers) else {
        println!("images: FOCAL_PX OUTER_MM INNER_MM REPETITIONS FILE.pgm…");
        return;
    };
    for path in &arguments[4..] {
        for mode in [Mode::Fast, Mode::Precise] {
            measure(path, mode, &numbers);
        }
    }
}
