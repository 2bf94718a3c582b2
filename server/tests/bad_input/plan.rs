//! Wrong arguments of `roundel plan`, and correct reports beside them.

use std::{
    fs,
    process::{Command, Output},
};

use super::lab;

fn plan(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_roundel"));
    command.arg("plan").args(arguments).output().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

const PINHOLE: [&str; 4] = ["--resolution", "640x480", "--fov", "60"];

#[test]
fn names_what_cannot_be_planned() {
    let folder = lab();
    let text = folder.path().join("text.toml");
    fs::write(&text, "not a configuration").unwrap();
    let text = text.to_str().unwrap();
    let lab = folder.path().join("lab.toml");
    fs::write(&lab, super::EXAMPLE).unwrap();
    let lab = lab.to_str().unwrap();
    for (arguments, code, expected) in [
        (vec![], 1, "expected a camera: add --camera FILE"),
        (vec!["--camera", "/no/such.yaml"], 1, "cannot read camera file /no/such.yaml"),
        (vec!["--camera", text], 1, "not a camera_info YAML"),
        (vec!["--resolution", "640x480"], 2, "--fov"),
        (vec!["--resolution", "0x480", "--fov", "60"], 1, "width: expected 1 to 16384 pixels"),
        (vec!["--resolution", "640", "--fov", "60"], 2, "expected COLUMNSxROWS"),
        (vec!["--resolution", "640x480", "--fov", "180"], 1, "--fov: expected 1 to 150 degrees"),
        (vec!["--resolution", "8x8", "--fov", "60"], 1, "is found at no distance"),
        (vec!["--map", "map.svg"], 1, "--map: expected cameras with positions"),
        (vec!["--config", text], 1, "text.toml:1"),
        (vec!["--config", lab, "--code", "8:2"], 1, "--code: expected --marker as well"),
        (vec!["--config", "/no/such.toml"], 1, "cannot read the configuration"),
        (vec!["--config", lab, "--views", "2"], 2, "cannot be used with '--views <VIEWS>'"),
        (vec!["--config", lab, "--mount", "2"], 2, "cannot be used with '--mount <M[:M]>'"),
    ] {
        let output = plan(&arguments);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(expected), "{arguments:?}: {}", stderr(&output));
        assert!(output.stdout.is_empty());
    }
}

#[test]
fn names_what_is_wrong_with_a_pinhole_camera_and_its_roundel() {
    for (arguments, code, expected) in [
        (vec!["--marker", "0"], 2, "above 0 mm"),
        (vec!["--marker", "160:10"], 1, "expected an inner diameter of 0.2 to 0.8"),
        (vec!["--code", "40"], 2, "codes of 2 to 16 bits"),
        (vec!["--polarity", "grey"], 2, "black-ring"),
        (vec!["--tilt", "80"], 1, "tilt: expected 0 to 75 degrees, found 80"),
        (vec!["--noise=-1"], 1, "noise: expected 0 to 60 grey levels, found -1"),
        (vec!["--blur", "0"], 1, "blur: expected 0.1 to 5 px"),
        (vec!["--white", "50"], 1, "white less black: expected at least 20"),
        (vec!["--distance", "500"], 1, "is detected from"),
        (vec!["--distance", "0"], 1, "--distance: expected metres above 0"),
        (vec!["--lost", "2"], 1, "--lost: expected a share of 0 to 1"),
        (vec!["--lost", "NaN"], 1, "--lost: expected a share of 0 to 1"),
        (vec!["--speed=-1"], 1, "--speed: expected 0 to 1000 m/s, found -1"),
        (vec!["--speed", "NaN"], 1, "--speed: expected 0 to 1000 m/s, found NaN"),
        (vec!["--speed", "fast"], 2, "--speed"),
        (vec!["--rate", "0"], 1, "--rate: expected 0.01 to 100000 frames per second, found 0"),
        (vec!["--rate", "inf"], 1, "--rate: expected 0.01 to 100000 frames per second, found inf"),
        (vec!["--speed", "900", "--rate", "0.1"], 1, "more than the width of the picture"),
        (vec!["--precision", "1"], 1, "add --distance M"),
        (vec!["--precision", "0.00001", "--distance", "5"], 1, "--precision: expected 0.0001"),
        (vec!["--precision", "0.001", "--distance", "5"], 1, "the best of this camera is"),
        (vec!["--arena", "10"], 2, "expected WIDTHxDEPTH in metres"),
        (vec!["--arena", "4x3"], 1, "--arena: expected the mounting height of the cameras"),
        (vec!["--arena", "4x3", "--mount", "5:3"], 2, "LOWEST:HIGHEST"),
        (vec!["--arena", "4x3", "--mount", "0.1"], 1, "whose height is 0.3 m (--height)"),
        (vec!["--arena", "4x3", "--mount", "-1"], 1, "--mount: expected cameras at least"),
        (vec!["--arena", "800x800", "--mount", "4"], 1, "or plan parts of the arena"),
        (
            vec!["--arena", "4x3", "--mount", "4", "--map", "a.gif"],
            1,
            "--map a.gif: expected a name",
        ),
        (vec!["--height", "NaN"], 1, "--height: expected -1000 to 1000 m, found NaN"),
        (vec!["--distance", "-1"], 1, "--distance: expected metres above 0, found -1"),
        (vec!["--marker", "-5:2"], 2, "expected a diameter above 0 mm"),
        (vec!["--arena", "4x3", "--mount", "50"], 1, "hang 49.70 to 49.70 m above it"),
        (
            vec!["--arena", "4x3", "--mount", "4", "--code", "8:2"],
            1,
            "is found and its code read from",
        ),
    ] {
        let all: Vec<&str> = PINHOLE.iter().chain(&arguments).copied().collect();
        let output = plan(&all);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(expected), "{arguments:?}: {}", stderr(&output));
        assert!(output.stdout.is_empty());
    }
}

