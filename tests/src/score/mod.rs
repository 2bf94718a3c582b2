//! Scores snapshots against ground truth: identities, and errors relative to their covariances (`error`).
//!
//! An object is associated with the nearest robot, whatever its code. A change of robot is a swap. The code is
//! compared with the robot's.

mod error;

use std::collections::{HashMap, HashSet};

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use roundel_proto::v1::{self, LifeStage, Snapshot};

use crate::arena::Truth;
pub use error::{CHI2_95_1, CHI2_95_2, CHI2_95_3, Errors, normal_error, normalized3};

/// Statistics of a run's snapshots.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Score {
    /// Position, metres.
    pub position: Errors,
    /// Horizontal component of the position error.
    pub plane: Errors,
    /// Vertical component.
    pub height: Errors,
    /// Velocity, m/s, of states with a covariance of the velocity.
    pub velocity: Errors,
    /// Normal, radians, over the two rotations that change it.
    pub normal: Errors,
    /// The whole rotation, radians, of states whose yaw is observed and unambiguous.
    pub rotation: Errors,
    /// Position of objects that no camera sees, metres.
    pub predicted: Errors,
    /// Σ vᵀΛe and Σ vᵀΛv over tracked states, with position error e, its precision Λ, and true velocity v.
    along: (f64, f64),
    /// Ids that were tracked at some time.
    pub ids: usize,
    /// States with another code than the robot's.
    pub wrong_codes: usize,
    /// Changes of an object's robot.
    pub swaps: usize,
    /// States farther than the gate from every robot.
    pub strays: usize,
    /// Ids of each robot beyond its first.
    pub extra_ids: usize,
    /// Missing states, tracked or predicted, summed over robots and snapshots.
    pub misses: usize,
    /// States whose error cannot be normalized: a covariance is missing or not positive definite.
    pub unusable: usize,
}

impl Score {
    /// Delay of poses relative to their stated times, seconds: -Σ vᵀΛe / Σ vᵀΛv, the weighted least-squares solution
    /// of e = -delay · v, with Λ the inverse of the stated covariance.
    pub fn delay_s(&self) -> f64 {
        -self.along.0 / self.along.1
    }
}

/// Scores snapshots one by one.
#[derive(Clone, Debug)]
pub struct Judge {
    /// A state farther than this from every robot is a stray.
    pub gate_m: f64,
    robot_by_id: HashMap<u64, usize>,
    ids: HashSet<u64>,
    score: Score,
}

impl Default for Judge {
    fn default() -> Self {
        Self {
            gate_m: 0.3,
            robot_by_id: HashMap::new(),
            ids: HashSet::new(),
            score: Score::default(),
        }
    }
}

impl Judge {
    /// Adds one snapshot's states that are tracked or predicted. `truth` is that of its `pose_time_ns`.
    pub fn take(&mut self, snapshot: &Snapshot, truth: &[Truth]) {
        let mut found = vec![false; truth.len()];
        for state in &snapshot.objects {
            match state.stage() {
                LifeStage::Tracked => self.take_tracked(state, truth, &mut found),
                LifeStage::Predicted => self.take_predicted(state, truth, &mut found),
                _ => {}
            }
        }
        self.score.misses += found.iter().filter(|found| !**found).count();
    }

    /// The score of all snapshots.
    pub fn finish(mut self) -> Score {
        let robots: HashSet<_> = self.robot_by_id.values().collect();
        self.score.extra_ids = self.robot_by_id.len() - robots.len();
        self.score.ids = self.ids.len();
        self.score
    }

    fn take_tracked(&mut self, state: &v1::ObjectState, truth: &[Truth], found: &mut [bool]) {
        self.ids.insert(state.object_id);
        let Some(position) = state.position.as_ref().map(vector) else {
            self.score.unusable += 1;
            return;
        };
        let Some(robot) = self.associate(state.object_id, &position, truth) else {
            self.score.strays += 1;
            return;
        };
        found[robot] = true;
        let shown = state.code.as_ref().map(|code| code.number);
        if shown.is_some_and(|number| truth[robot].code.map(u32::from) != Some(number)) {
            self.score.wrong_codes += 1;
        }
        self.compare(state, &position, &truth[robot]);
    }

