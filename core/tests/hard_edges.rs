//! Rings without blur: pixels sampled at their centres, and pixels repeated to enlarge a picture.

use crate::drawing::{Drawing, Roundel, ellipse, frame};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use roundel_core::{
    camera::PixelPoint,
    ellipse::Ellipse,
    marker::{Detector, Kind, Params, Tracker},
};

const SIDE: usize = 240;
const CASES: u64 = 100;
/// The first picture is searched, in the others the ring is followed.
const PICTURES: u32 = 4;
const MOTION_PX: f64 = 1.7;
const RATIO: f64 = 0.4;
const MARGIN: f64 = 1.4;

/// The outer rim in a picture.
fn rim(diameters_px: (f64, f64), seed: u64, picture: u32) -> Ellipse {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let radius_px = 0.5 * random.random_range(diameters_px.0..diameters_px.1);
    let flat = random.random_range(0.75..1.0);
    let moved_px = MOTION_PX * f64::from(picture);
    let at = (118.3 + random.random_range(0.0..1.0) + moved_px, 119.1 - 0.4 * moved_px);
    ellipse(at, (radius_px / flat, radius_px), random.random_range(-1.5..1.5))
}

/// Each pixel has the level at its centre.
fn sampled(rim: &Ellipse) -> Vec<u8> {
    let scaled = |by: f64| Ellipse {
        semi_major_px: by * rim.semi_major_px,
        semi_minor_px: by * rim.semi_minor_px,
        ..*rim
    };
    let areas = [(scaled(MARGIN), 230), (scaled(1.0), 20), (scaled(RATIO), 230)];
    let level = |at: usize| {
        let point = PixelPoint { u: (at % SIDE) as f64, v: (at / SIDE) as f64 };
        let inside = areas.iter().rfind(|(area, _)| area.contains(point));
        inside.map_or(110, |(_, level)| *level)
    };
    (0..SIDE * SIDE).map(level).collect()
}

/// A picture of half the size, each pixel doubled.
fn enlarged(rim: &Ellipse, seed: u64) -> Vec<u8> {
    let half = |px: f64| 0.5 * px;
    let small = Ellipse {
        center: PixelPoint { u: half(rim.center.u - 0.5), v: half(rim.center.v - 0.5) },
        semi_major_px: half(rim.semi_major_px),
        semi_minor_px: half(rim.semi_minor_px),
        ..*rim
    };
    let mut drawing = Drawing::new(SIDE / 2, SIDE / 2, 110.0, 0.7);
    let roundel = Roundel { outer: small, ratio: RATIO, margin: MARGIN, black: 30.0, white: 220.0 };
    drawing.add(&roundel, 110.0);
    let picture = drawing.picture(1.0, seed);
    (0..SIDE * SIDE).map(|at| picture[at / SIDE / 2 * (SIDE / 2) + at % SIDE / 2]).collect()
}

fn check(diameters_px: (f64, f64), picture: impl Fn(&Ellipse, u64) -> Vec<u8>) {
    for kinds in [vec![], vec![Kind::plain("robot", 0.16, 0.16 * RATIO)]] {
        let (mut missed, mut squares_px2, mut worst_px) = (0, 0.0, 0.0f64);
        for seed in 0..CASES {
            let mut tracker =
                Tracker::new(Detector::new(kinds.clone(), Params::default()).unwrap());
            for number in 0..PICTURES {
                let rim = rim(diameters_px, seed, number);
                let pixels = picture(&rim, seed * 10 + u64::from(number));
                let frame = frame(&pixels, SIDE);
                let tracked = tracker.process(&frame).to_vec();
                let [one] = tracked[..] else {
                    let rejects: Vec<_> =
                        tracker.rejects().iter().filter(|(_, count)| *count > 0).collect();
                    println!("missed in picture {number}: {rim:?} {tracked:?} {rejects:?}");
                    missed += 1;
                    continue;
                };
                let (from, to) = (rim.center, one.ring.outer.center);
                let off_px = (from.u - to.u).hypot(from.v - to.v)
                    + (one.ring.outer.mean_radius_px() - rim.mean_radius_px()).abs();
                squares_px2 += off_px * off_px;
                worst_px = worst_px.max(off_px);
                if one.track.0 != 1 {
                    println!("lost in picture {number}: {rim:?}");
                    missed += 1;
                }
            }
        }
        let rms_px = (squares_px2 / (CASES * u64::from(PICTURES)) as f64).sqrt();
        println!(
            "{diameters_px:?}, {} kinds: {missed} missed, {rms_px:.3} px rms, {worst_px:.2} px",
            kinds.len()
        );
        assert_eq!(missed, 0);
        assert!(worst_px < 0.6, "{worst_px}");
    }
}

#[test]
fn rings_sampled_at_pixel_centres_are_found_and_followed() {
    check((20.0, 40.0), |rim, _| sampled(rim));
    check((40.0, 130.0), |rim, _| sampled(rim));
}

#[test]
fn rings_with_doubled_pixels_are_found_and_followed() {
    check((30.0, 60.0), enlarged);
    check((60.0, 130.0), enlarged);
}
