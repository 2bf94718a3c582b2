//! Finds the board in successive pictures and keeps the views that improve a calibration.

use roundel_core::{
    calib::{
        board::Board,
        lens::{LensCalibrationError, Target, View, ViewSelector, ViewVerdict},
    },
    frame::Frame,
    marker::{Detector, DetectorError, Mode, Params, Ring, Scratch},
};
use thiserror::Error;

use super::chessboard::{Chessboard, ChessboardMismatch, GridCounts};
#[cfg(feature = "chessboard")]
use super::corners;

/// Number of views that suffices once the coverage is complete.
pub const GOOD_VIEWS: usize = 20;

#[derive(Clone, Debug, PartialEq)]
pub enum CalibrationTarget {
    /// Roundel's own board.
    Roundels(Board),
    /// A board printed by another tool.
    Chessboard(Chessboard),
}

/// The target is not supported.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SearchError {
    #[error(transparent)]
    Roundels(#[from] DetectorError),
    #[error(
        "this build of roundel has no chessboard support (`cargo build --release -p roundel-server --features chessboard` \
         adds it); `roundel print --board 7x5 board.pdf` prints a board that every build supports"
    )]
    WithoutChessboards,
    #[error("{0}")]
    Chessboard(String),
}

/// The printed board differs from its description.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PrintMismatch {
    #[error(transparent)]
    Board(LensCalibrationError),
    #[error(transparent)]
    Chessboard(#[from] ChessboardMismatch),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error(
    "expected {} x {} pixels as in earlier pictures, found {} x {}: all pictures of a camera must have the same size",
    .expected.0, .expected.1, .found.0, .found.1
)]
pub struct SizeChanged {
    pub expected: (usize, usize),
    pub found: (usize, usize),
}

/// Views and counts of pictures by their [`ViewVerdict`].
#[derive(Clone, Debug)]
pub struct CollectedViews {
    /// Columns and rows of the pictures.
    pub size: (usize, usize),
    pub selector: ViewSelector,
    /// All pictures.
    pub frames: usize,
    pub without_board: usize,
    pub too_little: usize,
    pub moving: usize,
    pub alike: usize,
    /// Pictures of a board with other columns or rows.
    pub others: usize,
    /// Sizes of grids other than the described chessboard.
    grids: GridCounts,
}

impl CollectedViews {
    /// Numbers of pictures, of views kept, and of pictures left out by reason.
    pub fn describe(&self) -> String {
        let Self { frames, without_board, too_little, moving, alike, others, .. } = self;
        let taken = self.selector.taken().len();
        let counted = |count: usize, one: &str| match count {
            1 => format!("1 {one}"),
            _ => format!("{count} {one}s"),
        };
        let mut text = format!("{}, {} taken", counted(*frames, "picture"), counted(taken, "view"));
        for (count, why) in [
            (without_board, "without the board"),
            (too_little, "with less than half of it"),
            (moving, "in motion"),
            (alike, "like another one"),
            (others, "of a board with other columns or rows"),
        ] {
            if *count > 0 {
                text.push_str(&format!(", {count} {why}"));
            }
        }
        text
    }

    /// The mismatch between the print and its description, once it is certain. `is_over`: there are no more pictures.
    pub fn other_print(&self, is_over: bool) -> Option<PrintMismatch> {
        if let Some(error) = self.selector.other_board() {
            return Some(PrintMismatch::Board(error));
        }
        let Target::Corners(board) = self.selector.target() else { return None };
        let taken = self.selector.taken().len();
        self.grids.mismatch(board, taken, is_over).map(PrintMismatch::Chessboard)
    }

    /// Whether there are enough views and the coverage is complete.
    pub fn is_complete(&self) -> bool {
        self.selector.taken().len() >= GOOD_VIEWS
            && self.selector.coverage().missing_views().is_empty()
    }
}

pub struct BoardSearch {
    target: Target,
    finder: Finder,
    still: bool,
    gathered: Option<CollectedViews>,
}

enum Finder {
    Roundels(Board, Box<(Detector, Scratch)>),
    #[cfg(feature = "chessboard")]
    Corners(corners::Finder),
}

