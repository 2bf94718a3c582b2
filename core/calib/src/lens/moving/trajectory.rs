//! Trajectory of a roundel, interpolated between the fused estimates of other cameras.
//!
//! Positions follow the cubic Hermite spline of positions and velocities.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

/// Maximum interval that is interpolated, seconds.
const MAX_GAP_S: f64 = 0.15;

/// State of a roundel at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waypoint {
    /// Seconds since the recording's epoch, by the clock of the other cameras.
    pub time_s: f64,
    /// Centre, world frame, metres.
    pub position_m: Vector3<f64>,
    /// World frame, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// world_from_roundel; the rotation about the normal does not matter.
    pub orientation: UnitQuaternion<f64>,
    /// Covariance of the position, world frame, metres².
    pub covariance_m2: Matrix3<f64>,
}

/// Trajectory of one roundel.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    radius_m: f64,
    /// Sorted by time.
    waypoints: Vec<Waypoint>,
}

impl Trajectory {
    /// `radius_m` is the radius of the outer rim. Waypoints may be in any order; those with non-finite numbers are
    /// dropped.
    pub fn new(radius_m: f64, waypoints: Vec<Waypoint>) -> Self {
        let is_finite = |it: &Waypoint| {
            let places = it.position_m.iter().chain(&it.velocity_m_s).chain(&it.covariance_m2);
            it.time_s.is_finite() && places.chain(&it.orientation.coords).all(|it| it.is_finite())
        };
        let mut waypoints: Vec<_> = waypoints.into_iter().filter(is_finite).collect();
        waypoints.sort_by(|one, other| one.time_s.total_cmp(&other.time_s));
        waypoints.dedup_by(|one, other| one.time_s <= other.time_s);
        Self { radius_m, waypoints }
    }

    /// Radius of the outer rim, metres.
    pub fn radius_m(&self) -> f64 {
        self.radius_m
    }

    /// Interpolated state; `None` outside of the trajectory and within gaps.
    pub fn at(&self, time_s: f64) -> Option<Waypoint> {
        let next = self.waypoints.partition_point(|it| it.time_s < time_s);
        let after = self.waypoints.get(next)?;
        if after.time_s == time_s {
            return Some(*after);
        }
        let before = &self.waypoints[next.checked_sub(1)?];
        let gap_s = after.time_s - before.time_s;
        if gap_s > MAX_GAP_S {
            return None;
        }
        let s = (time_s - before.time_s) / gap_s;
        let (s2, s3) = (s * s, s * s * s);
        let (from, to) = (before.position_m, after.position_m);
        let (start_slope, end_slope) = (before.velocity_m_s * gap_s, after.velocity_m_s * gap_s);
        let position_m = from * (2.0 * s3 - 3.0 * s2 + 1.0)
            + start_slope * (s3 - 2.0 * s2 + s)
            + to * (3.0 * s2 - 2.0 * s3)
            + end_slope * (s3 - s2);
        let nearer = if s < 0.5 { before } else { after };
        Some(Waypoint {
            time_s,
            position_m,
            // Interpolated, not the spline's derivative: a step of the filter's position is not a velocity.
            velocity_m_s: before.velocity_m_s.lerp(&after.velocity_m_s, s),
            orientation: nearer.orientation,
            covariance_m2: before.covariance_m2 * (1.0 - s) + after.covariance_m2 * s,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn waypoint(time_s: f64) -> Waypoint {
        // A cubic, which the spline reproduces exactly.
        let (t, t2) = (time_s, time_s * time_s);
        Waypoint {
            time_s,
            position_m: Vector3::new(t, t2, 1.0 - t * t2),
            velocity_m_s: Vector3::new(1.0, 2.0 * t, -3.0 * t2),
            orientation: UnitQuaternion::identity(),
            covariance_m2: Matrix3::identity() * (1.0 + t),
        }
    }

    #[test]
    fn a_cubic_is_reproduced_and_gaps_are_not_interpolated() {
        let invalid = Waypoint { position_m: Vector3::repeat(f64::NAN), ..waypoint(0.15) };
        let trajectory =
            Trajectory::new(0.08, vec![waypoint(0.1), invalid, waypoint(0.0), waypoint(0.5)]);
        let found = trajectory.at(0.03).unwrap();
        assert!((found.position_m - waypoint(0.03).position_m).norm() < 1e-15);
        assert!((found.covariance_m2[(0, 0)] - 1.03).abs() < 1e-12);
        assert_eq!(trajectory.at(0.5).map(|it| it.time_s), Some(0.5));
        for outside in [-0.1, 0.3, 0.6, f64::NAN] {
            assert_eq!(trajectory.at(outside), None, "{outside}");
        }
    }
}
