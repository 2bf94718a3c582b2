//! Image of a circle: centroid and area of the region that its rim encloses.
//!
//! For the rim's image (x(φ), y(φ)) the area is A = ½∮(x dy - y dx) and the centroid (∮ x² dy, -∮ y² dx) / 2A. The
//! integrands are smooth and periodic, so sums over equal steps of φ converge faster than any power; [`SAMPLES`] steps
//! reach a thousandth of a pixel.

use nalgebra::{Isometry3, Point2, Point3, Vector2, Vector3};

use roundel_vision::camera::{Camera, LensError};

const SAMPLES: usize = 16;

pub(crate) struct RimImage {
    /// Centroid minus the image of the circle's centre, pixels.
    pub offset_px: Vector2<f64>,
    /// Radius of the circle with the same area, pixels.
    pub radius_px: f64,
}

/// Projects a circle of `radius_m` around `disc_center` on the board's plane.
pub(crate) fn project_rim(
    camera: &Camera,
    pose: &Isometry3<f64>,
    disc_center: &Point2<f64>,
    radius_m: f64,
) -> Result<RimImage, LensError> {
    let center = camera.project(&(pose * Point3::new(disc_center.x, disc_center.y, 0.0)).coords)?;
    let (mut area, mut moment_u, mut moment_v) = (0.0, 0.0, 0.0);
    for sample in 0..SAMPLES {
        let (sin, cos) = (std::f64::consts::TAU * sample as f64 / SAMPLES as f64).sin_cos();
        let at =
            pose * Point3::new(disc_center.x + radius_m * cos, disc_center.y + radius_m * sin, 0.0);
        let tangent = pose.rotation * Vector3::new(-radius_m * sin, radius_m * cos, 0.0);
        let (pixel, jacobian) = camera.project_with_jacobian(&at.coords)?;
        let slope = jacobian * tangent;
        // Relative to the centre, to keep digits in the squares.
        let (u, v) = (pixel.u - center.u, pixel.v - center.v);
        area += 0.5 * (u * slope.y - v * slope.x);
        moment_u += 0.5 * u * u * slope.y;
        moment_v -= 0.5 * v * v * slope.x;
    }
    let step_rad = std::f64::consts::TAU / SAMPLES as f64;
    let radius_px = (area.abs() * step_rad / std::f64::consts::PI).sqrt();
    Ok(RimImage { offset_px: Vector2::new(moment_u, moment_v) / area, radius_px })
}

#[cfg(test)]
mod tests {
    use nalgebra::{Translation3, UnitQuaternion};

    use super::*;
    use crate::test_world;
    use roundel_vision::camera::Lens;

    #[test]
    fn the_centroid_of_a_tilted_circle_is_its_ellipses_centre() {
        let lens = Lens::PlumbBob([0.0; 5]);
        let camera = test_world::camera((1280, 720), [1000.0, 1000.0, 640.0, 360.0], lens);
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.7);
        let pose = Isometry3::from_parts(Translation3::new(0.0, 0.0, 0.5), rotation);
        let radius_m = 0.05;
        let found = project_rim(&camera, &pose, &Point2::origin(), radius_m).unwrap();
        let (u, v) = (found.offset_px.x, found.offset_px.y);
        // The ends of the axis along u are images of the circle's own ends.
        let end = |x: f64| camera.project(&(pose * Point3::new(x, 0.0, 0.0)).coords).unwrap().u;
        let expected = 0.5 * (end(radius_m) + end(-radius_m)) - end(0.0);
        assert!(expected.abs() > 1.0, "{expected}");
        assert!((u - expected).abs() < 1e-6 && v.abs() < 1e-9, "{u} {v}, {expected}");
        // The other axis lies across, both of its ends as far away as its middle.
        let (near_px, far_px) = (end(-radius_m), end(radius_m));
        let along_px = 0.5 * (near_px - far_px).abs();
        let middle_m = 0.5 * (near_px + far_px) - 640.0;
        let slant = |x: f64| 0.5 - x * 0.7f64.sin();
        let x_m = middle_m * 1e-3 * 0.5 / (0.7f64.cos() + middle_m * 1e-3 * 0.7f64.sin());
        let across_px = 1000.0 * (radius_m * radius_m - x_m * x_m).sqrt() / slant(x_m);
        let expected_px = (along_px * across_px).sqrt();
        assert!((found.radius_px - expected_px).abs() < 1e-6, "{} {expected_px}", found.radius_px);
    }
}
