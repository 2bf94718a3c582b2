//! What is foretold of an installation, held against what happens: a share of `cargo run --release -p roundel-tests
//! --bin plans`.

use roundel_core::marker::Mode;
use roundel_tests::plans::{SetUp, compare};

/// Set-ups, roundels at each distance and for the errors of each.
const SET_UPS: u64 = 10;
const COUNTS: (usize, usize) = (12, 60);

#[test]
fn distance_and_precision_are_as_foretold() {
    let mut told = String::new();
    let (mut distances, mut precise, mut exact) = (0, 0, 0);
    for (set_up, reach, errors) in compare(SET_UPS, COUNTS) {
        let SetUp { mode, diameter_px, ratio, .. } = set_up;
        let reach = reach.unwrap();
        told += &format!("{mode:?} {diameter_px:.0} px, {ratio:.2}: {reach:?} {errors:?}\n");
        distances += usize::from(reach.holds(0.10));
        if mode == Mode::Precise {
            precise += 1;
            exact += usize::from(errors.depth_m.holds(0.35) && errors.across_m.holds(0.35));
        }
        // By moments, small roundels are told to a factor of about two.
        let share = errors.depth_m.ratio();
        assert!((0.3..3.0).contains(&share), "{told}");
    }
    assert!(distances + 1 >= SET_UPS as usize, "{told}");
    // Of 60 errors the rms is itself known to a tenth only.
    assert!(exact + 1 >= precise, "{told}");
}
