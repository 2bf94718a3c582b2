//! The commands of `roundel`.

mod calibrate;
#[cfg(all(target_os = "linux", target_pointer_width = "64"))]
mod cameras;
mod demo;
mod detect;
mod eval;
mod ground_truth;
mod info;
mod node;
mod plan;
mod print;
mod record;
mod replay;
mod serve;
mod watch;

use std::{
    fs::{self, File},
    io::{self, IsTerminal, stderr},
    path::Path,
    process::ExitCode,
};

use clap::{Parser, Subcommand};
use roundel_core::camera::MAX_SIDE_PX;
use tracing_subscriber::EnvFilter;

/// Async tasks only pass bytes on; detection and fusion have threads of their own.
const ASYNC_THREADS: usize = 2;

/// What is logged where RUST_LOG does not say. The finder of ChArUco boards warns of each picture without one.
const LOG: &str = "info,calib_targets_charuco=error";

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
    #[cfg(all(target_os = "linux", target_pointer_width = "64"))]
    Cameras(cameras::CamerasArgs),
}

/// Runs the command that the process was started with. Errors go to stderr; the code is 0 for
/// success, 1 for failure, 2 for wrong arguments.
pub fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(LOG));
    let colors = stderr().is_terminal();
    tracing_subscriber::fmt().with_env_filter(filter).with_ansi(colors).with_writer(stderr).init();
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
        Command::Replay(arguments) => run_async(replay::run(arguments)),
        #[cfg(all(target_os = "linux", target_pointer_width = "64"))]
        Command::Cameras(arguments) => cameras::run(&arguments),
    };
    outcome.unwrap_or_else(|error| {
        eprintln!("error: {}", error_chain(&error));
        ExitCode::FAILURE
    })
}

/// The error with its causes, each said once: many name their cause in their own words already.
fn error_chain(error: &anyhow::Error) -> String {
    error.chain().map(ToString::to_string).fold(String::new(), |told, cause| {
        if told.is_empty() {
            cause
        } else if told.contains(&cause) {
            told
        } else {
            format!("{told}: {cause}")
        }
    })
}

/// Whether a file can be written there, before long work is done for it; leaves everything as it is.
fn check_writable(path: &Path) -> io::Result<()> {
    match File::options().write(true).create_new(true).open(path) {
        Ok(_) => fs::remove_file(path),
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => Err(error),
        // A pipe is not opened: that would wait for who reads it.
        Err(_) if !path.is_file() && !path.is_dir() => Ok(()),
        Err(_) => File::options().write(true).open(path).map(drop),
    }
}

/// Columns and rows of pictures.
fn size(text: &str) -> Result<(usize, usize), String> {
    let side =
        |side: &str| side.trim().parse().ok().filter(|side| (1..=MAX_SIDE_PX).contains(side));
    let sides = text.split_once('x').and_then(|(w, h)| Some((side(w)?, side(h)?)));
    sides.ok_or_else(|| {
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
    // What is left is blocking work of clients that did not end in time.
    runtime.shutdown_background();
    outcome
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn a_cause_is_said_once() {
        let cause = anyhow::anyhow!("no such file").context("cannot read a.png: no such file");
        assert_eq!(error_chain(&cause), "cannot read a.png: no such file");
        let cause = anyhow::anyhow!("no such file").context("a.png");
        assert_eq!(error_chain(&cause), "a.png: no such file");
    }

    #[test]
    fn where_a_file_may_go_is_told_without_leaving_one() {
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
