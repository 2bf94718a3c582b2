//! Where the centre of a circle's image lies, and how wide it is: the centroid and the area of what its rim surrounds.
//!
//! With the rim's image (x(φ), y(φ)), its area is A = ½∮(x dy - y dx) and its centroid
//! (∮ x² dy, -∮ y² dx) / 2A. The integrands are smooth and periodic, so equal steps of φ converge faster than any power;
//! [`STEPS`] give a thousandth of a pixel and better.

use nalgebra::{Isometry3, Point2, Point3, Vector3};

use roundel_vision::camera::{Camera, LensError};

const STEPS: usize = 16;

/// The image of a circle.
pub(crate) struct Image {
    /// The centroid less the image of the circle's centre, pixels.
    pub offset_px: (f64, f64),
    /// Radius of the circle with its area, pixels.
    pub radius_px: f64,
}

/// Of a circle of `radius_m` round `center`, on the board's plane.
pub(crate) fn image(
    camera: &Camera,
    pose: &Isometry3<f64>,
    center: &Point2<f64>,
    radius_m: f64,
) -> Result<Image, LensError> {
    let middle = camera.project(&(pose * Point3::new(center.x, center.y, 0.0)).coords)?;
    let (mut area, mut moment_u, mut moment_v) = (0.0, 0.0, 0.0);
    for step in 0..STEPS {
        let (sin, cos) = (std::f64::consts::TAU * step as f64 / STEPS as f64).sin_cos();
        let at = pose * Point3::new(center.x + radius_m * cos, center.y + radius_m * sin, 0.0);
        let along = pose.rotation * Vector3::new(-radius_m * sin, radius_m * cos, 0.0);
        let (pixel, jacobian) = camera.project_with_jacobian(&at.coords)?;
        let slope = jacobian * along;
        // From the middle, or squares would lose digits.
        let (u, v) = (pixel.u - middle.u, pixel.v - middle.v);
        area += 0.5 * (u * slope.y - v * slope.x);
        moment_u += 0.5 * u * u * slope.y;
        moment_v -= 0.5 * v * v * slope.x;
    }
    let step_rad = std::f64::consts::TAU / STEPS as f64;
    let radius_px = (area.abs() * step_rad / std::f64::consts::PI).sqrt();
    Ok(Image { offset_px: (moment_u / area, moment_v / area), radius_px })
}

#[cfg(test)]
mod tests {
    use nalgebra::{Translation3, UnitQuaternion};

    use super::*;
    use roundel_vision::camera::{Intrinsics, Lens};

    #[test]
    fn the_centroid_of_a_tilted_circle_is_its_ellipses_centre() {
        let camera = Camera::new(Intrinsics {
            width: 1280,
            height: 720,
            fx_px: 1000.0,
            fy_px: 1000.0,
            cx_px: 640.0,
            cy_px: 360.0,
            lens: Lens::PlumbBob([0.0; 5]),
        })
        .unwrap();
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.7);
        let pose = Isometry3::from_parts(Translation3::new(0.0, 0.0, 0.5), rotation);
        let radius_m = 0.05;
        let found = image(&camera, &pose, &Point2::origin(), radius_m).unwrap();
        let (u, v) = found.offset_px;
        // Of the ellipse the ends of the axis along u are images of the circle's.
        let end = |x: f64| camera.project(&(pose * Point3::new(x, 0.0, 0.0)).coords).unwrap().u;
        let expected = 0.5 * (end(radius_m) + end(-radius_m)) - end(0.0);
        assert!(expected.abs() > 1.0, "{expected}");
        assert!((u - expected).abs() < 1e-6 && v.abs() < 1e-9, "{u} {v}, {expected}");
        // Across it the other axis, of which both ends are as far as its middle.
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
