//! Detection of roundels among look-alikes without false detections, on fewer frames than `cargo run -p roundel-tests
//! -- recall`.

use rayon::prelude::*;
use roundel_core::{
    id::KindId,
    marker::{Detector, Kind, Params, Polarity, Scratch},
};
use roundel_tests::{
    clutter::Clutter,
    elliptical,
    recall::{Plan, Range, Scenes},
};

/// Requires that each roundel is found, with a known print and with any ratio, without false detections.
fn check(range: Range, count: usize, seed: u64) {
    let plans: Vec<Plan> = Scenes::new(range, count, seed).collect();
    plans.into_par_iter().for_each(|plan| {
        let scene = plan.render();
        let mut scratch = Scratch::default();
        for print_is_known in [true, false] {
            let outcome = scene.judge(&scene.detector(print_is_known), &mut scratch);
            let about = format!(
                "frame {:#x}, {:?}, ratio {:.3}, print known: {print_is_known}",
                scene.seed, scene.imaging, scene.ratio
            );
            assert!(outcome.missed.is_empty(), "{about}: missed {:?}", outcome.missed);
            assert!(
                outcome.false_detections.is_empty(),
                "{about}: false {:?}",
                outcome.false_detections
            );
        }
    });
}

#[test]
fn roundels_of_all_sizes_are_found_without_false_detections() {
    check(Range::default(), 300, 1);
}

#[test]
fn the_smallest_roundels_are_found_without_false_detections() {
    check(Range { minor_px: [10.0, 14.0], per_frame: 60, ..Range::default() }, 180, 2);
}

#[test]
fn dense_clutter_has_no_false_detection() {
    (0..24u64).into_par_iter().for_each(|seed| {
        let scene = Plan::empty(Clutter::JUNK, seed).render();
        let outcome = scene.judge(&scene.detector(false), &mut Scratch::default());
        assert!(
            outcome.false_detections.is_empty(),
            "frame {seed}: false {:?}",
            outcome.false_detections
        );
    });
}

/// With a kind with an elliptical disc, 0.6 by 0.4 of the outer diameter, plain roundels are distinguished as
/// strictly. The clutter has rings with elliptical discs of 0.7 by 0.3: a few small ones of these are detected as the
/// kind.
#[test]
fn dense_clutter_has_few_false_detections_of_elliptical_discs() {
    let kinds = [
        elliptical::kinds(Polarity::BlackRing).swap_remove(0),
        Kind::plain("small disc", 0.16, 0.064),
    ];
    let detector = Detector::new(kinds.to_vec(), Params::default()).unwrap();
    let found = |seed| {
        let scene = Plan::empty(Clutter::JUNK, seed).render();
        let false_detections = scene.judge(&detector, &mut Scratch::default()).false_detections;
        for ring in &false_detections {
            assert_eq!(ring.kind, Some(KindId(0)), "frame {seed}: {ring:?}");
            assert!(ring.inner.semi_minor_px < 4.0, "frame {seed}: {ring:?}");
        }
        false_detections.len()
    };
    let count: usize = (0..24u64).into_par_iter().map(found).sum();
    assert!(count <= 20, "{count} false");
}
