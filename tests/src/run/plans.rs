//! The plan's predictions beside simulation: `cargo run --release -p roundel-tests --bin plans -- [SET-UPS]`, and of
//! time on this machine: `… -- times`. It ends with an error where a prediction is off by more than it may be.

use std::process::ExitCode;

use roundel_core::marker::Pattern;
use roundel_server::lab::plan::timing::TimingCase;
use roundel_tests::{
    plans::{
        Pair, compare,
        loads::{Timed, times},
    },
    precision::MODES,
};

/// Roundels at each distance, and for the errors of each set-up: of so many the rms is itself known to a 28th, and of
/// small ones, which rare pictures with the wrong normal decide, still to about a tenth.
const REACHES: usize = 20;
const SHOTS: usize = 400;
/// What the plan may be off by.
const DISTANCE_SHARE: f64 = 0.10;
const PRECISION_SHARE: f64 = 0.30;
const TIME_SHARE: f64 = 0.30;

fn main() -> ExitCode {
    let argument = std::env::args().nth(1);
    if argument.as_deref() == Some("times") {
        return timed();
    }
    match argument.as_deref().map_or(Ok(100), str::parse::<u64>) {
        Ok(count) if count > 0 => planned(count),
        _ => {
            eprintln!("expected a number of set-ups, such as 100, or times");
            ExitCode::from(2)
        }
    }
}

fn timed() -> ExitCode {
    match times() {
        Ok(all) => ended(timed_ones(&all)),
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// How the program ends, by whether all was held.
fn ended(all_held: bool) -> ExitCode {
    if all_held {
        return ExitCode::SUCCESS;
    }
    eprintln!(
        "error: not all that was foretold came out within what it may be off by (marked with !)"
    );
    ExitCode::FAILURE
}

/// Whether all are within what they may be off by.
fn timed_ones(all: &[Timed]) -> bool {
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
            for (what, share) in [("followed", 0.0), ("searched", 1.0)] {
                let is_one = |(case, searched_share, _): &&Timed| {
                    (is_coded(case), *searched_share, case.mode) == (coded, share, mode)
                };
                let pairs: Vec<Pair> = all.iter().filter(is_one).map(|(.., pair)| *pair).collect();
                told(&format!("time, {mode:?}, {name}, {what}"), &pairs, TIME_SHARE);
            }
        }
    }
    let pairs: Vec<Pair> = all.iter().map(|(.., pair)| *pair).collect();
    told("time in all", &pairs, TIME_SHARE)
}

fn planned(count: u64) -> ExitCode {
    println!(
        "  mode    | picture    f px | outer mm ratio tilt | noise blur contrast | farthest m  plan/sim | \
         px    | depth mm  plan/sim | across mm  plan/sim"
    );
    let mut all: [Vec<Pair>; 3] = Default::default();
    let mut all_held = true;
    for (set_up, reach, errors) in compare(count, (REACHES, SHOTS)) {
        let camera = &set_up.camera;
        let imaging = &set_up.imaging;
        let reach = match reach {
            Ok(reach) => reach,
            Err(error) => {
                println!("{error}");
                all_held = false;
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
    all_held &= told("farthest distance", reaches, DISTANCE_SHARE);
    all_held &= told("error along the line of sight (3D)", depths, PRECISION_SHARE);
    all_held &= told("error across it (2D)", acrosses, PRECISION_SHARE);
    ended(all_held)
}

fn mark(pair: &Pair, share: f64) -> char {
    if pair.holds(share) { ' ' } else { '!' }
}

/// Whether all are within the share.
fn told(what: &str, pairs: &[Pair], share: f64) -> bool {
    let held = pairs.iter().filter(|pair| pair.holds(share)).count();
    let mut ratios: Vec<f64> = pairs.iter().map(Pair::ratio).collect();
    ratios.sort_by(f64::total_cmp);
    let (Some(least), Some(most)) = (ratios.first(), ratios.last()) else { return true };
    println!(
        "{what}: {held} of {} within {:.0} %; plan over simulation {least:.2} to {most:.2}, median {:.2}",
        pairs.len(),
        share * 100.0,
        ratios[ratios.len() / 2]
    );
    held == pairs.len()
}
