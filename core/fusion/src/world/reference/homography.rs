//! The 2D case: from undistorted image points directly to a plane of the world (section 4.4.2).
//!
//! Fusion locates ground robots with a filter that is constrained to the floor
//! ([`MotionClass::Ground`](crate::world::MotionClass)), which is equally precise: within 3 % either way on the same
//! observations (`tests/src/scenario/plane.rs`, with the figures). A homography needs neither the focal length nor the
//! camera's pose, but serves one plane and one camera only.

use nalgebra::{Matrix3, SMatrix, SVector, SymmetricEigen, Vector2};
use thiserror::Error;

use roundel_vision::camera::NormalizedPoint;

/// Maps undistorted image points to a plane of the world.
#[derive(Clone, Debug, PartialEq)]
pub struct Homography {
    plane_from_image: Matrix3<f64>,
    /// Root mean square distance of the given points from their mapped images, metres.
    pub rms_m: f64,
}

/// Reason why points give no homography.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum HomographyError {
    /// Fewer than four points.
    #[error(
        "expected at least 4 points of the plane, each with its image, found {plane} and {image}"
    )]
    TooFew {
        /// Points of the plane.
        plane: usize,
        /// Their images.
        image: usize,
    },
    /// A coordinate is not finite.
    #[error("point {index}: expected finite coordinates")]
    NotFinite {
        /// Index of the point.
        index: usize,
    },
    /// Three of four points on one line, or points that coincide.
    #[error("expected 4 points of which no 3 are in one line, found fewer; place another")]
    Degenerate,
}

/// Smallest ratio of the second smallest eigenvalue of the normalized design to the largest; below it the
/// solution is not unique.
const DEGENERATE: f64 = 1e-7;

impl Homography {
    /// From four or more points of the plane (x, y, metres) and their images, by the direct linear transform on
    /// normalized coordinates (Hartley 1997).
    pub fn new(
        plane_m: &[Vector2<f64>],
        image: &[NormalizedPoint],
    ) -> Result<Self, HomographyError> {
        if plane_m.len() < 4 || plane_m.len() != image.len() {
            return Err(HomographyError::TooFew { plane: plane_m.len(), image: image.len() });
        }
        let image_points: Vec<_> = image.iter().map(|p| Vector2::new(p.x, p.y)).collect();
        for (index, (a, b)) in plane_m.iter().zip(&image_points).enumerate() {
            if !a.iter().chain(b.iter()).all(|value| value.is_finite()) {
                return Err(HomographyError::NotFinite { index });
            }
        }
        let to_unit_plane = normalization(plane_m).ok_or(HomographyError::Degenerate)?;
        let to_unit_image = normalization(&image_points).ok_or(HomographyError::Degenerate)?;
        let mut design = SMatrix::<f64, 9, 9>::zeros();
        for (plane, image_point) in plane_m.iter().zip(&image_points) {
            let p = to_unit_plane * plane.push(1.0);
            let s = to_unit_image * image_point.push(1.0);
            // First two rows of p × (H s) = 0.
            let mut rows = [SVector::<f64, 9>::zeros(), SVector::<f64, 9>::zeros()];
            for k in 0..3 {
                rows[0][k] = s[k];
                rows[0][6 + k] = -p.x * s[k];
                rows[1][3 + k] = s[k];
                rows[1][6 + k] = -p.y * s[k];
            }
            design += rows[0] * rows[0].transpose() + rows[1] * rows[1].transpose();
        }
        let eigen = SymmetricEigen::new(design);
        let mut order: [usize; 9] = std::array::from_fn(|k| k);
        order.sort_by(|&i, &j| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[j]));
        let value = |rank: usize| eigen.eigenvalues[order[rank]];
        if value(1) <= DEGENERATE * value(8) {
            return Err(HomographyError::Degenerate);
        }
        let h = eigen.eigenvectors.column(order[0]);
        let unit = Matrix3::from_row_iterator(h.iter().copied());
        let from_unit_plane = to_unit_plane.try_inverse().ok_or(HomographyError::Degenerate)?;
        let mut plane_from_image = from_unit_plane * unit * to_unit_image;
        // The sign that makes the given points' third coordinate positive.
        let depth: f64 =
            image_points.iter().map(|s| (plane_from_image * s.push(1.0)).z.signum()).sum();
        if depth.abs() < image_points.len() as f64 - 0.5 {
            return Err(HomographyError::Degenerate);
        }
        plane_from_image *= depth.signum() / plane_from_image.norm();
        let mut found = Self { plane_from_image, rms_m: 0.0 };
        let mut squares = 0.0;
        for (plane, point) in plane_m.iter().zip(image) {
            let there = found.apply(*point).ok_or(HomographyError::Degenerate)?;
            squares += (there - plane).norm_squared();
        }
        found.rms_m = (squares / plane_m.len() as f64).sqrt();
        Ok(found)
    }

    /// Position of an image point on the plane, metres; `None` at and beyond the plane's horizon.
    pub fn apply(&self, point: NormalizedPoint) -> Option<Vector2<f64>> {
        let there = self.plane_from_image * nalgebra::Vector3::new(point.x, point.y, 1.0);
        (there.z > 0.0).then(|| there.xy() / there.z)
    }
}

