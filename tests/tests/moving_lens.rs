//! Lens calibration from coded roundels on robots that move before a camera of a calibrated arena: recorded by a
//! server, and processed by the real binary.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use roundel_core::world::FrameObservations;
use roundel_server::model::camera_file;
use roundel_tests::{
    arena::Arena,
    optics::Pinhole,
    process::roundel,
    recorded::record,
    scenario::swarm::PRECISE,
    sensor::{Sensing, Stream},
};
use serde_json::Value;

const SENSING: Sensing = Sensing { shows_rims: true, ..PRECISE };
/// Relative error of the configured focal length.
const LENS_ERROR: f64 = 0.01;

fn calibrate(file: &Path, camera: &str, more: &[&str]) -> Output {
    let file = file.to_string_lossy();
    let mut command = Command::new(roundel().unwrap());
    command.args(["calibrate", "lens", "--from-recording", &file, "--camera", camera]);
    command.args(more).output().unwrap()
}

fn error(file: &Path, camera: &str) -> String {
    let output = calibrate(file, camera, &[]);
    assert!(!output.status.success());
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Detections of a worker whose configured focal length is too long.
fn with_longer_lens(mut frame: FrameObservations) -> FrameObservations {
    for pose in frame.detections.iter_mut().filter_map(|it| it.pose.as_mut()) {
        pose.position_m.z *= 1.0 + LENS_ERROR;
    }
    frame
}

#[test]
fn a_wrong_lens_is_corrected_from_robots_that_other_cameras_saw() {
    let arena = Arena::r4(3);
    let folder = tempfile::tempdir().unwrap();
    let (index, truth) = (1, arena.sites[1].optics);
    let wrong_lens =
        Pinhole { focal_px: truth.focal_px.map(|it| it * (1.0 + LENS_ERROR)), ..truth };
    let frames = Stream::new(&arena, SENSING, 15.0)
        .map(|frame| if frame.camera.0 == index { with_longer_lens(frame) } else { frame });
    let recorded = record(&arena, frames, folder.path(), &[(index as usize, wrong_lens)]).unwrap();
    let yaml = folder.path().join("found.yaml");
    let more = ["--format", "json", "--output", &yaml.to_string_lossy()];
    let output = calibrate(&recorded.file, &arena.sites[1].name, &more);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    println!("{report:#}");
    let number = |key: &str, part: &str| report["parameters"][key][part].as_f64().unwrap();
    let expected = [
        ("fx", truth.focal_px[0], 1e-3 * truth.focal_px[0]),
        ("fy", truth.focal_px[1], 1e-3 * truth.focal_px[1]),
        ("cx", truth.center_px[0], 1.0),
        ("cy", truth.center_px[1], 1.0),
    ];
    for (key, truth, max) in expected {
        let (value, deviation) = (number(key, "value"), number(key, "deviation"));
        assert!((value - truth).abs() < max, "{key}: {value} ± {deviation} for {truth}");
        assert!((value - truth).abs() < 4.0 * deviation, "{key}: {value} ± {deviation}, {truth}");
    }
    assert_eq!(report["distortion_model"], truth.distortion.name());
    let place = arena.sites[1].world_from_camera.translation.vector;
    for (axis, expected) in place.iter().enumerate() {
        let found = report["position_m"][axis].as_f64().unwrap();
        assert!((found - expected).abs() < 0.005, "{axis}: {found} for {expected}");
    }
    let text = fs::read_to_string(&yaml).unwrap();
    assert!(text.contains("parameter_covariance"), "{text}");
    let written = camera_file::load(&yaml).unwrap();
    assert_eq!(written.intrinsics().fx_px, number("fx", "value"));

    let error = error(&recorded.file, "corner 9");
    assert!(
        error.contains(&arena.sites[3].name) && error.contains("found \"corner 9\""),
        "{error}"
    );
}

/// A recording of the sightings that `sees` keeps.
fn recorded(arena: &Arena, folder: &Path, sees: impl Fn(u32, u64, bool) -> bool) -> PathBuf {
    fs::create_dir(folder).unwrap();
    let frames = Stream::new(arena, SENSING, 1.5).map(|mut frame| {
        let (camera, number) = (frame.camera.0, frame.frame);
        frame.detections.retain(|detection| {
            let is_first = detection.ring.code.is_some_and(|it| it.code.number == 1);
            sees(camera, number, is_first)
        });
        frame
    });
    record(arena, frames, folder, &[]).unwrap().file
}

#[test]
fn insufficient_recordings_are_rejected_with_a_reason() {
    let arena = Arena::r4(3);
    let folder = tempfile::tempdir().unwrap();
    // The first camera sees nothing, the second one robot that no other camera sees, and the third what the fourth sees.
    let sees = |camera, _, is_first| match camera {
        0 => false,
        1 => is_first,
        _ => !is_first,
    };
    let file = recorded(&arena, &folder.path().join("apart"), sees);
    let name = |index: usize| arena.sites[index].name.as_str();
    let nothing = error(&file, name(0));
    assert!(nothing.contains("saw no coded roundel"), "{nothing}");
    let alone = error(&file, name(1));
    assert!(alone.contains("no other camera saw one of them"), "{alone}");
    // A single camera does not know the size of its prints.
    let uncertain = error(&file, name(2));
    assert!(uncertain.contains("the other cameras know their positions only to"), "{uncertain}");
    assert!(uncertain.contains("`tolerance = 0`"), "{uncertain}");

    let sees = |camera, number, _| camera != 2 || number <= 5;
    let file = recorded(&arena, &folder.path().join("together"), sees);
    let little = error(&file, name(2));
    assert!(little.contains("expected at least 100 sightings in 20 places"), "{little}");
    assert!(little.contains("record for longer"), "{little}");

    let other = folder.path().join("other.mcap");
    fs::write(&other, b"\x89PNG").unwrap();
    assert!(error(&other, name(0)).contains("found a PNG image"));
}
