//! Detection and reading of coded roundels. `cargo run -p roundel-tests -- codes` has larger samples.

use roundel_core::marker::CodeLayout;
use roundel_tests::coded::{Case, run};

#[test]
fn codes_are_read_from_their_minimum_size_on() {
    for (bits, min_distance, min_px) in [(8, 2, 36.0), (12, 2, 60.0), (16, 2, 90.0)] {
        let layout = CodeLayout { bits, min_distance };
        let score = run(&Case { layout, diameters_px: (min_px, 1.5 * min_px) }, 300);
        let case = format!("{bits} bits: {score:?}");
        assert!(score.read >= 299, "{case}");
        assert_eq!((score.wrong, score.wrong_yaw), (0, 0), "{case}");
        assert!(score.yaw_rms_rad < 0.15f64.to_radians(), "{case}");
        assert!(score.yaw_rms_stated < 2.5, "{case}");
    }
}

#[test]
fn codes_that_are_too_small_are_never_misread() {
    for (bits, min_distance, diameters_px) in [(8, 2, (12.0, 30.0)), (16, 2, (20.0, 70.0))] {
        let layout = CodeLayout { bits, min_distance };
        let score = run(&Case { layout, diameters_px }, 300);
        assert!(score.read < score.shown, "{bits} bits");
        assert_eq!((score.wrong, score.wrong_yaw), (0, 0), "{bits} bits: {score:?}");
    }
}
