//! Arenas with ground truth: cameras, and robots with roundels on smooth paths.
//!
//! World frame right-handed with z up, metres; a roundel's z points out of its face. Paths ([`path`]) give position,
//! velocity and acceleration exactly at any time. [`mod@reference`] builds the reference installations, [`moving`]
//! those with cameras mounted on robots.

pub mod moving;
pub mod path;
pub mod realism;
pub mod reference;
pub mod trips;

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::{
    optics::Pinhole,
    render::{Imaging, Print},
};
pub use path::{Course, Path, Sine};

/// Pose of a camera at `position` that looks at `target`, with its image upright.
pub fn look_at(position: Vector3<f64>, target: Vector3<f64>) -> Isometry3<f64> {
    let forward = (target - position).normalize();
    // Seen from straight above, the world's y points up in the image.
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
    pub optics: Pinhole,
    pub imaging: Imaging,
    /// Pose of a fixed camera.
    pub world_from_camera: Isometry3<f64>,
    /// The robot that a moving camera is mounted on.
    pub mount: Option<Mount>,
    pub rate_hz: f64,
    /// Capture time of its first frame after the arena's start.
    pub offset_s: f64,
    pub clock: SiteClock,
}

/// Mount of a moving camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mount {
    /// Index of the robot.
    pub robot: usize,
    /// In the frame of the robot's roundel.
    pub robot_from_camera: Isometry3<f64>,
}

/// A camera's clock: at t seconds after the arena's start it shows `ahead_s + (1 + skew) · t`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SiteClock {
    pub ahead_s: f64,
    pub skew: f64,
}

/// A roundel on a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    /// For reports.
    pub name: String,
    /// Kind of roundel, as configured.
    pub kind: String,
    pub print: Print,
    /// Number of its code, if it has one.
    pub code: Option<u16>,
    pub path: Path,
    /// Intervals in which no camera sees it, seconds, in order.
    pub hidden_s: Vec<(f64, f64)>,
    /// Fixed cameras never see it, as if it drove between shelves.
    pub is_hidden_from_fixed_cameras: bool,
}

impl Robot {
    pub fn is_hidden(&self, t: f64) -> bool {
        let started = self.hidden_s.partition_point(|span| span.0 <= t);
        started > 0 && t < self.hidden_s[started - 1].1
    }
}

/// A kind of roundel.
#[derive(Clone, Debug, PartialEq)]
pub struct Kind {
    /// Name in the configuration.
    pub name: String,
    /// Diameter of the black ring.
    pub outer_diameter_m: f64,
    /// Diameter of the white disc; of an elliptical disc the longer one.
    pub inner_diameter_m: f64,
    /// Shorter diameter of an elliptical disc.
    pub inner_minor_m: Option<f64>,
    /// Code length, if it has a code.
    pub code_bits: Option<u8>,
}

impl Kind {
    /// A roundel of 160 mm with the paper's ratio.
    pub fn robot() -> Self {
        Self {
            name: "robot".into(),
            outer_diameter_m: 0.16,
            inner_diameter_m: 0.064,
            inner_minor_m: None,
            code_bits: None,
        }
    }

    /// A coded roundel of 160 mm.
    pub fn coded(bits: u8) -> Self {
        Self { inner_diameter_m: 0.096, code_bits: Some(bits), ..Self::robot() }
    }
}

/// True state of an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// world_from_roundel.
    pub pose: Isometry3<f64>,
    /// World frame.
    pub velocity_m_s: Vector3<f64>,
    /// Number of its code, if it has one.
    pub code: Option<u16>,
}

/// Cameras and robots.
#[derive(Clone, Debug, PartialEq)]
pub struct Arena {
    /// Unix time of the arena's second 0.
    pub start_ns: i64,
    /// Seed of paths, backgrounds and noise.
    pub seed: u64,
    pub kinds: Vec<Kind>,
    pub sites: Vec<Site>,
    pub robots: Vec<Robot>,
    /// Roundels on walls.
    pub landmarks: Vec<Landmark>,
}

/// A fixed roundel.
#[derive(Clone, Debug, PartialEq)]
pub struct Landmark {
    /// Index of its kind.
    pub kind: usize,
    /// Number of its code.
    pub code: u16,
    /// world_from_roundel.
    pub pose: Isometry3<f64>,
}

impl Arena {
    /// True state of every robot at this Unix time.
    pub fn truth(&self, time_ns: i64) -> Vec<Truth> {
        let t = (time_ns - self.start_ns) as f64 * 1e-9;
        let truth = |robot: &Robot| Truth {
            pose: robot.path.pose(t),
            velocity_m_s: robot.path.velocity(t),
            code: robot.code,
        };
        self.robots.iter().map(truth).collect()
    }

    /// Pose of a camera at `t` seconds: world_from_camera.
    pub fn camera_pose(&self, site: &Site, t: f64) -> Isometry3<f64> {
        match &site.mount {
            Some(mount) => self.robots[mount.robot].path.pose(t) * mount.robot_from_camera,
            None => site.world_from_camera,
        }
    }

    /// Mid-exposure of the centre row of a camera's frame, Unix time.
    pub fn capture_time_ns(&self, site: &Site, frame: usize) -> i64 {
        let seconds = site.offset_s + frame as f64 / site.rate_hz;
        self.start_ns + (seconds * 1e9).round() as i64
    }

    /// Reading of a camera's clock at this Unix time.
    pub fn stated_time_ns(&self, site: &Site, time_ns: i64) -> i64 {
        let t = (time_ns - self.start_ns) as f64 * 1e-9;
        time_ns + ((site.clock.ahead_s + site.clock.skew * t) * 1e9).round() as i64
    }

    /// Pixel of a world point, or `None` if it is outside the image.
    pub fn pixel(&self, site: &Site, point_m: &Point3<f64>) -> Option<[f64; 2]> {
        let p = site.optics.project(&site.world_from_camera.inverse_transform_point(point_m))?;
        let inside = (-0.5..site.optics.width as f64 - 0.5).contains(&p.x)
            && (-0.5..site.optics.height as f64 - 0.5).contains(&p.y);
        inside.then_some([p.x, p.y])
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
            // Right-handed, and higher points in the world are higher in the image (smaller v).
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
    fn robots_are_hidden_during_their_intervals() {
        let mut robot = Arena::r4_lite(1, 1, 0).robots.remove(0);
        robot.hidden_s = vec![(1.0, 1.5), (3.0, 3.5)];
        let hidden = [0.9, 1.0, 1.4, 1.5, 2.9, 3.2, 4.0].map(|t| robot.is_hidden(t));
        assert_eq!(hidden, [false, true, true, false, false, true, false]);
    }

    #[test]
    fn clocks_run_ahead_and_drift() {
        let mut arena = Arena::r4_lite(1, 1, 0);
        let clock = SiteClock { ahead_s: -0.02, skew: 50e-6 };
        arena.sites[0].clock = clock;
        let at = arena.start_ns + 10_000_000_000;
        assert_eq!(arena.stated_time_ns(&arena.sites[0], at) - at, -19_500_000);
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
