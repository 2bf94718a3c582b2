//! Cameras: from points in the camera frame to raw pixels and back.
//!
//! Pixels are u = fx x″ + cx, v = fy y″ + cy, with (x″, y″) from the [`Lens`]. The inverse is Newton's
//! method on the full two-dimensional model, exact to 1e-12 of a focal length over the whole image
//! (`camera::tests`, and OpenCV's numbers in `tests/golden.rs`). A point that the camera cannot see,
//! or a pixel that no ray reaches, is a [`LensError`], never a wrong number.

mod lens;
mod nearby_rays;

use nalgebra::{Matrix2x3, Vector2, Vector3};
use thiserror::Error;

pub use lens::Lens;
pub(crate) use nearby_rays::NearRays;

/// Largest width or height of an image; sums of moments are exact up to this size.
pub const MAX_SIDE_PX: usize = 16_384;

/// A raw, distorted point of the image; see [`crate::conventions`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PixelPoint {
    /// Column, to the right, pixels.
    pub u: f64,
    /// Row, downwards, pixels.
    pub v: f64,
}

/// An undistorted point of the image, on the plane z = 1 of the camera frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NormalizedPoint {
    /// x / z.
    pub x: f64,
    /// y / z.
    pub y: f64,
}

/// A camera's calibration; [`Camera::new`] checks it.
#[derive(Clone, Debug, PartialEq)]
pub struct Intrinsics {
    /// Columns, pixels.
    pub width: usize,
    /// Rows, pixels.
    pub height: usize,
    /// Focal length along u, pixels.
    pub fx_px: f64,
    /// Focal length along v, pixels.
    pub fy_px: f64,
    /// Principal point, column, pixels.
    pub cx_px: f64,
    /// Principal point, row, pixels.
    pub cy_px: f64,
    /// Distortion.
    pub lens: Lens,
}

/// A camera that projects: checked intrinsics and the reach of the lens model.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    intrinsics: Intrinsics,
    reach: f64,
}

/// Why intrinsics are invalid.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum CameraError {
    /// A side is zero or too long for a frame.
    #[error("{field}: expected 1 to {MAX_SIDE_PX} pixels, found {found}")]
    Size {
        /// `width` or `height`.
        field: &'static str,
        /// The value given.
        found: usize,
    },
    /// A focal length is not a positive number.
    #[error("{field}: expected a positive number of pixels, found {found}")]
    Focal {
        /// `fx_px` or `fy_px`.
        field: &'static str,
        /// The value given.
        found: f64,
    },
    /// The principal point is not a number.
    #[error("{field}: expected a finite number of pixels, found {found}")]
    Center {
        /// `cx_px` or `cy_px`.
        field: &'static str,
        /// The value given.
        found: f64,
    },
    /// A distortion coefficient is not a number.
    #[error("lens {lens}: expected finite coefficients, found {found} as number {index} (from 0)")]
    Coefficient {
        /// The model's ROS name.
        lens: &'static str,
        /// Which coefficient, from 0, in ROS' order.
        index: usize,
        /// The value given.
        found: f64,
    },
}

/// Why a point has no image, or a pixel no ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum LensError {
    /// A coordinate is not a number.
    #[error("expected finite coordinates")]
    NotFinite,
    /// Behind the camera, or with an angle from the axis that has no point on the plane z = 1.
    #[error("expected a point in front of the camera, found one behind it")]
    Behind,
    /// Beyond the reach of the lens model.
    #[error("expected a point within the lens model's reach, found one outside")]
    Outside,
}

impl Camera {
    /// Checks intrinsics: sides of 1 to [`MAX_SIDE_PX`], positive finite focal lengths,
    /// the rest finite. The error names the field.
    pub fn new(intrinsics: Intrinsics) -> Result<Self, CameraError> {
        for (field, found) in [("width", intrinsics.width), ("height", intrinsics.height)] {
            if found == 0 || found > MAX_SIDE_PX {
                return Err(CameraError::Size { field, found });
            }
        }
        for (field, found) in [("fx_px", intrinsics.fx_px), ("fy_px", intrinsics.fy_px)] {
            if !(found.is_finite() && found > 0.0) {
                return Err(CameraError::Focal { field, found });
            }
        }
        for (field, found) in [("cx_px", intrinsics.cx_px), ("cy_px", intrinsics.cy_px)] {
            if !found.is_finite() {
                return Err(CameraError::Center { field, found });
            }
        }
        for (index, &found) in intrinsics.lens.coefficients().iter().enumerate() {
            if !found.is_finite() {
                let lens = intrinsics.lens.name();
                return Err(CameraError::Coefficient { lens, index, found });
            }
        }
        let reach = intrinsics.lens.reach();
        Ok(Self { intrinsics, reach })
    }

    /// The intrinsics it was created with.
    pub fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// Columns, pixels.
    pub fn width(&self) -> usize {
        self.intrinsics.width
    }

    /// Rows, pixels.
    pub fn height(&self) -> usize {
        self.intrinsics.height
    }

