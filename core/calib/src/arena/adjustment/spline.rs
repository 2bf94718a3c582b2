//! Where a roundel was over time: a uniform cubic B-spline, or one point of one that stands.
//!
//! Between knots h apart a path whose fourth derivative is a⁗ is off by at most h⁴ a⁗ / 384 (de Boor, *A
//! practical guide to splines*, 1978): with h = 0.1 s and 2 m/s² at 3 rad/s, 5 µm. Position and velocity are
//! linear in four control points, so a course is solved for, never searched for.

use nalgebra::Vector3;

/// Beyond first and last sighting, so that a clock's correction stays inside, seconds.
const MARGIN_S: f64 = 0.25;

/// A course's control points.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Course {
    start_s: f64,
    knot_s: f64,
    /// One of what stands, else four or more.
    pub(crate) points_m: Vec<Vector3<f64>>,
}

/// What a course is at an instant.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Instant {
    /// The first of `count` control points that matter.
    pub(crate) first: usize,
    pub(crate) count: usize,
    /// What each adds to the position.
    pub(crate) weights: [f64; 4],
    pub(crate) position_m: Vector3<f64>,
    pub(crate) velocity_m_s: Vector3<f64>,
}

impl Course {
    /// Of a roundel that stands.
    pub(crate) fn standing(position_m: Vector3<f64>) -> Self {
        Self { start_s: 0.0, knot_s: 1.0, points_m: vec![position_m] }
    }

    /// Of one seen from `first_s` to `last_s`, not yet known.
    pub(crate) fn over((first_s, last_s): (f64, f64), knot_s: f64) -> Self {
        let start_s = first_s - MARGIN_S;
        let spans = ((last_s + MARGIN_S - start_s) / knot_s).ceil().max(1.0) as usize;
        Self { start_s, knot_s, points_m: vec![Vector3::zeros(); spans + 3] }
    }

    pub(crate) fn stands(&self) -> bool {
        self.points_m.len() == 1
    }

    pub(crate) fn knot_s(&self) -> f64 {
        self.knot_s
    }

    /// Beyond its ends a course goes on as its last span would.
    pub(crate) fn at(&self, time_s: f64) -> Instant {
        if self.stands() {
            let weights = [1.0, 0.0, 0.0, 0.0];
            let position_m = self.points_m[0];
            return Instant {
                first: 0,
                count: 1,
                weights,
                position_m,
                velocity_m_s: Vector3::zeros(),
            };
        }
        let along = (time_s - self.start_s) / self.knot_s;
        let first = (along.floor().max(0.0) as usize).min(self.points_m.len() - 4);
        let u = along - first as f64;
        let v = 1.0 - u;
        let weights = [
            v * v * v / 6.0,
            ((3.0 * u - 6.0) * u * u + 4.0) / 6.0,
            ((3.0 * v - 6.0) * v * v + 4.0) / 6.0,
            u * u * u / 6.0,
        ];
        let slopes = [-v * v / 2.0, (1.5 * u - 2.0) * u, (2.0 - 1.5 * v) * v, u * u / 2.0];
        let points = &self.points_m[first..first + 4];
        let sum = |factors: &[f64; 4]| -> Vector3<f64> {
            std::iter::zip(points, factors).map(|(point, factor)| point * *factor).sum()
        };
        Instant {
            first,
            count: 4,
            weights,
            position_m: sum(&weights),
            velocity_m_s: sum(&slopes) / self.knot_s,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn velocity_is_the_difference(points in proptest::collection::vec(-3.0..3.0f64, 30), t in -0.2..1.0f64) {
            let mut course = Course::over((0.0, 0.5), 0.2);
            for (point, value) in course.points_m.iter_mut().zip(&points) {
                *point = Vector3::new(*value, -value, value * value);
            }
            let difference = (course.at(t + 1e-5).position_m - course.at(t - 1e-5).position_m) / 2e-5;
            prop_assert!((course.at(t).velocity_m_s - difference).norm() < 1e-3);
            prop_assert!((course.at(t).weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn what_stands_has_one_point() {
        let course = Course::standing(Vector3::new(1.0, 2.0, 3.0));
        let instant = course.at(1e9);
        assert_eq!((instant.first, instant.count), (0, 1));
        assert_eq!(instant.velocity_m_s, Vector3::zeros());
    }
}
