//! Share of a camera's image in which roundels were observed.

use roundel_vision::camera::{Camera, PixelPoint};

/// Cells of an image across and down.
const CELLS: (usize, usize) = (8, 6);

/// Cells of an image with observations.
#[derive(Clone, Debug)]
pub struct ImageCoverage([bool; CELLS.0 * CELLS.1]);

impl ImageCoverage {
    /// Marks the cell of a pixel, or the nearest one if it is outside of the image.
    pub fn add(&mut self, lens: &Camera, at: PixelPoint) {
        let cell = |value: f64, size: usize, count: usize| {
            ((value / size as f64 * count as f64).max(0.0) as usize).min(count - 1)
        };
        let column = cell(at.u, lens.width(), CELLS.0);
        self.0[cell(at.v, lens.height(), CELLS.1) * CELLS.0 + column] = true;
    }

    /// Share of covered cells, 0 to 1.
    pub fn share(&self) -> f64 {
        self.0.iter().filter(|&&is_seen| is_seen).count() as f64 / self.0.len() as f64
    }
}

impl Default for ImageCoverage {
    fn default() -> Self {
        Self([false; CELLS.0 * CELLS.1])
    }
}
