//! What a recording says, in its order, from any place.
//!
//! A frame stands in the file after what was seen in it, since compressing takes a while. Who searches frames anew
//! needs them before: they are read ahead, and given by camera and number.

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

/// Compressing a frame takes no longer than this.
const READ_AHEAD_S: f64 = 1.0;

/// A recording that is being read.
pub struct Reader {
    file: FileReader,
    reads_ahead: bool,
    ready: VecDeque<RecordedMessage>,
    frames: BTreeMap<(Arc<str>, u32), RecordedMessage>,
    read_until: Option<Timestamp>,
    /// Messages of before are not given.
    from: Timestamp,
}

impl Reader {
    /// Opens a recording at its begin.
    pub fn open(path: &Path, reads_ahead: bool) -> Result<Self, ReplayError> {
        let file = FileReader::open(path)?;
        let from = file.span().map(|(begin, _)| begin).unwrap_or_default();
        let (ready, frames, read_until) = (VecDeque::new(), BTreeMap::new(), None);
        Ok(Self { file, reads_ahead, ready, frames, read_until, from })
    }

    pub fn file(&self) -> &FileReader {
        &self.file
    }

    /// Log times of the first and the last message.
    pub fn span(&self) -> (Timestamp, Timestamp) {
        self.file.span().unwrap_or_default()
    }

    /// All messages of a topic that can be read, with their log times.
    pub fn all<M: Message + Default>(
        &mut self,
        topic: Topic,
    ) -> Result<Vec<(Timestamp, M)>, ReplayError> {
        let raws = self.file.collect(topic).map_err(|source| self.failed(source))?;
        let read = |message: RecordedMessage| {
            Some((message.log_time, M::decode(message.data.as_slice()).ok()?))
        };
        Ok(raws.into_iter().filter_map(read).collect())
    }

    /// The first message of a topic.
    pub fn first(&mut self, topic: Topic) -> Result<Option<RecordedMessage>, ReplayError> {
        let raws = self.file.collect(topic).map_err(|source| self.failed(source))?;
        Ok(raws.into_iter().next())
    }

    /// Goes on with what was recorded then.
    pub fn seek(&mut self, time: Timestamp) {
        self.file.seek(self.file.chunk_at(time));
        (self.from, self.read_until) = (time, None);
        self.ready.clear();
        self.frames.clear();
    }

    /// The next message; `None` at the end.
    pub fn take(&mut self) -> Result<Option<RecordedMessage>, ReplayError> {
        loop {
            let is_near = |until: Timestamp, message: &RecordedMessage| {
                until.seconds_since(message.log_time) < READ_AHEAD_S
            };
            let wants_more = match (self.ready.front(), self.read_until) {
                (None, _) | (_, None) => true,
                (Some(message), Some(until)) => self.reads_ahead && is_near(until, message),
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

    /// A frame that was read ahead.
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

#[derive(Clone, Debug)]
pub enum FusionUpdate {
    Camera(v1::FusedCamera),
    /// Of objects and what they may do.
    Settings(v1::RecordedConfiguration),
}

/// What a recording says of itself at its begin, and of cameras and objects later on.
pub struct RecordingHeader {
    pub configuration: v1::RecordedConfiguration,
    /// Everything that fusion was told, in its order.
    pub updates: Vec<(Timestamp, FusionUpdate)>,
    /// The cameras, each as it was last.
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
