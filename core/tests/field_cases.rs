//! Small pictures that once failed (`../shared/data/field-cases`); the README beside each says what was wrong.

use std::path::{Path, PathBuf};

use crate::picture::Picture;
use roundel_core::marker::{CodeLayout, Detector, Kind, Params, Pattern, Ring, Scratch};

/// A file of `../shared/data/field-cases`. `None` if it is missing, after printing what is skipped.
fn field_case(test: &str, file: &str) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/field-cases");
    if folder.is_dir() {
        return Some(folder.join(file));
    }
    println!("skipped: {test} needs ../shared");
    None
}

/// The only ring of a picture.
fn only_ring(path: &Path, kinds: &[Kind]) -> Ring {
    let picture = Picture::read(path);
    let detector = Detector::new(kinds.to_vec(), Params::default()).unwrap();
    let mut scratch = Scratch::default();
    let rings = detector.detect(&picture.frame(), &mut scratch).to_vec();
    let rejects: Vec<_> = scratch.rejects().iter().filter(|(_, count)| *count > 0).collect();
    let [ring] = rings[..] else { panic!("{}: {rings:?}, {rejects:?}", path.display()) };
    ring
}

#[test]
fn a_ring_half_in_shadow_is_found() {
    let Some(path) = field_case("a_ring_half_in_shadow_is_found", "shadow-edge/frame.png") else {
        return;
    };
    only_ring(&path, &[]);
    only_ring(&path, &[Kind::plain("robot", 0.16, 0.064)]);
}

#[test]
fn rings_without_blur_are_found() {
    for file in
        ["hard-edges/drawn.png", "hard-edges/sampled.png", "enlarged-without-smoothing/frame.png"]
    {
        let Some(path) = field_case("rings_without_blur_are_found", file) else { return };
        only_ring(&path, &[]);
    }
}

#[test]
fn an_overexposed_ring_fits_its_kind() {
    let Some(path) = field_case("an_overexposed_ring_fits_its_kind", "overexposed/frame.png")
    else {
        return;
    };
    only_ring(&path, &[Kind::plain("robot", 0.16, 0.064)]);
}

#[test]
fn a_code_of_three_bits_is_read() {
    let Some(path) = field_case("a_code_of_three_bits_is_read", "whycode-3-bits/print.png") else {
        return;
    };
    let pattern = Pattern::Coded(CodeLayout { bits: 3, min_distance: 1 });
    let kind = Kind { pattern, ..Kind::plain("robot", 0.16, 0.16 * CodeLayout::RATIO) };
    let ring = only_ring(&path, &[kind]);
    assert!(ring.code.is_some(), "{ring:?}");
}
