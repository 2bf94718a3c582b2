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
    ("margin-10", Plain, Fast, [100, 99, 84, 84, 72]),
    ("margin-10", Plain, Precise, [100, 99, 3, 17, 84]),
    ("margin-7.5", Plain, Fast, [100, 99, 84, 76, 38]),
    ("margin-7.5", Plain, Precise, [100, 99, 0, 0, 32]),
    ("margin-6", Plain, Fast, [100, 99, 67, 59, 13]),
    ("margin-6", Plain, Precise, [100, 99, 0, 0, 63]),
    ("dirty-margin", Plain, Fast, [100, 99, 76, 51, 59]),
    ("disc-1.5-larger", Plain, Fast, [100, 99, 0, 0, 78]),
    ("disc-1.5-larger", Plain, Precise, [100, 99, 74, 74, 84]),
    ("disc-3-smaller", Plain, Fast, [100, 99, 0, 0, 26]),
    ("disc-3-smaller", Plain, Precise, [100, 99, 15, 11, 38]),
    ("scale-0.97", Plain, Fast, [100, 99, 0, 0, 84]),
    ("scale-0.97", Plain, Precise, [100, 99, 0, 0, 84]),
    ("scale-1.03", Plain, Fast, [100, 99, 0, 0, 84]),
    ("scale-1.03", Plain, Precise, [100, 99, 0, 0, 84]),
    ("ink-spread-0.4", Plain, Fast, [100, 99, 78, 84, 65]),
    ("ink-spread-0.4", Plain, Precise, [100, 99, 26, 67, 84]),
    ("ink-shrink-0.4", Plain, Fast, [100, 99, 84, 84, 78]),
    ("ink-shrink-0.4", Plain, Precise, [100, 99, 32, 76, 84]),
    ("bent-2m", Plain, Fast, [100, 99, 84, 3, 84]),
    ("bent-2m", Plain, Precise, [100, 99, 84, 11, 84]),
    ("saturated-1.5", Plain, Fast, [100, 99, 32, 78, 84]),
    ("saturated-2.2", Plain, Fast, [0, 0, 84, 84, 84]),
    ("saturated-2.2", Plain, Precise, [0, 0, 84, 84, 84]),
    ("saturated-bloom", Plain, Fast, [0, 0, 0, 0, 17]),
    ("saturated-bloom", Plain, Precise, [0, 0, 61, 65, 58]),
    ("shadow-30", Plain, Fast, [70, 99, 84, 84, 84]),
    ("shadow-30", Plain, Precise, [70, 99, 78, 78, 84]),
    ("shadow-50", Plain, Fast, [0, 0, 84, 84, 84]),
    ("shadow-50", Plain, Precise, [0, 0, 84, 84, 78]),
    ("shadow-60", Plain, Fast, [0, 0, 84, 84, 84]),
    ("shadow-60", Plain, Precise, [0, 0, 84, 84, 84]),
    ("gradient", Plain, Precise, [100, 99, 84, 84, 76]),
    ("glare", Plain, Fast, [70, 92, 77, 75, 84]),
    ("glare", Plain, Precise, [70, 92, 49, 47, 84]),
    ("sharpened", Plain, Fast, [100, 99, 47, 84, 84]),
    ("sharpened", Plain, Precise, [100, 99, 7, 53, 84]),
    ("vignetting", Plain, Fast, [100, 99, 84, 59, 84]),
    ("defocus-1.6", Plain, Fast, [100, 99, 84, 22, 63]),
    ("lens-error-0.1", Plain, Fast, [100, 99, 59, 0, 84]),
    ("lens-error-0.1", Plain, Precise, [100, 99, 0, 0, 84]),
    ("r4-real", Plain, Fast, [28, 71, 59, 43, 84]),
    ("r4-real", Plain, Precise, [28, 71, 23, 11, 75]),
    ("margin-10", Coded, Fast, [100, 99, 74, 76, 22]),
    ("margin-10", Coded, Precise, [100, 99, 0, 11, 84]),
    ("margin-7.5", Coded, Fast, [100, 99, 0, 3, 13]),
    ("margin-7.5", Coded, Precise, [100, 99, 0, 0, 36]),
    ("margin-6", Coded, Fast, [100, 99, 0, 0, 17]),
    ("margin-6", Coded, Precise, [100, 99, 0, 0, 70]),
    ("disc-1.5-larger", Coded, Fast, [100, 99, 0, 0, 78]),
    ("disc-3-smaller", Coded, Fast, [100, 99, 0, 0, 36]),
    ("disc-3-smaller", Coded, Precise, [100, 99, 3, 3, 45]),
    ("scale-0.97", Coded, Fast, [100, 99, 0, 0, 84]),
    ("scale-0.97", Coded, Precise, [100, 99, 0, 0, 84]),
    ("scale-1.03", Coded, Fast, [100, 99, 0, 0, 84]),
    ("scale-1.03", Coded, Precise, [100, 99, 0, 0, 84]),
    ("ink-spread-0.4", Coded, Precise, [100, 99, 51, 84, 84]),
    ("ink-shrink-0.4", Coded, Precise, [100, 99, 78, 84, 84]),
    ("bent-2m", Coded, Fast, [100, 99, 84, 22, 84]),
    ("bent-2m", Coded, Precise, [100, 99, 84, 5, 84]),
    ("saturated-1.5", Coded, Fast, [100, 99, 32, 63, 84]),
    ("saturated-1.5", Coded, Precise, [100, 99, 32, 63, 84]),
    ("saturated-2.2", Coded, Fast, [53, 99, 70, 84, 84]),
    ("saturated-2.2", Coded, Precise, [53, 99, 70, 84, 84]),
    ("saturated-bloom", Coded, Fast, [36, 99, 24, 43, 67]),
    ("saturated-bloom", Coded, Precise, [36, 99, 43, 48, 68]),
    ("shadow-30", Coded, Fast, [70, 99, 84, 84, 84]),
    ("shadow-30", Coded, Precise, [70, 99, 84, 84, 84]),
    ("shadow-50", Coded, Fast, [11, 74, 84, 84, 84]),
    ("shadow-50", Coded, Precise, [11, 74, 84, 84, 84]),
    ("shadow-60", Coded, Fast, [0, 0, 84, 84, 84]),
    ("shadow-60", Coded, Precise, [0, 0, 84, 71, 84]),
    ("gradient", Coded, Fast, [100, 99, 84, 42, 84]),
    ("gradient", Coded, Precise, [100, 99, 84, 84, 74]),
    ("glare", Coded, Fast, [100, 99, 57, 40, 49]),
    ("glare", Coded, Precise, [100, 99, 84, 72, 84]),
    ("sharpened", Coded, Precise, [100, 99, 55, 84, 84]),
    ("defocus-1.6", Coded, Fast, [100, 99, 72, 36, 67]),
    ("lens-error-0.1", Coded, Fast, [100, 99, 84, 0, 84]),
    ("lens-error-0.1", Coded, Precise, [100, 99, 0, 0, 84]),
    ("r4-real", Coded, Fast, [53, 90, 56, 45, 84]),
    ("r4-real", Coded, Precise, [53, 90, 53, 42, 84]),
];

/// An entry of [`MISSES`] that is exceeded by more must be tightened.
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
                problems.push(format!("{about}: reaches the aim, and must leave the list"));
            } else if listed.is_some_and(|bar| is_loose(bar, &shares)) {
                problems.push(format!("{about}: better than listed, tighten it"));
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
const COSTLY: &[(&str, [f64; 2])] = &[];

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
