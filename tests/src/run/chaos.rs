//! Runs servers under seeded faults, and exits with 1 if one breaks a promise:
//! `cargo run --release -p roundel-tests --bin chaos -- [--seeds 1000] [--from 1] [--at-once 8] [--process]`. With
//! `--process`, each server is a real process whose disk and clock are disturbed too.

use std::{process::ExitCode, time::Instant};

use roundel_tests::chaos::{self, timetable::Stage};

const USAGE: &str = "expected [--seeds N] [--from SEED] [--at-once N] [--process]";

struct Options {
    seeds: u64,
    from: u64,
    at_once: usize,
    stage: Stage,
}

fn options() -> Option<Options> {
    let mut options = Options { seeds: 100, from: 1, at_once: 0, stage: Stage::Library };
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--process" => options.stage = Stage::Process,
            "--seeds" => options.seeds = arguments.next()?.parse().ok()?,
            "--from" => options.from = arguments.next()?.parse().ok()?,
            "--at-once" => options.at_once = arguments.next()?.parse().ok()?,
            _ => return None,
        }
    }
    if options.at_once == 0 {
        options.at_once = if options.stage == Stage::Library { 8 } else { 4 };
    }
    Some(options)
}

#[tokio::main]
async fn main() -> ExitCode {
    let Some(Options { seeds, from, at_once, stage }) = options() else {
        eprintln!("{USAGE}");
        return ExitCode::from(2);
    };
    let begun = Instant::now();
    let (mut kept, mut broken) = (0, Vec::new());
    let (mut worst_share, mut longest_gap_s, mut stop_s) = (0.0f64, 0.0f64, 0.0f64);
    chaos::run_all(from..from + seeds, stage, at_once, |outcome| {
        worst_share = worst_share.max(outcome.received.worst_share);
        longest_gap_s = longest_gap_s.max(outcome.received.longest_gap_s);
        stop_s = stop_s.max(outcome.stop_s);
        if outcome.is_kept() {
            kept += 1;
        } else {
            println!("{outcome}");
            if seeds == 1 {
                println!("{}", outcome.log);
            }
            broken.push(outcome.seed);
        }
    })
    .await;
    println!(
        "{kept} seeds kept, {} broken {broken:?}, in {:.0} s; largest error {worst_share:.2} of what is allowed, longest \
         gap {longest_gap_s:.1} s, longest stop {stop_s:.1} s",
        broken.len(),
        begun.elapsed().as_secs_f64()
    );
    if broken.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