    /// A predicted object may be anywhere within its covariance, so it is compared with its previous robot.
    fn take_predicted(&mut self, state: &v1::ObjectState, truth: &[Truth], found: &mut [bool]) {
        let robot = self.robot_by_id.get(&state.object_id);
        let (Some(&robot), Some(position)) = (robot, &state.position) else { return };
        found[robot] = true;
        let error = vector(position) - truth[robot].pose.translation.vector;
        let block = position_block(&state.covariance);
        match block.and_then(|covariance| normalized3(&error, &covariance)) {
            Some(square) => self.score.predicted.push(error.norm(), square),
            None => self.score.unusable += 1,
        }
    }

    fn associate(&mut self, id: u64, position: &Vector3<f64>, truth: &[Truth]) -> Option<usize> {
        let distance = |truth: &Truth| (truth.pose.translation.vector - position).norm();
        let (robot, apart_m) = truth
            .iter()
            .map(distance)
            .enumerate()
            .min_by(|one, other| one.1.total_cmp(&other.1))?;
        if apart_m > self.gate_m {
            return None;
        }
        if self.robot_by_id.insert(id, robot).is_some_and(|before| before != robot) {
            self.score.swaps += 1;
        }
        Some(robot)
    }

    fn compare(&mut self, state: &v1::ObjectState, position: &Vector3<f64>, truth: &Truth) {
        let error = position - truth.pose.translation.vector;
        match position_block(&state.covariance) {
            Some(covariance) => self.compare_position(&error, &covariance, truth),
            None => self.score.unusable += 1,
        }
        if let (Some(velocity), Some(covariance)) =
            (&state.velocity, triangle3(&state.velocity_covariance))
        {
            let error = vector(velocity) - truth.velocity_m_s;
            match normalized3(&error, &covariance) {
                Some(square) => self.score.velocity.push(error.norm(), square),
                None => self.score.unusable += 1,
            }
        }
        let Some(q) = &state.orientation else { return };
        let Some(covariance) = rotation_block(&state.covariance) else { return };
        let turned = UnitQuaternion::from_quaternion(Quaternion::new(q.w, q.x, q.y, q.z));
        let (normal, true_normal) = (turned * Vector3::z(), truth.pose.rotation * Vector3::z());
        if let Some((angle, square)) = normal_error(&normal, &true_normal, &covariance) {
            self.score.normal.push(angle, square);
        }
        if state.yaw_observed && state.yaw_symmetry == 1 {
            let error = (turned * truth.pose.rotation.inverse()).scaled_axis();
            match normalized3(&error, &covariance) {
                Some(square) => self.score.rotation.push(error.norm(), square),
                None => self.score.unusable += 1,
            }
        }
    }

    fn compare_position(&mut self, error: &Vector3<f64>, covariance: &Matrix3<f64>, truth: &Truth) {
        let square = normalized3(error, covariance);
        let (Some(square), Some(root)) = (square, covariance.cholesky()) else {
            self.score.unusable += 1;
            return;
        };
        self.score.position.push(error.norm(), square);
        let along = root.solve(&truth.velocity_m_s);
        self.score.along.0 += along.dot(error);
        self.score.along.1 += along.dot(&truth.velocity_m_s);
        let level = covariance.fixed_view::<2, 2>(0, 0).into_owned();
        if let Some(root) = level.cholesky() {
            let error = error.xy();
            self.score.plane.push(error.norm(), error.dot(&root.solve(&error)));
        }
        self.score.height.push(error.z.abs(), error.z * error.z / covariance[(2, 2)]);
    }
}

