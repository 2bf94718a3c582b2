//! One object's motion over time: what measurements come in, the estimate that comes out.
//!
//! A track estimates apart where the roundel's centre is and how fast it moves ([`Motion`]), and how
//! it is turned ([`Attitude`], with both normals that an ellipse allows). Both build on one filter of
//! a value and its rate ([`Kernel`]). [`History`] keeps the measurements of a window, so that a late one is put in
//! its place and the past is filtered again.
//!
//! Motion model: constant velocity, disturbed by white acceleration of spectral density q,
//! F = [I dt·I; 0 I], Q = q [dt³/3·I dt²/2·I; dt²/2·I dt·I] (Bar-Shalom, Li, Kirubarajan,
//! *Estimation with Applications to Tracking and Navigation*, 2001, section 6.2.2).

mod acceleration;
mod attitude;
mod covariance;
mod cusum;
mod floor;
mod history;
mod kalman;
mod motion;
mod process_noise;

pub(crate) use acceleration::{added_by, left_after};
pub use attitude::{Attitude, AttitudeEstimate, AttitudeMeasurement};
pub(crate) use attitude::{smallest_turn, without_yaw};
pub use covariance::Spread;
pub use history::{History, Inserted, TakenBack};
pub use kalman::invert_positive;
pub(crate) use kalman::positive_root;
pub use kalman::{Correction, Innovation, Kernel, MAX_SOURCES, Noise};
pub use motion::{Filter, Motion, MotionEstimate};

use nalgebra::Vector3;

use roundel_vision::{
    id::{CameraId, TrackNumber},
    time::Timestamp,
};

/// How objects can move, and how measurements err; equal for all tracks of a kind.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionModel {
    /// Spectral density of the white acceleration along each axis of the world, m²/s³.
    pub acceleration_density_m2_s3: Vector3<f64>,
    /// Spectral density of the white angular acceleration about each axis of the world, rad²/s³.
    pub angular_density_rad2_s3: Vector3<f64>,
    /// Standard deviation of an unseen velocity along each axis, m/s.
    pub speed_m_s: Vector3<f64>,
    /// Standard deviation of an unseen angular velocity about each axis, rad/s.
    pub angular_speed_rad_s: Vector3<f64>,
    /// Time in which a camera's systematic error forgets itself, s.
    pub systematic_time_s: f64,
    /// Innovations beyond this squared Mahalanobis length are held back to it.
    pub robust_distance_squared: f64,
    /// Log-odds by which a normal straight up is preferred to a level one before any evidence.
    pub upright_log_odds: f64,
    /// Whether the density of what turns its normal is learned while its yaw is observed.
    pub learns_turning: bool,
    /// The floor that it keeps to.
    pub ground: Option<Ground>,
}

/// What holds an object that drives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ground {
    /// Height of the roundel's centre, metres; `None`: the same all the time, but not known.
    pub height_m: Option<f64>,
    /// Standard deviation of it, over the unevenness of floor and robots, metres.
    pub deviation_m: f64,
    /// Standard deviation of the normal from straight up, each of its two angles, radians.
    pub tilt_rad: f64,
}

/// One detection, carried into the world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measurement {
    /// When it was exposed …
    pub time: Timestamp,
    /// … by a stamp that was put back by so much, seconds.
    pub late_s: f64,
    /// Who saw it.
    pub camera: CameraId,
    /// In which of its frames.
    pub frame: u64,
    /// As which of its tracks.
    pub number: TrackNumber,
    /// Roundel's centre, metres.
    pub position_m: Vector3<f64>,
    /// Its error.
    pub position_noise: Noise,
    /// How the roundel is turned.
    pub attitude: AttitudeMeasurement,
}

impl Measurement {
    /// Says how uncertain its camera's clock is, seconds.
    pub fn set_timing(&mut self, timing_s: f64) {
        self.position_noise.timing_s = timing_s;
        self.attitude.set_timing(timing_s);
    }

    /// What orders measurements of one object, whatever the order in which they came.
    fn key(&self) -> (Timestamp, CameraId, u64, TrackNumber) {
        (self.time, self.camera, self.frame, self.number)
    }
}

/// All that is known of one object at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The instant.
    pub time: Timestamp,
    /// Position and velocity of the roundel's centre.
    pub motion: Motion,
    /// Orientation and angular velocity.
    pub attitude: Attitude,
    /// Newest position innovation's squared Mahalanobis length over its 3 degrees of freedom.
    pub residual: f64,
}

/// What is told of one object at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Position and velocity of the roundel's centre.
    pub motion: MotionEstimate,
    /// Orientation and angular velocity.
    pub attitude: AttitudeEstimate,
    /// As in [`Estimate`].
    pub residual: f64,
}

impl Estimate {
    /// What is told of another instant, as after [`Estimate::predict`].
    pub fn look(&self, time: Timestamp, model: &MotionModel) -> Look {
        let dt = time.seconds_since(self.time);
        Look {
            motion: self.motion.estimate(dt, model),
            attitude: self.attitude.estimate(dt, model),
            residual: self.residual,
        }
    }

    /// What one measurement tells; the velocity is the model's prior.
    pub fn begin(measurement: &Measurement, model: &MotionModel) -> Self {
        let mut estimate = Self {
            time: measurement.time,
            motion: Motion::begin(measurement, model),
            attitude: Attitude::begin(&measurement.attitude, measurement.camera, model),
            residual: 1.0,
        };
        estimate.hold(model);
        estimate
    }

    /// Becomes another, without what of it is not there.
    fn copy_from(&mut self, other: &Self) {
        let Self { time, motion, attitude, residual } = other;
        (self.time, self.motion, self.residual) = (*time, *motion, *residual);
        self.attitude.copy_from(attitude);
    }

    /// Holds what drives to its floor.
    fn hold(&mut self, model: &MotionModel) {
        if let Some(ground) = &model.ground {
            self.motion.hold(ground);
            self.attitude.hold(ground);
        }
    }

    /// The same object at another instant. Going back spreads the covariance as much as going
    /// forward, which is more than is true, never less.
    pub fn predict(&mut self, time: Timestamp, model: &MotionModel) {
        let dt = time.seconds_since(self.time);
        if dt == 0.0 {
            return;
        }
        self.time = time;
        self.motion.predict(dt, model);
        self.attitude.predict(dt, model);
    }

    /// Takes in a measurement made at or after this estimate's time.
    pub fn update(&mut self, measurement: &Measurement, model: &MotionModel) {
        self.predict(measurement.time, model);
        let innovation = self.motion.update(measurement, model);
        self.residual = innovation.distance_squared / 3.0;
        self.attitude.update(&measurement.attitude, measurement.camera, model);
        self.hold(model);
    }
}
