//! A warm detector, tracker and locator allocate nothing per frame.

mod drawing;

use drawing::{Drawing, Roundel, SIDE, ellipse, frame};
use roundel_core::{
    camera::{Camera, Intrinsics, Lens},
    id::TrackNumber,
    marker::{
        Code, CodeLayout, Detector, Kind, Mode, Params, Pattern, Scratch, TrackedRing, Tracker,
    },
    pose::{Located, Locator},
};

/// Nine roundels that move, one of them missing in every third frame.
fn picture(frame: u32) -> Vec<u8> {
    drawing::nine(f64::from(frame), Some(frame % 3 * 4), frame.into())
}

#[test]
fn a_warm_detector_allocates_nothing() {
    let detector = Detector::new(Vec::new(), Params::default()).unwrap();
    let pictures: Vec<Vec<u8>> = (0..6).map(picture).collect();
    let mut scratch = Scratch::default();
    for picture in &pictures {
        assert_eq!(detector.detect(&frame(picture, SIDE), &mut scratch).len(), 8);
    }
    let spent = allocation_counter::measure(|| {
        for picture in &pictures {
            detector.detect(&frame(picture, SIDE), &mut scratch);
        }
    });
    assert_eq!(spent.count_total, 0);
}

#[test]
fn a_warm_tracker_allocates_nothing() {
    let detector = Detector::new(Vec::new(), Params::default()).unwrap();
    let pictures: Vec<Vec<u8>> = (0..12).map(picture).collect();
    let mut tracker = Tracker::new(detector);
    for picture in &pictures {
        tracker.process(&frame(picture, SIDE));
    }
    let spent = allocation_counter::measure(|| {
        for picture in pictures.iter().rev() {
            tracker.process(&frame(picture, SIDE));
        }
    });
    assert_eq!(spent.count_total, 0);
    assert_eq!(tracker.process(&frame(&pictures[0], SIDE)).len(), 8);
}

#[test]
fn rings_that_appear_late_allocate_nothing() {
    let roundel = |at, axes, ratio| Roundel {
        outer: ellipse(at, axes, 0.3),
        ratio,
        margin: 1.1,
        black: 40.0,
        white: 200.0,
    };
    let drawn = |late: &[Roundel], stripes: bool| {
        let mut drawing = Drawing::new(SIDE, SIDE, 90.0, 0.7);
        if stripes {
            drawing.stripe(|u, v| if v >= 260 && u % 8 < 4 { 100.0 } else { 0.0 });
        }
        drawing.add(&roundel((24.0, 24.0), (9.0, 8.0), 0.5), 90.0);
        late.iter().for_each(|late| drawing.add(late, 90.0));
        drawing.picture(2.0, 1)
    };
    let first = drawn(&[], false);
    // Larger than any before, with a thinner ring, and rows with more edges.
    let large = drawn(&[roundel((155.0, 150.0), (104.0, 90.0), 0.5)], false);
    let thin = drawn(&[roundel((150.0, 150.0), (13.0, 13.0), 0.78)], true);
    let params = Params { search_frames: 4, ..Params::default() };
    let detector = Detector::new(Vec::new(), params).unwrap();
    let mut tracker = Tracker::new(detector);
    assert_eq!(tracker.process(&frame(&first, SIDE)).len(), 1);
    let spent = allocation_counter::measure(|| {
        for picture in [&large, &thin] {
            for _ in 0..4 {
                tracker.process(&frame(picture, SIDE));
            }
            assert_eq!(tracker.process(&frame(picture, SIDE)).len(), 2);
        }
    });
    assert_eq!(spent.count_total, 0);
}

