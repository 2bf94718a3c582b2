//! The configuration of an installation: one TOML file, read into checked types.
//!
//! Every key that exists stands in `deploy/roundel.example.toml` with its meaning and default. All
//! that is wrong with a file is found in one go; each problem names file, line and column, and an
//! unknown key the nearest known one. What is read here holds: sizes are positive, names unique,
//! references to kinds resolved, camera files loaded, quaternions unit.

mod allow_origins;
mod camera;
mod camera_pose;
mod document;
pub mod edit;
mod error;
mod file;
mod geometry;
mod history;
mod mask;
mod object;
mod reader;
mod recording;
mod reference;
mod roundel;

use std::{
    collections::BTreeMap,
    fs,
    net::SocketAddr,
    path::{Path, PathBuf},
};

use roundel_core::{
    camera::Camera,
    marker::{Kind, Mode},
    world::MotionClass,
};

pub use camera::{CAMERA_SCHEMA, CameraConfig, Effect, MODES};
pub use camera_pose::{MountConfig, PoseConfig};
use document::ParseOptions;
pub use error::{ConfigError, Problem, TextLocation};
pub use file::{ConfigFile, ConfigFileError};
pub use history::HistoryConfig;
pub use object::{ObjectConfig, ObjectRoundels};
pub use recording::{FrameFormat, RecordingConfig};
pub use reference::ReferenceConfig;
pub use roundel::POLARITIES;

/// A configuration longer than this is certainly another file.
const MAX_BYTES: u64 = 4 << 20;

pub type Lenses = BTreeMap<String, Camera>;

#[derive(Clone, Debug)]
pub struct Config {
    pub file: ConfigFile,
    /// Relative paths in it begin here.
    pub folder: PathBuf,
    /// Shown to clients and on the dashboard.
    pub name: String,
    /// `[server]`.
    pub server: ServerConfig,
    /// `[detection] mode`, of cameras that do not say theirs.
    pub mode: Mode,
    /// `[[roundel]]`, by [`KindId`]; at least one. Plain ones have ratios of diameters a tenth apart,
    /// coded ones codes of different bits.
    pub kinds: Vec<Kind>,
    /// How objects of each kind move; of those beyond its end, freely.
    pub motions: Vec<MotionClass>,
    /// `[[camera]]`, by [`roundel_core::id::CameraId`]; at least one, names unique.
    pub cameras: Vec<CameraConfig>,
    /// `[[reference]]`; at least three that are not in one line if a camera's pose is unknown.
    pub references: Vec<ReferenceConfig>,
    /// `[[object]]`; no roundel is on two of them, names unique.
    pub objects: Vec<ObjectConfig>,
    /// `[fusion]`.
    pub fusion: FusionConfig,
    /// `[limits]`.
    pub limits: LimitsConfig,
    /// `[recording]`.
    pub recording: RecordingConfig,
    /// `[history]`; `None`: none is kept.
    pub history: Option<HistoryConfig>,
    /// `[node] server`: the cameras are those of a node, which that server fuses, and have no poses here.
    pub node: Option<String>,
}

/// `[server]`.
#[derive(Clone, Debug, PartialEq)]
pub struct ServerConfig {
    /// The one port of every API.
    pub listen: SocketAddr,
    /// Snapshots a second.
    pub snapshot_rate_hz: f64,
    /// Whether there is one as soon as a frame was fused, besides.
    pub publishes_per_frame: bool,
    /// Where calibrations of the arena are kept. `None`: until the end of the process.
    pub calibration: Option<PathBuf>,
    /// Whether cameras that were bumped are noticed, left out and found again.
    pub monitors_cameras: bool,
    /// Whether clients may have sources tried; who may can have this machine open any address.
    pub setup: bool,
    /// Origins whose pages browsers let ask this server, as browsers write them; `*` is any.
    pub allow_origins: Vec<String>,
}

/// `[fusion]`.
#[derive(Clone, Debug, PartialEq)]
pub struct FusionConfig {
    /// Rms acceleration that objects are capable of, m/s².
    pub acceleration_m_s2: f64,
    /// Observations this much older than the newest are still used, seconds.
    pub late_window_s: f64,
    /// Not seen for so long: predicted, seconds.
    pub predicted_after_s: f64,
    /// Not seen for so long: lost, seconds; above `predicted_after_s`.
    pub lost_after_s: f64,
}

