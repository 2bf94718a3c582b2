//! `roundel calibrate lens` over rendered pictures of the board: a camera file that loads and is right, whatever else lies
//! in the folder.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use roundel_server::camera_file;
use roundel_tests::{
    board::{board_print, camera, imaging, pictures, poses},
    export::write_png,
    normal::Random,
    process::roundel,
};
use serde_json::Value;

const VIEWS: usize = 24;

/// Runs it in a folder.
fn calibrate(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(roundel().unwrap());
    command.args(["calibrate", "lens"]).args(arguments).current_dir(folder).output().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A folder with a folder of so many views.
fn pictured(count: usize) -> tempfile::TempDir {
    let truth = camera();
    let folder = tempfile::tempdir().unwrap();
    let views = folder.path().join("views");
    fs::create_dir(&views).unwrap();
    let poses = poses(&truth, count, &mut Random::new(17, 0));
    for (view, image) in pictures(&truth, imaging(), &board_print(), &poses, 17).iter().enumerate()
    {
        write_png(&views.join(format!("view-{view:02}.png")), image).unwrap();
    }
    folder
}

#[test]
fn a_folder_with_broken_pictures_among_them_gives_a_file_that_is_right() {
    let folder = pictured(VIEWS);
    let at = |name: &str| folder.path().join(name);
    let good = fs::read(at("views/view-00.png")).unwrap();
    fs::write(at("views/cut.png"), &good[..good.len() / 2]).unwrap();
    // Before all others in order: what most have counts, not what comes first.
    let small: Vec<u8> = b"P5\n64 48\n255\n".iter().copied().chain([255; 64 * 48]).collect();
    fs::write(at("views/a.pgm"), small).unwrap();
    fs::write(at("north.yaml"), "of before").unwrap();

    let output = calibrate(folder.path(), &["--format", "json", "-o", "north.yaml", "views"]);
    let text = stderr(&output);
    assert!(output.status.success(), "{text}");
    for expected in [
        "cut.png: broken or truncated PNG image",
        "a.pgm: expected 1280 x 720 pixels as most have, found 64 x 48",
        "wrote north.yaml; what was there is kept as north.previous.yaml",
    ] {
        assert!(text.contains(expected), "no {expected} in\n{text}");
    }
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&report["files_left_out"], &report["frames"]), (&2.into(), &VIEWS.into()));

    let truth = camera();
    let (found, doubt) = camera_file::load_with_doubt(&at("north.yaml")).unwrap();
    let intrinsics = found.intrinsics();
    println!("{intrinsics:?}");
    for (value, truth) in
        [(intrinsics.fx_px, truth.focal_px[0]), (intrinsics.fy_px, truth.focal_px[1])]
    {
        assert!((value / truth - 1.0).abs() < 5e-4, "{value} for {truth}");
    }
    let off_px =
        (intrinsics.cx_px - truth.center_px[0]).hypot(intrinsics.cy_px - truth.center_px[1]);
    assert!(off_px < 0.5 && (found.width(), found.height()) == (1280, 720), "{off_px} px");
    assert!(doubt.is_some(), "it says how well it is known");
    assert_eq!(fs::read_to_string(at("north.previous.yaml")).unwrap(), "of before");
}

#[test]
fn a_pattern_of_photographs_is_a_folder_and_one_with_a_rate_is_a_stream() {
    let folder = pictured(8);
    let report = |source: &str| {
        let output = calibrate(folder.path(), &["--format", "json", source]);
        assert!(output.status.success(), "{source}: {}", stderr(&output));
        serde_json::from_slice::<Value>(&output.stdout).unwrap()
    };
    let of_pattern = report("images:views/*.png");
    assert_eq!(of_pattern, report("views"));
    assert_eq!(of_pattern["frames"], 8);
    // No view follows one that is like it.
    let output = calibrate(folder.path(), &["images:views/*.png?fps=5"]);
    let text = stderr(&output);
    assert!(!output.status.success() && output.stdout.is_empty(), "{text}");
    assert!(text.contains("0 views taken") && text.contains("in motion"), "{text}");
    assert!(text.contains("are given as a folder or as files"), "{text}");
}
