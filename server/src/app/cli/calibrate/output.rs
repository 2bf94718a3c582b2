//! Writes the camera file. The path is checked before a camera is opened, and a replaced file is kept under another name.

use std::{
    ffi::OsString,
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};

use crate::{app::cli::check_writable, model::text_file};

/// Checks whether a file can be written there, without changing anything.
pub(super) fn check(path: &Path) -> anyhow::Result<()> {
    let shown = path.display();
    if path.is_dir() {
        let example = path.join("north.yaml");
        bail!("--output {shown} is a folder: name a file in it, such as {}", example.display());
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
        bail!(
            "--output {shown}: there is no folder {}: create it, or name another file",
            folder.display()
        );
    }
    let kept = path.is_file().then(|| previous_path(path));
    let writable =
        check_writable(path).and_then(|()| kept.as_deref().map_or(Ok(()), check_writable));
    writable.with_context(|| format!("--output {shown} cannot be written"))
}

/// Writes the file, keeps an existing one under another name, and reports both on stderr.
pub(super) fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    let kept = path.is_file().then(|| previous_path(path));
    if let Some(kept) = &kept {
        fs::copy(path, kept).with_context(|| {
            format!("{} was not replaced: cannot keep it as {}", path.display(), kept.display())
        })?;
    }
    // A pipe or a terminal cannot be replaced.
    let is_special = path.exists() && !path.is_file();
    let written = if is_special { fs::write(path, text) } else { text_file::replace(path, text) };
    written.with_context(|| format!("cannot write {}", path.display()))?;
    match kept {
        Some(kept) => {
            eprintln!("wrote {}; the previous file is kept as {}", path.display(), kept.display());
        }
        None => eprintln!("wrote {}", path.display()),
    }
    Ok(())
}

/// `north.yaml` → `north.previous.yaml`, as for arena calibrations.
fn previous_path(path: &Path) -> PathBuf {
    let mut name = path.file_stem().map_or_else(OsString::new, OsString::from);
    name.push(".previous");
    if let Some(ending) = path.extension() {
        name.push(".");
        name.push(ending);
    }
    path.with_file_name(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_existing_file_is_kept_under_another_name() {
        let folder = tempfile::tempdir().unwrap();
        for (name, previous) in [
            ("north.yaml", "north.previous.yaml"),
            ("a.b.yml", "a.b.previous.yml"),
            ("x", "x.previous"),
        ] {
            let (path, previous) = (folder.path().join(name), folder.path().join(previous));
            check(&path).unwrap();
            assert!(!path.exists(), "a check creates no file");
            write(&path, "first").unwrap();
            check(&path).unwrap();
            assert!(!previous.exists() && fs::read(&path).unwrap() == b"first");
            write(&path, "second").unwrap();
            write(&path, "third").unwrap();
            assert_eq!(fs::read(&path).unwrap(), b"third");
            assert_eq!(fs::read(&previous).unwrap(), b"second");
        }
    }

    #[test]
    fn a_path_that_cannot_be_written_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let error = |path: &Path| format!("{:#}", check(path).unwrap_err());
        let gone = folder.path().join("no").join("x.yaml");
        assert!(error(&gone).contains("there is no folder"), "{}", error(&gone));
        assert!(error(folder.path()).contains("is a folder"), "{}", error(folder.path()));
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        let below = file.join("x.yaml");
        assert!(error(&below).contains("there is no folder"), "{}", error(&below));
        let long = folder.path().join("x".repeat(300));
        assert!(error(&long).contains("cannot be written: "), "{}", error(&long));
    }
}
