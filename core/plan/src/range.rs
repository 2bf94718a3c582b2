//! Range at which a roundel is detected and its code read, and the field of view there (paper, equations 13 to 16).
//!
//! Distances are measured from the image plane along the optical axis, as in the paper. They are found by bisection with
//! the whole lens model, so the paper's kₓ and k_y (equation 15) are not needed.

use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::{
    PlanError, Sensor, bisect,
    monte_carlo::min_detected_px,
    roundel_image::{EDGE_PX, image_roundel},
    visibility::{is_detected, min_readable_px, min_required_px, requirement},
    within,
};
use roundel_vision::{
    camera::{NormalizedPoint, PixelPoint},
    marker::{Kind, Params},
    rigid::Rigid,
};

/// Relative precision of distances.
const SHARE: f64 = 1e-4;
/// Searched distances in outer diameters.
const SEARCHED_DIAMETERS: (f64, f64) = (0.1, 1e5);

/// Range in which a roundel is detected and, if it is coded, its code read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DetectionRange {
    /// Minimum distance at which it is completely in the picture in any rotation about the axis (v_min).
    pub min_m: f64,
    /// Maximum distance on the optical axis (v′_max).
    pub max_m: f64,
    /// Maximum distance in all corners of the picture (v_max).
    pub max_corner_m: f64,
    /// Width and height of the field of view at `max_corner_m` (v_y, v_z).
    pub base_m: [f64; 2],
    /// Required shorter diameter, pixels (D).
    pub min_minor_px: f64,
    /// For coded roundels, the range of the ring alone.
    pub unread: Option<RingRange>,
}

/// Range in which the ring of a coded roundel is detected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RingRange {
    /// Maximum distance on the optical axis.
    pub max_m: f64,
    /// Required shorter diameter, pixels.
    pub min_minor_px: f64,
}

/// Range of a roundel with this tilt against the image plane.
pub fn detection_range(
    sensor: &Sensor,
    kind: &Kind,
    tilt_rad: f64,
) -> Result<DetectionRange, PlanError> {
    sensor.check(kind)?;
    let max_tilt_deg = Params::default().min_axis_ratio.acos().to_degrees();
    // Rounded, as the angle was given in degrees.
    let tilt_deg = (tilt_rad.to_degrees() * 1e9).round() * 1e-9;
    within("tilt", tilt_deg, [0.0, max_tilt_deg], "0 to 75 degrees")?;
    let middle = middle(sensor);
    let needed_px = min_required_px(sensor, kind, tilt_rad);
    let farthest =
        |place: NormalizedPoint, min_px: f64| farthest(sensor, kind, tilt_rad, min_px, place);
    let max_m = farthest(middle, needed_px).ok_or_else(|| {
        PlanError::Unreachable(format!(
            "a roundel of {} mm tilted by {:.0}° is {} at no distance from this camera, in which it is at most {:.1} px \
             wide where it fits in, of {needed_px:.1} that it takes; take a longer focal length, more pixels or less tilt",
            kind.outer_diameter_m * 1e3,
            tilt_rad.to_degrees(),
            requirement(kind),
            sensor.camera.width().min(sensor.camera.height()) as f64 - 2.0 * EDGE_PX
        ))
    })?;
    let is_complete = |distance_m: f64| {
        let pose = pose_in_front(middle, distance_m, 0.0);
        let seen = image_roundel(&sensor.camera, kind, &sensor.imaging, &pose);
        seen.is_some_and(|seen| seen.is_complete)
    };
    let min_m = bisect(max_m, SEARCHED_DIAMETERS.0 * kind.outer_diameter_m, SHARE, is_complete);
    // Longer diameter of the smallest roundel that suffices.
    let widest_px = needed_px / tilt_rad.cos();
    let corners = corners(sensor, widest_px);
    let at_corner = |corner: NormalizedPoint| farthest(corner, needed_px);
    // Corners beyond the limits of the lens model are ignored.
    let max_corner_m = corners.iter().copied().filter_map(at_corner).fold(max_m, f64::min);
    let base_m = base(sensor, widest_px, max_corner_m);
    let unread = min_readable_px(kind).and_then(|_| {
        let min_minor_px = min_detected_px(sensor, kind, tilt_rad);
        Some(RingRange { max_m: farthest(middle, min_minor_px)?, min_minor_px })
    });
    Ok(DetectionRange { min_m, max_m, max_corner_m, base_m, min_minor_px: needed_px, unread })
}

