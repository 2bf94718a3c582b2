//! Detection in photographs with rims measured by hand (`../shared/data/real`): all roundels are found in the right
//! place, and nothing else.

use std::path::{Path, PathBuf};

use crate::picture::Picture;
use roundel_core::{
    ellipse::Ellipse,
    marker::{Detector, Kind, Params, Ring, Scratch, Tracker},
};
use serde::Deserialize;

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
    markers: Vec<Marker>,
}

#[derive(Deserialize)]
struct VideoAnnotation {
    frames: std::collections::BTreeMap<String, Marker>,
}

/// The folder of photographs. `None` if it is missing, after printing what is skipped.
fn photographs(test: &str) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/real");
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: {test} needs ../shared");
    None
}

fn detector(ratio: Option<f64>) -> Detector {
    let kind = |ratio| Kind::plain("photographed", 0.1, 0.1 * ratio);
    Detector::new(ratio.map(kind).into_iter().collect(), Params::default()).unwrap()
}

fn offset(found: &Ellipse, truth: &Rim) -> f64 {
    (found.center.u - truth.u).hypot(found.center.v - truth.v)
}

/// Requires both centres within 0.3 px of the annotation, and prints the semiaxes.
fn compare(name: &str, ring: &Ring, truth: &Marker) {
    let (outer, inner) = (offset(&ring.outer, &truth.outer), offset(&ring.inner, &truth.inner));
    println!(
        "{name}: centres off by {outer:.3} {inner:.3} px; semiaxes of {:.1} px: outer {:+.3} {:+.3}, \
         inner {:+.3} {:+.3} px",
        truth.outer.semi_major,
        ring.outer.semi_major_px - truth.outer.semi_major,
        ring.outer.semi_minor_px - truth.outer.semi_minor,
        ring.inner.semi_major_px - truth.inner.semi_major,
        ring.inner.semi_minor_px - truth.inner.semi_minor,
    );
    assert!(outer < 0.3, "{name}: outer centre off by {outer} px");
    assert!(inner < 0.3, "{name}: inner centre off by {inner} px");
}

/// Requires that exactly the annotated rings are found, with a known kind and with any ratio.
fn check_picture(folder: &Path, name: &str, ratio: Option<f64>) {
    let picture = Picture::read(&folder.join(name));
    let annotation = folder.join(name).with_extension("ann.json");
    let annotation: Annotation =
        serde_json::from_slice(&std::fs::read(annotation).unwrap()).unwrap();
    let detector = detector(ratio);
    let mut scratch = Scratch::default();
    let rings = detector.detect(&picture.frame(), &mut scratch).to_vec();
    for ring in &rings {
        let known = annotation.markers.iter().any(|m| offset(&ring.outer, &m.outer) < 3.0);
        assert!(known, "{name}: no roundel is at {ring:?}");
    }
    for truth in &annotation.markers {
        let ring = rings.iter().find(|ring| offset(&ring.outer, &truth.outer) < 3.0);
        let at = (truth.outer.u, truth.outer.v);
        let ring = ring
            .unwrap_or_else(|| panic!("{name}: nothing found at {at:?}; {:?}", scratch.rejects()));
        compare(name, ring, truth);
    }
    assert_eq!(rings.len(), annotation.markers.len(), "{name}");
}

#[test]
fn annotated_rings_are_found_where_they_are() {
    let Some(folder) = photographs("annotated_rings_are_found_where_they_are") else { return };
    for (name, ratio) in [
        ("whycon/0000.png", 0.357),
        ("whycon/0001.png", 0.357),
        ("whycon/many_gray.png", 0.357),
        ("ring/G2.jpeg", 0.593),
        ("ring/G4.jpeg", 0.593),
        ("ring/G6.jpeg", 0.593),
    ] {
        check_picture(&folder, name, None);
        check_picture(&folder, name, Some(ratio));
    }
}

#[test]
fn photographs_without_roundels_have_no_detection() {
    let Some(folder) = photographs("photographs_without_roundels_have_no_detection") else {
        return;
    };
    let mut scratch = Scratch::default();
    let mut pictures = 0;
    for entry in std::fs::read_dir(folder.join("negatives")).unwrap() {
        let path = entry.unwrap().path();
        let picture = Picture::read(&path);
        for ratio in [None, Some(0.357), Some(0.593)] {
            let rings = detector(ratio).detect(&picture.frame(), &mut scratch).to_vec();
            assert!(rings.is_empty(), "{}: {rings:?}", path.display());
        }
        pictures += 1;
    }
    assert!(pictures > 0);
}

#[test]
fn the_video_keeps_one_track() {
    let Some(folder) = photographs("the_video_keeps_one_track") else { return };
    let annotation = std::fs::read(folder.join("ring/video.ann.json")).unwrap();
    let annotation: VideoAnnotation = serde_json::from_slice(&annotation).unwrap();
    for ratio in [None, Some(0.593)] {
        let mut tracker = Tracker::new(detector(ratio));
        for number in 1..=60 {
            let name = format!("{number:04}.png");
            let picture = Picture::read(&folder.join("ring/video").join(&name));
            let tracked = tracker.process(&picture.frame()).to_vec();
            assert_eq!(tracked.len(), 1, "{name}: {tracked:?} {:?}", tracker.rejects());
            assert_eq!(tracked[0].track.0, 1, "{name}");
            if let Some(truth) = annotation.frames.get(&name) {
                compare(&name, &tracked[0].ring, truth);
            }
        }
    }
}
