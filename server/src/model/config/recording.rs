//! `[recording]`: folder, size limits and frames of recordings.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use super::reader::{NumberRange, Table};

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FrameFormat {
    /// A tenth of the size of PNG; detections in it differ slightly.
    #[default]
    Jpeg,
    Png,
}

/// One billion bytes.
const GIGABYTE: u64 = 1_000_000_000;

/// `[recording]`.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordingConfig {
    /// Whether recording starts with the server.
    pub starts: bool,
    pub folder: PathBuf,
    /// Size after which a new file is begun.
    pub rotate_bytes: u64,
    /// Age after which a new file is begun.
    pub rotate_after: Duration,
    /// Limit of all files together; the oldest are deleted. At least two files.
    pub budget_bytes: u64,
    /// Files younger than this are not deleted for a recording that a client starts.
    pub keep: Duration,
    /// Free space on the disk below which nothing is recorded.
    pub min_free_bytes: u64,
    /// Every how many frames one is recorded; 0: none.
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
            keep: Duration::from_secs(24 * 3600),
            min_free_bytes: GIGABYTE,
            frames_every: 0,
            frames_format: FrameFormat::default(),
        }
    }
}

const KEYS: [&str; 9] = [
    "start",
    "folder",
    "rotate_mb",
    "rotate_minutes",
    "budget_gb",
    "keep_hours",
    "min_free_mb",
    "frames_every",
    "frames_format",
];
const FORMATS: [(&str, FrameFormat); 2] = [("jpeg", FrameFormat::Jpeg), ("png", FrameFormat::Png)];
const MB: f64 = 1e6;
const GB: f64 = 1e9;
const MAX_MB: f64 = 1e9;
const MAX_MINUTES: f64 = 1e6;
const MAX_HOURS: f64 = 1e5;

pub(super) fn recording(root: &Table<'_, '_>, folder: &Path) -> RecordingConfig {
    let default = RecordingConfig::default();
    let table = root.section("recording", "[recording]", &KEYS);
    let size = |key, unit: f64, allowed: fn(f64) -> NumberRange, default: u64| {
        (table.number(key, allowed(MAX_MB * MB / unit), default as f64 / unit) * unit) as u64
    };
    let minutes = default.rotate_after.as_secs_f64() / 60.0;
    let minutes = table.number("rotate_minutes", NumberRange::PositiveUpTo(MAX_MINUTES), minutes);
    let hours = default.keep.as_secs_f64() / 3600.0;
    let hours = table.number("keep_hours", NumberRange::ZeroUpTo(MAX_HOURS), hours);
    let config = RecordingConfig {
        starts: table.flag("start").unwrap_or(default.starts),
        folder: table.text("folder").map_or(folder.join(&default.folder), |name| folder.join(name)),
        rotate_bytes: size("rotate_mb", MB, NumberRange::PositiveUpTo, default.rotate_bytes),
        rotate_after: Duration::from_secs_f64(minutes * 60.0),
        budget_bytes: size("budget_gb", GB, NumberRange::PositiveUpTo, default.budget_bytes),
        keep: Duration::from_secs_f64(hours * 3600.0),
        min_free_bytes: size("min_free_mb", MB, NumberRange::ZeroUpTo, default.min_free_bytes),
        frames_every: table.whole("frames_every", 0..=1_000_000).unwrap_or(0) as u32,
        frames_format: table.choice("frames_format", &FORMATS).unwrap_or_default(),
    };
    if config.budget_bytes < 2 * config.rotate_bytes {
        let message = format!(
            "`budget_gb` must allow two files of `rotate_mb` = {}, found {}: the one that is written and the one \
             before it",
            config.rotate_bytes as f64 / MB,
            config.budget_bytes as f64 / GB
        );
        table.fail("budget_gb", message, "");
    }
    config
}
