//! `roundel calibrate`: lenses, from views of a board; and where all cameras stand, from robots that drive about.

mod coverage;
mod files;
mod lens;
mod moving;
mod output;
mod print;
mod views;

use std::{io, path::PathBuf, process::ExitCode, time::Duration};

use anyhow::{Context, bail};
use clap::{Args, Subcommand, ValueEnum};
use futures::StreamExt;
use indicatif::{ProgressBar, ProgressStyle};
use roundel_client::{Client, Messages};
use roundel_proto::v1;

use super::serve::Signals;
use crate::{
    app::serve::Server,
    fusion::calibration::{DEFAULT_DURATION_S, DURATION_RANGE_S},
    model::config::Config,
};

/// Exit code of what a signal ended.
const ENDED_BY_SIGNAL: u8 = 130;
/// Parts of the bar.
const BAR: u64 = 1000;

/// Find out lenses, and where cameras stand.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    roundel calibrate lens --output north.yaml v4l2:/dev/video0\n  \
    roundel calibrate arena --config lab.toml")]
pub struct CalibrateArgs {
    #[command(subcommand)]
    what: CalibrateCommand,
}

#[derive(Debug, Subcommand)]
enum CalibrateCommand {
    Lens(lens::LensArgs),
    Arena(ArenaArgs),
}

/// Find all cameras' poses from robots that drive about, and at least three reference roundels that one
/// camera sees.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    roundel calibrate arena                               the server on this machine\n  \
    roundel calibrate arena --server http://arena:7670 --seconds 120\n  \
    roundel calibrate arena --config lab.toml             no server runs: opens the cameras itself\n\n\
    Robots should drive across every place where views of cameras overlap; those without codes are told apart\n\
    by how they move, so they must not all move alike. Other cameras need not see the references. A running\n\
    server loses no track: its cameras take the result over between two frames. It is kept beside the\n\
    configuration, lab.calibration.toml for lab.toml.\n\n\
    Columns: moved: from where the camera was taken to stand; deviation: of its place and of its rotation,\n\
    rms over the axes; error: of roundels' centres, rms; ratio: errors over what detections state, 1 if all\n\
    is right; seen: share of the image in which roundels were seen; clock: what its stamps are ahead of those\n\
    of the camera that sees the references.")]
struct ArenaArgs {
    /// Address of the running server
    #[arg(
        long,
        value_name = "URL",
        default_value = "http://127.0.0.1:7670",
        conflicts_with = "config"
    )]
    server: String,
    /// The installation's TOML file, if no server runs
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// How long to record
    #[arg(long, value_name = "SECONDS", default_value_t = DEFAULT_DURATION_S, value_parser = seconds)]
    seconds: f64,
    /// Estimate focal lengths, principal points and the first radial coefficients, too
    #[arg(long)]
    refine_lenses: bool,
    /// Whether cameras take the result over
    #[arg(long, value_enum, default_value_t = ApplyArg::IfSound)]
    apply: ApplyArg,
    /// How to print the report
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ApplyArg {
    /// Unless a finding is grave
    IfSound,
    /// In any case
    Always,
    /// Only look
    Never,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// A table, and findings in sentences
    Table,
    /// The report as REST gives it, one line
    Json,
}

fn seconds(text: &str) -> Result<f64, String> {
    let [least, most] = DURATION_RANGE_S;
    let seconds = text.parse().ok().filter(|seconds| (least..=most).contains(seconds));
    seconds.ok_or_else(|| format!("expected {least} to {most} seconds, found `{text}`"))
}

