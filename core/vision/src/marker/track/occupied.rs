//! Coarse grid of the rings of a frame.

use crate::{camera::PixelPoint, frame::Frame};

/// Side of a cell, pixels.
const CELL_PX: f64 = 16.0;

/// Cells that claims overlap, so that a ring is compared with its neighbours instead of all rings
/// of the frame.
#[derive(Debug, Default)]
pub(super) struct OccupancyGrid {
    /// Number of the newest frame in which a claim overlapped the cell.
    cells: Vec<u64>,
    columns: usize,
    frame: u64,
}

impl OccupancyGrid {
    /// Begins a new frame, in constant time.
    pub fn begin(&mut self, frame: &Frame) {
        let cells = |side: usize| (side as f64 / CELL_PX) as usize + 1;
        let (columns, rows) = (cells(frame.width()), cells(frame.height()));
        if self.columns != columns || self.cells.len() != columns * rows {
            self.columns = columns;
            self.cells.clear();
            self.cells.resize(columns * rows, 0);
        }
        self.frame += 1;
    }

    /// The cell of a coordinate, clamped to `count` cells.
    fn cell(x: f64, count: usize) -> usize {
        ((x / CELL_PX).max(0.0) as usize).min(count - 1)
    }

    pub fn add(&mut self, center: PixelPoint, (half_u, half_v): (f64, f64)) {
        let rows = self.cells.len() / self.columns;
        let left = Self::cell(center.u - half_u, self.columns);
        let right = Self::cell(center.u + half_u, self.columns);
        for row in Self::cell(center.v - half_v, rows)..=Self::cell(center.v + half_v, rows) {
            self.cells[row * self.columns + left..=row * self.columns + right].fill(self.frame);
        }
    }

    pub fn is_occupied(&self, center: PixelPoint) -> bool {
        let rows = self.cells.len() / self.columns;
        let (row, column) = (Self::cell(center.v, rows), Self::cell(center.u, self.columns));
        self.cells[row * self.columns + column] == self.frame
    }
}
