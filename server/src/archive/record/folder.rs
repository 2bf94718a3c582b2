//! The folder of recordings: names, disk budget and free space.
//!
//! A file is named `NAME-20261122T221055Z-001.mcap`: start of the recording in UTC, and the file's number within it.
//!
//! The disk budget covers files with such names that this installation has written and that are not pinned. An operator
//! pins a file by making it read-only (`chmod a-w`). Other files are neither counted nor deleted.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::{self, Read},
    path::{Path, PathBuf},
    time::{Duration, SystemTime},
};

use mcap::{
    MAGIC,
    records::{Record, op},
};
use roundel_core::time::Timestamp;

use super::{chunk, schema::METADATA};

/// Leaves space for the suffix within the limits of file systems.
pub const MAX_NAME_LEN: usize = 100;
const FILE_EXTENSION: &str = ".mcap";
/// The metadata are within these first bytes of a file.
const HEAD_BYTES: u64 = 64 * 1024;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordingFile {
    /// Without its folder.
    pub name: String,
    pub bytes: u64,
    /// Start of the recording.
    pub started: Timestamp,
    /// Number within the recording, from 1.
    pub number: u32,
    /// Last change.
    pub modified: SystemTime,
    /// Read-only: the disk budget neither counts nor deletes it.
    pub is_pinned: bool,
}

pub fn file_name(name: &str, started: Timestamp, number: u32) -> String {
    format!("{}{number:03}{FILE_EXTENSION}", file_prefix(name, started))
}

/// Start of the names of all files of a recording.
pub fn file_prefix(name: &str, started: Timestamp) -> String {
    let seconds = started.as_ns().div_euclid(1_000_000_000);
    let time = prost_types::Timestamp { seconds, nanos: 0 }.to_string().replace(['-', ':'], "");
    format!("{name}-{time}-")
}

/// Replaces characters that are not allowed in names by `-`.
pub fn sanitize_name(name: &str) -> String {
    let sanitize = |character: char| if is_allowed_char(character) { character } else { '-' };
    let name: String = name.chars().take(MAX_NAME_LEN).map(sanitize).collect();
    let name = name.trim_matches(['-', '.']);
    if name.is_empty() { "recording".to_owned() } else { name.to_owned() }
}

pub fn is_allowed_char(character: char) -> bool {
    character.is_ascii_alphanumeric() || matches!(character, '-' | '_' | '.')
}

/// Start and number of a recording's file; `None` for any other name.
fn parse_name(name: &str) -> Option<(Timestamp, u32)> {
    let (rest, number) = name.strip_suffix(FILE_EXTENSION)?.rsplit_once('-')?;
    let (_, time) = rest.rsplit_once('-')?;
    let (date, clock) = time.strip_suffix('Z')?.split_once('T')?;
    let is_digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    if date.len() != 8 || clock.len() != 6 || !is_digits(date) || !is_digits(clock) {
        return None;
    }
    let part = |text: &str, from: usize| text[from..from + 2].parse::<u8>().ok();
    let time = prost_types::Timestamp::date_time(
        date[..4].parse().ok()?,
        part(date, 4)?,
        part(date, 6)?,
        part(clock, 0)?,
        part(clock, 2)?,
        part(clock, 4)?,
    );
    let ns = time.ok()?.seconds.checked_mul(1_000_000_000)?;
    Some((Timestamp::from_ns(ns), number.parse().ok()?))
}

/// Files of recordings, the oldest first.
pub fn list(folder: &Path) -> io::Result<Vec<RecordingFile>> {
    let entries = match fs::read_dir(folder) {
        // The first recording creates the folder.
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries?,
    };
    let listed = |entry: fs::DirEntry| {
        let name = entry.file_name().into_string().ok()?;
        let (started, number) = parse_name(&name)?;
        let data = entry.metadata().ok().filter(fs::Metadata::is_file)?;
        let modified = data.modified().unwrap_or_else(|_| SystemTime::now());
        let (bytes, is_pinned) = (data.len(), data.permissions().readonly());
        Some(RecordingFile { name, bytes, started, number, modified, is_pinned })
    };
    let mut files: Vec<RecordingFile> = entries.flatten().filter_map(listed).collect();
    files.sort_by(|a, b| (a.started, a.number, &a.name).cmp(&(b.started, b.number, &b.name)));
    Ok(files)
}

