//! Time per frame of tracking, of searching a whole frame, and of searching while roundels are tracked:
//! `cargo bench -p roundel-core --bench detect [-- PART OF A NAME]`.
//!
//! Prints minimum, median and 99th percentile. On a shared machine, compare the minimum.

#[path = "../tests/drawing/mod.rs"]
mod drawing;

use std::time::{Duration, Instant};

use drawing::{Drawing, Roundel, ellipse, frame};
use roundel_core::marker::{Detector, Kind, Params, Scratch, Tracker};

const HD: (usize, usize) = (1920, 1080);
const UHD: (usize, usize) = (3840, 2160);
const SMALL: (usize, usize) = (1280, 720);
/// Duration of each measurement.
const DURATION: Duration = Duration::from_millis(1200);

fn detector(max_roundels: usize) -> Detector {
    let kind = Kind::plain("robot", 0.16, 0.064);
    Detector::new(vec![kind], Params { max_roundels, ..Params::default() }).unwrap()
}

/// Roundels of one diameter in a grid, optionally on a background that causes candidates.
fn picture(size: (usize, usize), count: usize, diameter_px: f64, clutter: bool) -> Vec<u8> {
    picture_without(size, (count, 0), diameter_px, clutter)
}

/// The same without the last ones.
fn picture_without(
    (width, height): (usize, usize),
    (count, missing): (usize, usize),
    diameter_px: f64,
    clutter: bool,
) -> Vec<u8> {
    let columns = (count as f64 * 16.0 / 9.0).sqrt().ceil().max(1.0) as usize;
    let rows = count.div_ceil(columns).max(1);
    let place = |index: usize| {
        (
            (0.5 + (index % columns) as f64) * width as f64 / columns as f64 + 0.3,
            (0.5 + (index / columns) as f64) * height as f64 / rows as f64 - 0.2,
        )
    };
    let mut drawing = Drawing::new(width, height, 110.0, 0.7);
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
    for at in (0..count - missing).map(place) {
        let radius = 0.5 * diameter_px;
        let outer = ellipse(at, (radius, 0.9 * radius), 0.4);
        let roundel = Roundel { outer, ratio: 0.4, margin: 1.4, black: 40.0, white: 200.0 };
        drawing.add(&roundel, 110.0);
    }
    drawing.picture(2.0, 7)
}

/// Calls `frame` repeatedly and prints its times.
fn time(name: &str, filter: &Option<String>, mut frame: impl FnMut()) {
    if filter.as_ref().is_some_and(|filter| !name.contains(filter)) {
        return;
    }
    // Short calls are timed in batches.
    let start = Instant::now();
    let mut calls = 0u32;
    while start.elapsed() < DURATION / 10 {
        frame();
        calls += 1;
    }
    let one = start.elapsed() / calls;
    let batch = (2000 / one.as_nanos().max(1)).max(1) as u32;
    let mut times = Vec::new();
    let start = Instant::now();
    while start.elapsed() < DURATION {
        let start_one = Instant::now();
        (0..batch).for_each(|_| frame());
        times.push(start_one.elapsed().as_secs_f64() * 1e6 / f64::from(batch));
    }
    print_times(name, times);
}

fn print_times(name: &str, mut times: Vec<f64>) {
    times.sort_by(f64::total_cmp);
    let share = |share: f64| times[((times.len() - 1) as f64 * share) as usize];
    println!(
        "{name:<58} {:>9.2} {:>9.2} {:>9.2}   us min, median, p99",
        times[0],
        share(0.5),
        share(0.99)
    );
}

/// Tracking without search, since all roundels are tracked.
fn followed(filter: &Option<String>) {
    let sizes = [15.0, 30.0, 60.0, 110.0];
    let cases = sizes.map(|diameter_px| (HD, 1, diameter_px));
    for (size, count, diameter_px) in
        cases.into_iter().chain([(HD, 100, 30.0), (HD, 400, 30.0), (UHD, 400, 30.0)])
    {
        let name = format!("followed/{count} of {diameter_px} px in {}x{}", size.0, size.1);
        if filter.as_ref().is_some_and(|filter| !name.contains(filter)) {
            continue;
        }
        let picture = picture(size, count, diameter_px, false);
        let frame = frame(&picture, size.0);
        let mut tracker = Tracker::new(detector(count));
        let found = tracker.process(&frame).len();
        assert_eq!(found, count, "{:?}", tracker.rejects());
        time(&name, filter, || assert_eq!(tracker.process(&frame).len(), count));
    }
}

/// Tracking with search for further roundels.
fn searched_in_parts(filter: &Option<String>) {
    for (size, count, clutter) in [(HD, 10, true), (HD, 400, false), (UHD, 400, false)] {
        let ground = if clutter { "clutter" } else { "plain" };
        let name = format!("followed and searched/{count} in {ground} {}x{}", size.0, size.1);
        if filter.as_ref().is_some_and(|filter| !name.contains(filter)) {
            continue;
        }
        let picture = picture(size, count, 30.0, clutter);
        let frame = frame(&picture, size.0);
        let mut tracker = Tracker::new(detector(500));
        assert_eq!(tracker.process(&frame).len(), count);
        time(&name, filter, || assert_eq!(tracker.process(&frame).len(), count));
    }
}

/// Frames in which an eleventh roundel is missing and its track is still held.
fn one_missing(filter: &Option<String>) {
    let name = "followed, one missing/10 and 1 in clutter 1920x1080";
    if filter.as_ref().is_some_and(|filter| !name.contains(filter)) {
        return;
    }
    let with = picture(HD, 11, 30.0, true);
    let without = picture_without(HD, (11, 1), 30.0, true);
    let (with, without) = (frame(&with, HD.0), frame(&without, HD.0));
    let detector = detector(400);
    let held = detector.params().coast_frames;
    let mut tracker = Tracker::new(detector);
    let mut times = Vec::new();
    let start = Instant::now();
    while start.elapsed() < DURATION {
        // Until the partial search has found it again.
        while tracker.process(&with).len() < 11 {}
        for _ in 0..held {
            let start_one = Instant::now();
            assert_eq!(tracker.process(&without).len(), 10);
            times.push(start_one.elapsed().as_secs_f64() * 1e6);
        }
    }
    print_times(name, times);
}

fn searched(filter: &Option<String>) {
    for (size, count, clutter) in
        [(SMALL, 0, false), (SMALL, 0, true), (SMALL, 1, true), (SMALL, 100, true), (HD, 100, true)]
    {
        let ground = if clutter { "clutter" } else { "plain" };
        let name = format!("searched/{count} in {ground} {}x{}", size.0, size.1);
        if filter.as_ref().is_some_and(|filter| !name.contains(filter)) {
            continue;
        }
        let picture = picture(size, count, 30.0, clutter);
        let frame = frame(&picture, size.0);
        let detector = detector(400);
        let mut scratch = Scratch::default();
        assert_eq!(detector.detect(&frame, &mut scratch).len(), count);
        time(&name, filter, || assert_eq!(detector.detect(&frame, &mut scratch).len(), count));
    }
}

fn main() {
    let filter = std::env::args().skip(1).find(|argument| !argument.starts_with('-'));
    followed(&filter);
    searched_in_parts(&filter);
    one_missing(&filter);
    searched(&filter);
}
