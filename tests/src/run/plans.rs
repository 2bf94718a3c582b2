//! Predictions of `roundel plan` compared with simulation: range and precision of random set-ups, or times on this
//! machine. Predictions that are off by more than their bar are marked with `!` and make the run fail.

use std::process::ExitCode;

use roundel_core::marker::Pattern;
use roundel_server::lab::plan::timing::TimingCase;
use roundel_tests::{
    plans::{
        Pair, compare,
        times::{Timed, times},
    },
    precision::MODES,
};

use super::exit_code;

/// Roundels at each distance, and for the errors of each set-up. 400 give the rms to 1/28, and to about a tenth for
/// small roundels, whose rms a few pictures with the wrong normal decide.
const REACHES: usize = 20;
const SHOTS: usize = 400;
/// Largest relative errors of predictions.
const DISTANCE_SHARE: f64 = 0.10;
const PRECISION_SHARE: f64 = 0.30;
const TIME_SHARE: f64 = 0.30;

#[derive(clap::Args)]
pub struct Options {
    /// Random set-ups
    #[arg(default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    set_ups: u64,
    /// Compare times per frame instead
    #[arg(long, conflicts_with = "set_ups")]
    times: bool,
}

pub fn run(options: &Options) -> anyhow::Result<ExitCode> {
    let holds =
        if options.times { report_times(&times()?) } else { report_set_ups(options.set_ups) };
    if !holds {
        eprintln!("error: some predictions miss their bar (marked with !)");
    }
    Ok(exit_code(holds))
}

fn report_times(all: &[Timed]) -> bool {
    println!(
        "  mode    | megapixels  roundels         px  px a frame  searched | measured ms  plan/measured"
    );
    let is_coded = |case: &TimingCase| matches!(case.kind.pattern, Pattern::Coded(_));
    for (case, searched_share, pair) in all {
        println!(
            "{:9} | {:10.2}  {:8}  {:6} {:3.0}  {:10.1}  {:8} | {:11.3}  {:12.2}{}",
            format!("{:?}", case.mode),
            (case.size.0 * case.size.1) as f64 * 1e-6,
            case.roundels,
            if is_coded(case) { "coded" } else { "" },
            case.diameter_px,
            case.motion_px,
            if *searched_share > 0.0 { "yes" } else { "" },
            pair.simulated * 1e3,
            pair.ratio(),
            mark(pair, TIME_SHARE)
        );
    }
    for mode in MODES {
        for (name, coded) in [("plain", false), ("coded", true)] {
            for (what, share) in [("tracked", 0.0), ("searched", 1.0)] {
                let is_selected = |(case, searched_share, _): &&Timed| {
                    (is_coded(case), *searched_share, case.mode) == (coded, share, mode)
                };
                let pairs: Vec<Pair> =
                    all.iter().filter(is_selected).map(|(.., pair)| *pair).collect();
                report(&format!("time, {mode:?}, {name}, {what}"), &pairs, TIME_SHARE);
            }
        }
    }
    let pairs: Vec<Pair> = all.iter().map(|(.., pair)| *pair).collect();
    report("time in all", &pairs, TIME_SHARE)
}

fn report_set_ups(count: u64) -> bool {
    println!(
        "  mode    | picture    f px | outer mm ratio tilt | noise blur contrast | farthest m  plan/sim | \
         px    | depth mm  plan/sim | across mm  plan/sim"
    );
    let mut all: [Vec<Pair>; 3] = Default::default();
    let mut holds = true;
    for (set_up, reach, errors) in compare(count, REACHES, SHOTS) {
        let camera = &set_up.camera;
        let imaging = &set_up.imaging;
        let reach = match reach {
            Ok(reach) => reach,
            Err(error) => {
                println!("{error}");
                holds = false;
                continue;
            }
        };
        println!(
            "{:9} | {:4}x{:4} {:6.0} | {:8.0} {:5.2} {:4.0} | {:5.1} {:4.2} {:8.0} | {:10.2} {:9.3}{} | {:5.1} | {:8.3} {:9.2}{} | {:9.4} {:9.2}{} {}",
            format!("{:?}", set_up.mode),
            camera.width,
            camera.height,
            camera.focal_px[0],
            set_up.outer_m * 1e3,
            set_up.ratio,
            set_up.tilt_rad.to_degrees(),
            imaging.noise,
            imaging.blur_px,
            imaging.white - imaging.black,
            reach.simulated,
            reach.ratio(),
            mark(&reach, DISTANCE_SHARE),
            set_up.diameter_px,
            errors.depth_m.simulated * 1e3,
            errors.depth_m.ratio(),
            mark(&errors.depth_m, PRECISION_SHARE),
            errors.across_m.simulated * 1e3,
            errors.across_m.ratio(),
            mark(&errors.across_m, PRECISION_SHARE),
            if errors.missed > 0 { format!("{} missed", errors.missed) } else { String::new() },
        );
        all[0].push(reach);
        all[1].push(errors.depth_m);
        all[2].push(errors.across_m);
    }
    let [reaches, depths, acrosses] = &all;
    holds &= report("farthest distance", reaches, DISTANCE_SHARE);
    holds &= report("error along the line of sight (3D)", depths, PRECISION_SHARE);
    holds &= report("error across it (2D)", acrosses, PRECISION_SHARE);
    holds
}

fn mark(pair: &Pair, share: f64) -> char {
    if pair.holds(share) { ' ' } else { '!' }
}

/// Prints a summary, and returns whether all predictions are within the share.
fn report(what: &str, pairs: &[Pair], share: f64) -> bool {
    let within = pairs.iter().filter(|pair| pair.holds(share)).count();
    let mut ratios: Vec<f64> = pairs.iter().map(Pair::ratio).collect();
    ratios.sort_by(f64::total_cmp);
    let (Some(min), Some(max)) = (ratios.first(), ratios.last()) else { return true };
    println!(
        "{what}: {within} of {} within {:.0} %; plan over simulation {min:.2} to {max:.2}, median {:.2}",
        pairs.len(),
        share * 100.0,
        ratios[ratios.len() / 2]
    );
    within == pairs.len()
}
