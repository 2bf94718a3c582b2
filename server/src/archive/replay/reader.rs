//! Reads a recording's messages in order, from any time.
//!
//! In the file, a frame follows its observations, since compression takes a while. A replay from frames needs them
//! earlier: they are read ahead and returned by camera and number.

use std::{
    collections::{BTreeMap, VecDeque},
    io,
    path::Path,
    sync::Arc,
};

use prost::Message;
use roundel_core::time::Timestamp;
use roundel_proto::v1;

use super::ReplayError;
use crate::archive::record::{
    file_reader::{Channel, FileReader, RecordedMessage},
    schema::Topic,
};

/// Longest delay of a frame by compression.
const READ_AHEAD_S: f64 = 1.0;

pub struct Reader {
    file: FileReader,
    reads_ahead: bool,
    ready: VecDeque<RecordedMessage>,
    frames: BTreeMap<(Arc<str>, u32), RecordedMessage>,
    read_until: Option<Timestamp>,
    /// Earlier messages are skipped.
    from: Timestamp,
}

impl Reader {
    pub fn open(path: &Path, reads_ahead: bool) -> Result<Self, ReplayError> {
        let file = FileReader::open(path)?;
        let (from, _) = file.span().unwrap_or_default();
        let (ready, frames) = (VecDeque::new(), BTreeMap::new());
        Ok(Self { file, reads_ahead, ready, frames, read_until: None, from })
    }

    pub fn file(&self) -> &FileReader {
        &self.file
    }

    /// Log times of the first and the last message.
    pub fn span(&self) -> (Timestamp, Timestamp) {
        self.file.span().unwrap_or_default()
    }

    /// All readable messages of a topic, with their log times.
    pub fn all<M: Message + Default>(
        &mut self,
        topic: Topic,
    ) -> Result<Vec<(Timestamp, M)>, ReplayError> {
        let raws = self.collect(topic)?;
        let read = |message: RecordedMessage| {
            Some((message.log_time, M::decode(message.data.as_slice()).ok()?))
        };
        Ok(raws.into_iter().filter_map(read).collect())
    }

    /// The first message of a topic.
    pub fn first(&mut self, topic: Topic) -> Result<Option<RecordedMessage>, ReplayError> {
        Ok(self.collect(topic)?.into_iter().next())
    }

    fn collect(&mut self, topic: Topic) -> Result<Vec<RecordedMessage>, ReplayError> {
        self.file.collect(topic).map_err(|source| self.failed(source))
    }

    /// Continues with the messages from this time on.
    pub fn seek(&mut self, time: Timestamp) {
        self.file.seek(self.file.chunk_at(time));
        (self.from, self.read_until) = (time, None);
        self.ready.clear();
        self.frames.clear();
    }

    /// The next message; `None` at the end.
    pub fn take(&mut self) -> Result<Option<RecordedMessage>, ReplayError> {
        loop {
            let wants_more = match (self.ready.front(), self.read_until) {
                (Some(message), Some(until)) => {
                    self.reads_ahead && until.seconds_since(message.log_time) < READ_AHEAD_S
                }
                _ => true,
            };
            if !wants_more || !self.read().map_err(|source| self.failed(source))? {
                break;
            }
        }
        let next = self.ready.pop_front();
        if let Some(message) = &next {
            let old = message.log_time.plus_seconds(-2.0 * READ_AHEAD_S);
            self.frames.retain(|_, frame| frame.log_time >= old);
        }
        Ok(next)
    }

    /// Takes a frame that was read ahead.
    pub fn frame(&mut self, camera: &str, number: u32) -> Option<RecordedMessage> {
        self.frames.remove(&(Arc::from(camera), number))
    }

    fn read(&mut self) -> io::Result<bool> {
        let Some(messages) = self.file.next_chunk()? else { return Ok(false) };
        for message in messages {
            self.read_until = self.read_until.max(Some(message.log_time));
            if message.log_time < self.from {
                continue;
            }
            match &message.channel {
                Channel::Frame(camera) if self.reads_ahead => {
                    self.frames.insert((camera.clone(), message.sequence), message);
                }
                _ => self.ready.push_back(message),
            }
        }
        Ok(true)
    }

    fn failed(&self, source: io::Error) -> ReplayError {
        ReplayError::Io { path: self.file.path().to_owned(), source }
    }
}

/// A recorded change of fusion.
#[derive(Clone, Debug)]
pub enum FusionUpdate {
    Camera(v1::FusedCamera),
    Settings(v1::RecordedConfiguration),
}

/// Messages of a recording that a replay needs in advance.
pub struct RecordingHeader {
    /// The first configuration.
    pub configuration: v1::RecordedConfiguration,
    /// Every change of fusion, in order.
    pub updates: Vec<(Timestamp, FusionUpdate)>,
    /// The last state of each camera, by name.
    pub cameras: BTreeMap<String, v1::Camera>,
}

impl RecordingHeader {
    pub fn read(reader: &mut Reader) -> Result<Self, ReplayError> {
        let configurations = reader.all::<v1::RecordedConfiguration>(Topic::Configuration)?;
        let configuration = configurations.first().map(|(_, it)| it.clone());
        let settings = configurations.into_iter().filter(|(_, it)| it.fused);
        let settings = settings.map(|(time, it)| (time, FusionUpdate::Settings(it)));
        let of_cameras = reader.all(Topic::Calibration)?.into_iter();
        let mut updates: Vec<_> =
            of_cameras.map(|(time, it)| (time, FusionUpdate::Camera(it))).chain(settings).collect();
        updates.sort_by_key(|(time, _)| *time);
        let mut cameras = BTreeMap::new();
        for (_, list) in reader.all::<v1::ListCamerasResponse>(Topic::Health)? {
            cameras.extend(list.cameras.into_iter().map(|camera| (camera.name.clone(), camera)));
        }
        Ok(Self { configuration: configuration.unwrap_or_default(), updates, cameras })
    }
}
