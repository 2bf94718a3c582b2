//! What cannot be printed, and what is printed before there is anything but paper.

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
fn what_cannot_be_printed_or_would_change_nothing_is_named() {
    let folder = tempfile::tempdir().unwrap();
    for (arguments, expected) in [
        ("a.pdf", "expected --marker OUTER_MM[:INNER_MM]"),
        ("--marker -5:2 a.pdf", "expected a diameter above 0 mm"),
        ("--marker 50:5 a.pdf", "another would not be found"),
        ("--marker 160:96:95 a.pdf", "at most 0.9 of its longer one"),
        ("--marker 50:20 a.gif", "expected a name that ends in .pdf, .svg or .png"),
        ("--marker 50:20 --dpi 600 a.pdf", "--dpi counts for .png alone"),
        ("--marker 50:20 --dpi -5 a.png", "expected 36 to 2400 dots an inch, found -5"),
        ("--marker 50:20 --format json a.pdf", "--list"),
        ("--board 7x5 --copies 3 a.pdf", "cannot be used with '--copies <COPIES>'"),
        ("--board 7x5 --kind robot a.pdf", "cannot be used with '--kind <NAME>'"),
        ("--code 8:2 --list a.pdf", "cannot be used with"),
        ("--code 8:2 --list --ids 3,17", "no code 17 of 8 bits"),
    ] {
        let arguments: Vec<&str> = arguments.split(' ').collect();
        let output = print(&arguments, folder.path());
        let told = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && told.contains(expected), "{arguments:?}: {told}");
        assert!(fs::read_dir(folder.path()).unwrap().next().is_none(), "{arguments:?}");
    }
}

#[test]
fn an_installation_is_printed_before_its_cameras_have_lenses() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("lab.toml"), super::EXAMPLE).unwrap();
    let output = print(&["--config", "lab.toml", "lab.pdf"], folder.path());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(fs::read(folder.path().join("lab.pdf")).unwrap().starts_with(b"%PDF"));
    // What it carries is checked all the same.
    let broken = super::EXAMPLE.replacen("outer_mm = 160.0", "outer_mm = -160.0", 1);
    assert_ne!(broken, super::EXAMPLE);
    fs::write(folder.path().join("lab.toml"), broken).unwrap();
    let output = print(&["--config", "lab.toml", "lab.pdf"], folder.path());
    assert!(String::from_utf8_lossy(&output.stderr).contains("outer_mm"));
}

#[test]
fn nobody_need_read_what_is_told() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [&["--marker", "50:20", "a.pdf"][..], &["--code", "8:2", "--list"]] {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let mut command = Command::new(env!("CARGO_BIN_EXE_roundel"));
        command.arg("print").args(arguments).current_dir(folder.path()).stdout(writer);
        let output = command.output().unwrap();
        let told = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && told.is_empty(), "{arguments:?}: {told}");
    }
    assert!(folder.path().join("a.pdf").exists());
}

#[test]
fn a_list_has_the_codes_that_were_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let json = ["--code", "8:2", "--list", "--ids", "2-3", "--format", "json"];
    let listed: serde_json::Value =
        serde_json::from_slice(&print(&json, folder.path()).stdout).unwrap();
    let numbers: Vec<u64> =
        listed.as_array().unwrap().iter().map(|code| code["number"].as_u64().unwrap()).collect();
    assert_eq!(numbers, [2, 3]);
}