    /// Whether a point lies on the image, [-0.5, width - 0.5] × [-0.5, height - 0.5].
    pub fn contains(&self, point: PixelPoint) -> bool {
        (-0.5..=self.intrinsics.width as f64 - 0.5).contains(&point.u)
            && (-0.5..=self.intrinsics.height as f64 - 0.5).contains(&point.v)
    }

    /// Pixel of a point of the camera frame, metres; it may lie off the image.
    pub fn project(&self, point_m: &Vector3<f64>) -> Result<PixelPoint, LensError> {
        let (image, _) = self.intrinsics.lens.project(self.reach, point_m)?;
        Ok(self.to_pixel(&image))
    }

    /// As [`Camera::project`], with the derivative of (u, v) by the point, pixels per metre.
    pub fn project_with_jacobian(
        &self,
        point_m: &Vector3<f64>,
    ) -> Result<(PixelPoint, Matrix2x3<f64>), LensError> {
        let (image, mut jacobian) = self.intrinsics.lens.project(self.reach, point_m)?;
        jacobian.row_mut(0).scale_mut(self.intrinsics.fx_px);
        jacobian.row_mut(1).scale_mut(self.intrinsics.fy_px);
        Ok((self.to_pixel(&image), jacobian))
    }

    /// The pixel of an undistorted point.
    pub fn distort(&self, point: NormalizedPoint) -> Result<PixelPoint, LensError> {
        self.project(&Vector3::new(point.x, point.y, 1.0))
    }

    /// The undistorted point of a pixel. [`LensError::Behind`] for rays 90° and more from the axis
    /// (`equidistant` only), which [`Camera::bearing`] gives.
    pub fn undistort(&self, pixel: PixelPoint) -> Result<NormalizedPoint, LensError> {
        let ray = self.intrinsics.lens.ray(self.reach, &self.to_image(pixel))?.direction;
        if ray.z <= 0.0 {
            return Err(LensError::Behind);
        }
        Ok(NormalizedPoint { x: ray.x / ray.z, y: ray.y / ray.z })
    }

    /// Unit vector in the camera frame along the ray of a pixel.
    pub fn bearing(&self, pixel: PixelPoint) -> Result<Vector3<f64>, LensError> {
        Ok(self.intrinsics.lens.ray(self.reach, &self.to_image(pixel))?.direction.normalize())
    }

    fn to_pixel(&self, image: &Vector2<f64>) -> PixelPoint {
        PixelPoint {
            u: self.intrinsics.fx_px * image.x + self.intrinsics.cx_px,
            v: self.intrinsics.fy_px * image.y + self.intrinsics.cy_px,
        }
    }

