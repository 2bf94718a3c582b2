//! What prints, light, lenses and cameras do to detection, as a table: found, followed, errors over the bound, share
//! inside the stated 95 %, and cost relative to `plain` in the same run. No bar.

use std::{io::Write, process::ExitCode, time::Instant};

use clap::builder::PossibleValuesParser;
use roundel_core::marker::Mode;
use roundel_tests::{
    conditions::{
        Condition, Marker, all,
        cost::{Cost, Picture, cost},
        score::Summary,
        trial::summaries,
    },
    precision::MODES,
};

/// Outer diameters.
const SIZES_PX: [f64; 5] = [15.0, 20.0, 36.0, 72.0, 110.0];
const SHORT_SIZES_PX: [f64; 2] = [20.0, 36.0];
/// Diameters at which the cost is measured.
const COST_SIZES_PX: [f64; 2] = [36.0, 72.0];

#[derive(clap::Args)]
pub struct Options {
    /// Conditions; all by default
    #[arg(value_parser = PossibleValuesParser::new(all().into_iter().map(|one| one.name)))]
    names: Vec<String>,
    /// Two sizes, few trials, no times
    #[arg(long)]
    short: bool,
    /// One mode instead of both
    #[arg(long, value_enum)]
    mode: Option<ModeName>,
    /// Coded roundels only
    #[arg(long, conflicts_with = "plain")]
    coded: bool,
    /// Plain roundels only
    #[arg(long)]
    plain: bool,
    /// Trials of each row [default: 20, 8 with --short]
    #[arg(long)]
    trials: Option<usize>,
}

#[derive(Clone, Copy, Debug, PartialEq, clap::ValueEnum)]
enum ModeName {
    Precise,
    Fast,
}

impl Options {
    fn markers(&self) -> Vec<Marker> {
        let is_selected = |marker: &Marker| match marker {
            Marker::Plain => !self.coded,
            Marker::Coded => !self.plain,
        };
        [Marker::Plain, Marker::Coded].into_iter().filter(is_selected).collect()
    }

    fn has_mode(&self, mode: Mode) -> bool {
        self.mode.is_none_or(|name| (name == ModeName::Precise) == (mode == Mode::Precise))
    }
}

pub fn run(options: &Options) -> ExitCode {
    let started = Instant::now();
    let selected: Vec<Condition> = all()
        .into_iter()
        .filter(|one| options.names.is_empty() || options.names.iter().any(|it| it == one.name))
        .collect();
    let sizes_px: &[f64] = if options.short { &SHORT_SIZES_PX } else { &SIZES_PX };
    let trials = options.trials.unwrap_or(if options.short { 8 } else { 20 });
    println!(
        "condition       | print | mode    |  px | found %, followed %, false | depth: error, stated \
         / bound | inside 95 %: depth, position, normal | cost"
    );
    for marker in options.markers() {
        for &diameter_px in sizes_px {
            let measures_cost = !options.short && COST_SIZES_PX.contains(&diameter_px);
            let plain =
                measures_cost.then(|| Picture::new(&Condition::plain(), marker, diameter_px));
            for condition in &selected {
                let summaries = summaries(condition, marker, diameter_px, trials);
                let picture = plain
                    .as_ref()
                    .map(|plain| (plain, Picture::new(condition, marker, diameter_px)));
                for (mode, summary) in MODES.into_iter().zip(&summaries) {
                    if options.has_mode(mode) {
                        let cost = picture.as_ref().map(|(plain, own)| cost(own, plain, mode));
                        let row = row(summary, cost);
                        println!(
                            "{:15} | {} | {:7} | {diameter_px:3} | {row}",
                            condition.name,
                            marker.name(),
                            format!("{mode:?}"),
                        );
                    }
                }
                // The table takes minutes: show rows at once.
                let _ = std::io::stdout().flush();
            }
        }
    }
    eprintln!("{:.0} s", started.elapsed().as_secs_f64());
    ExitCode::SUCCESS
}

/// A cost is marked where not all roundels are followed, since lost ones are searched for instead.
fn row(summary: &Summary, cost: Option<Cost>) -> String {
    let [depth, position, normal] = summary.inside_shares().map(|share| 100.0 * share);
    let cost = cost.map_or(String::new(), |cost| {
        let work =
            if cost.work.is_nan() { String::new() } else { format!(", work {:.1}", cost.work) };
        let lost = if cost.followed < 0.99 {
            format!(" ({:.0} % followed)", 100.0 * cost.followed)
        } else {
            String::new()
        };
        format!("{:5.1}{work}{lost}", cost.time)
    });
    format!(
        "{:5.1} {:5.1} {:2} | {:7.2} {:7.2} | {depth:5.1} {position:5.1} {normal:5.1} | {cost}",
        100.0 * summary.found_share(),
        100.0 * summary.followed_share(),
        summary.false_detections,
        summary.depth_over_bound(),
        summary.stated_over_bound(),
    )
}
