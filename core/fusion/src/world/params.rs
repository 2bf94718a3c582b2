//! Parameters of fusion; the defaults are those of `deploy/roundel.example.toml`.

use nalgebra::Vector3;

use crate::track::{Ground, MotionModel};

/// Duration of an acceleration as seen by a filter with a memory of a tenth of a second. Converts the rms
/// acceleration a into the density of a white one, q = a² · T. Chosen so that errors and covariances agree in the
/// scenarios of `core/tests/fusion`.
const ACCELERATION_TIME_S: f64 = 0.1;

/// Squared Mahalanobis length up to which innovations have full weight (χ², 3 degrees of freedom, 0.999).
const ROBUST_DISTANCE_SQUARED: f64 = 16.3;

/// Prior log-odds of a face that looks up against one to the side.
const UPRIGHT_LOG_ODDS: f64 = 3.0;

/// The same for an object that drives.
const GROUND_LOG_ODDS: f64 = 30.0;
/// Standard deviation of the tilt of an object that drives.
const TILT_RAD: f64 = 0.02;
/// Rms angular acceleration and angular speed of its tilt.
const ROCKING_RAD_S2: f64 = 1.0;
const ROCKING_RAD_S: f64 = 0.1;
/// Standard deviation of a floor's height, metres.
pub(super) const FLOOR_M: f64 = 0.003;
/// Rms vertical acceleration and speed of an object that drives.
const BUMP_M_S2: f64 = 0.05;
const SLOPE_M_S: f64 = 0.05;

/// How objects of a kind move.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum MotionClass {
    /// Free motion in all directions, as of objects that fly.
    #[default]
    Free,
    /// Upright on a level floor.
    Ground {
        /// Height of the roundel's centre in the world, metres. With it a single camera locates as precisely as
        /// it measures angles (2D mode); `None`: the height is estimated.
        height_m: Option<f64>,
    },
}

impl MotionClass {
    /// Height to which objects are constrained.
    pub(super) fn height_m(self) -> Option<f64> {
        match self {
            Self::Ground { height_m } => height_m,
            Self::Free => None,
        }
    }

    /// Motion of a point `by_m` above.
    pub(super) fn raised(self, by_m: f64) -> Self {
        match self {
            Self::Ground { height_m } => {
                Self::Ground { height_m: height_m.map(|height_m| height_m + by_m) }
            }
            Self::Free => self,
        }
    }
}

/// Parameters of fusion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FusionParams {
    /// Rms acceleration of objects, m/s².
    pub acceleration_m_s2: f64,
    /// Rms angular acceleration of objects, rad/s².
    pub angular_acceleration_rad_s2: f64,
    /// Rms speed of a new object along each axis, m/s.
    pub speed_m_s: f64,
    /// Rms angular speed of a new object about each axis, rad/s.
    pub angular_speed_rad_s: f64,
    /// Largest age, against the newest observation, at which one is still used.
    pub late_window_ns: i64,
    /// Largest advance of a frame's capture time before all others, relative to receiving times; frames beyond
    /// are rejected.
    pub max_lead_ns: i64,
    /// A tentative track ends after this time without detection.
    pub tentative_after_ns: i64,
    /// A track becomes predicted after this time without detection.
    pub predicted_after_ns: i64,
    /// A track is lost after this time without detection.
    pub lost_after_ns: i64,
    /// Number of detections that confirm a track.
    pub confirm_hits: u64,
    /// Largest number of tracks.
    pub max_objects: usize,
    /// Gate: largest squared Mahalanobis length (3 degrees of freedom) of an innovation; the default passes
    /// 0.9999 of the true ones.
    pub gate_distance_squared: f64,
    /// Share of each observation's covariance that is systematic: common to a camera's frames and not averaged
    /// out, 0 to 1.
    pub systematic_share: f64,
    /// Relative standard deviation of the focal lengths in camera models, which moves objects along the optical axis.
    pub focal_deviation: f64,
    /// Correlation time of the systematic error, s.
    pub systematic_time_s: f64,
    /// Longest time for which a camera that suddenly disagrees with all others is held back, until the camera
    /// monitor has decided. 0 disables holding back.
    pub held_back_ns: i64,
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
            focal_deviation: 0.0,
            systematic_time_s: 1.0,
            held_back_ns: 3_000_000_000,
        }
    }
}

impl FusionParams {
    /// The filter's model for objects of this motion class.
    pub(super) fn motion_model(&self, class: &MotionClass) -> MotionModel {
        let density = |rms: f64| rms * rms * ACCELERATION_TIME_S;
        let level = density(self.acceleration_m_s2);
        let turning = density(self.angular_acceleration_rad_s2);
        let free = MotionModel {
            acceleration_density_m2_s3: Vector3::repeat(level),
            angular_density_rad2_s3: Vector3::repeat(turning),
            speed_m_s: Vector3::repeat(self.speed_m_s),
            angular_speed_rad_s: Vector3::repeat(self.angular_speed_rad_s),
            systematic_time_s: self.systematic_time_s,
            robust_distance_squared: ROBUST_DISTANCE_SQUARED,
            upright_log_odds: UPRIGHT_LOG_ODDS,
            learns_rotation_density: true,
            ground: None,
        };
        match *class {
            MotionClass::Free => free,
            MotionClass::Ground { height_m } => MotionModel {
                acceleration_density_m2_s3: Vector3::new(level, level, density(BUMP_M_S2)),
                angular_density_rad2_s3: Vector3::new(
                    density(ROCKING_RAD_S2),
                    density(ROCKING_RAD_S2),
                    turning,
                ),
                speed_m_s: Vector3::new(self.speed_m_s, self.speed_m_s, SLOPE_M_S),
                angular_speed_rad_s: Vector3::new(
                    ROCKING_RAD_S,
                    ROCKING_RAD_S,
                    self.angular_speed_rad_s,
                ),
                upright_log_odds: GROUND_LOG_ODDS,
                ground: Some(Ground { height_m, deviation_m: FLOOR_M, tilt_rad: TILT_RAD }),
                ..free
            },
        }
    }
}
