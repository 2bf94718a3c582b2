//! Holds what an honest client receives against the truth of the world.

use std::{
    collections::HashMap,
    sync::{
        Arc,
        atomic::{AtomicI64, Ordering},
    },
    time::{Duration, Instant},
};

use nalgebra::{Matrix3, Vector3};
use roundel_core::time::Timestamp;
use roundel_proto::v1::{LifeStage, ObjectState, Snapshot};

use super::world::{FAR_M, World};
use crate::{
    arena::Truth,
    score::{normalized3, vector},
};

/// Snapshots arrive at least this often while the server runs; a limit for hangs on a busy machine.
pub const HANG: Duration = Duration::from_secs(12);
/// Errors stay within this number of standard deviations …
const SIGMAS: f64 = 6.0;
/// … of the stated covariance and of what models of motion do not state, metres.
const UNSTATED_M: f64 = 5e-3;
/// Pauses of this process longer than this, seconds, delay messages by more than their senders state …
const USUAL_PAUSE_S: f64 = 0.02;
/// … while robots move this fast, m/s.
const SPEED_M_S: f64 = 1.0;
/// An object within this distance of a robot is taken for it, metres.
const GATE_M: f64 = 0.3;
/// A second track of a robot may exist for this number of snapshots while tracks begin.
const MAX_DOUBLE: u32 = 40;
/// Violations that are reported.
const MAX_VIOLATIONS: usize = 8;

/// One run of the server.
struct Run {
    /// Its clock against the world's.
    offset_ns: i64,
    /// Ids of robots, once each is tracked.
    ids: Vec<Option<u64>>,
    /// Snapshots with further tracks of robots, by id.
    doubles: HashMap<u64, u32>,
    /// Robots tracked in the newest snapshot.
    tracked: usize,
}

/// What was received so far.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Received {
    /// Snapshots received.
    pub snapshots: u64,
    /// Poses held against the truth.
    pub poses: u64,
    /// Poses of robots that the server predicted at the time.
    pub predicted: u64,
    /// Largest error over what is allowed.
    pub worst_share: f64,
    /// Longest time without a snapshot while the server ran, seconds.
    pub longest_gap_s: f64,
    /// Longest pause of this process, seconds.
    pub longest_pause_s: f64,
}

/// Judges snapshots one by one.
pub struct Judge {
    world: Arc<World>,
    /// Clock of the server that runs now, against the world's.
    server_offset_ns: Arc<AtomicI64>,
    runs: HashMap<String, Run>,
    newest_run: String,
    /// From when on snapshots must arrive; `None` while no server runs.
    expected_from: Option<Instant>,
    received: Received,
    violations: Vec<String>,
}

impl Judge {
    /// Expects a server that is not running yet.
    pub fn new(world: Arc<World>, server_offset_ns: Arc<AtomicI64>) -> Self {
        Self {
            world,
            server_offset_ns,
            runs: HashMap::new(),
            newest_run: String::new(),
            expected_from: None,
            received: Received::default(),
            violations: Vec::new(),
        }
    }

    /// A server runs from now on, or none does.
    pub fn set_running(&mut self, is_running: bool) {
        self.check_gap();
        self.expected_from = is_running.then(Instant::now);
    }

    /// Notes that this process did not run for a while.
    pub fn paused(&mut self, pause: Duration) {
        self.received.longest_pause_s = self.received.longest_pause_s.max(pause.as_secs_f64());
    }

    /// How far a robot moves within the longest pause, metres.
    fn paused_m(&self) -> f64 {
        SPEED_M_S * (self.received.longest_pause_s - USUAL_PAUSE_S).max(0.0)
    }

    /// Notes a broken promise.
    pub fn violate(&mut self, what: String) {
        if self.violations.len() < MAX_VIOLATIONS {
            self.violations.push(format!("{:.2} s: {what}", self.world.seconds()));
        }
    }

    fn check_gap(&mut self) {
        let Some(from) = self.expected_from else { return };
        let gap = from.elapsed();
        self.received.longest_gap_s = self.received.longest_gap_s.max(gap.as_secs_f64());
        if gap > HANG {
            self.violate(format!("no snapshot for {:.1} s", gap.as_secs_f64()));
        }
    }

    /// Whether all robots are tracked by the server that runs now.
    pub fn tracks_all(&self) -> bool {
        let run = self.runs.get(&self.newest_run);
        run.is_some_and(|run| run.tracked == run.ids.len())
    }

