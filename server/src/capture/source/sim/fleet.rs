//! The simulated robots that clients drive: one world for all its cameras.
//!
//! In: objects, as fusion follows them, and what they are to do. Out: scenarios in which the robots do it. What a robot
//! is told counts from 50 ms later on ([`ACTUATION_S`]): by then no camera has rendered a frame, so all of them show the
//! same world. A robot is known by where its object is, since objects are all that clients know of it; by where that was
//! when it was last seen, if nobody sees it, for while it is expected to go on as it went, its robot may turn.

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

use crate::model::address::SimAddress;
use crate::model::simulated::simulated_scenario;

/// From the request until robots do it, seconds; a camera renders a frame less than this before it is taken, since at
/// 30 Hz it begins when the one before has arrived, 15 ms after that was taken.
pub const ACTUATION_S: f64 = 0.05;
/// A robot that hears nothing for so long stops.
pub const COMMAND_TIMEOUT_S: f64 = 0.5;
/// Fastest that a robot may be told to move, m/s.
pub const MAX_SPEED_M_S: f64 = 1.0;
/// Fastest that it may be pushed, m/s.
pub const MAX_PUSH_M_S: f64 = 2.0;
/// Longest that it may be pushed, milliseconds.
pub const MAX_PUSH_MS: f64 = 5000.0;
/// An object farther than this from a robot is not taken for it, metres.
const MATCH_RADIUS_M: f64 = 0.15;

/// Why robots are not driven.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum FleetError {
    /// There are no simulated robots.
    #[error(
        "nothing is simulated here, and real robots are not driven by this server: `roundel demo`, or cameras with \
         `source = \"sim:…\"`, have robots that accept velocities"
    )]
    NothingSimulated,
    /// The object is not followed.
    #[error("object {object} is not followed now; {known}")]
    NoObject { object: u64, known: String },
    /// No robot is where the object is.
    #[error(
        "object {object} is at no simulated robot: the nearest one is {distance_m:.2} m from it, and within {MATCH_RADIUS_M} m \
         was expected"
    )]
    NoRobot {
        object: u64,
        /// From the nearest robot, metres.
        distance_m: f64,
    },
    #[error(
        "object {object} is parked as a reference of the arena, by which cameras are calibrated: it stays there"
    )]
    Reference { object: u64 },
}

/// All simulated worlds of one server: those of its sources, each once.
#[derive(Default)]
pub struct Fleets {
    fleets: Mutex<Vec<Arc<Fleet>>>,
}

/// The robots of one world.
pub struct Fleet {
    world: SimAddress,
    origin: Timestamp,
    state: Mutex<State>,
}

struct State {
    scenario: Arc<Scenario>,
    /// Which robot an object was last, for when it is not seen.
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
    /// The fleet of a source's world, whose time begins at `origin`; made if no source has asked before.
    pub fn of(&self, address: &SimAddress, origin: Timestamp) -> Result<Arc<Fleet>, ScenarioError> {
        let world = SimAddress { camera: 0, ..address.clone() };
        let mut fleets = lock(&self.fleets);
        if let Some(fleet) = fleets.iter().find(|fleet| fleet.world == world) {
            return Ok(fleet.clone());
        }
        let scenario = Arc::new(simulated_scenario(&world)?);
        let state = Mutex::new(State { scenario, robots: BTreeMap::new() });
        let fleet = Arc::new(Fleet { world, origin, state });
        fleets.push(fleet.clone());
        Ok(fleet)
    }

    /// Tells the robots of these objects how to move, all or none of them; from when on they do.
    pub fn drive(
        &self,
        commands: &[DriveCommand],
        snapshot: &Snapshot,
        now: Timestamp,
    ) -> Result<Timestamp, FleetError> {
        self.change(commands, snapshot, now, |scenario, robot, command, begin_s| {
            let span_s = [begin_s, begin_s + COMMAND_TIMEOUT_S];
            scenario.drive(robot, Drive { velocity_m_s: command.velocity_m_s, span_s });
        })
    }

    /// Pushes the robot of an object for a while; from when on.
    pub fn push(
        &self,
        command: DriveCommand,
        duration_s: f64,
        snapshot: &Snapshot,
        now: Timestamp,
    ) -> Result<Timestamp, FleetError> {
        self.change(&[command], snapshot, now, |scenario, robot, command, begin_s| {
            let span_s = [begin_s, begin_s + duration_s];
            scenario.push(robot, Drive { velocity_m_s: command.velocity_m_s, span_s });
        })
    }

    fn change(
        &self,
        commands: &[DriveCommand],
        snapshot: &Snapshot,
        now: Timestamp,
        change: impl Fn(&mut Scenario, usize, &DriveCommand, f64),
    ) -> Result<Timestamp, FleetError> {
        // An installation has one world; of several, the one that has all these robots.
        let fleets = lock(&self.fleets).clone();
        let mut refused = FleetError::NothingSimulated;
        for fleet in fleets {
            let mut state = lock(&fleet.state);
            match fleet.robots(&mut state, commands, snapshot) {
                Ok(robots) => {
                    let begin = now.plus_seconds(ACTUATION_S);
                    let begin_s = begin.seconds_since(fleet.origin);
                    let scenario = Arc::make_mut(&mut state.scenario);
                    for (robot, command) in robots.into_iter().zip(commands) {
                        change(scenario, robot, command, begin_s);
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
    /// The world as its robots move by now.
    pub fn scenario(&self) -> Arc<Scenario> {
        lock(&self.state).scenario.clone()
    }

    /// The robots that these objects are.
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
                [] => "nor is any other".to_owned(),
                ids => format!("there are: {}", ids.join(", ")),
            };
            return Err(FleetError::NoObject { object, known });
        };
        let (at_m, truth) = match found.stage {
            LifeStage::Tracked => (found.position_m, Cow::Borrowed(truth)),
            _ => {
                let seen_s = found.newest_observation.seconds_since(self.origin);
                let age_s = snapshot.pose_time.seconds_since(found.newest_observation);
                // It has been expected to keep its velocity since.
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
            // Nobody has seen it for long.
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

/// Plain values that a panic elsewhere cannot leave half written: go on.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
