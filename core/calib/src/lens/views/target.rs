//! What views show: points of a plane, each with a number.

use nalgebra::Point2;

use crate::{board::Board, checkerboard::Checkerboard};

/// What is held before the camera.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// Coded roundels, of which the centres of the outer rims' ellipses are seen.
    Roundels(Board),
    /// A chessboard, whether markers in its squares tell its corners apart or not, of which the inner corners are seen.
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
    /// Points in a row.
    pub fn columns(&self) -> usize {
        match self {
            Self::Roundels(board) => board.columns(),
            Self::Corners(board) => board.columns(),
        }
    }

    /// Points in a column.
    pub fn rows(&self) -> usize {
        match self {
            Self::Roundels(board) => board.rows(),
            Self::Corners(board) => board.rows(),
        }
    }

    /// From one to the next, metres.
    pub fn pitch_m(&self) -> f64 {
        match self {
            Self::Roundels(board) => board.pitch_m(),
            Self::Corners(board) => board.square_m(),
        }
    }

    /// What its points are called.
    pub fn points(&self) -> &'static str {
        match self {
            Self::Roundels(_) => "roundels",
            Self::Corners(_) => "corners",
        }
    }

    /// Where the point of that number is in the target's frame, metres.
    pub(crate) fn at(&self, number: u16) -> Option<Point2<f64>> {
        match self {
            Self::Roundels(board) => board.flat(number),
            Self::Corners(board) => board.corner(number),
        }
    }

    /// Radius of the circles round the points whose images' centres are seen, metres; `None`: the points themselves are seen.
    pub(crate) fn rim_m(&self) -> Option<f64> {
        match self {
            Self::Roundels(board) => Some(board.kind().outer_diameter_m / 2.0),
            Self::Corners(_) => None,
        }
    }

    /// The board of roundels, whose numbers tell whether the print is another one.
    pub(crate) fn board(&self) -> Option<&Board> {
        match self {
            Self::Roundels(board) => Some(board),
            Self::Corners(_) => None,
        }
    }
}
