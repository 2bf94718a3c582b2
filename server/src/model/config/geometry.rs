//! Poses, positions and orientations of the configuration.

use nalgebra::{Matrix3, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector3};
use roundel_core::{rigid::Rigid, world::Mount};

use super::reader::{NumberRange, Table};

/// Tolerance of a quaternion's length: three written decimals.
const NORM_TOLERANCE: f64 = 0.01;
/// Points nearer than this count as coincident, or as collinear.
const MIN_SEPARATION_M: f64 = 1e-3;
/// Lateral distance of two roundels, metres, or sine between their normals, that reveals an object's orientation.
const MIN_LATERAL_OFFSET_M: f64 = 0.02;
const MIN_NORMAL_SINE: f64 = 0.1;
/// Tolerance of the right angle between `right` and `top`, as its cosine.
const RIGHT_ANGLE_TOLERANCE: f64 = 0.02;

/// `position_m` and `orientation_xyzw`.
pub(super) fn pose(table: &Table<'_, '_>) -> Option<Rigid> {
    let position = table.required_numbers::<3>("position_m", "[x, y, z]");
    let orientation = table.required_numbers::<4>("orientation_xyzw", "[x, y, z, w]");
    let (position, [x, y, z, w]) = (position?, orientation?);
    let quaternion = Quaternion::new(w, x, y, z);
    let norm = quaternion.norm();
    if (norm - 1.0).abs() > NORM_TOLERANCE {
        let remedy = if norm > 1e-9 {
            let unit = quaternion / norm;
            format!("the unit one is [{:.6}, {:.6}, {:.6}, {:.6}]", unit.i, unit.j, unit.k, unit.w)
        } else {
            "no rotation at all is [0.0, 0.0, 0.0, 1.0]".to_owned()
        };
        let message =
            format!("`orientation_xyzw` must be a quaternion of length 1, found length {norm:.4}");
        return table.reject("orientation_xyzw", message, remedy);
    }
    let rotation = UnitQuaternion::from_quaternion(quaternion);
    Some(Rigid::from_parts(Translation3::from(Vector3::from(position)), rotation))
}

/// Orientation of a print in `frame`: `yaw_deg`, or `right` and `top`.
pub(super) fn rotation(part: &Table<'_, '_>, frame: &str) -> Option<UnitQuaternion<f64>> {
    if !part.has("right") && !part.has("top") {
        let yaw_deg = part.number("yaw_deg", NumberRange::Within(360.0), 0.0);
        return Some(UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_deg.to_radians()));
    }
    if part.has("yaw_deg") {
        let message =
            "`yaw_deg` turns a print that lies flat, `right` and `top` any print: found both";
        return part.reject("yaw_deg", message, "leave out `yaw_deg`");
    }
    let right = part.required_numbers::<3>("right", "[0.0, 1.0, 0.0]").map(Vector3::from);
    let top = part.required_numbers::<3>("top", "[0.0, 0.0, 1.0]").map(Vector3::from);
    let (right, top) = (right?, top?);
    let (Some(x), Some(y)) = (right.try_normalize(1e-9), top.try_normalize(1e-9)) else {
        let message = "`right` and `top` must point somewhere, found zeros";
        return part.reject("right", message, "");
    };
    if x.dot(&y).abs() > RIGHT_ANGLE_TOLERANCE {
        let between_deg = x.dot(&y).acos().to_degrees();
        return part.reject(
            "top",
            format!("`right` and `top` must be at right angles, found {between_deg:.1} degrees"),
            format!("they are the ways in {frame} that the print's right and its top point to"),
        );
    }
    let z = x.cross(&y).normalize();
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
    Some(UnitQuaternion::from_rotation_matrix(&rotation))
}

/// Whether roundels without codes reveal their object's orientation: they are not all on one axis.
pub(super) fn determine_orientation(mounts: &[Mount]) -> bool {
    let Some((first, rest)) = mounts.split_first() else { return false };
    let normal = |mount: &Mount| mount.object_from_roundel.rotation * Vector3::z();
    let place_m = |mount: &Mount| mount.object_from_roundel.translation.vector;
    rest.iter().any(|mount| {
        let aside_m = normal(first).cross(&(place_m(mount) - place_m(first))).norm();
        let apart = normal(first).cross(&normal(mount)).norm();
        aside_m > MIN_LATERAL_OFFSET_M || apart > MIN_NORMAL_SINE
    })
}

/// The first two points that coincide.
pub(super) fn coincident_points(places: &[Vector3<f64>]) -> Option<(usize, usize)> {
    (0..places.len()).find_map(|second| {
        (0..second)
            .find(|&first| (places[first] - places[second]).norm() < MIN_SEPARATION_M)
            .map(|first| (first, second))
    })
}

pub(super) fn collinear(places: &[Vector3<f64>]) -> bool {
    let Some((first, rest)) = places.split_first() else { return true };
    // The point farthest from the first gives the line's direction.
    let Some(farthest) = rest
        .iter()
        .max_by(|a, b| (*a - first).norm_squared().total_cmp(&(*b - first).norm_squared()))
    else {
        return true;
    };
    let Some(direction) = (farthest - first).try_normalize(0.0) else { return true };
    rest.iter().all(|place| (place - first).cross(&direction).norm() < MIN_SEPARATION_M)
}

#[cfg(test)]
mod tests {
    use roundel_core::id::KindId;

    use super::*;

    #[test]
    fn lines_are_told_from_triangles() {
        let line = [0.0, 1.0, 3.0].map(|s| Vector3::new(s, 2.0 * s, -s));
        assert!(collinear(&line));
        let triangle = [line[0], line[1], Vector3::new(0.0, 0.01, 0.0)];
        assert!(!collinear(&triangle));
        assert_eq!(coincident_points(&triangle), None);
        assert_eq!(coincident_points(&[line[0], line[1], line[1]]), Some((1, 2)));
    }

    #[test]
    fn roundels_along_one_axis_do_not_tell_a_turn() {
        let mount = |z: f64, aside_m: f64, lean: f64| Mount {
            kind: KindId(0),
            code: None,
            object_from_roundel: Rigid::from_parts(
                Vector3::new(aside_m, 0.0, z).into(),
                UnitQuaternion::from_euler_angles(lean, 0.0, 1.0),
            ),
        };
        let first = mount(0.3, 0.0, 0.0);
        assert!(!determine_orientation(&[first]));
        assert!(!determine_orientation(&[
            first,
            mount(0.1, 0.0, 0.0),
            mount(-0.1, 0.0, std::f64::consts::PI)
        ]));
        assert!(determine_orientation(&[first, mount(0.3, 0.2, 0.0)]));
        assert!(determine_orientation(&[first, mount(0.1, 0.0, 0.5)]));
    }
}
