//! A recording on this machine, out of what a server streams.

use std::{
    collections::BTreeMap,
    io::Write as _,
    path::Path,
    process::ExitCode,
    time::{Duration, Instant},
};

use anyhow::Context;
use futures::StreamExt;
use roundel_client::{Client, Subscription, Update};
use roundel_core::time::Timestamp;
use roundel_proto::v1;

use super::progress;
use crate::{
    app::cli::serve::{Signals, elapsed},
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
    let recorded = take_all(client, &mut file, &info, length).await;
    let (messages, begun) = (file.messages(), recorded?);
    let bytes = file.finish().with_context(|| format!("cannot end {}", path.display()))?;
    writeln!(
        std::io::stdout(),
        "{}: {:.1} s, {messages} messages, {}",
        path.display(),
        begun.elapsed().as_secs_f64(),
        megabytes(bytes)
    )
    .context("cannot write to the standard output")?;
    Ok(ExitCode::SUCCESS)
}

async fn take_all(
    client: &Client,
    file: &mut FileWriter,
    info: &v1::ServerInfo,
    length: Option<Duration>,
) -> anyhow::Result<Instant> {
    let (clock, begun) = (Clock::anchored_now(), Instant::now());
    let mut signals = Signals::listen()?;
    let mut snapshots = client.snapshots(Subscription::default());
    let mut observations = client.observations(&[]).await?;
    let mut events = client.events(0).await?;
    let mut flush = tokio::time::interval(FLUSH_INTERVAL);
    let end = elapsed(length);
    tokio::pin!(end);
    let bar = progress()?;
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
                // The other streams do not come back by themselves: what there is, is kept.
                Some(Ok(Update::Disconnected { reason, .. })) => {
                    tracing::warn!("the connection is lost, and the recording ends: {reason}");
                    return Ok(begun);
                }
                Some(Ok(_)) => {}
                Some(Err(error)) => return Err(error.into()),
                None => return Ok(begun),
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
                file.flush().context("the recording cannot be written")?;
                let seconds = begun.elapsed().as_secs_f64();
                bar.set_message(format!("{seconds:.0} s, {}, {missed} missed", megabytes(file.bytes())));
            }
            () = signals.next() => return Ok(begun),
            () = &mut end => return Ok(begun),
        }
    }
}
