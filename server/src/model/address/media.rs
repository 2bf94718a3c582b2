//! What GStreamer plays: `rtsp://USER:PASSWORD@HOST:PORT/PATH#OPTIONS`, `file:PATH?OPTIONS` and `gst:PIPELINE`.

use std::{
    fmt,
    path::{Path, PathBuf},
    time::Duration,
};

use super::{
    AddressError, choice,
    network::{STALL_S, check_port, credentials, stall, without_credentials},
    options, whole,
};
use crate::model::capture_clock::CaptureClock;

const RTSP_KEYS: [&str; 3] = ["transport", "latency_ms", "stall"];
const RTSP_EXAMPLE: &str = "`rtsp://USER:PASSWORD@192.168.1.20/stream1`";
const FILE_KEYS: [&str; 2] = ["loop", "speed"];
/// Packets are waited for so long, where nothing else is said.
const LATENCY_MS: u64 = 50;

/// A stream, a file or a pipeline.
#[derive(Clone, PartialEq)]
pub enum MediaAddress {
    Rtsp {
        /// Without user, password and options.
        url: String,
        credentials: Option<(String, String)>,
        transport: Transport,
        /// How long one that is late is waited for.
        latency: Duration,
        /// No picture for so long is a failure.
        stall: Duration,
    },
    File {
        /// Absolute, or relative to the working directory.
        path: PathBuf,
        /// Starts again after the last frame.
        repeat: bool,
        /// Frame after frame, each as soon as the one before was searched; else in real time.
        hurry: bool,
    },
    /// Elements linked by `!`, without the sink.
    Pipeline(String),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transport {
    /// Within the RTSP connection: none is lost.
    Tcp,
    /// By themselves: none waits for another.
    Udp,
}

impl Transport {
    /// GStreamer's word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tcp => "tcp",
            Self::Udp => "udp",
        }
    }
}

impl fmt::Debug for MediaAddress {
    /// Passwords stay out of logs.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "MediaAddress({self})")
    }
}

impl fmt::Display for MediaAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Rtsp { url, .. } => f.write_str(url),
            Self::File { path, .. } => write!(f, "file:{}", path.display()),
            Self::Pipeline(pipeline) => write!(f, "gst:{pipeline}"),
        }
    }
}

impl MediaAddress {
    /// Which clock its times come from, as far as is known before the first frame: a camera may send no sender
    /// reports.
    pub(super) fn capture_clock(&self) -> CaptureClock {
        match self {
            Self::Rtsp { .. } => CaptureClock::ARRIVAL,
            Self::File { .. } => CaptureClock::EXACT,
            Self::Pipeline(_) => CaptureClock::DRIVER,
        }
    }

    /// No picture for so long is a failure.
    pub fn stall(&self) -> Duration {
        match self {
            Self::Rtsp { stall, .. } => *stall,
            Self::File { .. } | Self::Pipeline(_) => Duration::from_secs_f64(STALL_S),
        }
    }
}

pub(super) fn rtsp(url: &str) -> Result<MediaAddress, AddressError> {
    let wrong = |reason: String| AddressError::Network {
        found: without_credentials(url),
        reason,
        example: RTSP_EXAMPLE,
    };
    let (plain, query) = url.split_once('#').unwrap_or((url, ""));
    let credentials = credentials(plain).map_err(wrong)?;
    let shown = without_credentials(plain);
    let uri: hyper::Uri = shown.parse().map_err(|error| wrong(format!("{error}")))?;
    check_port(&uri).map_err(wrong)?;
    if uri.host().is_none_or(str::is_empty) {
        return Err(wrong("it names no host".to_owned()));
    }
    let mut transport = Transport::Tcp;
    let (mut latency_ms, mut silence) = (LATENCY_MS, Duration::from_secs_f64(STALL_S));
    for option in options("rtsp", &RTSP_KEYS, query) {
        match option? {
            ("transport", value) if choice("transport", value, "tcp", "udp")? => {
                transport = Transport::Udp;
            }
            ("transport", _) => transport = Transport::Tcp,
            ("latency_ms", value) => latency_ms = whole("latency_ms", value)?,
            (_, value) => silence = stall(value)?,
        }
    }
    let latency = Duration::from_millis(latency_ms);
    Ok(MediaAddress::Rtsp { url: shown, credentials, transport, latency, stall: silence })
}

