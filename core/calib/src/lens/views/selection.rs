//! Selects useful views from a stream of pictures.

use super::{
    super::LensCalibrationError,
    coverage::Coverage,
    homography::BoardHomography,
    layout_check,
    target::Target,
    view::{MIN_ROUNDELS, View},
};

/// Views are duplicates if their roundels differ by less than this share of the picture's diagonal, rms.
const SAME_SHARE: f64 = 0.02;
/// The board moves if its roundels moved by more than this share of their diameter since the last frame.
const MOVING_SHARE: f64 = 0.15;
/// Minimum number of views of another board for an error.
const MIN_OTHER_BOARDS: usize = 3;

/// Decision about a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ViewVerdict {
    /// Kept.
    Taken,
    /// No roundel or corner of the board was found.
    NoBoard,
    /// Less than half of the board is visible, or its roundels are not where a flat board has them.
    TooLittle,
    /// The board moves, so the picture is smeared.
    Moving,
    /// Duplicate of the kept view with this index.
    Duplicate(usize),
    /// The print has these columns and at least these rows, not the stated ones.
    OtherBoard(usize, usize),
}

/// Keeps views of a board that is held still at a new position or orientation.
#[derive(Clone, Debug)]
pub struct ViewSelector {
    target: Target,
    still: bool,
    last: Option<View>,
    taken: Vec<View>,
    coverage: Coverage,
    /// Number of views of another board, and its sides.
    other_boards: (usize, Option<(usize, usize)>),
}

impl ViewSelector {
    /// For a camera of `size` = (columns, rows). `still`: views are consecutive frames, so motion of the board can
    /// be detected; otherwise each picture is judged alone.
    pub fn new(target: Target, size: (usize, usize), still: bool) -> Self {
        Self {
            target,
            still,
            last: None,
            taken: Vec::new(),
            coverage: Coverage::new(size),
            other_boards: (0, None),
        }
    }

    /// Decides about the next view.
    pub fn offer(&mut self, view: View) -> ViewVerdict {
        let verdict = self.judge(&view);
        if verdict == ViewVerdict::Taken {
            if let Some(homography) = BoardHomography::fit(&self.target, &view) {
                self.coverage.add(&view, &homography);
            }
            self.taken.push(view.clone());
        }
        if let ViewVerdict::OtherBoard(columns, rows) = verdict {
            let before = self.other_boards.1.map_or(0, |(_, rows)| rows);
            self.other_boards = (self.other_boards.0 + 1, Some((columns, rows.max(before))));
        }
        self.last = Some(view);
        verdict
    }

    fn judge(&self, view: &View) -> ViewVerdict {
        if view.sightings.is_empty() {
            return ViewVerdict::NoBoard;
        }
        let other = self.target.board().and_then(|board| layout_check::other_sides(board, view));
        if let Some((columns, rows)) = other {
            return ViewVerdict::OtherBoard(columns, rows);
        }
        let half = (self.target.columns() * self.target.rows()).div_ceil(2);
        if view.sightings.len() < half.max(MIN_ROUNDELS)
            || BoardHomography::fit(&self.target, view).is_none()
        {
            return ViewVerdict::TooLittle;
        }
        let moved_px = self.last.as_ref().and_then(|last| last.distance_px(view));
        if self.still
            && moved_px.is_none_or(|moved_px| moved_px > MOVING_SHARE * view.mean_radius_px())
        {
            return ViewVerdict::Moving;
        }
        let (width, height) = self.coverage.size();
        let same_px = SAME_SHARE * (width as f64).hypot(height as f64);
        let is_duplicate = |taken: &View| taken.distance_px(view).is_some_and(|px| px < same_px);
        self.taken.iter().position(is_duplicate).map_or(ViewVerdict::Taken, ViewVerdict::Duplicate)
    }

    /// Error that ends the calibration if the print is not the described one.
    pub fn other_board(&self) -> Option<LensCalibrationError> {
        let (count, sides) = self.other_boards;
        let (found_columns, found_rows) = sides?;
        let (columns, rows) = (self.target.columns(), self.target.rows());
        (count >= MIN_OTHER_BOARDS && count > self.taken.len()).then_some(
            LensCalibrationError::OtherBoard { columns, rows, found_columns, found_rows },
        )
    }

    /// The calibration target.
    pub fn target(&self) -> &Target {
        &self.target
    }

    /// The kept views.
    pub fn taken(&self) -> &[View] {
        &self.taken
    }

    /// Coverage of the kept views.
    pub fn coverage(&self) -> &Coverage {
        &self.coverage
    }
}
