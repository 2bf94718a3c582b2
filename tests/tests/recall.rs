//! Whether roundels are found among things that resemble them, and nothing else is: a seeded share of
//! what `cargo run -p roundel-tests --bin recall` prints.

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

/// Each roundel of these frames is found by a detector that knows the print and by one that does not,
/// and nothing else by either.
fn check(range: Range, count: usize, seed: u64) {
    let plans: Vec<Plan> = Scenes::new(range, count, seed).collect();
    plans.into_par_iter().for_each(|plan| {
        let scene = plan.render();
        let mut scratch = Scratch::default();
        for knows_print in [true, false] {
            let outcome = scene.judge(&scene.detector(knows_print), &mut scratch);
            let about = format!(
                "frame {:#x}, {:?}, ratio {:.3}, print known: {knows_print}",
                scene.seed, scene.imaging, scene.ratio
            );
            assert!(outcome.missed.is_empty(), "{about}: missed {:?}", outcome.missed);
            assert!(outcome.ghosts.is_empty(), "{about}: false {:?}", outcome.ghosts);
        }
    });
}

#[test]
fn roundels_of_all_sizes_are_found_and_nothing_else() {
    check(Range::default(), 300, 1);
}

#[test]
fn the_smallest_are_found_and_nothing_else() {
    check(Range { minor_px: [10.0, 14.0], per_frame: 60, ..Range::default() }, 180, 2);
}

#[test]
fn a_junk_room_holds_no_roundel() {
    (0..24u64).into_par_iter().for_each(|seed| {
        let scene = Plan::empty(Clutter::JUNK, seed).render();
        let outcome = scene.judge(&scene.detector(false), &mut Scratch::default());
        assert!(outcome.ghosts.is_empty(), "frame {seed}: false {:?}", outcome.ghosts);
    });
}

/// Beside a kind with an elliptical disc, 0.6 by 0.4 of the outer diameter, a plain one is told as
/// strictly. The junk has rings with elliptical discs of 0.7 by 0.3: of these only small ones are taken
/// for the kind, and few.
#[test]
fn a_junk_room_holds_next_to_no_roundel_with_an_elliptical_disc() {
    let kinds = [
        elliptical::kinds(Polarity::BlackRing).swap_remove(0),
        Kind::plain("small disc", 0.16, 0.064),
    ];
    let detector = Detector::new(kinds.to_vec(), Params::default()).unwrap();
    let found = |seed| {
        let scene = Plan::empty(Clutter::JUNK, seed).render();
        let ghosts = scene.judge(&detector, &mut Scratch::default()).ghosts;
        for ring in &ghosts {
            assert_eq!(ring.kind, Some(KindId(0)), "frame {seed}: {ring:?}");
            assert!(ring.inner.semi_minor_px < 4.0, "frame {seed}: {ring:?}");
        }
        ghosts.len()
    };
    let count: usize = (0..24u64).into_par_iter().map(found).sum();
    assert!(count <= 20, "{count} false");
}
