//! Closed-form paths of robots, evaluated at any time without state.
//!
//! A moving robot follows a *lane*, a closed rounded rectangle
//!
//! x = (a + w(t)) (cos θ - h cos 3θ) / (1 - h),  y = (b + w(t)) (sin θ + h sin 3θ) / (1 - h)
//!
//! with θ(t) = θ₀ ± (ω t + s(t)), where w moves it sideways and s varies its speed. Flying robots also rise and sink. A
//! ground robot turns with its heading; the normal of a flying one follows its specific thrust (a + g ẑ), as for a
//! multicopter.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::jet::{Jet, Wave};

/// Share of the third harmonic that turns an ellipse into a rounded rectangle.
const SQUARENESS: f64 = 0.08;
/// Standard gravity, m/s².
const GRAVITY_M_S2: f64 = 9.806_65;

#[derive(Clone, Debug)]
pub(super) enum Path {
    Still { position_m: Vector3<f64>, yaw_rad: f64 },
    Lane(LanePath),
}

#[derive(Clone, Debug)]
pub(super) struct LanePath {
    /// Semiaxes a, b of the lane.
    pub semiaxes_m: [f64; 2],
    /// θ₀.
    pub start_rad: f64,
    /// ω, with the direction as its sign.
    pub rate_rad_s: f64,
    /// s: along the lane, radians.
    pub along_lane: Wave,
    /// w: across the lane, metres.
    pub weave: Wave,
    /// Mean height and its variation.
    pub height_m: f64,
    pub climb: Wave,
    /// For a flying robot: its heading at time zero and its turning rate.
    pub heading: Option<[f64; 2]>,
}

/// Position with derivatives, world frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    pub position_m: Vector3<f64>,
    pub velocity_m_s: Vector3<f64>,
    pub acceleration_m_s2: Vector3<f64>,
    pub jerk_m_s3: Vector3<f64>,
}

/// Orientation (world_from_roundel) and angular velocity (world frame).
#[derive(Clone, Copy, Debug)]
pub(super) struct Attitude {
    pub orientation: UnitQuaternion<f64>,
    pub angular_velocity_rad_s: Vector3<f64>,
}

impl Path {
    pub fn is_still(&self) -> bool {
        matches!(self, Path::Still { .. })
    }

    pub fn is_flying(&self) -> bool {
        matches!(self, Path::Lane(lane) if lane.heading.is_some())
    }

    /// Motion of the roundel's centre, `t` seconds after the scenario's start.
    pub fn motion(&self, t: f64) -> Motion {
        match self {
            Path::Still { position_m, .. } => Motion {
                position_m: *position_m,
                velocity_m_s: Vector3::zeros(),
                acceleration_m_s2: Vector3::zeros(),
                jerk_m_s3: Vector3::zeros(),
            },
            Path::Lane(lane) => lane.motion(t),
        }
    }

    /// Orientation of the roundel for this motion.
    pub fn attitude(&self, t: f64, motion: &Motion) -> Attitude {
        match self {
            Path::Still { yaw_rad, .. } => Attitude {
                orientation: UnitQuaternion::from_axis_angle(&Vector3::z_axis(), *yaw_rad),
                angular_velocity_rad_s: Vector3::zeros(),
            },
            Path::Lane(lane) => match lane.heading {
                Some([heading_rad, turn_rad_s]) => {
                    flying_attitude(heading_rad + turn_rad_s * t, turn_rad_s, motion)
                }
                None => driving_attitude(motion),
            },
        }
    }
}

impl LanePath {
    fn motion(&self, t: f64) -> Motion {
        let direction = self.rate_rad_s.signum();
        let angle = Jet::linear(self.start_rad, self.rate_rad_s, t)
            + self.along_lane.at(t).scale(direction);
        let weave = self.weave.at(t);
        let [x_unit, y_unit] = lane_shape(angle);
        let x = (Jet::constant(self.semiaxes_m[0]) + weave) * x_unit;
        let y = (Jet::constant(self.semiaxes_m[1]) + weave) * y_unit;
        let z = Jet::constant(self.height_m) + self.climb.at(t);
        let [position_m, velocity_m_s, acceleration_m_s2, jerk_m_s3] =
            std::array::from_fn(|order| Vector3::new(x.0[order], y.0[order], z.0[order]));
        Motion { position_m, velocity_m_s, acceleration_m_s2, jerk_m_s3 }
    }

