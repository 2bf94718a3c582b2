//! Precision and consistency of single poses, on a small part of the trials of `cargo bench -p roundel-tests --bench
//! precision`, which has the tables.
//!
//! Bars of shares and means are widened by two standard deviations of the sample.

use std::sync::LazyLock;

use roundel_core::marker::Mode;
use roundel_tests::precision::{
    MODES, NARROW_MARGIN, RATIO, Range, Summary, Trial, TrialFrame, WIDE_MARGIN, trials,
};

/// Diameters, pixels, and the bar for the depth's rms over its bound.
const SIZES: [((f64, f64), f64); 4] =
    [((12.0, 20.0), 3.0), ((20.0, 30.0), 2.0), ((30.0, 50.0), 1.5), ((50.0, 110.0), 1.5)];
const TILTS_DEG: [(f64, f64); 4] = [(0.0, 5.0), (5.0, 20.0), (20.0, 40.0), (40.0, 60.0)];
/// Trials of each size and tilt, two frames each.
const TRIALS: usize = 25;

const FAST: usize = 0;
const PRECISE: usize = 1;

/// A narrower roundel may be missed.
const MIN_FOUND_PX: f64 = 10.0;

static WIDE: LazyLock<Vec<Trial>> = LazyLock::new(|| drawn(TRIALS, WIDE_MARGIN, RATIO));
static NARROW: LazyLock<Vec<Trial>> = LazyLock::new(|| drawn(TRIALS / 2, NARROW_MARGIN, RATIO));

fn drawn(count: usize, margin: f64, ratio: f64) -> Vec<Trial> {
    let mut all = Vec::new();
    for (diameter_px, _) in SIZES {
        for tilt_deg in TILTS_DEG {
            let (blur_px, noise) = ((0.5, 1.1), (1.0, 4.0));
            let range = Range {
                motion_px: (0.0, 0.0),
                diameter_px,
                tilt_deg,
                blur_px,
                noise,
                margin,
                ratio,
            };
            all.extend(trials(&range, count, 77 + all.len() as u64));
        }
    }
    all
}

fn select(all: &[Trial], mode: usize, is_selected: impl Fn(&Trial) -> bool) -> Summary {
    let frames: Vec<&TrialFrame> =
        all.iter().filter(|trial| is_selected(trial)).flat_map(|trial| &trial.frames).collect();
    Summary::of(frames, mode)
}

fn within(value: f64, (low, high): (f64, f64)) -> bool {
    (low..high).contains(&value)
}

fn print(name: &str, summary: &Summary) {
    println!(
        "{name}: depth {:.4} % rms, {:.2} over the bound, bias {:+.2} of it; inside 95 %: position \
         {:.1} %, pose {:.1} %; {} of {} missed",
        100.0 * summary.depth_rms(),
        summary.depth_over_bound(),
        summary.bias_over_rms(),
        100.0 * summary.position_share(),
        100.0 * summary.pose_share(),
        summary.missed,
        summary.frames,
    );
}

/// Two standard deviations of a sampled share of 95 %.
fn sampling_margin(summary: &Summary) -> f64 {
    2.0 * (0.95 * 0.05 / summary.found() as f64).sqrt()
}

/// The bias is below a third of the rms, and 95 ± 3 % are inside the stated ellipsoids.
fn assert_consistent(name: &str, summary: &Summary) {
    print(name, summary);
    let bias = summary.bias_over_rms().abs();
    assert!(bias < 1.0 / 3.0 + 2.0 / (summary.found() as f64).sqrt(), "{name}: {bias}");
    for share in [summary.position_share(), summary.pose_share()] {
        assert!((share - 0.95).abs() <= 0.03 + sampling_margin(summary), "{name}: {share}");
    }
}

#[test]
fn precise_depth_is_near_the_bound_at_every_size() {
    assert_eq!(MODES[PRECISE], Mode::Precise);
    for (size, bar) in SIZES {
        let summary = select(&WIDE, PRECISE, |trial| within(trial.diameter_px, size));
        assert_consistent(&format!("{size:?} px"), &summary);
        let over = summary.depth_over_bound();
        assert!(over <= bar, "{size:?}: {over}");
    }
}

#[test]
fn precise_poses_are_consistent_at_every_tilt() {
    for tilt in TILTS_DEG {
        let summary = select(&WIDE, PRECISE, |trial| within(trial.tilt_deg, tilt));
        assert_consistent(&format!("{tilt:?}°"), &summary);
    }
}

#[test]
fn precise_normals_of_tilted_roundels_are_accurate_to_a_tenth_of_a_degree() {
    let summary = select(&WIDE, PRECISE, |trial| {
        within(trial.diameter_px, (40.0, 110.0)) && within(trial.tilt_deg, (20.0, 60.0))
    });
    let (median, p95) = (summary.normal_deg(0.5), summary.normal_deg(0.95));
    println!("normal: median {median:.3}°, 95 % within {p95:.3}°, of {}", summary.found());
    assert!(median <= 0.1 && p95 <= 0.6, "{median} {p95}");
}

/// A margin as on real prints, and the closed form: less precise, and as consistent.
#[test]
fn both_modes_are_consistent_with_a_narrow_margin() {
    for (mode, name) in MODES.iter().enumerate() {
        for (size, _) in SIZES {
            let summary = select(&NARROW, mode, |trial| within(trial.diameter_px, size));
            print(&format!("{name:?} mode, {size:?} px"), &summary);
            let share = summary.position_share();
            assert!(share >= 0.92 - sampling_margin(&summary), "{name:?}, {size:?}: {share}");
        }
    }
}

/// The wider the disc, the thinner the black ring, until the blurs of its rims overlap, first with a less sharp lens.
/// Coded prints have a ratio of 0.6.
#[test]
fn fast_positions_are_consistent_at_every_ratio() {
    let mut thin: Vec<Trial> = Vec::new();
    for ratio in [0.5, 0.6] {
        let all = drawn(TRIALS, WIDE_MARGIN, ratio);
        for (size, _) in SIZES {
            let summary = select(&all, FAST, |trial| within(trial.diameter_px, size));
            print(&format!("ratio {ratio}, {size:?} px"), &summary);
            let share = summary.position_share();
            assert!(share >= 0.92 - sampling_margin(&summary), "ratio {ratio}, {size:?}: {share}");
        }
        let black_px = |trial: &Trial| {
            0.5 * (1.0 - ratio) * trial.diameter_px * trial.tilt_deg.to_radians().cos()
        };
        let is_thin = |trial: &Trial| within(black_px(trial), (2.5, 6.0)) && trial.blur_px > 0.8;
        thin.extend(all.into_iter().filter(is_thin));
    }
    let summary = select(&thin, FAST, |_| true);
    print("black of 2.5 to 6 px, blur above 0.8 px", &summary);
    let share = summary.position_share();
    assert!(share >= 0.92 - sampling_margin(&summary), "{share}");
}

#[test]
fn roundels_ten_pixels_wide_are_found() {
    for all in [&WIDE, &NARROW] {
        let width = |trial: &Trial| trial.diameter_px * trial.tilt_deg.to_radians().cos();
        let summary = select(all, FAST, |trial| width(trial) > MIN_FOUND_PX);
        assert_eq!(summary.missed, 0, "of {}", summary.frames);
    }
}
