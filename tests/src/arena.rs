//! An arena with known truth: cameras, and robots on smooth paths that carry roundels.
//!
//! World frame right-handed with z up, metres; a roundel's z is out of its face. Paths are sums of
//! sines in closed form, so position, velocity and acceleration are exact at any time.

use std::f64::consts::{PI, TAU};

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::{
    normal::Random,
    optics::{Distortion, Pinhole},
    render::{Imaging, Print},
};

/// Standard gravity, m/s².
const GRAVITY_M_S2: f64 = 9.806_65;

/// A camera's place: looking from `position` to `target`, its image upright.
pub fn look_at(position: Vector3<f64>, target: Vector3<f64>) -> Isometry3<f64> {
    let forward = (target - position).normalize();
    // Seen straight from above, the world's y points up in the image.
    let up = if forward.xy().norm() < 1e-6 { Vector3::y() } else { Vector3::z() };
    let right = forward.cross(&up).normalize();
    let down = forward.cross(&right);
    let turn = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[right, down, forward]));
    Isometry3::from_parts(Translation3::from(position), UnitQuaternion::from_rotation_matrix(&turn))
}

/// One camera of the arena.
#[derive(Clone, Debug, PartialEq)]
pub struct Site {
    /// Name in the configuration.
    pub name: String,
    /// Lens.
    pub optics: Pinhole,
    /// Grey values and shutter.
    pub imaging: Imaging,
    /// Place: world_from_camera.
    pub world_from_camera: Isometry3<f64>,
    /// Frames a second.
    pub rate_hz: f64,
    /// Its first frame's capture time after the arena's start, seconds.
    pub offset_s: f64,
}

/// One coordinate's motion: `amplitude · sin(rate · t + phase)`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sine {
    /// Metres.
    pub amplitude_m: f64,
    /// Radians a second.
    pub rate_rad_s: f64,
    /// Radians.
    pub phase_rad: f64,
}

/// A closed or Lissajous path about a centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Path {
    /// Middle of the path.
    pub center_m: Vector3<f64>,
    /// Along x, y and z.
    pub sines: [Sine; 3],
    /// Turns about the vertical, radians a second.
    pub spin_rad_s: f64,
    /// Robots that fly lean into their acceleration; those on the ground stay upright.
    pub flies: bool,
}

impl Path {
    /// The n-th derivative of the position at `t` seconds (0: the position itself).
    fn derivative(&self, n: i32, t: f64) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| {
            let s = self.sines[axis];
            let angle = s.rate_rad_s * t + s.phase_rad + f64::from(n) * PI / 2.0;
            s.amplitude_m * s.rate_rad_s.powi(n) * angle.sin()
        })
    }

    /// Velocity, m/s.
    pub fn velocity(&self, t: f64) -> Vector3<f64> {
        self.derivative(1, t)
    }

    /// Acceleration, m/s².
    pub fn acceleration(&self, t: f64) -> Vector3<f64> {
        self.derivative(2, t)
    }

    /// world_from_roundel at `t` seconds.
    pub fn pose(&self, t: f64) -> Isometry3<f64> {
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.spin_rad_s * t);
        let lift = if self.flies { self.acceleration(t) } else { Vector3::zeros() };
        let normal = lift + Vector3::new(0.0, 0.0, GRAVITY_M_S2);
        let lean = UnitQuaternion::rotation_between(&Vector3::z(), &normal).unwrap_or_default();
        let position = self.center_m + self.derivative(0, t);
        Isometry3::from_parts(Translation3::from(position), lean * yaw)
    }

    /// Greatest acceleration that any part of the path can reach, m/s².
    pub fn peak_acceleration(&self) -> f64 {
        let peak = |s: &Sine| s.amplitude_m.abs() * s.rate_rad_s.powi(2);
        self.sines.iter().map(|s| peak(s).powi(2)).sum::<f64>().sqrt()
    }
}

/// A roundel on a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    /// For reports.
    pub name: String,
    /// Kind of roundel, as configured.
    pub kind: String,
    /// What is printed.
    pub print: Print,
    /// Where it goes.
    pub path: Path,
}

/// A kind of roundel without a code.
#[derive(Clone, Debug, PartialEq)]
pub struct Kind {
    /// Name in the configuration.
    pub name: String,
    /// Black ring's outer diameter, metres.
    pub outer_diameter_m: f64,
    /// White disc's diameter, metres; of an elliptical one the longer.
    pub inner_diameter_m: f64,
    /// The shorter one of an elliptical disc.
    pub inner_minor_m: Option<f64>,
}

