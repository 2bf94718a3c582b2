//! Reads one file of a recording, even if it is damaged.
//!
//! The reader steps from record to record by their lengths and needs neither the index nor the end of a file. Unreadable
//! parts are skipped and reported as [`Damage`]. A file is rejected only if none of its channels is one of a recording.

use std::{
    collections::BTreeMap,
    fs::File,
    io::{self, BufReader, Read, Seek, SeekFrom},
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::Context as _;
use mcap::{
    MAGIC,
    records::{Record, op},
};
use roundel_core::time::Timestamp;
use thiserror::Error;

use super::{
    chunk, megabytes,
    schema::{FORMAT_VERSION, FRAME_TOPIC_PREFIX, IMAGE_SCHEMA, METADATA, Topic},
};

const RECORD_HEADER_LEN: u64 = 9;

#[derive(Debug, Error)]
pub enum ReadError {
    #[error("cannot read {}: {source}", .path.display())]
    Open { path: PathBuf, source: io::Error },
    #[error("{}: expected a recording (an MCAP file written by `roundel record`), found {found}", .path.display())]
    Foreign {
        path: PathBuf,
        /// Description of the file.
        found: String,
    },
    #[error(
        "{}: recorded by Roundel {version} in format {format}, but this version reads formats up to {FORMAT_VERSION}: use \
         that version or a newer one",
        .path.display()
    )]
    Newer { path: PathBuf, version: String, format: u32 },
}

#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Channel {
    Topic(Topic),
    /// Frames of this camera.
    Frame(Arc<str>),
    /// A topic of another program.
    Foreign(Arc<str>),
}

impl Channel {
    pub fn name(&self) -> String {
        match self {
            Self::Topic(topic) => topic.name().to_owned(),
            Self::Frame(camera) => format!("{FRAME_TOPIC_PREFIX}{camera}"),
            Self::Foreign(topic) => topic.to_string(),
        }
    }
}

#[derive(Clone, Debug)]
pub struct RecordedMessage {
    pub channel: Channel,
    /// Time of recording.
    pub log_time: Timestamp,
    /// Time of the content.
    pub publish_time: Timestamp,
    pub sequence: u32,
    pub data: Vec<u8>,
}

/// Unreadable parts of a file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Damage {
    /// Descriptions in the order of the file.
    pub sentences: Vec<String>,
    /// Unreadable bytes.
    pub bytes: u64,
    /// The file has no end: it was truncated, or is still being written.
    pub is_cut_off: bool,
}

/// Position and times of a chunk.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ChunkInfo {
    /// First byte of its record.
    pub offset: u64,
    pub begin: Timestamp,
    pub end: Timestamp,
    /// Channels of its messages; empty without an index.
    channels: Vec<u16>,
}

pub struct FileReader {
    path: PathBuf,
    file: BufReader<File>,
    length: u64,
    metadata: BTreeMap<String, String>,
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, Channel>,
    chunks: Vec<ChunkInfo>,
    damage: Damage,
    next: usize,
}

impl FileReader {
    /// Opens a file and finds its chunks.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let failed = |source| ReadError::Open { path: path.to_owned(), source };
        let file = File::open(path).map_err(failed)?;
        let length = file.metadata().map_err(failed)?.len();
        let mut reader = Self {
            path: path.to_owned(),
            file: BufReader::with_capacity(1 << 18, file),
            length,
            metadata: BTreeMap::new(),
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            chunks: Vec::new(),
            damage: Damage::default(),
            next: 0,
        };
        reader.check_magic()?;
        reader.scan().map_err(failed)?;
        let format = reader.metadata.get("format").and_then(|format| format.parse().ok());
        if let Some(format) = format.filter(|&format: &u32| format > FORMAT_VERSION) {
            let version = reader.metadata.get("version").cloned().unwrap_or_default();
            return Err(ReadError::Newer { path: path.to_owned(), version, format });
        }
        if reader.damage.is_cut_off {
            // Channels are defined where they are first used; only the end of a file repeats them.
            while reader.next_chunk().map_err(failed)?.is_some() {}
            reader.next = 0;
        }
        if reader.channels.values().all(|channel| matches!(channel, Channel::Foreign(_))) {
            return Err(reader.not_a_recording());
        }
        Ok(reader)
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Length of the file, bytes.
    pub fn length(&self) -> u64 {
        self.length
    }

    pub fn metadata(&self) -> &BTreeMap<String, String> {
        &self.metadata
    }

    /// Damage found so far.
    pub fn damage(&self) -> &Damage {
        &self.damage
    }

