//! Path of a robot that commands may drive: a sequence of legs with smooth velocity changes.
//!
//! Input: commanded velocities with start and end times, and additional pushes. Output: the robot's motion at any time in
//! closed form, so that cameras with different exposure times see the same world. On a leg, the velocity approaches its
//! target u as a critically damped oscillator with ω = 4 rad/s: with e = v - u, e'' + 2 ω e' + ω² e = 0, so
//!
//! e(t) = (e₀ + c t) e^(-ωt), c = e₀' + ω e₀, and its integral is e₀ (1 - E)/ω + c (1 - E (1 + ωt))/ω², E = e^(-ωt).
//!
//! Velocity and acceleration are continuous between legs and from the original path to the first leg. A velocity change of
//! 1 m/s takes at most 1.5 m/s². A robot at a wall of the arena slides along it; only there the velocity jumps.

use std::collections::VecDeque;

use nalgebra::{UnitQuaternion, Vector3};

use super::path::{Attitude, Motion, Path};

/// ω.
const RESPONSE_RAD_S: f64 = 4.0;
/// Legs that ended earlier are dropped.
const HISTORY_S: f64 = 10.0;

/// A commanded velocity for a limited time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drive {
    /// World frame, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// Start and end, seconds after the scenario's start.
    pub span_s: [f64; 2],
}

impl Drive {
    fn at(drive: Option<&Drive>, time_s: f64) -> Vector3<f64> {
        drive
            .filter(|drive| drive.is_active(time_s))
            .map_or_else(Vector3::zeros, |d| d.velocity_m_s)
    }

    fn is_active(&self, time_s: f64) -> bool {
        (self.span_s[0]..self.span_s[1]).contains(&time_s)
    }
}

/// Limits of a robot's position, world frame, metres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Walls {
    pub min_m: Vector3<f64>,
    pub max_m: Vector3<f64>,
}

/// The path of a robot, and the legs that replace it.
#[derive(Clone, Debug)]
pub(super) struct DrivenPath {
    /// The path without commands.
    pub path: Path,
    legs: VecDeque<Leg>,
    /// Whether old legs were dropped.
    is_truncated: bool,
    /// Orientation of a ground robot when it was first commanded; it may drive sideways.
    orientation: Option<UnitQuaternion<f64>>,
    walls: Walls,
    command: Option<Drive>,
    push: Option<Drive>,
}

#[derive(Clone, Copy, Debug)]
struct Leg {
    start_s: f64,
    position_m: Vector3<f64>,
    /// u.
    target_m_s: Vector3<f64>,
    /// e₀ and e₀'.
    excess_m_s: Vector3<f64>,
    excess_rate_m_s2: Vector3<f64>,
}

impl Leg {
    fn motion(&self, time_s: f64) -> Motion {
        let (t, w) = ((time_s - self.start_s).max(0.0), RESPONSE_RAD_S);
        let fading = (-w * t).exp();
        let c = self.excess_rate_m_s2 + self.excess_m_s * w;
        let e = (self.excess_m_s + c * t) * fading;
        let e1 = c * fading - e * w;
        let travelled =
            self.excess_m_s * ((1.0 - fading) / w) + c * ((1.0 - fading * (1.0 + w * t)) / (w * w));
        Motion {
            position_m: self.position_m + self.target_m_s * t + travelled,
            velocity_m_s: self.target_m_s + e,
            acceleration_m_s2: e1,
            jerk_m_s3: e1 * (-2.0 * w) - e * (w * w),
        }
    }
}

impl DrivenPath {
    pub fn new(path: Path, walls: Walls) -> Self {
        let legs = VecDeque::new();
        Self {
            path,
            legs,
            is_truncated: false,
            orientation: None,
            walls,
            command: None,
            push: None,
        }
    }

    fn take_over(&mut self, time_s: f64) {
        let path = &self.path;
        let orientation = || path.attitude(time_s, &path.motion(time_s)).orientation;
        self.orientation.get_or_insert_with(orientation);
    }

    /// Starts at `position_m` with constant velocity at time 0, and discards earlier commands.
    pub fn start_at(&mut self, position_m: Vector3<f64>, velocity_m_s: Vector3<f64>) {
        self.take_over(0.0);
        self.legs = VecDeque::from([Leg {
            start_s: 0.0,
            position_m,
            target_m_s: velocity_m_s,
            excess_m_s: Vector3::zeros(),
            excess_rate_m_s2: Vector3::zeros(),
        }]);
    }

