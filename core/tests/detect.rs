//! Detection and tracking on drawn frames: symmetries, lighting, edges, identity.

use crate::drawing::{Drawing, Roundel, ellipse, frame};
use proptest::prelude::*;
use roundel_core::{
    camera::PixelPoint,
    ellipse::Ellipse,
    frame::Frame,
    id::KindId,
    marker::{
        Detector, Kind, Mask, Params, Polarity, Reject, Rejected, Ring, Scratch, TrackedRing,
        Tracker,
    },
};

const WIDTH: usize = 200;
const HEIGHT: usize = 160;

fn kind(name: &str, ratio: f64) -> Kind {
    Kind::plain(name, 0.16, 0.16 * ratio)
}

fn any_ring() -> Detector {
    Detector::new(Vec::new(), Params::default()).unwrap()
}

fn roundel(at: (f64, f64), radius: f64, ratio: f64) -> Roundel {
    let outer = ellipse(at, (radius, radius), 0.0);
    Roundel { outer, ratio, margin: 1.4, black: 40.0, white: 200.0 }
}

fn drawn(roundels: &[Roundel], noise: f64, seed: u64) -> Vec<u8> {
    let mut drawing = Drawing::new(WIDTH, HEIGHT, 90.0, 0.7);
    roundels.iter().for_each(|roundel| drawing.add(roundel, 90.0));
    drawing.picture(noise, seed)
}

fn detect(detector: &Detector, picture: &[u8], width: usize) -> Vec<Ring> {
    detector.detect(&frame(picture, width), &mut Scratch::default()).to_vec()
}

fn distance(rim: &Ellipse, (u, v): (f64, f64)) -> f64 {
    (rim.center.u - u).hypot(rim.center.v - v)
}

/// The picture and its width after quarter turns and an optional mirroring.
fn turned(picture: &[u8], width: usize, quarters: usize, mirror: bool) -> (Vec<u8>, usize) {
    let (mut picture, mut width) = (picture.to_vec(), width);
    for _ in 0..quarters {
        let height = picture.len() / width;
        // (u, v) goes to (height - 1 - v, u).
        let at = |u: usize, v: usize| picture[(height - 1 - u) * width + v];
        picture = (0..width).flat_map(|v| (0..height).map(move |u| at(u, v))).collect();
        width = height;
    }
    if mirror {
        picture.chunks_exact_mut(width).for_each(<[u8]>::reverse);
    }
    (picture, width)
}

fn turned_point(at: (f64, f64), quarters: usize, mirror: bool) -> (f64, f64) {
    let (mut at, mut size) = (at, (WIDTH as f64, HEIGHT as f64));
    for _ in 0..quarters {
        at = (size.1 - 1.0 - at.1, at.0);
        size = (size.1, size.0);
    }
    if mirror { (size.0 - 1.0 - at.0, at.1) } else { at }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(48) })]

    #[test]
    fn rims_follow_quarter_turns_and_mirroring(
        u in 60.0..140.0f64,
        v in 60.0..100.0f64,
        radius in 11.0..30.0f64,
        tilt in 0.7..1.0f64,
        angle in -1.5..1.5f64,
        quarters in 0usize..4,
        mirror: bool,
    ) {
        let mut roundel = roundel((u, v), radius, 0.45);
        // Large and wide enough that the same path is taken in every orientation.
        roundel.margin = 1.6;
        roundel.outer = ellipse((u, v), (radius, radius * tilt), angle);
        let picture = drawn(&[roundel], 0.0, 1);
        let upright = detect(&any_ring(), &picture, WIDTH);
        let (picture, width) = turned(&picture, WIDTH, quarters, mirror);
        let rings = detect(&any_ring(), &picture, width);
        prop_assert_eq!(upright.len(), 1);
        prop_assert_eq!(rings.len(), 1);
        for (rim, before) in [(rings[0].outer, upright[0].outer), (rings[0].inner, upright[0].inner)] {
            let at = turned_point((before.center.u, before.center.v), quarters, mirror);
            prop_assert!(distance(&rim, at) < 0.03, "{:?} {:?}", rim, at);
            prop_assert!((rim.semi_major_px - before.semi_major_px).abs() < 0.05);
            prop_assert!((rim.semi_minor_px - before.semi_minor_px).abs() < 0.05);
        }
    }

    #[test]
    fn brightness_does_not_move_the_rims(
        u in 60.0..140.0f64,
        v in 60.0..100.0f64,
        radius in 8.0..30.0f64,
        offset in 1u8..40,
    ) {
        let picture = drawn(&[roundel((u, v), radius, 0.45)], 2.0, 3);
        let brighter: Vec<u8> = picture.iter().map(|&grey| grey + offset).collect();
        let (before, after) =
            (detect(&any_ring(), &picture, WIDTH), detect(&any_ring(), &brighter, WIDTH));
        prop_assert_eq!(before.len(), 1);
        prop_assert_eq!(after.len(), 1);
        let (before, after) = (before[0], after[0]);
        // Weights are single floats.
        prop_assert!(distance(&after.outer, (before.outer.center.u, before.outer.center.v)) < 1e-5);
        prop_assert!((after.outer.semi_major_px - before.outer.semi_major_px).abs() < 1e-5);
        prop_assert!((after.inner.semi_minor_px - before.inner.semi_minor_px).abs() < 1e-5);
        prop_assert_eq!(u16::from(after.threshold), u16::from(before.threshold) + u16::from(offset));
    }

    #[test]
    fn no_picture_panics(
        width in 1usize..40,
        height in 1usize..40,
        values in proptest::collection::vec(0usize..4, 1600),
    ) {
        let greys = [0, 60, 130, 255];
        let picture: Vec<u8> = values.iter().map(|&value| greys[value]).collect();
        let picture = &picture[..width * height];
        let mut tracker = Tracker::new(any_ring());
        for _ in 0..2 {
            for tracked in tracker.process(&frame(picture, width)) {
                prop_assert!(tracked.ring.outer.is_valid() && tracked.ring.inner.is_valid());
            }
        }
    }
}

