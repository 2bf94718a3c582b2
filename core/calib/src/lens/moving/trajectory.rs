//! Where a roundel was, as other cameras told, between the instants at which they did.
//!
//! Between two of them its place follows the cubic with their places and velocities (Hermite's).

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

/// Nothing is said of a time between two instants that are further apart, seconds.
const MOST_GAP_S: f64 = 0.15;

/// A roundel at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waypoint {
    /// Since the recording's epoch, by the clock of those who saw it, seconds.
    pub time_s: f64,
    /// Its centre, world frame, metres.
    pub place_m: Vector3<f64>,
    /// World frame, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// world_from_roundel; of the turn about the normal nothing depends.
    pub orientation: UnitQuaternion<f64>,
    /// Of the place, world frame, metres².
    pub covariance_m2: Matrix3<f64>,
}

/// One roundel's way through the arena.
#[derive(Clone, Debug, PartialEq)]
pub struct Way {
    radius_m: f64,
    /// In the order of time.
    waypoints: Vec<Waypoint>,
}

impl Way {
    /// Of a roundel with this radius of its outer rim; waypoints in any order, of those with numbers that are not finite
    /// nothing is kept.
    pub fn new(radius_m: f64, waypoints: Vec<Waypoint>) -> Self {
        let is_finite = |it: &Waypoint| {
            let places = it.place_m.iter().chain(&it.velocity_m_s).chain(&it.covariance_m2);
            it.time_s.is_finite() && places.chain(&it.orientation.coords).all(|it| it.is_finite())
        };
        let mut waypoints: Vec<_> = waypoints.into_iter().filter(is_finite).collect();
        waypoints.sort_by(|one, other| one.time_s.total_cmp(&other.time_s));
        waypoints.dedup_by(|one, other| one.time_s <= other.time_s);
        Self { radius_m, waypoints }
    }

    /// Radius of its outer rim, metres.
    pub fn radius_m(&self) -> f64 {
        self.radius_m
    }

    /// Where it was; `None` where nobody saw it for a while.
    pub fn at(&self, time_s: f64) -> Option<Waypoint> {
        let next = self.waypoints.partition_point(|it| it.time_s < time_s);
        let after = self.waypoints.get(next)?;
        if after.time_s == time_s {
            return Some(*after);
        }
        let before = &self.waypoints[next.checked_sub(1)?];
        let gap_s = after.time_s - before.time_s;
        if gap_s > MOST_GAP_S {
            return None;
        }
        let s = (time_s - before.time_s) / gap_s;
        let (s2, s3) = (s * s, s * s * s);
        let (from, to) = (before.place_m, after.place_m);
        let (leaving, coming) = (before.velocity_m_s * gap_s, after.velocity_m_s * gap_s);
        let place_m = from * (2.0 * s3 - 3.0 * s2 + 1.0)
            + leaving * (s3 - 2.0 * s2 + s)
            + to * (3.0 * s2 - 2.0 * s3)
            + coming * (s3 - s2);
        let nearer = if s < 0.5 { before } else { after };
        Some(Waypoint {
            time_s,
            place_m,
            // The filters' own: a place that a measurement has moved by a step is no speed.
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
        // A cubic, which is followed exactly.
        let (t, t2) = (time_s, time_s * time_s);
        Waypoint {
            time_s,
            place_m: Vector3::new(t, t2, 1.0 - t * t2),
            velocity_m_s: Vector3::new(1.0, 2.0 * t, -3.0 * t2),
            orientation: UnitQuaternion::identity(),
            covariance_m2: Matrix3::identity() * (1.0 + t),
        }
    }

    #[test]
    fn a_cubic_is_followed_and_gaps_are_not() {
        let nowhere = Waypoint { place_m: Vector3::repeat(f64::NAN), ..waypoint(0.15) };
        let way = Way::new(0.08, vec![waypoint(0.1), nowhere, waypoint(0.0), waypoint(0.5)]);
        let found = way.at(0.03).unwrap();
        assert!((found.place_m - waypoint(0.03).place_m).norm() < 1e-15);
        assert!((found.covariance_m2[(0, 0)] - 1.03).abs() < 1e-12);
        assert_eq!(way.at(0.5).map(|it| it.time_s), Some(0.5));
        for outside in [-0.1, 0.3, 0.6, f64::NAN] {
            assert_eq!(way.at(outside), None, "{outside}");
        }
    }
}