#[test]
fn a_warm_tracker_of_coded_roundels_allocates_nothing() {
    let layout = CodeLayout { bits: 8, min_distance: 2 };
    let teeth = layout.codes().unwrap().teeth(9).unwrap();
    let kind = Kind { pattern: Pattern::Coded(layout), ..Kind::plain("robot", 0.16, 0.096) };
    let detector = Detector::new(vec![kind], Params::default()).unwrap();
    let picture = |shift: f64| {
        let mut drawing = Drawing::new(SIDE, SIDE, 90.0, 0.7);
        let outer = ellipse((150.0 + shift, 140.0), (30.0, 24.0), 0.4);
        let roundel = Roundel { outer, ratio: 0.6, margin: 1.28, black: 40.0, white: 200.0 };
        drawing.add_coded(&roundel, 90.0, &teeth);
        drawing.picture(2.0, shift as u64)
    };
    let pictures: Vec<Vec<u8>> = (0..8).map(|i| picture(f64::from(i))).collect();
    let mut tracker = Tracker::new(detector);
    for picture in &pictures {
        tracker.process(&frame(picture, SIDE));
    }
    let spent = allocation_counter::measure(|| {
        for picture in pictures.iter().rev() {
            let [tracked] = tracker.process(&frame(picture, SIDE)) else { panic!("not one") };
            let read = tracked.ring.code.map(|reading| reading.code);
            assert_eq!(read, Some(Code { bits: 8, number: 9 }));
            assert_eq!(tracked.code.map(|voted| voted.code), read);
        }
    });
    assert_eq!(spent.count_total, 0);
}

fn camera() -> Camera {
    let intrinsics = Intrinsics {
        width: SIDE,
        height: SIDE,
        fx_px: 500.0,
        fy_px: 500.0,
        cx_px: 149.5,
        cy_px: 149.5,
        lens: Lens::PlumbBob([0.0; 5]),
    };
    Camera::new(intrinsics).unwrap()
}

#[test]
fn a_warm_locator_allocates_nothing() {
    let kinds = vec![Kind::plain("robot", 0.16, 0.08)];
    let pictures: Vec<Vec<u8>> = (0..12).map(picture).collect();
    for mode in [Mode::Fast, Mode::Precise] {
        let params = Params { mode, ..Params::default() };
        let mut locator = Locator::new(camera(), kinds.clone(), mode);
        let mut tracker = Tracker::new(Detector::new(kinds.clone(), params).unwrap());
        let mut located = Vec::new();
        let mut locate = |picture: &[u8]| {
            let frame = frame(picture, SIDE);
            locator.locate_all(&frame, tracker.process(&frame), &mut located);
            assert!(located.len() > 6 && located.iter().all(Result::is_ok), "{located:?}");
        };
        pictures.iter().for_each(|picture| locate(picture));
        let spent =
            allocation_counter::measure(|| pictures.iter().for_each(|picture| locate(picture)));
        assert_eq!(spent.count_total, 0, "{mode:?}");
    }
}

#[test]
fn a_warm_locator_of_elliptical_discs_allocates_nothing() {
    let pattern = Pattern::Elliptical { minor_diameter_m: 0.064 };
    let kinds = vec![Kind { pattern, ..Kind::plain("robot", 0.16, 0.096) }];
    let mut locator = Locator::new(camera(), kinds.clone(), Mode::Precise);
    let mut tracker = Tracker::new(Detector::new(kinds, Params::default()).unwrap());
    let picture = |shift: f64| {
        let at = (150.0 + shift, 140.0);
        let mut drawing = Drawing::new(SIDE, SIDE, 200.0, 0.7);
        drawing.add_disc(&ellipse(at, (30.0, 30.0), 0.0), -160.0);
        drawing.add_disc(&ellipse(at, (18.0, 12.0), 0.5), 160.0);
        drawing.picture(2.0, shift as u64)
    };
    let pictures: Vec<Vec<u8>> = (0..8).map(|i| picture(f64::from(i))).collect();
    let mut locate = |picture: &[u8]| {
        let frame = frame(picture, SIDE);
        let [tracked] = tracker.process(&frame) else { panic!("not one") };
        let located = locator.locate(&frame, tracked).unwrap();
        assert_eq!(located.by, Mode::Precise);
        assert!(located.pose.yaw_rad.is_some());
    };
    pictures.iter().for_each(|picture| locate(picture));
    let spent = allocation_counter::measure(|| pictures.iter().for_each(|picture| locate(picture)));
    assert_eq!(spent.count_total, 0);
}

/// Rings that a new tracker of these kinds tracks in the picture.
fn followed(kinds: &[Kind], picture: &[u8]) -> Vec<TrackedRing> {
    let mut tracker = Tracker::new(Detector::new(kinds.to_vec(), Params::default()).unwrap());
    tracker.process(&frame(picture, SIDE)).to_vec()
}

