//! Writes one file of a recording.
//!
//! Messages are collected in chunks, and each chunk is compressed and written at once. After a crash, the file is readable up
//! to its last complete chunk. After a failed write, it is truncated to its last complete chunk.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::{self, BufWriter},
    path::{Path, PathBuf},
};

use mcap::{WriteOptions, records::MessageHeader, write::NoSeek};
use prost::Message;
use roundel_core::time::Timestamp;

use super::schema::{
    ENCODING, FORMAT_VERSION, FRAME_TOPIC_PREFIX, IMAGE_SCHEMA, METADATA, Topic, descriptors,
    image_descriptors,
};
use crate::model::text_file;

/// A chunk is closed at this size, uncompressed.
const CHUNK_BYTES: u64 = 1 << 20;
/// Floating-point numbers hardly compress, so a higher level gains little.
const COMPRESSION_LEVEL: u32 = 1;
const BUFFER_BYTES: usize = 1 << 18;

type Writer = mcap::Writer<NoSeek<BufWriter<File>>>;

#[derive(Clone, Copy, Debug, Default)]
pub struct MessageStamp {
    /// Time of recording.
    pub log_time: Timestamp,
    /// Time of the content.
    pub publish_time: Timestamp,
    /// Sequence number within the channel.
    pub sequence: u64,
}

impl MessageStamp {
    pub fn at(time: Timestamp, sequence: u64) -> Self {
        Self { log_time: time, publish_time: time, sequence }
    }
}

pub struct FileWriter {
    path: PathBuf,
    writer: Writer,
    /// The same file, for its length and for syncing.
    file: File,
    /// Length after the last complete chunk.
    complete_bytes: u64,
    channels: [u16; Topic::ALL.len()],
    frames: BTreeMap<String, u16>,
    messages: u64,
}

impl FileWriter {
    /// Creates a file with `about` in its header; fails if the file exists.
    pub fn create(path: &Path, about: &BTreeMap<String, String>) -> io::Result<Self> {
        let file = File::options().write(true).create_new(true).open(path)?;
        // On a full disk, a file without its header is of no use.
        Self::begin(path, file, about).inspect_err(|_| drop(fs::remove_file(path)))
    }

    fn begin(path: &Path, file: File, about: &BTreeMap<String, String>) -> io::Result<Self> {
        let options = WriteOptions::new()
            .profile("")
            .library(concat!("roundel ", env!("CARGO_PKG_VERSION")))
            .chunk_size(Some(CHUNK_BYTES))
            .compression_level(COMPRESSION_LEVEL)
            .compression_threads(0)
            // Chunks are written when they are complete.
            .disable_seeking(true);
        let sink = NoSeek::new(BufWriter::with_capacity(BUFFER_BYTES, file.try_clone()?));
        let mut writer = options.create(sink).map_err(io_error)?;
        let mut metadata = about.clone();
        metadata.insert("format".into(), FORMAT_VERSION.to_string());
        metadata.insert("version".into(), env!("CARGO_PKG_VERSION").into());
        let record = mcap::records::Metadata { name: METADATA.into(), metadata };
        writer.write_metadata(&record).map_err(io_error)?;
        let mut channels = [0; Topic::ALL.len()];
        for (channel, topic) in channels.iter_mut().zip(Topic::ALL) {
            let (schema, data) = (topic.schema(), descriptors(topic.schema()));
            *channel = add_channel(&mut writer, topic.name(), schema, &data)?;
        }
        text_file::sync_folder_of(path);
        let mut writer = Self {
            path: path.to_owned(),
            writer,
            file,
            complete_bytes: 0,
            channels,
            frames: BTreeMap::new(),
            messages: 0,
        };
        writer.flush()?;
        Ok(writer)
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes written so far.
    pub fn bytes(&self) -> u64 {
        self.file.metadata().map_or(self.complete_bytes, |file| file.len())
    }

    pub fn messages(&self) -> u64 {
        self.messages
    }

    pub fn write(
        &mut self,
        topic: Topic,
        stamp: MessageStamp,
        message: &impl Message,
    ) -> io::Result<()> {
        self.write_encoded(topic, stamp, &message.encode_to_vec())
    }

    pub fn write_encoded(
        &mut self,
        topic: Topic,
        stamp: MessageStamp,
        bytes: &[u8],
    ) -> io::Result<()> {
        self.put(self.channels[topic as usize], stamp, bytes)
    }

    /// Writes an encoded [`CompressedImage`](super::schema::CompressedImage); the stamp has the frame's number.
    pub fn write_frame(
        &mut self,
        camera: &str,
        stamp: MessageStamp,
        image: &[u8],
    ) -> io::Result<()> {
        let channel = match self.frames.get(camera) {
            Some(channel) => *channel,
            None => {
                let topic = format!("{FRAME_TOPIC_PREFIX}{camera}");
                let data = image_descriptors();
                let channel = add_channel(&mut self.writer, &topic, IMAGE_SCHEMA, &data)?;
                self.frames.insert(camera.to_owned(), channel);
                channel
            }
        };
        self.put(channel, stamp, image)
    }

    fn put(&mut self, channel_id: u16, stamp: MessageStamp, data: &[u8]) -> io::Result<()> {
        let ns = |time: Timestamp| u64::try_from(time.as_ns()).unwrap_or(0);
        let header = MessageHeader {
            channel_id,
            // The format has 32 bits.
            sequence: stamp.sequence as u32,
            log_time: ns(stamp.log_time),
            publish_time: ns(stamp.publish_time),
        };
        self.writer.write_to_known_channel(&header, data).map_err(io_error)?;
        self.messages += 1;
        Ok(())
    }

    /// Closes the chunk and writes it, so that all messages so far survive a crash of the process.
    pub fn flush(&mut self) -> io::Result<()> {
        self.writer.flush().map_err(io_error)?;
        self.complete_bytes = self.bytes();
        Ok(())
    }

    /// Waits for the disk, so that everything flushed so far survives a power failure.
    pub fn sync(&self) -> io::Result<()> {
        self.file.sync_data()
    }

    /// Writes the index and the end; returns the length.
    pub fn finish(mut self) -> io::Result<u64> {
        self.flush()?;
        self.writer.finish().map_err(io_error)?;
        self.file.sync_all()?;
        Ok(self.bytes())
    }

    /// Truncates the file to its last complete chunk; returns the length.
    pub fn truncate_to_complete(self) -> u64 {
        let Self { writer, file, complete_bytes, .. } = self;
        // Dropping the writer makes it try to write the end of the file.
        drop(writer);
        if let Err(error) = file.set_len(complete_bytes) {
            tracing::warn!(%error, "could not truncate the file of a failed recording");
        }
        complete_bytes
    }
}

fn add_channel(writer: &mut Writer, topic: &str, schema: &str, data: &[u8]) -> io::Result<u16> {
    let schema = writer.add_schema(schema, ENCODING, data).map_err(io_error)?;
    writer.add_channel(schema, topic, ENCODING, &BTreeMap::new()).map_err(io_error)
}

fn io_error(error: mcap::McapError) -> io::Error {
    match error {
        mcap::McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}
