//! Cameras: from pixels to rays and back.

mod lens;

pub use lens::Lens;

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

/// Intrinsics and lens of one camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
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
