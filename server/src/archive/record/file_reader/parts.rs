//! What a reader gives, and why it does not.

use std::{io, path::PathBuf, sync::Arc};

use roundel_core::time::Timestamp;
use thiserror::Error;

use crate::archive::record::schema::{FORMAT_VERSION, FRAME_TOPIC_PREFIX, Topic};

/// Why a file is not played at all.
#[derive(Debug, Error)]
pub enum ReadError {
    /// The system does not give it.
    #[error("cannot read {}: {source}", .path.display())]
    Open { path: PathBuf, source: io::Error },
    #[error("{}: expected a recording (an MCAP file, as `roundel record` makes them), found {found}", .path.display())]
    Foreign {
        path: PathBuf,
        /// What it seems to be.
        found: String,
    },
    /// It was made by a later version.
    #[error(
        "{}: was recorded by Roundel {version} in format {format}; this version reads formats up to {FORMAT_VERSION}: use that \
         version or a newer one",
        .path.display()
    )]
    Newer { path: PathBuf, version: String, format: u32 },
}

#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Channel {
    Topic(Topic),
    /// A frame of a camera.
    Frame(Arc<str>),
    /// Of somebody else, on this topic.
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
    /// When it was recorded.
    pub log_time: Timestamp,
    /// When it was made.
    pub publish_time: Timestamp,
    pub sequence: u32,
    pub data: Vec<u8>,
}

/// What could not be read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Damage {
    /// Sentences, in the order of the file.
    pub sentences: Vec<String>,
    /// Bytes that are lost.
    pub bytes: u64,
    /// The file has no end: it was cut off, or is still being written.
    pub is_cut_off: bool,
}

/// Where a chunk is, and of when.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ChunkInfo {
    /// Its record's first byte.
    pub offset: u64,
    pub begin: Timestamp,
    pub end: Timestamp,
    /// Channels of which messages are in it, where an index says so.
    pub(super) channels: Vec<u16>,
}
