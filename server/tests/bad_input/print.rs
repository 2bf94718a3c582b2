//! Wrong arguments of `roundel print`, and printing without a complete configuration.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

fn print(arguments: &[&str], folder: &Path) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_roundel"));
    command.arg("print").args(arguments).current_dir(folder).output().unwrap()
}

#[test]
fn names_impossible_and_useless_options() {
    let folder = tempfile::tempdir().unwrap();
    for (arguments, expected) in [
        ("a.pdf", "expected --marker OUTER_MM[:INNER_MM]"),
        ("--marker -5:2 a.pdf", "expected a diameter above 0 mm"),
        ("--marker 50:5 a.pdf", "the detector finds no other"),
        ("--marker 160:96:95 a.pdf", "at most 0.9 of its longer one"),
        ("--marker 50:20 a.gif", "expected a name that ends in .pdf, .svg or .png"),
        ("--marker 50:20 --dpi 600 a.pdf", "--dpi applies only to .png"),
        ("--marker 50:20 --dpi -5 a.png", "expected 36 to 2400 dots per inch, found -5"),
        ("--marker 50:20 --format json a.pdf", "--list"),
        ("--board 7x5 --copies 3 a.pdf", "cannot be used with '--copies <COPIES>'"),
        ("--board 7x5 --kind robot a.pdf", "cannot be used with '--kind <NAME>'"),
        ("--code 8:2 --list a.pdf", "cannot be used with"),
        ("--code 8:2 --list --ids 3,17", "no code 17 of 8 bits"),
    ] {
        let arguments: Vec<&str> = arguments.split(' ').collect();
        let output = print(&arguments, folder.path());
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && stderr.contains(expected), "{arguments:?}: {stderr}");
        assert!(fs::read_dir(folder.path()).unwrap().next().is_none(), "{arguments:?}");
    }
}

#[test]
fn prints_a_configuration_without_camera_files() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("lab.toml"), super::EXAMPLE).unwrap();
    let output = print(&["--config", "lab.toml", "lab.pdf"], folder.path());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(fs::read(folder.path().join("lab.pdf")).unwrap().starts_with(b"%PDF"));
    // Roundels are validated nevertheless.
    let broken = super::EXAMPLE.replacen("outer_mm = 160.0", "outer_mm = -160.0", 1);
    assert_ne!(broken, super::EXAMPLE);
    fs::write(folder.path().join("lab.toml"), broken).unwrap();
    let output = print(&["--config", "lab.toml", "lab.pdf"], folder.path());
    assert!(String::from_utf8_lossy(&output.stderr).contains("outer_mm"));
}

#[test]
fn succeeds_if_standard_output_is_closed() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [&["--marker", "50:20", "a.pdf"][..], &["--code", "8:2", "--list"]] {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let mut command = Command::new(env!("CARGO_BIN_EXE_roundel"));
        command.arg("print").args(arguments).current_dir(folder.path()).stdout(writer);
        let output = command.output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && stderr.is_empty(), "{arguments:?}: {stderr}");
    }
    assert!(folder.path().join("a.pdf").exists());
}

#[test]
fn lists_the_selected_codes() {
    let folder = tempfile::tempdir().unwrap();
    let json = ["--code", "8:2", "--list", "--ids", "2-3", "--format", "json"];
    let listed: serde_json::Value =
        serde_json::from_slice(&print(&json, folder.path()).stdout).unwrap();
    let numbers: Vec<u64> =
        listed.as_array().unwrap().iter().map(|code| code["number"].as_u64().unwrap()).collect();
    assert_eq!(numbers, [2, 3]);
}