    /// Judges the next snapshot.
    pub fn take(&mut self, snapshot: &Snapshot) {
        self.check_gap();
        if let Some(from) = &mut self.expected_from {
            *from = Instant::now();
        }
        self.received.snapshots += 1;
        let robots = self.world.arena.robots.len();
        let offset_ns = self.server_offset_ns.load(Ordering::Relaxed);
        let mut run = self.runs.remove(&snapshot.source_id).unwrap_or_else(|| {
            self.newest_run.clone_from(&snapshot.source_id);
            let (ids, doubles) = (vec![None; robots], HashMap::new());
            Run { offset_ns, ids, doubles, tracked: 0 }
        });
        let time_ns = snapshot.pose_time_ns - run.offset_ns;
        let truth = self.world.arena.truth(Timestamp::from_ns(time_ns).as_ns());
        self.find_robots(&mut run, snapshot, &truth);
        self.check_robots(&mut run, snapshot, &truth);
        self.runs.insert(snapshot.source_id.clone(), run);
    }

    /// Takes the first object that is tracked alone at a robot for it, and counts further ones.
    fn find_robots(&mut self, run: &mut Run, snapshot: &Snapshot, truth: &[Truth]) {
        let mut at: Vec<Vec<&ObjectState>> = vec![Vec::new(); truth.len()];
        for state in snapshot.objects.iter().filter(|it| it.stage() == LifeStage::Tracked) {
            let position = state.position.as_ref().map_or_else(Vector3::zeros, vector);
            match nearest(&position, truth, GATE_M + self.paused_m()) {
                Some(robot) => at[robot].push(state),
                None if position.x < FAR_M => {
                    self.violate(format!(
                        "object {} at {position:?} does not exist",
                        state.object_id
                    ));
                }
                None => {}
            }
        }
        for (robot, states) in at.iter().enumerate() {
            match (run.ids[robot], &states[..]) {
                (None, [state]) => run.ids[robot] = Some(state.object_id),
                (None, _) => {}
                (Some(id), states) => {
                    for other in states.iter().filter(|it| it.object_id != id) {
                        let count = run.doubles.entry(other.object_id).or_default();
                        *count += 1;
                        if *count == MAX_DOUBLE {
                            let double = other.object_id;
                            self.violate(format!(
                                "robot {robot} is object {id}, and also {double}"
                            ));
                        }
                    }
                }
            }
        }
    }

    fn check_robots(&mut self, run: &mut Run, snapshot: &Snapshot, truth: &[Truth]) {
        run.tracked = 0;
        for (robot, truth) in truth.iter().enumerate() {
            let Some(id) = run.ids[robot] else { continue };
            let Some(state) = snapshot.objects.iter().find(|it| it.object_id == id) else {
                self.violate(format!("robot {robot} is no longer tracked as object {id}"));
                run.ids[robot] = None;
                continue;
            };
            match state.stage() {
                LifeStage::Tracked => run.tracked += 1,
                LifeStage::Predicted => self.received.predicted += 1,
                stage => self.violate(format!("robot {robot}, object {id}, is {stage:?}")),
            }
            self.check_pose(robot, state, truth);
            let code = state.code.as_ref().map(|code| code.number);
            if code.is_some() && code != truth.code.map(u32::from) {
                self.violate(format!("robot {robot} with code {:?} has code {code:?}", truth.code));
            }
        }
    }

    fn check_pose(&mut self, robot: usize, state: &ObjectState, truth: &Truth) {
        self.received.poses += 1;
        let position = state.position.as_ref().map_or_else(Vector3::zeros, vector);
        let error = position - truth.pose.translation.vector;
        let stated = position_covariance(&state.covariance);
        let unstated_m2 = UNSTATED_M.powi(2) + self.paused_m().powi(2);
        let allowed = stated.map(|it| it + Matrix3::identity() * unstated_m2);
        let Some(square) = allowed.and_then(|allowed| normalized3(&error, &allowed)) else {
            return self.violate(format!("robot {robot} has no usable covariance"));
        };
        let share = square.sqrt() / SIGMAS;
        self.received.worst_share = self.received.worst_share.max(share);
        if share.is_nan() || share > 1.0 {
            let stage = state.stage();
            let deviation_mm = stated.map_or(f64::NAN, |it| (it.trace() / 3.0).sqrt() * 1e3);
            self.violate(format!(
                "robot {robot}, {stage:?}, is off by {:.1} mm, {:.1} sigma of {deviation_mm:.1} mm",
                error.norm() * 1e3,
                square.sqrt()
            ));
        }
    }

    /// Counts, and the broken promises.
    pub fn finish(&mut self) -> (Received, Vec<String>) {
        self.check_gap();
        (self.received.clone(), std::mem::take(&mut self.violations))
    }
}

fn nearest(position: &Vector3<f64>, truth: &[Truth], gate_m: f64) -> Option<usize> {
    let distance = |robot: &usize| (truth[*robot].pose.translation.vector - position).norm();
    let nearest =
        (0..truth.len()).min_by(|one, other| distance(one).total_cmp(&distance(other)))?;
    (distance(&nearest) < gate_m).then_some(nearest)
}

/// The position's block of the upper triangle of a 6x6 covariance.
fn position_covariance(triangle: &[f64]) -> Option<Matrix3<f64>> {
    let &[xx, xy, xz, _, _, _, yy, yz, _, _, _, zz, ..] = triangle else { return None };
    Some(Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz))
}
