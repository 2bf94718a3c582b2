//! A box of the world in a request.

use nalgebra::Vector3;
use roundel_proto::v1;

use super::error::ApiError;

/// An axis-aligned box in the world frame, metres. It includes its faces; sides may be infinite.
#[derive(Clone, Debug, PartialEq)]
pub struct Region {
    pub min_m: Vector3<f64>,
    pub max_m: Vector3<f64>,
}

impl Region {
    /// The corners' names are for errors.
    pub fn checked(region: v1::Box, [min, max]: [&str; 2]) -> Result<Self, ApiError> {
        let (min_m, max_m) = (corner(region.min, min)?, corner(region.max, max)?);
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
            if min_m[axis] > max_m[axis] {
                let expected = format!("at least {} ({min}.{name})", min_m[axis]);
                return Err(ApiError::invalid(format!("{max}.{name}"), expected, max_m[axis]));
            }
        }
        Ok(Self { min_m, max_m })
    }

    pub fn contains(&self, point_m: &Vector3<f64>) -> bool {
        (0..3).all(|axis| self.min_m[axis] <= point_m[axis] && point_m[axis] <= self.max_m[axis])
    }
}

fn corner(corner: Option<v1::Vector3>, field: &str) -> Result<Vector3<f64>, ApiError> {
    let Some(corner) = corner else {
        return Err(ApiError::invalid(field, "a corner of the box, metres", "nothing"));
    };
    for (name, side) in [("x", corner.x), ("y", corner.y), ("z", corner.z)] {
        if side.is_nan() {
            return Err(ApiError::invalid(format!("{field}.{name}"), "metres", side));
        }
    }
    Ok(Vector3::new(corner.x, corner.y, corner.z))
}