#[test]
fn plans_a_camera_and_an_arena() {
    let folder = lab();
    let camera = folder.path().join("north.yaml");
    let camera = camera.to_str().unwrap();
    let report = plan(&["--camera", camera, "--distance", "3", "--format", "json"]);
    assert!(report.status.success(), "{}", stderr(&report));
    let report: serde_json::Value = serde_json::from_slice(&report.stdout).unwrap();
    // 600 px focal length, 160 mm, at 3 m.
    assert!((report["minor_px"].as_f64().unwrap() - 32.0).abs() < 0.6, "{report}");
    let depth_m = report["depth_deviation_m"].as_f64().unwrap();
    assert!((2e-4..8e-4).contains(&depth_m), "{report}");
    let frame_s = |name: &str| report[name].as_f64().unwrap();
    assert!(0.0 < frame_s("frame_s") && frame_s("frame_s") <= frame_s("frame_p95_s"), "{report}");
    assert_eq!(report["roundels_timed"], 10, "{report}");
    assert!(report["times"].as_str().unwrap().starts_with("measured now"), "{report}");
    assert_eq!(report["lens_uncertainty_known"], false);

    let map = folder.path().join("grid.svg");
    let map = map.to_str().unwrap();
    let arguments = ["--arena", "4x3", "--mount", "3:4", "--map", map];
    let found = plan(&[&["--camera", camera][..], &arguments].concat());
    assert!(found.status.success(), "{}", stderr(&found));
    let text = String::from_utf8(found.stdout).unwrap();
    assert!(text.contains("cameras: ") && text.contains("% seen"), "{text}");
    assert!(fs::read_to_string(map).unwrap().contains("</svg>"));

    let lab = folder.path().join("lab.toml");
    fs::write(&lab, super::EXAMPLE).unwrap();
    let map = folder.path().join("lab.png");
    let (lab, map) = (lab.to_str().unwrap(), map.to_str().unwrap());
    let seen = plan(&["--config", lab, "--map", map, "--step", "0.5"]);
    assert!(seen.status.success(), "{}", stderr(&seen));
    let text = String::from_utf8(seen.stdout).unwrap();
    assert!(text.contains("north") && text.contains("south        left out: its pose"), "{text}");
    let north = text.lines().find(|line| line.contains("north")).unwrap();
    assert!(north.ends_with("% of the map"), "{text}");
    assert!(fs::read(map).unwrap().starts_with(b"\x89PNG"));
    let unknown = plan(&["--config", lab, "--kind", "plate"]);
    assert!(stderr(&unknown).contains("no roundel \"plate\""), "{}", stderr(&unknown));

    // The lens uncertainty in the camera file increases the predicted error.
    let median_m = || {
        let report = plan(&["--config", lab, "--step", "0.5", "--format", "json"]);
        let report: serde_json::Value = serde_json::from_slice(&report.stdout).unwrap();
        report["summary"]["median_m"].as_f64().unwrap()
    };
    let exact_m = median_m();
    let variances: Vec<f64> = (0..16).map(|at| if at % 5 == 0 { 25.0 } else { 0.0 }).collect();
    let doubt = format!(
        "parameter_names: [fx, fy, cx, cy]\nparameter_covariance:\n  rows: 4\n  cols: 4\n  data: {variances:?}\n"
    );
    fs::write(camera, fs::read_to_string(camera).unwrap() + &doubt).unwrap();
    let doubtful_m = median_m();
    assert!(doubtful_m > 2.0 * exact_m, "{exact_m} {doubtful_m}");
}

