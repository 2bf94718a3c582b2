//! Image velocity of a tracked ring.
//!
//! In: positions of its centre, each with the time of its own row. Out: its velocity at the newest
//! of them, with the variance of either component.
//!
//! Along either axis a Kalman filter of position, velocity and acceleration, whose jerk is white
//! noise of density q. Over a step t their covariance grows by
//!
//! q t⁵/20, q t⁴/8, q t³/6;  q t³/3, q t²/2;  q t
//!
//! Both axes are measured with the same accuracy and share one covariance. The initial velocity is
//! unknown, with a standard deviation of [`SPEED_M_S`] scaled by the ring's size in the image.
//! Where innovations exceed their expected variance (jittering clocks, impacts), by the mean of
//! their squares over the last [`MEAN_COUNT`] or by half of the last one alone, the variance grows
//! by that factor. A position far off restarts the filter.
//!
//! **Accuracy.** At 60 Hz, with centres accurate to 0.01 px, a velocity of 600 px/s is known to 10
//! px/s in the second frame and to 3 px/s from the third one on.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::{camera::PixelPoint, time::Timestamp};

/// Standard deviation of either component of an unknown velocity …
const SPEED_M_S: f64 = 2.0;
/// … and of an unknown acceleration.
const ACCELERATION_M_S2: f64 = 5.0;
/// q, m²/s⁵: an acceleration that lasts a tenth of a second.
const JERK: f64 = 2.0 * ACCELERATION_M_S2 * ACCELERATION_M_S2 / 0.1;
/// A longer gap restarts the filter.
const MAX_GAP_S: f64 = 0.5;
/// Effective number of innovations in the mean.
const MEAN_COUNT: f64 = 4.0;
/// Squared normalized innovation that restarts the filter.
const RESTART_SQUARED: f64 = 4000.0;

#[derive(Clone, Copy, Debug)]
pub struct CenterMeasurement {
    /// When its row was exposed.
    pub time: Timestamp,
    pub center: PixelPoint,
    /// Variance of either coordinate.
    pub variance_px2: f64,
    pub px_per_m: f64,
}

#[derive(Clone, Copy, Debug)]
pub struct ImageMotion {
    time: Timestamp,
    /// Position, velocity and acceleration along u and along v, in px and s.
    axes: [Vector3<f64>; 2],
    /// Covariance of either axis.
    covariance: Matrix3<f64>,
    /// Mean square of the innovations over their expected variance.
    normalized_innovation: f64,
}

impl ImageMotion {
    /// The prior, for a ring detected for the first time.
    pub fn new(measured: &CenterMeasurement) -> Self {
        let axis = |place: f64| Vector3::new(place, 0.0, 0.0);
        let variance = |by_metre: f64| (by_metre * measured.px_per_m).powi(2);
        let variances =
            Vector3::new(measured.variance_px2, variance(SPEED_M_S), variance(ACCELERATION_M_S2));
        Self {
            time: measured.time,
            axes: [axis(measured.center.u), axis(measured.center.v)],
            covariance: Matrix3::from_diagonal(&variances),
            normalized_innovation: 1.0,
        }
    }

    /// The same frame a second time changes nothing.
    pub fn update(&mut self, measured: &CenterMeasurement) {
        let step_s = measured.time.seconds_since(self.time);
        if step_s == 0.0 {
            return;
        }
        if !(0.0..MAX_GAP_S).contains(&step_s) {
            *self = Self::new(measured);
            return;
        }
        self.predict(step_s, measured.px_per_m);
        self.time = measured.time;
        let innovation = [measured.center.u - self.axes[0].x, measured.center.v - self.axes[1].x];
        let place = self.covariance.column(0).into_owned();
        let expected_px2 = place.x + measured.variance_px2;
        let square = (innovation[0] * innovation[0] + innovation[1] * innovation[1]) / expected_px2;
        if square > RESTART_SQUARED {
            *self = Self::new(measured);
            return;
        }
        let mean =
            self.normalized_innovation + (0.5 * square - self.normalized_innovation) / MEAN_COUNT;
        self.normalized_innovation = mean.max(0.25 * square);
        let gain = place / expected_px2;
        for (axis, innovation) in self.axes.iter_mut().zip(innovation) {
            *axis += gain * innovation;
        }
        self.covariance -= gain * place.transpose();
    }

    fn predict(&mut self, t: f64, px_per_m: f64) {
        let step = Matrix3::new(1.0, t, 0.5 * t * t, 0.0, 1.0, t, 0.0, 0.0, 1.0);
        for axis in &mut self.axes {
            *axis = step * *axis;
        }
        let q = JERK * px_per_m * px_per_m * t;
        let (place_speed, place_acceleration) = (t.powi(3) / 8.0, t * t / 6.0);
        let speed_acceleration = 0.5 * t;
        let process_noise = Matrix3::new(
            t.powi(4) / 20.0,
            place_speed,
            place_acceleration,
            place_speed,
            t * t / 3.0,
            speed_acceleration,
            place_acceleration,
            speed_acceleration,
            1.0,
        );
        self.covariance = step * self.covariance * step.transpose() + process_noise * q;
    }

