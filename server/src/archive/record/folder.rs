//! The folder of recordings: names, the budget, and what room there is.
//!
//! A file is `NAME-20261122T221055Z-001.mcap`: begin of the recording, UTC, and its number within it, so that the order
//! of names is that of time. Only files with such names are ever deleted.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use roundel_core::time::Timestamp;

/// A name may be so long: with what is put behind it, file systems take it.
pub const MAX_NAME_LEN: usize = 100;
const FILE_EXTENSION: &str = ".mcap";
const SECONDS_A_DAY: i64 = 86_400;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordingFile {
    /// Without its folder.
    pub name: String,
    pub bytes: u64,
    /// Begin of the recording.
    pub started: Timestamp,
    /// Its number within the recording, from 1.
    pub number: u32,
}

/// The file of a recording that began then.
pub fn file_name(name: &str, started: Timestamp, number: u32) -> String {
    format!("{name}-{}-{number:03}{FILE_EXTENSION}", utc(started))
}

/// A text as the begin of a file's name: what does not belong there becomes `-`.
pub fn sanitize_name(name: &str) -> String {
    let sanitize_name = |character: char| if is_allowed_char(character) { character } else { '-' };
    let name: String = name.chars().take(MAX_NAME_LEN).map(sanitize_name).collect();
    let name = name.trim_matches(['-', '.']);
    if name.is_empty() { "recording".to_owned() } else { name.to_owned() }
}

/// Whether a character may stand in a name.
pub fn is_allowed_char(character: char) -> bool {
    character.is_ascii_alphanumeric() || matches!(character, '-' | '_' | '.')
}

/// `20261122T221055Z`.
fn utc(time: Timestamp) -> String {
    let seconds = time.as_ns().div_euclid(1_000_000_000);
    let (day, second) = (seconds.div_euclid(SECONDS_A_DAY), seconds.rem_euclid(SECONDS_A_DAY));
    let (year, month, day) = date(day);
    let (hour, minute, second) = (second / 3600, second / 60 % 60, second % 60);
    format!("{year:04}{month:02}{day:02}T{hour:02}{minute:02}{second:02}Z")
}

/// Year, month and day of a day since 1970 (H. Hinnant, *chrono-compatible low-level date algorithms*).
fn date(day: i64) -> (i64, i64, i64) {
    let shifted = day + 719_468;
    let (era, of_era) = (shifted.div_euclid(146_097), shifted.rem_euclid(146_097));
    let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let month = (5 * of_year + 2) / 153;
    let day = of_year - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    (year + era * 400 + i64::from(month <= 2), month, day)
}

/// The day since 1970 of a date.
fn day_of(year: i64, month: i64, day: i64) -> i64 {
    let year = year - i64::from(month <= 2);
    let (era, of_era) = (year.div_euclid(400), year.rem_euclid(400));
    let of_year = (153 * (if month > 2 { month - 3 } else { month + 9 }) + 2) / 5 + day - 1;
    era * 146_097 + of_era * 365 + of_era / 4 - of_era / 100 + of_year - 719_468
}

/// Begin and number, if it is a recording's name.
fn parse_name(name: &str) -> Option<(Timestamp, u32)> {
    let (rest, number) = name.strip_suffix(FILE_EXTENSION)?.rsplit_once('-')?;
    let (_, time) = rest.rsplit_once('-')?;
    let time = time.strip_suffix('Z').filter(|time| time.len() == 15 && time.is_ascii())?;
    let (day, clock) = time.split_once('T').filter(|(day, _)| day.len() == 8)?;
    let part = |text: &str, from: usize, to: usize| text.get(from..to)?.parse::<i64>().ok();
    let day = day_of(part(day, 0, 4)?, part(day, 4, 6)?, part(day, 6, 8)?);
    let second = part(clock, 0, 2)? * 3600 + part(clock, 2, 4)? * 60 + part(clock, 4, 6)?;
    let ns = (day * SECONDS_A_DAY + second).checked_mul(1_000_000_000)?;
    Some((Timestamp::from_ns(ns), number.parse().ok()?))
}

/// The recordings' files, the oldest first.
pub fn list(folder: &Path) -> io::Result<Vec<RecordingFile>> {
    let entries = match fs::read_dir(folder) {
        // It is made with the first recording.
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries?,
    };
    let listed = |entry: fs::DirEntry| {
        let name = entry.file_name().into_string().ok()?;
        let (started, number) = parse_name(&name)?;
        let data = entry.metadata().ok().filter(fs::Metadata::is_file)?;
        Some(RecordingFile { name, bytes: data.len(), started, number })
    };
    let mut files: Vec<RecordingFile> = entries.flatten().filter_map(listed).collect();
    files.sort_by(|a, b| (a.started, a.number, &a.name).cmp(&(b.started, b.number, &b.name)));
    Ok(files)
}

/// Deletes the oldest files until all together take no more than `budget_bytes`; never `open`. Gives the deleted.
pub fn enforce_budget(
    folder: &Path,
    budget_bytes: u64,
    open: Option<&Path>,
) -> io::Result<Vec<PathBuf>> {
    let files = list(folder)?;
    let mut total: u64 = files.iter().map(|file| file.bytes).sum();
    let mut deleted = Vec::new();
    for file in files {
        if total <= budget_bytes {
            break;
        }
        let path = folder.join(&file.name);
        if open == Some(path.as_path()) {
            continue;
        }
        fs::remove_file(&path)?;
        total -= file.bytes;
        deleted.push(path);
    }
    Ok(deleted)
}

/// Bytes that the disk of a folder has left for programs without privileges.
#[cfg(all(target_os = "linux", target_pointer_width = "64"))]
pub fn free_bytes(folder: &Path) -> io::Result<u64> {
    let disk = rustix::fs::statvfs(folder)?;
    Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
}

/// Elsewhere nobody says; what is too much fails when it is written.
#[cfg(not(all(target_os = "linux", target_pointer_width = "64")))]
pub fn free_bytes(_: &Path) -> io::Result<u64> {
    Ok(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 2026-11-22 22:10:55 UTC.
    const THEN: i64 = 1_795_385_455;

    fn at(seconds: i64) -> Timestamp {
        Timestamp::from_ns(seconds * 1_000_000_000)
    }

    #[test]
    fn names_tell_when_and_sort_by_it() {
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

    #[test]
    fn the_oldest_make_room_and_nothing_but_recordings() {
        let folder = tempfile::tempdir().unwrap();
        let put = |name: &str, length: usize| {
            fs::write(folder.path().join(name), vec![0; length]).unwrap();
        };
        put("mine.mcap", 1000);
        put(&file_name("b", at(THEN), 1), 100);
        put(&file_name("a", at(THEN + 1), 1), 100);
        put(&file_name("a", at(THEN + 1), 2), 100);
        let newest = folder.path().join(file_name("a", at(THEN + 1), 2));
        assert_eq!(
            enforce_budget(folder.path(), 300, Some(&newest)).unwrap(),
            Vec::<PathBuf>::new()
        );
        let deleted = enforce_budget(folder.path(), 299, Some(&newest)).unwrap();
        assert_eq!(deleted, [folder.path().join(file_name("b", at(THEN), 1))]);
        assert_eq!(enforce_budget(folder.path(), 0, Some(&newest)).unwrap().len(), 1);
        assert!(newest.exists() && folder.path().join("mine.mcap").exists());
        assert!(free_bytes(folder.path()).unwrap() > 0);
        assert_eq!(list(&folder.path().join("none")).unwrap(), []);
    }
}
