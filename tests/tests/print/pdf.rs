//! The PDF as another program draws it at 600 dots per inch: true to scale, and every kind and number in its place.
//!
//! Needs pdftoppm (poppler-utils); without it these tests are skipped.

use std::{fs, path::Path, process::Command};

use kurbo::{BezPath, Point, Shape as _};
use rayon::prelude::*;
use roundel_core::{
    calib::board::Board,
    marker::{CodeLayout, Kind, Pattern, Polarity},
};
use roundel_server::{
    capture::image_file::{self, GreyImage},
    lab::print::{self, Page, PageSize, PrintItem, board_page, items_of_kind, lay_out_pages, spec},
};
use roundel_tests::process::roundel;

use super::{A4, coded, found, kinds, numbers};

const DPI: f64 = 600.0;
const MM: f64 = 25.4 / DPI;
/// Tolerance of all measurements.
const TOLERANCE_MM: f64 = 0.1;

/// A PDF on disk.
struct Pdf {
    folder: tempfile::TempDir,
}

impl Pdf {
    /// `None` without pdftoppm.
    fn of(pages: &[Page]) -> Option<Self> {
        if Command::new("pdftoppm").arg("-v").output().is_err() {
            println!("skipped: print needs pdftoppm (poppler-utils)");
            return None;
        }
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("sheet.pdf"), print::pdf(pages, "sheet")).unwrap();
        Some(Self { folder })
    }

    /// A page as drawn, counted from 0.
    fn drawn(&self, index: usize) -> GreyImage {
        let number = (index + 1).to_string();
        let output = Command::new("pdftoppm")
            .args(["-gray", "-r", &DPI.to_string(), "-f", &number, "-l", &number])
            .arg(self.folder.path().join("sheet.pdf"))
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        image_file::decode(&output.stdout, Path::new("sheet.pgm")).unwrap()
    }
}

/// The centre of a print, whose outline is symmetrical.
fn middle(outline: &BezPath) -> Point {
    outline.bounding_box().center()
}

/// A page and its items.
struct Sheet<'a> {
    kind: &'a Kind,
    page: &'a Page,
    numbers: Vec<Option<u16>>,
}

impl Sheet<'_> {
    /// Requires that a drawing has these numbers and no others, each in its place and size.
    fn check(&self, image: &GreyImage) {
        let Self { kind, page, numbers } = self;
        let close = |found_mm: f64, wanted_mm: f64, what: &str| {
            let off_mm = (found_mm - wanted_mm).abs();
            assert!(
                off_mm < TOLERANCE_MM,
                "{}: {what} is {found_mm} mm, not {wanted_mm}",
                kind.name
            );
        };
        close(image.width as f64 * MM, page.size.width_mm, "the page's width");
        close(image.height as f64 * MM, page.size.height_mm, "the page's height");
        let rings = found(kind, image);
        let places: Vec<Point> = page.prints.iter().map(middle).collect();
        let mut missing: Vec<Option<u16>> = numbers.clone();
        for ring in &rings {
            // Pixel centres are whole numbers.
            let (x, y) = ((ring.outer.center.u + 0.5) * MM, (ring.outer.center.v + 0.5) * MM);
            let near =
                |at: &Point| (x - at.x).abs() < TOLERANCE_MM && (y - at.y).abs() < TOLERANCE_MM;
            let Some(index) = places.iter().position(near) else {
                panic!("{}: a roundel at ({x}, {y}) mm, where none is printed", kind.name);
            };
            let read = ring.code.map(|reading| reading.code.number);
            assert_eq!(read, numbers[index], "{:?} at ({x}, {y}) mm", kind.pattern);
            missing.retain(|number| *number != read);
            for semi_px in [ring.outer.semi_major_px, ring.outer.semi_minor_px] {
                close(2.0 * semi_px * MM, kind.outer_diameter_m * 1e3, "the outer diameter");
            }
            let minor_m = match kind.pattern {
                Pattern::Elliptical { minor_diameter_m } => minor_diameter_m,
                _ => kind.inner_diameter_m,
            };
            close(2.0 * ring.inner.semi_major_px * MM, kind.inner_diameter_m * 1e3, "the disc");
            close(2.0 * ring.inner.semi_minor_px * MM, minor_m * 1e3, "the disc across");
        }
        assert!(missing.is_empty(), "{}: {missing:?} are not found", kind.name);
    }
}

/// Pages of a kind with the numbers on them.
fn sheets_of<'a>(kind: &'a Kind, pages: &'a [Page], items: &[PrintItem]) -> Vec<Sheet<'a>> {
    let mut numbers = items.iter().map(|item| item.number);
    let sheet = |page: &'a Page| {
        let numbers = numbers.by_ref().take(page.prints.len()).collect();
        Sheet { kind, page, numbers }
    };
    let sheets: Vec<_> = pages.iter().map(sheet).collect();
    let count: usize = sheets.iter().map(|sheet| sheet.numbers.len()).sum();
    assert_eq!(count, items.len(), "all are on some page");
    sheets
}

