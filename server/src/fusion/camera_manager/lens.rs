//! Lens files that are found while the server runs: written beside the configuration, and taken into use.

use std::{
    fs::{self, OpenOptions},
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use roundel_proto::v1::CameraSetup;

use super::{CameraManager, CameraManagerError};

/// Lens files of one name beside a configuration, at most.
const MOST_FILES: usize = 1000;

impl CameraManager {
    /// Writes a lens file beside the configuration, under a name that no file has yet. Says which.
    pub fn save_lens(&self, name: &str, text: &str) -> Result<String, CameraManagerError> {
        let folder = {
            let state = self.lock_editable()?;
            let path = state.config.file.path().ok_or(CameraManagerError::NoFolder)?;
            path.parent().unwrap_or(Path::new("")).to_owned()
        };
        let stem: String = name
            .chars()
            .map(|it| if it.is_alphanumeric() || it == '-' || it == '_' { it } else { '-' })
            .take(100)
            .collect();
        for number in 1..=MOST_FILES {
            let file = format!("{stem}.lens-{number}.yaml");
            match write_new(&folder.join(&file), text) {
                Ok(()) => return Ok(file),
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(source) => {
                    return Err(CameraManagerError::Lens { path: folder.join(file), source });
                }
            }
        }
        let path: PathBuf = folder.join(format!("{stem}.lens-{MOST_FILES}.yaml"));
        Err(CameraManagerError::Lens { path, source: io::ErrorKind::AlreadyExists.into() })
    }

    /// The same, and has the camera use it from its next frame on. Says the file, and where the configuration is kept.
    pub fn use_lens(
        &self,
        camera: &str,
        text: &str,
    ) -> Result<(String, String), CameraManagerError> {
        let file = self.save_lens(camera, text)?;
        let target = CameraSetup { calibration: file.clone(), ..CameraSetup::default() };
        match self.change(camera, &target, &["calibration"]) {
            Ok((_, kept)) => Ok((file, kept)),
            Err(error) => {
                // A file that nobody uses is of no use; that it could not be removed changes nothing about the error.
                if let Some(folder) = self.lock().config.file.path().and_then(Path::parent) {
                    let _ = fs::remove_file(folder.join(file));
                }
                Err(error)
            }
        }
    }
}

fn write_new(path: &Path, text: &str) -> io::Result<()> {
    let mut file = OpenOptions::new().write(true).create_new(true).open(path)?;
    let written = file.write_all(text.as_bytes()).and_then(|()| file.sync_all());
    written.inspect_err(|_| {
        let _ = fs::remove_file(path);
    })
}