    /// Replaces the current command.
    pub fn command(&mut self, drive: Drive) {
        self.command = Some(drive);
        self.plan_legs(drive.span_s[0]);
    }

    /// Replaces the current push.
    pub fn push(&mut self, push: Drive) {
        self.push = Some(push);
        self.plan_legs(push.span_s[0]);
    }

    /// Whether the robot has left its original path.
    pub fn has_begun(&self, time_s: f64) -> bool {
        self.is_truncated || self.legs.front().is_some_and(|leg| leg.start_s <= time_s)
    }

    /// Motion at an instant.
    pub fn motion(&self, time_s: f64) -> Motion {
        let free = match self.legs.iter().rev().find(|leg| leg.start_s <= time_s) {
            Some(leg) => leg.motion(time_s),
            None => match self.legs.front() {
                Some(oldest) if self.is_truncated => oldest.motion(oldest.start_s),
                _ => return self.path.motion(time_s),
            },
        };
        self.within_walls(free)
    }

    /// Orientation at an instant.
    pub fn attitude(&self, time_s: f64, motion: &Motion) -> Attitude {
        match self.orientation {
            Some(orientation) if self.has_begun(time_s) && !self.path.is_flying() => {
                Attitude { orientation, angular_velocity_rad_s: Vector3::zeros() }
            }
            _ => self.path.attitude(time_s, motion),
        }
    }

    /// Recomputes the legs from `from_s` on.
    fn plan_legs(&mut self, from_s: f64) {
        self.take_over(from_s);
        let mut state = self.motion(from_s);
        self.legs.retain(|leg| leg.start_s < from_s);
        let spans =
            [&self.command, &self.push].into_iter().flatten().flat_map(|drive| drive.span_s);
        let mut change_times_s: Vec<f64> = spans.filter(|&time_s| time_s > from_s).collect();
        change_times_s.push(from_s);
        change_times_s.sort_by(f64::total_cmp);
        for start_s in change_times_s {
            if let Some(leg) = self.legs.back().filter(|leg| leg.start_s >= from_s) {
                state = self.within_walls(leg.motion(start_s));
            }
            let target_m_s =
                Drive::at(self.command.as_ref(), start_s) + Drive::at(self.push.as_ref(), start_s);
            self.legs.push_back(Leg {
                start_s,
                position_m: state.position_m,
                target_m_s,
                excess_m_s: state.velocity_m_s - target_m_s,
                excess_rate_m_s2: state.acceleration_m_s2,
            });
        }
        while self.legs.get(1).is_some_and(|next| next.start_s < from_s - HISTORY_S) {
            self.legs.pop_front();
            self.is_truncated = true;
        }
    }

