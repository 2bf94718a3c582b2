//! Views: which of the board's roundels are where in a picture.

use super::blur::blur_px;
use crate::board::Board;
use roundel_vision::{
    camera::PixelPoint,
    frame::Frame,
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
    /// Roundels with codes as the board's are, each once. Numbers that the board does not have tell that it is another one.
    pub sightings: Vec<Sighting>,
    /// Deviation of the blur across the roundels' rims, pixels (`calib::lens::blur`); `None` where nobody has looked.
    pub blur_px: Option<f64>,
}

impl View {
    /// What may be the board's roundels among rings that were found in a picture; a number that was read twice is left out, since
    /// one of them is wrong.
    pub fn of_rings(board: &Board, frame: &Frame<'_>, rings: &[Ring]) -> Self {
        let is_it = |ring: &&Ring| ring.code.is_some_and(|read| board.may_have(read.code));
        let blur_px = blur_px(frame, rings.iter().filter(is_it));
        let mut sightings: Vec<Sighting> = rings
            .iter()
            .filter_map(|ring| {
                let code: Code = ring.code?.code;
                if !board.may_have(code) {
                    return None;
                }
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
        Self { sightings, blur_px }
    }

    /// Corners of the convex outline round the roundels' centres, raw pixels; empty of fewer than three.
    pub fn outline(&self) -> Vec<PixelPoint> {
        let mut places: Vec<PixelPoint> = self.sightings.iter().map(|it| it.center).collect();
        places.sort_by(|one, other| one.u.total_cmp(&other.u).then(one.v.total_cmp(&other.v)));
        if places.len() < 3 {
            return Vec::new();
        }
        // One half of the way round, without the place where the other begins (Andrew 1979).
        let half = |places: &mut dyn Iterator<Item = PixelPoint>| {
            let mut corners: Vec<PixelPoint> = Vec::new();
            for place in places {
                while let [.., before, last] = corners[..]
                    && (last.u - before.u) * (place.v - before.v)
                        <= (last.v - before.v) * (place.u - before.u)
                {
                    corners.pop();
                }
                corners.push(place);
            }
            corners.pop();
            corners
        };
        let mut corners = half(&mut places.iter().copied());
        corners.extend(half(&mut places.iter().rev().copied()));
        corners
    }

    /// Rms distance of the roundels that both have, pixels; `None` if they have too few.
    pub(crate) fn distance_px(&self, other: &View) -> Option<f64> {
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

    pub(crate) fn mean_radius_px(&self) -> f64 {
        let sum: f64 = self.sightings.iter().map(|sighting| sighting.radius_px).sum();
        sum / self.sightings.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_outline_has_the_outermost_roundels_as_corners() {
        let sighting = |(number, (u, v)): (usize, (f64, f64))| Sighting {
            number: number as u16 + 1,
            center: PixelPoint { u, v },
            radius_px: 5.0,
        };
        let view = |places: &[(f64, f64)]| View {
            sightings: places.iter().copied().enumerate().map(sighting).collect(),
            ..View::default()
        };
        // A lattice of three by three, leaning; those on its sides are no corners.
        let places: Vec<(f64, f64)> = (0..9)
            .map(|index| (f64::from(index % 3), f64::from(index / 3)))
            .map(|(column, row)| (10.0 * column + 2.0 * row, 10.0 * row + column))
            .collect();
        let corners: Vec<_> = view(&places).outline().iter().map(|it| (it.u, it.v)).collect();
        assert_eq!(corners, [(0.0, 0.0), (20.0, 2.0), (24.0, 22.0), (4.0, 20.0)]);
        assert!(view(&places[..2]).outline().is_empty());
    }
}
