//! Roundels as printers, lamps, lenses and cameras show them: a few trials of each condition at one size. The whole table
//! is that of `cargo run --release -p roundel-tests -- conditions`.

use Marker::{Coded, Plain};
use Mode::{Fast, Precise};
use roundel_core::marker::Mode;
use roundel_tests::{
    conditions::{
        Condition, Marker, all,
        cost::{Picture, work_ratio},
        score::Summary,
        trial::summaries,
    },
    precision::MODES,
};

const DIAMETER_PX: f64 = 36.0;
const TRIALS: usize = 12;

/// Least shares in percent: found, followed, depths, positions and normals inside their stated 95 %.
type Bar = [u8; 5];

/// What every condition must reach. The shares inside are 8 points below the 92 % that many trials must reach: twelve
/// trials with four frames each, which are alike, give a share to about 5.
const AIM: Bar = [100, 99, 84, 84, 84];

/// Conditions that do not reach [`AIM`] yet, with what they reach less five points.
#[rustfmt::skip]
const MISSES: &[(&str, Marker, Mode, Bar)] = &[
    ("dirty-margin", Plain, Fast, [100, 99, 84, 72, 84]),
    ("disc-3-smaller", Plain, Fast, [100, 99, 84, 84, 64]),
    ("disc-3-smaller", Plain, Precise, [100, 99, 84, 84, 53]),
    ("scale-0.97", Plain, Fast, [100, 99, 0, 0, 84]),
    ("scale-0.97", Plain, Precise, [100, 99, 0, 0, 84]),
    ("scale-1.03", Plain, Fast, [100, 99, 0, 0, 84]),
    ("scale-1.03", Plain, Precise, [100, 99, 0, 0, 84]),
    ("ink-spread-0.4", Plain, Precise, [100, 99, 84, 84, 72]),
    ("bent-2m", Plain, Fast, [100, 99, 84, 3, 84]),
    ("bent-2m", Plain, Precise, [100, 99, 84, 12, 84]),
    ("saturated-bloom", Plain, Fast, [100, 99, 84, 84, 57]),
    ("saturated-bloom", Plain, Precise, [100, 99, 72, 72, 45]),
    ("shadow-60", Plain, Fast, [87, 94, 84, 84, 84]),
    ("shadow-60", Plain, Precise, [87, 94, 84, 84, 84]),
    ("gradient", Plain, Precise, [100, 99, 84, 76, 84]),
    ("glare", Plain, Fast, [70, 92, 84, 73, 84]),
    ("glare", Plain, Precise, [70, 92, 84, 71, 84]),
    ("sharpened", Plain, Fast, [100, 99, 51, 84, 84]),
    ("sharpened", Plain, Precise, [100, 99, 10, 53, 84]),
    ("vignetting", Plain, Fast, [100, 99, 84, 60, 84]),
    ("defocus-1.6", Plain, Fast, [100, 99, 84, 28, 64]),
    ("lens-error-0.1", Plain, Fast, [100, 99, 60, 0, 84]),
    ("lens-error-0.1", Plain, Precise, [100, 99, 0, 0, 84]),
    ("r4-real", Plain, Fast, [87, 92, 55, 33, 84]),
    ("r4-real", Plain, Precise, [87, 92, 47, 33, 84]),
    ("margin-10", Coded, Fast, [100, 99, 84, 84, 26]),
    ("disc-3-smaller", Coded, Fast, [100, 99, 84, 84, 76]),
    ("scale-0.97", Coded, Fast, [100, 99, 0, 0, 84]),
    ("scale-0.97", Coded, Precise, [100, 99, 0, 0, 84]),
    ("scale-1.03", Coded, Fast, [100, 99, 0, 0, 84]),
    ("scale-1.03", Coded, Precise, [100, 99, 0, 0, 84]),
    ("bent-2m", Coded, Fast, [100, 99, 84, 22, 84]),
    ("bent-2m", Coded, Precise, [100, 99, 84, 10, 84]),
    ("saturated-2.2", Coded, Fast, [53, 99, 84, 84, 84]),
    ("saturated-2.2", Coded, Precise, [53, 99, 84, 84, 84]),
    ("saturated-bloom", Coded, Fast, [37, 99, 84, 84, 84]),
    ("saturated-bloom", Coded, Precise, [37, 99, 84, 84, 84]),
    ("gradient", Coded, Fast, [100, 99, 84, 43, 84]),
    ("gradient", Coded, Precise, [100, 99, 84, 76, 76]),
    ("sharpened", Coded, Precise, [100, 99, 64, 84, 84]),
    ("defocus-1.6", Coded, Fast, [100, 99, 84, 41, 66]),
    ("defocus-1.6", Coded, Precise, [100, 99, 84, 76, 84]),
    ("lens-error-0.1", Coded, Fast, [100, 99, 84, 0, 84]),
    ("lens-error-0.1", Coded, Precise, [100, 99, 0, 0, 84]),
    ("r4-real", Coded, Fast, [62, 94, 63, 49, 84]),
    ("r4-real", Coded, Precise, [62, 94, 63, 46, 84]),
];

