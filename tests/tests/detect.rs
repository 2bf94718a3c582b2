//! `roundel detect` on rendered pictures with ground truth, and on existing prints (WhyCode's, of
//! `../shared/data/whycode`; skipped where they are missing).

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use roundel_server::capture::image_file;
use roundel_tests::{
    export::{camera_yaml, write_png},
    optics::{Distortion, Pinhole},
    process::roundel,
    random::Random,
    render::{Canvas, Image, Imaging, MovingPrint, Print, Renderer},
    shared_data::shared_data,
};
use serde_json::Value;

const OUTER_M: f64 = 0.16;
const INNER_M: f64 = 0.064;

/// A folder with a camera file and a picture of a roundel of 60 px among three dark squares, and the roundel's pose.
fn pictured() -> (tempfile::TempDir, Isometry3<f64>) {
    let camera =
        Pinhole::centered(640, 480, 600.0, Distortion::PlumbBob([-0.1, 0.02, 0.0, 0.0, 0.0]));
    let facing = UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0);
    let tilt = UnitQuaternion::from_euler_angles(0.0, 0.6, 0.2);
    let pose =
        Isometry3::from_parts(Translation3::new(0.2, -0.1, 600.0 * OUTER_M / 60.0), facing * tilt);
    let renderer = Renderer::new(camera, Imaging::default());
    let mut background = Canvas::flat(camera.width, camera.height, 140.0);
    for (left, top) in [(60, 300), (120, 360), (400, 380)] {
        for v in top..top + 40 {
            background.grey[v * 640 + left..v * 640 + left + 40].fill(30.0);
        }
    }
    let print = Print::plain(OUTER_M, INNER_M, 0.2);
    let motion = move |_: f64| pose;
    let moving = [MovingPrint { print: &print, motion: &motion }];
    let image = renderer.frame(&background, &moving, &mut Random::new(7, 0));
    let folder = tempfile::tempdir().unwrap();
    write_png(&folder.path().join("picture.png"), &image).unwrap();
    fs::write(folder.path().join("camera.yaml"), camera_yaml("camera", &camera)).unwrap();
    (folder, pose)
}

