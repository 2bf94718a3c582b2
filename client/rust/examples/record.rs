//! Records every robot to a CSV file, with one line for each robot of each snapshot.
//!
//! ```sh
//! cargo run --release -p roundel-client --example record -- run.csv 10     # ten seconds; - for standard output
//! ```
//!
//! A restarted server has another `source_id` and assigns new ids, so the same `object_id` may be another robot.

use std::{
    fs::File,
    io::{self, BufWriter, Write},
    pin::pin,
    time::Duration,
};

use anyhow::Context;
use futures::StreamExt;
use roundel_client::{
    Client, Subscription, Update, position_sigma_m,
    v1::{ObjectState, Snapshot},
};
use tokio::{signal::ctrl_c, time::sleep};

const USAGE: &str = "usage: record FILE [SECONDS] [SERVER]\n\
    FILE is - for standard output; without SECONDS, records until interrupted; SERVER defaults to http://127.0.0.1:7670";
const COLUMNS: &str = "pose_time_ns,source_id,sequence,object_id,name,stage,\
    x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s,qx,qy,qz,qw,sx_m,sy_m,sz_m";

#[tokio::main(flavor = "current_thread")]
async fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().context(USAGE)?;
    let length = arguments.next().map(|text| length(&text)).transpose().context(USAGE)?;
    let server = arguments.next().unwrap_or_else(|| "http://127.0.0.1:7670".to_owned());
    let file: Box<dyn Write> = if path == "-" {
        Box::new(io::stdout())
    } else {
        Box::new(File::create(&path).with_context(|| format!("cannot write {path}"))?)
    };
    let mut file = BufWriter::new(file);
    writeln!(file, "{COLUMNS}")?;

    let client = Client::connect(&server).await?;
    let mut snapshots = client.snapshots(Subscription::default());
    let mut end = pin!(end(length));
    let mut written = 0_u64;
    loop {
        // Ends in time also without updates.
        let update = tokio::select! {
            update = snapshots.next() => update,
            interrupted = &mut end => {
                interrupted?;
                break;
            }
        };
        let Some(update) = update else { break };
        match update? {
            Update::Snapshot(snapshot) => {
                for state in &snapshot.objects {
                    writeln!(file, "{}", line(&snapshot, state))?;
                }
                written += 1;
            }
            Update::Disconnected { reason, retry_in, .. } => {
                eprintln!(
                    "connection lost ({reason}); next attempt in {} ms",
                    retry_in.as_millis()
                );
            }
            Update::Reconnected { gap, restarted: true, .. } => {
                eprintln!("connected again after {gap:.1?}, server restarted with new ids");
            }
            Update::Reconnected { gap, missed, .. } => {
                eprintln!("connected again after {gap:.1?}, missed {}", missed.unwrap_or_default());
            }
            _ => {}
        }
    }
    file.flush()?;
    eprintln!("{written} snapshots written, {} missed", snapshots.missed());
    Ok(())
}

fn length(seconds: &str) -> anyhow::Result<Duration> {
    Ok(Duration::try_from_secs_f64(seconds.parse()?)?)
}

/// Waits for the end of the recording or an interrupt.
async fn end(length: Option<Duration>) -> io::Result<()> {
    let timer = async {
        match length {
            Some(length) => sleep(length).await,
            None => std::future::pending().await,
        }
    };
    tokio::select! {
        () = timer => Ok(()),
        interrupted = ctrl_c() => interrupted,
    }
}

fn line(snapshot: &Snapshot, state: &ObjectState) -> String {
    let (p, v) = (state.position.unwrap_or_default(), state.velocity.unwrap_or_default());
    let q = state.orientation.unwrap_or_default();
    let numbers = [p.x, p.y, p.z, v.x, v.y, v.z, q.x, q.y, q.z, q.w].map(|x| format!("{x:.6}"));
    let sigma = match position_sigma_m(state) {
        Some(sigma_m) => sigma_m.map(|x| format!("{x:.6}")).join(","),
        None => ",,".to_owned(),
    };
    let stage = state.stage().as_str_name().trim_start_matches("LIFE_STAGE_").to_lowercase();
    // Names come from the configuration and may contain any character; `source_id` contains the server's name.
    let [source_id, name] = [&snapshot.source_id, &state.name].map(|text| quoted(text));
    format!(
        "{},{source_id},{},{},{name},{stage},{},{sigma}",
        snapshot.pose_time_ns,
        snapshot.sequence,
        state.object_id,
        numbers.join(",")
    )
}

fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('"', "\"\""))
}