/// Checks all numbers of a kind, and returns their count. `None` without pdftoppm.
fn check_all(kind: &Kind) -> Option<usize> {
    let items = items_of_kind(kind, None).unwrap();
    let pages = lay_out_pages(&items, A4).unwrap();
    let pdf = Pdf::of(&pages)?;
    let sheets = sheets_of(kind, &pages, &items);
    sheets.into_par_iter().enumerate().for_each(|(index, sheet)| sheet.check(&pdf.drawn(index)));
    Some(items.len())
}

#[test]
fn every_kind_is_true_to_scale_on_every_page() {
    let custom = PageSize { width_mm: 160.0, height_mm: 180.5 };
    let sizes = [A4, PageSize::parse("Letter").unwrap(), custom];
    for (kind, size) in kinds().iter().zip(sizes.into_iter().cycle()) {
        let few = match kind.pattern {
            Pattern::Coded(_) => Some(spec::numbers("1-12").unwrap()),
            _ => None,
        };
        let items = items_of_kind(kind, few.as_ref()).unwrap();
        let pages = lay_out_pages(&items, size).unwrap();
        let Some(pdf) = Pdf::of(&pages) else { return };
        for (index, sheet) in sheets_of(kind, &pages, &items).iter().enumerate() {
            sheet.check(&pdf.drawn(index));
        }
    }
}

/// All numbers of all codes that can be printed, 2 to 16 bits, up to 12 bits at every distance (codes at a larger
/// distance are a subset of those at distance 1 under other numbers): 9,400 small prints.
#[test]
fn every_number_of_every_code_is_read() {
    let mut count = 0;
    for bits in CodeLayout::BITS.0..=CodeLayout::BITS.1 {
        let max = if bits <= 12 { u8::MAX } else { 1 };
        for min_distance in 1..=max {
            let layout = CodeLayout { bits, min_distance };
            if layout.check().is_err() {
                break;
            }
            let Some(held) = check_all(&coded(6.0, layout)) else { return };
            count += held;
        }
    }
    println!("{count} coded roundels read");
    assert!(count > 8792, "{count}");
}

/// The default codes, as white rings too.
#[test]
fn every_number_of_the_default_codes_is_read_in_either_polarity() {
    for (bits, min_distance) in [(8, 2), (9, 1)] {
        for polarity in [Polarity::BlackRing, Polarity::WhiteRing] {
            let kind = Kind { polarity, ..coded(15.0, CodeLayout { bits, min_distance }) };
            if check_all(&kind).is_none() {
                return;
            }
        }
    }
}

#[test]
fn the_board_is_true_to_scale() {
    let small = Board::new((3, 3), 0.05, 0.04, CodeLayout { bits: 8, min_distance: 2 });
    let usual = Board::new((7, 5), 0.036, 0.03, print::BOARD_LAYOUT);
    let many = Board::new((17, 12), 0.015, 0.0125, CodeLayout { bits: 12, min_distance: 1 });
    for board in [small, usual, many] {
        let board = board.unwrap();
        let page = board_page(&board, A4).unwrap();
        let Some(pdf) = Pdf::of(std::slice::from_ref(&page)) else { return };
        let numbers: Vec<_> = board.centers().map(|(number, _)| Some(number)).collect();
        Sheet { kind: &board.kind(), page: &page, numbers }.check(&pdf.drawn(0));
        // The distance from the first to the last is that assumed by lens calibration.
        let (first, last) = (middle(&page.prints[0]), middle(page.prints.last().unwrap()));
        let places: Vec<_> = board.centers().map(|(_, center)| center).collect();
        let apart_m = (places[0] - places[places.len() - 1]).norm();
        let apart_mm = (first.x - last.x).hypot(first.y - last.y);
        assert!((apart_mm - apart_m * 1e3).abs() < 1e-6, "{apart_mm} mm");
    }
}

