//! Which of a stream of views are worth keeping.

use super::{
    super::LensCalibrationError,
    coverage::Coverage,
    homography::Flat,
    layout_check,
    target::Target,
    view::{LEAST_ROUNDELS, View},
};

/// Views whose roundels moved by less than this share of the picture's diagonal, rms, are the same one.
const SAME_SHARE: f64 = 0.02;
/// Roundels that moved by more than this share of their diameter since the frame before are smeared.
const MOVING_SHARE: f64 = 0.15;
/// So many views of another board are no accident.
const LEAST_OTHERS: usize = 3;

/// What became of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It is kept.
    Taken,
    /// No roundel or corner of the board was found.
    NoBoard,
    /// Less than half of the board, which is cut off, covered or too far away, or not where a flat board has it.
    TooLittle,
    /// The board moved, so its picture is smeared.
    Moving,
    /// One like it is kept already: this one of those.
    Alike(usize),
    /// The print has other columns or rows than is said: these, or more rows.
    OtherBoard(usize, usize),
}

/// Chooses views of a stream: the board held still for a moment, at a new place or turned anew.
#[derive(Clone, Debug)]
pub struct Chooser {
    target: Target,
    size: (usize, usize),
    still: bool,
    last: Option<View>,
    taken: Vec<View>,
    coverage: Coverage,
    /// Views of another board, and its sides as the last of them had it.
    others: (usize, Option<(usize, usize)>),
}

impl Chooser {
    /// For a camera of `size` = (columns, rows). `still`: views follow one another in time, so a board that moves is
    /// seen to move; else each picture stands for itself.
    pub fn new(target: Target, size: (usize, usize), still: bool) -> Self {
        let coverage = Coverage::new(size);
        Self { target, size, still, last: None, taken: Vec::new(), coverage, others: (0, None) }
    }

    /// Looks at the next view.
    pub fn offer(&mut self, view: View) -> Verdict {
        let verdict = self.judge(&view);
        if verdict == Verdict::Taken {
            if let Some(flat) = Flat::of(&self.target, &view) {
                self.coverage.add(&view, &flat, self.size);
            }
            self.taken.push(view.clone());
        }
        if let Verdict::OtherBoard(columns, rows) = verdict {
            let before = self.others.1.map_or(0, |(_, rows)| rows);
            self.others = (self.others.0 + 1, Some((columns, rows.max(before))));
        }
        self.last = Some(view);
        verdict
    }

    fn judge(&self, view: &View) -> Verdict {
        if view.sightings.is_empty() {
            return Verdict::NoBoard;
        }
        let other = self.target.board().and_then(|board| layout_check::other_sides(board, view));
        if let Some((columns, rows)) = other {
            return Verdict::OtherBoard(columns, rows);
        }
        let half = (self.target.columns() * self.target.rows()).div_ceil(2);
        if view.sightings.len() < half.max(LEAST_ROUNDELS) || Flat::of(&self.target, view).is_none()
        {
            return Verdict::TooLittle;
        }
        let moved_px = self.last.as_ref().and_then(|last| last.distance_px(view));
        if self.still
            && moved_px.is_none_or(|moved_px| moved_px > MOVING_SHARE * view.mean_radius_px())
        {
            return Verdict::Moving;
        }
        let (width, height) = self.size;
        let same_px = SAME_SHARE * (width as f64).hypot(height as f64);
        let is_like = |taken: &View| taken.distance_px(view).is_some_and(|px| px < same_px);
        self.taken.iter().position(is_like).map_or(Verdict::Taken, Verdict::Alike)
    }

    /// Why there will be no lens, once it is clear that the print is another one than is described.
    pub fn other_board(&self) -> Option<LensCalibrationError> {
        let (count, sides) = self.others;
        let (found_columns, found_rows) = sides?;
        let (columns, rows) = (self.target.columns(), self.target.rows());
        (count >= LEAST_OTHERS && count > self.taken.len()).then_some(
            LensCalibrationError::OtherBoard { columns, rows, found_columns, found_rows },
        )
    }

    /// What is held before the camera.
    pub fn target(&self) -> &Target {
        &self.target
    }

    /// The views that were kept.
    pub fn taken(&self) -> &[View] {
        &self.taken
    }

    /// Where the board has been.
    pub fn coverage(&self) -> &Coverage {
        &self.coverage
    }
}
