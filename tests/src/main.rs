//! Runs that take longer than a test: tables of scenarios scored against ground truth, servers under faults, and input
//! for other tools. `cargo run --release -p roundel-tests -- --help` lists them; `tests/README.md` has their durations.

mod run;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(name = "roundel-tests", about = "Runs scenarios, prints tables, and checks them")]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Fusion in simulated arenas
    Scenarios(run::scenarios::Options),
    /// Detection and correction of bumped and drifting cameras
    Healing(run::healing::Options),
    /// Calibration of arenas from robots that drive about
    Survey(run::survey::Options),
    /// Lens calibration from rendered views of a board
    Lenses(run::lenses::Options),
    /// Predictions of `roundel plan` compared with simulation
    Plans(run::plans::Options),
    /// The experiments of the WhyCon paper, as Markdown
    Paper(run::paper::Options),
    /// Servers under seeded faults
    Chaos(run::chaos::Options),
    /// Days of operation in minutes
    Soak(run::soak::Options),
    /// Roundels found among look-alikes, and false detections in clutter
    Recall(run::recall::Options),
    /// Coded roundels read rightly and wrongly
    Codes(run::codes::Options),
    /// Roundels as printers, lamps, lenses and cameras show them
    Conditions(run::conditions::Options),
    /// R4 under lab realism, from pixels to fusion
    Lab(run::lab::Options),
    /// Draws the curves of core/docs/detector.md
    Curves(run::curves::Options),
    /// Renders the scenes of tests/compare/run and tests/compare/fmac
    CompareScenes(run::compare_scenes::Options),
    /// A server with simulated objects, for measuring the dashboard
    DashboardLoad(run::dashboard_load::Options),
}

fn main() -> anyhow::Result<ExitCode> {
    match Arguments::parse().command {
        Command::Scenarios(options) => Ok(run::scenarios::run(&options)),
        Command::Healing(options) => Ok(run::healing::run(&options)),
        Command::Survey(options) => Ok(run::survey::run(&options)),
        Command::Lenses(options) => run::lenses::run(&options),
        Command::Plans(options) => run::plans::run(&options),
        Command::Paper(options) => Ok(run::paper::run(&options)),
        Command::Chaos(options) => run::chaos::run(&options),
        Command::Soak(options) => run::soak::run(&options),
        Command::Recall(options) => Ok(run::recall::run(&options)),
        Command::Codes(options) => Ok(run::codes::run(&options)),
        Command::Conditions(options) => Ok(run::conditions::run(&options)),
        Command::Lab(options) => run::lab::run(&options).map(|()| ExitCode::SUCCESS),
        Command::Curves(options) => run::curves::run(&options),
        Command::CompareScenes(options) => run::compare_scenes::run(&options),
        Command::DashboardLoad(options) => run::dashboard_load::run(&options),
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn arguments_are_consistent() {
        Arguments::command().debug_assert();
    }
}
