//! Where frames come from, as a URL: `images:GLOB-OR-FOLDER?…`, `sim:?…`, `http://…`, `rtsp://…`, `file:PATH?…`,
//! `gst:PIPELINE`, `v4l2:DEVICE?…` or `push:?…`.

mod device;
mod media;
mod network;
mod push;

use std::{
    fmt,
    path::{Path, PathBuf},
    str::FromStr,
};

use thiserror::Error;

use super::capture_clock::CaptureClock;
use crate::model::suggestion::{list, nearest};
pub use device::DeviceAddress;
pub use media::{MediaAddress, Transport};
pub use network::{HttpAddress, without_credentials};
pub use push::PushAddress;

/// The schemes that this version plays, as people write them.
const SCHEMES: [&str; 8] = ["images:", "sim:", "http:", "v4l2:", "rtsp:", "file:", "gst:", "push:"];
const IMAGES_KEYS: [&str; 4] = ["fps", "times", "clock", "loop"];
const SIM_KEYS: [&str; 4] = ["preset", "seed", "robots", "camera"];
/// Frames a second that an address may ask for.
const MAX_FPS: f64 = 1000.0;
/// Default frame rate.
const USUAL_FPS: f64 = 30.0;

/// A source's URL, read.
#[derive(Clone, Debug, PartialEq)]
pub enum SourceAddress {
    /// Image files, played in real time.
    Images(ImagesAddress),
    /// One camera of a simulated arena.
    Sim(SimAddress),
    /// A network camera that sends JPEGs.
    Http(HttpAddress),
    Device(DeviceAddress),
    Media(MediaAddress),
    Push(PushAddress),
}

/// `images:GLOB-OR-FOLDER?fps=30&times=FILE&clock=file&loop=true`.
#[derive(Clone, Debug, PartialEq)]
pub struct ImagesAddress {
    /// A folder or a glob, absolute or relative to the working directory.
    pub pattern: String,
    /// Frames a second, where `times` is absent; `None`: the default, 30.
    pub fps: Option<f64>,
    /// A text file of capture times, one a line, ns since the Unix epoch.
    pub times: Option<PathBuf>,
    /// Capture times are those of the file, and the server's clock follows them.
    pub file_clock: bool,
    /// Starts again after the last file.
    pub repeat: bool,
}

impl ImagesAddress {
    /// Frames a second, where `times` is absent.
    pub fn rate_hz(&self) -> f64 {
        self.fps.unwrap_or(USUAL_FPS)
    }

    /// Whether it is said when each file is due, so that they follow one another in time.
    pub fn is_timed(&self) -> bool {
        self.fps.is_some() || self.times.is_some()
    }
}

/// `sim:?preset=r4_lite&seed=1&robots=24&camera=0`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SimAddress {
    pub preset: SimPreset,
    /// Decides paths, noise and lighting; the same seed gives the same world to every camera.
    pub seed: u64,
    /// Robots in the arena; `None`: as many as the preset has.
    pub robots: Option<usize>,
    /// The camera's place in the preset, from 0.
    pub camera: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SimPreset {
    /// The demo's: four cameras of 1280x720 at 30 Hz, plain roundels.
    R4Lite,
    /// The reference installation: the same cameras with 1920x1080 at 60 Hz, coded roundels.
    R4,
    /// The demo's, with elliptical discs.
    R4Elliptical,
}