#[test]
fn a_light_gradient_moves_no_centre() {
    let roundel = roundel((100.3, 80.6), 20.0, 0.4);
    let mut drawing = Drawing::new(WIDTH, HEIGHT, 90.0, 0.7);
    drawing.add(&roundel, 90.0);
    // From 0.7 to 1.3 of the light over the frame: a tenth of it over the roundel.
    drawing.shade(0.3);
    let rings = detect(&any_ring(), &drawing.picture(0.0, 1), WIDTH);
    assert_eq!(rings.len(), 1);
    let off = distance(&rings[0].outer, (100.3, 80.6));
    assert!(off < 0.05, "{off}");
    assert!((rings[0].outer.semi_major_px - 20.0).abs() < 0.04, "{:?}", rings[0]);
}

#[test]
fn a_ring_cut_by_the_edge_is_rejected_and_counted() {
    for at in [(5.0, 80.0), (100.0, 5.0), (195.0, 80.0), (100.0, 155.0), (14.7, 80.0)] {
        let picture = drawn(&[roundel(at, 15.0, 0.5)], 1.0, 1);
        let mut scratch = Scratch::default();
        let rings = any_ring().detect(&frame(&picture, WIDTH), &mut scratch);
        assert!(rings.is_empty(), "{at:?} {rings:?}");
    }
    let picture = drawn(&[roundel((14.7, 80.0), 15.0, 0.5)], 1.0, 1);
    let mut scratch = Scratch::default();
    any_ring().detect(&frame(&picture, WIDTH), &mut scratch);
    assert!(scratch.rejects().count(Reject::FrameEdge) > 0, "{:?}", scratch.rejects());
}

#[test]
fn a_bridged_margin_is_split_by_another_threshold() {
    // A dark floor, and a grey smear from it over the margin to the ring: black at the threshold halfway between
    // black and white, white at a quarter.
    let mut drawing = Drawing::new(WIDTH, HEIGHT, 30.0, 0.7);
    drawing.add(&roundel((100.0, 80.0), 20.0, 0.5), 30.0);
    drawing.add_disc(&ellipse((100.0, 54.0), (7.0, 2.5), 1.57), -100.0);
    let picture = drawing.picture(1.0, 1);
    let mut tracker = Tracker::new(any_ring());
    for _ in 0..3 {
        let tracked = tracker.process(&frame(&picture, WIDTH)).to_vec();
        assert_eq!(numbers(&tracked), [1], "{:?}", tracker.rejects());
        assert!(distance(&tracked[0].ring.outer, (100.0, 80.0)) < 0.3);
        assert!(tracked[0].ring.threshold < 100);
    }
}

