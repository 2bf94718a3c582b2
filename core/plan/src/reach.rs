//! How near and how far a roundel is found, and how wide the view is there (paper, equations 13 to 16).
//!
//! A coded one counts where its code is read as well; where its ring alone is found is told beside that.
//!
//! Distances are those from the image plane, along the optical axis, as in the paper. They are found by bisection on
//! roundels projected through the whole lens model, so that the paper's kₓ and k_y (equation 15) are not needed.

use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::{
    PlanError, Sensor,
    sight::{EDGE_PX, is_found, least_minor_px, least_needed_px, least_read_px, sight, wanted},
    within,
};
use roundel_vision::{
    camera::{NormalizedPoint, PixelPoint},
    marker::{Kind, Params},
    rigid::Rigid,
};

/// Distances are found to this share.
const SHARE: f64 = 1e-4;
/// Nearest and farthest distance that is looked at, outer diameters.
const LOOKED_AT: (f64, f64) = (0.1, 1e5);

/// Where a roundel is found and, if it is coded, read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reach {
    /// Nearest distance at which it is wholly in the picture however it is turned about the axis (v_min).
    pub least_m: f64,
    /// Farthest one on the optical axis, a coded one read (v′_max).
    pub most_m: f64,
    /// Farthest one in every corner of the picture, a coded one read (v_max).
    pub most_corner_m: f64,
    /// Width and height at `most_corner_m` within which it is wholly in the picture (v_y, v_z).
    pub base_m: [f64; 2],
    /// Shorter diameter at `most_m`, pixels (D).
    pub least_minor_px: f64,
    /// Of a coded one only: where its ring alone is found.
    pub unread: Option<Unread>,
}

/// How far the ring of a coded roundel is found whose code need not be read: as one without teeth would be, which is
/// the most that it can be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unread {
    /// Farthest distance on the optical axis.
    pub most_m: f64,
    /// Shorter diameter there, pixels.
    pub least_minor_px: f64,
}

/// Where a roundel tilted by this angle against the image plane is found and, if it is coded, read.
pub fn reach(sensor: &Sensor, kind: &Kind, tilt_rad: f64) -> Result<Reach, PlanError> {
    sensor.check(kind)?;
    let most_tilt_deg = Params::default().min_axis_ratio.acos().to_degrees();
    // As whoever said it in degrees knows it.
    let tilt_deg = (tilt_rad.to_degrees() * 1e9).round() * 1e-9;
    within("tilt", tilt_deg, [0.0, most_tilt_deg], "0 to 75 degrees")?;
    let middle = middle(sensor);
    let needed_px = least_needed_px(sensor, kind, tilt_rad);
    let farthest =
        |place: NormalizedPoint, least_px: f64| farthest(sensor, kind, (tilt_rad, least_px), place);
    let most_m = farthest(middle, needed_px).ok_or_else(|| PlanError::NoReach {
        outer_mm: kind.outer_diameter_m * 1e3,
        tilt_deg: tilt_rad.to_degrees(),
        wanted: wanted(kind),
        most_px: sensor.camera.width().min(sensor.camera.height()) as f64 - 2.0 * EDGE_PX,
        least_px: needed_px,
    })?;
    let whole = |distance_m: f64| {
        let pose = before(middle, distance_m, 0.0);
        let seen = sight(&sensor.camera, kind, &sensor.imaging, &pose);
        seen.is_some_and(|seen| seen.is_whole)
    };
    let least_m = bisect(most_m, LOOKED_AT.0 * kind.outer_diameter_m, whole);
    // Of the smallest one that counts, the diameter that tilt leaves.
    let widest_px = needed_px / tilt_rad.cos();
    let corners = corners(sensor, widest_px);
    let at_corner = |corner: NormalizedPoint| farthest(corner, needed_px);
    // A corner that the lens model does not reach is none that anybody could use.
    let most_corner_m = corners.iter().copied().filter_map(at_corner).fold(most_m, f64::min);
    let base_m = base(sensor, widest_px, most_corner_m);
    let unread = least_read_px(kind).and_then(|_| {
        let least_minor_px = least_minor_px(sensor, kind, tilt_rad);
        Some(Unread { most_m: farthest(middle, least_minor_px)?, least_minor_px })
    });
    Ok(Reach { least_m, most_m, most_corner_m, base_m, least_minor_px: needed_px, unread })
}

/// A roundel at a place of the image plane and a distance, tilted against that plane about the picture's vertical.
pub fn before(place: NormalizedPoint, distance_m: f64, tilt_rad: f64) -> Rigid {
    let facing = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let tilt = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), tilt_rad);
    let position = Vector3::new(place.x, place.y, 1.0) * distance_m;
    Rigid::from_parts(Translation3::from(position), tilt * facing)
}

/// On the optical axis, or in the picture's middle where that is not in the picture.
fn middle(sensor: &Sensor) -> NormalizedPoint {
    let camera = &sensor.camera;
    let axis = NormalizedPoint::default();
    if camera.distort(axis).is_ok_and(|pixel| camera.contains(pixel)) {
        return axis;
    }
    let [u, v] = [camera.width(), camera.height()].map(|side| 0.5 * (side as f64 - 1.0));
    camera.undistort(PixelPoint { u, v }).unwrap_or(axis)
}

/// At which it is found and its shorter diameter is at least so many pixels; `None` where it is at no distance.
fn farthest(
    sensor: &Sensor,
    kind: &Kind,
    (tilt_rad, least_px): (f64, f64),
    place: NormalizedPoint,
) -> Option<f64> {
    let does = |distance_m: f64| {
        let pose = before(place, distance_m, tilt_rad);
        let seen = sight(&sensor.camera, kind, &sensor.imaging, &pose);
        seen.is_some_and(|seen| seen.minor_px >= least_px && is_found(sensor, kind, &seen))
    };
    // Nearer it is larger, until it does not fit in: the near end is where it is just large enough by the pinhole.
    let focal_px = sensor.camera.intrinsics().fx_px.min(sensor.camera.intrinsics().fy_px);
    let by_pinhole_m = focal_px * kind.outer_diameter_m * tilt_rad.cos() / least_px;
    let near_m = (1..12).map(|step| by_pinhole_m * 0.8f64.powi(step)).find(|&d| does(d))?;
    Some(bisect(near_m, LOOKED_AT.1 * kind.outer_diameter_m, does))
}

/// From where something holds towards where it does not, the last place where it does.
fn bisect(from: f64, to: f64, holds: impl Fn(f64) -> bool) -> f64 {
    let (mut good, mut bad) = (from, to);
    while (good / bad).ln().abs() > SHARE {
        let middle = (good * bad).sqrt();
        if holds(middle) { good = middle } else { bad = middle }
    }
    good
}

/// Half of a roundel so wide, with its white edge, pixels.
fn half_px(widest_px: f64) -> f64 {
    0.5 * widest_px + EDGE_PX + 1.0
}

/// Just within the picture's corners, as far as the lens reaches.
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