impl SimPreset {
    const NAMES: [(&'static str, Self); 3] =
        [("r4_lite", Self::R4Lite), ("r4", Self::R4), ("r4_elliptical", Self::R4Elliptical)];
}

/// Why a text is no source.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum AddressError {
    #[error("no source begins with `{found}`: expected {}{}", list(SCHEMES), suggest_scheme(.found))]
    Scheme {
        /// What stands before the colon, or the whole text.
        found: String,
    },
    /// An option that the scheme does not have.
    #[error("unknown option `{found}` of an `{scheme}:` source{}; its options: {}", did_you_mean(.nearest), list(.known.iter().copied()))]
    Option {
        scheme: &'static str,
        /// The option's name.
        found: String,
        /// The option that was probably meant.
        nearest: Option<&'static str>,
        known: &'static [&'static str],
    },
    /// An option's value.
    #[error("option `{option}` must be {expected}, found `{found}`")]
    Value { option: &'static str, expected: String, found: String },
    /// No files are named.
    #[error("`images:` needs a folder or a pattern, such as `images:frames/*.png?fps=30`")]
    NoPattern,
    #[error("control `{control}` must be a whole number, found `{found}`")]
    Control { control: String, found: String },
    /// Two options that exclude each other, or one that needs another.
    #[error("{0}")]
    Options(&'static str),
    /// A network address that is none.
    #[error("`{found}` is no address of a camera: {reason}; write it as {example}")]
    Network {
        /// As written, without user and password.
        found: String,
        reason: String,
        example: &'static str,
    },
}

fn suggest_scheme(found: &str) -> String {
    did_you_mean(&nearest(found, SCHEMES))
}

fn did_you_mean(name: &Option<&'static str>) -> String {
    name.map(|name| format!("; did you mean `{name}`?")).unwrap_or_default()
}

impl SourceAddress {
    /// Reads a URL; relative paths in it are relative to `folder`.
    pub fn parse(url: &str, folder: &Path) -> Result<Self, AddressError> {
        let Some((scheme, rest)) = url.split_once(':') else {
            return Err(AddressError::Scheme { found: url.to_owned() });
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
            "push" => push::push(path, query).map(Self::Push),
            _ => Err(AddressError::Scheme { found: format!("{scheme}:") }),
        }
    }

    /// Which clock the capture times of its frames come from, as far as is known before the first one.
    pub fn capture_clock(&self) -> CaptureClock {
        match self {
            Self::Images(_) | Self::Sim(_) => CaptureClock::EXACT,
            // What it sends says more.
            Self::Http(_) | Self::Push(_) => CaptureClock::ARRIVAL,
            Self::Device(_) => CaptureClock::DRIVER,
            Self::Media(media) => media.capture_clock(),
        }
    }

    /// Whether capture times are taken from files and the server's clock has to follow them.
    pub fn follows_file_clock(&self) -> bool {
        matches!(self, Self::Images(images) if images.file_clock)
    }
}

fn images(path: &str, query: &str, folder: &Path) -> Result<ImagesAddress, AddressError> {
    if path.trim().is_empty() {
        return Err(AddressError::NoPattern);
    }
    let mut address = ImagesAddress {
        pattern: folder.join(path).to_string_lossy().into_owned(),
        fps: None,
        times: None,
        file_clock: false,
        repeat: false,
    };
    for option in options("images", &IMAGES_KEYS, query) {
        let (key, value) = option?;
        match key {
            "fps" => address.fps = Some(frame_rate(value)?),
            "times" => address.times = Some(folder.join(value)),
            "clock" => address.file_clock = choice("clock", value, "server", "file")?,
            _ => address.repeat = choice("loop", value, "false", "true")?,
        }
    }
    if address.times.is_some() && address.fps.is_some() {
        return Err(AddressError::Options("`fps` and `times` exclude each other: leave one out"));
    }
    if address.file_clock && address.times.is_none() {
        return Err(AddressError::Options("`clock=file` needs `times=FILE`"));
    }
    Ok(address)
}

fn frame_rate(value: &str) -> Result<f64, AddressError> {
    value.parse().ok().filter(|fps| *fps > 0.0 && *fps <= MAX_FPS).ok_or_else(|| {
        AddressError::Value {
            option: "fps",
            expected: format!("a number above 0, at most {MAX_FPS}"),
            found: value.to_owned(),
        }
    })
}

/// Whether the option says `second` and not `first`.
fn choice(
    option: &'static str,
    value: &str,
    first: &str,
    second: &str,
) -> Result<bool, AddressError> {
    match value {
        value if value == second => Ok(true),
        value if value == first => Ok(false),
        _ => Err(AddressError::Value {
            option,
            expected: format!("`{first}` or `{second}`"),
            found: value.to_owned(),
        }),
    }
}

fn sim(path: &str, query: &str) -> Result<SimAddress, AddressError> {
    if !path.is_empty() {
        return Err(AddressError::Options(
            "`sim:` takes no path: write `sim:?seed=1&robots=24&camera=0`",
        ));
    }
    let mut address = SimAddress { preset: SimPreset::R4Lite, seed: 1, robots: None, camera: 0 };
    for option in options("sim", &SIM_KEYS, query) {
        let (key, value) = option?;
        match key {
            "preset" => address.preset = preset(value)?,
            "seed" => address.seed = whole("seed", value)?,
            "robots" => address.robots = Some(whole("robots", value)?),
            _ => address.camera = whole("camera", value)?,
        }
    }
    Ok(address)
}

fn preset(value: &str) -> Result<SimPreset, AddressError> {
    let known = SimPreset::NAMES.iter().find(|(name, _)| *name == value);
    known.map(|(_, preset)| *preset).ok_or_else(|| AddressError::Value {
        option: "preset",
        expected: format!("one of {}", list(SimPreset::NAMES.iter().map(|(name, _)| *name))),
        found: value.to_owned(),
    })
}

fn whole<T: FromStr>(option: &'static str, value: &str) -> Result<T, AddressError> {
    value.parse().map_err(|_| AddressError::Value {
        option,
        expected: "a whole number from 0".to_owned(),
        found: value.to_owned(),
    })
}

/// The query's options, each checked to be one of `known`.
fn options<'q>(
    scheme: &'static str,
    known: &'static [&'static str],
    query: &'q str,
) -> impl Iterator<Item = Result<(&'static str, &'q str), AddressError>> {
    query.split('&').filter(|option| !option.is_empty()).map(move |option| {
        let (key, value) = option.split_once('=').unwrap_or((option, ""));
        match known.iter().find(|name| **name == key) {
            Some(name) => Ok((*name, value)),
            None => Err(AddressError::Option {
                scheme,
                found: key.to_owned(),
                nearest: nearest(key, known.iter().copied()),
                known,
            }),
        }
    })
}

impl fmt::Display for SimAddress {
    /// The URL that reads as this address.
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
    fn paths_are_relative_to_the_folder() {
        let SourceAddress::Images(images) =
            parse("images:north/*.png?times=north.txt&clock=file&loop=true").unwrap()
        else {
            panic!("not images")
        };
        assert_eq!(images.pattern, "/lab/north/*.png");
        assert_eq!(images.times, Some("/lab/north.txt".into()));
        assert!(images.file_clock && images.repeat);
    }

    #[test]
    fn simulated_addresses_round_trip() {
        let url = "sim:?preset=r4_lite&seed=7&robots=3&camera=2";
        let SourceAddress::Sim(sim) = parse(url).unwrap() else { panic!("not sim") };
        assert_eq!(sim.to_string(), url);
    }

    #[test]
    fn wrong_addresses_say_what_to_write() {
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
            ("sim:?robots=-1", "option `robots` must be a whole number from 0, found `-1`"),
            (
                "sim:?preset=r5",
                "option `preset` must be one of `r4_lite`, `r4`, `r4_elliptical`, found `r5`",
            ),
            ("sim:arena", "takes no path"),
        ] {
            let error = parse(url).expect_err(url);
            assert!(error.contains(expected), "{url}: {error}");
        }
    }
}
