//! Roundels that move past a rolling shutter: their poses are as precise as those of still ones, and consistent from
//! the first frame on.

use roundel_core::marker::Mode;
use roundel_tests::{
    precision::{MODES, RATIO, Range, Summary, TrialFrame, WIDE_MARGIN},
    rolling_shutter::{Drive, FRAMES, MarkerType, sequences},
};

const LINE_TIME_S: f64 = 12e-6;
const SPEED_M_S: f64 = 3.0;
/// Roundels of each kind.
const COUNT: usize = 60;
/// Frame from which on the motion is known.
const SETTLED: usize = 2;

fn range() -> Range {
    Range {
        diameter_px: (30.0, 60.0),
        tilt_deg: (0.0, 50.0),
        blur_px: (0.5, 1.1),
        noise: (1.0, 3.0),
        motion_px: (0.0, 0.0),
        margin: WIDE_MARGIN,
        ratio: RATIO,
    }
}

fn summary<'a>(
    name: &str,
    frames: impl IntoIterator<Item = &'a TrialFrame>,
    mode: Mode,
) -> Summary {
    let index = MODES.iter().position(|&other| other == mode).unwrap();
    let summary = Summary::of(frames, index);
    println!(
        "{name}, {mode:?}: depth {:.4} % rms, {:.2} over the bound, bias {:+.2} of it; inside 95 %: \
         position {:.1} %, pose {:.1} %; normal {:.2}° median; {} of {} missed",
        100.0 * summary.depth_rms(),
        summary.depth_over_bound(),
        summary.bias_over_rms(),
        100.0 * summary.position_share(),
        100.0 * summary.pose_share(),
        summary.normal_deg(0.5),
        summary.missed,
        summary.frames,
    );
    summary
}

fn check(name: &str, marker: MarkerType) {
    let drive = Drive {
        marker,
        speed_m_s: SPEED_M_S,
        line_time_s: LINE_TIME_S,
        configured_line_time_s: LINE_TIME_S,
    };
    let still = Drive { line_time_s: 0.0, configured_line_time_s: 0.0, ..drive };
    let (moving, still) =
        (sequences(&range(), &drive, COUNT, 3), sequences(&range(), &still, COUNT, 3));
    for mode in MODES {
        let select = |all: &[[TrialFrame; FRAMES]], name: &str, from: usize, to: usize| {
            let frames = all.iter().flat_map(|frames| &frames[from..to]);
            summary(name, frames.collect::<Vec<_>>(), mode)
        };
        let still = select(&still, &format!("{name}, global shutter"), SETTLED, FRAMES);
        let first = select(&moving, &format!("{name}, first frame"), 0, 1);
        let second = select(&moving, &format!("{name}, second frame"), 1, 2);
        let settled = select(&moving, &format!("{name}, later"), SETTLED, FRAMES);
        let margin = 2.0 * (0.95 * 0.05 / COUNT as f64).sqrt();
        for early in [&first, &second] {
            assert!(early.position_share() >= 0.92 - margin, "{name}, {mode:?}");
        }
        let rms = (settled.depth_over_bound(), still.depth_over_bound());
        assert!(rms.0 < 1.15 * rms.1 + 0.1, "{name}, {mode:?}: {rms:?}");
        assert!(settled.position_share() >= still.position_share() - margin, "{name}, {mode:?}");
        assert!(settled.pose_share() >= still.pose_share() - margin, "{name}, {mode:?}");
    }
}

/// A slow roundel is soon known to be slow: its errors are stated as under a global shutter.
#[test]
fn still_roundels_have_no_larger_covariances() {
    for (name, marker) in [("plain", MarkerType::Plain), ("8 bits", MarkerType::Coded(8))] {
        let drive = Drive {
            marker,
            speed_m_s: 0.0,
            line_time_s: LINE_TIME_S,
            configured_line_time_s: LINE_TIME_S,
        };
        let global = Drive { line_time_s: 0.0, configured_line_time_s: 0.0, ..drive };
        let [rolling, global] = [drive, global].map(|drive| sequences(&range(), &drive, COUNT, 4));
        for (index, mode) in MODES.into_iter().enumerate() {
            let mean = |all: &[[TrialFrame; FRAMES]]| {
                let frames = all.iter().flat_map(|frames| &frames[SETTLED..]);
                let squares = frames.filter_map(|frame| Some(frame.errors[index]?.position_square));
                let squares: Vec<_> = squares.collect();
                squares.iter().sum::<f64>() / squares.len() as f64
            };
            let (rolling, global) = (mean(&rolling), mean(&global));
            println!(
                "{name}, {mode:?}: normalized squares of {rolling:.2}, {global:.2} under a global shutter"
            );
            assert!(rolling >= 0.9 * global, "{name}, {mode:?}: {rolling} of {global}");
        }
    }
}

#[test]
fn plain_roundels() {
    check("plain", MarkerType::Plain);
}

#[test]
fn coded_roundels() {
    check("8 bits", MarkerType::Coded(8));
}

#[test]
fn elliptical_roundels() {
    check("elliptical", MarkerType::Elliptical);
}