    /// In the order of the file.
    pub fn chunks(&self) -> &[ChunkInfo] {
        &self.chunks
    }

    pub fn has_frames(&self) -> bool {
        self.channels.values().any(|channel| matches!(channel, Channel::Frame(_)))
    }

    /// Log times of the first and the last message.
    pub fn span(&self) -> Option<(Timestamp, Timestamp)> {
        // A chunk without messages has no times.
        let timed = || self.chunks.iter().filter(|chunk| chunk.end.as_ns() > 0);
        let begin = timed().map(|chunk| chunk.begin).min()?;
        let end = timed().map(|chunk| chunk.end).max()?;
        Some((begin, end))
    }

    /// Continues with the chunk of this number.
    pub fn seek(&mut self, chunk: usize) {
        self.next = chunk.min(self.chunks.len());
    }

    /// Number of the first chunk that ends at this time or later.
    pub fn chunk_at(&self, time: Timestamp) -> usize {
        self.chunks.partition_point(|chunk| chunk.end < time)
    }

    /// All messages of a topic, in the order of the file. Reads only chunks that may have some.
    pub fn collect(&mut self, topic: Topic) -> io::Result<Vec<RecordedMessage>> {
        let wanted = Channel::Topic(topic);
        let (next, mut all) = (self.next, Vec::new());
        for number in 0..self.chunks.len() {
            let channels = &self.chunks[number].channels;
            let is_wanted = |channel: &u16| self.channels.get(channel) == Some(&wanted);
            if channels.is_empty() || channels.iter().any(is_wanted) {
                self.seek(number);
                let messages = self.next_chunk()?.unwrap_or_default();
                all.extend(messages.into_iter().filter(|raw| raw.channel == wanted));
            }
        }
        self.next = next;
        Ok(all)
    }

    /// The messages of the next chunk (none if it is damaged); `None` at the end of the file.
    pub fn next_chunk(&mut self) -> io::Result<Option<Vec<RecordedMessage>>> {
        let Some(place) = self.chunks.get(self.next).cloned() else { return Ok(None) };
        self.next += 1;
        let body = self.record_at(place.offset)?;
        let messages = self.read_chunk(&body).unwrap_or_else(|why| {
            let lost = body.len() as u64;
            let sentence = format!(
                "the chunk at byte {} is corrupt ({why:#}): {} are lost",
                place.offset,
                megabytes(lost)
            );
            self.note_damage(lost, sentence);
            Vec::new()
        });
        Ok(Some(messages))
    }

    fn note_damage(&mut self, bytes: u64, sentence: String) {
        if !self.damage.sentences.contains(&sentence) {
            self.damage.sentences.push(sentence);
            self.damage.bytes += bytes;
        }
    }

    fn read_chunk(&mut self, body: &[u8]) -> anyhow::Result<Vec<RecordedMessage>> {
        let mut messages = Vec::new();
        let records = chunk::decompress(body)?;
        let mut rest = records.as_slice();
        while !rest.is_empty() {
            let (opcode, body, after) = chunk::split_record(rest)?;
            rest = after;
            match chunk::parse(opcode, body)? {
                Some(Record::Message { header, data }) => {
                    let channel = self.channels.get(&header.channel_id);
                    messages.push(RecordedMessage {
                        channel: channel
                            .with_context(|| format!("no channel {}", header.channel_id))?
                            .clone(),
                        log_time: time(header.log_time),
                        publish_time: time(header.publish_time),
                        sequence: header.sequence,
                        data: data.into_owned(),
                    });
                }
                Some(definition) => self.read_definition(definition),
                None => {}
            }
        }
        Ok(messages)
    }