impl Finder {
    fn new(target: &CalibrationTarget) -> Result<Self, SearchError> {
        match target {
            CalibrationTarget::Roundels(board) => {
                let defaults = Params::default();
                let max_roundels = defaults.max_roundels.max(board.count());
                let params = Params { mode: Mode::Precise, max_roundels, ..defaults };
                let detector = Detector::new(vec![board.kind()], params)?;
                Ok(Self::Roundels(board.clone(), Box::new((detector, Scratch::default()))))
            }
            #[cfg(feature = "chessboard")]
            CalibrationTarget::Chessboard(board) => {
                corners::Finder::new(board).map(Self::Corners).map_err(SearchError::Chessboard)
            }
            #[cfg(not(feature = "chessboard"))]
            CalibrationTarget::Chessboard(_) => Err(SearchError::WithoutChessboards),
        }
    }

    /// Returns the view of the board, or the columns and rows of a chessboard that differs from the description, and the rings
    /// found.
    fn find(&mut self, frame: &Frame<'_>) -> (Result<View, (usize, usize)>, &[Ring]) {
        match self {
            Self::Roundels(board, detecting) => {
                let (detector, scratch) = &mut **detecting;
                let rings = detector.detect(frame, scratch);
                (Ok(View::of_rings(board, frame, rings)), rings)
            }
            #[cfg(feature = "chessboard")]
            Self::Corners(finder) => (finder.find(frame), &[]),
        }
    }
}

impl BoardSearch {
    /// `still`: the pictures are consecutive frames, and those of a moving board are left out.
    pub fn new(target: &CalibrationTarget, still: bool) -> Result<Self, SearchError> {
        let finder = Finder::new(target)?;
        let target = match target {
            CalibrationTarget::Roundels(board) => board.clone().into(),
            CalibrationTarget::Chessboard(board) => board.corners.into(),
        };
        Ok(Self { target, finder, still, gathered: None })
    }

    /// Searches a picture, and returns the rings found in it.
    pub fn look(&mut self, frame: &Frame<'_>) -> Result<(ViewVerdict, &[Ring]), SizeChanged> {
        let found = (frame.width(), frame.height());
        let gathered = self.gathered.get_or_insert_with(|| CollectedViews {
            size: found,
            selector: ViewSelector::new(self.target.clone(), found, self.still),
            frames: 0,
            without_board: 0,
            too_little: 0,
            moving: 0,
            alike: 0,
            others: 0,
            grids: GridCounts::default(),
        });
        if gathered.size != found {
            return Err(SizeChanged { expected: gathered.size, found });
        }
        gathered.frames += 1;
        let (view, rings) = self.finder.find(frame);
        let verdict = match view {
            Ok(view) => gathered.selector.offer(view),
            Err(sides) => {
                gathered.grids.add(sides);
                ViewVerdict::TooLittle
            }
        };
        match verdict {
            ViewVerdict::Taken => {}
            ViewVerdict::NoBoard => gathered.without_board += 1,
            ViewVerdict::TooLittle => gathered.too_little += 1,
            ViewVerdict::Moving => gathered.moving += 1,
            ViewVerdict::Duplicate(_) => gathered.alike += 1,
            ViewVerdict::OtherBoard(..) => gathered.others += 1,
        }
        Ok((verdict, rings))
    }

    /// The views so far; `None` before the first picture.
    pub fn gathered(&self) -> Option<&CollectedViews> {
        self.gathered.as_ref()
    }

    pub fn into_gathered(self) -> Option<CollectedViews> {
        self.gathered
    }

    /// The progress and the most useful next view, for the operator who moves the board.
    pub fn message(&self) -> String {
        let Some(gathered) = &self.gathered else { return "waiting for a picture".to_owned() };
        let coverage = gathered.selector.coverage();
        let taken = gathered.selector.taken().len();
        let covered = (coverage.share() * 100.0).round();
        let next = coverage.missing_views().first().map_or_else(
            || "hold the board still at new places".to_owned(),
            |want| format!("next: {want}"),
        );
        format!("{taken} views, {covered} % of the picture; {next}")
    }
}
