//! Existing WhyCode prints (`../shared/data/whycode`) are read with their known numbers: direction, order and
//! polarity of the teeth.

use std::path::{Path, PathBuf};

use crate::picture::Picture;
use roundel_core::{
    camera::PixelPoint,
    ellipse::Ellipse,
    frame::Frame,
    marker::{
        Code, CodeLayout, CodeReader, CodeReading, Detector, Kind, Params, Pattern, Polarity, Ring,
        Scratch,
    },
};

/// Side of a picture of a print, and the outer radius in it.
const SIDE: usize = 120;
const RADIUS_PX: f64 = 40.0;
/// The same in the files.
const FILE_CENTER_PX: f64 = 299.5;
const FILE_RADIUS_PX: f64 = 700.0 / 3.0;
/// Subpixels along each side of a pixel.
const FINE: usize = 4;

fn prints(test: &str, bits: u8) -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/whycode");
    if folder.is_dir() {
        return Some(folder.join(format!("bits{bits}")));
    }
    println!("skipped: {test} needs ../shared");
    None
}

/// The print rotated counter-clockwise by `turn_rad`, compressed along v to `flat`.
fn turned(print: &Picture, turn_rad: f64, flat: f64, is_negative: bool) -> Vec<u8> {
    let middle = (SIDE as f64 - 1.0) / 2.0;
    let (sin, cos) = turn_rad.sin_cos();
    let grey = |u: f64, v: f64| {
        let scale = FILE_RADIUS_PX / RADIUS_PX;
        // On the print y is up.
        let (x, y) = ((u - middle) * scale, -(v - middle) / flat * scale);
        let (x, y) = (cos * x + sin * y, -sin * x + cos * y);
        let (column, row) = ((FILE_CENTER_PX + x).round(), (FILE_CENTER_PX - y).round());
        if column < 0.0 || row < 0.0 || column > 599.0 || row > 599.0 {
            return 255.0;
        }
        f64::from(print.frame().row(row as usize)[column as usize])
    };
    let place = |k: usize| (k as f64 + 0.5) / FINE as f64 - 0.5;
    let pixel = |index: usize| {
        let (u, v) = ((index % SIDE) as f64, (index / SIDE) as f64);
        let parts = (0..FINE * FINE).map(|k| grey(u + place(k % FINE), v + place(k / FINE)));
        let mean = parts.sum::<f64>() / (FINE * FINE) as f64;
        let level = 30.0 + 0.75 * mean;
        if is_negative { (255.0 - level) as u8 } else { level as u8 }
    };
    (0..SIDE * SIDE).map(pixel).collect()
}

fn read(reader: &CodeReader, pixels: &[u8], flat: f64, polarity: Polarity) -> Option<CodeReading> {
    let middle = (SIDE as f64 - 1.0) / 2.0;
    let rim = |radius: f64| Ellipse {
        center: PixelPoint { u: middle, v: middle },
        semi_major_px: radius,
        semi_minor_px: radius * flat,
        angle_rad: 0.0,
    };
    let ring = Ring { polarity, ..Ring::of_rims(rim(RADIUS_PX), rim(RADIUS_PX * 0.6)) };
    reader.read(&Frame::new(pixels, SIDE, SIDE, SIDE).unwrap(), &ring)
}

/// The reading of a detector that knows the kind alone.
fn detected(detector: &Detector, pixels: &[u8], scratch: &mut Scratch) -> Option<CodeReading> {
    let frame = Frame::new(pixels, SIDE, SIDE, SIDE).unwrap();
    let [ring] = detector.detect(&frame, scratch) else { return None };
    ring.code
}

#[test]
fn a_detector_finds_existing_prints_and_reads_them() {
    for (bits, min_distance, count) in [(5, 1, 6), (7, 2, 9)] {
        let Some(folder) = prints("existing prints", bits) else { return };
        let pattern = Pattern::Coded(CodeLayout { bits, min_distance });
        let kind = Kind { pattern, ..Kind::plain("print", 0.14, 0.084) };
        let other = Kind::plain("other", 0.14, 0.14 * 0.489);
        let detector = Detector::new(vec![other, kind], Params::default()).unwrap();
        let mut scratch = Scratch::default();
        for number in 1..=count {
            let print = Picture::read(&folder.join(format!("{number}.png")));
            for step in 0..10 {
                let (turn_rad, flat) = (f64::from(step) * 0.63, 1.0 - 0.04 * f64::from(step));
                let pixels = turned(&print, turn_rad, flat, false);
                let reading = detected(&detector, &pixels, &mut scratch);
                let found = reading.map(|reading| reading.code);
                assert_eq!(found, Some(Code { bits, number }), "{turn_rad} rad, {flat}");
            }
        }
    }
}

#[test]
fn existing_prints_keep_their_numbers_in_any_rotation() {
    for (bits, min_distance, count) in [(5, 1, 6), (7, 2, 9)] {
        let Some(folder) = prints("existing prints", bits) else { return };
        let layout = CodeLayout { bits, min_distance };
        let reader = CodeReader::new(layout, CodeLayout::RATIO).unwrap();
        assert_eq!(reader.dictionary().len(), count);
        for number in 1..=count as u16 {
            let print = Picture::read(&folder.join(format!("{number}.png")));
            for (step, flat, polarity) in
                (0..18).flat_map(|step| [(step, 1.0), (step, 0.7)]).map(|(step, flat)| {
                    let is_ring_black = step % 3 != 2;
                    let polarity =
                        if is_ring_black { Polarity::BlackRing } else { Polarity::WhiteRing };
                    (step, flat, polarity)
                })
            {
                let turn_rad = f64::from(step) * 0.36;
                let pixels = turned(&print, turn_rad, flat, polarity == Polarity::WhiteRing);
                let reading = read(&reader, &pixels, flat, polarity);
                let case = format!("{bits} bits, {number}, {turn_rad} rad, {flat}: {reading:?}");
                let reading = reading.unwrap_or_else(|| panic!("{case}"));
                assert_eq!(reading.code, Code { bits, number }, "{case}");
                assert_eq!(reading.corrected, 0, "{case}");
                let middle = (SIDE as f64 - 1.0) / 2.0;
                let direction = |at: PixelPoint| ((middle - at.v) / flat).atan2(at.u - middle);
                let off = direction(reading.zero) - turn_rad;
                assert!(off.sin().abs() < 0.01 && off.cos() > 0.0, "{off} {case}");
                let off = direction(reading.opposite) - turn_rad;
                assert!(off.sin().abs() < 0.01 && off.cos() < 0.0, "{off} {case}");
            }
        }
    }
}