#[test]
fn the_range_of_a_coded_roundel_is_limited_by_its_code() {
    let json = |arguments: &[&str]| {
        let report = plan(&[&PINHOLE[..], &["--format", "json"], arguments].concat());
        assert!(report.status.success(), "{}", stderr(&report));
        serde_json::from_slice::<serde_json::Value>(&report.stdout).unwrap()
    };
    let number = |report: &serde_json::Value, name: &str| report[name].as_f64().unwrap();
    let marker = ["--marker", "160:96"];
    let (plain, coded) = (json(&marker), json(&["--marker", "160", "--code", "8:2"]));
    let (plain_m, coded_m) = (number(&plain, "most_distance_m"), number(&coded, "most_distance_m"));
    // 554 px focal length, 160 mm; the code needs 36 px.
    assert!((coded_m - 2.46).abs() < 0.05 && coded_m < 0.5 * plain_m, "{plain_m} {coded_m}");
    let ring_m = number(&coded["code_unread"], "most_distance_m");
    assert!((ring_m / plain_m - 1.0).abs() < 1e-3, "{ring_m} {plain_m}");
    assert_eq!((&coded["code_is_read"], &plain["code_is_read"]), (&true.into(), &().into()));
    // The report states that the ring is found beyond the range of the code.
    let beyond = ["--marker", "160", "--code", "8:2", "--distance", "4"];
    assert_eq!(json(&beyond)["code_is_read"], false);
    let table = String::from_utf8(plan(&[&PINHOLE[..], &beyond[..]].concat()).stdout).unwrap();
    assert!(table.contains("maximum distance, code read, on axis"), "{table}");
    assert!(table.contains("codes of 8 bits") && table.contains("not read"), "{table}");

    // One high camera finds the rings in the whole arena, but not their codes. The report names the assumed size.
    let arena = ["--arena", "4x3", "--mount", "2:6"];
    let cameras = |report: &serde_json::Value| report["stations"].as_array().unwrap().len();
    let (plain, coded) = (json(&arena), json(&[&arena[..], &["--code", "8:2"]].concat()));
    assert!(cameras(&plain) == 1 && cameras(&coded) >= 4, "{plain} {coded}");
    assert_eq!((number(&coded, "outer_m"), &coded["size_is_assumed"]), (0.16, &true.into()));
    assert_eq!(coded["code"]["bits"], 8);
    assert_eq!(json(&[&arena[..], &marker].concat())["size_is_assumed"], false);
    let table = String::from_utf8(plan(&[&PINHOLE[..], &arena[..]].concat()).stdout).unwrap();
    assert!(table.contains("160.0 mm, disc 64.0 mm (default size"), "{table}");
}

