//! Wrong arguments, wrong images, and a port in use.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use super::{EXAMPLE, lab};

pub(super) fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_roundel")).args(arguments).output().unwrap()
}

pub(super) fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn serve_rejects_wrong_configurations() {
    let folder = lab();
    let path = folder.path().join("lab.toml");
    let file = path.to_str().unwrap();
    for (content, expected) in [
        (None, "cannot read the configuration"),
        (
            Some(b"name = \"\xFF\"".as_slice()),
            "expected UTF-8 text, found other bytes after byte 8",
        ),
        (Some(b"nane = \"lab\""), "lab.toml:1:1: unknown key `nane`; did you mean `name`?"),
    ] {
        match content {
            Some(content) => fs::write(&path, content).unwrap(),
            None => assert!(!path.exists()),
        }
        let output = run(&["serve", "--config", file]);
        assert_eq!(output.status.code(), Some(1));
        assert!(stderr(&output).contains(expected), "no {expected} in {}", stderr(&output));
        assert!(output.stdout.is_empty());
    }
}

#[test]
fn nodes_and_servers_reject_each_others_configurations() {
    let folder = lab();
    let path = folder.path().join("node.toml");
    let file = path.to_str().unwrap();
    let cameras = "[[roundel]]\nname = \"robot\"\nouter_mm = 160\ninner_mm = 64\n\
                   [[camera]]\nname = \"north\"\nsource = \"images:frames\"\ncalibration = \"north.yaml\"\n";
    fs::write(&path, cameras).unwrap();
    let output = run(&["node", "--config", file]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("expected a server: add --server"), "{}", stderr(&output));
    let output = run(&["node", "--config", file, "--server", "ftp://10.0.0.1"]);
    assert!(
        stderr(&output).contains("ftp:// is neither http:// nor https://"),
        "{}",
        stderr(&output)
    );
    let output = run(&["serve", "--config", file]);
    assert!(stderr(&output).contains("missing key `pose` in [[camera]]"), "{}", stderr(&output));

    // A node needs no poses; a server rejects the keys of a node.
    fs::write(&path, format!("[node]\nserver = \"http://10.0.0.1:7670\"\n{cameras}")).unwrap();
    let output = run(&["serve", "--config", file]);
    assert_eq!(output.status.code(), Some(1));
    let text = stderr(&output);
    assert!(
        text.contains("describes a node ([node])") && text.contains("roundel node --config"),
        "{text}"
    );
    fs::write(&path, format!("[node]\nsever = \"http://10.0.0.1:7670\"\n{cameras}")).unwrap();
    let output = run(&["node", "--config", file]);
    assert!(stderr(&output).contains("did you mean `server`?"), "{}", stderr(&output));
}

#[test]
fn a_port_in_use_is_named() {
    let folder = lab();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let path = folder.path().join("lab.toml");
    fs::write(&path, EXAMPLE.replacen("127.0.0.1:7670", &address, 1)).unwrap();
    let output = run(&["serve", "--config", path.to_str().unwrap()]);
    let text = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains(&format!("cannot listen on {address}")), "{text}");
    assert!(text.contains("stop it, or choose another `listen`"), "{text}");
}

/// Writes a PNG of one grey level.
pub(super) fn png(path: &Path, width: u32, height: u32) {
    let mut encoder = png::Encoder::new(fs::File::create(path).unwrap(), width, height);
    encoder.set_color(png::ColorType::Grayscale);
    let pixels = vec![180; (width * height) as usize];
    encoder.write_header().unwrap().write_image_data(&pixels).unwrap();
}

#[test]
fn detect_reports_each_bad_image_and_continues() {
    let folder = lab();
    let at = |name: &str| -> PathBuf { folder.path().join(name) };
    png(&at("good.png"), 640, 480);
    png(&at("large.png"), 641, 480);
    fs::write(at("empty.png"), "").unwrap();
    fs::write(at("text.jpg"), "not an image at all").unwrap();
    let good = fs::read(at("good.png")).unwrap();
    fs::write(at("cut.png"), &good[..good.len() - 30]).unwrap();
    fs::write(at("cut.jpg"), [0xFF, 0xD8, 0xFF, 0xE0, 0x00, 0x10]).unwrap();
    let images = [
        "good.png",
        "gone.png",
        "empty.png",
        "text.jpg",
        "cut.png",
        "cut.jpg",
        "large.png",
        "good.png",
    ]
    .map(|name| at(name).to_str().unwrap().to_owned());
    let mut arguments = vec!["detect", "--format", "json"];
    let camera = at("north.yaml");
    arguments.extend(["--camera", camera.to_str().unwrap()]);
    arguments.extend(images.iter().map(String::as_str));
    let output = run(&arguments);
    let text = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    for expected in [
        "gone.png: cannot read the image",
        "empty.png: expected an image, found an empty file",
        "text.jpg: expected a PNG, JPEG, PGM or BMP image, found text",
        "cut.png: broken or truncated PNG image",
        "cut.jpg: broken or truncated JPEG image",
        "large.png: expected an image of 640 x 480 pixels as the camera file says, found 641 x 480",
    ] {
        assert!(text.contains(expected), "no {expected} in\n{text}");
    }
    let stdout = String::from_utf8(output.stdout).unwrap();
    let lines: Vec<serde_json::Value> =
        stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let named: Vec<&str> = lines.iter().map(|line| line["image"].as_str().unwrap()).collect();
    assert_eq!(named, images, "expected one line for each image, in order");
    for (line, image) in lines.iter().zip(&images) {
        assert_eq!(line["error"].is_null(), image.ends_with("good.png"), "{line}");
    }
    assert_eq!(lines[0]["width"], 640);
}

#[test]
fn detect_names_wrong_arguments() {
    let folder = lab();
    let image = folder.path().join("good.png");
    png(&image, 64, 48);
    let image = image.to_str().unwrap();
    for (arguments, code, expected) in [
        (vec!["detect"], 2, "IMAGE"),
        (vec!["detect", "--marker", "64:160", image], 2, "the inner diameter must be below"),
        (vec!["detect", "--format", "xml", image], 2, "possible values: table, json"),
        (
            vec!["detect", "--camera", "/no/such.yaml", image],
            1,
            "cannot read camera file /no/such.yaml",
        ),
        (vec!["detect", "--camera", image, image], 1, "cannot read camera file"),
        (vec!["detekt", image], 2, "detect"),
    ] {
        let output = run(&arguments);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(expected), "{arguments:?}: {}", stderr(&output));
    }
}
