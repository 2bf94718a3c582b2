//! Rims as imaged: ellipses, from the moments of a segment.

use crate::camera::PixelPoint;

/// A rim as imaged, in raw pixels; see [`crate::conventions`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipse {
    /// Centre of the ellipse.
    pub center: PixelPoint,
    /// Longer semiaxis, pixels.
    pub semi_major_px: f64,
    /// Shorter semiaxis, pixels.
    pub semi_minor_px: f64,
    /// Major axis against +u, growing towards +v, radians in (-π/2, π/2].
    pub angle_rad: f64,
}