    /// Velocity, px/s, and the variance of either component.
    pub fn velocity(&self) -> (Vector2<f64>, f64) {
        let velocity = Vector2::new(self.axes[0].y, self.axes[1].y);
        (velocity, self.covariance.m22 * self.normalized_innovation.max(1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PX_PER_M: f64 = 200.0;
    const RATE_HZ: f64 = 60.0;

    fn sighting(time_s: f64, [u, v]: [f64; 2]) -> CenterMeasurement {
        CenterMeasurement {
            time: Timestamp::from_ns(1 << 60).plus_seconds(time_s),
            center: PixelPoint { u, v },
            variance_px2: 1e-4,
            px_per_m: PX_PER_M,
        }
    }

    /// An object on a circle of 2.5 m at 3 m/s, with errors of 0.01 px.
    fn circling(time_s: f64) -> (CenterMeasurement, Vector2<f64>) {
        let (radius_px, speed_px_s) = (2.5 * PX_PER_M, 3.0 * PX_PER_M);
        let (sin, cos) = (speed_px_s / radius_px * time_s).sin_cos();
        let error = |turn: f64| 0.0141 * (turn * time_s * RATE_HZ).sin();
        let at = [radius_px * cos + error(1.9), radius_px * sin + error(2.7)];
        (sighting(time_s, at), Vector2::new(-sin, cos) * speed_px_s)
    }

    #[test]
    fn velocity_errors_match_the_stated_variance() {
        let mut motion = ImageMotion::new(&circling(0.0).0);
        let mut shares = Vec::new();
        for frame in 1..200 {
            let (measured, truth) = circling(f64::from(frame) / RATE_HZ);
            motion.update(&measured);
            let (velocity, variance) = motion.velocity();
            let innovation = (velocity - truth).norm();
            assert!(
                innovation < 3.5 * (2.0 * variance).sqrt(),
                "{frame}: {innovation} of {}",
                variance.sqrt()
            );
            let max = if frame == 1 { 15.0 } else { 5.0 };
            assert!(variance.sqrt() < max, "{frame}: {}", variance.sqrt());
            if frame > 2 {
                shares.push(innovation * innovation / (2.0 * variance));
            }
        }
        let mean = shares.iter().sum::<f64>() / shares.len() as f64;
        assert!(mean > 0.1 && mean < 1.2, "{mean}");
    }

    #[test]
    fn an_unknown_velocity_has_the_prior_variance() {
        let (velocity, variance) = ImageMotion::new(&circling(0.0).0).velocity();
        assert_eq!(velocity, Vector2::zeros());
        assert_eq!(variance.sqrt(), SPEED_M_S * PX_PER_M);
    }

    #[test]
    fn gaps_and_jumps_restart_the_filter() {
        let (first, second) = (circling(0.0).0, circling(1.0 / RATE_HZ).0);
        let mut motion = ImageMotion::new(&first);
        motion.update(&second);
        let before = motion.velocity();
        motion.update(&second);
        assert_eq!(motion.velocity(), before, "the same frame twice");
        let restarts = |measured: CenterMeasurement| {
            let mut motion = motion;
            motion.update(&measured);
            motion.velocity() == ImageMotion::new(&measured).velocity()
        };
        assert!(!restarts(circling(2.0 / RATE_HZ).0));
        assert!(restarts(circling(0.9).0), "after a gap");
        assert!(restarts(first), "a clock set back");
        assert!(restarts(sighting(2.0 / RATE_HZ, [0.0, 900.0])), "elsewhere");
    }

    #[test]
    fn a_jittering_clock_widens_the_variance() {
        let mut variances = [0.0, 1e-3].map(|jitter_s| {
            let mut motion = ImageMotion::new(&circling(0.0).0);
            let mut worst: f64 = 0.0;
            for frame in 1..100 {
                let time_s = f64::from(frame) / RATE_HZ;
                let (mut measured, truth) = circling(time_s);
                measured.time =
                    measured.time.plus_seconds(jitter_s * (2.3 * f64::from(frame)).sin());
                motion.update(&measured);
                let (velocity, variance) = motion.velocity();
                // The filter needs some frames to notice.
                if frame > 8 {
                    worst = worst.max((velocity - truth).norm() / variance.sqrt());
                }
            }
            assert!(worst < 5.0, "{jitter_s}: {worst}");
            motion.velocity().1
        });
        variances.sort_by(f64::total_cmp);
        assert!(variances[1] > 4.0 * variances[0], "{variances:?}");
    }
}
