//! The scenarios of [`roundel_tests::scenario`], scored against ground truth in one table. Progress goes to standard error.

use std::{panic::catch_unwind, process::ExitCode, time::Instant};

use clap::builder::PossibleValuesParser;
use roundel_tests::{
    scenario::{ALL, Length, Row, consistency, table},
    score::Score,
};

use super::exit_code;

#[derive(clap::Args)]
pub struct Options {
    /// Scenarios to run; all by default
    #[arg(value_parser = PossibleValuesParser::new(ALL.map(|(name, _)| name)))]
    names: Vec<String>,
    /// Fewer seconds of each
    #[arg(long)]
    short: bool,
    /// Also print each row's errors and their mean normalized squares, to standard error
    #[arg(long)]
    detail: bool,
}

pub fn run(options: &Options) -> ExitCode {
    let length = if options.short { Length::Short } else { Length::Full };
    let mut rows = Vec::new();
    for (name, scenario) in ALL {
        if !options.names.is_empty() && !options.names.iter().any(|selected| selected == name) {
            continue;
        }
        let started = Instant::now();
        let panicked = |_| vec![Row::new(name, "").check("panicked", false)];
        let results = catch_unwind(|| scenario(length)).unwrap_or_else(panicked);
        if options.detail {
            for row in &results {
                let score = row.score.as_ref().map_or(String::new(), Score::to_string);
                eprintln!("{}\n{score}", row.scenario);
            }
        }
        rows.extend(results);
        eprintln!("{name}: {:.1} s", started.elapsed().as_secs_f64());
    }
    rows.push(consistency(&rows));
    print!("{}", table(&rows));
    exit_code(rows.iter().all(Row::holds))
}