#[test]
fn kinds_are_distinguished_and_others_rejected() {
    let detector =
        Detector::new(vec![kind("robot", 0.4), kind("reference", 0.6)], Params::default()).unwrap();
    let roundels = [
        roundel((40.0, 40.0), 15.0, 0.6),
        roundel((110.0, 50.0), 20.0, 0.4),
        roundel((150.0, 110.0), 15.0, 0.25),
    ];
    let rings = detect(&detector, &drawn(&roundels, 2.0, 5), WIDTH);
    assert_eq!(rings.len(), 2);
    for (ring, (truth, kind)) in rings.iter().zip([(roundels[0], 1), (roundels[1], 0)]) {
        assert!(distance(&ring.outer, (truth.outer.center.u, truth.outer.center.v)) < 0.05);
        assert_eq!(ring.kind, Some(KindId(kind)));
    }
}

#[test]
fn detections_are_limited() {
    let roundels: Vec<Roundel> =
        (0..3).map(|i| roundel((35.0 + 60.0 * f64::from(i), 80.0), 15.0, 0.5)).collect();
    let picture = drawn(&roundels, 1.0, 1);
    let detector =
        Detector::new(Vec::new(), Params { max_roundels: 2, ..Params::default() }).unwrap();
    assert_eq!(detect(&detector, &picture, WIDTH).len(), 2);
    let mut tracker = Tracker::new(detector);
    for _ in 0..8 {
        assert_eq!(tracker.process(&frame(&picture, WIDTH)).len(), 2);
    }
}

/// An unobserved track does not count towards the limit: a robot that was carried elsewhere is found by the next
/// search.
#[test]
fn a_roundel_that_was_moved_is_found_at_the_limit() {
    let params = Params { max_roundels: 2, search_frames: 1, ..Params::default() };
    let mut tracker = Tracker::new(Detector::new(Vec::new(), params).unwrap());
    let still = roundel((40.0, 40.0), 14.0, 0.5);
    let mut frames = vec![vec![still, roundel((40.0, 110.0), 14.0, 0.5)]; 3];
    frames.extend(vec![vec![still, roundel((150.0, 110.0), 14.0, 0.5)]; 3]);
    let tracked = follow(&mut tracker, &frames);
    assert_eq!(numbers(&tracked[2]), [1, 2]);
    assert_eq!(numbers(&tracked[3]), [1, 3]);
    assert_eq!(numbers(&tracked[5]), [1, 3]);
}

/// Tracks moving roundels through frames, and returns the rings of each frame.
fn follow(tracker: &mut Tracker, frames: &[Vec<Roundel>]) -> Vec<Vec<TrackedRing>> {
    let pictures = (0..).zip(frames).map(|(seed, roundels)| drawn(roundels, 2.0, seed));
    pictures.map(|picture| tracker.process(&frame(&picture, WIDTH)).to_vec()).collect()
}

fn numbers(tracked: &[TrackedRing]) -> Vec<u64> {
    tracked.iter().map(|ring| ring.track.0).collect()
}

#[test]
fn track_numbers_stay_with_their_roundels() {
    // Two roundels pass each other, one of them accelerating to 6 px a frame.
    let frames: Vec<Vec<Roundel>> = (0..24)
        .map(|i| {
            let t = f64::from(i);
            vec![
                roundel((30.0 + 0.26 * t * t, 50.0), 14.0, 0.5),
                roundel((160.0 - 3.0 * t, 105.0 - 0.3 * t), 17.0, 0.4),
            ]
        })
        .collect();
    let mut tracker = Tracker::new(any_ring());
    for (tracked, truth) in follow(&mut tracker, &frames).iter().zip(&frames) {
        assert_eq!(numbers(tracked), [1, 2]);
        for (tracked, truth) in tracked.iter().zip(truth) {
            let at = (truth.outer.center.u, truth.outer.center.v);
            assert!(distance(&tracked.ring.outer, at) < 0.1);
        }
    }
}

#[test]
fn a_hidden_roundel_keeps_its_number_for_a_while() {
    let at = |i: u32| roundel((30.0 + 2.0 * f64::from(i), 80.0), 14.0, 0.5);
    for (hidden, after) in [(3, 1), (5, 1), (6, 2)] {
        let frames: Vec<Vec<Roundel>> = (0..20)
            .map(|i| if (8..8 + hidden).contains(&i) { Vec::new() } else { vec![at(i)] })
            .collect();
        let tracked = follow(&mut Tracker::new(any_ring()), &frames);
        assert_eq!(numbers(&tracked[7]), [1]);
        assert_eq!(numbers(&tracked[8]), [0u64; 0]);
        assert_eq!(numbers(&tracked[19]), [after], "hidden for {hidden} frames");
    }
}

