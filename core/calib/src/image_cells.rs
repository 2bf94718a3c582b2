//! Cells of an image, to tell which parts of it were observed.

use roundel_vision::camera::{Camera, PixelPoint};

/// Index of a pixel's cell among `cells` = (across, down), row by row; that of the nearest one outside of the image.
pub(crate) fn cell_of(at: PixelPoint, size: (usize, usize), cells: (usize, usize)) -> usize {
    let cell = |value: f64, size: usize, count: usize| {
        ((value / size as f64 * count as f64).max(0.0) as usize).min(count - 1)
    };
    cell(at.v, size.1, cells.1) * cells.0 + cell(at.u, size.0, cells.0)
}

/// Cells of an image across and down.
const CELLS: (usize, usize) = (8, 6);

/// Cells of an image with observations, a bit for each.
#[derive(Clone, Debug, Default)]
pub struct ImageCoverage(u64);

impl ImageCoverage {
    /// Marks the cell of a pixel.
    pub fn add(&mut self, lens: &Camera, at: PixelPoint) {
        self.0 |= 1 << cell_of(at, (lens.width(), lens.height()), CELLS);
    }

    /// Share of covered cells, 0 to 1.
    pub fn share(&self) -> f64 {
        f64::from(self.0.count_ones()) / (CELLS.0 * CELLS.1) as f64
    }
}
