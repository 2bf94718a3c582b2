//! Roundels that drive past a rolling shutter: their poses are as exact as those of what stands still, and as
//! exact as they say, from the first frame on.

use roundel_core::marker::Mode;
use roundel_tests::{
    passing::{Drive, FRAMES, Subject, passings},
    precision::{MODES, RATIO, Range, Shot, Summary, WIDE_MARGIN},
};

const LINE_TIME_S: f64 = 12e-6;
const SPEED_M_S: f64 = 3.0;
/// Roundels of each kind.
const COUNT: usize = 60;
/// From this frame on the motion is known.
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

fn summary<'a>(name: &str, shots: impl IntoIterator<Item = &'a Shot>, mode: Mode) -> Summary {
    let index = MODES.iter().position(|&other| other == mode).unwrap();
    let summary = Summary::of(shots, index);
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
        summary.shots,
    );
    summary
}

fn check(name: &str, subject: Subject) {
    let drive =
        Drive { subject, speed_m_s: SPEED_M_S, line_time_s: LINE_TIME_S, told_s: LINE_TIME_S };
    let still = Drive { line_time_s: 0.0, told_s: 0.0, ..drive };
    let (moving, still) =
        (passings(&range(), &drive, COUNT, 3), passings(&range(), &still, COUNT, 3));
    for mode in MODES {
        let of = |all: &[[Shot; FRAMES]], name: &str, from: usize, to: usize| {
            let shots = all.iter().flat_map(|frames| &frames[from..to]);
            summary(name, shots.collect::<Vec<_>>(), mode)
        };
        let still = of(&still, &format!("{name}, global shutter"), SETTLED, FRAMES);
        let first = of(&moving, &format!("{name}, first frame"), 0, 1);
        let second = of(&moving, &format!("{name}, second frame"), 1, 2);
        let known = of(&moving, &format!("{name}, later"), SETTLED, FRAMES);
        let room = 2.0 * (0.95 * 0.05 / COUNT as f64).sqrt();
        for early in [&first, &second] {
            assert!(early.position_share() >= 0.92 - room, "{name}, {mode:?}");
        }
        let rms = (known.depth_over_bound(), still.depth_over_bound());
        assert!(rms.0 < 1.15 * rms.1 + 0.1, "{name}, {mode:?}: {rms:?}");
        assert!(known.position_share() >= still.position_share() - room, "{name}, {mode:?}");
        assert!(known.pose_share() >= still.pose_share() - room, "{name}, {mode:?}");
    }
}

/// What hardly moves is soon known not to: its errors, which are the same, are stated as they are under a global shutter.
#[test]
fn what_stands_is_stated_no_wider() {
    for (name, subject) in [("plain", Subject::Plain), ("8 bits", Subject::Coded(8))] {
        let drive =
            Drive { subject, speed_m_s: 0.0, line_time_s: LINE_TIME_S, told_s: LINE_TIME_S };
        let global = Drive { line_time_s: 0.0, told_s: 0.0, ..drive };
        let [rolling, global] = [drive, global].map(|drive| passings(&range(), &drive, COUNT, 4));
        for (index, mode) in MODES.into_iter().enumerate() {
            let mean = |all: &[[Shot; FRAMES]]| {
                let shots = all.iter().flat_map(|frames| &frames[SETTLED..]);
                let squares = shots.filter_map(|shot| Some(shot.seen[index]?.position_square));
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
    check("plain", Subject::Plain);
}

#[test]
fn coded_roundels() {
    check("8 bits", Subject::Coded(8));
}

#[test]
fn elliptical_roundels() {
    check("elliptical", Subject::Elliptical);
}
