//! Lists the image files of a folder or of a pattern, in the natural order of their names.
//!
//! `**` in a pattern can span a whole disk, so a listing ends with an error after [`MAX_ENTRIES`] or [`MAX_DURATION`],
//! and with the stop signal of its source. Folders that no file of the pattern can be in are not entered. Symbolic links
//! to folders are followed, except by patterns with `**`.

use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use glob::Pattern;
use thiserror::Error;
use walkdir::{DirEntry, WalkDir};

use crate::model::{address::split_pattern, stop::StopSignal};

/// File name endings of images in a folder.
const ENDINGS: [&str; 5] = ["png", "jpg", "jpeg", "pgm", "bmp"];
/// Files and folders that one listing may visit.
const MAX_ENTRIES: usize = 1_000_000;
const MAX_DURATION: Duration = Duration::from_secs(30);
const ANY_FOLDERS: &str = "**";

#[derive(Debug, Error)]
pub enum ListError {
    #[error("stopped")]
    Stopped,
    #[error("cannot list the folder {}: {reason}", .folder.display())]
    Folder { folder: PathBuf, reason: String },
    #[error("folder {0} has no PNG, JPEG, PGM or BMP files: put frames there")]
    EmptyFolder(String),
    #[error("no file matches {0}: check the path, or put frames there")]
    Empty(String),
    #[error("pattern {pattern}: {reason}")]
    Pattern { pattern: String, reason: String },
    #[error(
        "pattern {pattern} spans too many files: listing them stopped after {MAX_ENTRIES} files and folders, or {} s; name \
         the folder of the frames",
        MAX_DURATION.as_secs()
    )]
    TooMany { pattern: String },
}

/// Ends with an error on the stop signal.
pub fn list_files(pattern: &str, stop: &StopSignal) -> Result<Vec<PathBuf>, ListError> {
    let folder = Path::new(pattern);
    let mut files = if folder.is_dir() {
        // A folder that cannot be read is an error, one without images is another.
        let failed = |reason: std::io::Error| ListError::Folder {
            folder: folder.to_owned(),
            reason: reason.to_string(),
        };
        folder.read_dir().map_err(failed)?;
        let is_image = |path: &Path| {
            let ending = path.extension().unwrap_or_default().to_ascii_lowercase();
            ENDINGS.iter().any(|known| ending == *known)
        };
        let files = walk(pattern, WalkDir::new(folder).max_depth(1), |_| true, stop)?;
        files.into_iter().filter(|path| is_image(path)).collect()
    } else {
        matching_files(pattern, stop)?
    };
    if files.is_empty() && folder.is_dir() {
        return Err(ListError::EmptyFolder(pattern.to_owned()));
    }
    if files.is_empty() {
        return Err(ListError::Empty(pattern.to_owned()));
    }
    alphanumeric_sort::sort_path_slice(&mut files);
    Ok(files)
}

fn matching_files(pattern: &str, stop: &StopSignal) -> Result<Vec<PathBuf>, ListError> {
    let wrong = |reason: String| ListError::Pattern { pattern: pattern.to_owned(), reason };
    let (root, wildcards) = split_pattern(pattern);
    if wildcards.as_os_str().is_empty() {
        return Ok(if root.is_file() { vec![root] } else { Vec::new() });
    }
    let components: Vec<String> =
        wildcards.iter().map(|it| it.to_string_lossy().into_owned()).collect();
    if components.iter().any(|it| it == "..") {
        return Err(wrong("`..` must not follow a wildcard".to_owned()));
    }
    let parsed =
        components.iter().map(|it| Pattern::new(it).map_err(|error| wrong(error.to_string())));
    let names = parsed.collect::<Result<Vec<Pattern>, ListError>>()?;
    let whole = Pattern::new(&components.join("/")).map_err(|error| wrong(error.to_string()))?;
    let any_from = components.iter().position(|it| it == ANY_FOLDERS);
    let mut walker = WalkDir::new(if root.as_os_str().is_empty() { Path::new(".") } else { &root });
    walker = walker.min_depth(1);
    if any_from.is_none() {
        walker = walker.max_depth(names.len()).follow_links(true);
    }
    let may_match = |entry: &DirEntry| {
        let depth = entry.depth();
        let is_exact = depth > 0 && any_from.is_none_or(|from| depth <= from);
        !is_exact
            || names
                .get(depth - 1)
                .is_some_and(|it| it.matches(&entry.file_name().to_string_lossy()))
    };
    let mut files = walk(pattern, walker, may_match, stop)?;
    let options = glob::MatchOptions { require_literal_separator: true, ..Default::default() };
    files.retain(|file| {
        let below = file.strip_prefix(&root).or_else(|_| file.strip_prefix("."));
        below.is_ok_and(|below| whole.matches_path_with(below, options))
    });
    Ok(files)
}

