//! Servers under seeded faults. With `--process`, each server is a real process whose disk and clock are disturbed too.

use std::{process::ExitCode, time::Instant};

use roundel_tests::chaos::{self, timetable::Stage};

use super::exit_code;

#[derive(clap::Args)]
pub struct Options {
    /// Number of seeds
    #[arg(long, default_value_t = 100)]
    seeds: u64,
    /// First seed
    #[arg(long, default_value_t = 1)]
    from: u64,
    /// Servers that run at the same time; by default 8, or 4 with --process
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    at_once: Option<u64>,
    /// Start each server as a process, and disturb its disk and clock too
    #[arg(long)]
    process: bool,
}

pub fn run(options: &Options) -> anyhow::Result<ExitCode> {
    let stage = if options.process { Stage::Process } else { Stage::Library };
    let at_once = options.at_once.unwrap_or(if options.process { 4 } else { 8 }) as usize;
    let seeds = options.from..options.from + options.seeds;
    let started = Instant::now();
    let (mut kept, mut broken) = (0, Vec::new());
    let (mut worst_share, mut longest_gap_s, mut longest_stop_s) = (0.0f64, 0.0f64, 0.0f64);
    let report = |outcome: chaos::Outcome| {
        worst_share = worst_share.max(outcome.received.worst_share);
        longest_gap_s = longest_gap_s.max(outcome.received.longest_gap_s);
        longest_stop_s = longest_stop_s.max(outcome.stop_s);
        if outcome.is_kept() {
            kept += 1;
        } else {
            println!("{outcome}");
            if options.seeds == 1 {
                println!("{}", outcome.log);
            }
            broken.push(outcome.seed);
        }
    };
    tokio::runtime::Runtime::new()?.block_on(chaos::run_all(seeds, stage, at_once, report));
    println!(
        "{kept} seeds kept all promises, {} broke one {broken:?}, in {:.0} s; largest error {worst_share:.2} of the allowed \
         one, longest gap {longest_gap_s:.1} s, longest stop {longest_stop_s:.1} s",
        broken.len(),
        started.elapsed().as_secs_f64()
    );
    Ok(exit_code(broken.is_empty()))
}
