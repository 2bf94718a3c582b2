//! Projection of a roundel through the whole camera model.
//!
//! Both rims are projected point by point. The detector measures the ellipses with the same moments as the enclosed areas.

use nalgebra::{Point3, Vector3};

use super::Imaging;
use roundel_vision::{
    camera::Camera,
    ellipse::{Ellipse, Shape},
    marker::{Kind, Pattern, Ring},
    rigid::Rigid,
};

/// Points per rim: exact to a millionth of a pixel for smooth lenses.
const POINTS: usize = 24;
/// White margin that the detector requires around the ring, pixels.
pub const EDGE_PX: f64 = 2.0;
/// Unevenness of a ring's levels relative to the noise, since levels are means across the rim's width.
const UNEVEN_SHARE: f64 = 2.0 / 3.0;

/// Image of a roundel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoundelImage {
    /// Rims and levels.
    pub ring: Ring,
    /// Shorter diameter of the outer rim, pixels.
    pub minor_px: f64,
    /// Angle between normal and line of sight, radians.
    pub tilt_rad: f64,
    /// Whether the ring and its white margin are completely in the picture.
    pub is_complete: bool,
}

/// Projects a roundel; `None` if it faces away or is outside of the lens model's range.
pub fn image_roundel(
    camera: &Camera,
    kind: &Kind,
    imaging: &Imaging,
    camera_from_roundel: &Rigid,
) -> Option<RoundelImage> {
    let center_m = camera_from_roundel.translation.vector;
    let normal = camera_from_roundel.rotation * Vector3::z();
    if normal.dot(&center_m) >= 0.0 {
        return None;
    }
    let outer_m = 0.5 * kind.outer_diameter_m;
    let along_m = 0.5 * kind.inner_diameter_m;
    let across_m = match kind.pattern {
        Pattern::Elliptical { minor_diameter_m } => 0.5 * minor_diameter_m,
        Pattern::Plain | Pattern::Coded(_) => along_m,
    };
    let outer = rim(camera, camera_from_roundel, [outer_m; 2])?;
    let inner = rim(camera, camera_from_roundel, [along_m, across_m])?;
    let ring = Ring {
        black: imaging.black,
        white: imaging.white,
        unevenness: UNEVEN_SHARE * imaging.noise / imaging.contrast(),
        polarity: kind.polarity,
        ..Ring::of_rims(outer, inner)
    };
    let (half_u, half_v) = outer.half_box_px();
    let (reach_u, reach_v) = (half_u + EDGE_PX, half_v + EDGE_PX);
    let (width, height) = (camera.width() as f64, camera.height() as f64);
    let fits =
        |middle: f64, reach: f64, side: f64| middle - reach >= -0.5 && middle + reach <= side - 0.5;
    let is_complete = fits(outer.center.u, reach_u, width) && fits(outer.center.v, reach_v, height);
    let tilt_rad = normal.angle(&-center_m);
    Some(RoundelImage { ring, minor_px: 2.0 * outer.semi_minor_px, tilt_rad, is_complete })
}

/// Ellipse of a rim with these semiaxes.
fn rim(camera: &Camera, camera_from_roundel: &Rigid, [a_m, b_m]: [f64; 2]) -> Option<Ellipse> {
    let step = std::f64::consts::TAU / POINTS as f64;
    let mut points = [[0.0; 4]; POINTS];
    for (index, point) in points.iter_mut().enumerate() {
        let (sin, cos) = (index as f64 * step).sin_cos();
        let place = camera_from_roundel * Point3::new(a_m * cos, b_m * sin, 0.0);
        let ahead = camera_from_roundel.rotation * Vector3::new(-a_m * sin, b_m * cos, 0.0);
        let (pixel, by_place) = camera.project_with_jacobian(&place.coords).ok()?;
        let moved = by_place * ahead * step;
        *point = [pixel.u, pixel.v, moved.x, moved.y];
    }
    let mut ellipse = Shape::of_contour(points.iter().copied()).ellipse();
    // For a circle, rounding decides which axis is longer.
    ellipse.semi_minor_px = ellipse.semi_minor_px.min(ellipse.semi_major_px);
    ellipse.is_valid().then_some(ellipse)
}
