//! Chessboards printed by other tools. Their targets are the inner corners, where four squares meet.
//!
//! Frame: x right and y up on the print, z out of it, the origin in the middle. Numbers run from 1 at the top left
//! corner, row by row. A plain chessboard looks the same after a rotation by 180°; the calibration is the same too.

use nalgebra::Point2;
use thiserror::Error;

use crate::board::Grid;

/// A printed chessboard.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Checkerboard {
    pub(crate) grid: Grid,
}

/// Invalid description of a chessboard.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the comments of the variants cover their fields")]
pub enum CheckerboardError {
    /// Number of inner corners out of range.
    #[error(
        "expected a chessboard of {} to {} inner corners across and down, found {columns} x {rows}",
        Checkerboard::SIDES.0, Checkerboard::SIDES.1
    )]
    Shape { columns: usize, rows: usize },
    /// Side of a square not positive.
    #[error("expected squares of above 0 mm, found {found_mm} mm")]
    Square { found_mm: f64 },
}

impl Checkerboard {
    /// Minimum and maximum number of inner corners across and down.
    pub const SIDES: (usize, usize) = (3, 100);

    /// A chessboard with `columns` by `rows` inner corners, `square_m` apart.
    pub fn new((columns, rows): (usize, usize), square_m: f64) -> Result<Self, CheckerboardError> {
        let (min, max) = Self::SIDES;
        if ![columns, rows].iter().all(|side| (min..=max).contains(side)) {
            return Err(CheckerboardError::Shape { columns, rows });
        }
        if !(square_m.is_finite() && square_m > 0.0) {
            return Err(CheckerboardError::Square { found_mm: square_m * 1e3 });
        }
        Ok(Self { grid: Grid { columns, rows, pitch_m: square_m } })
    }

    /// Inner corners per row.
    pub fn columns(&self) -> usize {
        self.grid.columns
    }

    /// Inner corners per column.
    pub fn rows(&self) -> usize {
        self.grid.rows
    }

    /// Side of a square, metres.
    pub fn square_m(&self) -> f64 {
        self.grid.pitch_m
    }

    /// Number of the corner in this column and row, which count from 0 at the top left.
    pub fn number(&self, column: usize, row: usize) -> Option<u16> {
        let exists = column < self.columns() && row < self.rows();
        exists.then_some((row * self.columns() + column + 1) as u16)
    }

    /// Position of the corner with this number in the board's frame, metres; `None` if the board does not have it.
    pub fn corner(&self, number: u16) -> Option<Point2<f64>> {
        self.grid.point_m(number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_run_row_by_row_from_the_top_left() {
        let board = Checkerboard::new((9, 6), 0.025).unwrap();
        let at = |column, row| board.corner(board.number(column, row)?).map(|it| (it.x, it.y));
        assert_eq!(at(0, 0), Some((-4.0 * 0.025, 2.5 * 0.025)));
        assert_eq!(at(8, 5), Some((4.0 * 0.025, -2.5 * 0.025)));
        assert_eq!((at(9, 0), at(0, 6)), (None, None));
        assert_eq!((board.corner(0), board.corner(55)), (None, None));
    }

    #[test]
    fn errors_of_chessboards_name_the_valid_range() {
        let error = |sides, square_m| Checkerboard::new(sides, square_m).unwrap_err().to_string();
        assert!(
            error((9, 2), 0.025).contains("3 to 100 inner corners across and down, found 9 x 2")
        );
        assert!(error((9, 6), 0.0).contains("above 0 mm"));
        assert!(error((9, 6), f64::NAN).contains("found NaN"));
    }
}