impl Kind {
    /// DESIGN's roundel of 160 mm with the paper's ratio.
    pub fn robot() -> Self {
        Self {
            name: "robot".into(),
            outer_diameter_m: 0.16,
            inner_diameter_m: 0.064,
            inner_minor_m: None,
        }
    }
}

/// Where an object truly is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// world_from_roundel.
    pub pose: Isometry3<f64>,
    /// World frame, m/s.
    pub velocity_m_s: Vector3<f64>,
}

/// Cameras and robots, from `start_ns` on.
#[derive(Clone, Debug, PartialEq)]
pub struct Arena {
    /// Unix time of the arena's second 0.
    pub start_ns: i64,
    /// Seeds paths, backgrounds and noise.
    pub seed: u64,
    /// Kinds of roundel in use.
    pub kinds: Vec<Kind>,
    /// Cameras.
    pub sites: Vec<Site>,
    /// Robots.
    pub robots: Vec<Robot>,
}

impl Arena {
    /// DESIGN's R4-lite: four cameras 1280x720 at 30 Hz over 10 × 8 m, unsynchronized, with
    /// `robots` of which a quarter stands still and `flying` of the others fly.
    pub fn r4_lite(seed: u64, robots: usize, flying: usize) -> Self {
        let mut random = Random::new(seed, 0);
        let corners = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)];
        let names = ["southwest", "southeast", "northwest", "northeast"];
        let sites = std::iter::zip(corners, names)
            .map(|((x, y), name)| {
                let k = [random.uniform(-0.10, -0.06), random.uniform(0.01, 0.04)];
                let p = [random.uniform(-5e-4, 5e-4), random.uniform(-5e-4, 5e-4)];
                let distortion = Distortion::PlumbBob([k[0], k[1], p[0], p[1], 0.0]);
                let mut optics = Pinhole::centered(1280, 720, 733.3, distortion);
                optics.center_px[0] += random.uniform(-8.0, 8.0);
                optics.center_px[1] += random.uniform(-8.0, 8.0);
                Site {
                    name: name.into(),
                    optics,
                    imaging: Imaging {
                        gradient: [random.uniform(-0.15, 0.15), random.uniform(-0.15, 0.15)],
                        exposure_s: 4e-3,
                        line_time_s: 12e-6,
                        ..Imaging::default()
                    },
                    world_from_camera: look_at(
                        Vector3::new(2.5 * x, 2.0 * y, 5.0),
                        Vector3::new(1.25 * x, y, 0.0),
                    ),
                    rate_hz: 30.0,
                    offset_s: random.uniform(0.0, 1.0 / 30.0),
                }
            })
            .collect();
        let mut arena = Self {
            start_ns: 1_790_000_000_000_000_000,
            seed,
            kinds: vec![Kind::robot()],
            sites,
            robots: Vec::new(),
        };
        arena.place_robots(robots, flying, &mut random);
        arena
    }

    /// Robots each in its own cell of a grid over 6 × 4.5 m, so that none ever passes through
    /// another.
    fn place_robots(&mut self, count: usize, flying: usize, random: &mut Random) {
        let columns = ((count as f64 * 6.0 / 4.5).sqrt().ceil() as usize).max(1);
        let rows = count.div_ceil(columns).max(1);
        let cell = [6.0 / columns as f64, 4.5 / rows as f64];
        let room_m = (cell[0].min(cell[1]) - 0.35).max(0.0) / 2.0;
        let kind = self.kinds[0].clone();
        for i in 0..count {
            let center_m = Vector3::new(
                ((i % columns) as f64 + 0.5) * cell[0] - 3.0,
                ((i / columns) as f64 + 0.5) * cell[1] - 2.25,
                0.3,
            );
            let stands = i % 4 == 0;
            let flies = !stands && i % 4 <= flying * 4 / count.max(1);
            let path = if stands {
                let sines = [Sine::default(); 3];
                Path { center_m, sines, spin_rad_s: 0.0, flies: false }
            } else {
                wandering(center_m, room_m, flies, random)
            };
            self.robots.push(Robot {
                name: format!("robot {}", i + 1),
                kind: kind.name.clone(),
                print: Print::plain(kind.outer_diameter_m, kind.inner_diameter_m, 0.25),
                path,
            });
        }
    }

    /// Where every robot truly is at this Unix time.
    pub fn truth(&self, time_ns: i64) -> Vec<Truth> {
        let t = (time_ns - self.start_ns) as f64 * 1e-9;
        self.robots
            .iter()
            .map(|robot| Truth { pose: robot.path.pose(t), velocity_m_s: robot.path.velocity(t) })
            .collect()
    }

    /// Mid-exposure of the middle row of a camera's frame, Unix time.
    pub fn capture_time_ns(&self, site: &Site, frame: usize) -> i64 {
        let seconds = site.offset_s + frame as f64 / site.rate_hz;
        self.start_ns + (seconds * 1e9).round() as i64
    }

    /// A point of the world in a camera's pixels; `None` if it is not in its image.
    pub fn pixel(&self, site: &Site, point_m: &Point3<f64>) -> Option<[f64; 2]> {
        let p = site.optics.project(&site.world_from_camera.inverse_transform_point(point_m))?;
        let inside = (-0.5..site.optics.width as f64 - 0.5).contains(&p.x)
            && (-0.5..site.optics.height as f64 - 0.5).contains(&p.y);
        inside.then_some([p.x, p.y])
    }
}

