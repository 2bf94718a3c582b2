//! Configurations that a client sends to be checked.

use std::{fs, sync::LazyLock};

use roundel_proto::v1;
use roundel_server::model::{
    camera_file,
    config::{Config, edit},
};
use tempfile::TempDir;

use super::lab;

/// Columns of the camera of the only file outside the folders that clients may name.
const SECRET_WIDTH: usize = 48_271;

const ACTIVE: &str = r#"name = "lab"
[server]
listen = "127.0.0.1:0"
[[roundel]]
name = "robot"
outer_mm = 160.0
inner_mm = 64.0
[[camera]]
name = "north"
source = "http://user:password@127.0.0.1/stream"
calibration = "camera.yaml"
pose = { position_m = [0.0, 0.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }
"#;

struct Lab {
    folder: TempDir,
    active: Config,
}

static LAB: LazyLock<Lab> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let inside = folder.path().join("lab");
    fs::create_dir(&inside).unwrap();
    let text = camera_file::write("camera", &lab::lens());
    fs::write(inside.join("camera.yaml"), &text).unwrap();
    let secret = text.replace("image_width: 64", &format!("image_width: {SECRET_WIDTH}"));
    fs::write(folder.path().join("secret.yaml"), secret).unwrap();
    fs::write(inside.join("lab.toml"), ACTIVE).unwrap();
    let active = Config::load(&inside.join("lab.toml")).unwrap();
    Lab { folder, active }
});

/// A text names only files inside the folder, every problem lies in the text, and the API can show an accepted text.
pub fn run(data: &[u8]) {
    let Ok(text) = str::from_utf8(data) else { return };
    let Lab { folder, active } = &*LAB;
    // As `CameraManager::check` does.
    let text = edit::restored(text, active.file.text()).unwrap_or_else(|_| text.to_owned());
    match active.parse_request(&text) {
        Err(problems) => {
            assert!(!problems.is_empty());
            let lines = text.lines().count().max(1);
            let secret = SECRET_WIDTH.to_string();
            for problem in &problems {
                assert!(!problem.message.is_empty());
                assert!(
                    !problem.message.contains(&secret) || text.contains(&secret),
                    "{problem:?}"
                );
                if let Some(place) = &problem.place {
                    assert!((1..=lines + 1).contains(&place.line), "{problem:?} in {lines} lines");
                }
            }
        }
        Ok(config) => {
            for camera in &config.cameras {
                active.admit_source(&camera.address).unwrap();
                let Some(path) = &camera.calibration_file else { continue };
                let path = path.canonicalize().unwrap();
                assert!(path.starts_with(folder.path().join("lab")), "{}", path.display());
            }
            // As `GET /api/v1/configuration` shows it.
            let shown = edit::redacted(&text).unwrap();
            edit::read_all::<v1::CameraSetup>(&shown).unwrap();
            edit::read_all::<v1::ObjectSetup>(&shown).unwrap();
            let restored = edit::restored(&shown, &text).unwrap();
            let again = active.parse_request(&restored);
            let again = again.unwrap_or_else(|problems| panic!("{problems:?} in\n{restored}"));
            let addresses = |config: &Config| {
                config.cameras.iter().map(|camera| camera.address.clone()).collect::<Vec<_>>()
            };
            assert_eq!(addresses(&again), addresses(&config), "{restored}");
        }
    }
}
