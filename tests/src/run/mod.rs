//! Subcommands of `roundel-tests`, one module each: options, the run, and its table.

pub mod chaos;
pub mod codes;
pub mod compare_scenes;
pub mod conditions;
pub mod curves;
pub mod dashboard_load;
pub mod healing;
pub mod lab;
pub mod lenses;
pub mod paper;
pub mod plans;
pub mod recall;
pub mod scenarios;
pub mod soak;
pub mod survey;

use std::process::ExitCode;

/// How a run ends, given whether all its bars were met.
fn exit_code(holds: bool) -> ExitCode {
    if holds { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Parses a duration in any unit.
fn positive(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(number) if number > 0.0 => Ok(number),
        _ => Err("expected a number above 0".into()),
    }
}