/// Limits of the files of one recording.
pub struct Budget<'a> {
    pub bytes: u64,
    /// Start of the names of its files, which may be deleted at any age.
    pub prefix: &'a str,
    /// Files of other recordings that are younger are kept.
    pub keep: Duration,
    /// The file that is being written.
    pub open: &'a Path,
}

/// The files that a disk budget covers.
pub struct BudgetedFiles {
    folder: PathBuf,
    installation: String,
    /// Whether files of these names are covered: this installation has written them, and they can be deleted.
    known: BTreeMap<String, bool>,
}

impl BudgetedFiles {
    pub fn new(folder: &Path, installation: &str) -> Self {
        let (folder, installation) = (folder.to_owned(), installation.to_owned());
        Self { folder, installation, known: BTreeMap::new() }
    }

    /// The oldest first.
    pub fn list(&mut self) -> io::Result<Vec<RecordingFile>> {
        let mut files = list(&self.folder)?;
        files.retain(|file| !file.is_pinned);
        self.known.retain(|name, _| files.iter().any(|file| file.name == *name));
        let Self { folder, installation, known } = self;
        files.retain(|file| {
            *known.entry(file.name.clone()).or_insert_with(|| {
                let writer = written_by(&folder.join(&file.name));
                writer.is_ok_and(|writer| writer.as_ref() == Some(installation))
            })
        });
        Ok(files)
    }

    /// Bytes of the files that no recording of a client may replace.
    pub fn kept_bytes(&mut self, keep: Duration) -> io::Result<u64> {
        Ok(self.list()?.iter().filter(|file| is_younger(file, keep)).map(|file| file.bytes).sum())
    }

    /// Deletes the oldest files that may be deleted until the rest fits; returns them.
    pub fn enforce(&mut self, budget: &Budget<'_>) -> io::Result<Vec<PathBuf>> {
        let files = self.list()?;
        let mut total: u64 = files.iter().map(|file| file.bytes).sum();
        let mut deleted = Vec::new();
        for file in files {
            if total <= budget.bytes {
                break;
            }
            let path = self.folder.join(&file.name);
            let is_kept = !file.name.starts_with(budget.prefix) && is_younger(&file, budget.keep);
            if is_kept || budget.open == path {
                continue;
            }
            match fs::remove_file(&path) {
                Ok(()) => deleted.push(path),
                Err(error) => {
                    tracing::warn!(file = %path.display(), %error, "cannot delete an old recording");
                    self.known.insert(file.name, false);
                }
            }
            total -= file.bytes;
        }
        Ok(deleted)
    }
}

fn is_younger(file: &RecordingFile, keep: Duration) -> bool {
    // A time in the future, as after a step of the clock, is young.
    keep > Duration::ZERO && file.modified.elapsed().map_or(true, |age| age < keep)
}

/// Name of the installation that has written a recording; `None` for other files.
fn written_by(path: &Path) -> io::Result<Option<String>> {
    let mut head = Vec::new();
    File::open(path)?.take(HEAD_BYTES).read_to_end(&mut head)?;
    let mut rest = head.strip_prefix(MAGIC).unwrap_or_default();
    while let Ok((opcode, body, after)) = chunk::split_record(rest) {
        rest = after;
        if opcode != op::METADATA {
            continue;
        }
        if let Ok(Some(Record::Metadata(record))) = chunk::parse(opcode, body)
            && record.name == METADATA
        {
            return Ok(record.metadata.get("installation").cloned());
        }
    }
    Ok(None)
}

/// Free bytes of a folder's disk for unprivileged programs.
#[cfg(all(target_os = "linux", target_pointer_width = "64"))]
pub fn free_bytes(folder: &Path) -> io::Result<u64> {
    let disk = rustix::fs::statvfs(folder)?;
    Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
}

