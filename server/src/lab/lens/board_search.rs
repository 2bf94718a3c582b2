//! Pictures in, views of the board worth keeping out, with what became of each picture.

use roundel_core::{
    calib::{
        board::Board,
        lens::{Chooser, LensCalibrationError, Target, Verdict, View},
    },
    frame::Frame,
    marker::{Detector, DetectorError, Mode, Params, Ring, Scratch},
};
use thiserror::Error;

use super::chessboard::{Chessboard, ChessboardMismatch, GridCounts};
#[cfg(feature = "chessboard")]
use super::corners;

/// Enough views, once nothing is missing.
pub const GOOD_VIEWS: usize = 20;

/// What is held before the camera.
#[derive(Clone, Debug, PartialEq)]
pub enum CalibrationTarget {
    /// Roundel's own board.
    Roundels(Board),
    /// One that another tool has printed.
    Chessboard(Chessboard),
}

impl CalibrationTarget {
    fn target(&self) -> Target {
        match self {
            Self::Roundels(board) => board.clone().into(),
            Self::Chessboard(board) => board.corners.into(),
        }
    }
}

/// Why nothing can be looked for.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SearchError {
    /// Not these roundels.
    #[error(transparent)]
    Roundels(#[from] DetectorError),
    /// Not in this program.
    #[error(
        "this roundel was built without chessboards (`cargo build --release -p roundel-server --features chessboard` \
         builds it with them); `roundel print --board 7x5 board.pdf` prints a board that needs no more than this one"
    )]
    WithoutChessboards,
    /// Not this chessboard.
    #[error("{0}")]
    Chessboard(String),
}

/// The print is not what was said.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PrintMismatch {
    #[error(transparent)]
    Board(LensCalibrationError),
    #[error(transparent)]
    Chessboard(#[from] ChessboardMismatch),
}

/// A picture of another size than those before.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error(
    "expected {} x {} pixels as the pictures before, found {} x {}: pictures of one camera have one size",
    .expected.0, .expected.1, .found.0, .found.1
)]
pub struct SizeChanged {
    /// Of the first one: columns, rows.
    pub expected: (usize, usize),
    pub found: (usize, usize),
}

#[derive(Clone, Debug)]
pub struct CollectedViews {
    /// Of the pictures: columns, rows.
    pub size: (usize, usize),
    pub chooser: Chooser,
    /// Pictures that were looked at …
    pub frames: usize,
    /// … those without the board …
    pub without_board: usize,
    /// … with less than half of it, or that is another one …
    pub too_little: usize,
    pub moving: usize,
    /// … like one that was kept …
    pub alike: usize,
    /// … and of a board with other columns or rows.
    pub others: usize,
    /// Of a plain chessboard, what else it looked like.
    grids: GridCounts,
}

impl CollectedViews {
    fn new(target: Target, size: (usize, usize), still: bool) -> Self {
        Self {
            size,
            chooser: Chooser::new(target, size, still),
            frames: 0,
            without_board: 0,
            too_little: 0,
            moving: 0,
            alike: 0,
            others: 0,
            grids: GridCounts::default(),
        }
    }

    /// How many pictures were left out, and why.
    pub fn describe(&self) -> String {
        let Self { frames, without_board, too_little, moving, alike, others, .. } = self;
        let taken = self.chooser.taken().len();
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

    /// Why there will be no lens, once it is clear that the print is another one than is described; `is_over`: no more
    /// pictures come.
    pub fn other_print(&self, is_over: bool) -> Option<PrintMismatch> {
        let of_roundels = self.chooser.other_board().map(PrintMismatch::Board);
        let of_squares = || match self.chooser.target() {
            Target::Corners(board) => {
                let taken = self.chooser.taken().len();
                self.grids.mismatch(board, taken, is_over).map(PrintMismatch::Chessboard)
            }
            Target::Roundels(_) => None,
        };
        of_roundels.or_else(of_squares)
    }

    /// Whether nothing is missing any more.
    pub fn is_complete(&self) -> bool {
        self.chooser.taken().len() >= GOOD_VIEWS && self.chooser.coverage().wants().is_empty()
    }
}

/// Looks for the board in one picture after the other.
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

enum SearchOutcome<'a> {
    Board(View, &'a [Ring]),
    /// Of a chessboard, columns and rows that are not those described.
    #[cfg(feature = "chessboard")]
    OtherGrid((usize, usize)),
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

    fn find(&mut self, frame: &Frame<'_>) -> SearchOutcome<'_> {
        match self {
            Self::Roundels(board, detecting) => {
                let (detector, scratch) = &mut **detecting;
                let rings = detector.detect(frame, scratch);
                SearchOutcome::Board(View::of_rings(board, frame, rings), rings)
            }
            #[cfg(feature = "chessboard")]
            Self::Corners(finder) => match finder.find(frame) {
                corners::CornerSearch::Board(view) => SearchOutcome::Board(view, &[]),
                corners::CornerSearch::Other(sides) => SearchOutcome::OtherGrid(sides),
            },
        }
    }
}

impl BoardSearch {
    /// `still`: pictures follow one another in time, so a board that moves is seen to move.
    pub fn new(target: &CalibrationTarget, still: bool) -> Result<Self, SearchError> {
        let finder = Finder::new(target)?;
        Ok(Self { target: target.target(), finder, still, gathered: None })
    }

    /// Looks at a picture: what became of it, and the rings that were found in it.
    pub fn look(&mut self, frame: &Frame<'_>) -> Result<(Verdict, &[Ring]), SizeChanged> {
        let found = (frame.width(), frame.height());
        let (target, still) = (&self.target, self.still);
        let gathered =
            self.gathered.get_or_insert_with(|| CollectedViews::new(target.clone(), found, still));
        if gathered.size != found {
            return Err(SizeChanged { expected: gathered.size, found });
        }
        gathered.frames += 1;
        let (verdict, rings) = match self.finder.find(frame) {
            SearchOutcome::Board(view, rings) => (gathered.chooser.offer(view), rings),
            #[cfg(feature = "chessboard")]
            SearchOutcome::OtherGrid(sides) => {
                gathered.grids.add(sides);
                (Verdict::TooLittle, &[] as &[Ring])
            }
        };
        match verdict {
            Verdict::Taken => {}
            Verdict::NoBoard => gathered.without_board += 1,
            Verdict::TooLittle => gathered.too_little += 1,
            Verdict::Moving => gathered.moving += 1,
            Verdict::Alike(_) => gathered.alike += 1,
            Verdict::OtherBoard(..) => gathered.others += 1,
        }
        Ok((verdict, rings))
    }

    /// What was found so far; `None` before the first picture.
    pub fn gathered(&self) -> Option<&CollectedViews> {
        self.gathered.as_ref()
    }

    pub fn into_gathered(self) -> Option<CollectedViews> {
        self.gathered
    }

    /// What is still missing, for who moves the board.
    pub fn message(&self) -> String {
        let Some(gathered) = &self.gathered else { return "waiting for a picture".to_owned() };
        let coverage = gathered.chooser.coverage();
        let taken = gathered.chooser.taken().len();
        let covered = (coverage.share() * 100.0).round();
        let next = coverage.wants().first().map_or_else(
            || "hold it still at new places".to_owned(),
            |want| format!("wanted: {want}"),
        );
        format!("{taken} views, {covered} % of the picture; {next}")
    }
}
