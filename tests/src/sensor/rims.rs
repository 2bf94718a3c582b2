//! Rims of a roundel in the image: the ellipse with the area, the centroid and the second moments of the imaged disc.

use nalgebra::{Isometry3, Matrix2, Point3, Vector2};
use roundel_core::{camera::PixelPoint, ellipse::Ellipse};

use crate::optics::Pinhole;

/// Corners of the rim.
const CORNERS: usize = 48;

/// The imaged rim of this diameter, or `None` where the camera cannot see it.
pub(super) fn imaged(
    optics: &Pinhole,
    camera_from_roundel: &Isometry3<f64>,
    diameter_m: f64,
) -> Option<Ellipse> {
    let step_rad = std::f64::consts::TAU / CORNERS as f64;
    // A polygon of the circle's area.
    let radius_m = 0.5 * diameter_m * (step_rad / step_rad.sin()).sqrt();
    let middle = optics.project(&Point3::from(camera_from_roundel.translation.vector))?;
    let corner = |index: usize| {
        let (sin, cos) = (step_rad * index as f64).sin_cos();
        let at = camera_from_roundel * Point3::new(radius_m * cos, radius_m * sin, 0.0);
        Some(optics.project(&at)? - middle)
    };
    let corners: Vec<Vector2<f64>> = (0..CORNERS).map(corner).collect::<Option<_>>()?;
    let (mut area, mut moment, mut spread) = (0.0, Vector2::zeros(), Matrix2::zeros());
    for (index, one) in corners.iter().enumerate() {
        let other = corners[(index + 1) % CORNERS];
        let twice = one.perp(&other);
        area += twice / 2.0;
        moment += (one + other) * (twice / 6.0);
        let sum = one + other;
        spread += (one * one.transpose() + other * other.transpose() + sum * sum.transpose())
            * (twice / 24.0);
    }
    let center = moment / area;
    let spread = spread / area - center * center.transpose();
    let eigen = spread.symmetric_eigen();
    let (major, minor) = (eigen.eigenvalues.imax(), eigen.eigenvalues.imin());
    let axis = eigen.eigenvectors.column(major);
    // An ellipse's variance along an axis is a quarter of its semiaxis squared.
    Some(Ellipse {
        center: PixelPoint { u: middle.x + center.x, v: middle.y + center.y },
        semi_major_px: 2.0 * eigen.eigenvalues[major].sqrt(),
        semi_minor_px: 2.0 * eigen.eigenvalues[minor].sqrt(),
        angle_rad: axis.y.atan2(axis.x),
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::{Translation3, UnitQuaternion, Vector3};

    use super::*;
    use crate::optics::Distortion;

    #[test]
    fn a_tilted_rim_is_the_ellipse_of_its_outermost_points() {
        let optics = Pinhole::centered(1281, 721, 1000.0, Distortion::NONE);
        let turn = UnitQuaternion::from_scaled_axis(Vector3::y() * 0.7);
        let pose = Isometry3::from_parts(Translation3::new(0.0, 0.0, 0.5), turn);
        let rim = imaged(&optics, &pose, 0.1).unwrap();
        let end = |x: f64| optics.project(&(pose * Point3::new(x, 0.0, 0.0))).unwrap().x;
        let (one, other) = (end(0.05), end(-0.05));
        assert!((rim.center.u - 0.5 * (one + other)).abs() < 0.01, "{rim:?} {one} {other}");
        assert!((rim.center.v - 360.0).abs() < 1e-9, "{rim:?}");
        assert!((rim.semi_minor_px - 0.5 * (one - other).abs()).abs() < 0.05, "{rim:?}");
        assert!(rim.semi_major_px > rim.semi_minor_px && rim.angle_rad.cos().abs() < 1e-6);
    }
}