#[test]
fn searches_the_roundel_for_an_arena_and_a_precision() {
    let arena = ["--arena", "4x3", "--mount", "2:4", "--precision", "2", "--format", "json"];
    let json = |arguments: &[&str]| {
        let report = plan(&[&PINHOLE[..], &arena, arguments].concat());
        assert!(report.status.success(), "{}", stderr(&report));
        serde_json::from_slice::<serde_json::Value>(&report.stdout).unwrap()
    };
    let found = json(&[]);
    assert_eq!(found["outer_was_searched"], true);
    assert_eq!(found["size_is_assumed"], false);
    let outer_mm = found["outer_m"].as_f64().unwrap() * 1e3;
    let cameras = |report: &serde_json::Value| report["stations"].as_array().unwrap().len();
    // The roundel found needs this number of cameras, and one that is a tenth smaller needs more.
    let same = json(&["--marker", &format!("{outer_mm}:{}", 0.4 * outer_mm)]);
    assert_eq!(cameras(&same), cameras(&found), "{outer_mm}");
    let less_mm = 0.9 * outer_mm;
    let marker = format!("{less_mm}:{}", 0.4 * less_mm);
    let less = plan(&[&PINHOLE[..], &arena, &["--marker", &marker]].concat());
    let less: Option<serde_json::Value> = serde_json::from_slice(&less.stdout).ok();
    assert!(less.is_none_or(|less| cameras(&less) > cameras(&found)), "{outer_mm}");
    // The report contains the time per frame and how it was measured.
    let longest_s = found["longest_frame_s"].as_f64().unwrap();
    assert!(0.0 < longest_s && longest_s <= found["longest_frame_p95_s"].as_f64().unwrap());
    assert!(longest_s <= found["frames_together_s"].as_f64().unwrap(), "{found}");
    let times = found["times"].as_str().unwrap();
    assert!(times.ends_with("with 10 of 10 roundels tracked"), "{times}");
    let table = plan(&[&PINHOLE[..], &arena[..6], &["--count", "24"]].concat());
    let table = String::from_utf8(table.stdout).unwrap();
    assert!(table.contains("(the size that needs the fewest cameras)"), "{table}");
    assert!(table.contains("time per frame with 24 roundels straight below"), "{table}");
}

#[test]
fn names_options_without_effect() {
    let arena = ["--arena", "2x1", "--mount", "3", "--marker", "160:64"];
    for (arguments, expected) in [
        (vec!["--tilt", "30"], "--tilt has no effect over an arena: roundels lie face up"),
        (vec!["--distance", "3"], "--distance has no effect over an arena"),
        (vec!["--show", "cameras"], "--show has no effect without --map"),
    ] {
        let report = plan(&[&PINHOLE[..], &arena, &arguments].concat());
        assert!(report.status.success(), "{}", stderr(&report));
        assert!(stderr(&report).contains(expected), "{arguments:?}: {}", stderr(&report));
    }
    let quiet = plan(&[&PINHOLE[..], &arena].concat());
    assert_eq!(stderr(&quiet), "");
    let single = plan(&[&PINHOLE[..], &["--height", "1", "--marker", "160:64"]].concat());
    assert!(
        stderr(&single).contains("--height has no effect for a single camera"),
        "{}",
        stderr(&single)
    );
    // The option is rejected before its file is read, so the file need not exist.
    let machine = ["--machine", "/no/machine.toml", "--marker", "160:64"];
    let machine = plan(&[&PINHOLE[..], &machine].concat());
    assert!(machine.status.success() && stderr(&machine).contains("--machine has no effect"));
    let reached = ["--precision", "1", "--marker", "160:64"];
    let reached = plan(&[&PINHOLE[..], &reached].concat());
    assert!(stderr(&reached).contains("--precision has no effect"), "{}", stderr(&reached));
}

#[test]
fn times_the_requested_case() {
    let json = |arguments: &[&str]| {
        let all = [&PINHOLE[..], &["--distance", "1", "--format", "json"], arguments].concat();
        let report = plan(&all);
        assert!(report.status.success(), "{}", stderr(&report));
        serde_json::from_slice::<serde_json::Value>(&report.stdout).unwrap()
    };
    let slow = ["--speed", "0.1", "--rate", "50", "--count", "5"];
    for code in [&[][..], &["--code", "8:2"], &["--polarity", "white-ring"], &["--mode", "fast"]] {
        let report = json(&[&slow[..], code].concat());
        // 640 pixels at 60° are 554 pixels per metre at 1 m.
        assert!((report["motion_px"].as_f64().unwrap() - 1.1).abs() < 0.05, "{report}");
        assert_eq!(report["roundels_timed"], 5, "{code:?}: {report}");
    }
    // 60 roundels of 88 px do not fit into the image.
    let crowded = json(&["--count", "60"]);
    assert!((5..40).contains(&crowded["roundels_timed"].as_u64().unwrap()), "{crowded}");
}

#[test]
fn times_typical_cases_on_this_machine() {
    let report = plan(&["--measure", "--format", "json"]);
    assert!(report.status.success(), "{}", stderr(&report));
    let report: serde_json::Value = serde_json::from_slice(&report.stdout).unwrap();
    let rows = report["measured"].as_array().unwrap();
    assert_eq!(rows.len(), 20);
    for row in rows {
        assert!([10, 24, 100].contains(&row["roundels"].as_u64().unwrap()), "{row}");
        assert!(0.0 < row["measured_s"].as_f64().unwrap(), "{row}");
    }
}
