//! Prints for other detectors in place of roundels: square markers and plain discs.

use std::{fs, io, path::Path};

use crate::render::{Image, Ink, Outline, Print};

/// A square marker's cells, row by row, including its black border: 0 is black.
pub type Cells = Vec<Vec<u8>>;

fn square([x, y]: [f64; 2], half_m: f64) -> Outline {
    Outline::Polygon(vec![
        [x - half_m, y - half_m],
        [x + half_m, y - half_m],
        [x + half_m, y + half_m],
        [x - half_m, y + half_m],
    ])
}

/// A black square of this side with white cells, on a sheet with one cell of margin.
pub fn marker(cells: &Cells, side_m: f64) -> Print {
    let count = cells.len();
    let cell_m = side_m / count as f64;
    let mut inks = vec![Ink { outline: square([0.0; 2], side_m / 2.0), white: false }];
    for (row, line) in cells.iter().enumerate() {
        for (column, bit) in line.iter().enumerate() {
            if *bit == 1 {
                let place = |i: usize| (i as f64 - (count as f64 - 1.0) / 2.0) * cell_m;
                let outline = square([place(column), -place(row)], cell_m / 2.0);
                inks.push(Ink { outline, white: true });
            }
        }
    }
    Print { sheet: square([0.0; 2], side_m / 2.0 + cell_m), inks, bend: None }
}

/// A black disc of this diameter on a round sheet.
pub fn disc(diameter_m: f64) -> Print {
    let mut print = Print::plain(diameter_m, 0.4 * diameter_m, 0.2);
    print.inks.truncate(1);
    print
}

/// Writes a binary PGM, which OpenCV and `cargo bench -p roundel-core --bench images` read.
pub fn write_pgm(path: &Path, image: &Image) -> io::Result<()> {
    let mut bytes = format!("P5\n{} {}\n255\n", image.width, image.height).into_bytes();
    bytes.extend(&image.pixels);
    fs::write(path, bytes)
}
