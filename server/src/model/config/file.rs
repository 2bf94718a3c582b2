//! The text that an installation was configured by, and how another one takes its place.
//!
//! The new text is written beside the file, forced to the disk, and takes the file's place in one step: whoever reads
//! it, and whatever happens meanwhile, it is the one or the other. A file that somebody has changed since it was read
//! is not replaced, nor one that is marked as not to be written.

use std::{
    ffi::OsString,
    fs,
    hash::{DefaultHasher, Hash, Hasher},
    io,
    io::Write as _,
    path::{Path, PathBuf},
};

use thiserror::Error;

/// A configuration's text, and where it is kept.
#[derive(Clone, Debug, Default)]
pub struct ConfigFile {
    path: Option<PathBuf>,
    text: String,
}

/// Why a text does not take the place of the one before.
#[derive(Debug, Error)]
pub enum ConfigFileError {
    #[error(
        "{} was changed since this server read it, so it is not written over: start the server anew to take over what \
         is in it, or undo that change",
        .0.display()
    )]
    Changed(PathBuf),
    /// It is not to be written.
    #[error("{} may not be written (it is read-only): change its permissions, or edit it by hand and start the server anew", .0.display())]
    ReadOnly(PathBuf),
    #[error("cannot write {}: {source}; edit it by hand and start the server anew", .path.display())]
    Write { path: PathBuf, source: io::Error },
}

impl ConfigFile {
    /// Of a text that is kept there; without a path it is kept nowhere.
    pub fn new(path: Option<PathBuf>, text: String) -> Self {
        Self { path, text }
    }

    pub fn text(&self) -> &str {
        &self.text
    }

    /// The file that it is kept in.
    pub fn path(&self) -> Option<&Path> {
        self.path.as_deref()
    }

    pub fn version(&self) -> String {
        let mut hasher = DefaultHasher::new();
        self.text.hash(&mut hasher);
        format!("{:016x}", hasher.finish())
    }

    /// Where changes are kept, in the second half of a sentence.
    pub fn kept(&self) -> String {
        match &self.path {
            Some(path) => format!("it is kept in {}", path.display()),
            None => {
                "it lasts until this server ends, which was started without a configuration file"
                    .to_owned()
            }
        }
    }

    /// Puts a text in the place of the one before.
    pub fn replace(&mut self, text: String) -> Result<(), ConfigFileError> {
        if let Some(path) = &self.path {
            let failed = |source| ConfigFileError::Write { path: path.clone(), source };
            // What a link points to is replaced, and not the link.
            let target = fs::canonicalize(path).map_err(failed)?;
            if fs::read(&target).map_err(failed)? != self.text.as_bytes() {
                return Err(ConfigFileError::Changed(path.clone()));
            }
            let metadata = fs::metadata(&target).map_err(failed)?;
            if metadata.permissions().readonly() {
                return Err(ConfigFileError::ReadOnly(path.clone()));
            }
            write(&target, &metadata, &text).map_err(failed)?;
        }
        self.text = text;
        Ok(())
    }
}

fn write(target: &Path, metadata: &fs::Metadata, text: &str) -> io::Result<()> {
    let mut name = OsString::from(".");
    name.push(target.file_name().unwrap_or_default());
    name.push(".new");
    let fresh = target.with_file_name(name);
    let written = || {
        let mut file = fs::File::create(&fresh)?;
        file.set_permissions(metadata.permissions())?;
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        fs::rename(&fresh, target)
    };
    written().inspect_err(|_| {
        // What there is of it is of no use.
        let _ = fs::remove_file(&fresh);
    })?;
    // That the new name is on the disk as well; where folders cannot be synced, the system does it by itself.
    let folder = target.parent().filter(|folder| !folder.as_os_str().is_empty());
    if let Some(folder) = folder.and_then(|folder| fs::File::open(folder).ok()) {
        let _ = folder.sync_all();
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::{PermissionsExt, symlink};

    use super::*;

    fn file(folder: &Path) -> (PathBuf, ConfigFile) {
        let path = folder.join("lab.toml");
        fs::write(&path, "a = 1\n").unwrap();
        (path.clone(), ConfigFile::new(Some(path), "a = 1\n".to_owned()))
    }

    #[test]
    fn a_new_text_keeps_permissions_and_links() {
        let folder = tempfile::tempdir().unwrap();
        let (path, _) = file(folder.path());
        fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).unwrap();
        let link = folder.path().join("link.toml");
        symlink("lab.toml", &link).unwrap();
        let mut file = ConfigFile::new(Some(link.clone()), "a = 1\n".to_owned());
        file.replace("a = 2\n".to_owned()).unwrap();
        file.replace("a = 3\n".to_owned()).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "a = 3\n");
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o640);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "nothing is left beside it");
    }

    #[test]
    fn what_somebody_changed_locked_or_moved_away_stays_as_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let (path, mut file) = file(folder.path());
        fs::write(&path, "a = 1 # mine\n").unwrap();
        let error = file.replace("a = 2\n".to_owned()).unwrap_err().to_string();
        assert!(error.contains("lab.toml was changed since this server read it"), "{error}");
        assert_eq!(fs::read_to_string(&path).unwrap(), "a = 1 # mine\n");

        fs::write(&path, "a = 1\n").unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o444)).unwrap();
        let error = file.replace("a = 2\n".to_owned()).unwrap_err().to_string();
        assert!(error.contains("read-only"), "{error}");
        assert_eq!(fs::read_to_string(&path).unwrap(), "a = 1\n");

        fs::remove_file(&path).unwrap();
        let error = file.replace("a = 2\n".to_owned()).unwrap_err().to_string();
        assert!(error.contains("cannot write") && error.contains("lab.toml"), "{error}");
        assert!(!path.exists());
        assert_eq!(file.text(), "a = 1\n", "and the server knows");
    }

    #[test]
    fn without_a_file_it_lasts_until_the_end() {
        let mut file = ConfigFile::default();
        file.replace("a = 2\n".to_owned()).unwrap();
        assert_eq!(file.text(), "a = 2\n");
        assert!(file.kept().contains("lasts until this server ends"), "{}", file.kept());
    }
}
