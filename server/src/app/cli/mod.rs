//! The commands of `roundel`.

mod calibrate;
#[cfg(all(target_os = "linux", target_pointer_width = "64"))]
mod cameras;
mod connection;
mod demo;
mod detect;
mod eval;
mod ground_truth;
pub mod info;
mod log;
mod node;
mod plan;
mod print;
mod record;
mod replay;
mod serve;
mod signals;
mod token;
mod watch;

use std::{
    fs::{self, File},
    io::{self, Write as _},
    path::Path,
    process::ExitCode,
};

use anyhow::Context;
use clap::{
    Parser, Subcommand, ValueEnum,
    builder::{PossibleValue, PossibleValuesParser, TypedValueParser},
};
use indicatif::{ProgressBar, ProgressStyle};
use roundel_core::{camera::MAX_SIDE_PX, marker::Mode};
use serde::Serialize;

use crate::lab::print::spec;

/// Async tasks only forward bytes; detection and fusion run on their own threads.
const ASYNC_THREADS: usize = 2;

/// Localizes robots with printed roundels and cameras.
#[derive(Debug, Parser)]
#[command(name = "roundel", version, about, arg_required_else_help = true)]
#[command(after_help = "Try it without a camera:\n  roundel demo")]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::DemoArgs),
    Serve(serve::ServeArgs),
    Node(node::NodeArgs),
    Detect(detect::DetectArgs),
    Watch(watch::WatchArgs),
    Calibrate(calibrate::CalibrateArgs),
    Plan(plan::PlanArgs),
    Print(print::PrintArgs),
    Record(record::RecordArgs),
    Info(info::InfoArgs),
    Replay(replay::ReplayArgs),
    Eval(eval::EvalArgs),
    Token(token::TokenArgs),
    #[cfg(all(target_os = "linux", target_pointer_width = "64"))]
    Cameras(cameras::CamerasArgs),
}

/// Format of a report.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Text
    Table,
    /// JSON, for programs
    Json,
}

impl Format {
    fn print<T: Serialize>(
        self,
        report: &T,
        table: impl FnOnce(&T) -> String,
    ) -> anyhow::Result<()> {
        print(&match self {
            Self::Table => table(report),
            Self::Json => serde_json::to_string_pretty(report)? + "\n",
        })
    }
}

/// Modes of the detector.
const MODES: [(&str, Mode, &str); 2] = [
    ("precise", Mode::Precise, "Rims and poses fitted to the grey levels"),
    ("fast", Mode::Fast, "Rims from moments, poses in closed form"),
];

/// Parses a number within bounds.
fn number(text: &str, [least, most]: [f64; 2]) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| (least..=most).contains(number));
    number.ok_or_else(|| format!("expected {least} to {most}, found `{text}`"))
}

/// A parser for the words of a table with their values and help texts.
fn words<T: Copy + Send + Sync>(
    table: &'static [(&'static str, T, &'static str)],
) -> impl TypedValueParser<Value = T> {
    let possible = table.iter().map(|(word, _, help)| PossibleValue::new(*word).help(*help));
    PossibleValuesParser::new(possible).try_map(|text| {
        let known = table.iter().find(|(word, ..)| *word == text);
        known.map(|(_, value, _)| *value).ok_or("unknown word")
    })
}

/// Writes to the standard output and flushes it.
fn print(text: &str) -> anyhow::Result<()> {
    let mut stdout = io::stdout().lock();
    let written = stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush());
    written.context("cannot write to the standard output")
}

/// A progress bar with that many steps, or a spinner, on stderr; hidden where that is no terminal.
fn progress_bar(steps: Option<u64>, template: &str) -> anyhow::Result<ProgressBar> {
    let bar = steps.map_or_else(ProgressBar::new_spinner, ProgressBar::new);
    bar.set_style(ProgressStyle::with_template(template)?.progress_chars("=> "));
    Ok(bar)
}