    fn within_walls(&self, mut motion: Motion) -> Motion {
        for axis in 0..3 {
            let (min, max) = (self.walls.min_m[axis], self.walls.max_m[axis]);
            let inside = motion.position_m[axis].clamp(min, max);
            if inside != motion.position_m[axis] || min == max {
                motion.position_m[axis] = inside;
                motion.velocity_m_s[axis] = 0.0;
                motion.acceleration_m_s2[axis] = 0.0;
                motion.jerk_m_s3[axis] = 0.0;
            }
        }
        motion
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WALLS: Walls =
        Walls { min_m: Vector3::new(-5.0, -4.0, 0.3), max_m: Vector3::new(5.0, 4.0, 0.3) };

    fn parked() -> Path {
        Path::Still { position_m: Vector3::new(1.0, -1.0, 0.3), yaw_rad: 0.4 }
    }

    fn drive(velocity_m_s: [f64; 3], span_s: [f64; 2]) -> Drive {
        Drive { velocity_m_s: velocity_m_s.into(), span_s }
    }

    /// Commands at 1 s and 2 s, a push at 1.6 s, and no command afterwards.
    fn driven_path() -> DrivenPath {
        let mut driven_path = DrivenPath::new(parked(), WALLS);
        driven_path.command(drive([1.0, 0.0, 0.0], [1.0, 2.5]));
        driven_path.push(drive([0.0, 1.5, 0.0], [1.6, 2.2]));
        driven_path.command(drive([-0.5, 0.5, 0.0], [2.0, 2.5]));
        driven_path
    }

    #[test]
    fn motion_is_smooth_and_consistent() {
        let (driven_path, step_s) = (driven_path(), 1e-5);
        // Includes the starts of legs.
        for time_s in (0..600).map(|i| f64::from(i) * 0.01) {
            let [before, here, after] =
                [-step_s, 0.0, step_s].map(|off_s| driven_path.motion(time_s + off_s));
            let velocity = (after.position_m - before.position_m) / (2.0 * step_s);
            assert!((velocity - here.velocity_m_s).norm() < 1e-4, "{time_s}: {velocity}");
            let acceleration = (after.velocity_m_s - before.velocity_m_s) / (2.0 * step_s);
            assert!((acceleration - here.acceleration_m_s2).norm() < 1e-3, "{time_s}: {here:?}");
        }
    }

    #[test]
    fn a_robot_reaches_the_commanded_velocity_and_stops_afterwards() {
        let mut driven_path = DrivenPath::new(parked(), WALLS);
        driven_path.command(drive([0.5, -0.25, 0.0], [1.0, 4.0]));
        let command = driven_path.motion(3.9).velocity_m_s;
        assert!((command - Vector3::new(0.5, -0.25, 0.0)).norm() < 1e-3, "{command}");
        let later = driven_path.motion(8.0);
        assert!(later.velocity_m_s.norm() < 1e-4, "{later:?}");
        // Three seconds of it: the delays of start and stop cancel.
        let moved = later.position_m - parked().motion(0.0).position_m;
        assert!((moved - Vector3::new(1.5, -0.75, 0.0)).norm() < 1e-4, "{moved}");
    }

    #[test]
    fn a_placed_robot_keeps_its_velocity_until_commanded() {
        let mut driven_path = driven_path();
        let (start_m, velocity_m_s) = (Vector3::new(-2.0, 1.0, 0.3), Vector3::new(0.5, -0.25, 0.0));
        driven_path.start_at(start_m, velocity_m_s);
        for time_s in [0.0, 0.5, 4.0] {
            let motion = driven_path.motion(time_s);
            assert!((motion.position_m - start_m - velocity_m_s * time_s).norm() < 1e-12);
            assert_eq!(motion.velocity_m_s, velocity_m_s);
        }
        driven_path.command(drive([0.0; 3], [5.0, 9.0]));
        assert!(driven_path.motion(9.0).velocity_m_s.norm() < 1e-4);
    }

    #[test]
    fn commands_do_not_change_the_past() {
        let (whole, mut cut) = (driven_path(), driven_path());
        cut.command(drive([0.0, -1.0, 0.0], [2.3, 9.0]));
        for time_s in [0.0, 1.2, 1.9, 2.29] {
            assert_eq!(whole.motion(time_s).position_m, cut.motion(time_s).position_m);
        }
        assert_ne!(whole.motion(3.0).position_m, cut.motion(3.0).position_m);
    }

    #[test]
    fn walls_stop_a_robot_temporarily() {
        let mut driven_path = DrivenPath::new(parked(), WALLS);
        driven_path.command(drive([1.0, 0.2, 1.0], [0.0, 10.0]));
        let held = driven_path.motion(9.0);
        assert_eq!((held.position_m.x, held.position_m.z), (5.0, 0.3));
        assert_eq!((held.velocity_m_s.x, held.velocity_m_s.z), (0.0, 0.0));
        driven_path.command(drive([-1.0, 0.0, 0.0], [9.0, 12.0]));
        let free = driven_path.motion(11.0);
        assert!(free.position_m.x < 4.0, "{free:?}");
    }

    #[test]
    fn the_history_of_legs_is_bounded() {
        let mut driven_path = DrivenPath::new(parked(), WALLS);
        for step in 0..10_000 {
            let time_s = f64::from(step) * 0.05;
            driven_path.command(drive([0.1, 0.0, 0.0], [time_s, time_s + 0.5]));
        }
        assert!(driven_path.legs.len() < 210, "{}", driven_path.legs.len());
        assert_eq!(driven_path.motion(1.0).position_m, driven_path.motion(2.0).position_m);
    }
}