pub(super) fn file(path: &str, query: &str, folder: &Path) -> Result<MediaAddress, AddressError> {
    let path = path.strip_prefix("//").unwrap_or(path);
    if path.trim().is_empty() {
        return Err(AddressError::Options(
            "`file:` needs a video file, such as `file:run.mp4?loop=true`",
        ));
    }
    let (mut repeat, mut hurry) = (false, false);
    for option in options("file", &FILE_KEYS, query) {
        match option? {
            ("loop", value) => repeat = choice("loop", value, "false", "true")?,
            (_, value) => hurry = choice("speed", value, "real", "max")?,
        }
    }
    Ok(MediaAddress::File { path: folder.join(path), repeat, hurry })
}

pub(super) fn pipeline(text: &str) -> Result<MediaAddress, AddressError> {
    if text.trim().is_empty() {
        return Err(AddressError::Options(
            "`gst:` needs a pipeline without its sink, such as `gst:v4l2src ! jpegdec`",
        ));
    }
    Ok(MediaAddress::Pipeline(text.trim().to_owned()))
}

#[cfg(test)]
mod tests {
    use super::{super::SourceAddress, *};

    fn parse(url: &str) -> Result<MediaAddress, String> {
        match SourceAddress::parse(url, Path::new("/lab")) {
            Ok(SourceAddress::Media(media)) => Ok(media),
            Ok(other) => panic!("{other:?}"),
            Err(error) => Err(error.to_string()),
        }
    }

    #[test]
    fn addresses_are_taken_apart() {
        let media =
            parse("rtsp://lab:p%40ss@cam:8554/live?ch=1#transport=udp&latency_ms=0&stall=3");
        let MediaAddress::Rtsp { url, credentials, transport, latency, stall } = media.unwrap()
        else {
            panic!("no stream")
        };
        assert_eq!(url, "rtsp://cam:8554/live?ch=1");
        assert_eq!(credentials, Some(("lab".to_owned(), "p@ss".to_owned())));
        assert_eq!((transport, latency), (Transport::Udp, Duration::ZERO));
        assert_eq!(stall, Duration::from_secs(3));
        let run = |repeat, hurry| MediaAddress::File { path: "/lab/run.mp4".into(), repeat, hurry };
        assert_eq!(parse("file:run.mp4?loop=true"), Ok(run(true, false)));
        assert_eq!(parse("file:run.mp4?speed=max"), Ok(run(false, true)));
        assert_eq!(parse("file:///lab/run.mp4?speed=real"), Ok(run(false, false)));
        let pipeline = "v4l2src device=/dev/video0 ! video/x-raw,width=640 ! queue";
        assert_eq!(parse(&format!("gst:{pipeline}")), Ok(MediaAddress::Pipeline(pipeline.into())));
    }

    #[test]
    fn wrong_addresses_say_what_to_write() {
        for (url, expected) in [
            ("rtsp://u:secret@", "`rtsp://` is no address of a camera"),
            ("rtsp://h/#transport=quic", "option `transport` must be `tcp` or `udp`, found `quic`"),
            ("rtsp://h/#latency_ms=-1", "option `latency_ms` must be a whole number from 0"),
            (
                "rtsp://h/#latency=1",
                "unknown option `latency` of an `rtsp:` source; did you mean `latency_ms`?",
            ),
            ("file:", "`file:` needs a video file"),
            ("file:x.mp4?fps=2", "unknown option `fps` of an `file:` source"),
            ("file:x.mp4?speed=2", "option `speed` must be `real` or `max`, found `2`"),
            ("gst:", "`gst:` needs a pipeline without its sink"),
        ] {
            let error = parse(url).expect_err(url);
            assert!(error.contains(expected), "{url}: {error}");
        }
    }
}
