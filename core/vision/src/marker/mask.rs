//! Regions of a camera's frames where no roundel is reported: reflections, posters, a neighbour's
//! arena.
//!
//! The roundel's centre decides: if it lies in a masked region, the roundel is neither measured in the search nor tracked.
//! A roundel that only extends into such a region is unaffected. The mask is tested first, so a masked region costs no
//! more than an empty one.

use thiserror::Error;

use crate::camera::PixelPoint;

/// Polygons in raw pixels; empty by default.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mask {
    polygons: Vec<Polygon>,
}

#[derive(Clone, Debug, PartialEq)]
struct Polygon {
    corners: Vec<PixelPoint>,
    /// Bounding box: smallest and largest u and v.
    low: PixelPoint,
    high: PixelPoint,
}

/// Why corners do not form a polygon.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum MaskError {
    /// Too few corners.
    #[error("mask polygon {polygon}: expected at least 3 corners, found {found}")]
    Corners {
        /// Index of the polygon.
        polygon: usize,
        /// Number of corners.
        found: usize,
    },
    /// A corner with a coordinate that is not finite.
    #[error("mask polygon {polygon}: expected finite pixels, found ({}, {})", found.u, found.v)]
    NotFinite {
        /// Index of the polygon.
        polygon: usize,
        /// The corner.
        found: PixelPoint,
    },
}

impl Mask {
    /// The union of polygons, each closed from its last corner to its first, by the even-odd rule.
    /// Corners may lie outside the frame.
    pub fn of_polygons(polygons: &[Vec<PixelPoint>]) -> Result<Self, MaskError> {
        let polygons = polygons.iter().enumerate().map(|(polygon, corners)| {
            if corners.len() < 3 {
                return Err(MaskError::Corners { polygon, found: corners.len() });
            }
            let wrong = corners.iter().find(|at| !at.u.is_finite() || !at.v.is_finite());
            if let Some(&found) = wrong {
                return Err(MaskError::NotFinite { polygon, found });
            }
            let (mut low, mut high) = (corners[0], corners[0]);
            for at in corners {
                low = PixelPoint { u: low.u.min(at.u), v: low.v.min(at.v) };
                high = PixelPoint { u: high.u.max(at.u), v: high.v.max(at.v) };
            }
            Ok(Polygon { corners: corners.clone(), low, high })
        });
        Ok(Self { polygons: polygons.collect::<Result<_, _>>()? })
    }

    /// Whether a point lies in a masked region.
    pub fn covers(&self, point: PixelPoint) -> bool {
        self.polygons.iter().any(|polygon| polygon.contains(point))
    }
}

impl Polygon {
    fn contains(&self, at: PixelPoint) -> bool {
        let (low, high) = (self.low, self.high);
        if at.u < low.u || at.u > high.u || at.v < low.v || at.v > high.v {
            return false;
        }
        let before = self.corners.iter().cycle().skip(self.corners.len() - 1);
        let crossed = self.corners.iter().zip(before).filter(|(a, b)| {
            // A ray towards +u crosses the edges with one end above it and one below.
            (a.v > at.v) != (b.v > at.v) && at.u < a.u + (at.v - a.v) * (b.u - a.u) / (b.v - a.v)
        });
        crossed.count() % 2 == 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corners(corners: &[(f64, f64)]) -> Vec<PixelPoint> {
        corners.iter().map(|&(u, v)| PixelPoint { u, v }).collect()
    }

    #[test]
    fn a_point_is_covered_by_any_polygon() {
        // An L, and a triangle that extends beyond the frame.
        let l = corners(&[(10., 10.), (30., 10.), (30., 20.), (20., 20.), (20., 40.), (10., 40.)]);
        let triangle = corners(&[(50.0, 50.0), (90.0, 50.0), (50.0, -30.0)]);
        let mask = Mask::of_polygons(&[l, triangle]).unwrap();
        for (u, v, inside) in [
            (15.0, 15.0, true),
            (25.0, 15.0, true),
            (15.0, 35.0, true),
            (25.0, 30.0, false),
            (9.9, 15.0, false),
            (51.0, 0.0, true),
            (51.0, -40.0, false),
            (89.0, 40.0, false),
            (f64::NAN, 15.0, false),
        ] {
            assert_eq!(mask.covers(PixelPoint { u, v }), inside, "{u} {v}");
        }
        assert!(!Mask::default().covers(PixelPoint { u: 15.0, v: 15.0 }));
    }

    #[test]
    fn errors_of_invalid_corners_name_them() {
        let fine = corners(&[(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]);
        let error = Mask::of_polygons(&[fine.clone(), corners(&[(0.0, 0.0), (1.0, 0.0)])]);
        assert_eq!(error, Err(MaskError::Corners { polygon: 1, found: 2 }));
        let wrong = corners(&[(0.0, 0.0), (1.0, f64::INFINITY), (0.0, 1.0)]);
        let error = Mask::of_polygons(&[fine, wrong]).unwrap_err().to_string();
        assert_eq!(error, "mask polygon 1: expected finite pixels, found (1, inf)");
    }
}
