//! Broken, missing and mistyped input: each ends in an error that names the file, line or field, and the remedy. The
//! tables list common mistakes: `configuration` and `wrong_values` in the file, `mounted_cameras` with cameras on
//! objects, `command_line` on the command line, `lens`, `plan` and `print` with the input of these commands.

use std::{fs, path::Path};

use roundel_core::camera::{Camera, Intrinsics, Lens};
use roundel_server::model::{camera_file, config::Config};

mod command_line;
mod configuration;
mod lens;
mod mounted_cameras;
mod plan;
mod print;
mod wrong_values;

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

/// All problems of a configuration, as one text.
fn problems(text: &str, folder: &Path) -> String {
    let path = folder.join("lab.toml");
    fs::write(&path, text).unwrap();
    Config::load(&path).expect_err("a wrong configuration was accepted").to_string()
}

/// Checks that the example with one text replaced by another is rejected, with a message that contains `expected`, and
/// that each problem names a line.
fn expect(folder: &Path, (from, to): (&str, &str), expected: &str) {
    assert!(EXAMPLE.contains(from), "the example no longer contains {from:?}");
    // Replaces the last occurrence if the first camera has the same text.
    let broken = match EXAMPLE.rfind(from) {
        Some(at) if from.starts_with("pose") => {
            format!("{}{to}{}", &EXAMPLE[..at], &EXAMPLE[at + from.len()..])
        }
        _ => EXAMPLE.replacen(from, to, 1),
    };
    let text = problems(&broken, folder);
    assert!(text.contains(expected), "{to:?} does not give \"{expected}\" but\n{text}");
    let file = folder.join("lab.toml").display().to_string();
    for line in text.lines().filter(|line| line.starts_with('/')) {
        let place = line.strip_prefix(&file).unwrap_or(line);
        let number = place.split(':').nth(1).and_then(|number| number.parse::<usize>().ok());
        assert!(number.is_some_and(|number| number > 0), "no line in {line}");
    }
}
