//! Chessboards, as other tools print them: what is seen of them are the corners at which four squares meet.
//!
//! Frame: x to the right and y up on the print, z out of it, the origin in the middle. Numbers run from 1 at the top left
//! corner, row by row. A plain chessboard that is turned by 180° looks the same, and for the lens is the same.

use nalgebra::Point2;
use thiserror::Error;

/// A chessboard as printed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Checkerboard {
    columns: usize,
    rows: usize,
    square_m: f64,
}

/// Why there is no such chessboard.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum CheckerboardError {
    /// Too few corners to tell a lens, or more than fingers can print.
    #[error(
        "expected a chessboard of {} to {} inner corners across and down, found {columns} x {rows}",
        Checkerboard::SIDES.0, Checkerboard::SIDES.1
    )]
    Shape {
        /// As asked for.
        columns: usize,
        /// As asked for.
        rows: usize,
    },
    /// No positive length.
    #[error("expected squares of above 0 mm, found {found_mm} mm")]
    Square {
        /// As asked for.
        found_mm: f64,
    },
}

impl Checkerboard {
    /// Fewest and most inner corners across and down.
    pub const SIDES: (usize, usize) = (3, 100);

    /// With `columns` by `rows` inner corners, `square_m` apart.
    pub fn new((columns, rows): (usize, usize), square_m: f64) -> Result<Self, CheckerboardError> {
        let (least, most) = Self::SIDES;
        if ![columns, rows].iter().all(|side| (least..=most).contains(side)) {
            return Err(CheckerboardError::Shape { columns, rows });
        }
        if !(square_m.is_finite() && square_m > 0.0) {
            return Err(CheckerboardError::Square { found_mm: square_m * 1e3 });
        }
        Ok(Self { columns, rows, square_m })
    }

    /// Inner corners in a row.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Inner corners in a column.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Side of a square, metres.
    pub fn square_m(&self) -> f64 {
        self.square_m
    }

    /// The number of the corner in that column and row, from 0 at the top left.
    pub fn number(&self, column: usize, row: usize) -> Option<u16> {
        let is_there = column < self.columns && row < self.rows;
        is_there.then_some((row * self.columns + column + 1) as u16)
    }

    /// Where the corner of that number is in the board's frame, metres; `None`: it is not on the board.
    pub fn corner(&self, number: u16) -> Option<Point2<f64>> {
        let index = usize::from(number).checked_sub(1)?;
        let (column, row) = (index % self.columns, index / self.columns);
        let from_middle = |place: usize, count: usize| place as f64 - (count - 1) as f64 / 2.0;
        (row < self.rows).then(|| {
            Point2::new(
                from_middle(column, self.columns) * self.square_m,
                -from_middle(row, self.rows) * self.square_m,
            )
        })
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
    fn impossible_chessboards_say_what_is_possible() {
        let error = |sides, square_m| Checkerboard::new(sides, square_m).unwrap_err().to_string();
        assert!(
            error((9, 2), 0.025).contains("3 to 100 inner corners across and down, found 9 x 2")
        );
        assert!(error((9, 6), 0.0).contains("above 0 mm"));
        assert!(error((9, 6), f64::NAN).contains("found NaN"));
    }
}
