//! Simulated robots are known by the objects that clients see, also where those are only expected.

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
/// So long nobody has seen anything, as on a machine that has much else to do.
const UNSEEN_S: f64 = 1.2;
/// An object farther than this from a robot is not taken for it, metres.
const SAME_M: f64 = 0.15;

#[test]
fn who_is_not_seen_is_known_by_where_it_was_seen_last() {
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
    let is_nowhere = |state: &&ObjectState| {
        let off_m = |robot: &RobotTruth| {
            (robot.world_from_roundel.translation.vector - state.position_m).norm()
        };
        now.iter().all(|robot| off_m(robot) > SAME_M)
    };
    let nowhere = predicted.objects.iter().filter(is_nowhere).count();
    assert!(nowhere > 0, "expected a robot that has turned meanwhile: another instant has one");

    let wanted_m_s = |robot: &RobotTruth| Vector3::new(0.1 * robot.index as f64, -0.25, 0.0);
    let order = |robot: &RobotTruth| DriveCommand {
        object: ObjectId(robot.index as u64 + 1),
        velocity_m_s: wanted_m_s(robot).cap_magnitude(1.0),
    };
    let orders: Vec<DriveCommand> = then.iter().map(order).collect();
    // The world in which each robot itself is told what its object is.
    let mut expected = fleet.scenario().as_ref().clone();
    let begin_s = fleets.drive(&orders, &predicted, pose_time).unwrap().seconds_since(ORIGIN);
    for (robot, DriveCommand { velocity_m_s, .. }) in then.iter().zip(&orders) {
        let span_s = [begin_s, begin_s + COMMAND_TIMEOUT_S];
        expected.drive(robot.index, Drive { velocity_m_s: *velocity_m_s, span_s });
    }
    let soon_s = begin_s + 0.4;
    assert_eq!(fleet.scenario().truth(soon_s), expected.truth(soon_s));
    assert_ne!(
        expected.truth(soon_s),
        Fleets::default().of(&address, ORIGIN).unwrap().scenario().truth(soon_s)
    );

    // One that is seen where no robot is, is none.
    let fleets = Fleets::default();
    fleets.of(&address, ORIGIN).unwrap();
    let refused = fleets.drive(&orders, &snapshot(LifeStage::Tracked), pose_time);
    assert!(
        matches!(refused, Err(FleetError::NoRobot { distance_m, .. }) if distance_m > SAME_M),
        "{refused:?}"
    );
}

/// An object that was last seen at this robot, and is expected to have gone on as it went.
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
        newest_observation: seen,
        residual: 1.0,
        first_observation: ORIGIN,
        observations: 9,
    }
}
