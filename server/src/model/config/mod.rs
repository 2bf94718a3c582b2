//! The configuration of an installation: one TOML file, parsed into checked types.
//!
//! `deploy/roundel.example.toml` has all keys with their meanings and defaults. All problems of a file are reported
//! together, each with file, line and column, and an unknown key with the most similar known one. A parsed
//! configuration is valid: sizes are positive, names unique, references resolved, camera files loaded, quaternions unit.

mod access;
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
mod node;
mod object;
mod reader;
mod recording;
mod reference;
mod request;
mod roundel;
mod source_rules;
mod tls;

use std::{
    collections::BTreeMap,
    io,
    net::SocketAddr,
    path::{Path, PathBuf},
    sync::Arc,
};

use roundel_core::{
    camera::Camera,
    marker::{Kind, Mode},
    world::MotionClass,
};

pub use camera::{CAMERA_SCHEMA, CameraConfig, Effect, MODES, UNTRUSTED};
pub use camera_pose::{MountConfig, PoseConfig};
use document::ParseOptions;
pub use error::{ConfigError, Problem, TextLocation};
pub use file::{ConfigFile, ConfigFileError};
pub use history::HistoryConfig;
pub use node::NodeConfig;
pub use object::{ObjectConfig, ObjectRoundels};
pub use recording::{FrameFormat, RecordingConfig};
pub use reference::ReferenceConfig;
use request::RequestScope;
pub use roundel::POLARITIES;
pub use tls::TlsConfig;

use crate::model::{
    access::AccessConfig,
    address::SourceAddress,
    regular_file,
    source_rules::{SourceRuleError, SourceRules},
};

/// A longer file is not a configuration.
pub const MAX_BYTES: u64 = 4 << 20;

pub type Lenses = BTreeMap<String, Camera>;

#[derive(Clone, Debug)]
pub struct Config {
    pub file: ConfigFile,
    /// Relative paths begin here.
    pub folder: PathBuf,
    /// Shown to clients and on the dashboard.
    pub name: String,
    /// `[server]`.
    pub server: ServerConfig,
    /// `[[access]]`, and who may connect.
    pub access: AccessConfig,
    /// `[detection] mode`, for cameras without a mode of their own.
    pub mode: Mode,
    /// `[detection] time_budget`, a share of the interval between frames.
    pub time_budget: f64,
    /// `[[roundel]]`, by [`KindId`]; at least one. Ratios of plain ones differ by a tenth, coded ones in their bits.
    pub kinds: Vec<Kind>,
    /// Motion of the objects of each kind.
    pub motions: Vec<MotionClass>,
    /// Relative tolerance of their printed diameters, in the same order.
    pub tolerances: Vec<f64>,
    /// `[[camera]]`, by [`roundel_core::id::CameraId`]; at least one, names unique.
    pub cameras: Vec<CameraConfig>,
    /// `[[reference]]`; at least three that are not in one line if a camera's pose is unknown.
    pub references: Vec<ReferenceConfig>,
    /// `[[object]]`, names unique; no roundel is on two of them.
    pub objects: Vec<ObjectConfig>,
    /// `[fusion]`.
    pub fusion: FusionConfig,
    /// `[limits]`.
    pub limits: LimitsConfig,
    /// `[recording]`.
    pub recording: RecordingConfig,
    /// `[history]`.
    pub history: Option<HistoryConfig>,
    /// `[node]`: the file is a node's, whose cameras need no poses.
    pub node: Option<NodeConfig>,
}

/// `[server]`.
#[derive(Clone, Debug, PartialEq)]
pub struct ServerConfig {
    /// The one port of every API.
    pub listen: SocketAddr,
    /// Snapshots a second.
    pub snapshot_rate_hz: f64,
    /// Also publishes a snapshot as soon as a frame was fused.
    pub publishes_per_frame: bool,
    /// The calibration file. `None`: calibrations last until the server ends.
    pub calibration: Option<PathBuf>,
    /// Whether bumped cameras are detected, quarantined and recovered.
    pub monitors_cameras: bool,
    /// Whether clients (with `[[access]]`, those with the role `setup`) may change cameras and objects and probe sources,
    /// within [`Self::source_rules`].
    pub setup: bool,
    /// Origins of pages that may use this server from a browser; `*` is any.
    pub allow_origins: Vec<String>,
    /// `None`: the port does not offer TLS.
    pub tls: Option<TlsConfig>,
    /// What sources that clients name may reach.
    pub source_rules: Arc<SourceRules>,
}

