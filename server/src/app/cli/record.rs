//! `roundel record`: controls recording on a server, or records the server's streams on this computer.

mod local;

use std::{path::PathBuf, process::ExitCode, time::Duration};

use clap::Args;
use roundel_client::Client;
use roundel_proto::v1;

use super::{
    Format, connection::ConnectionArgs, print, progress_bar, serve::seconds,
    signals::signal_or_after,
};
use crate::archive::record::megabytes;

const PROGRESS_INTERVAL: Duration = Duration::from_millis(500);
const PROGRESS: &str = "recording: {msg}";

/// Record a server's data for inspection, replay and evaluation.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    roundel record                                  the server on this machine, until Ctrl-C\n  \
    roundel record --server http://arena:7670 --name trial --seconds 60\n  \
    roundel record --detach; …; roundel record --stop\n  \
    roundel record --output run.mcap                on this computer, from the server's streams\n\n\
    Files are MCAP, which Foxglove opens. The server writes them to the folder of [recording] in its configuration,\n\
    unless --output names a file on this computer. `roundel info`, `roundel replay` and `roundel eval` read them. Only a\n\
    recording made by the server can be fused again: the streams lack the camera updates that fusion received.")]
pub struct RecordArgs {
    /// Address of the running server
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:7670")]
    server: String,
    #[command(flatten)]
    connection: ConnectionArgs,
    /// Prefix of the files' names [default: the installation's name]
    #[arg(long, value_name = "NAME", default_value = "", hide_default_value = true)]
    name: String,
    /// Stop after this many seconds
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    seconds: Option<Duration>,
    /// Record every Nth frame of each camera, 0: none [default: as configured]
    #[arg(long, value_name = "N")]
    frames_every: Option<u32>,
    /// Return at once and leave the server recording
    #[arg(long, conflicts_with_all = ["stop", "output"])]
    detach: bool,
    /// Stop the current recording
    #[arg(long, conflicts_with_all = ["output", "name", "seconds", "frames_every"])]
    stop: bool,
    /// Record the server's streams into this file on this computer instead
    #[arg(long, value_name = "FILE", conflicts_with_all = ["name", "frames_every"])]
    output: Option<PathBuf>,
    /// Format of the result; JSON is one line, as in REST
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
}

/// Records until a signal, the end of `--seconds`, or the end of the recording. The exit code is 1 if the recording failed.
pub(super) async fn run(arguments: RecordArgs) -> anyhow::Result<ExitCode> {
    let client = arguments.connection.connect(&arguments.server).await?;
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
    let signal = signal_or_after(None)?;
    let ended = tokio::select! {
        ended = follow(&client) => ended?,
        () = signal => client.stop_recording().await?,
    };
    print_outcome(&ended, arguments.format)
}

/// Shows the progress until the recording has ended.
async fn follow(client: &Client) -> anyhow::Result<v1::Recording> {
    let bar = progress_bar(None, PROGRESS)?;
    loop {
        let now = client.recording().await?;
        if now.state() != v1::RecordingState::Recording {
            bar.finish_and_clear();
            return Ok(now);
        }
        let lost = if now.dropped > 0 { format!(", {} lost", now.dropped) } else { String::new() };
        bar.set_message(format!(
            "{:.0} s, {} in {} messages{lost}, {} free on the disk",
            now.seconds,
            megabytes(now.bytes),
            now.messages,
            megabytes(now.disk_free_bytes)
        ));
        tokio::time::sleep(PROGRESS_INTERVAL).await;
    }
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
                text += &format!("; {dropped} messages were dropped: the disk was too slow");
            }
            if is_failed {
                text += &format!("; the recording failed: {}", recording.error);
            }
            text
        }
    };
    print(&(text + "\n"))?;
    Ok(if is_failed { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}
