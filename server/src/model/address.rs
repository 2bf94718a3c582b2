//! Addresses of sources: `images:GLOB-OR-FOLDER?…`, `sim:?…`, `http://…`, `rtsp://…`, `file:PATH?…`, `gst:PIPELINE`,
//! `v4l2:DEVICE?…` and `push:?…`.

mod device;
mod media;
mod network;
mod options;

use std::{
    fmt,
    path::{Component, Path, PathBuf},
    time::Duration,
};

use thiserror::Error;

use self::options::Options;
use super::capture_clock::CaptureClock;
use crate::model::{
    redact::redact,
    suggestion::{list, nearest},
};
pub use device::DeviceAddress;
pub use media::{MediaAddress, Transport};
pub use network::HttpAddress;

const SCHEMES: [&str; 8] = ["images:", "sim:", "http:", "v4l2:", "rtsp:", "file:", "gst:", "push:"];
const DEFAULT_FPS: f64 = 30.0;
/// More than fit into any arena.
const MAX_ROBOTS: usize = 10_000;

#[derive(Clone, Debug, PartialEq)]
pub enum SourceAddress {
    /// Image files, played in real time.
    Images(ImagesAddress),
    /// One camera of a simulated arena.
    Sim(SimAddress),
    /// A network camera that sends JPEGs.
    Http(HttpAddress),
    /// A camera of this machine.
    Device(DeviceAddress),
    /// Played by GStreamer.
    Media(MediaAddress),
    /// Frames or detections sent by a remote program.
    Push(PushAddress),
}

/// `images:GLOB-OR-FOLDER?fps=30&times=FILE&clock=file&loop=true`.
#[derive(Clone, Debug, PartialEq)]
pub struct ImagesAddress {
    /// A folder or a glob, absolute or relative to the working directory.
    pub pattern: String,
    /// Frames a second; excludes `times`.
    pub fps: Option<f64>,
    /// A text file of capture times, one a line, ns since the Unix epoch.
    pub times: Option<PathBuf>,
    /// The server's clock follows the capture times of the file.
    pub file_clock: bool,
    /// Starts again after the last file.
    pub repeat: bool,
}

impl ImagesAddress {
    /// Frames a second without `times`.
    pub fn rate_hz(&self) -> f64 {
        self.fps.unwrap_or(DEFAULT_FPS)
    }

    /// Whether the address gives the frames' times, so that they form a sequence.
    pub fn is_timed(&self) -> bool {
        self.fps.is_some() || self.times.is_some()
    }
}

/// `sim:?preset=r4_lite&seed=1&robots=24&camera=0`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SimAddress {
    pub preset: SimPreset,
    /// Determines paths, noise and lighting; cameras with the same seed see the same world.
    pub seed: u64,
    /// `None`: as many as the preset has.
    pub robots: Option<usize>,
    /// Index of the camera in the preset.
    pub camera: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SimPreset {
    /// Four cameras of 1280x720 at 30 Hz, plain roundels.
    R4Lite,
    /// The same with 1920x1080 at 60 Hz, coded roundels.
    R4,
    /// `R4Lite` with elliptical discs.
    R4Elliptical,
}

