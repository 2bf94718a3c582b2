//! Objects that are named, changed and removed while they drive.

use nalgebra::{UnitQuaternion, Vector3};
use roundel_core::{
    id::{BodyId, ObjectId},
    rigid::Rigid,
    world::{
        Body, BodyError, Event, EventKind, FrameObservations, Fusion, FusionParams, LifeStage,
        MotionClass, Mount, ObjectState,
    },
};

use super::{
    arena::START,
    body::{World, code, coded, flat, truth},
    score::fusion_of,
};

fn body(mounts: Vec<Mount>) -> Body {
    Body { motion: MotionClass::Free, mounts }
}

/// Processes the frames of one second; returns the tracked objects at its end, and the events.
fn second(
    fusion: &mut Fusion,
    frames: &[FrameObservations],
    from_s: f64,
) -> (Vec<ObjectState>, Vec<Event>) {
    let (begin, end) = (START.plus_seconds(from_s), START.plus_seconds(from_s + 1.0));
    let mut states = Vec::new();
    let is_then = |frame: &&FrameObservations| (begin..end).contains(&frame.capture_time);
    for frame in frames.iter().filter(is_then) {
        fusion.observe(frame);
        let snapshot = fusion.snapshot(frame.capture_time);
        states = snapshot.objects;
        states.retain(|state| state.stage == LifeStage::Tracked);
    }
    (states, fusion.drain_events().collect())
}

fn assert_at(state: &ObjectState, point: Vector3<f64>, newest_s: f64) {
    let expected_m = truth(newest_s) * nalgebra::Point3::from(point);
    let off_m = (state.position_m - expected_m.coords).norm();
    assert!(off_m < 0.03, "{off_m} m off at {newest_s} s: {state:?}");
}

/// Time of the last of these frames before a time, seconds.
fn last_s(frames: &[FrameObservations], before_s: f64) -> f64 {
    let seconds = frames.iter().map(|frame| frame.capture_time.seconds_since(START));
    seconds.filter(|at_s| *at_s < before_s).fold(0.0, f64::max)
}

#[test]
fn a_coded_track_continues_as_body_and_back() {
    let at = flat(0.2, 0.0, 0.0);
    let world = World::new(vec![coded(3, at)]);
    let frames = world.frames(6.0);
    let mut fusion = fusion_of(&world.arena, FusionParams::default());
    let end = |before_s| last_s(&frames, before_s);

    let (states, events) = second(&mut fusion, &frames, 0.0);
    assert_eq!(events.len(), 1, "{events:?}");
    assert_eq!((states.len(), states[0].id, states[0].body), (1, ObjectId(1), None));
    let center_m = at.translation.vector;
    assert_at(&states[0], center_m, end(1.0));

    // The origin is that of the robot; then 5 cm above it.
    let above = at * Rigid::translation(0.0, 0.0, -0.05);
    let named = [(at, Vector3::zeros()), (above, Vector3::z() * 0.05)];
    for (from_s, (mount, point)) in [1.0, 2.0].into_iter().zip(named) {
        let carries = body(vec![coded(3, mount)]);
        assert_eq!(fusion.set_bodies(&[(BodyId(0), carries)]), Ok(()));
        let (states, events) = second(&mut fusion, &frames, from_s);
        assert_eq!(events, [], "the track continues");
        let [state] = &states[..] else { panic!("{states:?}") };
        let expected = (ObjectId(1), Some(BodyId(0)), Some(code(3)));
        assert_eq!((state.id, state.body, state.code), expected);
        assert_at(state, point, end(from_s + 1.0));
    }

    assert_eq!(fusion.set_bodies(&[(BodyId(0), body(Vec::new()))]), Ok(()));
    let (states, events) = second(&mut fusion, &frames, 3.0);
    assert_eq!(events, [], "the track continues");
    let [state] = &states[..] else { panic!("{states:?}") };
    assert_eq!((state.id, state.body, state.code), (ObjectId(1), None, Some(code(3))));
    assert_at(state, center_m, end(4.0));

    // Under another body id it is still the same object.
    assert_eq!(fusion.set_bodies(&[(BodyId(1), body(vec![coded(3, at)]))]), Ok(()));
    let (states, events) = second(&mut fusion, &frames, 4.0);
    assert_eq!(events, []);
    assert_eq!((states[0].id, states[0].body), (ObjectId(1), Some(BodyId(1))));
}

#[test]
fn a_changed_mount_restarts_only_its_object() {
    let (front, back) = (flat(0.2, 0.0, 0.0), flat(-0.2, 0.0, 0.0));
    let world = World::new(vec![coded(3, front), coded(4, back)]);
    let frames = world.frames(5.0);
    let mut fusion = fusion_of(&world.arena, FusionParams::default());
    let ids = [BodyId(0), BodyId(1)];
    let carry = |a: Mount, b: Mount| [(ids[0], body(vec![a])), (ids[1], body(vec![b]))];
    fusion.set_bodies(&carry(coded(3, front), coded(4, back))).unwrap();
    let (states, _) = second(&mut fusion, &frames, 0.0);
    assert_eq!(states.len(), 2);
    let object_of = |states: &[ObjectState], body: BodyId| {
        states.iter().find(|state| state.body == Some(body)).map(|state| state.id).unwrap()
    };
    let objects = ids.map(|id| object_of(&states, id));

    // The front one is configured with another orientation.
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.5);
    let turned = Rigid::from_parts(front.translation, turn);
    fusion.set_bodies(&[(ids[0], body(vec![coded(3, turned)]))]).unwrap();
    let (states, events) = second(&mut fusion, &frames, 1.0);
    let changes: Vec<_> = events.iter().map(|event| (event.object, event.kind)).collect();
    assert_eq!(changes, [(objects[0], EventKind::Lost), (objects[0], EventKind::Appeared)]);
    assert_eq!(ids.map(|id| object_of(&states, id)), objects);

    // Codes cannot be exchanged one at a time, only both at once; an error changes nothing.
    let alone = fusion.set_bodies(&[(ids[0], body(vec![coded(4, back)]))]);
    assert_eq!(alone, Err(BodyError::Taken { mount: 0 }));
    let (_, events) = second(&mut fusion, &frames, 2.0);
    assert_eq!(events, []);
    fusion.set_bodies(&carry(coded(4, back), coded(3, front))).unwrap();
    let (states, events) = second(&mut fusion, &frames, 3.0);
    assert_eq!(ids.map(|id| object_of(&states, id)), objects, "{events:?}");
    for state in &states {
        assert_at(state, Vector3::zeros(), last_s(&frames, 4.0));
    }
}

#[test]
fn a_changed_motion_class_restarts_its_kind() {
    let world = World::new(vec![coded(3, flat(0.0, 0.0, 0.0))]);
    let frames = world.frames(3.0);
    let mut fusion = fusion_of(&world.arena, FusionParams::default());
    let kind = roundel_core::id::KindId(0);
    second(&mut fusion, &frames, 0.0);
    fusion.change_motion(kind, MotionClass::Free);
    assert_eq!(second(&mut fusion, &frames, 1.0).1, [], "nothing changed");
    fusion.change_motion(kind, MotionClass::Ground { height_m: None });
    let (_, events) = second(&mut fusion, &frames, 2.0);
    assert_eq!(events[0].kind, EventKind::Lost, "{events:?}");
}
