//! `roundel serve`: runs an installation.

use std::{future::pending, io::Write as _, path::PathBuf, process::ExitCode, time::Duration};

use anyhow::{Context, bail};
use clap::Args;
use tokio::signal::unix::{Signal, SignalKind, signal};

use crate::{app::serve::Server, model::config::Config};

/// Exit code of a process that a second signal ended.
const ENDED_BY_SIGNAL: i32 = 130;
/// Signals within this time count as one: a terminal or a supervisor may well send one to the
/// process and to its group.
const ONE_SIGNAL: Duration = Duration::from_millis(300);

/// Run an installation: cameras in, world poses out.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  \
    roundel serve --config deploy/roundel.example.toml\n\n\
    Prints the address that it listens on. SIGINT (Ctrl-C) or SIGTERM ends it; a second one ends it\n\
    at once. RUST_LOG sets what is logged, e.g. RUST_LOG=debug.")]
pub struct ServeArgs {
    /// The installation's TOML file
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// End after so many seconds
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    duration: Option<Duration>,
}

/// A positive number of seconds.
pub(super) fn seconds(text: &str) -> Result<Duration, String> {
    let seconds: f64 = text.parse().map_err(|_| format!("expected seconds, found `{text}`"))?;
    if seconds > 0.0 && seconds <= 1e9 {
        Ok(Duration::from_secs_f64(seconds))
    } else {
        Err(format!("expected seconds above 0, at most 1e9, found `{text}`"))
    }
}

/// Serves until a signal or the end of `--duration`.
pub(super) async fn run(arguments: ServeArgs) -> anyhow::Result<ExitCode> {
    let config = Config::load(&arguments.config)?;
    if config.node.is_some() {
        bail!(
            "{} describes a node ([node]), whose cameras another server fuses: run `roundel node --config {0}`",
            arguments.config.display()
        );
    }
    let mut signals = Signals::listen()?;
    let server = Server::start(config).await?;
    announce(&server)?;
    tokio::select! {
        () = signals.next() => tracing::info!("ending on a signal"),
        () = elapsed(arguments.duration) => {}
    }
    shut_down(server).await;
    Ok(ExitCode::SUCCESS)
}

/// Says where the server listens: the one line that scripts wait for.
pub(super) fn announce(server: &Server) -> anyhow::Result<()> {
    let mut stdout = std::io::stdout().lock();
    writeln!(stdout, "listening on http://{}", server.local_addr())
        .and_then(|()| stdout.flush())
        .context("cannot write to the standard output")
}

/// Waits so long; for ever without a duration.
pub(super) async fn elapsed(duration: Option<Duration>) {
    match duration {
        Some(duration) => tokio::time::sleep(duration).await,
        None => pending().await,
    }
}

/// Takes the server apart; a further signal meanwhile ends the process at once.
pub(super) async fn shut_down(server: Server) {
    let second_signal = async {
        tokio::time::sleep(ONE_SIGNAL).await;
        match Signals::listen() {
            // Hears what comes from now on.
            Ok(mut signals) => signals.next().await,
            Err(_) => pending().await,
        }
    };
    tokio::select! {
        () = server.shutdown() => {}
        () = second_signal => {
            tracing::warn!("ending at once on a second signal");
            std::process::exit(ENDED_BY_SIGNAL);
        }
    }
}

/// SIGINT and SIGTERM.
pub(super) struct Signals {
    interrupt: Signal,
    terminate: Signal,
}

impl Signals {
    /// From now on the signals no longer end the process by themselves.
    pub(super) fn listen() -> anyhow::Result<Self> {
        let listen = |kind| signal(kind).context("cannot listen for signals");
        Ok(Self {
            interrupt: listen(SignalKind::interrupt())?,
            terminate: listen(SignalKind::terminate())?,
        })
    }

    /// Waits for either.
    pub(super) async fn next(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
        }
    }
}
