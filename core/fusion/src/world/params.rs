//! What fusion can be told; the defaults are those of `deploy/roundel.example.toml`.

use nalgebra::Vector3;

use crate::track::{Ground, MotionModel};

/// How long an acceleration lasts, as seen by a filter that remembers a tenth of a second: turns
/// the acceleration that objects are capable of into the density of a white one, q = a² · T. Found
/// in the scenarios of `core/tests/fusion.rs`, where it makes errors and covariances agree.
const ACCELERATION_TIME_S: f64 = 0.1;

/// Squared Mahalanobis length up to which an innovation is believed as it is (χ², 3 degrees of
/// freedom, 0.999); longer ones are held back to it.
const ROBUST_DISTANCE_SQUARED: f64 = 16.3;

/// Printed faces look up: this much likelier, in log-odds, than to the side.
const UPRIGHT_LOG_ODDS: f64 = 3.0;

/// What drives: its face looks up, …
const GROUND_LOG_ODDS: f64 = 30.0;
/// … within this, …
const TILT_RAD: f64 = 0.02;
/// … and rocks by so much at most, rms.
const ROCKING_RAD_S2: f64 = 1.0;
const ROCKING_RAD_S: f64 = 0.1;
/// Its floor is even to this, m, …
pub(super) const FLOOR_M: f64 = 0.003;
/// … so that up and down it moves by so much at most, rms.
const BUMP_M_S2: f64 = 0.05;
const SLOPE_M_S: f64 = 0.05;

/// How objects of a kind move.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum MotionClass {
    /// Any way they like, as what flies.
    #[default]
    Free,
    /// On a level floor, upright.
    Ground {
        /// Height of the roundel's centre in the world, metres: with it one camera alone locates as
        /// exactly as it sees (2D mode); `None`: it is measured.
        height_m: Option<f64>,
    },
}

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
    /// A camera that suddenly disagrees with all others as if it had moved is held back, for so long at most:
    /// until then who watches the cameras has judged it. 0: none is.
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
            systematic_time_s: 1.0,
            held_back_ns: 3_000_000_000,
        }
    }
}

impl FusionParams {
    /// The filter's view of these parameters, of objects that move like this.
    pub(super) fn motion_model(&self, class: &MotionClass) -> MotionModel {
        let density = |most: f64| most * most * ACCELERATION_TIME_S;
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
