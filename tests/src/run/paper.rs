//! The paper's experiments, repeated in simulation, as Markdown tables with the paper's figures and ours. Progress goes to
//! standard error. OpenCV comes from PyPI; rows that need it are skipped where it cannot be installed. A row that is
//! worse than the paper's and gives no reason is an error.

use std::{process::ExitCode, time::Instant};

use clap::builder::PossibleValuesParser;
use roundel_tests::paper::{ALL, INTRODUCTION, Length, machine};

use super::exit_code;

/// Name of the text above the tables.
const HEAD: &str = "introduction";

#[derive(clap::Args)]
pub struct Options {
    /// Tables to print; all by default
    #[arg(value_parser = PossibleValuesParser::new(
        [HEAD].into_iter().chain(ALL.into_iter().map(|(name, _)| name))
    ))]
    names: Vec<String>,
    /// Render fewer pictures
    #[arg(long)]
    short: bool,
}

pub fn run(options: &Options) -> ExitCode {
    let length = if options.short { Length::Short } else { Length::Full };
    let is_selected =
        |name: &str| options.names.is_empty() || options.names.iter().any(|it| it == name);
    if is_selected(HEAD) {
        println!("{INTRODUCTION}\n{}", machine());
    }
    let mut holds = true;
    for (name, experiment) in ALL {
        if !is_selected(name) {
            continue;
        }
        let started = Instant::now();
        match experiment(length) {
            Ok(table) => {
                println!("{table}");
                for row in table.rows.iter().filter(|row| row.is_unexcused()) {
                    eprintln!("{name}: {} is worse than the paper's and gives no reason", row.case);
                    holds = false;
                }
            }
            Err(error) => {
                eprintln!("{name}: {error:#}");
                holds = false;
            }
        }
        eprintln!("{name}: {:.1} s", started.elapsed().as_secs_f64());
    }
    exit_code(holds)
}
