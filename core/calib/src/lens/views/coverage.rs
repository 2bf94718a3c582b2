//! Coverage of the picture and of tilts by the views so far, and the views that are still missing.

use std::fmt;

use super::{homography::BoardHomography, view::View};
use crate::image_cells::cell_of;

/// Zones of the picture across and down.
pub const ZONES: (usize, usize) = (3, 3);
/// Minimum tilt of a tilted view, radians (15°).
const TILT_RAD: f64 = 0.26;
/// Minimum number of sightings in a visited zone, over all views.
pub const MIN_ZONE_SIGHTINGS: usize = 4;

/// Coverage by the views so far.
#[derive(Clone, Debug, PartialEq)]
pub struct Coverage {
    /// Sightings by zone of the picture, row by row.
    zones: [usize; ZONES.0 * ZONES.1],
    /// Whether there is a view with the right, left, lower or upper side nearer.
    tilted: [bool; 4],
    size: (usize, usize),
}

/// A view that is still missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MissingView {
    /// With this side of the board nearer to the camera than the other.
    Tilted(Side),
    /// With the board in this zone of the picture: 0 to 2 from the left, and from the top.
    Zone(usize, usize),
}

/// Side of the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub enum Side {
    Right,
    Left,
    Lower,
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

impl fmt::Display for MissingView {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Tilted(side) => {
                write!(out, "a view tilted by 20° to 45° with the {side} side nearer to the camera")
            }
            Self::Zone(column, row) => write!(out, "the board {}", zone_name(column, row)),
        }
    }
}

/// Where a zone is, such as "at the left edge of the picture".
pub(crate) fn zone_name(column: usize, row: usize) -> String {
    let across = ["left", "middle", "right"][column.min(2)];
    let down = ["top", "middle", "bottom"][row.min(2)];
    match (down, across) {
        ("middle", "middle") => "in the middle of the picture".to_owned(),
        ("middle", side) | (side, "middle") => format!("at the {side} edge of the picture"),
        _ => format!("in the {down} {across} corner of the picture"),
    }
}

impl Coverage {
    /// Without views.
    pub fn new(size: (usize, usize)) -> Self {
        Self { zones: [0; ZONES.0 * ZONES.1], tilted: [false; 4], size }
    }

    pub(crate) fn add(&mut self, view: &View, homography: &BoardHomography) {
        for sighting in &view.sightings {
            self.zones[cell_of(sighting.center, self.size, ZONES)] += 1;
        }
        let (right_rad, down_rad) = homography.tilt_rad(self.size);
        let sides = [right_rad, -right_rad, down_rad, -down_rad];
        for (is_tilted, tilt_rad) in self.tilted.iter_mut().zip(sides) {
            *is_tilted |= tilt_rad > TILT_RAD;
        }
    }

    /// Share of the picture's zones that were visited, 0 to 1.
    pub fn share(&self) -> f64 {
        let visited = self.zones.iter().filter(|&&count| count >= MIN_ZONE_SIGHTINGS).count();
        visited as f64 / self.zones.len() as f64
    }

    /// Sightings by zone, row by row from the top left: 3 by 3.
    pub fn zones(&self) -> &[usize] {
        &self.zones
    }

    /// Sides, and whether there is a view with that side of the board nearer to the camera.
    pub fn sides(&self) -> [(Side, bool); 4] {
        std::array::from_fn(|index| (SIDES[index], self.tilted[index]))
    }

    /// Width and height of the picture.
    pub fn size(&self) -> (usize, usize) {
        self.size
    }

    /// Whether there are views tilted to at least two sides.
    pub(crate) fn is_tilted(&self) -> bool {
        self.tilted.iter().filter(|&&is_tilted| is_tilted).count() >= 2
    }

    /// Missing views, most important first; empty if the views suffice.
    pub fn missing_views(&self) -> Vec<MissingView> {
        let tilts = self.sides().into_iter().filter(|(_, is_done)| !is_done);
        let zones = self.zones.iter().enumerate().filter(|(_, count)| **count < MIN_ZONE_SIGHTINGS);
        tilts
            .map(|(side, _)| MissingView::Tilted(side))
            .chain(zones.map(|(index, _)| MissingView::Zone(index % ZONES.0, index / ZONES.0)))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;

    use super::*;
    use crate::{
        checkerboard::Checkerboard,
        lens::{Sighting, Target, ViewSelector, ViewVerdict},
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
    fn a_view_covers_its_zones_and_sides() {
        let board = Checkerboard::new((9, 6), 0.025).unwrap();
        let mut selector = ViewSelector::new(Target::from(board), (900, 600), false);
        assert_eq!(selector.offer(view(&board)), ViewVerdict::Taken);
        let coverage = selector.coverage();
        assert!(
            coverage.zones()[0] >= MIN_ZONE_SIGHTINGS
                && coverage.zones()[1..].iter().all(|it| *it == 0)
        );
        let done = coverage.sides().map(|(_, is_done)| is_done);
        assert_eq!(done, [true, false, false, false], "right, left, lower, upper");
        assert!(!coverage.missing_views().contains(&MissingView::Tilted(Side::Right)));
    }
}
