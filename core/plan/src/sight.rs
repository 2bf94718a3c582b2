//! How a roundel is imaged, whether it would be found, and whether its code would be read.
//!
//! Both rims are carried through the whole camera model point by point, and the ellipses of the areas that they
//! enclose are what the detector measures of them. Found is what is wholly in the picture, wide enough and not tilted
//! too far: the detector's own limits ([`roundel_vision::marker::Params`]), and what blur and noise leave of them, tried on pictures
//! of such rings (`tried`).
//!
//! A coded ring is found several times as far as its teeth are read: who prints codes wants them read, so what counts
//! as covered is where they are ([`least_needed_px`], [`is_read`]).

use nalgebra::{Point3, Vector3};

use super::{Imaging, Sensor, tried};
use roundel_vision::{
    camera::Camera,
    ellipse::{Ellipse, Shape},
    marker::{Kind, Params, Pattern, Ring},
    rigid::Rigid,
};

/// Points of a rim: the ellipse is exact to a millionth of a pixel where the lens is smooth.
const POINTS: usize = 24;
/// White that the detector wants round the ring, pixels.
pub const EDGE_PX: f64 = 2.0;
/// Bits of a code, and the outer diameter from which it is read, pixels; of other codes by straight lines between.
const READ_PX: [(f64, f64); 4] = [(5.0, 30.0), (8.0, 36.0), (12.0, 60.0), (16.0, 90.0)];
/// A ring's levels stray by this share of the noise in them, since they are means over its rim's width.
const UNEVEN_SHARE: f64 = 2.0 / 3.0;

/// A roundel as a camera would image it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Its rims and levels.
    pub ring: Ring,
    /// Shorter diameter of the outer rim, pixels.
    pub minor_px: f64,
    /// Angle between normal and line of sight, radians.
    pub tilt_rad: f64,
    /// Whether the ring with its white edge is wholly in the picture.
    pub is_whole: bool,
}

/// How a camera images a roundel at a pose; `None` if it is not before the camera or not within the lens' reach.
pub fn sight(
    camera: &Camera,
    kind: &Kind,
    imaging: &Imaging,
    camera_from_roundel: &Rigid,
) -> Option<Sighting> {
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
    let is_whole = fits(outer.center.u, reach_u, width) && fits(outer.center.v, reach_v, height);
    let tilt_rad = normal.angle(&-center_m);
    Some(Sighting { ring, minor_px: 2.0 * outer.semi_minor_px, tilt_rad, is_whole })
}

/// The least shorter diameter of the outer rim that is found reliably (nineteen of twenty), pixels: D of the paper's
/// equation (14).
///
/// Tried on pictures like its own (`tried`), which takes some tenths of a second when it is first asked for
/// ([`super::Trials`]); of a coded one as of a ring without teeth.
pub fn least_minor_px(sensor: &Sensor, kind: &Kind, tilt_rad: f64) -> f64 {
    tried::least_minor_px(sensor, kind, tilt_rad)
}

/// The least shorter diameter of the outer rim at which the teeth of a coded roundel are read, pixels; `None` of one
/// without.
///
/// Measured on rendered roundels (`--bin codes` of the tests' crate) of these diameters seen face-on and tilted up to
/// 50° then. The shorter diameter is held to them all the same: teeth at the ends of the longer one are as narrow as
/// it, and a plan had better err to the side of larger prints.
pub fn least_read_px(kind: &Kind) -> Option<f64> {
    let Pattern::Coded(layout) = kind.pattern else { return None };
    let bits = f64::from(layout.bits);
    let more = READ_PX.partition_point(|&(known, _)| known < bits).clamp(1, READ_PX.len() - 1);
    let ((few, few_px), (many, many_px)) = (READ_PX[more - 1], READ_PX[more]);
    Some(few_px + (bits - few) / (many - few) * (many_px - few_px))
}

/// The least shorter diameter of the outer rim that does what the print is for, pixels: it is found and, if it is
/// coded, read.
pub fn least_needed_px(sensor: &Sensor, kind: &Kind, tilt_rad: f64) -> f64 {
    least_minor_px(sensor, kind, tilt_rad).max(least_read_px(kind).unwrap_or(0.0))
}

/// Whether it would be found.
pub fn is_found(sensor: &Sensor, kind: &Kind, sighting: &Sighting) -> bool {
    let outer = &sighting.ring.outer;
    let params = Params::default();
    sighting.is_whole
        && outer.semi_minor_px >= params.min_axis_ratio * outer.semi_major_px
        && tried::is_wide_enough(sensor, kind, sighting)
}

/// Whether it would be found and, if it is coded, its code read.
pub fn is_read(sensor: &Sensor, kind: &Kind, sighting: &Sighting) -> bool {
    least_read_px(kind).is_none_or(|least_px| sighting.minor_px >= least_px)
        && is_found(sensor, kind, sighting)
}

/// What is wanted of a roundel of this kind, as errors say it.
pub(super) fn wanted(kind: &Kind) -> &'static str {
    if least_read_px(kind).is_some() { "found and its code read" } else { "found" }
}

/// The ellipse of a rim of these semiaxes.
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
    // Of a circle rounding alone says which axis is the longer one.
    ellipse.semi_minor_px = ellipse.semi_minor_px.min(ellipse.semi_major_px);
    ellipse.is_valid().then_some(ellipse)
}
