//! State estimation for one object: measurements in, position and orientation with rates and covariances out.
//!
//! [`Motion`] estimates position and velocity, [`Attitude`] orientation and angular velocity, with both normals that an
//! ellipse allows. Both use the same filter of a value and its rate ([`Kalman`]). [`History`] keeps the measurements of
//! a time window, so that a late measurement is inserted at its place and the later ones are filtered again.
//!
//! Motion model: constant velocity disturbed by white acceleration of spectral density q, F = [I dt·I; 0 I], Q = q
//! [dt³/3·I dt²/2·I; dt²/2·I dt·I] (Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to Tracking and
//! Navigation*, 2001, section 6.2.2).

mod acceleration;
mod attitude;
mod covariance;
mod cusum;
mod floor;
mod history;
mod kalman;
mod motion;
mod process_noise;

pub(crate) use acceleration::{decay_acceleration, integrate_acceleration};
pub use attitude::{Attitude, AttitudeEstimate, AttitudeMeasurement};
pub(crate) use attitude::{smallest_turn, without_yaw};
pub use covariance::{BlockCovariance, BlockTraces};
pub use history::{History, Inserted, Retraction};
pub(crate) use kalman::cholesky_lower;
pub use kalman::invert_positive;
pub use kalman::{Correction, ErrorSource, Innovation, Kalman, MAX_SOURCES, Noise};
pub use motion::{Motion, MotionEstimate, PositionFilter};

use nalgebra::Vector3;

use roundel_vision::{
    id::{CameraId, TrackNumber},
    time::Timestamp,
};

/// Motion and error model of a track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionModel {
    /// Spectral density of the white acceleration along each axis of the world, m²/s³.
    pub acceleration_density_m2_s3: Vector3<f64>,
    /// Spectral density of the white angular acceleration about each axis of the world, rad²/s³.
    pub angular_density_rad2_s3: Vector3<f64>,
    /// Standard deviation of the initial velocity along each axis, m/s.
    pub speed_m_s: Vector3<f64>,
    /// Standard deviation of the initial angular velocity about each axis, rad/s.
    pub angular_speed_rad_s: Vector3<f64>,
    /// Correlation time of a camera's systematic error, s.
    pub systematic_time_s: f64,
    /// Squared Mahalanobis length above which an innovation is down-weighted (Huber).
    pub robust_distance_squared: f64,
    /// Prior log-odds of a normal that points straight up against a horizontal one.
    pub upright_log_odds: f64,
    /// Whether the density of the normal's rotation is learned while the yaw is observed.
    pub learns_rotation_density: bool,
    /// Constraint for objects that drive on a floor.
    pub ground: Option<Ground>,
}

/// Floor constraint of an object that drives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ground {
    /// Height of the roundel's centre, metres; `None` if it is constant but unknown.
    pub height_m: Option<f64>,
    /// Standard deviation of the height from unevenness of floor and robots, metres.
    pub deviation_m: f64,
    /// Standard deviation of each of the normal's two tilt angles, radians.
    pub tilt_rad: f64,
}

/// One detection in the world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measurement {
    /// Time of exposure, with the camera's clock corrected.
    pub time: Timestamp,
    /// Correction that was subtracted from the camera's stamp, seconds.
    pub clock_correction_s: f64,
    /// Camera that made the detection.
    pub camera: CameraId,
    /// Number of the camera's frame.
    pub frame: u64,
    /// Track number in the camera's tracker.
    pub number: TrackNumber,
    /// Roundel's centre, metres.
    pub position_m: Vector3<f64>,
    /// Error of the position.
    pub position_noise: Noise,
    /// Orientation of the roundel and its error.
    pub attitude: AttitudeMeasurement,
}

impl Measurement {
    /// Sets the standard deviation of the camera's clock, seconds.
    pub fn set_timing(&mut self, timing_s: f64) {
        self.position_noise.timing_s = timing_s;
        self.attitude.set_timing(timing_s);
    }

    /// Sort key that does not depend on the order of arrival.
    fn key(&self) -> (Timestamp, CameraId, u64, TrackNumber) {
        (self.time, self.camera, self.frame, self.number)
    }
}

/// Filter state of one object at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FilterState {
    /// Time of the state.
    pub time: Timestamp,
    /// Position and velocity of the roundel's centre.
    pub motion: Motion,
    /// Orientation and angular velocity.
    pub attitude: Attitude,
    /// Squared Mahalanobis length of the newest position innovation over its 3 degrees of freedom.
    pub residual: f64,
}

/// Estimate of one object at one time, as reported to clients.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Position and velocity of the roundel's centre.
    pub motion: MotionEstimate,
    /// Orientation and angular velocity.
    pub attitude: AttitudeEstimate,
    /// As in [`FilterState`].
    pub residual: f64,
}

impl FilterState {
    /// Estimate at another time. Gives the same as [`FilterState::predict`] followed by an estimate, without
    /// changing the filters.
    pub fn estimate(&self, time: Timestamp, model: &MotionModel) -> Estimate {
        let dt = time.seconds_since(self.time);
        Estimate {
            motion: self.motion.estimate(dt, model),
            attitude: self.attitude.estimate(dt, model),
            residual: self.residual,
        }
    }

    /// State after a first measurement. The velocity is that of the model's prior.
    pub fn begin(measurement: &Measurement, model: &MotionModel) -> Self {
        let mut estimate = Self {
            time: measurement.time,
            motion: Motion::begin(measurement, model),
            attitude: Attitude::begin(&measurement.attitude, measurement.camera, model),
            residual: 1.0,
        };
        estimate.constrain_to_floor(model);
        estimate
    }

    /// Copies without the rival normal's state where there is none.
    fn copy_from(&mut self, other: &Self) {
        let Self { time, motion, attitude, residual } = other;
        (self.time, self.motion, self.residual) = (*time, *motion, *residual);
        self.attitude.copy_from(attitude);
    }

    /// Applies the floor constraint, if the model has one.
    fn constrain_to_floor(&mut self, model: &MotionModel) {
        if let Some(ground) = &model.ground {
            self.motion.constrain_to_floor(ground);
            self.attitude.constrain_to_floor(ground);
        }
    }

    /// Predicts to another time. Going back adds as much process noise as going forward, which overstates the
    /// covariance and never understates it.
    pub fn predict(&mut self, time: Timestamp, model: &MotionModel) {
        let dt = time.seconds_since(self.time);
        if dt == 0.0 {
            return;
        }
        self.time = time;
        self.motion.predict(dt, model);
        self.attitude.predict(dt, model);
    }

    /// Adds a measurement made at or after this state's time.
    pub fn update(&mut self, measurement: &Measurement, model: &MotionModel) {
        self.predict(measurement.time, model);
        let innovation = self.motion.update(measurement, model);
        self.residual = innovation.distance_squared / 3.0;
        self.attitude.update(&measurement.attitude, measurement.camera, model);
        self.constrain_to_floor(model);
    }
}
