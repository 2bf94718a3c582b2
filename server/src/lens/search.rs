//! Pictures in, views of the board worth keeping out, with what became of each picture.

use roundel_core::{
    calib::{
        board::Board,
        lens::{Chooser, Verdict, View},
    },
    frame::Frame,
    marker::{Detector, DetectorError, Mode, Params, Ring, Scratch},
};
use thiserror::Error;

/// Enough views, once nothing is missing.
pub const GOOD_VIEWS: usize = 20;

/// A picture of another size than those before.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error(
    "expected {} x {} pixels as the pictures before, found {} x {}: pictures of one camera have one size",
    .expected.0, .expected.1, .found.0, .found.1
)]
pub struct SizeChanged {
    /// Of the first one: columns, rows.
    pub expected: (usize, usize),
    /// Of this one.
    pub found: (usize, usize),
}

/// What was found so far.
#[derive(Clone, Debug)]
pub struct Gathered {
    /// Of the pictures: columns, rows.
    pub size: (usize, usize),
    /// The views that were kept.
    pub chooser: Chooser,
    /// Pictures that were looked at …
    pub frames: usize,
    /// … those without the board …
    pub without_board: usize,
    /// … with too little of it …
    pub too_little: usize,
    /// … in motion …
    pub moving: usize,
    /// … like one that was kept …
    pub alike: usize,
    /// … and of a board with other columns or rows.
    pub others: usize,
}

impl Gathered {
    fn new(board: &Board, size: (usize, usize), still: bool) -> Self {
        Self {
            size,
            chooser: Chooser::new(board.clone(), size, still),
            frames: 0,
            without_board: 0,
            too_little: 0,
            moving: 0,
            alike: 0,
            others: 0,
        }
    }

    /// How many pictures were left out, and why.
    pub fn told(&self) -> String {
        let Self { frames, without_board, too_little, moving, alike, others, .. } = self;
        let taken = self.chooser.taken().len();
        let mut text = format!("{frames} pictures, {taken} views taken");
        for (count, why) in [
            (without_board, "without the board"),
            (too_little, "with too little of it"),
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

    /// Whether nothing is missing any more.
    pub fn is_complete(&self) -> bool {
        self.chooser.taken().len() >= GOOD_VIEWS && self.chooser.coverage().wants().is_empty()
    }
}

/// Looks for the board in one picture after the other.
pub struct Search {
    board: Board,
    detector: Detector,
    scratch: Scratch,
    still: bool,
    gathered: Option<Gathered>,
}

impl Search {
    /// `still`: pictures follow one another in time, so a board that moves is seen to move.
    pub fn new(board: Board, still: bool) -> Result<Self, DetectorError> {
        let defaults = Params::default();
        let max_roundels = defaults.max_roundels.max(board.count());
        let params = Params { mode: Mode::Precise, max_roundels, ..defaults };
        let detector = Detector::new(vec![board.kind()], params)?;
        Ok(Self { board, detector, scratch: Scratch::default(), still, gathered: None })
    }

    /// Looks at a picture: what became of it, and the rings that were found in it.
    pub fn look(&mut self, frame: &Frame<'_>) -> Result<(Verdict, &[Ring]), SizeChanged> {
        let found = (frame.width(), frame.height());
        let (board, still) = (&self.board, self.still);
        let gathered = self.gathered.get_or_insert_with(|| Gathered::new(board, found, still));
        if gathered.size != found {
            return Err(SizeChanged { expected: gathered.size, found });
        }
        gathered.frames += 1;
        let rings = self.detector.detect(frame, &mut self.scratch);
        let verdict = gathered.chooser.offer(View::of_rings(board, rings));
        match verdict {
            Verdict::Taken => {}
            Verdict::NoBoard => gathered.without_board += 1,
            Verdict::TooLittle => gathered.too_little += 1,
            Verdict::Moving => gathered.moving += 1,
            Verdict::Alike => gathered.alike += 1,
            Verdict::OtherBoard(..) => gathered.others += 1,
        }
        Ok((verdict, rings))
    }

    /// What was found so far; `None` before the first picture.
    pub fn gathered(&self) -> Option<&Gathered> {
        self.gathered.as_ref()
    }

    /// What was found.
    pub fn into_gathered(self) -> Option<Gathered> {
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
