//! What is printed is what is detected: every kind and number, by the picture that is written, by the PDF as another
//! program draws it, and before a simulated camera.

use std::{collections::BTreeSet, fs, path::Path, process::Command};

use nalgebra::{Matrix3, Vector3};
use roundel_core::{
    calib::board::Board,
    frame::Frame,
    marker::{CodeLayout, Detector, Kind, Mode, Params, Pattern, Polarity, Ring, Scratch},
};
use roundel_server::{
    image_file::{self, GreyImage},
    print::{self, Item, Page, PageSize, SIDE_SHARE, board_page, sheets},
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

/// One of a plain kind, some of a coded one: all would be hundreds.
fn items(kind: &Kind) -> Vec<Item> {
    let numbers = match kind.pattern {
        Pattern::Coded(layout) => {
            let count = layout.codes().unwrap().len() as u16;
            (1..=count.min(40)).map(Some).collect()
        }
        _ => vec![None],
    };
    let label = |number: Option<u16>| number.map_or(String::new(), |number| format!("#{number}"));
    let item = |number| Item { kind: kind.clone(), number, label: label(number) };
    numbers.into_iter().map(item).collect()
}

fn picture(page: &Page, dpi: f64, folder: &Path) -> GreyImage {
    let file = folder.join("page.png");
    print::png(page, dpi, fs::File::create(&file).unwrap()).unwrap();
    image_file::load(&file).unwrap()
}

fn found(kind: &Kind, image: &GreyImage) -> Vec<Ring> {
    let params = Params { mode: Mode::Precise, ..Params::default() };
    let detector = Detector::new(vec![kind.clone()], params).unwrap();
    detector.detect(&image.frame().unwrap(), &mut Scratch::default()).to_vec()
}

fn numbers(rings: &[Ring]) -> BTreeSet<Option<u16>> {
    rings.iter().map(|ring| ring.code.map(|reading| reading.code.number)).collect()
}

fn pdftoppm(pages: &[Page], dpi: f64, folder: &Path) -> Option<Vec<GreyImage>> {
    let file = folder.join("sheet.pdf");
    fs::write(&file, print::pdf(pages, "sheet")).unwrap();
    let status = Command::new("pdftoppm")
        .args(["-gray", "-r", &dpi.to_string()])
        .arg(&file)
        .arg(folder.join("sheet"))
        .status();
    let Ok(status) = status else {
        println!("skipped: print needs pdftoppm (poppler-utils)");
        return None;
    };
    assert!(status.success(), "pdftoppm: {status}");
    let mut files: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|ending| ending == "pgm"))
        .collect();
    files.sort();
    Some(files.iter().map(|file| image_file::load(file).unwrap()).collect())
}

#[test]
fn every_kind_and_number_is_detected_in_the_pictures() {
    let folder = tempfile::tempdir().unwrap();
    for kind in kinds() {
        let items = items(&kind);
        let wanted: BTreeSet<_> = items.iter().map(|item| item.number).collect();
        let mut seen = BTreeSet::new();
        let mut count = 0;
        for page in &sheets(&items, A4).unwrap() {
            let rings = found(&kind, &picture(page, 150.0, folder.path()));
            count += rings.len();
            seen.extend(numbers(&rings));
        }
        assert_eq!((seen, count), (wanted, items.len()), "{}", kind.name);
    }
}

