//! Poses of coded roundels: in precise mode from grey levels, teeth and yaw, in fast mode from the rims, and from the
//! outer rim where the teeth cannot be read. `-- --nocapture` prints the table.

use roundel_core::marker::Mode;
use roundel_tests::precision::{
    MODES, RATIO, Range, Summary, TrialFrame, WIDE_MARGIN, coded_trials, trials_read_once,
    uncoded_trials,
};

/// Bits and diameters, pixels.
const CASES: [(u8, (f64, f64)); 4] =
    [(8, (36.0, 50.0)), (8, (50.0, 110.0)), (12, (60.0, 110.0)), (16, (90.0, 110.0))];
/// The same for roundels with teeth that are no code.
const UNREAD: [(u8, (f64, f64)); 3] = [(8, (30.0, 50.0)), (8, (50.0, 110.0)), (16, (60.0, 110.0))];
/// Minimum share of detections with a yaw, by mode: in fast mode the rims alone decide which normal is right.
const LEAST_TURNED: [f64; 2] = [0.95, 0.98];
/// The same for frames whose teeth are known from the previous frame.
const LEAST_PRESUMED: f64 = 0.97;
/// Trials of each case, two frames each.
const TRIALS: usize = 120;

#[test]
fn poses_of_coded_roundels_are_near_the_bound() {
    for (index, (bits, diameter_px)) in CASES.into_iter().enumerate() {
        let trials = coded_trials(&range(diameter_px), bits, TRIALS, 500 + index as u64);
        let frames: Vec<&TrialFrame> = trials.iter().flat_map(|trial| &trial.frames).collect();
        for (mode, name) in MODES.iter().enumerate() {
            let summary = Summary::of(frames.iter().copied(), mode);
            let name = format!("{bits} bits, {diameter_px:?} px, {name:?}");
            print(&name, &summary);
            assert_consistent(&name, &summary);
            assert!(
                summary.turned() as f64 >= LEAST_TURNED[mode] * summary.found() as f64,
                "{name}"
            );
            if MODES[mode] == Mode::Precise {
                assert_near_the_bound(&name, &summary);
            }
        }
    }
}

/// Without the teeth, both modes use the outer rim alone.
#[test]
fn unread_coded_roundels_are_located_by_their_outer_rims() {
    for (index, (bits, diameter_px)) in UNREAD.into_iter().enumerate() {
        let trials = uncoded_trials(&range(diameter_px), bits, TRIALS, 600 + index as u64);
        for (mode, name) in MODES.iter().enumerate() {
            let summary = Summary::of(trials.iter().flat_map(|trial| &trial.frames), mode);
            let name = format!("{bits} bits, {diameter_px:?} px, unread, {name:?}");
            print(&name, &summary);
            assert!(summary.missed * 100 <= summary.frames, "{name}: {} missed", summary.missed);
            assert_eq!(summary.turned(), 0, "{name}");
            assert!(summary.depth_over_bound() < 4.5, "{name}");
            assert_consistent(&name, &summary);
        }
    }
}

/// A track knows the teeth, so a frame that cannot be read is fitted as well.
#[test]
fn tracked_coded_roundels_are_fitted_in_unread_frames() {
    for (index, (bits, diameter_px)) in CASES.into_iter().enumerate() {
        let trials = trials_read_once(&range(diameter_px), bits, TRIALS, 700 + index as u64);
        let summary = Summary::of(trials.iter().map(|trial| &trial.frames[1]), 1);
        let name = format!("{bits} bits, {diameter_px:?} px, read before, {:?}", MODES[1]);
        print(&name, &summary);
        assert_eq!(summary.missed, 0, "{name}");
        assert_consistent(&name, &summary);
        assert!(summary.turned() as f64 >= LEAST_PRESUMED * summary.found() as f64, "{name}");
        let (depth, yaw) = (summary.depth_over_bound(), summary.yaw_over_bound());
        assert!(depth <= 1.3 && yaw <= 1.3, "{name}: depth {depth}, yaw {yaw} of the bound");
    }
}

fn range(diameter_px: (f64, f64)) -> Range {
    Range {
        motion_px: (0.0, 0.0),
        diameter_px,
        tilt_deg: (0.0, 50.0),
        blur_px: (0.5, 1.1),
        noise: (1.0, 4.0),
        margin: WIDE_MARGIN,
        ratio: RATIO,
    }
}

/// Bars of shares and means are widened by two standard deviations of the sample.
fn assert_consistent(name: &str, summary: &Summary) {
    let count = summary.found() as f64;
    let bias = summary.bias_over_rms().abs();
    assert!(bias < 1.0 / 3.0 + 2.0 / count.sqrt(), "{name}: {bias}");
    let room = 2.0 * (0.95 * 0.05 / count).sqrt();
    for share in [summary.position_share(), summary.pose_share()] {
        assert!((share - 0.95).abs() <= 0.03 + room, "{name}: {share}");
    }
}

fn assert_near_the_bound(name: &str, summary: &Summary) {
    let (depth, yaw) = (summary.depth_over_bound(), summary.yaw_over_bound());
    assert!(depth <= 1.5 && yaw <= 1.5, "{name}: depth {depth}, yaw {yaw} of the bound");
    let stated = summary.yaw_over_stated();
    assert!(
        (0.85..1.15).contains(&stated),
        "{name}: yaw error {stated} times its stated deviation"
    );
}

fn print(name: &str, summary: &Summary) {
    println!(
        "{name}: depth {:.4} %, {:.2} of the bound, bias {:+.2} of it; yaw {:.3}°, {:.2} of the bound, {:.2} of \
         what is stated; inside 95 %: position {:.1} %, pose {:.1} %; {} missed, {} without yaw, {:.1} % mirrored of {}",
        100.0 * summary.depth_rms(),
        summary.depth_over_bound(),
        summary.bias_over_rms(),
        summary.yaw_deg(),
        summary.yaw_over_bound(),
        summary.yaw_over_stated(),
        100.0 * summary.position_share(),
        100.0 * summary.pose_share(),
        summary.missed,
        summary.found() - summary.turned(),
        100.0 * summary.wrong_normal_share(),
        summary.frames,
    );
}
