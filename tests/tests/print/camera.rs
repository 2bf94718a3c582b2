//! Prints before a simulated camera at an angle: every kind, and every number of the usual codes.

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use roundel_core::{
    calib::board::Board,
    marker::{CodeLayout, Kind, Pattern, Polarity},
};
use roundel_server::{
    capture::image_file::GreyImage,
    lab::print::{self, board_page, items_of_kind, lay_out_pages, spec},
};

use super::{A4, coded, found, kinds, numbers, picture};

#[test]
fn a_camera_reads_each_kind() {
    let folder = tempfile::tempdir().unwrap();
    for kind in kinds() {
        let few = match kind.pattern {
            Pattern::Coded(_) => Some(spec::numbers("1-6").unwrap()),
            _ => None,
        };
        let items = items_of_kind(&kind, few.as_ref()).unwrap();
        let pages = lay_out_pages(&items, A4).unwrap();
        let seen = photograph(&picture(&pages[0], 150.0, folder.path()));
        let rings = found(&kind, &seen);
        let count = pages[0].prints.len();
        let wanted = items[..count].iter().map(|item| item.number).collect();
        assert_eq!(numbers(&rings), wanted, "{}", kind.name);
        assert_eq!(rings.len(), count, "{}", kind.name);
    }
}

#[test]
fn a_camera_reads_every_number() {
    let usual = [(8, 1, 17.0), (8, 2, 17.0), (9, 1, 17.0), (10, 2, 20.0), (12, 2, 26.0)];
    for (bits, min_distance, outer_mm) in usual {
        for polarity in [Polarity::BlackRing, Polarity::WhiteRing] {
            let layout = CodeLayout { bits, min_distance };
            let kind = Kind { polarity, ..coded(outer_mm, layout) };
            let items = items_of_kind(&kind, None).unwrap();
            let pages = lay_out_pages(&items, A4).unwrap();
            let mut read: Vec<_> = pages
                .par_iter()
                .flat_map_iter(|page| {
                    let folder = tempfile::tempdir().unwrap();
                    let seen = photograph(&picture(page, 300.0, folder.path()));
                    let rings = found(&kind, &seen);
                    assert_eq!(rings.len(), page.prints.len(), "{layout:?}, {polarity:?}");
                    numbers(&rings)
                })
                .collect();
            let wanted: Vec<_> = items.iter().map(|item| item.number).collect();
            read.sort_unstable();
            assert_eq!(read, wanted, "{layout:?}, {polarity:?}");
        }
    }
}

#[test]
fn a_camera_reads_the_board() {
    let folder = tempfile::tempdir().unwrap();
    let board = Board::new((5, 7), 0.036, 0.03, print::BOARD_LAYOUT).unwrap();
    let page = board_page(&board, A4).unwrap();
    let seen = photograph(&picture(&page, 150.0, folder.path()));
    let wanted = (1..=35).map(Some).collect();
    assert_eq!(numbers(&found(&board.kind(), &seen)), wanted);
}

/// A page seen at an angle: at the centre of 1600x1200 pixels, 2x2 samples per pixel, a blur of 0.8 px.
fn photograph(page: &GreyImage) -> GreyImage {
    const SIZE: (usize, usize) = (1600, 1200);
    let tilt = 0.5_f64;
    // Page pixels to rays: the page is rotated about its vertical axis, before a camera of 1400 px focal length.
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
