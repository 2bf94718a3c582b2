//! The calibration file: where cameras stand and what their lenses are, as the server found out.
//!
//! TOML that the server writes and people may read. Beside each camera's result stands what the
//! configuration said of it then: once the configuration says otherwise (somebody moved the camera and
//! measured anew, or calibrated the lens), the configuration is right and the old result is left out with a
//! warning. A new version replaces the file in one step; the one before is kept beside it.

mod stored;

use std::{
    ffi::OsString,
    fs,
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::model::config::Config;
pub use stored::{StoredCamera, StoredConfig};

/// A calibration file longer than this is certainly another file.
const MAX_BYTES: u64 = 4 << 20;
const HEADER: &str = "# Where cameras stand, as `roundel calibrate arena` and the running server found out.\n\
                      # Written by the server; delete it to go back to the configuration's poses.\n\n";

/// Why a calibration file cannot be used.
#[derive(Debug, Error)]
pub enum CalibrationFileError {
    /// It cannot be read.
    #[error("cannot read calibration file {}: {source}; mend that, or delete the file to go back to the configuration's poses", .path.display())]
    Read { path: PathBuf, source: io::Error },
    /// It cannot be written.
    #[error("cannot write calibration file {}: {source}; the server goes on with the new poses and forgets them when it ends", .path.display())]
    Write { path: PathBuf, source: io::Error },
    #[error("{}: {message}; the server writes this file: undo what was changed in it, or delete it to go back to the configuration's poses", .path.display())]
    Content {
        path: PathBuf,
        /// What was expected and what was found, where.
        message: String,
    },
}

/// All cameras' results of one version.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationFile {
    /// Grows by one with each change.
    pub version: u64,
    /// When, Unix time, seconds.
    pub made_unix_s: i64,
    #[serde(default, rename = "camera")]
    pub cameras: Vec<StoredCamera>,
}

impl CalibrationFile {
    /// Reads a file; `None` if there is none yet.
    pub fn load(path: &Path) -> Result<Option<Self>, CalibrationFileError> {
        let text = match read(path) {
            Ok(text) => text,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(source) => {
                return Err(CalibrationFileError::Read { path: path.to_owned(), source });
            }
        };
        let wrong = |message| CalibrationFileError::Content { path: path.to_owned(), message };
        let file: Self =
            toml::from_str(&text).map_err(|error| wrong(error.to_string().trim().to_owned()))?;
        for camera in &file.cameras {
            camera.read().map_err(|why| wrong(format!("camera \"{}\": {why}", camera.name)))?;
        }
        Ok(Some(file))
    }

    /// Writes it in place of what is there, which is kept under the name of its version.
    pub fn save(&self, path: &Path) -> Result<(), CalibrationFileError> {
        self.write(path)
            .map_err(|source| CalibrationFileError::Write { path: path.to_owned(), source })
    }

    fn write(&self, path: &Path) -> io::Result<()> {
        let text = toml::to_string(self).map_err(io::Error::other)?;
        let fresh = beside(path, "new");
        let mut file = fs::File::create(&fresh)?;
        file.write_all(HEADER.as_bytes())?;
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        if path.exists() {
            fs::copy(path, beside(path, "previous"))?;
        }
        fs::rename(&fresh, path)
    }

    /// A camera's newest result.
    pub fn set(&mut self, camera: StoredCamera) {
        match self.cameras.iter_mut().find(|it| it.name == camera.name) {
            Some(before) => *before = camera,
            None => self.cameras.push(camera),
        }
    }

    /// Has the configuration's cameras stand where they were found to stand. What was found under another
    /// configuration is dropped; a sentence says so for each.
    pub fn merge_into(&mut self, config: &mut Config) -> Vec<String> {
        let mut dropped = Vec::new();
        self.cameras.retain(|stored| match stored.merge_into(config) {
            Ok(()) => true,
            Err(why) => {
                dropped.push(why);
                false
            }
        });
        dropped
    }
}

fn read(path: &Path) -> io::Result<String> {
    let size = fs::metadata(path)?.len();
    if size > MAX_BYTES {
        let message = format!("expected at most {MAX_BYTES} bytes, found {size}");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, message));
    }
    fs::read_to_string(path)
}

/// `lab.calibration.toml` → `lab.calibration.previous.toml`.
fn beside(path: &Path, word: &str) -> PathBuf {
    let mut name = path.file_stem().map_or_else(OsString::new, OsString::from);
    name.push(".");
    name.push(word);
    name.push(".toml");
    path.with_file_name(name)
}

#[cfg(test)]
mod tests {
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
    fn what_is_kept_comes_back_at_the_next_start() {
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
        // The version before is kept.
        let previous = beside(&path, "previous");
        assert_eq!(CalibrationFile::load(&previous).unwrap().unwrap().version, 1);
    }

    #[test]
    fn what_the_configuration_says_anew_counts() {
        let before = config();
        let file = CalibrationFile {
            version: 1,
            made_unix_s: 5,
            cameras: vec![stored(&before, 0, 1.0), stored(&before, 1, 2.0)],
        };
        let mut moved = before.clone();
        moved.cameras[0].pose = PoseConfig::Known(placement(3.0).world_from_camera);
        let mut changed = file.clone();
        let told = changed.merge_into(&mut moved);
        assert_eq!(told.len(), 1);
        assert!(told[0].contains("camera north") && told[0].contains("another pose"), "{told:?}");
        assert_eq!(moved.cameras[0].pose, PoseConfig::Known(placement(3.0).world_from_camera));
        assert_eq!(changed.cameras.len(), 1, "what is dropped is not kept any longer");

        let mut renamed = before.clone();
        renamed.cameras[1].name = "east".into();
        let told = file.clone().merge_into(&mut renamed);
        assert!(told[0].contains("camera south") && told[0].contains("no camera"), "{told:?}");

        let mut lens = before.clone();
        let it = lens.cameras[1].calibration.intrinsics().clone();
        lens.cameras[1].calibration = Camera::new(Intrinsics { cx_px: 600.0, ..it }).unwrap();
        let told = file.clone().merge_into(&mut lens);
        assert!(told[0].contains("another lens"), "{told:?}");
    }

    #[test]
    fn a_damaged_file_says_where() {
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
