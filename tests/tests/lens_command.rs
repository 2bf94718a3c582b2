//! `roundel calibrate lens` on rendered pictures of the board: a camera file that loads and is right, whatever other
//! files the folder contains.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};
use roundel_server::model::camera_file;
use roundel_tests::{
    board::{board_print, camera, imaging, pictures, poses},
    export::write_png,
    optics::Pinhole,
    process::roundel,
    random::Random,
    render::{Image, Imaging},
};
use serde_json::Value;

const VIEWS: usize = 24;

/// Runs the command in a folder.
fn calibrate(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(roundel().unwrap());
    command.args(["calibrate", "lens"]).args(arguments).current_dir(folder).output().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A folder with a folder of views.
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
fn a_folder_with_broken_pictures_gives_a_correct_file() {
    let folder = pictured(VIEWS);
    let at = |name: &str| folder.path().join(name);
    let good = fs::read(at("views/view-00.png")).unwrap();
    fs::write(at("views/cut.png"), &good[..good.len() / 2]).unwrap();
    // First in order: the size of most pictures counts, not that of the first.
    let small: Vec<u8> = b"P5\n64 48\n255\n".iter().copied().chain([255; 64 * 48]).collect();
    fs::write(at("views/a.pgm"), small).unwrap();
    fs::write(at("north.yaml"), "of before").unwrap();

    let output = calibrate(folder.path(), &["--format", "json", "-o", "north.yaml", "views"]);
    let text = stderr(&output);
    assert!(output.status.success(), "{text}");
    for expected in [
        "cut.png: broken or truncated PNG image",
        "a.pgm: expected 1280 x 720 pixels as in most pictures, found 64 x 48",
        "wrote north.yaml; the previous file is kept as north.previous.yaml",
    ] {
        assert!(text.contains(expected), "no {expected} in\n{text}");
    }
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&report["files_left_out"], &report["frames"]), (&2.into(), &VIEWS.into()));

    let truth = camera();
    let (found, doubt) = camera_file::load_with_uncertainty(&at("north.yaml")).unwrap();
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

    // The printed pitch is 36 mm.
    assert_eq!(report["width"]["warning"], Value::Null, "{report}");
    let output = calibrate(folder.path(), &["--pitch", "36.7", "--format", "json", "views"]);
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let found_mm = report["width"]["found_pitch_mm"].as_f64().unwrap();
    assert!((found_mm - 36.0).abs() < 0.05, "{report}");
    let warning = report["width"]["warning"].as_str().unwrap();
    assert!(warning.contains("mm wide, not 30.00, if their pitch is 36.70 mm"), "{warning}");
    let table = calibrate(folder.path(), &["--pitch", "36.7", "--format", "table", "views"]);
    let table = String::from_utf8(table.stdout).unwrap();
    assert!(table.contains(&format!("Warning: {warning}")), "{table}");
}

/// Half of the board beyond the picture's left edge.
fn cut_off(truth: &Pinhole) -> Isometry3<f64> {
    let faced = UnitQuaternion::from_scaled_axis(Vector3::x() * std::f64::consts::PI);
    let left = truth.ray(&Vector2::new(0.0, 0.5 * truth.height as f64)).unwrap();
    Isometry3::from_parts(Translation3::from(left * (0.3 / left.z)), faced)
}

#[test]
fn every_kind_of_bad_view_is_rejected_by_name() {
    let folder = pictured(VIEWS);
    let truth = camera();
    let views = folder.path().join("views");
    let print = board_print();
    let write = |name: &str, image: &Image| write_png(&views.join(name), image).unwrap();
    let others = poses(&truth, VIEWS + 3, &mut Random::new(17, 0)).split_off(VIEWS);
    let taken = |pose: &Isometry3<f64>, imaging: Imaging, seed: u64| {
        pictures(&truth, imaging, &print, &[*pose], seed).remove(0)
    };
    for (pose, blur_px) in others.iter().zip([2.0, 3.0, 6.0]) {
        let blurred = Imaging { blur_px, ..imaging() };
        write(&format!("x-blurred-{blur_px}.png"), &taken(pose, blurred, 31));
    }
    write("x-cut.png", &taken(&cut_off(&truth), imaging(), 32));
    // The same pose once more, with other noise.
    let first = poses(&truth, 1, &mut Random::new(17, 0));
    write("x-twin.png", &taken(&first[0], imaging(), 33));
    let (width, height) = (truth.width, truth.height);
    write("x-empty.png", &Image { width, height, pixels: vec![120; width * height] });

    let output = calibrate(folder.path(), &["--format", "json", "views"]);
    let text = stderr(&output);
    assert!(output.status.success(), "{text}");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let why = |name: &str| {
        let file = format!("views/{name}");
        let has_name = |it: &&Value| it["file"] == file.as_str();
        let found = report["left_out"].as_array().unwrap().iter().find(has_name);
        found.map(|it| it["why"].as_str().unwrap().to_owned())
    };
    for (name, expected) in [
        ("x-blurred-2.png", "blurred beside the others"),
        ("x-blurred-3.png", "blurred beside the others"),
        ("x-cut.png", "with less than half of the board, or of another one"),
        ("x-twin.png", "like views/view-00.png"),
        ("x-empty.png", "without the board"),
    ] {
        assert_eq!(why(name).as_deref(), Some(expected), "{name}: {report:#}");
        assert!(text.contains(&format!("left out: views/{name}: {expected}")), "{text}");
    }
    // With this blur some codes cannot be read; the view may be rejected earlier.
    assert!(why("x-blurred-6.png").is_some(), "{report:#}");
    // No good view is rejected, except for those that resemble another one by chance.
    for view in 0..VIEWS {
        let why = why(&format!("view-{view:02}.png"));
        assert!(why.as_ref().is_none_or(|why| why.starts_with("like ")), "{view}: {why:?}");
    }
    let used = report["views"].as_array().unwrap();
    let used = used.iter().filter(|view| view.get("rms_px").is_some()).count();
    assert!(used >= VIEWS - 4, "{used} used");
    let found_px = report["parameters"]["fx"]["value"].as_f64().unwrap();
    assert!((found_px / truth.focal_px[0] - 1.0).abs() < 5e-4, "{found_px}");
    assert_eq!(report["parameters"].get("k3"), None, "it is 0: {report:#}");

    // The text output also gives the reasons for the model.
    let output = calibrate(folder.path(), &["views"]);
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("Distortion models"), "{text}");
    let taken = text.lines().find(|line| line.ends_with("selected")).unwrap();
    assert!(taken.contains("plumb_bob (k1 k2 p1 p2)"), "{text}");
    assert!(text.lines().filter(|line| line.contains("rms") && line.contains('(')).count() >= 4);
}

#[test]
fn a_pattern_of_photographs_is_a_folder_and_one_with_a_rate_is_a_stream() {
    let folder = pictured(8);
    let report = |source: &str| {
        let output = calibrate(folder.path(), &["--format", "json", source]);
        assert!(output.status.success(), "{source}: {}", stderr(&output));
        serde_json::from_slice::<Value>(&output.stdout).unwrap()
    };
    let by_pattern = report("images:views/*.png");
    assert_eq!(by_pattern, report("views"));
    assert_eq!(by_pattern["frames"], 8);
    // Consecutive views differ.
    let output = calibrate(folder.path(), &["images:views/*.png?fps=5"]);
    let text = stderr(&output);
    assert!(!output.status.success() && output.stdout.is_empty(), "{text}");
    assert!(text.contains("0 views taken") && text.contains("in motion"), "{text}");
    assert!(text.contains("as a folder or as files"), "{text}");
}