/// Pose of a roundel on the ray through `place`, tilted against the image plane about the vertical.
pub fn pose_in_front(place: NormalizedPoint, distance_m: f64, tilt_rad: f64) -> Rigid {
    let facing = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let tilt = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), tilt_rad);
    let position = Vector3::new(place.x, place.y, 1.0) * distance_m;
    Rigid::from_parts(Translation3::from(position), tilt * facing)
}

/// The optical axis, or the middle of the picture if the axis is outside.
fn middle(sensor: &Sensor) -> NormalizedPoint {
    let camera = &sensor.camera;
    let axis = NormalizedPoint::default();
    if camera.distort(axis).is_ok_and(|pixel| camera.contains(pixel)) {
        return axis;
    }
    let [u, v] = [camera.width(), camera.height()].map(|side| 0.5 * (side as f64 - 1.0));
    camera.undistort(PixelPoint { u, v }).unwrap_or(axis)
}

/// Maximum distance at which it is detected and its shorter diameter sufficient; `None` if there is none.
fn farthest(
    sensor: &Sensor,
    kind: &Kind,
    tilt_rad: f64,
    min_px: f64,
    place: NormalizedPoint,
) -> Option<f64> {
    let is_sufficient = |distance_m: f64| {
        let pose = pose_in_front(place, distance_m, tilt_rad);
        let seen = image_roundel(&sensor.camera, kind, &sensor.imaging, &pose);
        seen.is_some_and(|seen| seen.minor_px >= min_px && is_detected(sensor, kind, &seen))
    };
    // Starts near the pinhole's distance and comes closer, where it is larger, until it no longer fits into the
    // picture.
    let focal_px = sensor.camera.intrinsics().fx_px.min(sensor.camera.intrinsics().fy_px);
    let by_pinhole_m = focal_px * kind.outer_diameter_m * tilt_rad.cos() / min_px;
    let near_m =
        (1..12).map(|step| by_pinhole_m * 0.8f64.powi(step)).find(|&d| is_sufficient(d))?;
    Some(bisect(near_m, SEARCHED_DIAMETERS.1 * kind.outer_diameter_m, SHARE, is_sufficient))
}

/// Half the width of a roundel with its white margin, pixels.
fn half_px(widest_px: f64) -> f64 {
    0.5 * widest_px + EDGE_PX + 1.0
}

/// Rays just within the picture's corners, as far as the lens model is valid.
fn corners(sensor: &Sensor, widest_px: f64) -> Vec<NormalizedPoint> {
    let camera = &sensor.camera;
    let edge_px = half_px(widest_px) + 0.25 * widest_px;
    let ends = |side: usize| [edge_px, side as f64 - 1.0 - edge_px];
    let (us, vs) = (ends(camera.width()), ends(camera.height()));
    let all = us.into_iter().flat_map(|u| vs.map(|v| PixelPoint { u, v }));
    all.filter_map(|corner| camera.undistort(corner).ok()).collect()
}

fn base(sensor: &Sensor, widest_px: f64, distance_m: f64) -> [f64; 2] {
    let camera = &sensor.camera;
    let edge_px = half_px(widest_px);
    let [u, v] = [camera.width(), camera.height()].map(|side| side as f64 - 1.0);
    let across = |ends: [PixelPoint; 2], of: fn(NormalizedPoint) -> f64| {
        let [from, to] = ends.map(|end| camera.undistort(end).map(of));
        from.and_then(|from| Ok((to? - from) * distance_m)).map_or(0.0, |side| side.max(0.0))
    };
    let level = |u: f64| PixelPoint { u, v: 0.5 * v };
    let upright = |v: f64| PixelPoint { u: 0.5 * u, v };
    [
        across([level(edge_px), level(u - edge_px)], |point| point.x),
        across([upright(edge_px), upright(v - edge_px)], |point| point.y),
    ]
}