/// Unknown on other systems: writing fails when the disk is full.
#[cfg(not(all(target_os = "linux", target_pointer_width = "64")))]
pub fn free_bytes(_: &Path) -> io::Result<u64> {
    Ok(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::record::file_writer::FileWriter;

    /// 2026-11-22 22:10:55 UTC.
    const THEN: i64 = 1_795_385_455;

    fn at(seconds: i64) -> Timestamp {
        Timestamp::from_ns(seconds * 1_000_000_000)
    }

    #[test]
    fn names_contain_start_and_number() {
        let name = file_name("lab", at(THEN), 7);
        assert_eq!(name, "lab-20261122T221055Z-007.mcap");
        assert_eq!(parse_name(&name), Some((at(THEN), 7)));
        // A leap day, the last second of a century, the epoch.
        for seconds in [1_709_164_800, 4_102_444_799, 0, 951_782_400] {
            let name = file_name("a-b", at(seconds), 1);
            assert_eq!(parse_name(&name), Some((at(seconds), 1)), "{name}");
        }
        for name in
            ["lab.mcap", "lab-1.mcap", "lab-20261122T2210Z-1.mcap", "a-b-c.mcap", "ü-ü-ü.mcap"]
        {
            assert_eq!(parse_name(name), None, "{name}");
        }
        assert_eq!(sanitize_name("Halle 3/übung"), "Halle-3--bung");
        assert_eq!(sanitize_name("../../etc"), "etc");
        assert_eq!(sanitize_name("  "), "recording");
    }

    const HOUR: Duration = Duration::from_secs(3600);

    /// A folder with recordings of two installations, and their size.
    fn recordings() -> (tempfile::TempDir, u64) {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("mine.mcap"), vec![0; 1000]).unwrap();
        fs::write(folder.path().join(file_name("x", at(THEN - 9), 1)), vec![0; 1000]).unwrap();
        let put = |name: &str, seconds, number, installation: &str| {
            let path = folder.path().join(file_name(name, at(seconds), number));
            let about = BTreeMap::from([("installation".to_owned(), installation.to_owned())]);
            FileWriter::create(&path, &about).unwrap().finish().unwrap()
        };
        put("b", THEN - 5, 1, "elsewhere");
        let bytes = put("b", THEN, 1, "lab");
        put("a", THEN + 1, 1, "lab");
        put("a", THEN + 1, 2, "lab");
        (folder, bytes)
    }

    fn enforce(folder: &Path, bytes: u64, keep: Duration) -> Vec<String> {
        let newest = folder.join(file_name("a", at(THEN + 1), 2));
        let prefix = file_prefix("a", at(THEN + 1));
        let budget = Budget { bytes, prefix: &prefix, keep, open: &newest };
        let deleted = BudgetedFiles::new(folder, "lab").enforce(&budget).unwrap();
        let name = |path: PathBuf| path.file_name().unwrap().to_str().unwrap().to_owned();
        deleted.into_iter().map(name).collect()
    }

    #[test]
    fn only_the_oldest_recordings_of_this_installation_are_deleted() {
        let (folder, bytes) = recordings();
        assert_eq!(enforce(folder.path(), 3 * bytes, Duration::ZERO), Vec::<String>::new());
        let oldest = file_name("b", at(THEN), 1);
        assert_eq!(enforce(folder.path(), 3 * bytes - 1, Duration::ZERO), [oldest]);
        assert_eq!(enforce(folder.path(), 0, Duration::ZERO).len(), 1);
        let left = list(folder.path()).unwrap();
        assert_eq!(
            left.len(),
            3,
            "a foreign file, another installation's and the open one: {left:?}"
        );
        assert!(folder.path().join("mine.mcap").exists());
        assert!(free_bytes(folder.path()).unwrap() > 0);
        assert_eq!(list(&folder.path().join("none")).unwrap(), []);
    }

    #[test]
    fn pinned_and_recent_recordings_are_spared() {
        let (folder, bytes) = recordings();
        let mut files = BudgetedFiles::new(folder.path(), "lab");
        assert_eq!(files.kept_bytes(HOUR).unwrap(), 3 * bytes);
        assert_eq!(files.kept_bytes(Duration::ZERO).unwrap(), 0);
        let own = file_name("a", at(THEN + 1), 1);
        assert_eq!(enforce(folder.path(), 0, HOUR), [own], "only of this recording");
        let pinned = folder.path().join(file_name("b", at(THEN), 1));
        let mut permissions = fs::metadata(&pinned).unwrap().permissions();
        permissions.set_readonly(true);
        fs::set_permissions(&pinned, permissions).unwrap();
        assert_eq!(enforce(folder.path(), 0, Duration::ZERO), Vec::<String>::new());
        assert!(pinned.exists());
    }
}
