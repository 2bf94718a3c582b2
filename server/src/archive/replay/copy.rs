//! Fuses a recording again into another file, at full speed. The result is reproducible bit by bit.

use std::{collections::BTreeMap, io, path::Path, time::Duration};

use super::{ReplayError, session::ReplaySession};
use crate::archive::record::{
    file_reader::{Channel, RecordedMessage},
    file_writer::{FileWriter, MessageStamp},
    item::write_item,
    schema::Topic,
};
use crate::model::tap::{RecordedItem, TapReceiver};

/// Recorded time per chunk, as in live recordings.
const FLUSH_INTERVAL: Duration = Duration::from_millis(500);

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CopySummary {
    pub messages: u64,
    pub snapshots: u64,
    pub bytes: u64,
    /// Messages skipped as invalid.
    pub invalid_messages: u64,
    pub seconds: f64,
}

/// Plays a recording into a new file. Calls `advance` with the recorded seconds done.
pub fn copy(
    mut session: ReplaySession,
    to: &Path,
    mut advance: impl FnMut(f64),
) -> Result<CopySummary, ReplayError> {
    let failed = |source| ReplayError::Io { path: to.to_owned(), source };
    let (begin, end) = session.reader.span();
    let installation = session.hub.installation();
    let about = BTreeMap::from([
        ("installation".to_owned(), installation.name.clone()),
        ("source_id".to_owned(), installation.source_id.clone()),
    ]);
    let mut file = FileWriter::create(to, &about).map_err(failed)?;
    let TapReceiver { items, frames: _frames, compressed: _compressed, camera_updates: _ } =
        session.hub.tap().open(0);
    session.engine.restart(&session.updates, begin)?;
    // Without fusion, the result is a complete file of every readable message.
    let wants_all = !session.engine.fuses();
    let (mut copied, mut flushed, mut newest) = (CopySummary::default(), begin, begin);
    while let Some(raw) = session.reader.take()? {
        newest = newest.max(raw.log_time);
        session.engine.process(&raw, &mut session.reader);
        copy_unchanged(&mut file, &raw, wants_all).map_err(failed)?;
        if wants_all {
            items.try_iter().for_each(drop);
        }
        let installation = session.hub.installation();
        for item in items.try_iter() {
            let item = match item {
                // Copied unchanged.
                RecordedItem::Settings(_) => continue,
                // The current time is not reproducible.
                RecordedItem::Detections(observations, _) => {
                    RecordedItem::Detections(observations, newest)
                }
                item => item,
            };
            write_item(&mut file, &installation, &item, newest).map_err(failed)?;
        }
        if raw.channel == Channel::Topic(Topic::Snapshots) {
            copied.snapshots += 1;
            advance(newest.seconds_since(begin));
        }
        if newest.seconds_since(flushed) >= FLUSH_INTERVAL.as_secs_f64() {
            file.flush().map_err(failed)?;
            flushed = newest;
        }
    }
    session.hub.tap().close();
    (copied.messages, copied.invalid_messages) =
        (file.messages(), session.engine.invalid_messages());
    copied.seconds = end.seconds_since(begin);
    copied.bytes = file.finish().map_err(failed)?;
    Ok(copied)
}

fn copy_unchanged(file: &mut FileWriter, raw: &RecordedMessage, wants_all: bool) -> io::Result<()> {
    let sequence = u64::from(raw.sequence);
    let stamp = MessageStamp { log_time: raw.log_time, publish_time: raw.publish_time, sequence };
    match &raw.channel {
        Channel::Topic(topic)
            if wants_all || matches!(topic, Topic::Health | Topic::Configuration) =>
        {
            file.write_encoded(*topic, stamp, &raw.data)
        }
        Channel::Frame(camera) if wants_all => file.write_frame(camera, stamp, &raw.data),
        _ => Ok(()),
    }
}
