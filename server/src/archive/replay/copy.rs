//! A recording fused anew into another one, as fast as it goes: the same bits each time.

use std::{collections::BTreeMap, io, path::Path, time::Duration};

use prost::Message;

use super::{ReplayError, scene::Scene};
use crate::archive::record::{
    item::write_item,
    reader::{Raw, Source},
    schema::{CompressedImage, Topic},
    writer::{FileWriter, Stamp},
};
use crate::model::tap::{Item, Outlet};

/// A chunk is closed after so many recorded seconds, as in recordings that are made live.
const FLUSH_EVERY: Duration = Duration::from_millis(500);

/// What came of it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Copied {
    /// Messages that were written.
    pub messages: u64,
    /// Of them, snapshots.
    pub snapshots: u64,
    /// Length of the new file.
    pub bytes: u64,
    /// Messages that said what cannot be, and were left out.
    pub faulty: u64,
    /// Of the recording.
    pub seconds: f64,
}

/// Plays a recording into a file that is not there yet; `advance` hears of each second that is done.
pub fn copy(
    mut scene: Scene,
    to: &Path,
    mut advance: impl FnMut(f64),
) -> Result<Copied, ReplayError> {
    let failed = |source| ReplayError::Io { path: to.to_owned(), source };
    let (begin, end) = scene.script.span();
    let installation = scene.hub.installation();
    let about = BTreeMap::from([
        ("installation".to_owned(), installation.name.clone()),
        ("source_id".to_owned(), installation.source_id.clone()),
    ]);
    let mut file = FileWriter::create(to, &about).map_err(failed)?;
    let Outlet { items, frames: _frames, back: _back, known: _ } = scene.hub.tap().open(0);
    scene.stage.restart(&scene.told, begin)?;
    // Nothing is fused: it becomes a whole file of what can be read.
    let wants_all = !scene.stage.fuses();
    let (mut copied, mut flushed, mut newest) = (Copied::default(), begin, begin);
    while let Some(raw) = scene.script.take()? {
        newest = newest.max(raw.log_time);
        scene.stage.show(&raw, &mut scene.script);
        copy_as_it_is(&mut file, &raw, wants_all).map_err(failed)?;
        if wants_all {
            items.try_iter().for_each(drop);
        }
        let installation = scene.hub.installation();
        for item in items.try_iter() {
            let item = match item {
                // It is copied as it is.
                Item::Settings(_) => continue,
                // When it is taken now is nothing that repeats.
                Item::Observed(observations, _) => Item::Observed(observations, newest),
                item => item,
            };
            write_item(&mut file, &installation, &item, newest).map_err(failed)?;
        }
        if raw.source == Source::Topic(Topic::Snapshots) {
            copied.snapshots += 1;
            advance(newest.seconds_since(begin));
        }
        if newest.seconds_since(flushed) >= FLUSH_EVERY.as_secs_f64() {
            file.flush().map_err(failed)?;
            flushed = newest;
        }
    }
    scene.hub.tap().close();
    (copied.messages, copied.faulty) = (file.messages(), scene.stage.faulty());
    copied.seconds = end.seconds_since(begin);
    copied.bytes = file.finish().map_err(failed)?;
    Ok(copied)
}

/// What nobody makes anew.
fn copy_as_it_is(file: &mut FileWriter, raw: &Raw, wants_all: bool) -> io::Result<()> {
    let sequence = u64::from(raw.sequence);
    let stamp = Stamp { log_time: raw.log_time, publish_time: raw.publish_time, sequence };
    match &raw.source {
        Source::Topic(topic) => {
            let is_copied = wants_all || matches!(topic, Topic::Health | Topic::Configuration);
            if is_copied { file.write_encoded(*topic, stamp, &raw.data) } else { Ok(()) }
        }
        Source::Frame(camera) if wants_all => match CompressedImage::decode(raw.data.as_slice()) {
            Ok(image) => file.write_frame(camera, stamp, &image),
            Err(_) => Ok(()),
        },
        Source::Frame(_) | Source::Foreign(_) => Ok(()),
    }
}
