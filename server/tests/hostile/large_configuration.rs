//! The largest configurations that the API accepts, each with as much work for its size as possible.

use std::{fmt::Write as _, time::Instant};

use roundel_server::model::config::Config;

/// Below the limit of a request.
const BYTES: usize = 240_000;
/// A machine under load may need a while; what this rejects took minutes.
const LIMIT_S: f64 = 30.0;

const HEAD: &str = "[[roundel]]\nname = \"r\"\nouter_mm = 160\ninner_mm = 64\n\
                    [[roundel]]\nname = \"c\"\nouter_mm = 160\ncode = { bits = 16, min_distance = 1 }\n\
                    [[camera]]\nname = \"z\"\nsource = \"sim:\"\n";

/// A configuration of [`BYTES`], which repeats this text.
fn repeated(head: &str, part: impl Fn(usize) -> String) -> String {
    let mut text = head.to_owned();
    for number in 1.. {
        let part = part(number);
        if text.len() + part.len() > BYTES {
            break;
        }
        text.push_str(&part);
    }
    text
}

#[test]
fn large_configurations_are_checked_in_linear_time() {
    let folder = tempfile::tempdir().unwrap();
    let lens = roundel_server::model::camera_file::write("c", &crate::setup::rig::lens(300.0));
    // As long as a camera file may be.
    let padding = "# comment\n".repeat((1_000_000 - lens.len()) / 10);
    std::fs::write(folder.path().join("c.yaml"), padding + &lens).unwrap();
    let mut one_line = "mask = [".to_owned();
    while one_line.len() < BYTES - 300 {
        one_line.push_str("[[0,0],[1,0],\"\"],");
    }
    let mut polygons = "mask = [".to_owned();
    while polygons.len() < BYTES - 300 {
        polygons.push_str("[[1279,719],[1280,719],[1279,720]],");
    }
    let mut slivers = "mask = [".to_owned();
    while slivers.len() < BYTES - 300 {
        slivers.push_str("[[0.1,0],[0.2,0],[0.1,719]],");
    }
    let shapes = [
        ("unknown keys", repeated(HEAD, |n| format!("k{n}=1\n"))),
        ("unknown root keys", repeated("", |n| format!("k{n}=1\n"))),
        ("errors of syntax", repeated(HEAD, |_| "=\n".to_owned())),
        ("errors in one line", repeated(HEAD, |_| "= ".to_owned())),
        ("nested lists", format!("{HEAD}mask = {}", "[".repeat(BYTES - 300))),
        ("broken cameras", repeated(HEAD, |_| "[[camera]]\n".to_owned())),
        (
            "simulated cameras",
            repeated(HEAD, |n| format!("[[camera]]\nname=\"{n}\"\nsource=\"sim:\"\n")),
        ),
        (
            "cameras of many worlds",
            repeated(HEAD, |n| format!("[[camera]]\nname=\"{n}\"\nsource=\"sim:?seed={n}\"\n")),
        ),
        (
            "cameras of many robots",
            repeated(HEAD, |n| {
                format!("[[camera]]\nname=\"{n}\"\nsource=\"sim:?robots=99999999999\"\n")
            }),
        ),
        (
            "cameras with a large file",
            repeated(HEAD, |n| {
                format!(
                    "[[camera]]\nname=\"{n}\"\nsource=\"push:\"\ncalibration=\"c.yaml\"\npose=\"unknown\"\n"
                )
            }),
        ),
        (
            "mounted cameras",
            repeated(HEAD, |n| {
                format!(
                    "[[object]]\nname=\"o{n}\"\n[[camera]]\nname=\"{n}\"\nsource=\"sim:\"\npose={{object=\"p{n}\",position_m=[0,0,0],orientation_xyzw=[0,0,0,1]}}\n"
                )
            }),
        ),
        (
            "objects with codes",
            repeated(HEAD, |n| format!("[[object]]\nname=\"{n}\"\nroundel=\"c\"\ncode={n}\n")),
        ),
        (
            "objects with the same name",
            repeated(HEAD, |n| format!("[[object]]\nname=\"o\"\nroundel=\"c\"\ncode={n}\n")),
        ),
        (
            "objects of unknown kinds",
            repeated(HEAD, |n| format!("[[object]]\nname=\"{n}\"\nroundel=\"k{n}\"\n")),
        ),
        (
            "kinds",
            repeated(HEAD, |n| format!("[[roundel]]\nname=\"k{n}\"\nouter_mm=160\ninner_mm=64\n")),
        ),
        (
            "coded kinds",
            repeated(HEAD, |n| {
                format!(
                    "[[roundel]]\nname=\"k{n}\"\nouter_mm=160\ncode={{bits=16,min_distance=8}}\n"
                )
            }),
        ),
        (
            "references",
            repeated(HEAD, |n| format!("[[reference]]\nroundel=\"r\"\nposition_m=[{n},0,0]\n")),
        ),
        (
            "references in one place",
            repeated(HEAD, |_| "[[reference]]\nroundel=\"r\"\nposition_m=[0,0,0]\n".to_owned()),
        ),
        ("wrong polygons in one line", format!("{HEAD}{one_line}]\n")),
        ("small polygons far from the origin", format!("{HEAD}{polygons}]\n")),
        ("polygons without a pixel", format!("{HEAD}{slivers}]\n")),
        (
            "cameras with a mask",
            repeated(HEAD, |n| {
                format!(
                    "[[camera]]\nname=\"{n}\"\nsource=\"sim:\"\nmask=[[[0,0],[1280,0],[1280,718.5],[0,718.5]]]\n"
                )
            }),
        ),
        (
            "origins",
            repeated(&format!("{HEAD}[server]\nallow_origins=["), |n| format!("\"x{n}\",")),
        ),
    ];
    let mut report = String::new();
    let mut slowest_s: f64 = 0.0;
    for (what, text) in shapes {
        let begun = Instant::now();
        let parsed = Config::parse(&text, folder.path());
        let seconds = begun.elapsed().as_secs_f64();
        slowest_s = slowest_s.max(seconds);
        let problems = parsed.err().unwrap_or_default();
        let bytes: usize = problems.iter().map(|it| format!("{it:?}").len()).sum();
        let _ = writeln!(
            report,
            "{seconds:7.2} s  {:5} problems of {bytes} bytes  {what}",
            problems.len()
        );
        eprintln!("{seconds:7.2} s  {:5} problems of {bytes} bytes  {what}", problems.len());
        assert!(bytes < 10_000_000, "{report}");
    }
    assert!(slowest_s < LIMIT_S, "{report}");
}
