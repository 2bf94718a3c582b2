//! The simulated robots that clients drive: one world for all its cameras.
//!
//! Input: commands for tracked objects. Output: scenarios in which the robots carry them out. A command takes effect
//! after [`ACTUATION_S`]: no camera has rendered a later frame by then, so all cameras show the same world.
//!
//! Clients know only objects, so a robot is identified by the position of its object. The position of an object that is
//! not tracked now is extrapolated, while its robot may have turned; such a robot is identified by the position at the
//! newest observation.

use std::{
    borrow::Cow,
    collections::BTreeMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use nalgebra::Vector3;
use roundel_core::{
    id::ObjectId,
    sim::{Drive, RobotTruth, Scenario, ScenarioError},
    time::Timestamp,
    world::{LifeStage, Snapshot},
};
use thiserror::Error;

use crate::model::{address::SimAddress, simulated::simulated_scenario};

/// Delay from a command to its effect, seconds. A camera renders a frame less than this before its capture: at 30 Hz it
/// begins when the previous frame has arrived, 15 ms after that one's capture.
pub const ACTUATION_S: f64 = 0.05;
/// A robot without a new command for this long stops.
pub const COMMAND_TIMEOUT_S: f64 = 0.5;
pub const MAX_SPEED_M_S: f64 = 1.0;
pub const MAX_PUSH_M_S: f64 = 2.0;
pub const MAX_PUSH_MS: f64 = 5000.0;
/// Greatest distance between an object and its robot, metres.
const MATCH_RADIUS_M: f64 = 0.15;

/// Why a command is rejected.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum FleetError {
    /// There are no simulated robots.
    #[error(
        "nothing is simulated here, and this server does not drive real robots: use `roundel demo`, or cameras with \
         `source = \"sim:…\"`"
    )]
    NothingSimulated,
    #[error("object {object} is not tracked now; {known}")]
    NoObject { object: u64, known: String },
    #[error(
        "object {object} is not at a simulated robot: expected one within {MATCH_RADIUS_M} m, the nearest is \
         {distance_m:.2} m away"
    )]
    NoRobot { object: u64, distance_m: f64 },
    #[error("object {object} is a reference for calibrating cameras, and stays parked")]
    Reference { object: u64 },
}

/// All simulated worlds of one server.
#[derive(Default)]
pub struct Fleets(Mutex<Vec<Arc<Fleet>>>);

/// The robots of one world.
pub struct Fleet {
    world: SimAddress,
    origin: Timestamp,
    state: Mutex<State>,
}

struct State {
    scenario: Arc<Scenario>,
    /// The robot that an object was last matched to.
    robots: BTreeMap<ObjectId, usize>,
}

/// A velocity for the robot of an object.
#[derive(Clone, Copy, Debug)]
pub struct DriveCommand {
    pub object: ObjectId,
    /// World frame, m/s.
    pub velocity_m_s: Vector3<f64>,
}

impl Fleets {
    /// The fleet of a source's world, whose time begins at `origin`; created on first use.
    pub fn of(&self, address: &SimAddress, origin: Timestamp) -> Result<Arc<Fleet>, ScenarioError> {
        let world = SimAddress { camera: 0, ..address.clone() };
        let mut fleets = lock(&self.0);
        if let Some(fleet) = fleets.iter().find(|fleet| fleet.world == world) {
            return Ok(fleet.clone());
        }
        let scenario = Arc::new(simulated_scenario(&world)?);
        let state = Mutex::new(State { scenario, robots: BTreeMap::new() });
        let fleet = Arc::new(Fleet { world, origin, state });
        fleets.push(fleet.clone());
        Ok(fleet)
    }

    /// Sets the velocities of these objects' robots, of all or of none; returns when they take effect.
    pub fn drive(
        &self,
        commands: &[DriveCommand],
        snapshot: &Snapshot,
        now: Timestamp,
    ) -> Result<Timestamp, FleetError> {
        self.change(commands, COMMAND_TIMEOUT_S, snapshot, now, Scenario::drive)
    }

