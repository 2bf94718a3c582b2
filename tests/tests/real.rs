//! Detection in real pictures: a video with rims measured by hand, and pictures without roundels.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use roundel_core::{
    ellipse::Ellipse,
    marker::{Detector, Kind, Params, Polarity, Ring, Scratch, Tracker},
};
use roundel_server::capture::image_file;
use roundel_tests::{elliptical, python::Python, shared_data::shared_data};
use serde::Deserialize;

/// Folder for files made by Python.
const FOLDER: &str = env!("CARGO_TARGET_TMPDIR");

#[derive(Deserialize)]
struct Rim {
    u: f64,
    v: f64,
    semi_major: f64,
    semi_minor: f64,
}

#[derive(Deserialize)]
struct Marker {
    outer: Rim,
    inner: Rim,
}

#[derive(Deserialize)]
struct Annotation {
    frames: BTreeMap<String, Marker>,
}

fn detector(ratio: Option<f64>) -> Detector {
    let kind = |ratio| Kind::plain("photographed", 0.1, 0.1 * ratio);
    Detector::new(ratio.map(kind).into_iter().collect(), Params::default()).unwrap()
}

fn sorted(folder: &Path) -> Vec<PathBuf> {
    let mut paths: Vec<_> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    paths.sort();
    paths
}

/// Deviations of one length from the annotation.
#[derive(Default)]
struct Deviation {
    count: f64,
    sum: f64,
    squares: f64,
}

impl Deviation {
    fn push(&mut self, difference: f64) {
        self.count += 1.0;
        self.sum += difference;
        self.squares += difference * difference;
    }

    fn rms(&self) -> f64 {
        (self.squares / self.count).sqrt()
    }

    fn mean(&self) -> f64 {
        self.sum / self.count
    }
}

/// Semiaxes and centres of both rims compared with the annotation.
#[derive(Default)]
struct Comparison {
    /// Outer major, outer minor, inner major, inner minor.
    semiaxes: [Deviation; 4],
    /// Outer, inner: distances.
    centers: [Deviation; 2],
}

impl Comparison {
    fn push(&mut self, ring: &Ring, truth: &Marker) {
        let pairs = [(&ring.outer, &truth.outer), (&ring.inner, &truth.inner)];
        for (index, (found, truth)) in pairs.into_iter().enumerate() {
            self.semiaxes[2 * index].push(found.semi_major_px - truth.semi_major);
            self.semiaxes[2 * index + 1].push(found.semi_minor_px - truth.semi_minor);
            self.centers[index].push(offset(found, truth));
        }
    }

    fn print(&self, name: &str) {
        let [a, b, c, d] =
            self.semiaxes.each_ref().map(|d| format!("{:+.3} ± {:.3}", d.mean(), d.rms()));
        let [outer, inner] = self.centers.each_ref().map(Deviation::rms);
        println!(
            "{name}: semiaxes off by (mean ± rms, px) outer {a}, {b}, inner {c}, {d}; \
             centres {outer:.3}, {inner:.3}"
        );
    }
}

fn offset(found: &Ellipse, truth: &Rim) -> f64 {
    (found.center.u - truth.u).hypot(found.center.v - truth.v)
}

#[test]
fn the_whole_video_is_one_track() {
    const NAME: &str = "the_whole_video_is_one_track";
    let Some(data) = shared_data(NAME, "real/ring") else { return };
    let Some(python) = Python::new(NAME, Path::new(FOLDER)) else { return };
    let video = data.join("video.mp4");
    let Some(frames) = python.folder(NAME, "video", "video.py", &[video.as_os_str()]) else {
        return;
    };
    let annotation = fs::read(data.join("video.ann.json")).unwrap();
    let annotation: Annotation = serde_json::from_slice(&annotation).unwrap();
    let paths = sorted(&frames);
    assert_eq!(paths.len(), 280);
    for ratio in [None, Some(0.593)] {
        let mut tracker = Tracker::new(detector(ratio));
        let mut all = Comparison::default();
        let mut tens: Vec<Comparison> = (0..7).map(|_| Comparison::default()).collect();
        for (index, path) in paths.iter().enumerate() {
            let image = image_file::load(path).unwrap();
            let tracked = tracker.process(&image.frame().unwrap()).to_vec();
            let name = format!("{:04}.png", index + 1);
            assert_eq!(tracked.len(), 1, "{name}: {tracked:?} {:?}", tracker.rejects());
            assert_eq!(tracked[0].track.0, 1, "{name}");
            if let Some(truth) = annotation.frames.get(&name) {
                all.push(&tracked[0].ring, truth);
                tens[index / 40].push(&tracked[0].ring, truth);
            }
        }
        for (index, part) in tens.iter().enumerate() {
            part.print(&format!("{ratio:?} frames from {}", 40 * index + 1));
        }
        all.print(&format!("{ratio:?} all"));
        // The annotation is at half level between the observed levels. Where the ring is so thin that blur lifts its
        // black, the detector's rims lie outside the outer and inside the inner one, by up to 0.15 px in the first
        // frames.
        let squares: f64 = all.semiaxes.iter().map(|d| d.rms().powi(2)).sum();
        let rms_px = (squares / 4.0).sqrt();
        println!("{ratio:?}: all semiaxes {rms_px:.3} px rms");
        assert!(rms_px < 0.15, "semiaxes: {rms_px} px rms");
    }
}

/// Requires no detection in these pictures, by a detector of any ratio and by detectors of given kinds, including
/// elliptical discs.
fn check_empty(paths: &[PathBuf]) {
    let kinds = elliptical::kinds(Polarity::BlackRing);
    let detector_of = |kinds: &[Kind]| Detector::new(kinds.to_vec(), Params::default()).unwrap();
    let beside_plain = [kinds[0].clone(), Kind::plain("small disc", 0.16, 0.064)];
    let detectors = [
        ("any", detector(None)),
        ("0.357", detector(Some(0.357))),
        ("0.5", detector(Some(0.5))),
        ("0.593", detector(Some(0.593))),
        ("elliptical and plain", detector_of(&beside_plain)),
        ("all elliptical", detector_of(&kinds)),
    ];
    let mut scratch = Scratch::default();
    let mut found = Vec::new();
    for path in paths {
        let image = image_file::load(path).unwrap();
        for (kinds, detector) in &detectors {
            let rings = detector.detect(&image.frame().unwrap(), &mut scratch).to_vec();
            found.extend(rings.iter().map(|ring| format!("{}: {kinds}: {ring:?}", path.display())));
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn pictures_of_rooms_have_no_detection() {
    let Some(folder) = shared_data("pictures_of_rooms_have_no_detection", "real/negatives") else {
        return;
    };
    let paths = sorted(&folder);
    assert!(!paths.is_empty());
    check_empty(&paths);
}

#[test]
fn photographs_of_other_projects_have_no_detection() {
    const NAME: &str = "photographs_of_other_projects_have_no_detection";
    let Some(python) = Python::new(NAME, Path::new(FOLDER)) else { return };
    let Some(folder) = python.folder(NAME, "photographs", "photographs.py", &[]) else { return };
    check_empty(&sorted(&folder));
}