/// A picture of one ring of this size and place; `add` draws into it.
fn lit(
    radius_px: f64,
    blur_px: f64,
    kind: &Kind,
    disturb: impl Fn(&mut Drawing, (f64, f64)),
) -> Vec<u8> {
    let at = (148.0, 152.0);
    let mut drawing = Drawing::new(SIDE, SIDE, 200.0, blur_px);
    let axes = (radius_px, 0.86 * radius_px);
    match kind.pattern {
        Pattern::Elliptical { .. } => {
            drawing.add_disc(&ellipse(at, (radius_px, radius_px), 0.0), -160.0);
            drawing.add_disc(&ellipse(at, (0.6 * radius_px, 0.4 * radius_px), 0.5), 160.0);
        }
        _ => {
            let outer = ellipse(at, axes, 0.4);
            let plain = Roundel { outer, ratio: 0.6, margin: 1.28, black: 40.0, white: 200.0 };
            match kind.pattern {
                Pattern::Coded(layout) => {
                    let teeth = layout.codes().unwrap().teeth(9).unwrap();
                    drawing.add_coded(&plain, 200.0, &teeth);
                }
                _ => drawing.add(&plain, 200.0),
            }
        }
    }
    disturb(&mut drawing, at);
    drawing.picture(2.0, 7)
}

/// Once a first ring has been located, no other needs memory, whatever its size, blur, pattern and occlusion.
#[test]
fn poses_of_any_picture_allocate_nothing_after_the_first() {
    let plain = vec![Kind::plain("robot", 0.16, 0.096)];
    let with = |pattern| vec![Kind { pattern, ..plain[0].clone() }];
    let elliptical = with(Pattern::Elliptical { minor_diameter_m: 0.064 });
    let coded = with(Pattern::Coded(CodeLayout { bits: 8, min_distance: 2 }));
    // Half of the ring in shadow, and a dark object over a part of its rims.
    let shadow = |drawing: &mut Drawing, at: (f64, f64)| {
        drawing.stripe(|u, _| if (u as f64) < at.0 { -30.0 } else { 0.0 });
    };
    let cover = |radius_px: f64| {
        move |drawing: &mut Drawing, (u, v): (f64, f64)| {
            let axes = (0.3 * radius_px, 0.3 * radius_px);
            drawing.add_disc(&ellipse((u + radius_px, v), axes, 0.0), -150.0);
        }
    };
    // Minimum number of the twelve pictures that are fitted.
    for (kinds, min) in [(plain, 8), (elliptical, 4), (coded, 0)] {
        let kind = &kinds[0];
        let first = lit(14.0, 0.7, kind, |_, _| {});
        let mut late = Vec::new();
        for (radius_px, blur_px) in [(12.0, 0.6), (30.0, 0.9), (52.0, 1.3), (104.0, 0.5)] {
            let clean = lit(radius_px, blur_px, kind, |_, _| {});
            let rings = followed(&kinds, &clean);
            assert_eq!(rings.len(), 1);
            let disturbed = [
                lit(radius_px, blur_px, kind, shadow),
                lit(radius_px, blur_px, kind, cover(radius_px)),
            ];
            late.push((clean, rings.clone()));
            late.extend(disturbed.map(|picture| (picture, rings.clone())));
        }
        // A track for each size: the allowance of one would not pay for all these fits.
        for (size, pictures) in (100..).zip(late.chunks_mut(3)) {
            pictures.iter_mut().for_each(|(_, rings)| rings[0].track = TrackNumber(size));
        }
        let mut locator = Locator::new(camera(), kinds.clone(), Mode::Precise);
        let mut located = Vec::with_capacity(8);
        locator.locate_all(&frame(&first, SIDE), &followed(&kinds, &first), &mut located);
        let mut precise = 0;
        let spent = allocation_counter::measure(|| {
            for (picture, rings) in &late {
                locator.locate_all(&frame(picture, SIDE), rings, &mut located);
                let by = |one: &&Result<_, _>| matches!(one, Ok(Located { by: Mode::Precise, .. }));
                precise += located.iter().filter(by).count();
            }
        });
        assert!(precise >= min, "{kinds:?}: {precise}");
        assert_eq!(spent.count_total, 0);
    }
}