impl std::fmt::Display for Score {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "             count        rms   NEES (expected)   inside 95 %")?;
        let rows = [
            ("position", &self.position, 3.0, CHI2_95_3, "m"),
            ("in plane", &self.plane, 2.0, CHI2_95_2, "m"),
            ("height", &self.height, 1.0, CHI2_95_1, "m"),
            ("predicted", &self.predicted, 3.0, CHI2_95_3, "m"),
            ("velocity", &self.velocity, 3.0, CHI2_95_3, "m/s"),
            ("normal", &self.normal, 2.0, CHI2_95_2, "rad"),
            ("rotation", &self.rotation, 3.0, CHI2_95_3, "rad"),
        ];
        for (name, errors, freedom, bound, unit) in rows {
            if errors.count() == 0 {
                continue;
            }
            writeln!(
                f,
                "{name:10} {:7} {:10.5} {unit:4} {:7.2} ({freedom})     {:8.1} %",
                errors.count(),
                errors.rms(),
                errors.mean_normalized(),
                100.0 * errors.share_within(bound)
            )?;
        }
        write!(
            f,
            "ids {}, swaps {}, strays {}, extra ids {}, wrong codes {}, misses {}, unusable {}",
            self.ids,
            self.swaps,
            self.strays,
            self.extra_ids,
            self.wrong_codes,
            self.misses,
            self.unusable
        )
    }
}

pub fn vector(v: &v1::Vector3) -> Vector3<f64> {
    Vector3::new(v.x, v.y, v.z)
}

/// Rows and columns `first`.. of three of a 6×6 matrix given by its upper triangle.
fn block(triangle: &[f64], first: usize) -> Option<Matrix3<f64>> {
    if triangle.len() != 21 {
        return None;
    }
    let at = |row: usize, column: usize| {
        let (row, column) = (row.min(column), row.max(column));
        triangle[row * 6 - row * (row + 1) / 2 + column]
    };
    Some(Matrix3::from_fn(|row, column| at(first + row, first + column)))
}

fn position_block(triangle: &[f64]) -> Option<Matrix3<f64>> {
    block(triangle, 0)
}

fn rotation_block(triangle: &[f64]) -> Option<Matrix3<f64>> {
    block(triangle, 3)
}