    /// Upper bound of the acceleration, m/s², by the triangle inequality.
    pub fn acceleration_bound_m_s2(&self) -> f64 {
        // Largest |d/dθ| and |d²/dθ²| of either coordinate of the unit shape.
        const FIRST: f64 = (1.0 + 3.0 * SQUARENESS) / (1.0 - SQUARENESS);
        const SECOND: f64 = (1.0 + 9.0 * SQUARENESS) / (1.0 - SQUARENESS);
        let [weave, weave1, weave2] = amplitudes(&self.weave);
        let [_, hurry1, hurry2] = amplitudes(&self.along_lane);
        let rate = self.rate_rad_s.abs() + hurry1;
        let axis = |semiaxis: f64| {
            // A coordinate of the shape is at most (1 + h) / (1 - h).
            let reach = (1.0 + SQUARENESS) / (1.0 - SQUARENESS);
            weave2 * reach
                + 2.0 * weave1 * FIRST * rate
                + (semiaxis + weave) * (SECOND * rate * rate + FIRST * hurry2)
        };
        let vertical = amplitudes(&self.climb)[2];
        Vector3::new(axis(self.semiaxes_m[0]), axis(self.semiaxes_m[1]), vertical).norm()
    }

    /// The same path, `factor` times as fast: accelerations change by its square.
    pub fn with_pace(mut self, factor: f64) -> Self {
        self.rate_rad_s *= factor;
        for wave in [&mut self.along_lane, &mut self.weave, &mut self.climb] {
            wave.rate_rad_s *= factor;
        }
        self
    }
}

/// Lane with unit semiaxes.
fn lane_shape(angle: Jet) -> [Jet; 2] {
    let (sine, cosine) = angle.sin_cos();
    let (sine3, cosine3) = angle.scale(3.0).sin_cos();
    let norm = 1.0 / (1.0 - SQUARENESS);
    [
        (cosine + cosine3.scale(-SQUARENESS)).scale(norm),
        (sine + sine3.scale(SQUARENESS)).scale(norm),
    ]
}

/// Point of a lane at an angle, in the arena's plane.
pub(super) fn lane_point(semiaxes_m: [f64; 2], angle_rad: f64) -> [f64; 2] {
    let [x, y] = lane_shape(Jet::constant(angle_rad));
    [semiaxes_m[0] * x.0[0], semiaxes_m[1] * y.0[0]]
}

pub(super) fn lane_length_m(semiaxes_m: [f64; 2]) -> f64 {
    const STEPS: usize = 256;
    let point = |i: usize| {
        let [x, y] = lane_point(semiaxes_m, std::f64::consts::TAU * i as f64 / STEPS as f64);
        nalgebra::Vector2::new(x, y)
    };
    (0..STEPS).map(|i| (point(i + 1) - point(i)).norm()).sum()
}

fn amplitudes(wave: &Wave) -> [f64; 3] {
    let (amplitude, rate) = (wave.amplitude.abs(), wave.rate_rad_s.abs());
    [amplitude, amplitude * rate, amplitude * rate * rate]
}

fn driving_attitude(motion: &Motion) -> Attitude {
    let (velocity, acceleration) = (motion.velocity_m_s, motion.acceleration_m_s2);
    let heading_rad = velocity.y.atan2(velocity.x);
    let turn = velocity.x * acceleration.y - velocity.y * acceleration.x;
    // A robot at rest keeps its heading.
    let rate_rad_s = turn / velocity.xy().norm_squared().max(1e-12);
    Attitude {
        orientation: UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading_rad),
        angular_velocity_rad_s: Vector3::new(0.0, 0.0, rate_rad_s),
    }
}

/// Smallest rotation of z to the thrust's direction, after the heading about z. Its rate follows from the
/// quaternion Q = (1 + n·z, z × n): ω = 2 vec(Q̇ Q*) / |Q|².
fn flying_attitude(heading_rad: f64, turn_rad_s: f64, motion: &Motion) -> Attitude {
    let thrust = motion.acceleration_m_s2 + Vector3::new(0.0, 0.0, GRAVITY_M_S2);
    let length = thrust.norm();
    let normal = thrust / length;
    let normal_rate = (motion.jerk_m_s3 - normal * normal.dot(&motion.jerk_m_s3)) / length;
    let tilt = Quaternion::new(1.0 + normal.z, -normal.y, normal.x, 0.0);
    let tilt_rate = Quaternion::new(normal_rate.z, -normal_rate.y, normal_rate.x, 0.0);
    let tilting = (tilt_rate * tilt.conjugate()).imag() * (2.0 / tilt.norm_squared());
    let heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading_rad);
    Attitude {
        orientation: UnitQuaternion::from_quaternion(tilt) * heading,
        angular_velocity_rad_s: tilting + normal * turn_rad_s,
    }
}
