//! Calibration targets: numbered points of a plane.

use nalgebra::Point2;

use crate::{
    board::{Board, Grid},
    checkerboard::Checkerboard,
};

/// A calibration target.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// Coded roundels, observed at the centres of the ellipses of their outer rims.
    Roundels(Board),
    /// A chessboard, with or without markers in its squares, observed at its inner corners.
    Corners(Checkerboard),
}

impl From<Board> for Target {
    fn from(board: Board) -> Self {
        Self::Roundels(board)
    }
}

impl From<Checkerboard> for Target {
    fn from(board: Checkerboard) -> Self {
        Self::Corners(board)
    }
}

impl Target {
    fn grid(&self) -> &Grid {
        match self {
            Self::Roundels(board) => &board.grid,
            Self::Corners(board) => &board.grid,
        }
    }

    /// Points per row.
    pub fn columns(&self) -> usize {
        self.grid().columns
    }

    /// Points per column.
    pub fn rows(&self) -> usize {
        self.grid().rows
    }

    /// Distance of adjacent points, metres.
    pub fn pitch_m(&self) -> f64 {
        self.grid().pitch_m
    }

    /// Plural name of the points.
    pub fn points(&self) -> &'static str {
        match self {
            Self::Roundels(_) => "roundels",
            Self::Corners(_) => "corners",
        }
    }

    /// Position of a point in the target's frame, metres.
    pub(crate) fn point_m(&self, number: u16) -> Option<Point2<f64>> {
        self.grid().point_m(number)
    }

    /// Radius of the circles whose centroids are observed, metres; `None` if the points themselves are observed.
    pub(crate) fn rim_m(&self) -> Option<f64> {
        self.board().map(|board| board.kind().outer_diameter_m / 2.0)
    }

    /// The board of roundels, whose numbers identify the print.
    pub(crate) fn board(&self) -> Option<&Board> {
        match self {
            Self::Roundels(board) => Some(board),
            Self::Corners(_) => None,
        }
    }
}
