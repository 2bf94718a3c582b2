//! Compares a snapshot of simulated robots with the truth.

use roundel_core::{
    sim::{RobotTruth, Scenario},
    world::{LifeStage, Snapshot},
};

/// Maximum distance between an object and its robot.
const MATCH_RADIUS_M: f64 = 0.15;

/// Sums of squared errors of robots in snapshots.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Score {
    still: Sum,
    moving: Sum,
    snapshots: usize,
    /// Tracked objects, summed over all snapshots.
    tracked: usize,
    /// Tracked objects without a robot near them.
    astray: usize,
    /// Tracked objects with a code, and those with the wrong one.
    read: usize,
    misread: usize,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sum {
    count: usize,
    squares_m2: f64,
}

impl Sum {
    fn add(&mut self, error_m: f64) {
        self.count += 1;
        self.squares_m2 += error_m * error_m;
    }

    fn rms_mm(&self) -> Option<f64> {
        (self.count > 0).then(|| (self.squares_m2 / self.count as f64).sqrt() * 1e3)
    }
}

impl Score {
    /// Compares the tracked objects of a snapshot with the robots at `time_s`, the snapshot's pose
    /// time in seconds after the scenario's start.
    pub(super) fn add(&mut self, scenario: &Scenario, snapshot: &Snapshot, time_s: f64) {
        let robots = scenario.truth(time_s);
        self.snapshots += 1;
        for object in &snapshot.objects {
            if object.stage != LifeStage::Tracked {
                continue;
            }
            self.tracked += 1;
            let distance_m = |robot: &RobotTruth| {
                (robot.world_from_roundel.translation.vector - object.position_m).norm()
            };
            let nearest = robots.iter().min_by(|a, b| distance_m(a).total_cmp(&distance_m(b)));
            match nearest.map(|robot| (robot, distance_m(robot))) {
                Some((robot, error_m)) if error_m <= MATCH_RADIUS_M => {
                    if robot.still { &mut self.still } else { &mut self.moving }.add(error_m);
                    self.read += usize::from(object.code.is_some());
                    self.misread += usize::from(object.code.is_some() && object.code != robot.code);
                }
                _ => self.astray += 1,
            }
        }
    }

    /// One line, without the time.
    pub(super) fn line(&self) -> String {
        let millimetres = |sum: &Sum| {
            sum.rms_mm().map_or_else(|| "   –   ".to_owned(), |rms_mm| format!("{rms_mm:4.1} mm"))
        };
        let each = |count: usize| count as f64 / self.snapshots.max(1) as f64;
        let some = |count: usize, what: &str| match count {
            0 => String::new(),
            count => format!(" ({count} {what})"),
        };
        let read = match self.read {
            0 => String::new(),
            read => format!("; read {:.1}{}", each(read), some(self.misread, "misread")),
        };
        format!(
            "error rms: static {}, moving {}; tracked {:.1}{}{read}",
            millimetres(&self.still),
            millimetres(&self.moving),
            each(self.tracked),
            some(self.astray, "astray"),
        )
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};
    use roundel_core::{
        id::ObjectId,
        rigid::Covariance6,
        time::Timestamp,
        world::{ObjectState, Snapshot},
    };

    use super::*;

    fn object(position_m: Vector3<f64>) -> ObjectState {
        ObjectState {
            id: ObjectId(1),
            kind: None,
            body: None,
            code: None,
            stage: LifeStage::Tracked,
            position_m,
            orientation: UnitQuaternion::identity(),
            yaw_observed: false,
            yaw_symmetry: 1,
            velocity_m_s: Vector3::zeros(),
            acceleration_m_s2: Vector3::zeros(),
            angular_velocity_rad_s: Vector3::zeros(),
            covariance: Covariance6::identity(),
            motion_covariance: Covariance6::identity(),
            rotation_covariance: Covariance6::identity(),
            process_noise: Default::default(),
            cameras: Vec::new(),
            trust: 1,
            newest_observation: Timestamp::default(),
            residual: 0.0,
            first_observation: Timestamp::default(),
            observations: 1,
        }
    }

    #[test]
    fn errors_are_sorted_by_motion_and_strays_are_counted() {
        let scenario = Scenario::r4_lite(1);
        let robots = scenario.truth(2.0);
        let at = |still: bool| {
            robots.iter().find(|r| r.still == still).unwrap().world_from_roundel.translation.vector
        };
        let mut tentative = object(Vector3::zeros());
        tentative.stage = LifeStage::Tentative;
        let snapshot = Snapshot {
            objects: vec![
                object(at(true) + Vector3::new(0.003, 0.0, 0.004)),
                object(at(false) + Vector3::new(0.0, 0.012, 0.0)),
                object(Vector3::new(0.0, 0.0, 50.0)),
                tentative,
            ],
            ..Snapshot::default()
        };
        let mut score = Score::default();
        score.add(&scenario, &snapshot, 2.0);
        assert!((score.still.rms_mm().unwrap() - 5.0).abs() < 1e-9);
        assert!((score.moving.rms_mm().unwrap() - 12.0).abs() < 1e-9);
        assert_eq!((score.tracked, score.astray), (3, 1));
        score.add(&scenario, &snapshot, 2.0);
        assert!((score.still.rms_mm().unwrap() - 5.0).abs() < 1e-9);
        assert!(score.line().ends_with("tracked 3.0 (2 astray)"), "{}", score.line());
    }

    #[test]
    fn codes_are_compared_with_those_on_the_robots() {
        let scenario = Scenario::r4(1);
        let robots = scenario.truth(2.0);
        let seen = |index: usize, code: usize| ObjectState {
            code: robots[code].code,
            ..object(robots[index].world_from_roundel.translation.vector)
        };
        let unread = object(robots[5].world_from_roundel.translation.vector);
        let objects = vec![seen(0, 0), seen(1, 1), seen(2, 3), unread];
        let mut score = Score::default();
        score.add(&scenario, &Snapshot { objects, ..Snapshot::default() }, 2.0);
        assert!(score.line().ends_with("tracked 4.0; read 3.0 (1 misread)"), "{}", score.line());
    }
}
