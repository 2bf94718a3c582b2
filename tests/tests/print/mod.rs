//! Prints are detected: every kind and number, in the generated picture, in the PDF as drawn by another program, and
//! before a simulated camera.

mod camera;
mod pdf;

use std::{collections::BTreeSet, fs, path::Path};

use roundel_core::{
    calib::board::Board,
    marker::{CodeLayout, Detector, Kind, Mode, Params, Pattern, Polarity, Ring, Scratch},
};
use roundel_server::{
    capture::image_file::{self, GreyImage},
    lab::print::{self, Page, PageSize, PrintItem, board_page, lay_out_pages},
};

const A4: PageSize = PageSize { width_mm: 210.0, height_mm: 297.0 };
const EIGHT: CodeLayout = CodeLayout { bits: 8, min_distance: 2 };

fn coded(outer_mm: f64, layout: CodeLayout) -> Kind {
    let outer_m = outer_mm * 1e-3;
    let pattern = Pattern::Coded(layout);
    Kind { pattern, ..Kind::plain("coded", outer_m, outer_m * CodeLayout::RATIO) }
}

fn kinds() -> Vec<Kind> {
    let plain = Kind::plain("plain", 0.05, 0.02);
    let disc = Pattern::Elliptical { minor_diameter_m: 0.02 };
    let white = Polarity::WhiteRing;
    vec![
        plain.clone(),
        Kind { name: "white".to_owned(), polarity: white, ..plain.clone() },
        Kind { name: "disc".to_owned(), pattern: disc, ..Kind::plain("", 0.05, 0.03) },
        coded(50.0, EIGHT),
        coded(70.0, CodeLayout { bits: 12, min_distance: 2 }),
        Kind { name: "white coded".to_owned(), polarity: white, ..coded(50.0, EIGHT) },
    ]
}

/// One item of a plain kind, some of a coded one: all would be hundreds.
fn items(kind: &Kind) -> Vec<PrintItem> {
    let numbers = match kind.pattern {
        Pattern::Coded(layout) => {
            let count = layout.codes().unwrap().len() as u16;
            (1..=count.min(40)).map(Some).collect()
        }
        _ => vec![None],
    };
    let label = |number: Option<u16>| number.map_or(String::new(), |number| format!("#{number}"));
    let item = |number| PrintItem { kind: kind.clone(), number, label: label(number) };
    numbers.into_iter().map(item).collect()
}

fn picture(page: &Page, dpi: f64, folder: &Path) -> GreyImage {
    let file = folder.join("page.png");
    print::png(page, dpi, fs::File::create(&file).unwrap()).unwrap();
    image_file::load(&file).unwrap()
}

/// Detections of a kind.
fn found(kind: &Kind, image: &GreyImage) -> Vec<Ring> {
    let params = Params { mode: Mode::Precise, max_roundels: 1000, ..Params::default() };
    let detector = Detector::new(vec![kind.clone()], params).unwrap();
    detector.detect(&image.frame().unwrap(), &mut Scratch::default()).to_vec()
}

fn numbers(rings: &[Ring]) -> BTreeSet<Option<u16>> {
    rings.iter().map(|ring| ring.code.map(|reading| reading.code.number)).collect()
}

#[test]
fn every_kind_and_number_is_detected_in_the_pictures() {
    let folder = tempfile::tempdir().unwrap();
    for kind in kinds() {
        let items = items(&kind);
        let wanted: BTreeSet<_> = items.iter().map(|item| item.number).collect();
        let mut seen = BTreeSet::new();
        let mut count = 0;
        for page in &lay_out_pages(&items, A4).unwrap() {
            let rings = found(&kind, &picture(page, 150.0, folder.path()));
            count += rings.len();
            seen.extend(numbers(&rings));
        }
        assert_eq!((seen, count), (wanted, items.len()), "{}", kind.name);
    }
}

#[test]
fn the_whole_board_is_read_in_its_planned_place() {
    let folder = tempfile::tempdir().unwrap();
    let layout = CodeLayout { bits: 9, min_distance: 1 };
    let board = Board::new((7, 5), 0.036, 0.03, layout).unwrap();
    let page = board_page(&board, A4).unwrap();
    assert_eq!(page.size, A4.rotated());
    let image = picture(&page, 150.0, folder.path());
    let rings = found(&board.kind(), &image);
    assert_eq!(rings.len(), 35);
    let scale = 150.0 / 25.4;
    let middle =
        rings.iter().find(|ring| ring.code.is_some_and(|it| it.code.number == 18)).unwrap();
    for ring in &rings {
        let center = board.center(ring.code.unwrap().code).unwrap();
        let (right_mm, up_mm) = (
            (ring.outer.center.u - middle.outer.center.u) / scale,
            (middle.outer.center.v - ring.outer.center.v) / scale,
        );
        let off_mm = (right_mm - center.x * 1e3).hypot(up_mm - center.y * 1e3);
        assert!(off_mm < 0.02, "{:?} is off by {off_mm} mm", ring.code);
    }
    // For a smaller page, the error names what fits.
    let a5 = PageSize { width_mm: 148.0, height_mm: 210.0 };
    assert!(board_page(&board, a5).unwrap_err().to_string().contains("has room for"));
}
