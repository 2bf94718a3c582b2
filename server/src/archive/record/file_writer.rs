//! One file of a recording.
//!
//! Messages gather in chunks, which are compressed and written whole: what a crash leaves is readable to the last
//! complete chunk. A failed write leaves no torn chunk either: the file is cut back to the last complete one.

use std::{
    collections::BTreeMap,
    fs::File,
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use mcap::{WriteOptions, records::MessageHeader, write::NoSeek};
use prost::Message;
use roundel_core::time::Timestamp;

use super::schema::{
    CompressedImage, ENCODING, FORMAT_VERSION, FRAME_TOPIC_PREFIX, IMAGE_SCHEMA, METADATA, Topic,
    descriptors, image_descriptors,
};

/// A chunk is closed when it has grown to so much, uncompressed.
const CHUNK_BYTES: u64 = 1 << 20;
/// Doubles hardly compress, so more effort gains next to nothing.
const COMPRESSION_LEVEL: u32 = 1;
const BUFFER_BYTES: usize = 1 << 18;

type Writer = mcap::Writer<NoSeek<BufWriter<CountingFile>>>;

/// A file that knows how long it is.
struct CountingFile {
    file: File,
    written: Arc<AtomicU64>,
}

impl Write for CountingFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.file.write(bytes)?;
        self.written.fetch_add(count as u64, Ordering::Relaxed);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// A message's times and number.
#[derive(Clone, Copy, Debug, Default)]
pub struct MessageStamp {
    /// When it was recorded.
    pub log_time: Timestamp,
    /// When it was made.
    pub publish_time: Timestamp,
    /// Counts the messages of its kind.
    pub sequence: u64,
}

impl MessageStamp {
    /// Both times are one.
    pub fn at(time: Timestamp, sequence: u64) -> Self {
        Self { log_time: time, publish_time: time, sequence }
    }
}

/// A file that is being written.
pub struct FileWriter {
    path: PathBuf,
    writer: Writer,
    /// The same file, to be forced to the disk and cut.
    file: File,
    written: Arc<AtomicU64>,
    /// So long it was after the last complete chunk.
    complete_bytes: u64,
    channels: [u16; Topic::ALL.len()],
    frames: BTreeMap<String, u16>,
    messages: u64,
    buffer: Vec<u8>,
}

impl FileWriter {
    /// Begins a file that is not there yet; `about` is put into its head.
    pub fn create(path: &Path, about: &BTreeMap<String, String>) -> io::Result<Self> {
        let file = File::options().write(true).create_new(true).open(path)?;
        let written = Arc::<AtomicU64>::default();
        let sink = CountingFile { file: file.try_clone()?, written: written.clone() };
        let options = WriteOptions::new()
            .profile("")
            .library(concat!("roundel ", env!("CARGO_PKG_VERSION")))
            .chunk_size(Some(CHUNK_BYTES))
            .compression_level(COMPRESSION_LEVEL)
            .compression_threads(0)
            // Chunks are written when they are whole.
            .disable_seeking(true);
        let sink = NoSeek::new(BufWriter::with_capacity(BUFFER_BYTES, sink));
        let mut writer = options.create(sink).map_err(io_error)?;
        let mut metadata = about.clone();
        metadata.insert("format".into(), FORMAT_VERSION.to_string());
        metadata.insert("version".into(), env!("CARGO_PKG_VERSION").into());
        let record = mcap::records::Metadata { name: METADATA.into(), metadata };
        writer.write_metadata(&record).map_err(io_error)?;
        let mut channels = [0; Topic::ALL.len()];
        for (channel, topic) in channels.iter_mut().zip(Topic::ALL) {
            let data = descriptors(topic.schema());
            let schema = writer.add_schema(topic.schema(), ENCODING, &data).map_err(io_error)?;
            *channel = writer
                .add_channel(schema, topic.name(), ENCODING, &BTreeMap::new())
                .map_err(io_error)?;
        }
        let mut writer = Self {
            path: path.to_owned(),
            writer,
            file,
            written,
            complete_bytes: 0,
            channels,
            frames: BTreeMap::new(),
            messages: 0,
            buffer: Vec::new(),
        };
        writer.flush()?;
        Ok(writer)
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How much of it is written.
    pub fn bytes(&self) -> u64 {
        self.written.load(Ordering::Relaxed)
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
        self.buffer.clear();
        message.encode(&mut self.buffer).map_err(io::Error::other)?;
        let channel = self.channels[topic as usize];
        self.put(channel, stamp)
    }

    /// Adds a message as it went over the wire.
    pub fn write_encoded(
        &mut self,
        topic: Topic,
        stamp: MessageStamp,
        bytes: &[u8],
    ) -> io::Result<()> {
        self.buffer.clear();
        self.buffer.extend_from_slice(bytes);
        self.put(self.channels[topic as usize], stamp)
    }

    /// Adds a camera's picture; the stamp's number is the frame's.
    pub fn write_frame(
        &mut self,
        camera: &str,
        stamp: MessageStamp,
        image: &CompressedImage,
    ) -> io::Result<()> {
        let channel = match self.frames.get(camera) {
            Some(channel) => *channel,
            None => {
                let data = image_descriptors();
                let schema =
                    self.writer.add_schema(IMAGE_SCHEMA, ENCODING, &data).map_err(io_error)?;
                let topic = format!("{FRAME_TOPIC_PREFIX}{camera}");
                let channel = self
                    .writer
                    .add_channel(schema, &topic, ENCODING, &BTreeMap::new())
                    .map_err(io_error)?;
                self.frames.insert(camera.to_owned(), channel);
                channel
            }
        };
        self.buffer.clear();
        image.encode(&mut self.buffer).map_err(io::Error::other)?;
        self.put(channel, stamp)
    }

    fn put(&mut self, channel_id: u16, stamp: MessageStamp) -> io::Result<()> {
        let ns = |time: Timestamp| u64::try_from(time.as_ns()).unwrap_or(0);
        let header = MessageHeader {
            channel_id,
            // The format has 32 bits for it.
            sequence: stamp.sequence as u32,
            log_time: ns(stamp.log_time),
            publish_time: ns(stamp.publish_time),
        };
        self.writer.write_to_known_channel(&header, &self.buffer).map_err(io_error)?;
        self.messages += 1;
        Ok(())
    }

    /// Closes the chunk and hands it to the system: what was written until now survives the process.
    pub fn flush(&mut self) -> io::Result<()> {
        self.writer.flush().map_err(io_error)?;
        self.complete_bytes = self.bytes();
        Ok(())
    }

    /// Waits until the disk has it: what was flushed until now survives a power failure.
    pub fn sync(&self) -> io::Result<()> {
        self.file.sync_data()
    }

    /// Writes index and end.
    pub fn finish(mut self) -> io::Result<u64> {
        self.flush()?;
        self.writer.finish().map_err(io_error)?;
        self.file.sync_all()?;
        Ok(self.bytes())
    }

    /// Leaves it as it was after the last complete chunk, and says how long that is.
    pub fn truncate_to_complete(self) -> u64 {
        let Self { writer, file, complete_bytes: whole, .. } = self;
        // It tries to write its end, which has no room either.
        drop(writer);
        if let Err(error) = file.set_len(whole) {
            tracing::warn!(%error, "the file of a failed recording could not be cut back");
        }
        whole
    }
}

fn io_error(error: mcap::McapError) -> io::Error {
    match error {
        mcap::McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}