#[test]
fn a_roundel_elsewhere_gets_another_number() {
    let mut frames = vec![vec![roundel((40.0, 40.0), 14.0, 0.5)]; 3];
    frames.extend(vec![vec![roundel((150.0, 110.0), 14.0, 0.5)]; 9]);
    let tracked = follow(&mut Tracker::new(any_ring()), &frames);
    assert_eq!(numbers(&tracked[2]), [1]);
    assert_eq!(numbers(tracked.last().unwrap()), [2]);
}

#[test]
fn a_new_roundel_is_found_while_another_is_tracked() {
    let (first, second) = (roundel((40.0, 40.0), 14.0, 0.5), roundel((150.0, 120.0), 9.0, 0.5));
    let found_after = Params::default().search_frames as usize + 1;
    let mut frames = vec![vec![first]; 2];
    frames.extend(vec![vec![first, second]; found_after]);
    let tracked = follow(&mut Tracker::new(any_ring()), &frames);
    assert!(tracked.iter().all(|tracked| tracked[0].track.0 == 1));
    assert_eq!(numbers(&tracked[1 + found_after]), [1, 2]);
}

#[test]
fn a_background_search_reports_in_the_next_frame() {
    let parts = || Params { search_frames: 1, ..Params::default() };
    let tracker = || Tracker::new(Detector::new(vec![], parts()).unwrap());
    let (mut at_once, mut apart) = (tracker(), tracker());
    let one = roundel((60.0, 60.0), 14.0, 0.4);
    let other = roundel((140.0, 110.0), 14.0, 0.4);
    let mut seen = Vec::new();
    for number in 0..5 {
        // The second appears in the third frame.
        let pixels = drawn(&[one, other][..if number < 2 { 1 } else { 2 }], 2.0, number);
        let view = frame(&pixels, WIDTH);
        let plain = numbers(at_once.process(&view));
        seen.push((plain, numbers(apart.follow(&view))));
        apart.seek(&view);
    }
    let [first, before, there, next, last] = &seen[..] else { unreachable!() };
    // Without any track, the whole frame is searched at once.
    for same in [first, before, next, last] {
        assert_eq!(same.0, same.1, "{seen:?}");
    }
    assert_eq!((there.0.len(), there.1.len()), (2, 1), "{seen:?}");
}

#[test]
fn a_sudden_change_of_light_loses_no_track() {
    let mut tracker = Tracker::new(any_ring());
    for (light, seed) in [(1.0, 1), (0.4, 2), (1.2, 3), (0.3, 4)] {
        let mut drawing = Drawing::new(WIDTH, HEIGHT, 90.0, 0.7);
        drawing.add(&roundel((90.0, 70.0), 14.0, 0.5), 90.0);
        let picture: Vec<u8> = drawing
            .picture(1.0, seed)
            .iter()
            .map(|&grey| (f64::from(grey) * light).round() as u8)
            .collect();
        assert_eq!(numbers(tracker.process(&frame(&picture, WIDTH))), [1], "light {light}");
    }
}

#[test]
fn another_frame_size_resets_the_tracker() {
    let picture = drawn(&[roundel((60.0, 60.0), 14.0, 0.5)], 1.0, 1);
    let mut tracker = Tracker::new(any_ring());
    assert_eq!(numbers(tracker.process(&frame(&picture, WIDTH))), [1]);
    let smaller = Frame::new(&picture, WIDTH - 40, HEIGHT - 30, WIDTH).unwrap();
    assert_eq!(numbers(tracker.process(&smaller)), [2]);
    let one = Frame::new(&[0], 1, 1, 1).unwrap();
    assert!(tracker.process(&one).is_empty());
    assert_eq!(numbers(tracker.process(&frame(&picture, WIDTH))), [3]);
}

