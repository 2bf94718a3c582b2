//! Predictions of `roundel plan` compared with simulation, on fewer set-ups than `cargo run --release -p
//! roundel-tests -- plans`.

use roundel_core::marker::Mode;
use roundel_tests::plans::{Pair, SetUp, compare};

/// Set-ups; roundels at each distance, and for the errors of each set-up.
const SET_UPS: u64 = 10;
const REACHES: usize = 12;
const SHOTS: usize = 60;
/// Bars for relative errors. 60 errors give an rms to a tenth only.
const DISTANCE_SHARE: f64 = 0.10;
const PRECISION_SHARE: f64 = 0.30 + 0.09;
/// Bar for the median relative error.
const MEDIAN_SHARE: f64 = 0.10;

/// Requires all predictions within a share, and their median within [`MEDIAN_SHARE`].
fn check(pairs: &[Pair], share: f64, details: &str) {
    let within = pairs.iter().filter(|pair| pair.holds(share)).count();
    assert_eq!(within, pairs.len(), "within {share}:\n{details}");
    let mut ratios: Vec<f64> = pairs.iter().map(Pair::ratio).collect();
    ratios.sort_by(f64::total_cmp);
    let median = ratios[ratios.len() / 2];
    assert!((median - 1.0).abs() < MEDIAN_SHARE, "median {median}:\n{details}");
}

#[test]
fn distance_and_precision_are_as_predicted_in_both_modes() {
    let mut details = String::new();
    let (mut reaches, mut depths, mut acrosses) = (Vec::new(), Vec::new(), Vec::new());
    let mut modes = [0; 2];
    for (set_up, reach, errors) in compare(SET_UPS, REACHES, SHOTS) {
        let SetUp { mode, diameter_px, ratio, .. } = set_up;
        let reach = reach.unwrap();
        details += &format!("{mode:?} {diameter_px:.0} px, {ratio:.2}: {reach:?} {errors:?}\n");
        modes[usize::from(mode == Mode::Fast)] += 1;
        assert_eq!(errors.missed, 0, "a roundel predicted to be found was missed:\n{details}");
        reaches.push(reach);
        depths.push(errors.depth_m);
        acrosses.push(errors.across_m);
    }
    assert_eq!(modes, [SET_UPS / 2; 2]);
    check(&reaches, DISTANCE_SHARE, &details);
    check(&depths, PRECISION_SHARE, &details);
    check(&acrosses, PRECISION_SHARE, &details);
}
