//! The text of the configuration, and its atomic replacement.
//!
//! A file that was changed since it was read is not overwritten, nor is a read-only one.

use std::{
    fs,
    hash::{DefaultHasher, Hash, Hasher},
    io,
    path::{Path, PathBuf},
};

use thiserror::Error;

use crate::model::text_file;

/// The configuration's text, and the file that it is stored in.
#[derive(Clone, Debug, Default)]
pub struct ConfigFile {
    path: Option<PathBuf>,
    text: String,
}

/// Why the file is not replaced.
#[derive(Debug, Error)]
pub enum ConfigFileError {
    #[error(
        "{} has changed since this server read it and is not overwritten: restart the server to use the file, or undo the \
         change",
        .0.display()
    )]
    Changed(PathBuf),
    #[error("{} is read-only: change its permissions, or edit it by hand and restart the server", .0.display())]
    ReadOnly(PathBuf),
    #[error("cannot write {}: {source}; edit it by hand and restart the server", .path.display())]
    Write { path: PathBuf, source: io::Error },
}

impl ConfigFile {
    /// Without a path, the text is not stored.
    pub fn new(path: Option<PathBuf>, text: String) -> Self {
        Self { path, text }
    }

    pub fn text(&self) -> &str {
        &self.text
    }

    pub fn path(&self) -> Option<&Path> {
        self.path.as_deref()
    }

    pub fn version(&self) -> String {
        let mut hasher = DefaultHasher::new();
        self.text.hash(&mut hasher);
        format!("{:016x}", hasher.finish())
    }

    /// Where changes are saved, as the second half of a sentence.
    pub fn kept(&self) -> String {
        match &self.path {
            Some(path) => format!("saved in {}", path.display()),
            None => {
                "not saved, since the server was started without a configuration file".to_owned()
            }
        }
    }

    pub fn replace(&mut self, text: String) -> Result<(), ConfigFileError> {
        if let Some(path) = &self.path {
            let failed = |source| ConfigFileError::Write { path: path.clone(), source };
            if fs::read(path).map_err(failed)? != self.text.as_bytes() {
                return Err(ConfigFileError::Changed(path.clone()));
            }
            if fs::metadata(path).map_err(failed)?.permissions().readonly() {
                return Err(ConfigFileError::ReadOnly(path.clone()));
            }
            text_file::replace(path, &text).map_err(failed)?;
        }
        self.text = text;
        Ok(())
    }
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
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[test]
    fn a_file_that_was_changed_locked_or_removed_is_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let (path, mut file) = file(folder.path());
        fs::write(&path, "a = 1 # mine\n").unwrap();
        let error = file.replace("a = 2\n".to_owned()).unwrap_err().to_string();
        assert!(error.contains("lab.toml has changed since this server read it"), "{error}");
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
        assert_eq!(file.text(), "a = 1\n");
    }

    #[test]
    fn without_a_file_changes_stay_in_memory() {
        let mut file = ConfigFile::default();
        file.replace("a = 2\n".to_owned()).unwrap();
        assert_eq!(file.text(), "a = 2\n");
        assert!(file.kept().starts_with("not saved"), "{}", file.kept());
    }
}