/// An entry of [`MISSES`] that is exceeded by more should be tightened.
const SLACK: f64 = 15.0;

fn shares(summary: &Summary) -> [f64; 5] {
    let [depth, position, normal] = summary.inside_shares();
    [summary.found_share(), summary.followed_share(), depth, position, normal]
        .map(|share| if share.is_nan() { 0.0 } else { 100.0 * share })
}

fn is_met(bar: &Bar, shares: &[f64; 5]) -> bool {
    bar.iter().zip(shares).all(|(least, share)| *share >= f64::from(*least))
}

/// Whether a share below the aim has become better than its entry says.
fn is_loose(bar: &Bar, shares: &[f64; 5]) -> bool {
    let is_low = |index: usize| bar[index] < AIM[index];
    (0..bar.len()).any(|index| is_low(index) && shares[index] > f64::from(bar[index]) + SLACK)
}

fn check(marker: Marker) {
    let mut problems = Vec::new();
    for condition in all() {
        let summaries = summaries(&condition, marker, DIAMETER_PX, TRIALS);
        for (mode, summary) in MODES.into_iter().zip(&summaries) {
            let shares = shares(summary);
            let about = format!("{}, {}, {mode:?}: {shares:.0?}", condition.name, marker.name());
            println!("{about}, depth {:.1} over its bound", summary.depth_over_bound());
            let listed = MISSES
                .iter()
                .find(|(name, of, by, _)| (*name, *of, *by) == (condition.name, marker, mode))
                .map(|(.., bar)| bar);
            if !is_met(listed.unwrap_or(&AIM), &shares) {
                problems.push(format!("{about}: below {:?}", listed.unwrap_or(&AIM)));
            }
            if listed.is_some() && is_met(&AIM, &shares) {
                println!("  reaches the aim, and should leave the list");
            } else if listed.is_some_and(|bar| is_loose(bar, &shares)) {
                println!("  better than listed");
            }
            if summary.false_detections > 0 {
                problems.push(format!("{about}: {} false", summary.false_detections));
            }
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

/// Most work of followed roundels in precise mode, relative to ideal ones, of these sizes.
const MAX_WORK: [(f64, f64); 2] = [(36.0, 3.0), (72.0, 6.0)];

/// Conditions that need more yet, with the work that they need at most.
const COSTLY: &[(&str, [f64; 2])] = &[
    ("face-on", [5.0, 8.5]),
    ("dirty-margin", [5.5, 9.0]),
    ("bent-2m", [5.5, 7.5]),
    ("saturated-1.5", [3.0, 9.0]),
    ("saturated-2.2", [6.0, 10.5]),
    ("saturated-bloom", [4.0, 9.0]),
    ("shadow-30", [7.0, 6.0]),
    ("shadow-50", [7.5, 6.5]),
    ("shadow-60", [5.0, 9.5]),
    ("gradient", [5.0, 9.0]),
    ("glare", [5.5, 12.0]),
    ("sharpened", [5.5, 7.0]),
    ("r4-real", [6.0, 8.5]),
];

#[test]
fn work_is_bounded_under_every_condition() {
    let mut problems = Vec::new();
    for (size, (diameter_px, max)) in MAX_WORK.into_iter().enumerate() {
        let plain = Picture::new(&Condition::plain(), Plain, diameter_px);
        for condition in all() {
            let work = work_ratio(&Picture::new(&condition, Plain, diameter_px), &plain);
            println!("{}, {diameter_px} px: {work:.1}", condition.name);
            let listed = COSTLY.iter().find(|(name, _)| *name == condition.name);
            if work > listed.map_or(max, |(_, works)| works[size]) {
                problems.push(format!("{}, {diameter_px} px: {work:.1}", condition.name));
            }
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

#[test]
fn plain_roundels_reach_their_bars() {
    check(Plain);
}

#[test]
fn coded_roundels_reach_their_bars() {
    check(Coded);
}