    fn to_image(&self, pixel: PixelPoint) -> Vector2<f64> {
        Vector2::new(
            (pixel.u - self.intrinsics.cx_px) / self.intrinsics.fx_px,
            (pixel.v - self.intrinsics.cy_px) / self.intrinsics.fy_px,
        )
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    pub fn camera(lens: Lens) -> Camera {
        Camera::new(Intrinsics {
            width: 1280,
            height: 720,
            fx_px: 700.0,
            fy_px: 710.0,
            cx_px: 645.0,
            cy_px: 352.0,
            lens,
        })
        .unwrap()
    }

    pub fn lenses() -> [Lens; 6] {
        [
            Lens::PlumbBob([0.0; 5]),
            Lens::PlumbBob([-0.28, 0.09, 0.0012, -0.0008, -0.012]),
            Lens::PlumbBob([0.35, 0.12, -0.002, 0.003, 0.05]),
            Lens::Rational([8.1, 5.2, 0.0004, -0.0002, 0.21, 8.4, 8.0, 1.3]),
            Lens::Equidistant([0.0; 4]),
            Lens::Equidistant([-0.02, 0.011, -0.007, 0.0013]),
        ]
    }

    proptest! {
        #[test]
        fn pixels_round_trip(u in -0.5..1279.5f64, v in -0.5..719.5f64) {
            for lens in lenses() {
                let camera = camera(lens);
                let pixel = PixelPoint { u, v };
                let bearing = camera.bearing(pixel).unwrap();
                prop_assert!((bearing.norm() - 1.0).abs() < 1e-14);
                let back = camera.project(&(bearing * 3.7)).unwrap();
                prop_assert!((back.u - u).abs() < 1e-9 && (back.v - v).abs() < 1e-9, "{lens:?} {back:?}");
                let flat = camera.undistort(pixel).unwrap();
                let back = camera.distort(flat).unwrap();
                prop_assert!((back.u - u).abs() < 1e-9 && (back.v - v).abs() < 1e-9, "{lens:?} {back:?}");
            }
        }

        #[test]
        fn visible_points_round_trip(x in -1.0..1.0f64, y in -0.6..0.6f64, z in 0.2..20.0f64) {
            for lens in lenses() {
                let camera = camera(lens);
                let point = NormalizedPoint { x: 0.7 * x, y: 0.7 * y };
                let pixel = camera.project(&(Vector3::new(point.x, point.y, 1.0) * z)).unwrap();
                let back = camera.undistort(pixel).unwrap();
                prop_assert!((back.x - point.x).abs() < 1e-12 && (back.y - point.y).abs() < 1e-12, "{lens:?}");
            }
        }

        #[test]
        fn jacobians_are_finite_differences(x in -0.5..0.5f64, y in -0.4..0.4f64, z in 0.5..3.0f64) {
            for lens in lenses() {
                let camera = camera(lens);
                let point = Vector3::new(x * z, y * z, z);
                let (_, jacobian) = camera.project_with_jacobian(&point).unwrap();
                for axis in 0..3 {
                    let mut step = Vector3::zeros();
                    step[axis] = 1e-6;
                    let (a, b) =
                        (camera.project(&(point + step)).unwrap(), camera.project(&(point - step)).unwrap());
                    prop_assert!((jacobian[(0, axis)] - (a.u - b.u) / 2e-6).abs() < 1e-4);
                    prop_assert!((jacobian[(1, axis)] - (a.v - b.v) / 2e-6).abs() < 1e-4);
                }
            }
        }

        #[test]
        fn fisheyes_project_points_behind_the_camera(angle_rad in 0.0..3.0f64, turn_rad in -3.1..3.1f64) {
            let camera = camera(Lens::Equidistant([0.01, 0.002, 0.0, 0.0]));
            let (sin, cos) = angle_rad.sin_cos();
            let bearing = Vector3::new(sin * turn_rad.cos(), sin * turn_rad.sin(), cos);
            let pixel = camera.project(&bearing).unwrap();
            prop_assert!((camera.bearing(pixel).unwrap() - bearing).norm() < 1e-12);
            prop_assert_eq!(camera.undistort(pixel).is_ok(), camera.bearing(pixel).unwrap().z > 0.0);
        }
    }

    #[test]
    fn nothing_is_projected_beyond_the_reach() {
        // r (1 - 0.3 r²) grows up to r = 1 / √0.9 only.
        let camera = camera(Lens::PlumbBob([-0.3, 0.0, 0.0, 0.0, 0.0]));
        let edge = 1.0 / 0.9f64.sqrt();
        assert!(camera.project(&Vector3::new(0.999 * edge, 0.0, 1.0)).is_ok());
        assert_eq!(camera.project(&Vector3::new(1.001 * edge, 0.0, 1.0)), Err(LensError::Outside));
        let image_edge_px = 700.0 * edge * 2.0 / 3.0;
        let pixel = |radius_px: f64| PixelPoint { u: 645.0 + radius_px, v: 352.0 };
        let inside = camera.undistort(pixel(0.999 * image_edge_px)).unwrap();
        assert!(
            inside.x < edge
                && (camera.distort(inside).unwrap().u - 645.0 - 0.999 * image_edge_px).abs() < 1e-9
        );
        assert_eq!(camera.undistort(pixel(1.001 * image_edge_px)), Err(LensError::Outside));
        assert_eq!(camera.bearing(pixel(1e9)), Err(LensError::Outside));
    }

    #[test]
    fn invisible_points_are_errors() {
        let camera = camera(Lens::PlumbBob([0.0; 5]));
        assert_eq!(camera.project(&Vector3::new(0.0, 0.0, -1.0)), Err(LensError::Behind));
        assert_eq!(camera.project(&Vector3::zeros()), Err(LensError::Behind));
        assert_eq!(camera.project(&Vector3::new(f64::NAN, 0.0, 1.0)), Err(LensError::NotFinite));
        assert_eq!(
            camera.bearing(PixelPoint { u: f64::INFINITY, v: 0.0 }),
            Err(LensError::NotFinite)
        );
        assert!(!camera.contains(PixelPoint { u: -0.6, v: 0.0 }));
        assert!(camera.contains(PixelPoint { u: 1279.4, v: 719.4 }));
    }

    #[test]
    fn errors_of_invalid_intrinsics_name_the_field() {
        let good = camera(Lens::PlumbBob([0.0; 5])).intrinsics().clone();
        let refused = |change: &dyn Fn(&mut Intrinsics)| {
            let mut intrinsics = good.clone();
            change(&mut intrinsics);
            Camera::new(intrinsics).unwrap_err().to_string()
        };
        assert_eq!(refused(&|i| i.width = 0), "width: expected 1 to 16384 pixels, found 0");
        assert_eq!(
            refused(&|i| i.fy_px = -1.0),
            "fy_px: expected a positive number of pixels, found -1"
        );
        assert!(refused(&|i| i.cx_px = f64::NAN).starts_with("cx_px: expected a finite"));
        assert_eq!(
            refused(&|i| i.lens = Lens::Equidistant([0.0, 0.0, f64::INFINITY, 0.0])),
            "lens equidistant: expected finite coefficients, found inf as number 2 (from 0)"
        );
    }
}
