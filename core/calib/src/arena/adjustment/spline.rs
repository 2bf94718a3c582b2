//! Path of a roundel: a uniform cubic B-spline, or a constant for a stationary one.
//!
//! With knots h apart, the error for a fourth derivative a⁗ is at most h⁴ a⁗ / 384 (de Boor, *A practical guide to
//! splines*, 1978): 5 µm for h = 0.1 s and 2 m/s² at 3 rad/s. Position and velocity are linear in four control points.

use nalgebra::Vector3;

/// Extension beyond the first and last sighting for corrections of clocks, seconds.
const MARGIN_S: f64 = 0.25;

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Spline {
    start_s: f64,
    pub(crate) knot_s: f64,
    /// One for a stationary roundel, else at least four.
    pub(crate) points_m: Vec<Vector3<f64>>,
}

/// The spline at an instant.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Instant {
    /// First of the `count` control points that contribute.
    pub(crate) first: usize,
    pub(crate) count: usize,
    pub(crate) weights: [f64; 4],
    pub(crate) position_m: Vector3<f64>,
    pub(crate) velocity_m_s: Vector3<f64>,
}

impl Spline {
    pub(crate) fn constant(position_m: Vector3<f64>) -> Self {
        Self { start_s: 0.0, knot_s: 1.0, points_m: vec![position_m] }
    }

    /// For sightings from `first_s` to `last_s`, with all control points zero.
    pub(crate) fn over(first_s: f64, last_s: f64, knot_s: f64) -> Self {
        let start_s = first_s - MARGIN_S;
        let spans = ((last_s + MARGIN_S - start_s) / knot_s).ceil().max(1.0) as usize;
        Self { start_s, knot_s, points_m: vec![Vector3::zeros(); spans + 3] }
    }

    /// The outermost spans extrapolate beyond both ends.
    pub(crate) fn at(&self, time_s: f64) -> Instant {
        if let [position_m] = self.points_m[..] {
            return Instant {
                first: 0,
                count: 1,
                weights: [1.0, 0.0, 0.0, 0.0],
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
            let mut spline = Spline::over(0.0, 0.5, 0.2);
            for (point, value) in spline.points_m.iter_mut().zip(&points) {
                *point = Vector3::new(*value, -value, value * value);
            }
            let difference = (spline.at(t + 1e-5).position_m - spline.at(t - 1e-5).position_m) / 2e-5;
            prop_assert!((spline.at(t).velocity_m_s - difference).norm() < 1e-3);
            prop_assert!((spline.at(t).weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_stationary_roundel_has_one_point() {
        let spline = Spline::constant(Vector3::new(1.0, 2.0, 3.0));
        let instant = spline.at(1e9);
        assert_eq!((instant.first, instant.count), (0, 1));
        assert_eq!(instant.velocity_m_s, Vector3::zeros());
    }
}
