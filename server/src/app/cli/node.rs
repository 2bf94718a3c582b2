//! `roundel node`: captures and searches here, for a server elsewhere.

use std::{fmt::Write as _, io::Write as _, path::PathBuf, process::ExitCode, time::Duration};

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use roundel_client::Client;
use serde_json::json;

use super::serve::{Signals, elapsed, seconds};
use crate::{
    app::serve::node::{Node, NodeReport},
    model::config::Config,
};

/// Capture and search frames on this machine, for a server on another one
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  \
    roundel node --config robot7.toml --server http://10.0.0.1:7670\n\n\
    The file lists cameras and kinds of roundel as that of `roundel serve` does; poses are not looked at.\n\
    The server has a [[camera]] of the same name with source = \"push:\". While the server is away, frames\n\
    go on being searched; what is seen meanwhile and grows too old to be of use is dropped and counted.\n\
    SIGINT (Ctrl-C) or SIGTERM ends it, and it says what became of all frames.")]
pub struct NodeArgs {
    /// The node's TOML file
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// The server's address; without it, that of `[node] server`
    #[arg(long, value_name = "URL")]
    server: Option<String>,
    /// End after so many seconds
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    duration: Option<Duration>,
    /// How to say at the end what became of the frames
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Format {
    Table,
    Json,
}

/// Works until a signal or the end of `--duration`.
pub(super) async fn run(arguments: NodeArgs) -> anyhow::Result<ExitCode> {
    let config = Config::load_node(&arguments.config)?;
    let Some(server) = arguments.server.or(config.node.clone()) else {
        bail!(
            "which server? Name it with --server http://HOST:PORT, or write [node] and server = \"http://HOST:PORT\" \
             into {}",
            arguments.config.display()
        );
    };
    let mut signals = Signals::listen()?;
    let client = Client::connect_lazily(&server)?;
    let node = Node::start(&config, &client)?;
    say(&format!("sending to {}\n", client.address()))?;
    tokio::select! {
        () = signals.next() => tracing::info!("ending on a signal"),
        () = elapsed(arguments.duration) => {}
    }
    let reports = node.shutdown().await;
    say(&match arguments.format {
        Format::Table => table(&reports),
        Format::Json => format!("{:#}\n", as_json(&reports)),
    })?;
    Ok(ExitCode::SUCCESS)
}

fn say(text: &str) -> anyhow::Result<()> {
    let mut stdout = std::io::stdout().lock();
    let written = stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush());
    written.context("cannot write to the standard output")
}

fn table(reports: &[NodeReport]) -> String {
    let mut text = format!(
        "{:<20}{:>10}{:>10}{:>10}{:>13}{:>16}\n",
        "camera", "frames", "taken", "dropped", "connections", "clock within"
    );
    for NodeReport { camera, pushed, .. } in reports {
        let clock = pushed.clock_offset.map_or("unknown".to_owned(), |clock| {
            format!("{:.2} ms", clock.deviation_ns as f64 * 1e-6)
        });
        let _ = writeln!(
            text,
            "{camera:<20}{:>10}{:>10}{:>10}{:>13}{clock:>16}",
            pushed.captured, pushed.acknowledged, pushed.dropped, pushed.connections
        );
    }
    text
}

fn as_json(reports: &[NodeReport]) -> serde_json::Value {
    let report = |NodeReport { camera, frames, pushed }: &NodeReport| {
        json!({
            "camera": camera,
            "searched": frames,
            "frames": pushed.captured,
            "taken": pushed.acknowledged,
            "dropped": pushed.dropped,
            "connections": pushed.connections,
            "clock_offset_ns": pushed.clock_offset.map(|clock| clock.offset_ns.to_string()),
            "clock_deviation_ns": pushed.clock_offset.map(|clock| clock.deviation_ns),
        })
    };
    reports.iter().map(report).collect()
}
