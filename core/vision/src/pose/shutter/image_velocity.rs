//! How fast a followed ring moves in the image.
//!
//! In: where its centre was seen, each time with the instant of its own row. Out: its image velocity at the newest
//! of them, with the variance of either part.
//!
//! Along either axis a Kalman filter of place, velocity and acceleration, whose jerk is white noise of density q:
//! over a step t the three grow by
//!
//! q t⁵/20, q t⁴/8, q t³/6;  q t³/3, q t²/2;  q t
//!
//! Both axes are seen equally well, so that they share one covariance. Nothing is known of a velocity that was
//! not seen, but that things move by metres a second: that is the start, by [`SPEED_M_S`] and the ring's size in
//! the image. Where centres lie farther off than the filter expects (clocks that jitter, blows), by their squares'
//! mean over the last [`MEAN_OF`] or by half of the last one's alone, the variance is so much larger; where one
//! lies somewhere else altogether, the course begins anew.
//!
//! **Accuracy.** At 60 Hz, and centres seen to 0.01 px, a velocity of 600 px/s is known to 3 px/s from the third
//! frame on, to 10 px/s in the second one.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::{camera::PixelPoint, time::Timestamp};

/// Deviation of either part of a velocity of which nothing is known, m/s.
const SPEED_M_S: f64 = 2.0;
/// The same of an acceleration, m/s².
const PUSH_M_S2: f64 = 5.0;
/// q, m²/s⁵: a push that lasts a tenth of a second.
const JERK: f64 = 2.0 * PUSH_M_S2 * PUSH_M_S2 / 0.1;
/// A ring not seen for so long begins anew, seconds.
const LONGEST_S: f64 = 0.5;
/// Centres that tell whether they lie where they are expected, of which the last ones weigh more.
const MEAN_OF: f64 = 4.0;
/// Squared distance from there, in variances, from which on a centre is of another course.
const ELSEWHERE: f64 = 4000.0;

/// A centre seen.
#[derive(Clone, Copy, Debug)]
pub struct Sighting {
    /// When its row was exposed.
    pub time: Timestamp,
    pub center: PixelPoint,
    /// Of either coordinate.
    pub variance_px2: f64,
    /// How large a metre is there in the image.
    pub px_per_m: f64,
}

/// What is known of a ring's motion in the image.
#[derive(Clone, Copy, Debug)]
pub struct Course {
    time: Timestamp,
    /// Place, velocity and acceleration along u and along v, in px and s.
    axes: [Vector3<f64>; 2],
    /// Of either of them.
    covariance: Matrix3<f64>,
    /// Mean square of how far centres lie from where they are expected, in variances.
    surprise: f64,
}

impl Course {
    /// Of a ring seen for the first time.
    pub fn begin(seen: &Sighting) -> Self {
        let axis = |place: f64| Vector3::new(place, 0.0, 0.0);
        let variance = |by_metre: f64| (by_metre * seen.px_per_m).powi(2);
        let known = Vector3::new(seen.variance_px2, variance(SPEED_M_S), variance(PUSH_M_S2));
        Self {
            time: seen.time,
            axes: [axis(seen.center.u), axis(seen.center.v)],
            covariance: Matrix3::from_diagonal(&known),
            surprise: 1.0,
        }
    }

    /// Takes a later sighting in; the same frame once more changes nothing.
    pub fn follow(&mut self, seen: &Sighting) {
        let step_s = seen.time.seconds_since(self.time);
        if step_s == 0.0 {
            return;
        }
        if !(0.0..LONGEST_S).contains(&step_s) {
            *self = Self::begin(seen);
            return;
        }
        self.predict(step_s, seen.px_per_m);
        self.time = seen.time;
        let off = [seen.center.u - self.axes[0].x, seen.center.v - self.axes[1].x];
        let place = self.covariance.column(0).into_owned();
        let expected_px2 = place.x + seen.variance_px2;
        let square = (off[0] * off[0] + off[1] * off[1]) / expected_px2;
        if square > ELSEWHERE {
            *self = Self::begin(seen);
            return;
        }
        let mean = self.surprise + (0.5 * square - self.surprise) / MEAN_OF;
        self.surprise = mean.max(0.25 * square);
        let gain = place / expected_px2;
        for (axis, off) in self.axes.iter_mut().zip(off) {
            *axis += gain * off;
        }
        self.covariance -= gain * place.transpose();
    }

