//! Calibration board: coded roundels on a grid. Codes identify the visible part of a partly visible board.
//!
//! Frame: x right and y up on the print, z out of it, the origin in the middle of the board. Numbers run from 1 at the
//! top left, row by row.

use nalgebra::{Point2, Point3};
use thiserror::Error;

use roundel_vision::marker::{Code, CodeError, CodeLayout, Kind, Pattern};

/// A printed board.
#[derive(Clone, Debug, PartialEq)]
pub struct Board {
    pub(crate) grid: Grid,
    outer_diameter_m: f64,
    layout: CodeLayout,
}

/// Points in columns and rows, numbered row by row from 1 at the top left. The origin is in the middle, y up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Grid {
    pub(crate) columns: usize,
    pub(crate) rows: usize,
    /// Distance of adjacent points, metres.
    pub(crate) pitch_m: f64,
}

impl Grid {
    /// Position of a point, metres; `None` if the grid does not have it.
    pub(crate) fn point_m(&self, number: u16) -> Option<Point2<f64>> {
        let index = usize::from(number).checked_sub(1)?;
        let (column, row) = (index % self.columns, index / self.columns);
        let from_center =
            |index: usize, count: usize| (index as f64 - (count - 1) as f64 / 2.0) * self.pitch_m;
        (row < self.rows)
            .then(|| Point2::new(from_center(column, self.columns), -from_center(row, self.rows)))
    }
}

/// Invalid description of a board.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[expect(missing_docs, reason = "the comments of the variants cover their fields")]
pub enum BoardError {
    /// Number of columns or rows out of range.
    #[error(
        "expected a board of {} to {} columns and rows, found {columns} x {rows}",
        Board::SIDES.0, Board::SIDES.1
    )]
    Shape { columns: usize, rows: usize },
    /// Diameter not positive.
    #[error("expected an outer diameter above 0 mm, found {found_mm} mm")]
    Diameter { found_mm: f64 },
    /// Adjacent roundels are too close.
    #[error(
        "expected a pitch (from centre to centre) of at least {} of the outer diameter, {min_mm:.2} mm, \
         found {found_mm:.2} mm",
        Board::MIN_PITCH_RATIO
    )]
    Pitch { min_mm: f64, found_mm: f64 },
    /// Invalid code layout.
    #[error(transparent)]
    Code(#[from] CodeError),
    /// The layout has fewer codes than the board has roundels.
    #[error(
        "a board of {columns} x {rows} needs {} codes, and there are {count} of {bits} bits at a distance \
         of {min_distance}: use more bits",
        columns * rows
    )]
    Codes { columns: usize, rows: usize, count: usize, bits: u8, min_distance: u8 },
}

impl Board {
    /// Minimum and maximum number of columns and rows.
    pub const SIDES: (usize, usize) = (3, 40);
    /// Minimum pitch over outer diameter. The white gap between two rings is needed to measure their grey levels.
    pub const MIN_PITCH_RATIO: f64 = 1.15;

    /// A board of `columns` by `rows` roundels of `outer_diameter_m` with centres `pitch_m` apart.
    pub fn new(
        (columns, rows): (usize, usize),
        pitch_m: f64,
        outer_diameter_m: f64,
        layout: CodeLayout,
    ) -> Result<Self, BoardError> {
        let (min, max) = Self::SIDES;
        if ![columns, rows].iter().all(|side| (min..=max).contains(side)) {
            return Err(BoardError::Shape { columns, rows });
        }
        if !(outer_diameter_m.is_finite() && outer_diameter_m > 0.0) {
            return Err(BoardError::Diameter { found_mm: outer_diameter_m * 1e3 });
        }
        let min_m = Self::MIN_PITCH_RATIO * outer_diameter_m;
        // Negated so that NaN is rejected.
        if !(pitch_m.is_finite() && pitch_m >= min_m * (1.0 - 1e-9)) {
            return Err(BoardError::Pitch { min_mm: min_m * 1e3, found_mm: pitch_m * 1e3 });
        }
        let count = layout.codes()?.len();
        if count < columns * rows {
            let CodeLayout { bits, min_distance } = layout;
            return Err(BoardError::Codes { columns, rows, count, bits, min_distance });
        }
        Ok(Self { grid: Grid { columns, rows, pitch_m }, outer_diameter_m, layout })
    }

    /// The same board with another number of columns and rows; `None` if invalid.
    pub(crate) fn with_sides(&self, sides: (usize, usize)) -> Option<Self> {
        Self::new(sides, self.grid.pitch_m, self.outer_diameter_m, self.layout).ok()
    }

    /// Whether the code belongs to this board's family, whatever its number.
    pub(crate) fn has_bits_of(&self, code: Code) -> bool {
        code.bits == self.layout.bits
    }

    /// Kind of the board's roundels.
    pub fn kind(&self) -> Kind {
        let inner_m = self.outer_diameter_m * CodeLayout::RATIO;
        Kind {
            pattern: Pattern::Coded(self.layout),
            ..Kind::plain("board", self.outer_diameter_m, inner_m)
        }
    }

    /// Roundels per row.
    pub fn columns(&self) -> usize {
        self.grid.columns
    }

    /// Roundels per column.
    pub fn rows(&self) -> usize {
        self.grid.rows
    }

    /// Number of roundels.
    pub fn count(&self) -> usize {
        self.grid.columns * self.grid.rows
    }

    /// Distance of adjacent centres, metres.
    pub fn pitch_m(&self) -> f64 {
        self.grid.pitch_m
    }

    /// Numbers and centres of all roundels in the board's frame, metres.
    pub fn centers(&self) -> impl Iterator<Item = (u16, Point2<f64>)> + '_ {
        (1..=self.count() as u16).filter_map(|number| Some((number, self.grid.point_m(number)?)))
    }

    /// Centre of the roundel with this code in the board's frame, metres; `None` if the board does not have it.
    pub fn center(&self, code: Code) -> Option<Point3<f64>> {
        let center = self.grid.point_m(code.number).filter(|_| self.has_bits_of(code))?;
        Some(Point3::new(center.x, center.y, 0.0))
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
    fn errors_of_boards_name_the_valid_range() {
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
