//! The calibration file: poses and lenses found by calibration, for the next start.
//!
//! TOML that the server writes and people may read. Each result is stored with the configuration it belongs to. If the
//! configuration of a camera has changed since, it takes precedence, and the result is dropped with a warning. The
//! previous version is kept beside the file.

mod stored;

use std::{
    ffi::OsString,
    io,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::model::{config::Config, regular_file, text_file};
pub use stored::{StoredCamera, StoredConfig};

/// A longer file is not a calibration file.
const MAX_BYTES: u64 = 4 << 20;
const HEADER: &str = "# Poses and lenses of the cameras from `roundel calibrate arena` and the running server.\n\
                      # Written by the server; delete it to use the configuration's poses.\n\n";

#[derive(Debug, Error)]
pub enum CalibrationFileError {
    #[error("cannot read calibration file {}: {source}; correct that, or delete the file to use the configuration's poses", .path.display())]
    Read { path: PathBuf, source: io::Error },
    #[error("cannot write calibration file {}: {source}; the new poses last until the server ends", .path.display())]
    Write { path: PathBuf, source: io::Error },
    #[error("{}: {message}; the server writes this file: undo the change, or delete it to use the configuration's poses", .path.display())]
    Content { path: PathBuf, message: String },
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationFile {
    /// Increases by one with each calibration.
    pub version: u64,
    /// Unix time.
    pub made_unix_s: i64,
    #[serde(default, rename = "camera")]
    pub cameras: Vec<StoredCamera>,
}

impl CalibrationFile {
    /// Returns `None` if the file does not exist.
    pub fn load(path: &Path) -> Result<Option<Self>, CalibrationFileError> {
        let path_buf = || path.to_owned();
        let text = match regular_file::read_text(path, MAX_BYTES) {
            Ok(text) => text,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(source) => return Err(CalibrationFileError::Read { path: path_buf(), source }),
        };
        let wrong = |message| CalibrationFileError::Content { path: path_buf(), message };
        let file: Self =
            toml::from_str(&text).map_err(|error| wrong(error.to_string().trim().to_owned()))?;
        for camera in &file.cameras {
            camera.read().map_err(|why| wrong(format!("camera \"{}\": {why}", camera.name)))?;
        }
        Ok(Some(file))
    }

    /// Replaces the file; the version before is kept beside it.
    pub fn save(&self, path: &Path) -> Result<(), CalibrationFileError> {
        let write = || {
            let text = toml::to_string(self).map_err(io::Error::other)?;
            if path.exists() {
                text_file::replace(&previous(path), &regular_file::read_text(path, MAX_BYTES)?)?;
            }
            text_file::replace(path, &format!("{HEADER}{text}"))
        };
        write().map_err(|source| CalibrationFileError::Write { path: path.to_owned(), source })
    }

    /// Adds or replaces the result of a camera.
    pub fn set(&mut self, camera: StoredCamera) {
        match self.cameras.iter_mut().find(|it| it.name == camera.name) {
            Some(before) => *before = camera,
            None => self.cameras.push(camera),
        }
    }

    /// Sets the calibrated poses and lenses in the configuration. Results of another configuration are dropped, with a
    /// message for each.
    pub fn merge_into(&mut self, config: &mut Config) -> Vec<String> {
        let mut dropped = Vec::new();
        self.cameras
            .retain(|stored| stored.merge_into(config).map_err(|why| dropped.push(why)).is_ok());
        dropped
    }
}

/// `lab.calibration.toml` → `lab.calibration.previous.toml`.
fn previous(path: &Path) -> PathBuf {
    let mut name = path.file_stem().map_or_else(OsString::new, OsString::from);
    name.push(".previous.toml");
    path.with_file_name(name)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use nalgebra::{UnitQuaternion, Vector3};
    use roundel_core::{
        camera::{Camera, Intrinsics},
        rigid::{Covariance6, Rigid},
        world::CameraPlacement,
    };

    use super::*;
    use crate::model::config::PoseConfig;

    const CONFIG: &str = r#"
        [[roundel]]
        name = "robot"
        outer_mm = 160
        inner_mm = 64
        [[camera]]
        name = "north"
        source = "sim:?preset=r4_lite&camera=0"
        [[camera]]
        name = "south"
        source = "sim:?preset=r4_lite&camera=1"
    "#;

    fn config() -> Config {
        Config::parse(CONFIG, Path::new("")).unwrap()
    }

    fn placement(x: f64) -> CameraPlacement {
        let turn = UnitQuaternion::from_euler_angles(3.0, 0.1, 0.2);
        CameraPlacement {
            world_from_camera: Rigid::from_parts(Vector3::new(x, 2.0, 5.0).into(), turn),
            covariance: Covariance6::from_fn(|i, j| 1e-7 * (1 + i.max(j)) as f64),
        }
    }

    fn stored(config: &Config, index: usize, x: f64) -> StoredCamera {
        let camera = &config.cameras[index];
        let it = camera.calibration.intrinsics().clone();
        let lens = Camera::new(Intrinsics { fx_px: it.fx_px + 0.5, ..it }).unwrap();
        StoredCamera::new(camera.name.clone(), &placement(x), &lens, StoredConfig::of(camera))
    }

    #[test]
    fn a_saved_calibration_is_loaded_and_merged() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lab.calibration.toml");
        assert_eq!(CalibrationFile::load(&path).unwrap(), None);
        let before = config();
        let mut file = CalibrationFile { version: 1, made_unix_s: 5, cameras: Vec::new() };
        file.set(stored(&before, 1, 1.0));
        file.save(&path).unwrap();
        file.version = 2;
        file.set(stored(&before, 1, 1.25));
        file.save(&path).unwrap();

        let mut read = CalibrationFile::load(&path).unwrap().unwrap();
        assert_eq!(read, file);
        let mut config = before.clone();
        assert_eq!(read.merge_into(&mut config), Vec::<String>::new());
        assert_eq!(config.cameras[0].pose, before.cameras[0].pose);
        let PoseConfig::Calibrated(found) = &config.cameras[1].pose else { panic!("not merged") };
        let difference = found.world_from_camera.inverse() * placement(1.25).world_from_camera;
        assert!(difference.translation.vector.norm() < 1e-12 && difference.rotation.angle() < 1e-7);
        assert_eq!(found.covariance, placement(1.25).covariance);
        let focal_px = |config: &Config| config.cameras[1].calibration.intrinsics().fx_px;
        assert!((focal_px(&config) - focal_px(&before) - 0.5).abs() < 1e-12);
        let previous = CalibrationFile::load(&previous(&path)).unwrap().unwrap();
        assert_eq!(previous.version, 1);
    }

    #[test]
    fn a_changed_configuration_takes_precedence() {
        let before = config();
        let file = CalibrationFile {
            version: 1,
            made_unix_s: 5,
            cameras: vec![stored(&before, 0, 1.0), stored(&before, 1, 2.0)],
        };
        let mut moved = before.clone();
        moved.cameras[0].pose = PoseConfig::Known(placement(3.0).world_from_camera);
        let mut changed = file.clone();
        let dropped = changed.merge_into(&mut moved);
        assert_eq!(dropped.len(), 1);
        assert!(
            dropped[0].contains("camera north") && dropped[0].contains("another pose"),
            "{dropped:?}"
        );
        assert_eq!(moved.cameras[0].pose, PoseConfig::Known(placement(3.0).world_from_camera));
        assert_eq!(changed.cameras.len(), 1);

        let mut renamed = before.clone();
        renamed.cameras[1].name = "east".into();
        let dropped = file.clone().merge_into(&mut renamed);
        assert!(
            dropped[0].contains("camera south") && dropped[0].contains("no camera"),
            "{dropped:?}"
        );

        let mut lens = before.clone();
        let it = lens.cameras[1].calibration.intrinsics().clone();
        lens.cameras[1].calibration = Camera::new(Intrinsics { cx_px: 600.0, ..it }).unwrap();
        let dropped = file.clone().merge_into(&mut lens);
        assert!(dropped[0].contains("another lens"), "{dropped:?}");
    }

    #[test]
    fn errors_of_a_damaged_file_name_the_place() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lab.calibration.toml");
        let file = CalibrationFile {
            version: 1,
            made_unix_s: 5,
            cameras: vec![stored(&config(), 0, 1.0)],
        };
        file.save(&path).unwrap();
        let text = fs::read_to_string(&path).unwrap();
        let damaged = [
            (text.replace("version = 1", "version = \"one\""), "version"),
            (text.replace("plumb_bob", "plum_bob"), "plum_bob"),
            (text.replace("position_m = [", "position_m = [7.0, "), "position_m"),
            (text.replace("orientation_xyzw = [", "orientation_xyzw = [ 1"), "orientation_xyzw"),
            (text.replace("covariance = [", "covariance = [1.0, "), "21 finite numbers"),
            (text[..text.len() / 2].to_owned(), "lab.calibration.toml"),
        ];
        for (text, expected) in damaged {
            fs::write(&path, &text).unwrap();
            let error = CalibrationFile::load(&path).expect_err(expected).to_string();
            assert!(error.contains(expected) && error.contains("delete"), "{expected}: {error}");
        }
        fs::remove_file(&path).unwrap();
        fs::create_dir(&path).unwrap();
        let error = CalibrationFile::load(&path).unwrap_err().to_string();
        assert!(error.contains("cannot read calibration file"), "{error}");
    }
}