/// Runs the command of the process's arguments. Errors go to stderr. The exit code is 0 for success, 1 for failure, 2 for
/// invalid arguments.
pub fn main() -> ExitCode {
    let arguments = Arguments::parse();
    log::start();
    let outcome = match arguments.command {
        Command::Demo(arguments) => run_async(demo::run(arguments)),
        Command::Serve(arguments) => run_async(serve::run(arguments)),
        Command::Node(arguments) => run_async(node::run(arguments)),
        Command::Detect(arguments) => detect::run(&arguments),
        Command::Watch(arguments) => run_async(watch::run(arguments)),
        Command::Calibrate(arguments) => run_async(calibrate::run(arguments)),
        Command::Plan(arguments) => plan::run(&arguments),
        Command::Print(arguments) => print::run(&arguments),
        Command::Record(arguments) => run_async(record::run(arguments)),
        Command::Info(arguments) => info::run(&arguments),
        Command::Eval(arguments) => eval::run(&arguments),
        Command::Token(arguments) => token::run(&arguments),
        Command::Replay(arguments) => run_async(replay::run(arguments)),
        #[cfg(all(target_os = "linux", target_pointer_width = "64"))]
        Command::Cameras(arguments) => cameras::run(&arguments),
    };
    log::finish();
    outcome.unwrap_or_else(|error| {
        eprintln!("error: {}", error_chain(&error));
        ExitCode::FAILURE
    })
}

/// The error, followed by the causes that its text does not already include.
fn error_chain(error: &anyhow::Error) -> String {
    let mut text = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !text.contains(&cause) {
            text += &format!(": {cause}");
        }
    }
    text
}

/// Checks whether a file can be written, without changing anything. Called before long work that writes it.
fn check_writable(path: &Path) -> io::Result<()> {
    match File::options().write(true).create_new(true).open(path) {
        Ok(_) => fs::remove_file(path),
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => Err(error),
        // Opening a pipe would wait for its reader.
        Err(_) if !path.is_file() && !path.is_dir() => Ok(()),
        Err(_) => File::options().write(true).open(path).map(drop),
    }
}

/// Parses columns and rows of pictures.
fn size(text: &str) -> Result<(usize, usize), String> {
    let is_side = |side: &usize| (1..=MAX_SIDE_PX).contains(side);
    let size = spec::sides(text).ok().filter(|(width, height)| is_side(width) && is_side(height));
    size.ok_or_else(|| {
        format!(
            "expected a size such as 1280x720, at most {MAX_SIDE_PX} pixels a side, found `{text}`"
        )
    })
}

fn run_async(command: impl Future<Output = anyhow::Result<ExitCode>>) -> anyhow::Result<ExitCode> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(ASYNC_THREADS)
        .enable_all()
        .build()?;
    let outcome = runtime.block_on(command);
    // Does not wait for blocking work of clients that did not end in time.
    runtime.shutdown_background();
    outcome
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn a_cause_is_printed_once() {
        let cause = anyhow::anyhow!("no such file").context("cannot read a.png: no such file");
        assert_eq!(error_chain(&cause), "cannot read a.png: no such file");
        let cause = anyhow::anyhow!("no such file").context("a.png");
        assert_eq!(error_chain(&cause), "a.png: no such file");
    }

    #[test]
    fn a_writable_path_is_recognized_without_creating_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.toml");
        check_writable(&file).unwrap();
        assert!(!file.exists());
        fs::write(&file, "kept").unwrap();
        check_writable(&file).unwrap();
        assert_eq!(fs::read(&file).unwrap(), b"kept");
        assert!(check_writable(folder.path()).is_err() && check_writable(&file.join("b")).is_err());
    }

    #[test]
    fn sizes_are_two_sides_within_bounds() {
        assert_eq!(size("1920x1080"), Ok((1920, 1080)));
        for wrong in ["1920", "x1080", "1920x0", "0x1080", "1920x99999", "1920x1080x3", "-1x5"] {
            let error = size(wrong).unwrap_err();
            assert!(error.contains("such as 1280x720") && error.contains(wrong), "{error}");
        }
    }

    #[test]
    fn every_command_is_well_formed_and_has_an_example() {
        let mut command = Arguments::command();
        command.clone().debug_assert();
        for command in command.get_subcommands_mut() {
            let help = command.render_long_help().to_string();
            assert!(help.contains("Example"), "{} has no example:\n{help}", command.get_name());
        }
    }
}
