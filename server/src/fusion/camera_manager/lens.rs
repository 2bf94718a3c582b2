//! Writes lens files beside the configuration and applies them.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use roundel_proto::v1::CameraSetup;

use super::{CameraManager, CameraManagerError};
use crate::model::text_file;

/// Maximum number of lens files with the same stem.
const MAX_FILES: usize = 1000;

impl CameraManager {
    /// Writes a lens file with a new name beside the configuration, and returns that name.
    pub fn save_lens(&self, name: &str, text: &str) -> Result<String, CameraManagerError> {
        let folder = {
            let config = self.editable_config()?;
            let path = config.file.path().ok_or(CameraManagerError::NoFolder)?;
            path.parent().unwrap_or(Path::new("")).to_owned()
        };
        let stem: String = name
            .chars()
            .map(|it| if it.is_alphanumeric() || it == '-' || it == '_' { it } else { '-' })
            .take(100)
            .collect();
        for number in 1..=MAX_FILES {
            let file = format!("{stem}.lens-{number}.yaml");
            match text_file::create(&folder.join(&file), text) {
                Ok(()) => return Ok(file),
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(source) => {
                    return Err(CameraManagerError::Lens { path: folder.join(file), source });
                }
            }
        }
        let path: PathBuf = folder.join(format!("{stem}.lens-{MAX_FILES}.yaml"));
        Err(CameraManagerError::Lens { path, source: io::ErrorKind::AlreadyExists.into() })
    }

    /// Writes a lens file and applies it. Returns its name, and where the configuration is stored.
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
                if let Some(folder) = self.config().file.path().and_then(Path::parent) {
                    let _ = fs::remove_file(folder.join(file));
                }
                Err(error)
            }
        }
    }
}
