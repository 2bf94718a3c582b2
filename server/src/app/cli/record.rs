//! `roundel record`: tells a server to record, or records what it serves here.

mod local;

use std::{io::Write as _, path::PathBuf, process::ExitCode, time::Duration};

use anyhow::Context;
use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use roundel_client::Client;
use roundel_proto::v1;

use super::serve::{Signals, elapsed, seconds};
use crate::archive::record::megabytes;

const LOOK_EVERY: Duration = Duration::from_millis(500);

/// Record what a server sees and says, to look at, replay and evaluate it later.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    roundel record                                  the server on this machine, until Ctrl-C\n  \
    roundel record --server http://arena:7670 --name trial --seconds 60\n  \
    roundel record --detach; …; roundel record --stop\n  \
    roundel record --output run.mcap                here, out of what the server streams\n\n\
    Files are MCAP, which Foxglove opens, in the server's folder ([recording] in its configuration) unless\n\
    --output says otherwise; `roundel info`, `roundel replay` and `roundel eval` read them. Only what a server\n\
    records itself can be fused anew: what is streamed lacks what fusion was told of its cameras.")]
pub struct RecordArgs {
    /// Address of the running server
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:7670")]
    server: String,
    /// Begin of the files' names [default: the installation's name]
    #[arg(long, value_name = "NAME", default_value = "", hide_default_value = true)]
    name: String,
    /// End after so many seconds
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    seconds: Option<Duration>,
    /// Keep one in so many frames of each camera, 0: none [default: as configured]
    #[arg(long, value_name = "N")]
    frames_every: Option<u32>,
    /// Leave it recording
    #[arg(long, conflicts_with_all = ["stop", "output"])]
    detach: bool,
    /// End the recording that is being made
    #[arg(long, conflicts_with_all = ["output", "name", "seconds", "frames_every"])]
    stop: bool,
    /// Record into this file on this machine instead
    #[arg(long, value_name = "FILE", conflicts_with_all = ["name", "frames_every"])]
    output: Option<PathBuf>,
    /// How to print what became of it
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// Sentences
    Table,
    /// As REST gives it, one line
    Json,
}

/// Records until a signal, the given time, or the recording's own end; 1 if that was a failure.
pub(super) async fn run(arguments: RecordArgs) -> anyhow::Result<ExitCode> {
    let client = Client::connect(&arguments.server).await?;
    if let Some(path) = &arguments.output {
        return local::record(&client, path, arguments.seconds).await;
    }
    if arguments.stop {
        return print_outcome(&client.stop_recording().await?, arguments.format);
    }
    let begun = client
        .start_recording(v1::StartRecordingRequest {
            name: arguments.name.clone(),
            frames_every: arguments.frames_every,
            seconds: arguments.seconds.map(|length| length.as_secs_f64()),
        })
        .await?;
    eprintln!("recording into {}/{}", begun.folder, begun.file);
    if arguments.detach {
        return print_outcome(&begun, arguments.format);
    }
    let mut signals = Signals::listen()?;
    let ended = tokio::select! {
        ended = follow(&client) => ended?,
        () = signals.next() => client.stop_recording().await?,
    };
    print_outcome(&ended, arguments.format)
}

/// Shows how it is doing until it has ended by itself.
async fn follow(client: &Client) -> anyhow::Result<v1::Recording> {
    let bar = progress()?;
    loop {
        let now = client.recording().await?;
        if now.state() != v1::RecordingState::Recording {
            bar.finish_and_clear();
            return Ok(now);
        }
        let lost = if now.dropped > 0 { format!(", {} lost", now.dropped) } else { String::new() };
        bar.set_message(format!(
            "{:.0} s, {} in {} messages{lost}, {} left on the disk",
            now.seconds,
            megabytes(now.bytes),
            now.messages,
            megabytes(now.disk_free_bytes)
        ));
        elapsed(Some(LOOK_EVERY)).await;
    }
}

/// A line that tells how far it is; none where there is no terminal.
fn progress() -> anyhow::Result<ProgressBar> {
    let bar = ProgressBar::new_spinner();
    let style = ProgressStyle::with_template("recording: {msg}");
    bar.set_style(style.context("the progress bar's template is wrong")?);
    Ok(bar)
}

fn print_outcome(recording: &v1::Recording, format: Format) -> anyhow::Result<ExitCode> {
    let is_failed = recording.state() == v1::RecordingState::Failed;
    let text = match format {
        Format::Json => serde_json::to_string(recording)?,
        Format::Table => {
            let v1::Recording { folder, file, files, messages, dropped, .. } = recording;
            let all = if *files == 1 { "1 file".to_owned() } else { format!("{files} files") };
            let mut text = format!(
                "{folder}/{file}: {:.1} s, {messages} messages, {} in {all}",
                recording.seconds,
                megabytes(recording.bytes)
            );
            if *dropped > 0 {
                text += &format!("; {dropped} messages are missing, the disk was too slow");
            }
            if is_failed {
                text += &format!("; it ended by itself: {}", recording.error);
            }
            text
        }
    };
    writeln!(std::io::stdout(), "{text}").context("cannot write to the standard output")?;
    Ok(if is_failed { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}
