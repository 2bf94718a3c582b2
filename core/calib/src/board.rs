//! The board that lenses are calibrated with: coded roundels in rows, so that any part of it that is seen
//! is known.
//!
//! Frame: x to the right and y up on the print, z out of it, the origin in the middle of the board. Numbers
//! run from 1 at the top left, row by row.

use nalgebra::{Point2, Point3};
use thiserror::Error;

use roundel_vision::marker::{Code, CodeError, CodeLayout, Kind, Pattern};

/// A board as printed.
#[derive(Clone, Debug, PartialEq)]
pub struct Board {
    columns: usize,
    rows: usize,
    pitch_m: f64,
    outer_diameter_m: f64,
    layout: CodeLayout,
}

/// Why there is no such board.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum BoardError {
    /// Too few roundels to tell a lens, or more than fingers can print.
    #[error(
        "expected a board of {} to {} columns and rows, found {columns} x {rows}",
        Board::SIDES.0, Board::SIDES.1
    )]
    Shape {
        /// As asked for.
        columns: usize,
        /// As asked for.
        rows: usize,
    },
    /// No positive length.
    #[error("expected an outer diameter above 0 mm, found {found_mm} mm")]
    Diameter {
        /// As asked for.
        found_mm: f64,
    },
    /// Neighbours touch.
    #[error(
        "expected a pitch (from centre to centre) of at least {} of the outer diameter, {least_mm:.2} mm, \
         found {found_mm:.2} mm",
        Board::LEAST_PITCH
    )]
    Pitch {
        /// The least.
        least_mm: f64,
        /// As asked for.
        found_mm: f64,
    },
    /// No such codes.
    #[error(transparent)]
    Code(#[from] CodeError),
    /// Each roundel has a code of its own.
    #[error(
        "a board of {columns} x {rows} needs {} codes, and there are {count} of {bits} bits at a distance \
         of {min_distance}: use more bits",
        columns * rows
    )]
    Codes {
        /// The board's.
        columns: usize,
        /// The board's.
        rows: usize,
        /// How many there are.
        count: usize,
        /// The layout's.
        bits: u8,
        /// The layout's.
        min_distance: u8,
    },
}

impl Board {
    /// Fewest and most columns and rows.
    pub const SIDES: (usize, usize) = (3, 40);
    /// Least pitch over the outer diameter: the white between two rings is what their levels come from.
    pub const LEAST_PITCH: f64 = 1.15;

    /// A board of `columns` by `rows` roundels of `outer_diameter_m`, whose centres are `pitch_m` apart.
    pub fn new(
        (columns, rows): (usize, usize),
        pitch_m: f64,
        outer_diameter_m: f64,
        layout: CodeLayout,
    ) -> Result<Self, BoardError> {
        let (least, most) = Self::SIDES;
        if ![columns, rows].iter().all(|side| (least..=most).contains(side)) {
            return Err(BoardError::Shape { columns, rows });
        }
        if !(outer_diameter_m.is_finite() && outer_diameter_m > 0.0) {
            return Err(BoardError::Diameter { found_mm: outer_diameter_m * 1e3 });
        }
        let least_m = Self::LEAST_PITCH * outer_diameter_m;
        // Not `<`: what is no number is no pitch either.
        if !(pitch_m.is_finite() && pitch_m >= least_m * (1.0 - 1e-9)) {
            return Err(BoardError::Pitch { least_mm: least_m * 1e3, found_mm: pitch_m * 1e3 });
        }
        let count = layout.codes()?.len();
        if count < columns * rows {
            let CodeLayout { bits, min_distance } = layout;
            return Err(BoardError::Codes { columns, rows, count, bits, min_distance });
        }
        Ok(Self { columns, rows, pitch_m, outer_diameter_m, layout })
    }

    /// The same with other columns and rows; `None`: there is no such board.
    pub(crate) fn with_sides(&self, sides: (usize, usize)) -> Option<Self> {
        Self::new(sides, self.pitch_m, self.outer_diameter_m, self.layout).ok()
    }

    /// Whether one of its roundels may have that code, were there enough of them.
    pub(crate) fn may_have(&self, code: Code) -> bool {
        code.bits == self.layout.bits
    }

    /// The kind of its roundels.
    pub fn kind(&self) -> Kind {
        let inner_m = self.outer_diameter_m * CodeLayout::RATIO;
        Kind {
            pattern: Pattern::Coded(self.layout),
            ..Kind::plain("board", self.outer_diameter_m, inner_m)
        }
    }

    /// Roundels in a row.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Roundels in a column.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// How many roundels there are.
    pub fn count(&self) -> usize {
        self.columns * self.rows
    }

    /// From centre to centre, metres.
    pub fn pitch_m(&self) -> f64 {
        self.pitch_m
    }

    /// Every number with its roundel's centre in the board's frame, metres.
    pub fn centers(&self) -> impl Iterator<Item = (u16, Point2<f64>)> + '_ {
        (1..=self.count() as u16).filter_map(|number| Some((number, self.flat(number)?)))
    }

    /// Where the roundel of that code is in the board's frame, metres; `None`: it is not on the board.
    pub fn center(&self, code: Code) -> Option<Point3<f64>> {
        let center = self.flat(code.number).filter(|_| code.bits == self.layout.bits)?;
        Some(Point3::new(center.x, center.y, 0.0))
    }

    /// Where the roundel of that number is on the print, metres.
    pub(crate) fn flat(&self, number: u16) -> Option<Point2<f64>> {
        let index = usize::from(number).checked_sub(1).filter(|&index| index < self.count())?;
        let (column, row) = (index % self.columns, index / self.columns);
        let from_middle = |place: usize, count: usize| place as f64 - (count - 1) as f64 / 2.0;
        Some(Point2::new(
            from_middle(column, self.columns) * self.pitch_m,
            -from_middle(row, self.rows) * self.pitch_m,
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAYOUT: CodeLayout = CodeLayout { bits: 9, min_distance: 1 };

    #[test]
    fn numbers_run_row_by_row_from_the_top_left() {
        let board = Board::new((7, 5), 0.036, 0.03, LAYOUT).unwrap();
        let at = |number| board.center(Code { bits: 9, number }).map(|point| (point.x, point.y));
        assert_eq!(at(1), Some((-3.0 * 0.036, 2.0 * 0.036)));
        assert_eq!(at(18), Some((0.0, 0.0)));
        assert_eq!(at(35), Some((3.0 * 0.036, -2.0 * 0.036)));
        assert_eq!((at(0), at(36)), (None, None));
        assert_eq!(board.center(Code { bits: 8, number: 1 }), None);
        assert_eq!(board.centers().count(), 35);
    }

    #[test]
    fn impossible_boards_say_what_is_possible() {
        let error = |sides, pitch_m, outer_m, layout| {
            Board::new(sides, pitch_m, outer_m, layout).unwrap_err().to_string()
        };
        assert!(error((2, 5), 0.036, 0.03, LAYOUT).contains("found 2 x 5"));
        assert!(error((7, 5), 0.036, 0.0, LAYOUT).contains("above 0 mm"));
        assert!(error((7, 5), 0.031, 0.03, LAYOUT).contains("34.50 mm"));
        assert!(error((7, 5), f64::NAN, 0.03, LAYOUT).contains("found NaN"));
        let eight = CodeLayout { bits: 8, min_distance: 1 };
        assert!(error((7, 5), 0.036, 0.03, eight).contains("needs 35 codes, and there are 30"));
    }
}