impl SimPreset {
    const NAMES: [(&'static str, Self); 3] =
        [("r4_lite", Self::R4Lite), ("r4", Self::R4), ("r4_elliptical", Self::R4Elliptical)];
}

/// `push:?stall=SECONDS`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PushAddress {
    /// A pause of this length is a failure.
    pub stall: Duration,
}

#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum AddressError {
    /// `found`: the text up to the colon, or all of it.
    #[error("no source begins with `{found}`: expected {}{}", list(SCHEMES), did_you_mean(.found, &SCHEMES))]
    Scheme { found: String },
    #[error(
        "unknown option `{found}` of an `{scheme}:` source{}; its options: {}",
        did_you_mean(.found, .known),
        list(.known.iter().copied())
    )]
    UnknownOption { scheme: &'static str, found: String, known: &'static [&'static str] },
    /// `what`: the option or control.
    #[error("{what} must be {expected}, found `{found}`")]
    Value { what: String, expected: String, found: String },
    /// A path that is missing or wrong, or options that exclude each other.
    #[error("{0}")]
    Invalid(&'static str),
    /// `found`: without secrets.
    #[error("`{found}` is no address of a camera: {reason}; write it as {example}")]
    Network { found: String, reason: String, example: &'static str },
}

fn did_you_mean(found: &str, known: &[&str]) -> String {
    let nearest = nearest(found, known.iter().copied());
    nearest.map(|name| format!("; did you mean `{name}`?")).unwrap_or_default()
}

/// Splits a pattern of files at its first component with a wildcard.
pub fn split_pattern(pattern: &str) -> (PathBuf, PathBuf) {
    let is_plain = |it: &Component<'_>| !it.as_os_str().to_string_lossy().contains(['*', '?', '[']);
    let mut components = Path::new(pattern).components();
    let plain = components.clone().take_while(is_plain).collect::<PathBuf>();
    components.by_ref().take(plain.components().count()).for_each(drop);
    (plain, components.collect())
}

impl SourceAddress {
    /// Relative paths in `url` are relative to `folder`.
    pub fn parse(url: &str, folder: &Path) -> Result<Self, AddressError> {
        let Some((scheme, rest)) = url.split_once(':') else {
            return Err(AddressError::Scheme { found: redact(url) });
        };
        let (path, query) = rest.split_once('?').unwrap_or((rest, ""));
        match scheme {
            "images" => images(path, query, folder).map(Self::Images),
            "sim" => sim(path, query).map(Self::Sim),
            "http" => network::http(url).map(Self::Http),
            "v4l2" => device::device(path, query).map(Self::Device),
            "rtsp" => media::rtsp(url).map(Self::Media),
            "file" => media::file(path, query, folder).map(Self::Media),
            "gst" => media::pipeline(rest).map(Self::Media),
            "push" => push(path, query).map(Self::Push),
            _ => Err(AddressError::Scheme { found: format!("{scheme}:") }),
        }
    }

    /// The clock of its capture times, as far as it is known before the first frame.
    pub fn capture_clock(&self) -> CaptureClock {
        match self {
            Self::Images(_) | Self::Sim(_) | Self::Media(MediaAddress::File { .. }) => {
                CaptureClock::EXACT
            }
            // Until the sender's time stamps are known.
            Self::Http(_) | Self::Push(_) | Self::Media(MediaAddress::Rtsp { .. }) => {
                CaptureClock::ARRIVAL
            }
            Self::Device(_) | Self::Media(MediaAddress::Pipeline(_)) => CaptureClock::DRIVER,
        }
    }

    /// Whether the server's clock must follow capture times from a file.
    pub fn follows_file_clock(&self) -> bool {
        matches!(self, Self::Images(images) if images.file_clock)
    }
}

fn images(path: &str, query: &str, folder: &Path) -> Result<ImagesAddress, AddressError> {
    if path.trim().is_empty() {
        return Err(AddressError::Invalid(
            "`images:` needs a folder or a pattern, such as `images:frames/*.png?fps=30`",
        ));
    }
    let options = Options::parse("images", &["fps", "times", "clock", "loop"], query)?;
    let address = ImagesAddress {
        pattern: folder.join(path).to_string_lossy().into_owned(),
        fps: options.frame_rate()?,
        times: options.get("times").map(|file| folder.join(file)),
        file_clock: options.choice("clock", ["server", "file"])?,
        repeat: options.choice("loop", ["false", "true"])?,
    };
    if address.times.is_some() && address.fps.is_some() {
        return Err(AddressError::Invalid("`fps` and `times` exclude each other: leave one out"));
    }
    if address.file_clock && address.times.is_none() {
        return Err(AddressError::Invalid("`clock=file` needs `times=FILE`"));
    }
    Ok(address)
}

fn sim(path: &str, query: &str) -> Result<SimAddress, AddressError> {
    if !path.is_empty() {
        return Err(AddressError::Invalid(
            "`sim:` takes no path: write `sim:?seed=1&robots=24&camera=0`",
        ));
    }
    let options = Options::parse("sim", &["preset", "seed", "robots", "camera"], query)?;
    let preset = |name: &str| {
        let known = SimPreset::NAMES.iter().find(|(known, _)| *known == name);
        known.map(|(_, preset)| *preset)
    };
    let robots = |value: &str| value.parse().ok().filter(|robots| *robots <= MAX_ROBOTS);
    let robots_expected = || format!("a whole number from 0 to {MAX_ROBOTS}");
    let expected = || format!("one of {}", list(SimPreset::NAMES.map(|(name, _)| name)));
    Ok(SimAddress {
        preset: options.parsed("preset", preset, expected)?.unwrap_or(SimPreset::R4Lite),
        seed: options.whole("seed")?.unwrap_or(1),
        robots: options.parsed("robots", robots, robots_expected)?,
        camera: options.whole("camera")?.unwrap_or(0),
    })
}

fn push(path: &str, query: &str) -> Result<PushAddress, AddressError> {
    if !path.is_empty() {
        return Err(AddressError::Invalid(
            "`push:` takes no address: programs come to this server, and name the camera that they feed",
        ));
    }
    Ok(PushAddress { stall: Options::parse("push", &["stall"], query)?.stall()? })
}

impl fmt::Display for SimAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let preset = SimPreset::NAMES.iter().find(|(_, preset)| *preset == self.preset);
        write!(f, "sim:?preset={}&seed={}", preset.map_or("", |(name, _)| name), self.seed)?;
        if let Some(robots) = self.robots {
            write!(f, "&robots={robots}")?;
        }
        write!(f, "&camera={}", self.camera)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(url: &str) -> Result<SourceAddress, String> {
        SourceAddress::parse(url, Path::new("/lab")).map_err(|error| error.to_string())
    }

    #[test]
    fn addresses_are_parsed() {
        let url = "images:north/*.png?times=north.txt&clock=file&loop=true";
        let images = ImagesAddress {
            pattern: "/lab/north/*.png".into(),
            fps: None,
            times: Some("/lab/north.txt".into()),
            file_clock: true,
            repeat: true,
        };
        assert_eq!(parse(url), Ok(SourceAddress::Images(images)));
        let url = "sim:?preset=r4_lite&seed=7&robots=3&camera=2";
        let Ok(SourceAddress::Sim(sim)) = parse(url) else { panic!("not sim") };
        assert_eq!(sim.to_string(), url);
        for (url, seconds) in [("push:", 1), ("push:?stall=5", 5)] {
            let address = PushAddress { stall: Duration::from_secs(seconds) };
            assert_eq!(parse(url), Ok(SourceAddress::Push(address)));
        }

        let url = "http://lab:p%40ss%3A@cam-1:81/stream?res=9#stall=5&fps=2.5";
        let http = HttpAddress {
            host: "cam-1".into(),
            port: 81,
            target: "/stream?res=9".into(),
            credentials: Some(("lab".into(), "p@ss:".into())),
            snapshot_hz: 2.5,
            stall: Duration::from_secs(5),
        };
        assert_eq!(http.to_string(), "http://cam-1:81/stream?res=9");
        assert!(!format!("{http:?}").contains("p@ss"));
        assert_eq!(parse(url), Ok(SourceAddress::Http(http)));
        let Ok(SourceAddress::Http(http)) = parse("http://[::1]") else { panic!("not http") };
        assert_eq!((http.host.as_str(), http.port, http.target.as_str()), ("::1", 80, "/"));
        assert_eq!((http.authority().as_str(), http.credentials), ("[::1]", None));

        let rtsp = MediaAddress::Rtsp {
            url: "rtsp://cam:8554/live?ch=1".into(),
            host: "cam".into(),
            credentials: Some(("lab".into(), "p@ss".into())),
            transport: Transport::Udp,
            latency: Duration::ZERO,
            stall: Duration::from_secs(3),
        };
        let url = "rtsp://lab:p%40ss@cam:8554/live?ch=1#transport=udp&latency_ms=0&stall=3";
        let run = |repeat, hurry| MediaAddress::File { path: "/lab/run.mp4".into(), repeat, hurry };
        let pipeline = "v4l2src device=/dev/video0 ! video/x-raw,width=640 ! queue";
        let gst = format!("gst:{pipeline}");
        for (url, expected) in [
            (url, rtsp),
            ("file:run.mp4?loop=true", run(true, false)),
            ("file:run.mp4?speed=max", run(false, true)),
            ("file:///lab/run.mp4?speed=real", run(false, false)),
            (gst.as_str(), MediaAddress::Pipeline(pipeline.into())),
        ] {
            assert_eq!(parse(url), Ok(SourceAddress::Media(expected)));
        }

        let url = "v4l2:/dev/video2?fps=25&format=Y10&auto_exposure=1&exposure_time_absolute=-40";
        let device = DeviceAddress {
            path: "/dev/video2".into(),
            fps: Some(25.0),
            format: Some(*b"Y10 "),
            controls: vec![("auto_exposure".into(), 1), ("exposure_time_absolute".into(), -40)],
        };
        assert_eq!(device.to_string(), "/dev/video2");
        assert_eq!(parse(url), Ok(SourceAddress::Device(device)));
    }

    #[test]
    fn errors_say_what_to_write() {
        for (url, expected) in [
            (
                "image:x",
                "no source begins with `image:`: expected `images:`, `sim:`, `http:`, `v4l2:`, `rtsp:`, `file:`, `gst:`, `push:`; did you mean `images:`?",
            ),
            ("frames/*.png", "no source begins with `frames/*.png`"),
            ("images:", "needs a folder or a pattern"),
            ("images:x?fsp=3", "unknown option `fsp` of an `images:` source; did you mean `fps`?"),
            ("images:x?fps=0", "option `fps` must be a number above 0, at most 1000, found `0`"),
            ("images:x?fps=NaN", "found `NaN`"),
            ("images:x?loop=yes", "option `loop` must be `false` or `true`, found `yes`"),
            ("images:x?fps=3&times=t", "exclude each other"),
            ("images:x?clock=file", "`clock=file` needs `times=FILE`"),
            (
                "sim:?robots=-1",
                "option `robots` must be a whole number from 0 to 10000, found `-1`",
            ),
            ("sim:?robots=10001", "found `10001`"),
            (
                "sim:?preset=r5",
                "option `preset` must be one of `r4_lite`, `r4`, `r4_elliptical`, found `r5`",
            ),
            ("sim:arena", "takes no path"),
            ("push:?stall=0", "seconds above 0"),
            ("push://robot7", "programs come to this server"),
            ("push:?stal=5", "did you mean `stall`?"),
            ("http://", "write it as `http://192.168.1.20:81/stream`"),
            ("http://u:secret@", "`http://` is no address of a camera"),
            (
                "http://host:port/",
                "`http://host:port/` is no address of a camera: its port must be a number up to 65535, found `port`",
            ),
            ("http://u:%zz@host/", "two hex digits (write %25)"),
            (
                "http://host/#stall=0",
                "option `stall` must be seconds above 0, at most 3600, found `0`",
            ),
            ("http://host/#fps=fast", "option `fps` must be a number above 0, at most 1000"),
            (
                "http://host/#fsp=3",
                "unknown option `fsp` of an `http:` source; did you mean `fps`?",
            ),
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
            ("v4l2:video0", "needs a device file, such as `v4l2:/dev/video0?fps=30`"),
            ("v4l2:/dev/video0?fps=0", "option `fps` must be a number above 0"),
            ("v4l2:/dev/video0?format=YUYV422", "a code of up to four characters"),
            ("v4l2:/dev/video0?gain=high", "control `gain` must be a whole number, found `high`"),
        ] {
            let error = parse(url).expect_err(url);
            assert!(error.contains(expected), "{url}: {error}");
        }
    }
}
