//! Views: which of the board's roundels are where in a picture.

use super::super::board::Board;
use crate::{
    camera::PixelPoint,
    marker::{Code, Ring},
};

/// Fewest roundels of a view: four tell a homography, more tell whether one of them is wrong.
pub const LEAST_ROUNDELS: usize = 8;

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
    pub(super) fn distance_px(&self, other: &View) -> Option<f64> {
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

    pub(super) fn mean_radius_px(&self) -> f64 {
        let sum: f64 = self.sightings.iter().map(|sighting| sighting.radius_px).sum();
        sum / self.sightings.len().max(1) as f64
    }
}
