//! What is foretold of an installation, held against what happens: a share of `cargo run --release -p roundel-tests
//! --bin plans`.

use roundel_core::marker::Mode;
use roundel_tests::plans::{Pair, SetUp, compare};

/// Set-ups, roundels at each distance and for the errors of each.
const SET_UPS: u64 = 10;
const COUNTS: (usize, usize) = (12, 60);
/// What distances and precision may be off by; of 60 errors the rms is itself known to a tenth only.
const DISTANCE_SHARE: f64 = 0.10;
const PRECISION_SHARE: f64 = 0.30 + 0.09;
/// What they may be off by in the middle of all.
const MEDIAN_SHARE: f64 = 0.10;

/// Held within a share by all, and in the middle within [`MEDIAN_SHARE`].
fn check(pairs: &[Pair], share: f64, told: &str) {
    let held = pairs.iter().filter(|pair| pair.holds(share)).count();
    assert_eq!(held, pairs.len(), "within {share}:\n{told}");
    let mut ratios: Vec<f64> = pairs.iter().map(Pair::ratio).collect();
    ratios.sort_by(f64::total_cmp);
    let median = ratios[ratios.len() / 2];
    assert!((median - 1.0).abs() < MEDIAN_SHARE, "{median} in the middle:\n{told}");
}

#[test]
fn distance_and_precision_are_as_foretold_in_both_modes() {
    let mut told = String::new();
    let (mut reaches, mut depths, mut acrosses) = (Vec::new(), Vec::new(), Vec::new());
    let mut modes = [0; 2];
    for (set_up, reach, errors) in compare(SET_UPS, COUNTS) {
        let SetUp { mode, diameter_px, ratio, .. } = set_up;
        let reach = reach.unwrap();
        told += &format!("{mode:?} {diameter_px:.0} px, {ratio:.2}: {reach:?} {errors:?}\n");
        modes[usize::from(mode == Mode::Fast)] += 1;
        assert_eq!(errors.missed, 0, "what is foretold to be found is found:\n{told}");
        reaches.push(reach);
        depths.push(errors.depth_m);
        acrosses.push(errors.across_m);
    }
    assert_eq!(modes, [SET_UPS / 2; 2]);
    check(&reaches, DISTANCE_SHARE, &told);
    check(&depths, PRECISION_SHARE, &told);
    check(&acrosses, PRECISION_SHARE, &told);
}