/// Similarity that moves points to the origin with a mean distance of √2.
fn normalization(points: &[Vector2<f64>]) -> Option<Matrix3<f64>> {
    let n = points.len() as f64;
    let middle = points.iter().sum::<Vector2<f64>>() / n;
    let distance = points.iter().map(|p| (p - middle).norm()).sum::<f64>() / n;
    let scale = std::f64::consts::SQRT_2 / distance;
    scale.is_finite().then(|| {
        Matrix3::new(scale, 0.0, -scale * middle.x, 0.0, scale, -scale * middle.y, 0.0, 0.0, 1.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, Point3, Vector3};
    use proptest::prelude::*;

    fn image_of(point_m: &Vector2<f64>) -> NormalizedPoint {
        let camera_from_world =
            Isometry3::new(Vector3::new(0.2, 0.4, 4.5), Vector3::new(2.6, 0.1, -0.2));
        let there = camera_from_world * Point3::new(point_m.x, point_m.y, 0.3);
        NormalizedPoint { x: there.x / there.z, y: there.y / there.z }
    }

    fn corners() -> Vec<Vector2<f64>> {
        [[0.0, 0.0], [2.0, 0.1], [-0.1, 1.5], [2.0, 1.7]].map(Vector2::from).to_vec()
    }

    proptest! {
        #[test]
        fn the_plane_is_found_from_four_points(x in -1.0..3.0f64, y in -1.0..3.0f64) {
            let image: Vec<_> = corners().iter().map(image_of).collect();
            let homography = Homography::new(&corners(), &image).unwrap();
            prop_assert!(homography.rms_m < 1e-9);
            let point = Vector2::new(x, y);
            let found = homography.apply(image_of(&point)).unwrap();
            prop_assert!((found - point).norm() < 1e-9, "{found} {point}");
        }
    }

    #[test]
    fn points_beyond_the_horizon_are_rejected() {
        let image: Vec<_> = corners().iter().map(image_of).collect();
        let homography = Homography::new(&corners(), &image).unwrap();
        // The camera looks down at an angle: the horizon is far up in the image.
        let beyond = [-50.0, 50.0]
            .map(|y| homography.apply(NormalizedPoint { x: 0.0, y }))
            .iter()
            .filter(|there| there.is_none())
            .count();
        assert_eq!(beyond, 1);
    }

    #[test]
    fn too_few_or_collinear_points_are_rejected() {
        let image: Vec<_> = corners().iter().map(image_of).collect();
        assert_eq!(
            Homography::new(&corners()[..3], &image[..3]),
            Err(HomographyError::TooFew { plane: 3, image: 3 })
        );
        let line = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [0.5, 1.0]].map(Vector2::from);
        let image: Vec<_> = line.iter().map(image_of).collect();
        assert_eq!(Homography::new(&line, &image), Err(HomographyError::Degenerate));
        let mut broken = image.clone();
        broken[1].x = f64::INFINITY;
        assert_eq!(Homography::new(&line, &broken), Err(HomographyError::NotFinite { index: 1 }));
    }
}
