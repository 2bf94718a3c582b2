//! Whether roundels are found among things that resemble them, and nothing else is: a seeded share of
//! what `cargo run -p roundel-tests --bin recall` prints.

use rayon::prelude::*;
use roundel_core::marker::Scratch;
use roundel_tests::recall::{Plan, Range, Scenes};

/// Each roundel of these frames is found by a detector that knows the print and by one that does not.
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
        }
    });
}

#[test]
fn roundels_of_all_sizes_are_found() {
    check(Range { minor_px: [10.0, 110.0], ..Range::default() }, 300, 1);
}

#[test]
fn the_smallest_are_found() {
    check(Range { minor_px: [10.0, 14.0], per_frame: 60, ..Range::default() }, 180, 2);
}