#[test]
fn rulers_have_their_stated_length() {
    let items = items_of_kind(&kinds()[0], None).unwrap();
    let Some(pdf) = Pdf::of(&lay_out_pages(&items, A4).unwrap()) else { return };
    let image = &pdf.drawn(0);
    let dark = |u: usize, v: usize| image.pixels[v * image.width + u] < 128;
    let mm = |pixels: usize| pixels as f64 * MM;
    // The longest dark run of any row below the prints is the horizontal ruler, that of any column the vertical one.
    let longest = |along: usize, is_dark: &dyn Fn(usize) -> bool| {
        let (mut best, mut run) = (0, 0);
        for at in 0..along {
            run = if is_dark(at) { run + 1 } else { 0 };
            best = best.max(run);
        }
        best
    };
    let foot = image.height * 9 / 10;
    let across = (foot..image.height).map(|v| longest(image.width, &|u| dark(u, v))).max().unwrap();
    let edge = image.width * 9 / 10;
    let down = (edge..image.width).map(|u| longest(image.height, &|v| dark(u, v))).max().unwrap();
    // The centres of the outermost lines are 100 mm apart.
    let line_mm = print::page::LINE_MM;
    assert!((mm(across) - line_mm - 100.0).abs() < TOLERANCE_MM, "{} mm", mm(across));
    assert!((mm(down) - line_mm - 100.0).abs() < TOLERANCE_MM, "{} mm", mm(down));
}

/// With the command line alone.
#[test]
fn prints_of_the_command_are_detected_by_the_command() {
    if Command::new("pdftoppm").arg("-v").output().is_err() {
        println!("skipped: print needs pdftoppm (poppler-utils)");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let run = |program: &Path, arguments: &[&str]| {
        let output =
            Command::new(program).args(arguments).current_dir(folder.path()).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{arguments:?}: {stderr}");
        String::from_utf8(output.stdout).unwrap()
    };
    let roundel = roundel().unwrap();
    run(&roundel, &["print", "--marker", "20", "--code", "8:2", "robots.pdf"]);
    run(Path::new("pdftoppm"), &["-gray", "-r", "600", "robots.pdf", "page"]);
    let listed = run(&roundel, &["print", "--code", "8:2", "--list", "--format", "json"]);
    let listed: Vec<serde_json::Value> = serde_json::from_str(&listed).unwrap();
    let wanted: Vec<u64> = listed.iter().map(|code| code["number"].as_u64().unwrap()).collect();
    let lines = run(
        &roundel,
        &["detect", "--marker", "20", "--code", "8:2", "--format", "json", "page-1.pgm"],
    );
    let line: serde_json::Value = serde_json::from_str(lines.trim()).unwrap();
    let detections = line["detections"].as_array().unwrap();
    let mut found: Vec<u64> = detections.iter().map(|it| it["id"].as_u64().unwrap()).collect();
    found.sort_unstable();
    assert_eq!(found, wanted);
}

/// Several sheets, joined by their marks.
#[test]
fn a_roundel_over_several_pages_is_whole_when_they_are_joined() {
    // The larger one with its default margin, the other with that of two sheets.
    for (outer_mm, count) in [(250.0, 4), (225.0, 2)] {
        let kind = coded(outer_mm, CodeLayout { bits: 8, min_distance: 2 });
        let item = PrintItem { kind: kind.clone(), number: Some(7), label: "#7".to_owned() };
        let pages = lay_out_pages(&[item], A4).unwrap();
        assert_eq!(pages.len(), count, "{outer_mm} mm");
        let Some(pdf) = Pdf::of(&pages) else { return };
        let rings = found(&kind, &laid_together(&kind, &pages, &pdf));
        assert_eq!(numbers(&rings), [Some(7)].into());
        let outer = rings[0].outer;
        for semi_px in [outer.semi_major_px, outer.semi_minor_px] {
            // Each sheet lies within half a pixel of its place.
            let found_mm = 2.0 * semi_px * MM;
            assert!((found_mm - outer_mm).abs() < TOLERANCE_MM, "{found_mm} mm");
        }
    }
}

/// On a dark floor.
fn laid_together(kind: &Kind, pages: &[Page], pdf: &Pdf) -> GreyImage {
    // A sheet's part of the whole: its window, moved so that the roundel's centres coincide.
    let at = |mm: f64| (mm / MM).round() as usize;
    let side = at(kind.outer_diameter_m * 1e3 * 1.3);
    let mut whole = GreyImage { width: side, height: side, pixels: vec![60; side * side] };
    for (index, page) in pages.iter().enumerate() {
        let (image, middle) = (pdf.drawn(index), middle(&page.prints[0]));
        let (left, top) = (
            side as isize / 2 - (middle.x / MM).round() as isize,
            side as isize / 2 - (middle.y / MM).round() as isize,
        );
        let window = page.window;
        for v in at(window.y0) + 1..at(window.y1) - 1 {
            for u in at(window.x0) + 1..at(window.x1) - 1 {
                let (x, y) = (left + u as isize, top + v as isize);
                if (0..side as isize).contains(&x) && (0..side as isize).contains(&y) {
                    whole.pixels[y as usize * side + x as usize] =
                        image.pixels[v * image.width + u];
                }
            }
        }
    }
    whole
}