/// A loop within `room_m` of its centre whose accelerations stay below 2 m/s².
fn wandering(center_m: Vector3<f64>, room_m: f64, flies: bool, random: &mut Random) -> Path {
    let sine = |amplitude_m: f64, limit_m_s2: f64, random: &mut Random| {
        let fastest = (limit_m_s2 / amplitude_m.max(0.01)).sqrt().min(2.5);
        let rate_rad_s = random.uniform(0.4, 1.0) * fastest;
        Sine { amplitude_m, rate_rad_s, phase_rad: random.uniform(0.0, TAU) }
    };
    let x = sine(room_m * random.uniform(0.6, 1.0), 1.3, random);
    let y = sine(room_m * random.uniform(0.6, 1.0), 1.3, random);
    let (z, lift_m) = if flies {
        (sine(random.uniform(0.1, 0.3), 0.6, random), random.uniform(0.5, 1.2))
    } else {
        (Sine::default(), 0.0)
    };
    Path {
        center_m: center_m + Vector3::new(0.0, 0.0, lift_m),
        sines: [x, y, z],
        spin_rad_s: random.uniform(-0.8, 0.8),
        flies,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_look_where_they_should() {
        for position in [Vector3::new(2.5, 2.0, 5.0), Vector3::new(0.0, 0.0, 4.0)] {
            let target = Vector3::new(0.0, 0.0, 0.0);
            let world_from_camera = look_at(position, target);
            let seen = world_from_camera.inverse_transform_point(&Point3::from(target));
            assert!((seen.coords - Vector3::new(0.0, 0.0, position.norm())).norm() < 1e-12);
            // Right-handed, and what is higher in the world is higher in the image (smaller v).
            assert!(
                (world_from_camera.rotation.to_rotation_matrix().matrix().determinant() - 1.0)
                    .abs()
                    < 1e-12
            );
            let higher = if position.x == 0.0 {
                Point3::new(0.0, 0.1, 0.0)
            } else {
                Point3::new(0.0, 0.0, 0.1)
            };
            assert!(world_from_camera.inverse_transform_point(&higher).y < 0.0);
        }
    }

    #[test]
    fn velocities_and_accelerations_are_the_paths_derivatives() {
        let arena = Arena::r4_lite(5, 12, 4);
        assert!(arena.robots.iter().any(|robot| robot.path.flies));
        for robot in &arena.robots {
            let path = &robot.path;
            for t in [0.0, 1.7, 40.2] {
                let at = |t: f64| path.pose(t).translation.vector;
                let velocity = (at(t + 1e-4) - at(t - 1e-4)) / 2e-4;
                assert!((velocity - path.velocity(t)).norm() < 1e-6);
                let turn = (path.velocity(t + 1e-4) - path.velocity(t - 1e-4)) / 2e-4;
                assert!((turn - path.acceleration(t)).norm() < 1e-6);
            }
            assert!(path.peak_acceleration() <= 2.0, "{path:?}");
        }
    }

    #[test]
    fn robots_keep_their_distance() {
        let arena = Arena::r4_lite(1, 8, 2);
        for step in 0..200 {
            let truth = arena.truth(arena.start_ns + step * 100_000_000);
            for (i, one) in truth.iter().enumerate() {
                for other in &truth[..i] {
                    let apart = one.pose.translation.vector - other.pose.translation.vector;
                    assert!(apart.xy().norm() > 0.3);
                }
            }
        }
    }
}
