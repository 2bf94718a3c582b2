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
    reader::{Raw, Reader, Source},
    schema::Topic,
};

/// Compressing a frame takes no longer than this.
const AHEAD_S: f64 = 1.0;

/// A recording that is being read.
pub struct Script {
    reader: Reader,
    reads_ahead: bool,
    ready: VecDeque<Raw>,
    frames: BTreeMap<(Arc<str>, u32), Raw>,
    read_until: Option<Timestamp>,
    /// Messages of before are not given.
    from: Timestamp,
}

impl Script {
    /// Opens a recording at its begin.
    pub fn open(path: &Path, reads_ahead: bool) -> Result<Self, ReplayError> {
        let reader = Reader::open(path)?;
        let from = reader.span().map(|(begin, _)| begin).unwrap_or_default();
        let (ready, frames, read_until) = (VecDeque::new(), BTreeMap::new(), None);
        Ok(Self { reader, reads_ahead, ready, frames, read_until, from })
    }

    /// The file.
    pub fn reader(&self) -> &Reader {
        &self.reader
    }

    /// Log times of the first and the last message.
    pub fn span(&self) -> (Timestamp, Timestamp) {
        self.reader.span().unwrap_or_default()
    }

    /// All messages of a topic that can be read, with their log times.
    pub fn all<M: Message + Default>(
        &mut self,
        topic: Topic,
    ) -> Result<Vec<(Timestamp, M)>, ReplayError> {
        let raws = self.reader.collect(topic).map_err(|source| self.failed(source))?;
        let read = |raw: Raw| Some((raw.log_time, M::decode(raw.data.as_slice()).ok()?));
        Ok(raws.into_iter().filter_map(read).collect())
    }

    /// The first message of a topic.
    pub fn first(&mut self, topic: Topic) -> Result<Option<Raw>, ReplayError> {
        let raws = self.reader.collect(topic).map_err(|source| self.failed(source))?;
        Ok(raws.into_iter().next())
    }

    /// Goes on with what was recorded then.
    pub fn seek(&mut self, time: Timestamp) {
        self.reader.seek(self.reader.chunk_at(time));
        (self.from, self.read_until) = (time, None);
        self.ready.clear();
        self.frames.clear();
    }

    /// The next message; `None` at the end.
    pub fn take(&mut self) -> Result<Option<Raw>, ReplayError> {
        loop {
            let is_near = |until: Timestamp, raw: &Raw| until.seconds_since(raw.log_time) < AHEAD_S;
            let wants_more = match (self.ready.front(), self.read_until) {
                (None, _) | (_, None) => true,
                (Some(raw), Some(until)) => self.reads_ahead && is_near(until, raw),
            };
            if !wants_more || !self.read().map_err(|source| self.failed(source))? {
                break;
            }
        }
        let next = self.ready.pop_front();
        if let Some(raw) = &next {
            let old = raw.log_time.plus_seconds(-2.0 * AHEAD_S);
            self.frames.retain(|_, frame| frame.log_time >= old);
        }
        Ok(next)
    }

    /// A frame that was read ahead.
    pub fn frame(&mut self, camera: &str, number: u32) -> Option<Raw> {
        self.frames.remove(&(Arc::from(camera), number))
    }

    /// Whether there was another chunk.
    fn read(&mut self) -> io::Result<bool> {
        let Some(messages) = self.reader.next_chunk()? else { return Ok(false) };
        for raw in messages {
            self.read_until = self.read_until.max(Some(raw.log_time));
            if raw.log_time < self.from {
                continue;
            }
            match &raw.source {
                Source::Frame(camera) if self.reads_ahead => {
                    self.frames.insert((camera.clone(), raw.sequence), raw);
                }
                _ => self.ready.push_back(raw),
            }
        }
        Ok(true)
    }

    fn failed(&self, source: io::Error) -> ReplayError {
        ReplayError::Io { path: self.reader.path().to_owned(), source }
    }
}

/// What fusion was told.
#[derive(Clone, Debug)]
pub enum Told {
    /// Of a camera.
    Camera(v1::FusedCamera),
    /// Of objects and what they may do.
    Settings(v1::RecordedConfiguration),
}

/// What a recording says of itself at its begin, and of cameras and objects later on.
pub struct Prologue {
    /// What it was recorded with.
    pub configuration: v1::RecordedConfiguration,
    /// Everything that fusion was told, in its order.
    pub told: Vec<(Timestamp, Told)>,
    /// The cameras, each as it was last.
    pub cameras: BTreeMap<String, v1::Camera>,
}

impl Prologue {
    /// Reads it.
    pub fn read(script: &mut Script) -> Result<Self, ReplayError> {
        let configurations = script.all::<v1::RecordedConfiguration>(Topic::Configuration)?;
        let configuration = configurations.first().map(|(_, it)| it.clone());
        let settings = configurations.into_iter().filter(|(_, it)| it.fused);
        let settings = settings.map(|(time, it)| (time, Told::Settings(it)));
        let of_cameras = script.all(Topic::Calibration)?.into_iter();
        let mut told: Vec<_> =
            of_cameras.map(|(time, it)| (time, Told::Camera(it))).chain(settings).collect();
        told.sort_by_key(|(time, _)| *time);
        let mut cameras = BTreeMap::new();
        for (_, list) in script.all::<v1::ListCamerasResponse>(Topic::Health)? {
            cameras.extend(list.cameras.into_iter().map(|camera| (camera.name.clone(), camera)));
        }
        Ok(Self { configuration: configuration.unwrap_or_default(), told, cameras })
    }
}
