//! Views: positions of the board's numbered points in a picture.

use super::blur::blur_px;
use crate::board::Board;
use roundel_vision::{camera::PixelPoint, frame::Frame, marker::Ring};

/// Minimum number of roundels in a view: four determine a homography, more reveal outliers.
pub const MIN_ROUNDELS: usize = 8;

/// One of the board's roundels in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Number of its code.
    pub number: u16,
    /// Centre of the ellipse of its outer rim, raw pixels.
    pub center: PixelPoint,
    /// Geometric mean of the ellipse's semiaxes, pixels.
    pub radius_px: f64,
}

/// A board in one picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct View {
    /// Roundels with codes of the board's family, each once. Numbers beyond the board's indicate another print.
    pub sightings: Vec<Sighting>,
    /// Standard deviation of the blur across the rims, pixels; `None` if it was not measured.
    pub blur_px: Option<f64>,
}

impl View {
    /// View of the rings that may belong to the board. A number that was read twice is left out.
    pub fn of_rings(board: &Board, frame: &Frame<'_>, rings: &[Ring]) -> Self {
        let candidates = rings.iter().filter_map(|ring| {
            let code = ring.code?.code;
            board.has_bits_of(code).then_some((code.number, ring))
        });
        let blur_px = blur_px(frame, candidates.clone().map(|(_, ring)| ring));
        let sighting = |(number, Ring { outer, .. }): (u16, &Ring)| Sighting {
            number,
            center: outer.center,
            radius_px: outer.mean_radius_px(),
        };
        let mut sightings: Vec<Sighting> = candidates.map(sighting).collect();
        sightings.sort_by_key(|sighting| sighting.number);
        let by_number = sightings.chunk_by(|one, other| one.number == other.number);
        let once = by_number.filter(|same| same.len() == 1);
        Self { sightings: once.flatten().copied().collect(), blur_px }
    }

    /// Convex hull of the centres, raw pixels; empty for fewer than three.
    pub fn outline(&self) -> Vec<PixelPoint> {
        let mut centers: Vec<PixelPoint> = self.sightings.iter().map(|it| it.center).collect();
        centers
            .sort_by(|point, other| point.u.total_cmp(&other.u).then(point.v.total_cmp(&other.v)));
        if centers.len() < 3 {
            return Vec::new();
        }
        // One half of the hull without its last point (Andrew 1979).
        let half = |centers: &mut dyn Iterator<Item = PixelPoint>| {
            let mut corners: Vec<PixelPoint> = Vec::new();
            for center in centers {
                while let [.., before, last] = corners[..]
                    && (last.u - before.u) * (center.v - before.v)
                        <= (last.v - before.v) * (center.u - before.u)
                {
                    corners.pop();
                }
                corners.push(center);
            }
            corners.pop();
            corners
        };
        let mut corners = half(&mut centers.iter().copied());
        corners.extend(half(&mut centers.iter().rev().copied()));
        corners
    }

    /// Rms distance of the common roundels, pixels; `None` if there are too few.
    pub(crate) fn distance_px(&self, other: &View) -> Option<f64> {
        let square = |sighting: &Sighting| {
            let index = other.sightings.binary_search_by_key(&sighting.number, |it| it.number);
            let (one, other) = (sighting.center, other.sightings[index.ok()?].center);
            Some((one.u - other.u).powi(2) + (one.v - other.v).powi(2))
        };
        let squares: Vec<f64> = self.sightings.iter().filter_map(square).collect();
        let mean = squares.iter().sum::<f64>() / squares.len() as f64;
        (squares.len() >= MIN_ROUNDELS).then(|| mean.sqrt())
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
    fn the_outline_is_the_convex_hull() {
        let sighting = |(number, (u, v)): (usize, (f64, f64))| Sighting {
            number: number as u16 + 1,
            center: PixelPoint { u, v },
            radius_px: 5.0,
        };
        let view = |centers: &[(f64, f64)]| View {
            sightings: centers.iter().copied().enumerate().map(sighting).collect(),
            ..View::default()
        };
        // A sheared grid of three by three; the points on its sides are no corners.
        let centers: Vec<(f64, f64)> = (0..9)
            .map(|index| (f64::from(index % 3), f64::from(index / 3)))
            .map(|(column, row)| (10.0 * column + 2.0 * row, 10.0 * row + column))
            .collect();
        let corners: Vec<_> = view(&centers).outline().iter().map(|it| (it.u, it.v)).collect();
        assert_eq!(corners, [(0.0, 0.0), (20.0, 2.0), (24.0, 22.0), (4.0, 20.0)]);
        assert!(view(&centers[..2]).outline().is_empty());
    }
}
