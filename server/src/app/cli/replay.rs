//! `roundel replay`: serves a recording as if it were live, or fuses it again into another one.

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
    process::ExitCode,
    time::{Duration, Instant},
};

use anyhow::bail;
use clap::Args;

use super::{number, print, progress_bar, serve::seconds, signals::ServerEnd, words};
use crate::{
    app::{replay_server::ReplayServer, serve::check_exposure},
    archive::{
        record::megabytes,
        replay::{
            ReplayFrom, SPEEDS,
            copy::copy,
            session::{ReplayOptions, ReplaySession, initial_status},
        },
    },
    model::access::AccessConfig,
};

/// Serve a recording as if it were live, or fuse it again into another one.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    roundel replay run.mcap                               the dashboard shows a time line\n  \
    roundel replay run.mcap --speed 4 --start 30 --loop\n  \
    roundel replay run.mcap --from observations --config other.toml\n  \
    roundel replay run.mcap --from observations --to fused.mcap   at full speed\n\n\
    Times are those of the recording. While it is served: PATCH /api/v1/replay with {\"paused\": true},\n\
    {\"position_s\": 12.5}, {\"speed\": 0.5}, {\"looping\": true}; gRPC has ControlReplay. Fusing the same file again\n\
    gives the same bits each time.")]
pub struct ReplayArgs {
    /// The recording
    file: PathBuf,
    /// Recorded data to start from
    #[arg(long, default_value = "snapshots", value_parser = words(&REPLAY_FROM))]
    from: ReplayFrom,
    /// Recorded seconds per second, 0.01 to 100; --to FILE has no limit
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = |text: &str| number(text, SPEEDS))]
    speed: f64,
    /// Start position, seconds after the start of the recording
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, value_parser = |text: &str| number(text, [0.0, 1e9]))]
    start: f64,
    /// Loop
    #[arg(long = "loop")]
    looping: bool,
    /// Start paused
    #[arg(long)]
    paused: bool,
    /// Fuse (and search) with this configuration instead of the recorded one
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Address to listen on; port 0 takes a free one
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:7670")]
    listen: SocketAddr,
    /// Allow an address that other computers reach, without encryption and credentials
    #[arg(long)]
    insecure: bool,
    /// Write the result into this file at full speed instead of serving it
    #[arg(long, value_name = "FILE", conflicts_with_all = ["speed", "start", "looping", "paused", "listen"])]
    to: Option<PathBuf>,
    /// Stop after this many seconds
    #[arg(long, value_name = "SECONDS", value_parser = seconds, conflicts_with = "to")]
    duration: Option<Duration>,
}

const REPLAY_FROM: [(&str, ReplayFrom, &str); 3] = [
    ("snapshots", ReplayFrom::Snapshots, "Snapshots and events as recorded"),
    ("observations", ReplayFrom::Observations, "Observations, fused again"),
    ("frames", ReplayFrom::Frames, "Frames, searched and fused again"),
];

/// Serves until a signal; with `--to`, until the file is complete.
pub(super) async fn run(arguments: ReplayArgs) -> anyhow::Result<ExitCode> {
    let from = arguments.from;
    if arguments.config.is_some() && from == ReplayFrom::Snapshots {
        bail!("--config applies only when fusing again: add --from observations or --from frames");
    }
    let options = ReplayOptions { file: arguments.file.clone(), from, config: arguments.config };
    let session = tokio::task::spawn_blocking(move || ReplaySession::open(&options)).await??;
    if let Some(to) = arguments.to {
        return tokio::task::spawn_blocking(move || write_fused(session, &to)).await?;
    }
    let mut begin = initial_status(&session, &arguments.file, from);
    let length_s = begin.span.1.seconds_since(begin.span.0);
    if arguments.start > length_s {
        bail!(
            "--start: expected at most {length_s:.3} s, the length of the recording, found {}",
            arguments.start
        );
    }
    begin.position = begin.span.0.plus_seconds(arguments.start);
    begin.speed = arguments.speed;
    begin.paused = arguments.paused;
    begin.looping = arguments.looping;
    let end = ServerEnd::listen(arguments.duration)?;
    let access = AccessConfig { insecure: arguments.insecure, ..AccessConfig::default() };
    check_exposure(arguments.listen, false, &access)?;
    let server = ReplayServer::start(session, arguments.listen, begin).await?;
    let (address, file) = (server.local_addr(), arguments.file.display());
    print(&format!("listening on http://{address}\n{length_s:.1} s of {file}\n"))?;
    for sentence in &server.replay().status().damage {
        tracing::warn!("{sentence}");
    }
    end.wait().await;
    server.shutdown().await;
    Ok(ExitCode::SUCCESS)
}

fn write_fused(session: ReplaySession, to: &Path) -> anyhow::Result<ExitCode> {
    let bar = progress_bar(None, "replaying: {pos} s")?;
    let begun = Instant::now();
    let copied = copy(session, to, |second| bar.set_position(second as u64))?;
    bar.finish_and_clear();
    let mut text = format!(
        "{}: {} snapshots of {:.1} s, {} in {} messages, at {:.1} times the recorded speed",
        to.display(),
        copied.snapshots,
        copied.seconds,
        megabytes(copied.bytes),
        copied.messages,
        copied.seconds / begun.elapsed().as_secs_f64()
    );
    if copied.invalid_messages > 0 {
        text += &format!("; {} invalid messages were skipped", copied.invalid_messages);
    }
    print(&(text + "\n"))?;
    Ok(if copied.invalid_messages > 0 { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}
