//! What fusion can be told; the defaults are those of `deploy/roundel.example.toml`.

use crate::track::MotionModel;

/// How long an acceleration lasts, as seen by a filter that remembers a tenth of a second: turns
/// the acceleration that objects are capable of into the density of a white one, q = a² · T. Found
/// in the scenarios of `core/tests/fusion.rs`, where it makes errors and covariances agree.
const ACCELERATION_TIME_S: f64 = 0.1;

/// Squared Mahalanobis length up to which an innovation is believed as it is (χ², 3 degrees of
/// freedom, 0.999); longer ones are held back to it.
const ROBUST_DISTANCE_SQUARED: f64 = 16.3;

/// Printed faces look up: this much likelier, in log-odds, than to the side.
const UPRIGHT_LOG_ODDS: f64 = 3.0;

/// Parameters of fusion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FusionParams {
    /// Rms acceleration that objects are capable of, m/s².
    pub acceleration_m_s2: f64,
    /// Rms angular acceleration that objects are capable of, rad/s².
    pub angular_acceleration_rad_s2: f64,
    /// Rms speed of an object at its first sight, each axis, m/s.
    pub speed_m_s: f64,
    /// Rms angular speed of an object at its first sight, each axis, rad/s.
    pub angular_speed_rad_s: f64,
    /// Observations this much older than the newest are still used; older ones are dropped.
    pub late_window_ns: i64,
    /// A frame this far in the future of all others, its receiving time considered, is refused.
    pub max_lead_ns: i64,
    /// A tentative track without support for so long vanishes.
    pub tentative_after_ns: i64,
    /// Not seen for so long: predicted.
    pub predicted_after_ns: i64,
    /// Not seen for so long: lost.
    pub lost_after_ns: i64,
    /// Detections after which a tentative track is trusted.
    pub confirm_hits: u64,
    /// More tracks than this are not followed.
    pub max_objects: usize,
    /// Squared Mahalanobis length (3 degrees of freedom) up to which a detection can be an
    /// object's; the default passes 0.9999 of the true ones.
    pub gate_distance_squared: f64,
    /// Part of each observation's covariance that is the same from frame to frame of one camera
    /// and therefore does not average out, 0 to 1.
    pub systematic_share: f64,
    /// Time in which that part forgets itself, s.
    pub systematic_time_s: f64,
}

impl Default for FusionParams {
    fn default() -> Self {
        Self {
            acceleration_m_s2: 1.5,
            angular_acceleration_rad_s2: 3.0,
            speed_m_s: 3.0,
            angular_speed_rad_s: 3.0,
            late_window_ns: 300_000_000,
            max_lead_ns: 500_000_000,
            tentative_after_ns: 500_000_000,
            predicted_after_ns: 150_000_000,
            lost_after_ns: 2_000_000_000,
            confirm_hits: 3,
            max_objects: 1000,
            gate_distance_squared: 21.1,
            systematic_share: 0.5,
            systematic_time_s: 1.0,
        }
    }
}

impl FusionParams {
    /// The filter's view of these parameters.
    pub(super) fn motion_model(&self) -> MotionModel {
        MotionModel {
            acceleration_density_m2_s3: self.acceleration_m_s2.powi(2) * ACCELERATION_TIME_S,
            angular_density_rad2_s3: self.angular_acceleration_rad_s2.powi(2) * ACCELERATION_TIME_S,
            speed_m_s: self.speed_m_s,
            angular_speed_rad_s: self.angular_speed_rad_s,
            systematic_time_s: self.systematic_time_s,
            robust_distance_squared: ROBUST_DISTANCE_SQUARED,
            upright_log_odds: UPRIGHT_LOG_ODDS,
        }
    }
}
