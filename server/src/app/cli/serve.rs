//! `roundel serve`: runs an installation.

use std::{path::PathBuf, process::ExitCode, time::Duration};

use anyhow::bail;
use clap::Args;

use super::{log, print, signals::ServerEnd};
use crate::{app::serve::Server, model::config::Config};

/// Exit code after the failure of an essential thread.
const FAILED: i32 = 1;
/// Time for finishing the recording after such a failure.
const RECORDING_TIMEOUT: Duration = Duration::from_secs(1);

/// Run an installation: cameras in, world poses out.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  \
    roundel serve --config deploy/roundel.example.toml\n\n\
    Prints the address that it listens on. SIGINT (Ctrl-C), SIGTERM or SIGHUP shuts it down within 5 s; a\n\
    second one ends it at once. RUST_LOG sets the log level, such as RUST_LOG=debug.")]
pub struct ServeArgs {
    /// The installation's TOML file
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Stop after this many seconds
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
    let end = ServerEnd::listen(arguments.duration)?;
    let server = Server::start(config).await?;
    announce(&server)?;
    Ok(serve_until(server, &end).await)
}

/// Prints where the server listens: the line that scripts wait for. Its certificate comes first.
pub(super) fn announce(server: &Server) -> anyhow::Result<()> {
    let mut text = String::new();
    let mut scheme = "http";
    if let Some(certificate) = server.certificate() {
        text = format!("TLS certificate: {certificate}\n");
        scheme = "https";
    }
    print(&format!("{text}listening on {scheme}://{}\n", server.local_addr()))
}

/// Serves until `end`, or until an essential thread has failed, and shuts down. The exit code is 1 after a failure.
pub(super) async fn serve_until(server: Server, end: &ServerEnd) -> ExitCode {
    tokio::select! {
        biased;
        () = server.failed() => {
            end.begin();
            server.finish_recording(RECORDING_TIMEOUT).await;
            tracing::error!("ending with an error, so that a supervisor restarts this server");
            log::finish();
            std::process::exit(FAILED);
        }
        () = end.wait() => {}
    }
    tracing::info!("shutting down");
    server.shutdown().await;
    ExitCode::SUCCESS
}
