//! Sources that GStreamer plays: `rtsp://USER:PASSWORD@HOST:PORT/PATH#OPTIONS`, `file:PATH?OPTIONS` and `gst:PIPELINE`.

use std::{
    fmt,
    path::{Path, PathBuf},
    time::Duration,
};

use super::{
    AddressError,
    network::{self, NetworkUrl},
    options::{DEFAULT_STALL, Options},
};
use crate::model::redact::redact;

const RTSP_EXAMPLE: &str = "`rtsp://USER:PASSWORD@192.168.1.20/stream1`";
const DEFAULT_LATENCY: Duration = Duration::from_millis(50);

#[derive(Clone, PartialEq)]
pub enum MediaAddress {
    Rtsp {
        /// Without user, password and options.
        url: String,
        /// Name or address; IPv6 addresses without brackets.
        host: String,
        credentials: Option<(String, String)>,
        transport: Transport,
        /// How long late packets are waited for.
        latency: Duration,
        /// A pause of this length is a failure.
        stall: Duration,
    },
    File {
        /// Absolute, or relative to the working directory.
        path: PathBuf,
        /// Starts again after the last frame.
        repeat: bool,
        /// As fast as the frames are searched, not in real time.
        hurry: bool,
    },
    /// Elements linked by `!`, without the sink.
    Pipeline(String),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transport {
    /// Within the RTSP connection, without loss.
    Tcp,
    /// As datagrams; lost packets do not delay others.
    Udp,
}

impl Transport {
    /// GStreamer's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tcp => "tcp",
            Self::Udp => "udp",
        }
    }
}

impl fmt::Debug for MediaAddress {
    /// Without secrets.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "MediaAddress({self})")
    }
}

impl fmt::Display for MediaAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rtsp { url, .. } => f.write_str(&redact(url)),
            Self::File { path, .. } => write!(f, "file:{}", path.display()),
            Self::Pipeline(pipeline) => write!(f, "gst:{}", redact(pipeline)),
        }
    }
}

impl MediaAddress {
    /// A pause of this length is a failure.
    pub fn stall(&self) -> Duration {
        match self {
            Self::Rtsp { stall, .. } => *stall,
            Self::File { .. } | Self::Pipeline(_) => DEFAULT_STALL,
        }
    }
}

pub(super) fn rtsp(url: &str) -> Result<MediaAddress, AddressError> {
    let NetworkUrl { shown, uri, credentials, query } = NetworkUrl::parse(url, RTSP_EXAMPLE)?;
    let options = Options::parse("rtsp", &["transport", "latency_ms", "stall"], query)?;
    let is_udp = options.choice("transport", ["tcp", "udp"])?;
    Ok(MediaAddress::Rtsp {
        url: shown,
        host: network::host(&uri),
        credentials,
        transport: if is_udp { Transport::Udp } else { Transport::Tcp },
        latency: options.whole("latency_ms")?.map_or(DEFAULT_LATENCY, Duration::from_millis),
        stall: options.stall()?,
    })
}

pub(super) fn file(path: &str, query: &str, folder: &Path) -> Result<MediaAddress, AddressError> {
    let path = path.strip_prefix("//").unwrap_or(path);
    if path.trim().is_empty() {
        return Err(AddressError::Invalid(
            "`file:` needs a video file, such as `file:run.mp4?loop=true`",
        ));
    }
    let options = Options::parse("file", &["loop", "speed"], query)?;
    Ok(MediaAddress::File {
        path: folder.join(path),
        repeat: options.choice("loop", ["false", "true"])?,
        hurry: options.choice("speed", ["real", "max"])?,
    })
}

pub(super) fn pipeline(text: &str) -> Result<MediaAddress, AddressError> {
    if text.trim().is_empty() {
        return Err(AddressError::Invalid(
            "`gst:` needs a pipeline without its sink, such as `gst:v4l2src ! jpegdec`",
        ));
    }
    Ok(MediaAddress::Pipeline(text.trim().to_owned()))
}