    /// Pushes the robot of an object for a while; returns when it begins.
    pub fn push(
        &self,
        command: DriveCommand,
        duration_s: f64,
        snapshot: &Snapshot,
        now: Timestamp,
    ) -> Result<Timestamp, FleetError> {
        self.change(&[command], duration_s, snapshot, now, Scenario::push)
    }

    fn change(
        &self,
        commands: &[DriveCommand],
        duration_s: f64,
        snapshot: &Snapshot,
        now: Timestamp,
        change: fn(&mut Scenario, usize, Drive),
    ) -> Result<Timestamp, FleetError> {
        let begin = now.plus_seconds(ACTUATION_S);
        // An installation has one world; of several, the one that has all these robots.
        let fleets = lock(&self.0).clone();
        let mut refused = FleetError::NothingSimulated;
        for fleet in fleets {
            let mut state = lock(&fleet.state);
            match fleet.robots(&mut state, commands, snapshot) {
                Ok(robots) => {
                    let begin_s = begin.seconds_since(fleet.origin);
                    let span_s = [begin_s, begin_s + duration_s];
                    let scenario = Arc::make_mut(&mut state.scenario);
                    for (robot, command) in robots.into_iter().zip(commands) {
                        let velocity_m_s = command.velocity_m_s;
                        change(scenario, robot, Drive { velocity_m_s, span_s });
                    }
                    return Ok(begin);
                }
                Err(error) => refused = error,
            }
        }
        Err(refused)
    }
}

impl Fleet {
    /// The world with all commands so far.
    pub fn scenario(&self) -> Arc<Scenario> {
        lock(&self.state).scenario.clone()
    }

    fn robots(
        &self,
        state: &mut State,
        commands: &[DriveCommand],
        snapshot: &Snapshot,
    ) -> Result<Vec<usize>, FleetError> {
        let truth = state.scenario.truth(snapshot.pose_time.seconds_since(self.origin));
        state.robots.retain(|id, _| snapshot.objects.iter().any(|object| object.id == *id));
        commands.iter().map(|command| self.robot(state, command, snapshot, &truth)).collect()
    }

    fn robot(
        &self,
        state: &mut State,
        command: &DriveCommand,
        snapshot: &Snapshot,
        truth: &[RobotTruth],
    ) -> Result<usize, FleetError> {
        let object = command.object.0;
        let Some(found) = snapshot.objects.iter().find(|found| found.id == command.object) else {
            let ids: Vec<String> = snapshot.objects.iter().map(|o| o.id.0.to_string()).collect();
            let known = match ids.as_slice() {
                [] => "there are none".to_owned(),
                ids => format!("there are: {}", ids.join(", ")),
            };
            return Err(FleetError::NoObject { object, known });
        };
        let (at_m, truth) = match found.stage {
            LifeStage::Tracked => (found.position_m, Cow::Borrowed(truth)),
            _ => {
                let seen_s = found.newest_observation.seconds_since(self.origin);
                let age_s = snapshot.pose_time.seconds_since(found.newest_observation);
                // The snapshot extrapolates with constant velocity.
                let at_m = found.position_m - found.velocity_m_s * age_s;
                (at_m, Cow::Owned(state.scenario.truth(seen_s)))
            }
        };
        let off_m =
            |robot: &RobotTruth| (robot.world_from_roundel.translation.vector - at_m).norm();
        let nearest = truth.iter().min_by(|a, b| off_m(a).total_cmp(&off_m(b)));
        let nearest = nearest.map(|robot| (robot.index, off_m(robot)));
        let robot = match (nearest, state.robots.get(&command.object)) {
            (Some((robot, distance_m)), _) if distance_m <= MATCH_RADIUS_M => robot,
            (_, Some(&robot)) if found.stage != LifeStage::Tracked => robot,
            (nearest, _) => {
                let distance_m = nearest.map_or(f64::INFINITY, |(_, distance_m)| distance_m);
                return Err(FleetError::NoRobot { object, distance_m });
            }
        };
        if truth[robot].still && truth[robot].code.is_some() {
            return Err(FleetError::Reference { object });
        }
        state.robots.insert(command.object, robot);
        Ok(robot)
    }
}

/// Locks a mutex whose value a panic elsewhere cannot leave inconsistent.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
