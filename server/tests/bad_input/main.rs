//! Broken, missing and mistyped input: each ends in an error that names file, line or field, and the
//! remedy. The tables are what people get wrong: `configuration` in the file, `command` on the command line.

use std::{fs, path::Path};

use roundel_core::camera::{Camera, Intrinsics, Lens};
use roundel_server::{camera_file, config::Config};

mod command;
mod configuration;

const EXAMPLE: &str = include_str!("../../../deploy/roundel.example.toml");

/// A folder with the example's camera files.
fn lab() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["north", "south"] {
        fs::write(folder.path().join(format!("{name}.yaml")), camera_yaml()).unwrap();
    }
    folder
}

fn camera_yaml() -> String {
    let camera = Camera::new(Intrinsics {
        width: 640,
        height: 480,
        fx_px: 600.0,
        fy_px: 610.0,
        cx_px: 319.5,
        cy_px: 239.5,
        lens: Lens::PlumbBob([-0.1, 0.01, 0.0, 0.0, 0.0]),
    });
    camera_file::write("north", &camera.unwrap())
}

/// Everything that is wrong with a configuration, as one text.
fn problems(text: &str, folder: &Path) -> String {
    let path = folder.join("lab.toml");
    fs::write(&path, text).unwrap();
    Config::load(&path).expect_err("a wrong configuration was taken").to_string()
}