/// Calibrates, and prints the report; 1 if cameras do not take over what they were to.
pub(super) async fn run(arguments: CalibrateArgs) -> anyhow::Result<ExitCode> {
    let arguments = match arguments.what {
        CalibrateCommand::Arena(arguments) => arguments,
        // It waits for pictures and computes.
        CalibrateCommand::Lens(arguments) => {
            return tokio::task::block_in_place(|| run_lens(&arguments));
        }
    };
    let Some(path) = &arguments.config else {
        let client = Client::connect(&arguments.server).await?;
        return calibrate(&client, &arguments).await;
    };
    let mut config = Config::load(path)?;
    // Nobody else is to use it.
    config.server.listen = ([127, 0, 0, 1], 0).into();
    let server = Server::start(config).await?;
    let client = Client::connect(&format!("http://{}", server.local_addr())).await?;
    let outcome = calibrate(&client, &arguments).await;
    server.shutdown().await;
    outcome
}

async fn calibrate(client: &Client, arguments: &ArenaArgs) -> anyhow::Result<ExitCode> {
    let mut signals = Signals::listen()?;
    let apply = match arguments.apply {
        ApplyArg::IfSound => v1::CalibrationApply::IfSound,
        ApplyArg::Always => v1::CalibrationApply::Always,
        ApplyArg::Never => v1::CalibrationApply::Never,
    };
    client
        .start_calibration(v1::StartCalibrationRequest {
            seconds: Some(arguments.seconds),
            refine_lenses: arguments.refine_lenses,
            apply: apply.into(),
        })
        .await?;
    let mut changes = client.watch_calibration().await?;
    let done = tokio::select! {
        done = follow(&mut changes) => done?,
        () = signals.next() => {
            client.cancel_calibration().await?;
            eprintln!("cancelled; nothing has changed");
            return Ok(ExitCode::from(ENDED_BY_SIGNAL));
        }
    };
    let Some(report) = &done.report else { bail!("{}", done.error) };
    let mut stdout = io::stdout().lock();
    match arguments.format {
        Format::Json => print::json(&mut stdout, &done)?,
        Format::Table => print::table(&mut stdout, &done, report)?,
    }
    if !done.error.is_empty() {
        bail!("{}", done.error);
    }
    let is_as_wanted = apply == v1::CalibrationApply::Never || done.applied_version > 0;
    Ok(if is_as_wanted { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Shows how far it is until it is over.
async fn follow(changes: &mut Messages<v1::Calibration>) -> anyhow::Result<v1::Calibration> {
    let bar = ProgressBar::new(BAR);
    let style = ProgressStyle::with_template("{prefix:>9} [{bar:30}] {msg}");
    bar.set_style(style.context("the progress bar's template is wrong")?.progress_chars("=> "));
    let mut told = v1::CalibrationStage::Unspecified;
    while let Some(calibration) = changes.next().await {
        let calibration = calibration?;
        let stage = calibration.stage();
        if stage != told && bar.is_hidden() {
            // No terminal: a line for each stage.
            print::stage(&calibration);
        }
        told = stage;
        match stage {
            v1::CalibrationStage::Recording => {
                let share = calibration.recorded_s / calibration.seconds.max(1e-3);
                bar.set_prefix("recording");
                bar.set_position((share * BAR as f64) as u64);
                bar.set_message(print::recorded(&calibration));
            }
            v1::CalibrationStage::Solving => {
                bar.set_prefix("solving");
                bar.set_position(BAR);
                bar.set_message(format!("step {}", calibration.steps));
                bar.enable_steady_tick(Duration::from_millis(200));
            }
            v1::CalibrationStage::Done | v1::CalibrationStage::Failed => {
                bar.finish_and_clear();
                return Ok(calibration);
            }
            v1::CalibrationStage::Idle | v1::CalibrationStage::Unspecified => {}
        }
    }
    bail!("the server ended before the calibration did")
}

/// Calibrates a lens from pictures or a stream, or from a recording of a moving camera.
fn run_lens(arguments: &lens::LensArgs) -> anyhow::Result<ExitCode> {
    // Before a camera is opened.
    if let Some(file) = arguments.output() {
        output::check(file)?;
    }
    match arguments.recorded_camera() {
        Some((file, camera)) => moving::run(arguments, file, camera),
        None => lens::run(arguments),
    }
}
