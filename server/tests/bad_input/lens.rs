//! Wrong boards, sources and outputs of `roundel lens`.

use std::{
    fs,
    io::{Read, Write},
    net::TcpListener,
    path::Path,
    thread,
};

use jpeg_encoder::{ColorType, Encoder};

use super::command_line::{png, run, stderr};

/// The error message of a failed calibration.
fn error(arguments: &[&str]) -> String {
    let output = run(&[&["calibrate", "lens"], arguments].concat());
    assert!(!output.status.success() && output.stdout.is_empty(), "{arguments:?}");
    stderr(&output)
}

fn path_in(folder: &Path, name: &str) -> String {
    folder.join(name).to_str().unwrap().to_owned()
}

#[test]
fn rejects_impossible_boards() {
    let short = error(&["--board", "chessboard:9x6", "views"]);
    assert!(short.contains("such as chessboard:9x6:25"), "{short}");
    let plain = error(&["--board", "chess:9x6:25", "views"]);
    assert!(plain.contains("found `chess:9x6:25`; for boards of other tools"), "{plain}");
    let mixed = error(&["--board", "chessboard:9x6:25", "--pitch", "25", "views"]);
    assert!(mixed.contains("--pitch and --code apply only to boards of roundels"), "{mixed}");
    if cfg!(not(feature = "chessboard")) {
        let lacking = error(&["--board", "chessboard:9x6:25", "views"]);
        assert!(lacking.contains("--features chessboard` adds it"), "{lacking}");
    }
}

#[test]
fn an_unwritable_output_is_reported_before_the_source_is_opened() {
    let folder = tempfile::tempdir().unwrap();
    let missing = path_in(folder.path(), "no/such/x.yaml");
    // The camera does not exist either, but the output is reported first.
    let text = error(&["--output", &missing, "v4l2:/dev/no-such-camera"]);
    assert!(text.contains("there is no folder") && text.contains("create it, or name"), "{text}");
    assert!(!text.contains("no-such-camera"), "{text}");
    let text = error(&["--output", folder.path().to_str().unwrap(), "views"]);
    assert!(text.contains("is a folder: name a file in it, such as"), "{text}");
    let text = error(&["--output", &missing, "--from-recording", "no.mcap", "--camera", "north"]);
    assert!(text.contains("there is no folder"), "{text}");
    // If the output is writable, a later failure leaves no file behind.
    let output = path_in(folder.path(), "x.yaml");
    let text = error(&["--output", &output, &path_in(folder.path(), "views")]);
    assert!(text.contains("no file matches"), "{text}");
    assert!(!Path::new(&output).exists());
}

#[test]
fn accepts_video_files_as_sources() {
    let folder = tempfile::tempdir().unwrap();
    for (name, head, kind) in [
        ("run.mp4", &b"\0\0\0\x20ftypisom\0\0\x02\0"[..], "an MP4 video"),
        ("run.avi", b"RIFF\x24\0\0\0AVI LIST", "an AVI video"),
        ("run.mkv", b"\x1A\x45\xDF\xA3\x01\0\0\0\0\0\0\x1F", "a Matroska video"),
    ] {
        let file = path_in(folder.path(), name);
        fs::write(&file, head).unwrap();
        let text = error(&[&file]);
        assert!(text.contains(kind) && text.contains(&format!("`file:{file}`")), "{text}");
        let needs = text.contains("a build that has GStreamer") && text.contains("--features gst");
        assert_eq!(needs, cfg!(not(feature = "gst")), "{text}");
    }
}

#[test]
fn a_folder_without_usable_images_names_each_file() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("empty.png"), "").unwrap();
    fs::write(folder.path().join("text.jpg"), "not an image at all").unwrap();
    let text = error(&[folder.path().to_str().unwrap()]);
    for expected in [
        "empty.png: expected an image, found an empty file",
        "text.jpg: expected a PNG, JPEG, PGM or BMP image, found text",
        "error: none of the 2 files can be used",
    ] {
        assert!(text.contains(expected), "no {expected} in\n{text}");
    }
}

#[test]
fn a_board_that_is_never_visible_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    png(&folder.path().join("0.png"), 10, 8);
    for name in ["1.png", "2.png", "3.png"] {
        png(&folder.path().join(name), 320, 240);
    }
    fs::write(folder.path().join("4.png"), "").unwrap();
    let views = folder.path().to_str().unwrap();
    let text = error(&[views]);
    assert!(
        text.contains("3 pictures, 0 views taken, 3 without the board; 2 files left out"),
        "{text}"
    );
    assert!(
        text.contains("0.png: expected 320 x 240 pixels as in most pictures, found 10 x 8"),
        "{text}"
    );
    assert!(
        text.contains("is it the board of 7 x 5 roundels with codes of 9 bits (see its"),
        "{text}"
    );
    let text = error(&["--board", "5x3", "--code", "8:2", views]);
    assert!(text.contains("board of 5 x 3 roundels with codes of 8 bits, distance 2"), "{text}");
}

#[test]
fn size_applies_only_to_cameras() {
    let folder = tempfile::tempdir().unwrap();
    png(&folder.path().join("0.png"), 320, 240);
    let views = folder.path().to_str().unwrap();
    let text = error(&["--size", "1920", "v4l2:/dev/video0"]);
    assert!(text.contains("expected a size such as 1280x720"), "{text}");
    for source in [views, &format!("images:{views}/*.png?fps=30"), "sim:?preset=r4_lite"] {
        let text = error(&["--size", "320x240", source]);
        assert!(text.contains("--size applies only to cameras"), "{source}: {text}");
    }
    let text = error(&[&format!("images:{views}/*.png?fps=30"), "sim:?preset=r4_lite"]);
    assert!(text.contains("expected a single source"), "{text}");
}

#[test]
fn a_camera_with_another_size_than_requested_is_reported() {
    let mut jpeg = Vec::new();
    Encoder::new(&mut jpeg, 80).encode(&[200; 64 * 48], 64, 48, ColorType::Luma).unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let source = format!("http://{}/snapshot.jpg", listener.local_addr().unwrap());
    let camera = thread::spawn(move || {
        let (mut socket, _) = listener.accept().unwrap();
        assert!(socket.read(&mut [0; 1024]).unwrap() > 0);
        let head = format!(
            "HTTP/1.1 200 OK\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n",
            jpeg.len()
        );
        socket.write_all(&[head.as_bytes(), &jpeg].concat()).unwrap();
        // Streams until the client disconnects.
        let _ = socket.read(&mut [0; 1024]);
    });
    let text = error(&["--size", "128x96", &source]);
    assert!(text.contains("128 x 96 pixels (--size), found 64 x 48"), "{text}");
    camera.join().unwrap();
}
