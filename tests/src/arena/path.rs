//! Paths of robots: position, velocity and acceleration, exact at any time.

use std::{
    f64::consts::{PI, TAU},
    sync::Arc,
};

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::trips::Trips;
use crate::random::Random;

/// Standard gravity.
const GRAVITY_M_S2: f64 = 9.806_65;

/// Motion of one coordinate: `amplitude · sin(rate · t + phase)`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sine {
    pub amplitude_m: f64,
    pub rate_rad_s: f64,
    pub phase_rad: f64,
}

/// Shape of a path relative to its centre.
#[derive(Clone, Debug, PartialEq)]
pub enum Course {
    /// Closed or Lissajous: along x, y and z.
    Sines([Sine; 3]),
    /// Random accelerations.
    Stray(Arc<Stray>),
    /// From stop to stop on the floor.
    Trips(Arc<Trips>),
}

/// A path about a centre.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    pub center_m: Vector3<f64>,
    pub course: Course,
    /// Rotation about the vertical.
    pub spin_rad_s: f64,
    /// Leans into its acceleration like a multicopter; otherwise stays upright.
    pub leans: bool,
}

impl Path {
    /// Stands still, facing the world's x.
    pub fn still(center_m: Vector3<f64>) -> Self {
        let course = Course::Sines([Sine::default(); 3]);
        Self { center_m, course, spin_rad_s: 0.0, leans: false }
    }

    /// A level circle at constant speed; the print's x follows the direction of travel.
    pub fn circuit(center_m: Vector3<f64>, radius_m: f64, speed_m_s: f64, phase_rad: f64) -> Self {
        let rate_rad_s = speed_m_s / radius_m;
        let sine = |phase_rad| Sine { amplitude_m: radius_m, rate_rad_s, phase_rad };
        Self {
            course: Course::Sines([sine(phase_rad + PI / 2.0), sine(phase_rad), Sine::default()]),
            spin_rad_s: rate_rad_s,
            ..Self::still(center_m)
        }
    }

    /// A loop within `room_m` of its centre, with accelerations below 2 m/s². With a `lift_m` it flies that far above
    /// the centre, moves up and down as well, and leans.
    pub fn wandering(
        mut center_m: Vector3<f64>,
        room_m: f64,
        lift_m: Option<(f64, f64)>,
        random: &mut Random,
    ) -> Self {
        let sine = |amplitude_m: f64, limit_m_s2: f64, random: &mut Random| {
            let fastest = (limit_m_s2 / amplitude_m.max(0.01)).sqrt().min(2.5);
            let rate_rad_s = random.uniform(0.4, 1.0) * fastest;
            Sine { amplitude_m, rate_rad_s, phase_rad: random.uniform(0.0, TAU) }
        };
        let x = sine(room_m * random.uniform(0.6, 1.0), 1.3, random);
        let y = sine(room_m * random.uniform(0.6, 1.0), 1.3, random);
        let mut z = Sine::default();
        if let Some((min_m, max_m)) = lift_m {
            z = sine(random.uniform(0.1, 0.3), 0.6, random);
            center_m.z += random.uniform(min_m, max_m);
        }
        let course = Course::Sines([x, y, z]);
        let spin_rad_s = random.uniform(-0.8, 0.8);
        Self { center_m, course, spin_rad_s, leans: lift_m.is_some() }
    }

    /// Position relative to the centre, velocity and acceleration.
    fn motion(&self, t: f64) -> [Vector3<f64>; 3] {
        match &self.course {
            Course::Sines(sines) => along(sines, t),
            Course::Stray(stray) => stray.at(t),
            Course::Trips(trips) => trips.at(t),
        }
    }

    pub fn velocity(&self, t: f64) -> Vector3<f64> {
        self.motion(t)[1]
    }

    pub fn acceleration(&self, t: f64) -> Vector3<f64> {
        self.motion(t)[2]
    }

    /// world_from_roundel at `t` seconds.
    pub fn pose(&self, t: f64) -> Isometry3<f64> {
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.spin_rad_s * t);
        let [offset_m, _, acceleration] = self.motion(t);
        let lift = if self.leans { acceleration } else { Vector3::zeros() };
        let normal = lift + Vector3::new(0.0, 0.0, GRAVITY_M_S2);
        let lean = UnitQuaternion::rotation_between(&Vector3::z(), &normal).unwrap_or_default();
        Isometry3::from_parts(Translation3::from(self.center_m + offset_m), lean * yaw)
    }
}

/// Position, velocity and acceleration. Renderers call it for every point of every rim.
fn along(sines: &[Sine; 3], t: f64) -> [Vector3<f64>; 3] {
    let mut motion = [Vector3::zeros(); 3];
    for (axis, sine) in sines.iter().enumerate().filter(|(_, sine)| sine.amplitude_m != 0.0) {
        let (sin, cos) = (sine.rate_rad_s * t + sine.phase_rad).sin_cos();
        let (reach, rate) = (sine.amplitude_m, sine.rate_rad_s);
        motion[0][axis] = reach * sin;
        motion[1][axis] = reach * rate * cos;
        motion[2][axis] = -reach * rate * rate * sin;
    }
    motion
}