#[test]
fn roundels_with_a_masked_centre_are_not_reported() {
    let roundels = [roundel((50.0, 80.0), 15.0, 0.5), roundel((140.0, 80.0), 15.0, 0.5)];
    let picture = drawn(&roundels, 1.0, 1);
    // Over the left one's centre and into the right one's ring, to the left of its centre.
    let corners = [(40.0, 60.0), (135.0, 60.0), (135.0, 100.0), (40.0, 100.0)];
    let corners = corners.map(|(u, v)| PixelPoint { u, v }).to_vec();
    let detector = any_ring().with_mask(Mask::of_polygons(&[corners]).unwrap());
    let mut scratch = Scratch::default();
    let rings = detector.detect(&frame(&picture, WIDTH), &mut scratch);
    assert_eq!(rings.len(), 1);
    assert!(distance(&rings[0].outer, (140.0, 80.0)) < 0.1);
    assert!(scratch.rejects().count(Reject::Masked) > 0);
    // A roundel that moves into the region is lost there, and gets a new number when it leaves.
    let frames: Vec<Vec<Roundel>> =
        (0..30).map(|i| vec![roundel((22.0 + 5.0 * f64::from(i), 80.0), 14.0, 0.5)]).collect();
    let tracked = follow(&mut Tracker::new(detector), &frames);
    for (tracked, truth) in tracked.iter().zip(&frames) {
        let masked = (40.0..=135.0).contains(&truth[0].outer.center.u);
        assert_eq!(tracked.is_empty(), masked, "{truth:?}");
    }
    assert_eq!(numbers(&tracked[0]), [1]);
    assert_eq!(numbers(&tracked[29]), [2]);
}

#[test]
fn rejected_candidates_are_explained_on_request() {
    let picture = drawn(&[roundel((14.7, 80.0), 15.0, 0.5)], 1.0, 1);
    let mut scratch = Scratch::default();
    any_ring().detect(&frame(&picture, WIDTH), &mut scratch);
    assert!(scratch.rejected().is_empty());
    scratch.explain(true);
    any_ring().detect(&frame(&picture, WIDTH), &mut scratch);
    assert_eq!(scratch.rejected().len(), scratch.rejects().total() as usize);
    let cut = scratch.rejected().iter().find(|rejected| rejected.reject == Reject::FrameEdge);
    let Rejected { center, half_box_px, .. } = *cut.unwrap();
    assert!((center.u - 14.7).hypot(center.v - 80.0) < 1.5, "{cut:?}");
    assert!((half_box_px.0 - 15.0).hypot(half_box_px.1 - 15.0) < 2.0, "{cut:?}");
    scratch.explain(false);
    any_ring().detect(&frame(&picture, WIDTH), &mut scratch);
    assert!(scratch.rejected().is_empty());
}

#[test]
fn a_white_ring_is_detected_like_a_black_one() {
    let roundels = [roundel((50.0, 80.0), 15.0, 0.4), roundel((140.0, 80.0), 12.0, 0.6)];
    let picture = drawn(&roundels, 2.0, 1);
    let inverted: Vec<u8> = picture.iter().map(|grey| 255 - grey).collect();
    let black = vec![kind("robot", 0.4), kind("reference", 0.6)];
    let white = |kind: &Kind| Kind { polarity: Polarity::WhiteRing, ..kind.clone() };
    let both = [black.clone(), black.iter().map(white).collect()].concat();
    let detector = |kinds| Detector::new(kinds, Params::default()).unwrap();
    assert!(detect(&detector(black.clone()), &inverted, WIDTH).is_empty());
    let expected = detect(&detector(black), &picture, WIDTH);
    assert_eq!(expected.len(), 2);
    let detector = detector(both);
    assert_eq!(detect(&detector, &picture, WIDTH), expected);
    let found = detect(&detector, &inverted, WIDTH);
    let mut tracker = Tracker::new(detector);
    for _ in 0..3 {
        tracker.process(&frame(&inverted, WIDTH));
    }
    assert_eq!(tracker.rejects().count(Reject::NoWhite), 0);
    let followed: Vec<Ring> =
        tracker.process(&frame(&inverted, WIDTH)).iter().map(|tracked| tracked.ring).collect();
    // Thresholds and means are rounded the other way.
    for rings in [found, followed] {
        assert_eq!(rings.len(), 2);
        for (ring, expected) in rings.iter().zip(&expected) {
            assert_eq!(ring.polarity, Polarity::WhiteRing);
            assert_eq!(ring.kind.map(|kind| kind.0), expected.kind.map(|kind| kind.0 + 2));
            let at = expected.outer.center;
            assert!(distance(&ring.outer, (at.u, at.v)) < 0.02);
            assert!((ring.inner.semi_major_px - expected.inner.semi_major_px).abs() < 0.02);
            assert!((ring.black - (255.0 - expected.white)).abs() < 0.5);
            assert!((ring.white - (255.0 - expected.black)).abs() < 0.5);
        }
    }
}
