//! Where in the picture the board has been, how it was turned, and what is still wanted.

use std::fmt;

use super::{homography::Flat, view::View};

/// Zones of the picture across and down.
pub const ZONES: (usize, usize) = (3, 3);
/// A board is tilted when the picture's scale changes across it as it does at this angle, radians (15°).
const TILT_RAD: f64 = 0.26;
/// Tilted views wanted to each side.
const TILTED: usize = 1;
/// A zone has been visited when it held so many roundels in all.
pub const VISITED: usize = 4;

/// Where the board has been.
#[derive(Clone, Debug, PartialEq)]
pub struct Coverage {
    /// Roundels by zone of the picture, row by row.
    zones: [usize; ZONES.0 * ZONES.1],
    /// Views whose right, left, lower and upper part was nearer.
    tilted: [usize; 4],
    views: usize,
    size: (usize, usize),
}

/// A view that would help.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Want {
    /// With this side of the board nearer to the camera than the other.
    Tilted(Side),
    /// With the board in this zone of the picture: 0 to 2 from the left, and from the top.
    Zone(usize, usize),
}

/// Side of the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The right one.
    Right,
    /// The left one.
    Left,
    /// The lower one.
    Lower,
    /// The upper one.
    Upper,
}

const SIDES: [Side; 4] = [Side::Right, Side::Left, Side::Lower, Side::Upper];

impl fmt::Display for Side {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Right => "right",
            Self::Left => "left",
            Self::Lower => "lower",
            Self::Upper => "upper",
        })
    }
}

impl fmt::Display for Want {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Tilted(side) => {
                write!(out, "a view tilted by 20° to 45° with the {side} side nearer to the camera")
            }
            Self::Zone(column, row) => {
                let across = ["left", "middle", "right"][column.min(2)];
                let down = ["top", "middle", "bottom"][row.min(2)];
                match (down, across) {
                    ("middle", "middle") => write!(out, "the board in the middle of the picture"),
                    ("middle", side) => write!(out, "the board at the {side} edge of the picture"),
                    (side, "middle") => write!(out, "the board at the {side} edge of the picture"),
                    _ => write!(out, "the board in the {down} {across} corner of the picture"),
                }
            }
        }
    }
}

impl Coverage {
    /// Nowhere yet.
    pub fn new(size: (usize, usize)) -> Self {
        Self { zones: [0; ZONES.0 * ZONES.1], tilted: [0; 4], views: 0, size }
    }

    pub(crate) fn add(&mut self, view: &View, flat: &Flat, size: (usize, usize)) {
        self.views += 1;
        let (width, height) = (size.0 as f64, size.1 as f64);
        for sighting in &view.sightings {
            let zone = |place_px: f64, side_px: f64, count: usize| {
                ((place_px / side_px * count as f64).max(0.0) as usize).min(count - 1)
            };
            let column = zone(sighting.center.u, width, ZONES.0);
            let row = zone(sighting.center.v, height, ZONES.1);
            self.zones[row * ZONES.0 + column] += 1;
        }
        let (right_rad, down_rad) = flat.tilt_rad(size);
        let sides = [right_rad, -right_rad, down_rad, -down_rad];
        for (count, tilt_rad) in self.tilted.iter_mut().zip(sides) {
            *count += usize::from(tilt_rad > TILT_RAD);
        }
    }

    /// Share of the picture's zones that the board has been in, 0 to 1.
    pub fn share(&self) -> f64 {
        let visited = self.zones.iter().filter(|&&count| count >= VISITED).count();
        visited as f64 / self.zones.len() as f64
    }

    /// Roundels seen by zone, row by row from the top left: 3 by 3.
    pub fn zones(&self) -> &[usize] {
        &self.zones
    }

    /// Sides of the board that were nearer to the camera than the other at least once, and those that were not yet.
    pub fn sides(&self) -> [(Side, bool); 4] {
        [0, 1, 2, 3].map(|index| (SIDES[index], self.tilted[index] >= TILTED))
    }

    /// How wide and high the picture is.
    pub fn size(&self) -> (usize, usize) {
        self.size
    }

    /// Whether the board was tilted to at least two sides, one of them across and one down or opposite.
    pub(crate) fn is_tilted(&self) -> bool {
        self.tilted.iter().filter(|&&count| count > 0).count() >= 2
    }

    /// What would help, most first; empty: views are good enough.
    pub fn wants(&self) -> Vec<Want> {
        let tilts = SIDES.iter().zip(self.tilted).filter(|(_, count)| *count < TILTED);
        let mut wants: Vec<Want> = tilts.map(|(side, _)| Want::Tilted(*side)).collect();
        for (index, count) in self.zones.iter().enumerate() {
            if *count < VISITED {
                wants.push(Want::Zone(index % ZONES.0, index / ZONES.0));
            }
        }
        wants
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;

    use super::*;
    use crate::{
        checkerboard::Checkerboard,
        lens::{Chooser, Sighting, Target, Verdict},
    };
    use roundel_vision::camera::PixelPoint;

    /// A chessboard in the top left of a picture of 900 x 600, its right side nearer.
    fn view(board: &Checkerboard) -> View {
        let sighting = |index: usize| {
            let (column, row) = (index % 9, index / 9);
            let at = Point2::new(column as f64 - 4.0, row as f64 - 2.5);
            let depth = 1.0 - 0.012 * at.x;
            let center =
                PixelPoint { u: 150.0 + 18.0 * at.x / depth, v: 120.0 + 18.0 * at.y / depth };
            Sighting { number: board.number(column, row).unwrap(), center, radius_px: 9.0 }
        };
        let mut sightings: Vec<_> = (0..54).map(sighting).collect();
        sightings.sort_by_key(|sighting| sighting.number);
        View { sightings, ..View::default() }
    }

    #[test]
    fn zones_and_sides_are_done_by_a_view_that_shows_them() {
        let board = Checkerboard::new((9, 6), 0.025).unwrap();
        let mut chooser = Chooser::new(Target::from(board), (900, 600), false);
        assert_eq!(chooser.offer(view(&board)), Verdict::Taken);
        let coverage = chooser.coverage();
        assert!(coverage.zones()[0] >= VISITED && coverage.zones()[1..].iter().all(|it| *it == 0));
        let done = coverage.sides().map(|(_, is_done)| is_done);
        assert_eq!(done, [true, false, false, false], "right, left, lower, upper");
        assert!(!coverage.wants().contains(&Want::Tilted(Side::Right)));
    }
}