/// The files below a folder. Folders that cannot be read are left out.
fn walk(
    pattern: &str,
    walker: WalkDir,
    may_match: impl Fn(&DirEntry) -> bool,
    stop: &StopSignal,
) -> Result<Vec<PathBuf>, ListError> {
    let deadline = Instant::now() + MAX_DURATION;
    let (mut files, mut visited) = (Vec::new(), 0);
    let mut entries = walker.into_iter();
    while let Some(entry) = entries.next() {
        visited += 1;
        if stop.is_stopped() {
            return Err(ListError::Stopped);
        }
        if visited > MAX_ENTRIES || Instant::now() >= deadline {
            return Err(ListError::TooMany { pattern: pattern.to_owned() });
        }
        let Ok(entry) = entry else { continue };
        let found = entry.file_type();
        if !may_match(&entry) {
            if found.is_dir() {
                entries.skip_current_dir();
            }
            continue;
        }
        // Links are not resolved where those to folders are not followed.
        if found.is_file() || (found.is_symlink() && entry.path().is_file()) {
            files.push(entry.into_path());
        }
    }
    Ok(files)
}

#[cfg(test)]
mod tests {
    use std::{fs, os::unix::fs::symlink};

    use super::*;

    fn list(pattern: &str) -> Result<Vec<PathBuf>, String> {
        list_files(pattern, &StopSignal::default()).map_err(|error| error.to_string())
    }

    fn names(files: Vec<PathBuf>) -> Vec<String> {
        files.iter().map(|f| f.file_name().unwrap().to_string_lossy().into_owned()).collect()
    }

    #[test]
    fn files_come_in_natural_order_and_others_are_left_out() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["10.PNG", "9.png", "notes.txt", "1.bmp", "09.png"] {
            fs::write(folder.path().join(name), "").unwrap();
        }
        let path = folder.path().to_str().unwrap();
        assert_eq!(names(list(path).unwrap()), ["1.bmp", "9.png", "09.png", "10.PNG"]);
        assert_eq!(names(list(&format!("{path}/*.png")).unwrap()), ["9.png", "09.png"]);
        assert_eq!(names(list(&format!("{path}/9.png")).unwrap()), ["9.png"]);
        assert!(list(&format!("{path}/x*")).unwrap_err().contains("no file matches"));
        let missing = list(&format!("{path}/sub")).unwrap_err();
        assert!(missing.contains("no file matches"), "{missing}");
        let empty = tempfile::tempdir().unwrap();
        let error = list(empty.path().to_str().unwrap()).unwrap_err();
        assert!(error.contains("has no PNG, JPEG, PGM or BMP files"), "{error}");
    }

    /// The same files as with the crate `glob`, except that `**` does not follow links to folders.
    #[test]
    fn patterns_match_as_those_of_glob() {
        let folder = tempfile::tempdir().unwrap();
        for file in
            ["a/0.png", "a/1.png", "b/0.png", "b/sub/2.png", "b/.hidden/3.png", "c[1]/4.png"]
        {
            let path = folder.path().join(file);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, "").unwrap();
        }
        symlink("a", folder.path().join("link")).unwrap();
        symlink("../a/0.png", folder.path().join("b/link.png")).unwrap();
        symlink(".", folder.path().join("loop")).unwrap();
        let root = folder.path().to_str().unwrap();
        for pattern in [
            "*/*.png",
            "**/*.png",
            "**/0.png",
            "b/**/*.png",
            "?/[01].png",
            "link/*.png",
            "*/sub/*",
            "b/**/2.png",
            "c[[]1]/*.png",
            "a/../b/*.png",
            "*",
            "a//*.png",
            "./a/*.png",
        ] {
            let pattern = format!("{root}/{pattern}");
            let is_behind_link = |path: &PathBuf| {
                let text = path.to_string_lossy();
                pattern.contains("**") && (text.contains("/link/") || text.contains("/loop/"))
            };
            let mut expected: Vec<PathBuf> = glob::glob(&pattern)
                .unwrap()
                .flatten()
                .filter(|path| path.is_file() && !is_behind_link(path))
                .collect();
            alphanumeric_sort::sort_path_slice(&mut expected);
            let resolve = |files: Vec<PathBuf>| -> Vec<PathBuf> {
                files.iter().map(|file| file.components().collect()).collect()
            };
            let found = list(&pattern).unwrap_or_default();
            assert_eq!(resolve(found), resolve(expected), "{pattern}");
        }
        let error = list(&format!("{root}/*/../a/*.png")).unwrap_err();
        assert!(error.contains("`..` must not follow a wildcard"), "{error}");
        let error = list(&format!("{root}/[/*.png")).unwrap_err();
        assert!(error.contains("pattern "), "{error}");
    }

    #[test]
    fn a_stop_signal_ends_a_listing() {
        let stop = StopSignal::default();
        stop.stop();
        assert!(matches!(list_files("/**/*", &stop), Err(ListError::Stopped)));
    }
}
