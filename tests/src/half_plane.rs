//! One side of a straight line in the image, and the part of a polygon there.

use nalgebra::Vector2;

/// The side that lies at the right hand of someone who looks along the line, in an image with v down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HalfPlane {
    /// A point of the line.
    pub through_px: [f64; 2],
    /// Direction of the line, from u towards v.
    pub heading_rad: f64,
}

impl HalfPlane {
    /// Distance from the line, positive inside.
    pub fn depth_px(&self, at: &Vector2<f64>) -> f64 {
        let (sin, cos) = self.heading_rad.sin_cos();
        Vector2::new(-sin, cos).dot(&(at - Vector2::from(self.through_px)))
    }

    /// The part of a closed polygon inside (Sutherland and Hodgman 1974). Parts of a polygon that is not convex are
    /// connected along the line by edges that cancel in an integral around it.
    pub fn clip(&self, points: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
        let mut part = Vec::with_capacity(points.len() + 8);
        let Some(mut before) = points.last() else { return part };
        for point in points {
            let (from_px, to_px) = (self.depth_px(before), self.depth_px(point));
            if (from_px < 0.0) != (to_px < 0.0) {
                part.push(before + (point - before) * (from_px / (from_px - to_px)));
            }
            if to_px >= 0.0 {
                part.push(*point);
            }
            before = point;
        }
        part
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_is_cut_at_the_line() {
        let square = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]].map(Vector2::from);
        let area = |half_plane: HalfPlane| {
            let part = half_plane.clip(&square);
            let next = |i: usize| part[(i + 1) % part.len()];
            0.5 * (0..part.len()).map(|i| part[i].perp(&next(i))).sum::<f64>()
        };
        let below = HalfPlane { through_px: [9.0, 1.0], heading_rad: 0.0 };
        assert!((area(below) - 12.0).abs() < 1e-12);
        let corner = HalfPlane { through_px: [0.0, 3.0], heading_rad: std::f64::consts::FRAC_PI_4 };
        assert!((area(corner) - 0.5).abs() < 1e-12);
        let all = HalfPlane { through_px: [0.0, -1.0], heading_rad: 0.0 };
        assert_eq!(all.clip(&square).len(), 4);
        let none = HalfPlane { through_px: [0.0, 5.0], heading_rad: 0.0 };
        assert!(none.clip(&square).is_empty());
    }
}
