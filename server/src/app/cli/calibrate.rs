//! `roundel calibrate`: lenses from views of a board, and poses of all cameras from moving robots.

mod coverage;
mod files;
mod lens;
mod moving;
mod output;
mod print;
mod views;

use std::{path::PathBuf, process::ExitCode, time::Duration};

use anyhow::bail;
use clap::{Args, Subcommand};
use futures::StreamExt;
use roundel_client::{Client, Messages};
use roundel_proto::v1;

use super::{
    Format, connection::ConnectionArgs, number, progress_bar, signals::signal_or_after, words,
};
use crate::{
    app::serve::Server,
    fusion::calibration::{DEFAULT_DURATION_S, DURATION_RANGE_S},
    model::config::Config,
};

/// Exit code of a calibration that a signal ended.
const ENDED_BY_SIGNAL: u8 = 130;
/// Steps of the progress bar.
const BAR: u64 = 1000;

/// Calibrate lenses and camera positions.
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

/// Calibrate the poses of all cameras from moving robots and at least three reference roundels that one camera sees.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    roundel calibrate arena                               the server on this machine\n  \
    roundel calibrate arena --server http://arena:7670 --seconds 120\n  \
    roundel calibrate arena --config lab.toml             opens the cameras itself; no server must be running\n\n\
    Robots should drive through every place where views of cameras overlap. Robots without codes are distinguished by\n\
    their motion, so they must not all move alike. Only one camera needs to see the references. A running server\n\
    loses no track: its cameras switch to the result between two frames. The result is saved beside the\n\
    configuration, as lab.calibration.toml for lab.toml.\n\n\
    Columns: moved: change of the camera's pose; deviation: standard deviation of position and rotation, rms over the\n\
    axes; error: rms reprojection error of roundel centres; ratio: of measured to predicted errors, ideally 1; seen: share\n\
    of the image in which roundels were seen; clock: lead of its time stamps over those of the camera that sees the\n\
    references.")]
struct ArenaArgs {
    /// Address of the running server
    #[arg(
        long,
        value_name = "URL",
        default_value = "http://127.0.0.1:7670",
        conflicts_with = "config"
    )]
    server: String,
    #[command(flatten)]
    connection: ConnectionArgs,
    /// The installation's TOML file, if no server is running
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Duration of the recording
    #[arg(
        long,
        value_name = "SECONDS",
        default_value_t = DEFAULT_DURATION_S,
        value_parser = |text: &str| number(text, DURATION_RANGE_S)
    )]
    seconds: f64,
    /// Also estimate focal lengths, principal points and the first radial coefficients
    #[arg(long)]
    refine_lenses: bool,
    /// When to apply the result to the cameras
    #[arg(long, default_value = "if-sound", value_parser = words(&APPLY))]
    apply: v1::CalibrationApply,
    /// Format of the report; JSON is one line, as in REST
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
}

const APPLY: [(&str, v1::CalibrationApply, &str); 3] = [
    ("if-sound", v1::CalibrationApply::IfSound, "Unless a finding is grave"),
    ("always", v1::CalibrationApply::Always, "Even with grave findings"),
    ("never", v1::CalibrationApply::Never, "Only report it"),
];

/// Exit code 1 if the result should have been applied, and was not.
pub(super) async fn run(arguments: CalibrateArgs) -> anyhow::Result<ExitCode> {
    let arguments = match arguments.what {
        CalibrateCommand::Arena(arguments) => arguments,
        // Blocks on pictures and long computations.
        CalibrateCommand::Lens(arguments) => {
            return tokio::task::block_in_place(|| run_lens(&arguments));
        }
    };
    let Some(path) = &arguments.config else {
        let client = arguments.connection.connect(&arguments.server).await?;
        return calibrate(&client, &arguments).await;
    };
    let mut config = Config::load(path)?;
    // Not reachable by other clients.
    config.server.listen = ([127, 0, 0, 1], 0).into();
    let server = Server::start(config).await?;
    let client = Client::connect(&format!("http://{}", server.local_addr())).await?;
    let outcome = calibrate(&client, &arguments).await;
    server.shutdown().await;
    outcome
}

async fn calibrate(client: &Client, arguments: &ArenaArgs) -> anyhow::Result<ExitCode> {
    let signal = signal_or_after(None)?;
    client
        .start_calibration(v1::StartCalibrationRequest {
            seconds: Some(arguments.seconds),
            refine_lenses: arguments.refine_lenses,
            apply: arguments.apply.into(),
        })
        .await?;
    let mut changes = client.watch_calibration().await?;
    let done = tokio::select! {
        done = follow(&mut changes) => done?,
        () = signal => {
            client.cancel_calibration().await?;
            eprintln!("cancelled; nothing has changed");
            return Ok(ExitCode::from(ENDED_BY_SIGNAL));
        }
    };
    let Some(report) = &done.report else { bail!("{}", done.error) };
    super::print(&match arguments.format {
        Format::Json => serde_json::to_string(&done)? + "\n",
        Format::Table => print::table(&done, report)?,
    })?;
    if !done.error.is_empty() {
        bail!("{}", done.error);
    }
    let is_as_requested =
        arguments.apply == v1::CalibrationApply::Never || done.applied_version > 0;
    Ok(if is_as_requested { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Shows the progress until the calibration is over.
async fn follow(changes: &mut Messages<v1::Calibration>) -> anyhow::Result<v1::Calibration> {
    let bar = progress_bar(Some(BAR), "{prefix:>9} [{bar:30}] {msg}")?;
    let mut shown = v1::CalibrationStage::Unspecified;
    while let Some(calibration) = changes.next().await {
        let calibration = calibration?;
        let stage = calibration.stage();
        // Without a terminal: a line for each stage.
        let is_logged = stage != shown && bar.is_hidden();
        shown = stage;
        match stage {
            v1::CalibrationStage::Recording => {
                if is_logged {
                    eprintln!("recording for {:.0} s: let robots drive", calibration.seconds);
                }
                let share = calibration.recorded_s / calibration.seconds.max(1e-3);
                bar.set_prefix("recording");
                bar.set_position((share * BAR as f64) as u64);
                bar.set_message(print::recorded(&calibration));
            }
            v1::CalibrationStage::Solving => {
                if is_logged {
                    eprintln!("solving; {}", print::recorded(&calibration));
                }
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
    bail!("the server closed the connection before the calibration ended")
}

fn run_lens(arguments: &lens::LensArgs) -> anyhow::Result<ExitCode> {
    // Before a camera is opened.
    if let Some(file) = &arguments.output {
        output::check(file)?;
    }
    match (&arguments.from_recording, &arguments.camera) {
        (Some(file), Some(camera)) => moving::run(arguments, file, camera),
        _ => lens::run(arguments),
    }
}
