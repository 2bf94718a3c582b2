//! Replaces text files atomically.

use std::{ffi::OsString, fs, io, io::Write as _, path::Path};

/// Writes a file whose permissions, if it exists, stay. Readers and crashes find the old text or the new one. Replaces the
/// target of a symbolic link, not the link.
pub fn replace(path: &Path, text: &str) -> io::Result<()> {
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let mut name = OsString::from(".");
    name.push(target.file_name().unwrap_or_default());
    name.push(".new");
    let fresh = target.with_file_name(name);
    let write = || {
        let mut file = fs::File::create(&fresh)?;
        if let Ok(metadata) = fs::metadata(&target) {
            file.set_permissions(metadata.permissions())?;
        }
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        fs::rename(&fresh, &target)
    };
    write().inspect_err(|_| drop(fs::remove_file(&fresh)))?;
    sync_folder_of(&target);
    Ok(())
}

/// Writes a file that must not exist yet. After an error or a crash, it is complete or absent.
pub fn create(path: &Path, text: &str) -> io::Result<()> {
    let mut file = fs::File::options().write(true).create_new(true).open(path)?;
    let written = file.write_all(text.as_bytes()).and_then(|()| file.sync_all());
    written.inspect_err(|_| drop(fs::remove_file(path)))?;
    sync_folder_of(path);
    Ok(())
}

/// Waits until the names in a file's folder have reached the disk, so that a new name survives a power failure. Not every
/// system can sync folders; those sync them later.
pub fn sync_folder_of(path: &Path) {
    if let Ok(folder) = fs::File::open(folder_of(path)) {
        let _ = folder.sync_all();
    }
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        // A bare name is in the working directory.
        _ => Path::new("."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_folder_of_a_bare_name_is_the_working_directory() {
        assert_eq!(folder_of(Path::new("lab.toml")), Path::new("."));
        assert_eq!(folder_of(Path::new("etc/lab.toml")), Path::new("etc"));
    }

    #[test]
    fn a_failed_replacement_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.toml");
        create(&path, "old").unwrap();
        assert_eq!(create(&path, "new").unwrap_err().kind(), io::ErrorKind::AlreadyExists);
        replace(&path, "new").unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "new");
        fs::create_dir(folder.path().join(".a.toml.new")).unwrap();
        assert!(replace(&path, "newer").is_err());
        assert_eq!(fs::read_to_string(&path).unwrap(), "new");
    }
}