#[test]
fn the_pdf_is_true_to_scale_and_every_kind_and_number_is_detected_in_it() {
    const DPI: f64 = 600.0;
    for kind in kinds() {
        let folder = tempfile::tempdir().unwrap();
        let items: Vec<_> = items(&kind).into_iter().take(12).collect();
        let pages = sheets(&items, A4).unwrap();
        let Some(images) = pdftoppm(&pages, DPI, folder.path()) else { return };
        assert_eq!(images.len(), pages.len());
        let wanted: BTreeSet<_> = items.iter().map(|item| item.number).collect();
        let mut seen = BTreeSet::new();
        for (page, image) in pages.iter().zip(&images) {
            let rings = found(&kind, image);
            assert_eq!(rings.len(), page.prints.len(), "{}", kind.name);
            for ring in &rings {
                let mm = |radius_px: f64| 2.0 * radius_px * 25.4 / DPI;
                let (outer_mm, disc_mm) =
                    (kind.outer_diameter_m * 1e3, kind.inner_diameter_m * 1e3);
                for semi_px in [ring.outer.semi_major_px, ring.outer.semi_minor_px] {
                    assert!((mm(semi_px) - outer_mm).abs() < 0.1, "{} mm", mm(semi_px));
                }
                assert!((mm(ring.inner.semi_major_px) - disc_mm).abs() < 0.1, "{}", kind.name);
            }
            seen.extend(numbers(&rings));
            // Squares stand as far apart as they were laid out.
            let mut places: Vec<_> = rings.iter().map(|ring| ring.outer.center).collect();
            places.sort_by(|one, other| {
                (one.v + one.u * 1e-3).total_cmp(&(other.v + other.u * 1e-3))
            });
            if let [one, other, ..] = places[..] {
                let mm = (one.u - other.u).hypot(one.v - other.v) * 25.4 / DPI;
                assert!(mm > SIDE_SHARE * kind.outer_diameter_m * 1e3, "{mm} mm apart");
            }
        }
        assert_eq!(seen, wanted, "{}", kind.name);
    }
}

#[test]
fn rulers_of_the_pdf_measure_what_they_say() {
    const DPI: f64 = 600.0;
    let folder = tempfile::tempdir().unwrap();
    let pages = sheets(&items(&kinds()[0]), A4).unwrap();
    let Some(images) = pdftoppm(&pages, DPI, folder.path()) else { return };
    let image = &images[0];
    let dark = |u: usize, v: usize| image.pixels[v * image.width + u] < 128;
    let mm = |pixels: usize| pixels as f64 * 25.4 / DPI;
    // The longest dark run of any row below the prints is the ruler across, of any column the one down.
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
    // The ends are as wide as the lines that mark them.
    assert!((mm(across) - 100.0).abs() < 0.25, "{} mm", mm(across));
    assert!((mm(down) - 100.0).abs() < 0.25, "{} mm", mm(down));
}

#[test]
fn a_roundel_over_several_pages_is_whole_when_they_are_laid_together() {
    const DPI: f64 = 75.0;
    let folder = tempfile::tempdir().unwrap();
    let kind = coded(400.0, EIGHT);
    let item = Item { kind: kind.clone(), number: Some(7), label: "#7".to_owned() };
    let pages = sheets(&[item], A4).unwrap();
    // Three by three upright, or two by four where the page is turned.
    let columns = if pages[0].size == A4 { 3 } else { 2 };
    let rows = pages.len() / columns;
    assert_eq!(pages.len(), 8);
    let scale = DPI / 25.4;
    // Sheets overlap by ten millimetres; the upper and left ones go first, the others are laid on them.
    let window = pages[0].window;
    let steps = (window.width() - 10.0, window.height() - 10.0);
    let side = |step: f64, count: usize| ((count as f64 * step + 60.0) * scale) as usize;
    let (width, height) = (side(steps.0, columns), side(steps.1, rows));
    let mut whole = GreyImage { width, height, pixels: vec![255; width * height] };
    for (index, page) in pages.iter().enumerate() {
        let image = picture(page, DPI, folder.path());
        let at = |mm: f64| (mm * scale).round() as usize;
        let (left, top) =
            (at(steps.0 * (index % columns) as f64), at(steps.1 * (index / columns) as f64));
        let (from_u, from_v) = (at(window.left), at(window.top));
        for v in from_v + 1..at(window.bottom) - 1 {
            for u in from_u + 1..at(window.right) - 1 {
                whole.pixels[(top + v) * width + left + u] = image.pixels[v * image.width + u];
            }
        }
    }
    let rings = found(&kind, &whole);
    assert_eq!(numbers(&rings), BTreeSet::from([Some(7)]));
    let outer_mm = 2.0 * rings[0].outer.mean_radius_px() / scale;
    assert!((outer_mm - 400.0).abs() < 0.5, "{outer_mm} mm");
}

#[test]
fn a_simulated_camera_reads_what_was_printed() {
    let folder = tempfile::tempdir().unwrap();
    for kind in kinds() {
        let items: Vec<_> = items(&kind).into_iter().take(6).collect();
        let pages = sheets(&items, A4).unwrap();
        let seen = photograph(&picture(&pages[0], 150.0, folder.path()));
        let rings = found(&kind, &seen);
        let wanted: BTreeSet<_> =
            items[..pages[0].prints.len()].iter().map(|it| it.number).collect();
        assert_eq!(numbers(&rings), wanted, "{}", kind.name);
        assert_eq!(rings.len(), pages[0].prints.len(), "{}", kind.name);
    }
}