    fn predict(&mut self, t: f64, px_per_m: f64) {
        let step = Matrix3::new(1.0, t, 0.5 * t * t, 0.0, 1.0, t, 0.0, 0.0, 1.0);
        for axis in &mut self.axes {
            *axis = step * *axis;
        }
        let q = JERK * px_per_m * px_per_m * t;
        let (place_speed, place_push) = (t.powi(3) / 8.0, t * t / 6.0);
        let speed_push = 0.5 * t;
        let grown = Matrix3::new(
            t.powi(4) / 20.0,
            place_speed,
            place_push,
            place_speed,
            t * t / 3.0,
            speed_push,
            place_push,
            speed_push,
            1.0,
        );
        self.covariance = step * self.covariance * step.transpose() + grown * q;
    }

    /// Velocity, px/s, and the variance of either part.
    pub fn velocity(&self) -> (Vector2<f64>, f64) {
        let velocity = Vector2::new(self.axes[0].y, self.axes[1].y);
        (velocity, self.covariance.m22 * self.surprise.max(1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PX_PER_M: f64 = 200.0;
    const RATE_HZ: f64 = 60.0;

    fn sighting(time_s: f64, [u, v]: [f64; 2]) -> Sighting {
        Sighting {
            time: Timestamp::from_ns(1 << 60).plus_seconds(time_s),
            center: PixelPoint { u, v },
            variance_px2: 1e-4,
            px_per_m: PX_PER_M,
        }
    }

    /// Something that drives round a circle of 2.5 m at 3 m/s, seen with errors of 0.01 px.
    fn circling(time_s: f64) -> (Sighting, Vector2<f64>) {
        let (radius_px, speed_px_s) = (2.5 * PX_PER_M, 3.0 * PX_PER_M);
        let (sin, cos) = (speed_px_s / radius_px * time_s).sin_cos();
        let error = |turn: f64| 0.0141 * (turn * time_s * RATE_HZ).sin();
        let at = [radius_px * cos + error(1.9), radius_px * sin + error(2.7)];
        (sighting(time_s, at), Vector2::new(-sin, cos) * speed_px_s)
    }

    #[test]
    fn a_velocity_is_as_exact_as_it_says() {
        let mut course = Course::begin(&circling(0.0).0);
        let mut shares = Vec::new();
        for frame in 1..200 {
            let (seen, truth) = circling(f64::from(frame) / RATE_HZ);
            course.follow(&seen);
            let (velocity, variance) = course.velocity();
            let off = (velocity - truth).norm();
            assert!(off < 3.5 * (2.0 * variance).sqrt(), "{frame}: {off} of {}", variance.sqrt());
            let most = if frame == 1 { 15.0 } else { 5.0 };
            assert!(variance.sqrt() < most, "{frame}: {}", variance.sqrt());
            if frame > 2 {
                shares.push(off * off / (2.0 * variance));
            }
        }
        let mean = shares.iter().sum::<f64>() / shares.len() as f64;
        assert!(mean > 0.1 && mean < 1.2, "{mean}");
    }

    #[test]
    fn what_is_known_of_nothing_is_how_things_move() {
        let (velocity, variance) = Course::begin(&circling(0.0).0).velocity();
        assert_eq!(velocity, Vector2::zeros());
        assert_eq!(variance.sqrt(), SPEED_M_S * PX_PER_M);
    }

    #[test]
    fn a_course_that_breaks_off_begins_anew() {
        let (first, second) = (circling(0.0).0, circling(1.0 / RATE_HZ).0);
        let mut course = Course::begin(&first);
        course.follow(&second);
        let before = course.velocity();
        course.follow(&second);
        assert_eq!(course.velocity(), before, "the same frame twice");
        let anew = |seen: Sighting| {
            let mut course = course;
            course.follow(&seen);
            course.velocity() == Course::begin(&seen).velocity()
        };
        assert!(!anew(circling(2.0 / RATE_HZ).0));
        assert!(anew(circling(0.9).0), "after a gap");
        assert!(anew(first), "a clock set back");
        assert!(anew(sighting(2.0 / RATE_HZ, [0.0, 900.0])), "elsewhere");
    }

    #[test]
    fn a_jittering_clock_widens_what_is_known() {
        let mut courses = [0.0, 1e-3].map(|jitter_s| {
            let mut course = Course::begin(&circling(0.0).0);
            let mut worst: f64 = 0.0;
            for frame in 1..100 {
                let time_s = f64::from(frame) / RATE_HZ;
                let (mut seen, truth) = circling(time_s);
                seen.time = seen.time.plus_seconds(jitter_s * (2.3 * f64::from(frame)).sin());
                course.follow(&seen);
                let (velocity, variance) = course.velocity();
                // It takes some frames to be seen.
                if frame > 8 {
                    worst = worst.max((velocity - truth).norm() / variance.sqrt());
                }
            }
            assert!(worst < 5.0, "{jitter_s}: {worst}");
            course.velocity().1
        });
        courses.sort_by(f64::total_cmp);
        assert!(courses[1] > 4.0 * courses[0], "{courses:?}");
    }
}
