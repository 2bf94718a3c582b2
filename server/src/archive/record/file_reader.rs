//! A recording again, however broken its file is.
//!
//! Records are walked by their lengths, chunk by chunk, so that a file needs neither index nor end. What cannot be read
//! is left out and told as [`Damage`]; only a file in which nothing of ours can be read is an error.

mod parts;

use std::{
    collections::BTreeMap,
    fs::File,
    io::{self, BufReader, Read, Seek, SeekFrom},
    path::{Path, PathBuf},
};

use mcap::{
    MAGIC,
    read::ChunkReader,
    records::{Record, op},
};
pub use parts::{Channel, ChunkInfo, Damage, ReadError, RecordedMessage};
use roundel_core::time::Timestamp;

use super::{
    megabytes,
    schema::{FORMAT_VERSION, FRAME_TOPIC_PREFIX, IMAGE_SCHEMA, METADATA, Topic},
};

const RECORD_HEADER_LEN: u64 = 9;

/// A file that is being read.
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
            // The channels stand where they were first used; without an end nothing repeats them.
            while reader.next_chunk().map_err(failed)?.is_some() {}
            reader.next = 0;
        }
        if !reader.channels.values().any(|source| !matches!(source, Channel::Foreign(_))) {
            return Err(reader.not_a_recording());
        }
        Ok(reader)
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Its length, bytes.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// What its head says of it.
    pub fn metadata(&self) -> &BTreeMap<String, String> {
        &self.metadata
    }

    /// What could not be read so far.
    pub fn damage(&self) -> &Damage {
        &self.damage
    }

    /// Its chunks, in the order of the file.
    pub fn chunks(&self) -> &[ChunkInfo] {
        &self.chunks
    }

    /// Whether there are frames in it.
    pub fn has_frames(&self) -> bool {
        self.channels.values().any(|source| matches!(source, Channel::Frame(_)))
    }

    pub fn span(&self) -> Option<(Timestamp, Timestamp)> {
        // A chunk without messages, such as that of the schemas, has no times.
        let timed = || self.chunks.iter().filter(|chunk| chunk.end.as_ns() > 0);
        let begin = timed().map(|chunk| chunk.begin).min()?;
        let end = timed().map(|chunk| chunk.end).max()?;
        Some((begin, end))
    }

    /// Goes on with the chunk of this number.
    pub fn seek(&mut self, chunk: usize) {
        self.next = chunk.min(self.chunks.len());
    }

    /// The chunk in which something of this instant is, or of the next later one.
    pub fn chunk_at(&self, time: Timestamp) -> usize {
        self.chunks.partition_point(|chunk| chunk.end < time)
    }

    /// All messages of one topic, in the order of the file; only chunks that have some are read.
    pub fn collect(&mut self, topic: Topic) -> io::Result<Vec<RecordedMessage>> {
        let source = Channel::Topic(topic);
        let is_it = |channel: &u16| self.channels.get(channel) == Some(&source);
        let has = |chunk: &ChunkInfo| chunk.channels.is_empty() || chunk.channels.iter().any(is_it);
        let numbers: Vec<usize> =
            (0..self.chunks.len()).filter(|&number| has(&self.chunks[number])).collect();
        let (next, mut all) = (self.next, Vec::new());
        for number in numbers {
            self.seek(number);
            let messages = self.next_chunk()?.unwrap_or_default();
            all.extend(messages.into_iter().filter(|raw| raw.channel == source));
        }
        self.next = next;
        Ok(all)
    }

    /// The messages of the next chunk; `None` at the end. One that is broken is told and left out.
    pub fn next_chunk(&mut self) -> io::Result<Option<Vec<RecordedMessage>>> {
        let Some(place) = self.chunks.get(self.next).cloned() else { return Ok(None) };
        self.next += 1;
        let body = self.record_at(place.offset)?;
        let mut messages = Vec::new();
        if let Err(why) = self.read_chunk(&body, &mut messages) {
            self.note_damage(
                body.len() as u64,
                format!(
                    "the chunk at byte {} is broken ({why}): {} of it are lost",
                    place.offset,
                    megabytes(body.len() as u64)
                ),
            );
            messages.clear();
        }
        Ok(Some(messages))
    }

    fn note_damage(&mut self, bytes: u64, sentence: String) {
        if !self.damage.sentences.contains(&sentence) {
            self.damage.sentences.push(sentence);
            self.damage.bytes += bytes;
        }
    }

    fn read_chunk(
        &mut self,
        body: &[u8],
        messages: &mut Vec<RecordedMessage>,
    ) -> Result<(), String> {
        let told = |error: mcap::McapError| error.to_string();
        let Record::Chunk { header, data } =
            mcap::read::parse_record(op::CHUNK, body).map_err(told)?
        else {
            return Ok(());
        };
        for record in ChunkReader::new(header, &data).map_err(told)? {
            match record.map_err(told)? {
                Record::Message { header, data } => {
                    let Some(source) = self.channels.get(&header.channel_id) else {
                        return Err(format!("no channel {}", header.channel_id));
                    };
                    messages.push(RecordedMessage {
                        channel: source.clone(),
                        log_time: time(header.log_time),
                        publish_time: time(header.publish_time),
                        sequence: header.sequence,
                        data: data.into_owned(),
                    });
                }
                other => self.read_definition(other),
            }
        }
        Ok(())
    }

    /// Takes what says how messages are to be read.
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
                let source = match (ours, channel.topic.strip_prefix(FRAME_TOPIC_PREFIX)) {
                    (Some(topic), _) => Channel::Topic(topic),
                    (None, Some(camera)) if schema == IMAGE_SCHEMA => Channel::Frame(camera.into()),
                    _ => Channel::Foreign(channel.topic.as_str().into()),
                };
                self.channels.insert(channel.id, source);
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
            format!("the begin of one, {}, without a complete chunk", megabytes(self.length))
        } else if topics.is_empty() {
            "an MCAP file without any topic".to_owned()
        } else {
            format!("an MCAP file of something else, with the topics {}", topics.join(", "))
        };
        ReadError::Foreign { path: self.path.clone(), found }
    }

    /// Notes where chunks are, and all else outside of them.
    fn scan(&mut self) -> io::Result<()> {
        let mut offset = MAGIC.len() as u64;
        loop {
            let left = self.length.saturating_sub(offset);
            if left < RECORD_HEADER_LEN {
                self.note_truncation(offset, left);
                return Ok(());
            }
            let (opcode, length) = self.record_header_at(offset)?;
            if opcode == 0 || length > left - RECORD_HEADER_LEN {
                self.note_truncation(offset, left);
                return Ok(());
            }
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
                    let channel = u16::from_le_bytes(channel);
                    self.chunks
                        .iter_mut()
                        .last()
                        .into_iter()
                        .for_each(|it| it.channels.push(channel));
                }
                op::SCHEMA | op::CHANNEL | op::METADATA => {
                    let body = self.record_at(offset)?;
                    match mcap::read::parse_record(opcode, &body) {
                        Ok(record) => self.read_definition(record.into_owned()),
                        Err(error) => self.note_damage(
                            length,
                            format!("the record at byte {offset} is broken ({error})"),
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
            "nothing after its last complete chunk".to_owned()
        } else {
            format!("{} after its last complete chunk are lost", megabytes(left))
        };
        self.note_damage(left, format!(
            "the file has no end, as after a crash or while it is written: it was read up to byte {offset}, {lost}"
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
        // A file may have been cut since it was walked.
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
