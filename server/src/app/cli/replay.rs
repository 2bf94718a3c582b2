//! `roundel replay`: serves a recording as if it were live, or fuses it anew into another one.

use std::{io::Write as _, net::SocketAddr, path::PathBuf, process::ExitCode};

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};

use super::serve::{Signals, seconds};
use crate::{
    app::replay_server::ReplayServer,
    archive::{
        record::megabytes,
        replay::{
            ReplayFrom, SPEEDS,
            copy::copy,
            session::{ReplayOptions, ReplaySession, initial_status},
        },
    },
};

/// Serve a recording as if it were live, or fuse it anew into another one.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    roundel replay run.mcap                               the dashboard has a time line\n  \
    roundel replay run.mcap --speed 4 --start 30 --loop\n  \
    roundel replay run.mcap --from observations --config other.toml\n  \
    roundel replay run.mcap --from observations --to anew.mcap   as fast as it goes\n\n\
    Times are those of the recording. While it is served: PATCH /api/v1/replay with {\"paused\": true},\n\
    {\"position_s\": 12.5}, {\"speed\": 0.5}, {\"looping\": true}; gRPC has ControlReplay. Fused anew, the same file\n\
    gives the same bits each time.")]
pub struct ReplayArgs {
    /// The recording
    file: PathBuf,
    /// What is taken from it
    #[arg(long, value_enum, default_value_t = FromArg::Snapshots)]
    from: FromArg,
    /// How many recorded seconds pass in one, 0.01 to 100
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = speed)]
    speed: f64,
    /// Where to begin, seconds from the recording's begin
    #[arg(long, value_name = "SECONDS", value_parser = position, default_value_t = 0.0)]
    start: f64,
    /// Begin again after the end
    #[arg(long = "loop")]
    looping: bool,
    /// Wait at the begin
    #[arg(long)]
    paused: bool,
    /// Fuse (and search) by this configuration instead of the recorded one
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Where to listen; port 0 takes a free one
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:7670")]
    listen: SocketAddr,
    /// Serve nothing: write what comes out into this file, as fast as it goes
    #[arg(long, value_name = "FILE", conflicts_with_all = ["speed", "start", "looping", "paused", "listen"])]
    to: Option<PathBuf>,
    /// End after so many seconds
    #[arg(long, value_name = "SECONDS", value_parser = seconds, conflicts_with = "to")]
    duration: Option<std::time::Duration>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum FromArg {
    /// Snapshots and events as they were
    Snapshots,
    /// Observations, which are fused anew
    Observations,
    /// Frames, which are searched and fused anew
    Frames,
}

fn speed(text: &str) -> Result<f64, String> {
    let [slowest, fastest] = SPEEDS;
    let speed = text.parse().ok().filter(|speed| (slowest..=fastest).contains(speed));
    speed.ok_or_else(|| {
        format!("expected {slowest} to {fastest}, found `{text}` (as fast as it goes: --to FILE)")
    })
}

fn position(text: &str) -> Result<f64, String> {
    let position = text.parse().ok().filter(|position: &f64| (0.0..=1e9).contains(position));
    position.ok_or_else(|| format!("expected seconds, 0 or more, found `{text}`"))
}

/// Serves until a signal; with `--to`, until the file is whole.
pub(super) async fn run(arguments: ReplayArgs) -> anyhow::Result<ExitCode> {
    let from = match arguments.from {
        FromArg::Snapshots => ReplayFrom::Snapshots,
        FromArg::Observations => ReplayFrom::Observations,
        FromArg::Frames => ReplayFrom::Frames,
    };
    if arguments.config.is_some() && from == ReplayFrom::Snapshots {
        bail!("--config says how to fuse anew: add --from observations, or --from frames");
    }
    let wanted =
        ReplayOptions { file: arguments.file.clone(), from, config: arguments.config.clone() };
    let session = tokio::task::spawn_blocking(move || ReplaySession::open(&wanted)).await??;
    if let Some(to) = arguments.to {
        return tokio::task::spawn_blocking(move || fuse_anew(session, &to)).await?;
    }
    let mut begin = initial_status(&session, &arguments.file, from);
    let length_s = begin.span.1.seconds_since(begin.span.0);
    if arguments.start > length_s {
        bail!("--start: the recording has {length_s:.3} s, found {}", arguments.start);
    }
    begin.position = begin.span.0.plus_seconds(arguments.start);
    (begin.speed, begin.paused, begin.looping) =
        (arguments.speed, arguments.paused, arguments.looping);
    let mut signals = Signals::listen()?;
    let server = ReplayServer::start(session, arguments.listen, begin).await?;
    let mut stdout = std::io::stdout();
    writeln!(stdout, "listening on http://{}", server.local_addr())
        .and_then(|()| writeln!(stdout, "{length_s:.1} s of {}", arguments.file.display()))
        .and_then(|()| stdout.flush())
        .context("cannot write to the standard output")?;
    for sentence in &server.replay().status().damage {
        tracing::warn!("{sentence}");
    }
    tokio::select! {
        () = signals.next() => {}
        () = super::serve::elapsed(arguments.duration) => {}
    }
    server.shutdown().await;
    Ok(ExitCode::SUCCESS)
}

fn fuse_anew(session: ReplaySession, to: &std::path::Path) -> anyhow::Result<ExitCode> {
    let bar = ProgressBar::new_spinner();
    let style = ProgressStyle::with_template("replaying: {pos} s");
    bar.set_style(style.context("the progress bar's template is wrong")?);
    let begun = std::time::Instant::now();
    let copied = copy(session, to, |second| bar.set_position(second as u64))?;
    bar.finish_and_clear();
    let elapsed_s = begun.elapsed().as_secs_f64();
    let mut text = format!(
        "{}: {} snapshots of {:.1} s, {} in {} messages; {:.1} times as fast as it was",
        to.display(),
        copied.snapshots,
        copied.seconds,
        megabytes(copied.bytes),
        copied.messages,
        copied.seconds / elapsed_s
    );
    if copied.invalid_messages > 0 {
        text += &format!(
            "; {} messages said what cannot be, and were left out",
            copied.invalid_messages
        );
    }
    writeln!(std::io::stdout(), "{text}").context("cannot write to the standard output")?;
    Ok(if copied.invalid_messages > 0 { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}
