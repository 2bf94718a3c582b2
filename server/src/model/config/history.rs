//! `[history]`: storage of past object positions.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use super::reader::{NumberRange, Table};

/// `[history]`.
#[derive(Clone, Debug, PartialEq)]
pub struct HistoryConfig {
    pub file: PathBuf,
    /// Age up to which the finest tier is kept.
    pub keep: Duration,
}

const DEFAULT_HOURS: f64 = 24.0;
const MAX_HOURS: f64 = 24.0 * 366.0;

/// `None` without the table.
pub(super) fn history(root: &Table<'_, '_>, folder: &Path) -> Option<HistoryConfig> {
    let table = root.table("history", "[history]", &["file", "keep_hours"])?;
    let hours = table.number("keep_hours", NumberRange::PositiveUpTo(MAX_HOURS), DEFAULT_HOURS);
    let file = folder.join(table.text("file").unwrap_or("history.sqlite"));
    Some(HistoryConfig { file, keep: Duration::from_secs_f64(hours * 3600.0) })
}
