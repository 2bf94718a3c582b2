//! Poses and places of the configuration.

use nalgebra::{Quaternion, Translation3, UnitQuaternion, Vector3};
use roundel_core::rigid::Rigid;

use super::reader::Table;

const POSE_KEYS: [&str; 2] = ["position_m", "orientation_xyzw"];
/// How far a quaternion's length may be from 1: what three written decimals can cost.
const NORM_TOLERANCE: f64 = 0.01;
/// Reference roundels nearer than this to one another, or to one line, are an error of typing.
const LEAST_DISTANCE_M: f64 = 1e-3;

/// The pose under the key `pose`; `None` if it is wrong (then it is reported with `help`).
pub(super) fn pose(camera: &Table<'_, '_>, help: &str) -> Option<Rigid> {
    if camera.value("pose")?.get_ref().as_table().is_none() {
        let span = camera.span_of("pose");
        camera.fail_with_help(&span, "`pose` must be a table or \"unknown\"", help);
        return None;
    }
    let table = camera.table("pose", "pose", &POSE_KEYS)?;
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
        table.fail_with_help(
            &table.span_of("orientation_xyzw"),
            format!("`orientation_xyzw` must be a quaternion of length 1, found length {norm:.4}"),
            remedy,
        );
        return None;
    }
    let rotation = UnitQuaternion::from_quaternion(quaternion);
    Some(Rigid::from_parts(Translation3::from(Vector3::from(position)), rotation))
}

/// The first two places that are the same.
pub(super) fn same_place(places: &[Vector3<f64>]) -> Option<(usize, usize)> {
    (0..places.len()).find_map(|second| {
        (0..second)
            .find(|&first| (places[first] - places[second]).norm() < LEAST_DISTANCE_M)
            .map(|first| (first, second))
    })
}

/// Whether all places lie in one line.
pub(super) fn collinear(places: &[Vector3<f64>]) -> bool {
    let Some((first, rest)) = places.split_first() else { return true };
    // The farthest from the first gives the line's direction; any other base would do.
    let Some(farthest) = rest
        .iter()
        .max_by(|a, b| (*a - first).norm_squared().total_cmp(&(*b - first).norm_squared()))
    else {
        return true;
    };
    let Some(direction) = (farthest - first).try_normalize(0.0) else { return true };
    rest.iter().all(|place| (place - first).cross(&direction).norm() < LEAST_DISTANCE_M)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_told_from_triangles() {
        let line = [0.0, 1.0, 3.0].map(|s| Vector3::new(s, 2.0 * s, -s));
        assert!(collinear(&line));
        let triangle = [line[0], line[1], Vector3::new(0.0, 0.01, 0.0)];
        assert!(!collinear(&triangle));
        assert_eq!(same_place(&triangle), None);
        assert_eq!(same_place(&[line[0], line[1], line[1]]), Some((1, 2)));
    }
}