/// `[fusion]`.
#[derive(Clone, Debug, PartialEq)]
pub struct FusionConfig {
    /// Rms acceleration of objects, m/s².
    pub acceleration_m_s2: f64,
    /// Relative standard deviation of the focal lengths in camera files.
    pub focal_deviation: f64,
    /// Observations up to this much older than the newest are used, seconds.
    pub late_window_s: f64,
    /// A track without detections for this long is predicted, seconds.
    pub predicted_after_s: f64,
    /// A track without detections for this long is lost, seconds; above `predicted_after_s`.
    pub lost_after_s: f64,
}

impl Default for FusionConfig {
    fn default() -> Self {
        Self {
            acceleration_m_s2: 1.5,
            focal_deviation: 5e-4,
            late_window_s: 0.3,
            predicted_after_s: 0.15,
            lost_after_s: 2.0,
        }
    }
}

/// `[limits]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LimitsConfig {
    pub max_objects: usize,
    pub max_roundels_per_camera: usize,
    pub max_clients: usize,
    pub max_connections_per_peer: usize,
}

impl Default for LimitsConfig {
    fn default() -> Self {
        Self {
            max_objects: 1000,
            max_roundels_per_camera: 400,
            max_clients: 2000,
            max_connections_per_peer: 1000,
        }
    }
}

impl Config {
    /// Reads a file and its camera files; relative paths begin in its folder. The calibration file of `lab.toml` is
    /// `lab.calibration.toml` by default.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        Self::load_as(path, ParseOptions::default())
    }

    /// The configuration of a node, with `[node]` or without.
    pub fn load_node(path: &Path) -> Result<Self, ConfigError> {
        Self::load_as(path, ParseOptions { is_node: true, ..ParseOptions::default() })
    }

    /// Without cameras, for printing before their lenses and poses are known.
    pub fn load_without_cameras(path: &Path) -> Result<Self, ConfigError> {
        Self::load_as(path, ParseOptions { is_without_cameras: true, ..ParseOptions::default() })
    }

    fn load_as(path: &Path, options: ParseOptions<'_>) -> Result<Self, ConfigError> {
        let failed = |problems| ConfigError { path: path.to_owned(), problems };
        let text = regular_file::read_text(path, MAX_BYTES).map_err(|error| {
            let message = format!("cannot read the configuration: {error}");
            let help = match error.kind() {
                io::ErrorKind::InvalidData => "a configuration is a TOML text file: save it as UTF-8",
                _ => {
                    "name the file with --config FILE; deploy/roundel.example.toml is an annotated example to start from"
                }
            };
            failed(vec![Problem { message, help: Some(help.to_owned()), place: None }])
        })?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut config = document::parse(&text, folder, options).map_err(failed)?;
        config.set_file(ConfigFile::new(Some(path.to_owned()), text));
        Ok(config)
    }

    /// Sets the file, the default calibration file beside it, and its folder as one whose files clients may name.
    pub(crate) fn set_file(&mut self, file: ConfigFile) {
        self.file = file;
        if let Some(path) = self.file.path() {
            let here = PathBuf::from(".");
            // Without a file, clients may not name those of the folder in which the server happens to run.
            if self.folder.as_os_str().is_empty()
                && !self.server.source_rules.folders.contains(&here)
            {
                Arc::make_mut(&mut self.server.source_rules).folders.insert(0, here);
            }
            let beside = || path.with_extension("calibration.toml");
            self.server.calibration.get_or_insert_with(beside);
        }
    }

    /// Parses a text; relative paths begin in `folder`.
    pub fn parse(text: &str, folder: &Path) -> Result<Self, Vec<Problem>> {
        document::parse(text, folder, ParseOptions::default())
    }

    /// Parses a text of a request that may replace this configuration. Only its own sources and files, and those that
    /// its rules allow, may be named.
    pub fn parse_request(&self, text: &str) -> Result<Self, Vec<Problem>> {
        let request = Some(self.request_scope());
        document::parse(text, &self.folder, ParseOptions { request, ..ParseOptions::default() })
    }

    /// Checks a source of a request. Returns the rules that bind it; `None` for a source of the configuration file.
    pub fn admit_source(
        &self,
        address: &SourceAddress,
    ) -> Result<Option<Arc<SourceRules>>, SourceRuleError> {
        self.request_scope().admit_source(address)
    }

    fn request_scope(&self) -> RequestScope<'_> {
        RequestScope { rules: &self.server.source_rules, cameras: &self.cameras }
    }

    /// Parses the configuration of a recording with these lenses, in place of camera files.
    pub fn parse_recorded(text: &str, lenses: &Lenses) -> Result<Self, Vec<Problem>> {
        let options = ParseOptions { lenses: Some(lenses), ..ParseOptions::default() };
        document::parse(text, Path::new(""), options)
    }
}

/// The word for a value of a key that takes one of several words.
pub fn word<T: PartialEq>(words: &[(&'static str, T)], value: T) -> &'static str {
    words.iter().find(|(_, known)| *known == value).map_or("", |(word, _)| word)
}