    /// Registers schemas, channels and metadata.
    fn read_definition(&mut self, record: Record<'_>) {
        match record {
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                let schema = self.schemas.get(&channel.schema_id).map_or("", String::as_str);
                let ours = Topic::ALL
                    .into_iter()
                    .find(|topic| topic.name() == channel.topic && topic.schema() == schema);
                let known = match (ours, channel.topic.strip_prefix(FRAME_TOPIC_PREFIX)) {
                    (Some(topic), _) => Channel::Topic(topic),
                    (None, Some(camera)) if schema == IMAGE_SCHEMA => Channel::Frame(camera.into()),
                    _ => Channel::Foreign(channel.topic.as_str().into()),
                };
                self.channels.insert(channel.id, known);
            }
            Record::Metadata(metadata) if metadata.name == METADATA => {
                self.metadata = metadata.metadata;
            }
            _ => {}
        }
    }

    fn check_magic(&mut self) -> Result<(), ReadError> {
        let mut head = Vec::new();
        let failed = |source| ReadError::Open { path: self.path.clone(), source };
        (&mut self.file).take(MAGIC.len() as u64).read_to_end(&mut head).map_err(failed)?;
        if head == MAGIC {
            return Ok(());
        }
        let found = match head.as_slice() {
            [] => "an empty file".to_owned(),
            [0x89, b'P', b'N', b'G', ..] => "a PNG image".to_owned(),
            [0xff, 0xd8, ..] => "a JPEG image".to_owned(),
            bytes if MAGIC.starts_with(bytes) => format!("only {} bytes of one", bytes.len()),
            bytes => format!("a file that begins with {:?}", String::from_utf8_lossy(bytes)),
        };
        Err(ReadError::Foreign { path: self.path.clone(), found })
    }

    fn not_a_recording(&self) -> ReadError {
        let topics: Vec<String> = self.channels.values().map(Channel::name).collect();
        let found = if self.damage.is_cut_off && topics.is_empty() {
            let damage = self.damage.sentences.join("; ");
            format!("{} of one without a complete chunk: {damage}", megabytes(self.length))
        } else if topics.is_empty() {
            "an MCAP file without any topic".to_owned()
        } else {
            format!("an MCAP file of another program, with the topics {}", topics.join(", "))
        };
        ReadError::Foreign { path: self.path.clone(), found }
    }

    /// Finds the chunks, and reads all other records.
    fn scan(&mut self) -> io::Result<()> {
        let mut offset = MAGIC.len() as u64;
        loop {
            let left = self.length.saturating_sub(offset);
            let header = match left {
                ..RECORD_HEADER_LEN => None,
                _ => Some(self.record_header_at(offset)?),
            };
            let is_whole =
                |(opcode, length): &(u8, u64)| *opcode != 0 && *length <= left - RECORD_HEADER_LEN;
            let Some((opcode, length)) = header.filter(is_whole) else {
                self.note_truncation(offset, left);
                return Ok(());
            };
            match opcode {
                op::FOOTER => return Ok(()),
                op::CHUNK if length >= 16 => {
                    let mut times = [0; 16];
                    self.file.read_exact(&mut times)?;
                    let number = |half: &[u8]| half.try_into().map(u64::from_le_bytes).unwrap_or(0);
                    let (begin, end) = (time(number(&times[..8])), time(number(&times[8..])));
                    self.chunks.push(ChunkInfo { offset, begin, end, channels: Vec::new() });
                }
                op::MESSAGE_INDEX if length >= 2 => {
                    let mut channel = [0; 2];
                    self.file.read_exact(&mut channel)?;
                    if let Some(chunk) = self.chunks.last_mut() {
                        chunk.channels.push(u16::from_le_bytes(channel));
                    }
                }
                op::SCHEMA | op::CHANNEL | op::METADATA => {
                    let body = self.record_at(offset)?;
                    match chunk::parse(opcode, &body) {
                        Ok(Some(record)) => self.read_definition(record),
                        Ok(None) => {}
                        Err(error) => self.note_damage(
                            length,
                            format!("the record at byte {offset} is corrupt ({error})"),
                        ),
                    }
                }
                _ => {}
            }
            offset += RECORD_HEADER_LEN + length;
        }
    }

    fn note_truncation(&mut self, offset: u64, left: u64) {
        self.damage.is_cut_off = true;
        let lost = if left == 0 {
            "and nothing is lost".to_owned()
        } else {
            format!("and {} after the last complete chunk are lost", megabytes(left))
        };
        self.note_damage(left, format!(
            "the file has no end, as after a crash or during recording: it was read up to byte {offset}, {lost}"
        ));
    }

    fn record_header_at(&mut self, offset: u64) -> io::Result<(u8, u64)> {
        self.file.seek(SeekFrom::Start(offset))?;
        let mut head = [0; RECORD_HEADER_LEN as usize];
        self.file.read_exact(&mut head)?;
        let [opcode, length @ ..] = head;
        Ok((opcode, u64::from_le_bytes(length)))
    }

    fn record_at(&mut self, offset: u64) -> io::Result<Vec<u8>> {
        let (_, length) = self.record_header_at(offset)?;
        // The file may have been truncated since the scan.
        let mut body = Vec::new();
        (&mut self.file).take(length).read_to_end(&mut body)?;
        Ok(body)
    }
}

fn time(ns: u64) -> Timestamp {
    Timestamp::from_ns(i64::try_from(ns).unwrap_or(i64::MAX))
}

#[cfg(test)]
mod tests;
