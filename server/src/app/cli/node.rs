//! `roundel node`: captures and searches frames on this computer, for a server on another one.

use std::{fmt::Write as _, path::PathBuf, process::ExitCode, time::Duration};

use anyhow::bail;
use clap::Args;
use roundel_client::Client;
use serde_json::json;

use super::{Format, connection::ConnectionArgs, print, serve::seconds, signals::ServerEnd};
use crate::{
    app::serve::node::{Node, NodeReport},
    model::{config::Config, redact::redact},
};

/// Capture and search frames on this computer, for a server on another one
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  \
    roundel node --config robot7.toml --server http://10.0.0.1:7670\n\n\
    The file lists cameras and kinds of roundel like that of `roundel serve`; poses are ignored.\n\
    The server has a [[camera]] of the same name with source = \"push:\". While the server is away, frames\n\
    are still searched; observations that become too old to be useful are dropped and counted.\n\
    SIGINT (Ctrl-C) or SIGTERM shuts it down, and it reports the frames sent and dropped.")]
pub struct NodeArgs {
    /// The node's TOML file
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// The server's address [default: `[node] server` in the file]
    #[arg(long, value_name = "URL")]
    server: Option<String>,
    #[command(flatten)]
    connection: ConnectionArgs,
    /// Stop after this many seconds
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    duration: Option<Duration>,
    /// Format of the final report
    #[arg(long, value_enum, default_value_t = Format::Table)]
    format: Format,
}

/// Runs until a signal or the end of `--duration`.
pub(super) async fn run(arguments: NodeArgs) -> anyhow::Result<ExitCode> {
    let config = Config::load_node(&arguments.config)?;
    let Some(server) = arguments.server.or(config.node.as_ref().map(|node| node.server.clone()))
    else {
        bail!(
            "expected a server: add --server http://HOST:PORT, or [node] with server = \"http://HOST:PORT\" to {}",
            arguments.config.display()
        );
    };
    let end = ServerEnd::listen(arguments.duration)?;
    let options = arguments.connection.node_options(config.node.as_ref());
    let client = Client::connect_lazily_with(&server, &options)?;
    let node = Node::start(&config, &client)?;
    print(&format!("sending to {}\n", redact(client.address())))?;
    end.wait().await;
    tracing::info!("shutting down");
    let reports = node.shutdown().await;
    arguments.format.print(&as_json(&reports), |_| table(&reports))?;
    Ok(ExitCode::SUCCESS)
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