impl Default for FusionConfig {
    fn default() -> Self {
        Self {
            acceleration_m_s2: 1.5,
            late_window_s: 0.3,
            predicted_after_s: 0.15,
            lost_after_s: 2.0,
        }
    }
}

/// `[limits]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LimitsConfig {
    /// Objects followed at most.
    pub max_objects: usize,
    /// Roundels that one camera follows at most.
    pub max_roundels_per_camera: usize,
    pub max_clients: usize,
}

impl Default for LimitsConfig {
    fn default() -> Self {
        Self { max_objects: 1000, max_roundels_per_camera: 400, max_clients: 2000 }
    }
}

impl Config {
    /// Reads a file and the camera files that it names; paths in it are relative to its folder. Calibrations
    /// are kept beside it, `lab.calibration.toml` for `lab.toml`, if it does not say where.
    ///
    /// Errors name every problem with its line, and the remedy.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        Self::load_as(path, ParseOptions::default())
    }

    /// The same of a node, whose cameras need no poses whether it says `[node]` or not.
    pub fn load_node(path: &Path) -> Result<Self, ConfigError> {
        Self::load_as(path, ParseOptions { is_node: true, ..ParseOptions::default() })
    }

    /// The same without its cameras, for what is printed before their lenses and places are known.
    pub fn load_without_cameras(path: &Path) -> Result<Self, ConfigError> {
        Self::load_as(path, ParseOptions { is_without_cameras: true, ..ParseOptions::default() })
    }

    fn load_as(path: &Path, options: ParseOptions<'_>) -> Result<Self, ConfigError> {
        let text = read(path).map_err(|(message, help)| ConfigError {
            path: path.to_owned(),
            problems: vec![Problem { message, help: Some(help.to_owned()), place: None }],
        })?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut config = document::parse(&text, folder, options)
            .map_err(|problems| ConfigError { path: path.to_owned(), problems })?;
        config.set_file(ConfigFile::new(Some(path.to_owned()), text));
        Ok(config)
    }

    /// Says where it is kept, and calibrations beside it if nobody has said where.
    pub(crate) fn set_file(&mut self, file: ConfigFile) {
        self.file = file;
        if let Some(path) = self.file.path() {
            let beside = || path.with_extension("calibration.toml");
            self.server.calibration.get_or_insert_with(beside);
        }
    }

    /// Reads a configuration's text, which is kept nowhere; paths in it are relative to `folder`.
    pub fn parse(text: &str, folder: &Path) -> Result<Self, Vec<Problem>> {
        document::parse(text, folder, ParseOptions::default())
    }

    /// The same of a recording, whose cameras had these lenses; camera files are not read.
    pub fn parse_recorded(text: &str, lenses: &Lenses) -> Result<Self, Vec<Problem>> {
        document::parse(
            text,
            Path::new(""),
            ParseOptions { lenses: Some(lenses), ..ParseOptions::default() },
        )
    }
}

/// The word for a value of a key that is one of several words.
pub fn word<T: PartialEq>(words: &[(&'static str, T)], value: T) -> &'static str {
    words.iter().find(|(_, known)| *known == value).map_or("", |(word, _)| word)
}

fn read(path: &Path) -> Result<String, (String, &'static str)> {
    const NAME_IT: &str = "name the file with --config FILE; deploy/roundel.example.toml is an \
                           annotated example to start from";
    let size = fs::metadata(path)
        .map_err(|error| (format!("cannot read the configuration: {error}"), NAME_IT))?
        .len();
    if size > MAX_BYTES {
        let message =
            format!("expected a configuration of at most {MAX_BYTES} bytes, found {size}");
        return Err((message, NAME_IT));
    }
    let bytes = fs::read(path)
        .map_err(|error| (format!("cannot read the configuration: {error}"), NAME_IT))?;
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        (
            format!("expected UTF-8 text, found other bytes after byte {at}"),
            "a configuration is a TOML text file: save it as UTF-8",
        )
    })
}