/// Random accelerations: a push with a correlation time of 0.4 s, a spring and a damper that keep the robot near its
/// centre, and a limit.
#[derive(Clone, Debug, PartialEq)]
pub struct Stray {
    /// Position, velocity and acceleration every [`STEP_S`].
    knots: Vec<[Vector3<f64>; 3]>,
}

/// A random acceleration is constant for this long.
const STEP_S: f64 = 0.005;

impl Stray {
    /// `seconds` of motion, after which it stands still. `axes` scales the motion along each axis.
    pub fn new(seconds: f64, axes: &Vector3<f64>, max_m_s2: f64, random: &mut Random) -> Self {
        let (mut position, mut velocity, mut push) =
            (Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
        let kept: f64 = (-STEP_S / 0.4f64).exp();
        let push_m_s2 = 0.45 * max_m_s2 * (1.0 - kept * kept).sqrt();
        let mut knots: Vec<[Vector3<f64>; 3]> = Vec::new();
        for _ in 0..(seconds / STEP_S).ceil() as usize {
            let fresh = Vector3::from_fn(|axis, _| axes[axis] * f64::from(random.normal()));
            push = push * kept + fresh * push_m_s2;
            let mut acceleration: Vector3<f64> = push - position * 12.0 - velocity * 4.0;
            if acceleration.norm() > max_m_s2 {
                acceleration *= max_m_s2 / acceleration.norm();
            }
            knots.push([position, velocity, acceleration]);
            position += velocity * STEP_S + acceleration * (STEP_S * STEP_S / 2.0);
            velocity += acceleration * STEP_S;
        }
        knots.push([position, Vector3::zeros(), Vector3::zeros()]);
        Self { knots }
    }

    fn at(&self, t: f64) -> [Vector3<f64>; 3] {
        let index = ((t / STEP_S).max(0.0) as usize).min(self.knots.len() - 1);
        let [position, velocity, acceleration] = self.knots[index];
        let dt = (t - index as f64 * STEP_S).max(0.0);
        [
            position + velocity * dt + acceleration * (dt * dt / 2.0),
            velocity + acceleration * dt,
            acceleration,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arena::trips;

    fn paths() -> Vec<(Path, f64)> {
        let mut random = Random::new(3, 0);
        let center_m = Vector3::new(1.0, -2.0, 0.3);
        let stray = Stray::new(60.0, &Vector3::new(1.0, 1.0, 0.5), 2.0, &mut random);
        let trips = trips::plan(3, [2.0, 2.0], 60.0, &mut random).remove(0);
        let course = |course| Path { course, ..Path::still(center_m) };
        vec![
            (Path::wandering(center_m, 0.4, Some((0.5, 1.2)), &mut random), 2.0),
            (Path::wandering(center_m, 0.3, None, &mut random), 2.0),
            (Path::circuit(center_m, 2.0, 3.0, 1.0), 4.5 + 1e-9),
            (course(Course::Stray(Arc::new(stray))), 2.0 + 1e-9),
            (course(Course::Trips(Arc::new(trips))), 1.0 + 1e-9),
        ]
    }

    #[test]
    fn velocities_and_accelerations_are_the_paths_derivatives() {
        for (path, max_m_s2) in paths() {
            for step in 0..5000 {
                // Random accelerations jump every 5 ms; between the jumps they are constant.
                let t = 0.0125 + 0.01 * f64::from(step);
                let at = |t: f64| path.pose(t).translation.vector;
                let velocity = (at(t + 1e-4) - at(t - 1e-4)) / 2e-4;
                assert!((velocity - path.velocity(t)).norm() < 1e-5, "{path:?}");
                let turn = (path.velocity(t + 1e-4) - path.velocity(t - 1e-4)) / 2e-4;
                assert!((turn - path.acceleration(t)).norm() < 1e-3, "{path:?}");
                assert!(path.acceleration(t).norm() <= max_m_s2, "{path:?}");
            }
        }
    }

    #[test]
    fn circuits_have_their_speed_and_heading() {
        let path = Path::circuit(Vector3::zeros(), 2.0, 3.0, 0.4);
        for t in [0.0, 0.7, 3.1] {
            assert!((path.velocity(t).norm() - 3.0).abs() < 1e-12);
        }
    }

    #[test]
    fn random_paths_stay_near_their_centres() {
        let mut random = Random::new(9, 0);
        let stray = Stray::new(300.0, &Vector3::new(1.0, 1.0, 0.6), 2.0, &mut random);
        let far = stray.knots.iter().map(|knot| knot[0].norm()).fold(0.0, f64::max);
        assert!((0.1..0.5).contains(&far), "{far}");
    }
}
