//! Commands for simulated robots are matched to tracked objects by position, also when these are only predicted.

use nalgebra::Vector3;
use roundel_core::{
    id::ObjectId,
    rigid::Covariance6,
    sim::{Drive, RobotTruth},
    time::Timestamp,
    world::{LifeStage, ObjectState, ProcessNoise, Snapshot},
};
use roundel_server::{
    capture::source::fleet::{COMMAND_TIMEOUT_S, DriveCommand, FleetError, Fleets},
    model::address::{SimAddress, SimPreset},
};

const ORIGIN: Timestamp = Timestamp::from_ns(1_000_000_000);
/// Time since the last observation of every object, as on an overloaded machine.
const UNSEEN_S: f64 = 1.2;
/// Largest distance between an object and its robot, metres.
const SAME_M: f64 = 0.15;

#[test]
fn a_predicted_object_is_matched_by_its_last_observation() {
    let address = SimAddress { preset: SimPreset::R4Lite, seed: 5, robots: Some(12), camera: 0 };
    let fleets = Fleets::default();
    let fleet = fleets.of(&address, ORIGIN).unwrap();
    let seen = ORIGIN.plus_seconds(3.0);
    let pose_time = seen.plus_seconds(UNSEEN_S);
    let [then, now] =
        [seen, pose_time].map(|time| fleet.scenario().truth(time.seconds_since(ORIGIN)));
    let snapshot = |stage| Snapshot {
        pose_time,
        capture_time: Some(seen),
        objects: then.iter().map(|robot| object(robot, seen, stage)).collect(),
    };
    let predicted = snapshot(LifeStage::Predicted);
    let is_off_every_robot = |state: &&ObjectState| {
        let off_m = |robot: &RobotTruth| {
            (robot.world_from_roundel.translation.vector - state.position_m).norm()
        };
        now.iter().all(|robot| off_m(robot) > SAME_M)
    };
    let unmatched = predicted.objects.iter().filter(is_off_every_robot).count();
    assert!(unmatched > 0, "no robot has turned meanwhile: choose another time");

    let velocity_m_s = |robot: &RobotTruth| Vector3::new(0.1 * robot.index as f64, -0.25, 0.0);
    let command = |robot: &RobotTruth| DriveCommand {
        object: ObjectId(robot.index as u64 + 1),
        velocity_m_s: velocity_m_s(robot).cap_magnitude(1.0),
    };
    let commands: Vec<DriveCommand> = then.iter().map(command).collect();
    // The scenario in which each command goes directly to its robot.
    let mut expected = fleet.scenario().as_ref().clone();
    let begin_s = fleets.drive(&commands, &predicted, pose_time).unwrap().seconds_since(ORIGIN);
    for (robot, DriveCommand { velocity_m_s, .. }) in then.iter().zip(&commands) {
        let span_s = [begin_s, begin_s + COMMAND_TIMEOUT_S];
        expected.drive(robot.index, Drive { velocity_m_s: *velocity_m_s, span_s });
    }
    let soon_s = begin_s + 0.4;
    assert_eq!(fleet.scenario().truth(soon_s), expected.truth(soon_s));
    assert_ne!(
        expected.truth(soon_s),
        Fleets::default().of(&address, ORIGIN).unwrap().scenario().truth(soon_s)
    );

    // A tracked object is rejected if no robot is at its position.
    let fleets = Fleets::default();
    fleets.of(&address, ORIGIN).unwrap();
    let rejected = fleets.drive(&commands, &snapshot(LifeStage::Tracked), pose_time);
    assert!(
        matches!(rejected, Err(FleetError::NoRobot { distance_m, .. }) if distance_m > SAME_M),
        "{rejected:?}"
    );
}

/// An object that was last observed at this robot and predicted with constant velocity since.
fn object(robot: &RobotTruth, seen: Timestamp, stage: LifeStage) -> ObjectState {
    ObjectState {
        id: ObjectId(robot.index as u64 + 1),
        kind: None,
        body: None,
        code: None,
        stage,
        position_m: robot.world_from_roundel.translation.vector + robot.velocity_m_s * UNSEEN_S,
        orientation: robot.world_from_roundel.rotation,
        yaw_observed: false,
        yaw_symmetry: 1,
        velocity_m_s: robot.velocity_m_s,
        acceleration_m_s2: Vector3::zeros(),
        angular_velocity_rad_s: Vector3::zeros(),
        covariance: Covariance6::identity(),
        motion_covariance: Covariance6::identity(),
        rotation_covariance: Covariance6::identity(),
        process_noise: ProcessNoise::default(),
        cameras: Vec::new(),
        trust: 1,
        newest_observation: seen,
        residual: 1.0,
        first_observation: ORIGIN,
        observations: 9,
    }
}
