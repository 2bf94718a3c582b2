//! Coded roundels are found and read, with their yaw, or said not to be. `cargo run -p roundel-tests
//! --bin codes` shows many more.

use roundel_core::marker::CodeLayout;
use roundel_tests::coded::{Case, run};

#[test]
fn codes_are_read_from_their_least_size_on() {
    for (bits, min_distance, least_px) in [(8, 2, 36.0), (12, 2, 60.0), (16, 2, 90.0)] {
        let layout = CodeLayout { bits, min_distance };
        let score = run(&Case { layout, diameters_px: (least_px, 1.5 * least_px) }, 300);
        let case = format!("{bits} bits: {score:?}");
        assert!(score.read >= 299, "{case}");
        assert_eq!((score.wrong, score.wrong_yaw), (0, 0), "{case}");
        assert!(score.yaw_rms_rad < 0.15f64.to_radians(), "{case}");
        assert!(score.yaw_rms_stated < 2.5, "{case}");
    }
}

#[test]
fn what_is_too_small_is_never_read_wrongly() {
    for (bits, min_distance, diameters_px) in [(8, 2, (12.0, 30.0)), (16, 2, (20.0, 70.0))] {
        let layout = CodeLayout { bits, min_distance };
        let score = run(&Case { layout, diameters_px }, 300);
        assert!(score.read < score.shown, "{bits} bits");
        assert_eq!((score.wrong, score.wrong_yaw), (0, 0), "{bits} bits: {score:?}");
    }
}
