//! A recording on this machine, from a server's streams.

use std::{
    collections::BTreeMap,
    path::Path,
    process::ExitCode,
    time::{Duration, Instant},
};

use anyhow::Context;
use futures::StreamExt;
use roundel_client::{Client, Subscription, Update};
use roundel_core::time::Timestamp;
use roundel_proto::v1;

use super::PROGRESS;
use crate::{
    app::cli::{print, progress_bar, signals::signal_or_after},
    archive::record::{
        file_writer::{FileWriter, MessageStamp},
        megabytes,
        schema::Topic,
    },
    model::clock::Clock,
};

const FLUSH_INTERVAL: Duration = Duration::from_millis(500);

/// Records until a signal, the given time, or the end of the connection.
pub(super) async fn record(
    client: &Client,
    path: &Path,
    length: Option<Duration>,
) -> anyhow::Result<ExitCode> {
    let info = client.info().await?;
    let about = BTreeMap::from([
        ("installation".to_owned(), info.name.clone()),
        ("source_id".to_owned(), info.source_id.clone()),
        ("streamed".to_owned(), "true".to_owned()),
    ]);
    let mut file = FileWriter::create(path, &about)
        .with_context(|| format!("cannot write {}", path.display()))?;
    let begun = Instant::now();
    let recorded = write_streams(client, &mut file, &info, length).await;
    let (messages, seconds) = (file.messages(), begun.elapsed().as_secs_f64());
    recorded?;
    let bytes = file.finish().with_context(|| format!("cannot finish {}", path.display()))?;
    let size = megabytes(bytes);
    print(&format!("{}: {seconds:.1} s, {messages} messages, {size}\n", path.display()))?;
    Ok(ExitCode::SUCCESS)
}

async fn write_streams(
    client: &Client,
    file: &mut FileWriter,
    info: &v1::ServerInfo,
    length: Option<Duration>,
) -> anyhow::Result<()> {
    let (clock, begun) = (Clock::anchored_now(), Instant::now());
    let end = signal_or_after(length)?;
    tokio::pin!(end);
    let mut snapshots = client.snapshots(Subscription::default());
    let mut observations = client.observations(&[]).await?;
    let mut events = client.events(0).await?;
    let mut flush = tokio::time::interval(FLUSH_INTERVAL);
    let bar = progress_bar(None, PROGRESS)?;
    let message = v1::RecordedConfiguration {
        version: info.version.clone(),
        source_id: info.source_id.clone(),
        name: info.name.clone(),
        snapshot_rate_hz: info.snapshot_rate_hz,
        ..v1::RecordedConfiguration::default()
    };
    file.write(Topic::Configuration, MessageStamp::at(clock.now(), 0), &message)?;
    let mut missed = 0;
    loop {
        let now = clock.now();
        let at = |publish_ns: i64, sequence: u64| MessageStamp {
            log_time: now,
            publish_time: Timestamp::from_ns(publish_ns),
            sequence,
        };
        tokio::select! {
            snapshot = snapshots.next() => match snapshot {
                Some(Ok(Update::Snapshot(snapshot))) => {
                    missed += snapshot.missed;
                    let stamp = at(snapshot.pose_time_ns, snapshot.sequence);
                    file.write(Topic::Snapshots, stamp, &snapshot)?;
                }
                // The other streams do not reconnect, so the recording ends here.
                Some(Ok(Update::Disconnected { reason, .. })) => {
                    tracing::warn!("connection lost; the recording ends: {reason}");
                    return Ok(());
                }
                Some(Ok(_)) => {}
                Some(Err(error)) => return Err(error.into()),
                None => return Ok(()),
            },
            Some(Ok(frame)) = observations.next() => {
                missed += frame.missed;
                file.write(Topic::Observations, at(frame.capture_time_ns, frame.frame), &frame)?;
            }
            Some(Ok(event)) = events.next() => {
                file.write(Topic::Events, at(event.time_ns, event.sequence), &event)?;
            }
            _ = flush.tick() => {
                let cameras = client.cameras().await?;
                let message = v1::ListCamerasResponse { cameras };
                file.write(Topic::Health, MessageStamp::at(now, 0), &message)?;
                file.flush().context("cannot write the recording")?;
                let seconds = begun.elapsed().as_secs_f64();
                bar.set_message(format!("{seconds:.0} s, {}, {missed} missed", megabytes(file.bytes())));
            }
            () = &mut end => return Ok(()),
        }
    }
}