/// Runs `roundel detect` in a folder, and returns its lines.
fn detect(folder: &Path, arguments: &[&str]) -> Vec<Value> {
    let mut command = Command::new(roundel().unwrap());
    let output = command.arg("detect").args(arguments).current_dir(folder).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {stderr}");
    let lines = String::from_utf8(output.stdout).unwrap();
    lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn vector(value: &Value) -> Vector3<f64> {
    let numbers: Vec<f64> =
        value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect();
    Vector3::from_column_slice(&numbers)
}

/// Red, green and blue of an annotated PNG.
fn drawn(path: PathBuf) -> Vec<[u8; 3]> {
    let decoder = png::Decoder::new(std::io::BufReader::new(fs::File::open(path).unwrap()));
    let mut reader = decoder.read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    pixels.chunks_exact(3).map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect()
}

#[test]
fn both_modes_locate_a_roundel() {
    let (folder, truth) = pictured();
    for mode in ["precise", "fast"] {
        let print = ["--camera", "camera.yaml", "--marker", "160:64", "--mode", mode];
        let lines = detect(folder.path(), &[&print[..], &["picture.png"]].concat());
        let found = lines[0]["detections"].as_array().unwrap();
        assert_eq!(found.len(), 1, "{mode}: {}", lines[0]);
        let roundel = &found[0];
        let error_m = (vector(&roundel["position_m"]) - truth.translation.vector).norm();
        assert!(error_m < 3e-3, "{mode}: {error_m} m");
        let normals = [vector(&roundel["normal"]), vector(&roundel["other_normal"])];
        let angle = normals.map(|normal| normal.angle(&(truth.rotation * Vector3::z())));
        assert!(angle[0].min(angle[1]) < 0.02, "{mode}: {angle:?}");
        assert_eq!(roundel["covariance"].as_array().unwrap().len(), 21);
        // A plain roundel has neither an id nor a yaw.
        assert_eq!((&roundel["id"], &roundel["yaw_rad"]), (&Value::Null, &Value::Null));
    }
}

#[test]
fn white_rings_are_found_on_request() {
    let (folder, truth) = pictured();
    let black = image_file::load(&folder.path().join("picture.png")).unwrap();
    let pixels = black.pixels.iter().map(|level| 255 - level).collect();
    let white = Image { width: black.width, height: black.height, pixels };
    write_png(&folder.path().join("white.png"), &white).unwrap();
    for print in ["160", "160:64"] {
        for (polarity, found) in [("white-ring", [0, 1]), ("black-ring", [1, 0])] {
            let options = ["--camera", "camera.yaml", "--marker", print, "--polarity", polarity];
            let files = ["picture.png", "white.png"];
            let lines = detect(folder.path(), &[&options[..], &files].concat());
            let roundels =
                [0, 1].map(|index: usize| lines[index]["detections"].as_array().unwrap());
            assert_eq!(roundels.map(Vec::len), found, "{print} {polarity}: {lines:?}");
            let roundel = roundels.into_iter().flatten().next().unwrap();
            let error_m = (vector(&roundel["position_m"]) - truth.translation.vector).norm();
            // Without the inner diameter, the ratio is measured, with an error of a fraction of a pixel.
            assert!(error_m < 0.02, "{print} {polarity}: {error_m} m");
        }
    }
}

#[test]
fn rejected_candidates_are_reported_and_drawn() {
    let (folder, _) = pictured();
    let plain = detect(folder.path(), &["--draw", "plain", "picture.png"]);
    assert_eq!((&plain[0]["rejects"], &plain[0]["rejected"]), (&Value::Null, &Value::Null));
    let explained = detect(folder.path(), &["--explain", "--draw", "explained", "picture.png"]);
    let explained = &explained[0];
    let counts = explained["rejects"].as_object().unwrap();
    let total: u64 = counts.values().map(|count| count.as_u64().unwrap()).sum();
    let rejected = explained["rejected"].as_array().unwrap();
    assert!(total > 0 && rejected.len() as u64 <= total, "{explained}");
    for each in rejected {
        assert!(counts.contains_key(each["reason"].as_str().unwrap()), "{each}");
        let places = ["center_px", "half_box_px"].map(|key| each[key].as_array().unwrap().len());
        assert_eq!(places, [2, 2]);
    }
    let [plain, explained] =
        ["plain", "explained"].map(|it| drawn(folder.path().join(it).join("picture.png")));
    assert_ne!(plain, explained);
    // Detections are drawn in both, in the same green.
    let green = |pixels: &[[u8; 3]]| pixels.iter().filter(|p| **p == [40, 230, 80]).count();
    assert!(green(&plain) > 100, "{}", green(&plain));
}

/// A quarter turn of the paper, counter-clockwise in the image.
fn turned(image: &Image) -> Image {
    let (width, height) = (image.height, image.width);
    let pixels = (0..height).flat_map(|v| (0..width).map(move |u| (u, v)));
    let pixels = pixels.map(|(u, v)| image.pixels[u * image.width + (image.width - 1 - v)]);
    Image { width, height, pixels: pixels.collect() }
}

/// Direction of the print's right in the camera frame.
fn right_of(roundel: &Value) -> Vector3<f64> {
    let yaw =
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roundel["yaw_rad"].as_f64().unwrap());
    let upright = UnitQuaternion::rotation_between(&Vector3::z(), &vector(&roundel["normal"]));
    upright.unwrap() * yaw * Vector3::x()
}

#[test]
fn prints_are_read_with_their_number_and_yaw() {
    let Some(prints) = shared_data("prints_are_read_with_their_number_and_yaw", "whycode") else {
        return;
    };
    let camera = Pinhole::centered(600, 600, 800.0, Distortion::PlumbBob([0.0; 5]));
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("camera.yaml"), camera_yaml("camera", &camera)).unwrap();
    for (bits, code) in [("bits5", "5"), ("bits7", "7:2")] {
        for number in 1..=if bits == "bits5" { 6 } else { 9 } {
            let print = image_file::load(&prints.join(bits).join(format!("{number}.png"))).unwrap();
            let upright =
                Image { width: print.width, height: print.height, pixels: print.pixels.clone() };
            for (image, right) in [(turned(&upright), -Vector3::y()), (upright, Vector3::x())] {
                write_png(&folder.path().join("print.png"), &image).unwrap();
                let options = ["--camera", "camera.yaml", "--marker", "122", "--code", code];
                let lines = detect(folder.path(), &[&options[..], &["print.png"]].concat());
                let found = lines[0]["detections"].as_array().unwrap();
                assert_eq!(found.len(), 1, "{bits} {number}: {}", lines[0]);
                assert_eq!(found[0]["id"], number, "{bits}");
                let off = right_of(&found[0]).angle(&right);
                assert!(off < 0.02, "{bits} {number}: turned by {off} rad");
            }
        }
    }
}
