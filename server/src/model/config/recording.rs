//! `[recording]`: where recordings go, and how much room they take.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use super::reader::{NumberRange, Table};

/// What pictures of frames are kept as.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FrameFormat {
    /// A tenth of the size of PNG; what is found in them again differs a little.
    #[default]
    Jpeg,
    Png,
}

/// One billion bytes.
const GIGABYTE: u64 = 1_000_000_000;

/// `[recording]`.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordingConfig {
    /// Whether it begins with the server.
    pub starts: bool,
    pub folder: PathBuf,
    /// A file that has grown to so much is followed by another one.
    pub rotate_bytes: u64,
    /// So does one that is so old.
    pub rotate_after: Duration,
    /// All files together take no more; the oldest make room. At least two files.
    pub budget_bytes: u64,
    /// The disk has so much left, or nothing is recorded.
    pub min_free_bytes: u64,
    /// One in so many frames of each camera is kept; 0: none.
    pub frames_every: u32,
    pub frames_format: FrameFormat,
}

impl Default for RecordingConfig {
    fn default() -> Self {
        Self {
            starts: false,
            folder: PathBuf::from("recordings"),
            rotate_bytes: GIGABYTE,
            rotate_after: Duration::from_secs(3600),
            budget_bytes: 20 * GIGABYTE,
            min_free_bytes: GIGABYTE,
            frames_every: 0,
            frames_format: FrameFormat::default(),
        }
    }
}

const KEYS: [&str; 8] = [
    "start",
    "folder",
    "rotate_mb",
    "rotate_minutes",
    "budget_gb",
    "min_free_mb",
    "frames_every",
    "frames_format",
];
const FORMATS: [(&str, FrameFormat); 2] = [("jpeg", FrameFormat::Jpeg), ("png", FrameFormat::Png)];
const MB: f64 = 1e6;
const GB: f64 = 1e9;
const MAX_MB: f64 = 1e9;
const MAX_MINUTES: f64 = 1e6;

pub(super) fn recording(root: &Table<'_, '_>, folder: &Path) -> RecordingConfig {
    let default = RecordingConfig::default();
    let default = RecordingConfig { folder: folder.join(&default.folder), ..default };
    let Some(table) = root.table("recording", "[recording]", &KEYS) else { return default };
    let size = |key, unit: f64, allowed: fn(f64) -> NumberRange, default: u64| {
        (table.number(key, allowed(MAX_MB * MB / unit), default as f64 / unit) * unit) as u64
    };
    let minutes = default.rotate_after.as_secs_f64() / 60.0;
    let minutes = table.number("rotate_minutes", NumberRange::PositiveUpTo(MAX_MINUTES), minutes);
    let config = RecordingConfig {
        starts: table.flag("start").unwrap_or(default.starts),
        folder: table.text("folder").map_or(default.folder, |name| folder.join(name)),
        rotate_bytes: size("rotate_mb", MB, NumberRange::PositiveUpTo, default.rotate_bytes),
        rotate_after: Duration::from_secs_f64(minutes * 60.0),
        budget_bytes: size("budget_gb", GB, NumberRange::PositiveUpTo, default.budget_bytes),
        min_free_bytes: size("min_free_mb", MB, NumberRange::ZeroUpTo, default.min_free_bytes),
        frames_every: table.whole("frames_every", 0..=1_000_000).unwrap_or(0) as u32,
        frames_format: table.choice("frames_format", &FORMATS).unwrap_or_default(),
    };
    if config.budget_bytes < 2 * config.rotate_bytes {
        table.fail(
            &table.span_of("budget_gb"),
            format!(
                "`budget_gb` must have room for two files of `rotate_mb` = {}, found {}: the one that is written and \
                 one before it",
                config.rotate_bytes as f64 / MB,
                config.budget_bytes as f64 / GB
            ),
        );
    }
    config
}
