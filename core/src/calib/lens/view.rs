//! Views of the board, and which of a stream of them are worth keeping.

use super::{
    super::board::Board,
    coverage::Coverage,
    start::{self, Flat},
};
use crate::{
    camera::PixelPoint,
    marker::{Code, Ring},
};

/// Fewest roundels of a view: four tell a homography, more tell whether one of them is wrong.
pub const LEAST_ROUNDELS: usize = 8;
/// Views whose roundels moved by less than this share of the picture's diagonal, rms, are the same one.
const SAME_SHARE: f64 = 0.02;
/// Roundels that moved by more than this share of their diameter since the frame before are smeared.
const MOVING_SHARE: f64 = 0.15;

/// One of the board's roundels in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Its code's number.
    pub number: u16,
    /// The centre of its outer rim's ellipse, raw pixels.
    pub center: PixelPoint,
    /// Geometric mean of the ellipse's semiaxes, pixels.
    pub radius_px: f64,
}

/// The board in one picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct View {
    /// Roundels with numbers of the board, each once.
    pub sightings: Vec<Sighting>,
}

impl View {
    /// The board's roundels among rings that were found; a number that was read twice is left out, since one of them
    /// is wrong.
    pub fn of_rings(board: &Board, rings: &[Ring]) -> Self {
        let mut sightings: Vec<Sighting> = rings
            .iter()
            .filter_map(|ring| {
                let code: Code = ring.code?.code;
                board.center(code)?;
                let (center, radius_px) = (ring.outer.center, ring.outer.mean_radius_px());
                Some(Sighting { number: code.number, center, radius_px })
            })
            .collect();
        sightings.sort_by_key(|sighting| sighting.number);
        let twice: Vec<u16> = sightings
            .windows(2)
            .filter(|pair| pair[0].number == pair[1].number)
            .map(|pair| pair[0].number)
            .collect();
        sightings.retain(|sighting| !twice.contains(&sighting.number));
        Self { sightings }
    }

    /// Rms distance of the roundels that both have, pixels; `None` if they have too few.
    fn distance_px(&self, other: &View) -> Option<f64> {
        let mut squares = 0.0;
        let mut count = 0;
        for one in &self.sightings {
            let Ok(index) = other.sightings.binary_search_by_key(&one.number, |it| it.number)
            else {
                continue;
            };
            let twin = &other.sightings[index];
            squares +=
                (one.center.u - twin.center.u).powi(2) + (one.center.v - twin.center.v).powi(2);
            count += 1;
        }
        (count >= LEAST_ROUNDELS).then(|| (squares / count as f64).sqrt())
    }

    fn mean_radius_px(&self) -> f64 {
        let sum: f64 = self.sightings.iter().map(|sighting| sighting.radius_px).sum();
        sum / self.sightings.len().max(1) as f64
    }
}

/// What became of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It is kept.
    Taken,
    /// No roundel of the board was found.
    NoBoard,
    /// Fewer roundels than [`LEAST_ROUNDELS`], or they are not where a flat board has them.
    TooLittle,
    /// The board moved, so its picture is smeared.
    Moving,
    /// One like it is kept already.
    Alike,
}

/// Chooses views of a stream: the board held still for a moment, at a new place or turned anew.
#[derive(Clone, Debug)]
pub struct Chooser {
    board: Board,
    size: (usize, usize),
    still: bool,
    last: Option<View>,
    taken: Vec<View>,
    coverage: Coverage,
}

impl Chooser {
    /// For a camera of `size` = (columns, rows). `still`: views follow one another in time, so a board that moves is
    /// seen to move; else each picture stands for itself.
    pub fn new(board: Board, size: (usize, usize), still: bool) -> Self {
        let coverage = Coverage::new(size);
        Self { board, size, still, last: None, taken: Vec::new(), coverage }
    }

    /// Looks at the next view.
    pub fn offer(&mut self, view: View) -> Verdict {
        let verdict = self.judge(&view);
        if verdict == Verdict::Taken {
            if let Some(flat) = Flat::of(&self.board, &view) {
                self.coverage.add(&view, &flat, self.size);
            }
            self.taken.push(view.clone());
        }
        self.last = Some(view);
        verdict
    }

    fn judge(&self, view: &View) -> Verdict {
        if view.sightings.is_empty() {
            return Verdict::NoBoard;
        }
        if view.sightings.len() < LEAST_ROUNDELS || start::Flat::of(&self.board, view).is_none() {
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
        if self.taken.iter().any(is_like) { Verdict::Alike } else { Verdict::Taken }
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
