//! Where a camera file goes: looked at before anything is opened, since nobody wants to wave a board for minutes for a
//! folder that is not there. What is replaced is kept beside it.

use std::{
    ffi::OsString,
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};

use crate::app::cli::check_writable;

/// Whether a file can be written there; leaves everything as it is.
pub(super) fn check(path: &Path) -> anyhow::Result<()> {
    let shown = path.display();
    if path.is_dir() {
        let example = path.join("north.yaml");
        bail!("--output {shown} is a folder: name a file in it, such as {}", example.display());
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
        bail!(
            "--output {shown}: there is no folder {}: make it, or name another file",
            folder.display()
        );
    }
    let kept = path.is_file().then(|| beside(path));
    let writable =
        check_writable(path).and_then(|()| kept.as_deref().map_or(Ok(()), check_writable));
    writable.with_context(|| format!("--output {shown} cannot be written"))
}

/// Writes it; what was there is kept under another name. Says on stderr what was done.
pub(super) fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    let kept = path.is_file().then(|| beside(path));
    if let Some(kept) = &kept {
        fs::copy(path, kept).with_context(|| {
            format!("{} was not replaced: it cannot be kept as {}", path.display(), kept.display())
        })?;
    }
    fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))?;
    match kept {
        Some(kept) => {
            eprintln!("wrote {}; what was there is kept as {}", path.display(), kept.display());
        }
        None => eprintln!("wrote {}", path.display()),
    }
    Ok(())
}

/// `north.yaml` → `north.previous.yaml`, as calibrations of arenas are kept.
fn beside(path: &Path) -> PathBuf {
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
    fn what_was_there_is_kept_under_another_name() {
        let folder = tempfile::tempdir().unwrap();
        for (name, previous) in [
            ("north.yaml", "north.previous.yaml"),
            ("a.b.yml", "a.b.previous.yml"),
            ("x", "x.previous"),
        ] {
            let (path, previous) = (folder.path().join(name), folder.path().join(previous));
            check(&path).unwrap();
            assert!(!path.exists(), "looking leaves nothing behind");
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
    fn a_place_that_is_none_is_told_before() {
        let folder = tempfile::tempdir().unwrap();
        let told = |path: &Path| format!("{:#}", check(path).unwrap_err());
        let gone = folder.path().join("no").join("x.yaml");
        assert!(told(&gone).contains("there is no folder"), "{}", told(&gone));
        assert!(told(folder.path()).contains("is a folder"), "{}", told(folder.path()));
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        let below = file.join("x.yaml");
        assert!(told(&below).contains("there is no folder"), "{}", told(&below));
        let long = folder.path().join("x".repeat(300));
        assert!(told(&long).contains("cannot be written: "), "{}", told(&long));
    }
}
