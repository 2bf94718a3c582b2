//! Precision and consistency of single poses, in both modes, compared with the Cramér-Rao bound: `cargo bench -p
//! roundel-tests --bench precision`, a few minutes; with `-- --quick` a few seconds.
//!
//! Depth: rms of error over bound (bar 1.5 from 30 px, 2 from 20, 3 from 12) and bias over rms (bar a third).
//! Covariance: share of errors inside the stated 95 % ellipsoid, of the position and of the five degrees of freedom
//! that a plain roundel has. Normal: median and 95th percentile, of the first of the two normals, wrong ones
//! included, and of the closer one. `!` marks values that miss a bar by more than two standard deviations of the
//! sample, `?` those that miss it by less.

use roundel_tests::precision::{
    MODES, NARROW_MARGIN, RATIO, Range, Summary, Trial, TrialFrame, WIDE_MARGIN, tracked_trials,
};

const SIZES_PX: [(f64, f64); 4] = [(12.0, 20.0), (20.0, 30.0), (30.0, 50.0), (50.0, 110.0)];
const TILTS_DEG: [(f64, f64); 4] = [(0.0, 5.0), (5.0, 20.0), (20.0, 40.0), (40.0, 60.0)];
const BLURS_PX: [(f64, f64); 3] = [(0.5, 0.7), (0.7, 0.9), (0.9, 1.1)];
const NOISES: [(f64, f64); 3] = [(1.0, 2.0), (2.0, 3.0), (3.0, 4.0)];
/// Trials of each size and tilt.
const TRIALS: usize = 250;
const QUICK_TRIALS: usize = 30;
/// Frames until a fit reuses the normal equations of earlier ones.
const LONG: usize = 4;

fn main() {
    let quick = std::env::args().any(|argument| argument == "--quick");
    let count = if quick { QUICK_TRIALS } else { TRIALS };
    let (all, narrow) = (drawn(count, WIDE_MARGIN), drawn(count / 2, NARROW_MARGIN));
    for (index, mode) in MODES.iter().enumerate() {
        println!("\n{mode:?} mode, {} roundels in two frames each", all.len());
        for (frame, name) in ["found by search", "followed"].into_iter().enumerate() {
            println!("\n{name}");
            depths(&all, frame, index, true);
        }
        println!("\nfollowed, the sheet's margin a quarter of the diameter");
        depths(&narrow, 1, index, false);
        normals(&all, index);
    }
    let long = drawn_in(LONG, count, WIDE_MARGIN);
    println!("\nPrecise mode, followed into the fourth frame: products of columns are recalled");
    depths(&long, LONG - 1, 1, false);
}

/// `count` trials of each size and tilt.
fn drawn(count: usize, margin: f64) -> Vec<Trial> {
    drawn_in(2, count, margin)
}

/// The same with this number of frames.
fn drawn_in(frames: usize, count: usize, margin: f64) -> Vec<Trial> {
    let mut all = Vec::new();
    for (cell, diameter_px) in SIZES_PX.into_iter().enumerate() {
        for (column, tilt_deg) in TILTS_DEG.into_iter().enumerate() {
            let (blur_px, noise) = ((0.5, 1.1), (1.0, 4.0));
            let range = Range {
                motion_px: (0.0, 0.0),
                diameter_px,
                tilt_deg,
                blur_px,
                noise,
                margin,
                ratio: RATIO,
            };
            all.extend(tracked_trials(&range, frames, count, (10 * cell + column) as u64));
        }
    }
    all
}