fn triangle3(t: &[f64]) -> Option<Matrix3<f64>> {
    let [a, b, c, d, e, f] = *t else { return None };
    Some(Matrix3::new(a, b, c, b, d, e, c, e, f))
}

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;

    use super::*;
    use crate::random::Random;

    fn state(id: u64, position: Vector3<f64>, variance: f64) -> v1::ObjectState {
        let mut covariance = vec![0.0; 21];
        for (row, place) in [0, 6, 11, 15, 18, 20].into_iter().enumerate() {
            covariance[place] = if row < 3 { variance } else { 1e-4 };
        }
        v1::ObjectState {
            object_id: id,
            stage: LifeStage::Tracked as i32,
            position: Some(v1::Vector3 { x: position.x, y: position.y, z: position.z }),
            orientation: Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
            covariance,
            ..Default::default()
        }
    }

    fn truth(x: f64) -> Truth {
        let pose = Isometry3::translation(x, 0.0, 0.3);
        Truth { pose, velocity_m_s: Vector3::zeros(), code: None }
    }

    fn judged(scale: f64) -> Score {
        let mut random = Random::new(11, 0);
        let mut judge = Judge::default();
        for _ in 0..4000 {
            let error = Vector3::from_fn(|_, _| 0.002 * scale * f64::from(random.normal()));
            let objects = vec![state(1, Vector3::new(1.0, 0.0, 0.3) + error, 0.002 * 0.002)];
            judge.take(&Snapshot { objects, ..Default::default() }, &[truth(1.0)]);
        }
        judge.finish()
    }

    #[test]
    fn errors_with_the_right_covariance_are_consistent_and_others_are_not() {
        let right = judged(1.0);
        assert!((right.position.share_within(CHI2_95_3) - 0.95).abs() < 0.01);
        assert!((right.position.mean_normalized() - 3.0).abs() < 0.1);
        assert!(judged(1.5).position.share_within(CHI2_95_3) < 0.85);
        assert!(judged(0.5).position.share_within(CHI2_95_3) > 0.99);
    }

    #[test]
    fn swaps_strays_and_misses_are_counted() {
        let truths = [truth(0.0), truth(1.0)];
        let at = |id, x| state(id, Vector3::new(x, 0.0, 0.3), 1e-6);
        let mut judge = Judge::default();
        judge.take(
            &Snapshot { objects: vec![at(1, 0.0), at(2, 1.0)], ..Default::default() },
            &truths,
        );
        judge.take(
            &Snapshot { objects: vec![at(1, 1.0), at(2, 0.0)], ..Default::default() },
            &truths,
        );
        judge.take(
            &Snapshot { objects: vec![at(1, 1.0), at(7, 5.0)], ..Default::default() },
            &truths,
        );
        judge.take(
            &Snapshot { objects: vec![at(1, 1.0), at(3, 0.0)], ..Default::default() },
            &truths,
        );
        let score = judge.finish();
        assert_eq!((score.swaps, score.strays, score.misses, score.extra_ids), (2, 1, 1, 1));
    }

    #[test]
    fn poses_behind_their_time_show_the_delay() {
        let velocity_m_s = Vector3::new(0.3, -0.4, 0.0);
        let true_now = Truth { velocity_m_s, ..truth(1.0) };
        let behind = true_now.pose.translation.vector - velocity_m_s * 0.02;
        let mut judge = Judge::default();
        let objects = vec![state(1, behind, 1e-4)];
        judge.take(&Snapshot { objects, ..Default::default() }, &[true_now]);
        assert!((judge.finish().delay_s() - 0.02).abs() < 1e-12);
    }

    #[test]
    fn codes_are_compared_with_the_nearest_robot() {
        let coded = |number| Truth { code: Some(number), ..truth(f64::from(number)) };
        let mut judge = Judge::default();
        for number in [1, 2, 2] {
            let code = Some(v1::Code { bits: 8, number });
            let seen = v1::ObjectState { code, ..state(1, Vector3::new(2.0, 0.0, 0.3), 1e-6) };
            let snapshot = Snapshot { objects: vec![seen], ..Default::default() };
            judge.take(&snapshot, &[coded(1), coded(2)]);
        }
        let score = judge.finish();
        assert_eq!((score.wrong_codes, score.ids, score.misses), (1, 1, 3));
    }

    #[test]
    fn predicted_objects_are_compared_with_their_previous_robots() {
        let mut judge = Judge::default();
        let mut seen = state(1, Vector3::new(0.0, 0.0, 0.3), 1e-2);
        judge.take(&Snapshot { objects: vec![seen.clone()], ..Default::default() }, &[truth(0.0)]);
        seen.stage = LifeStage::Predicted as i32;
        let truths = [truth(0.2), truth(0.0)];
        judge.take(&Snapshot { objects: vec![seen], ..Default::default() }, &truths);
        let score = judge.finish();
        assert_eq!((score.predicted.count(), score.position.count(), score.misses), (1, 1, 1));
        assert!((score.predicted.rms() - 0.2).abs() < 1e-12);
        assert!((score.predicted.mean_normalized() - 4.0).abs() < 1e-9);
    }

    #[test]
    fn rotation_about_the_normal_counts_where_it_is_observed() {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.02);
        let mut judge = Judge::default();
        for yaw_observed in [false, true] {
            let mut seen = state(1, Vector3::new(0.0, 0.0, 0.3), 1e-6);
            let q = turn.quaternion();
            seen.orientation = Some(v1::Quaternion { x: q.i, y: q.j, z: q.k, w: q.w });
            (seen.yaw_observed, seen.yaw_symmetry) = (yaw_observed, 1);
            judge.take(&Snapshot { objects: vec![seen], ..Default::default() }, &[truth(0.0)]);
        }
        let score = judge.finish();
        assert_eq!((score.normal.count(), score.rotation.count()), (2, 1));
        assert!(score.normal.rms() < 1e-9);
        assert!((score.rotation.mean_normalized() - 4.0).abs() < 1e-9);
    }

    #[test]
    fn a_triangle_of_the_wrong_size_is_no_covariance() {
        assert!(block(&[0.0; 20], 0).is_none());
    }
}