#[test]
fn the_board_is_read_as_a_whole_where_its_plan_says() {
    let folder = tempfile::tempdir().unwrap();
    let layout = CodeLayout { bits: 9, min_distance: 1 };
    let board = Board::new((7, 5), 0.036, 0.03, layout).unwrap();
    let page = board_page(&board, A4).unwrap();
    assert_eq!(page.size, A4.turned());
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
    // A smaller page names what fits.
    let a5 = PageSize { width_mm: 148.0, height_mm: 210.0 };
    assert!(board_page(&board, a5).unwrap_err().to_string().contains("has room for"));
}

/// A page as a camera sees it that looks at it from aside: the middle of 1600x1200, 2x2 samples a pixel, a blur of
/// 0.8 px.
fn photograph(page: &GreyImage) -> GreyImage {
    const SIZE: (usize, usize) = (1600, 1200);
    let tilt = 0.5_f64;
    // Page pixels to rays: the page turned about its vertical axis, before a camera of 1400 px.
    let scale = 1.0 / page.height as f64;
    let center = (page.width as f64 / 2.0, page.height as f64 / 2.0);
    let columns = [
        Vector3::new(tilt.cos() * scale, 0.0, -tilt.sin() * scale),
        Vector3::new(0.0, scale, 0.0),
        Vector3::new(0.0, 0.0, 1.25),
    ];
    let intrinsics = Matrix3::new(1400.0, 0.0, 800.0, 0.0, 1400.0, 600.0, 0.0, 0.0, 1.0);
    let page_from_pixel = (intrinsics * Matrix3::from_columns(&columns)).try_inverse().unwrap();
    let (width, height) = SIZE;
    let level = |u: f64, v: f64| {
        let at = page_from_pixel * Vector3::new(u, v, 1.0);
        let (x, y) = (at.x / at.z + center.0, at.y / at.z + center.1);
        let inside =
            x >= 0.0 && y >= 0.0 && x < page.width as f64 - 1.0 && y < page.height as f64 - 1.0;
        if !inside {
            return 200.0;
        }
        let (left, top) = (x.floor(), y.floor());
        let (right_share, down_share) = (x - left, y - top);
        let pixel = |u: usize, v: usize| f64::from(page.pixels[v * page.width + u]);
        let (u, v) = (left as usize, top as usize);
        let upper = pixel(u, v) * (1.0 - right_share) + pixel(u + 1, v) * right_share;
        let lower = pixel(u, v + 1) * (1.0 - right_share) + pixel(u + 1, v + 1) * right_share;
        20.0 + 180.0 / 255.0 * (upper * (1.0 - down_share) + lower * down_share)
    };
    let sharp: Vec<f64> = (0..width * height)
        .map(|index| {
            let (u, v) = ((index % width) as f64, (index / width) as f64);
            let shifts = [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)];
            shifts.iter().map(|(right, down)| level(u + right, v + down)).sum::<f64>() / 4.0
        })
        .collect();
    let kernel: Vec<f64> =
        (-3..=3).map(|at: i32| (-f64::from(at * at) / (2.0 * 0.64)).exp()).collect();
    let sum: f64 = kernel.iter().sum();
    let blurred = |image: &[f64], stride: usize, at: usize, length: usize| {
        let values = kernel.iter().enumerate().map(|(index, weight)| {
            let place = (at + index).saturating_sub(3).min(length - 1);
            let value = image.get(place * stride).copied().unwrap_or(200.0);
            weight * value
        });
        values.sum::<f64>() / sum
    };
    let rows: Vec<f64> = (0..width * height)
        .map(|index| blurred(&sharp[index / width * width..], 1, index % width, width))
        .collect();
    let pixels = (0..width * height)
        .map(|index| blurred(&rows[index % width..], width, index / width, height).round() as u8)
        .collect();
    GreyImage { width, height, pixels }
}

#[test]
fn a_frame_of_a_photograph_is_a_frame() {
    let page = GreyImage { width: 8, height: 8, pixels: vec![0; 64] };
    let seen = photograph(&page);
    assert!(Frame::new(&seen.pixels, seen.width, seen.height, seen.width).is_ok());
}