/// A row for each size, and with `split` for each tilt, blur and noise of it.
fn depths(all: &[Trial], frame: usize, mode: usize, split: bool) {
    println!(
        "  size px |              | missed | depth rms %   bound % | over bound | bias/rms | \
         inside 95 %: position, pose"
    );
    for size in SIZES_PX {
        let of_size: Vec<_> = all.iter().filter(|trial| within(trial.diameter_px, size)).collect();
        let row = |name: &str, (low, high): (f64, f64), value: &dyn Fn(&Trial) -> f64| {
            let chosen = of_size.iter().filter(|trial| within(value(trial), (low, high)));
            let summary = Summary::of(chosen.map(|trial| &trial.frames[frame]), mode);
            print_depth(size, &format!("{name} {low}-{high}"), &summary);
        };
        row("all", (0.0, 90.0), &|trial| trial.tilt_deg);
        if !split {
            continue;
        }
        TILTS_DEG.into_iter().for_each(|tilt| row("tilt", tilt, &|trial| trial.tilt_deg));
        BLURS_PX.into_iter().for_each(|blur| row("blur", blur, &|trial| trial.blur_px));
        NOISES.into_iter().for_each(|noise| row("noise", noise, &|trial| trial.noise));
    }
}

fn print_depth(size: (f64, f64), name: &str, summary: &Summary) {
    let count = summary.found().max(1) as f64;
    let (over, bias) = (summary.depth_over_bound(), summary.bias_over_rms());
    let (position, pose) = (summary.position_share(), summary.pose_share());
    let honest = |share: f64| mark((share - 0.95).abs(), 0.03, (0.95 * 0.05 / count).sqrt());
    println!(
        "{:4}-{:<4} | {name:12} | {:6} | {:11.4} {:9.4} | {over:9.2}{} | {bias:+7.2}{} | {:7.1}{} {:7.1}{}",
        size.0,
        size.1,
        summary.missed,
        100.0 * summary.depth_rms(),
        100.0 * summary.depth_bound(),
        mark(over, bar(size.0), over / (2.0 * count).sqrt()),
        mark(bias.abs(), 1.0 / 3.0, 1.0 / count.sqrt()),
        100.0 * position,
        honest(position),
        100.0 * pose,
        honest(pose),
    );
}

/// Whether a value with this standard deviation misses its bar: clearly, possibly, or not.
fn mark(value: f64, bar: f64, deviation: f64) -> char {
    if value > bar + 2.0 * deviation {
        '!'
    } else if value > bar {
        '?'
    } else {
        ' '
    }
}

/// Bar for the depth's rms over its bound.
fn bar(diameter_px: f64) -> f64 {
    match diameter_px {
        size if size >= 30.0 => 1.5,
        size if size >= 20.0 => 2.0,
        _ => 3.0,
    }
}

fn normals(all: &[Trial], mode: usize) {
    println!("\nnormal, degrees; both frames");
    println!(
        "  size px | tilt  | median   p95    | closer: median   p95    | bound  | wrong %, as stated"
    );
    for size in [(12.0, 20.0), (20.0, 40.0), (40.0, 60.0), (60.0, 110.0), (40.0, 110.0)] {
        for tilt in [(20.0, 40.0), (40.0, 60.0), (20.0, 60.0)] {
            let chosen = all
                .iter()
                .filter(|trial| within(trial.diameter_px, size) && within(trial.tilt_deg, tilt));
            let frames: Vec<&TrialFrame> = chosen.flat_map(|trial| &trial.frames).collect();
            let summary = Summary::of(frames, mode);
            let (median, p95) = (summary.normal_deg(0.5), summary.normal_deg(0.95));
            let judged = size.0 >= 40.0;
            println!(
                "{:4}-{:<4} | {}-{} | {median:7.3}{} {p95:7.3}{} | {:14.3} {:7.3} | {:6.3} | {:5.1} {:5.1}",
                size.0,
                size.1,
                tilt.0,
                tilt.1,
                if judged { mark(median, 0.1, 0.0) } else { ' ' },
                if judged { mark(p95, 0.6, 0.0) } else { ' ' },
                summary.closer_deg(0.5),
                summary.closer_deg(0.95),
                summary.normal_bound_deg(),
                100.0 * summary.wrong_normal_share(),
                100.0 * summary.stated_wrong_share(),
            );
        }
    }
}

fn within(value: f64, (low, high): (f64, f64)) -> bool {
    (low..high).contains(&value)
}
