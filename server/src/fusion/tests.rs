use std::{f64::consts::FRAC_PI_2, sync::mpsc::sync_channel, time::Duration};

use nalgebra::{UnitQuaternion, Vector3};
use roundel_core::{
    id::{BodyId, KindId},
    rigid::{Covariance6, Rigid},
    world::{
        CameraPlacement, FusionParams, KindPrintSize, MotionClass, PrintSize, PrintSizeState,
        WrongHeight,
    },
};

use super::*;
use crate::model::hub::EVENT_LOG_LEN;

fn hub(clock: &Clock) -> Arc<Hub> {
    Arc::new(fixtures::hub(&["north"], clock.now()))
}

fn output(frame: u64, capture_time: Timestamp) -> WorkerOutput {
    let observations = fixtures::frame(CameraId(0), frame, capture_time);
    WorkerOutput { observations: Arc::new(observations), placement: None }
}

/// Processes these outputs and ends.
fn fuse(fusion: Fusion, hub: &Arc<Hub>, clock: Clock, outputs: Vec<WorkerOutput>) {
    let (sender, receiver) = sync_channel(QUEUE_FRAMES);
    outputs.into_iter().for_each(|output| sender.send(output).unwrap());
    drop(sender);
    let stop = StopSignal::default();
    stop.stop();
    let task = FusionTask::new(fusion, hub.clone(), clock, receiver);
    task.run(PublishSchedule::new(Duration::from_millis(10), false), &stop);
}

#[test]
fn queued_frames_are_fused_before_the_end() {
    let clock = Clock::anchored_now();
    let hub = hub(&clock);
    let placement = CameraPlacement {
        world_from_camera: Rigid::translation(1.0, 0.0, 0.0),
        covariance: Covariance6::zeros(),
    };
    // The camera's pose comes with its first frame, as from a worker that has estimated it.
    let outputs = (1..=10).map(|frame| WorkerOutput {
        placement: (frame == 1).then_some(placement),
        ..output(frame, clock.now().plus_seconds((frame as f64 - 10.0) * 0.01))
    });
    fuse(Fusion::new(FusionParams::default()), &hub, clock, outputs.collect());

    let newest = hub.snapshots().borrow().clone();
    assert_eq!(newest.sequence, 1, "the last one");
    let object = &newest.snapshot.objects[0];
    assert!((object.position_m - Vector3::new(1.0, 0.0, 3.0)).norm() < 0.01, "{object:?}");
    let (events, _) = hub.events(10);
    let messages: Vec<&str> = events.iter().map(|event| event.message.as_str()).collect();
    assert_eq!(messages, [format!("Object {} (robot one) has appeared.", object.id)]);
    assert_eq!((events[0].kind(), events[0].object_id), (EventKind::ObjectAppeared, object.id.0));
    assert!(hub.cameras()[&CameraId(0)].latency_ms >= 0.0);
}

#[test]
fn a_clock_step_is_an_event() {
    let clock = Clock::anchored_now();
    let hub = hub(&clock);
    let outputs = (1..=30).map(|frame| {
        let received_time = clock.now().plus_seconds(frame as f64 * 0.03);
        let set_s = if frame > 10 { 3600.0 } else { 0.0 };
        let mut seen = output(frame, received_time.plus_seconds(set_s));
        Arc::get_mut(&mut seen.observations).unwrap().received_time = received_time;
        seen
    });
    fuse(Fusion::new(FusionParams::default()), &hub, clock, outputs.collect());
    let (events, _) = hub.events(10);
    let kinds: Vec<_> = events.iter().map(|event| (event.kind(), event.camera.as_str())).collect();
    assert_eq!(kinds, [(EventKind::CameraClockSet, "north")]);
    assert!(events[0].message.contains("camera north was set"), "{}", events[0].message);
    assert!(hub.cameras()[&CameraId(0)].clock.is_some());
}

#[test]
fn a_wrong_height_is_an_event() {
    let clock = Clock::anchored_now();
    let hub = hub(&clock);
    let mut fusion = Fusion::new(FusionParams::default());
    let world_from_camera = Rigid::identity();
    let placement = CameraPlacement { world_from_camera, covariance: Covariance6::zeros() };
    fusion.set_camera(CameraId(0), Some(placement));
    fusion.set_motion(KindId(0), MotionClass::Ground { height_m: Some(2.5) });
    let outputs =
        (1..=200).map(|frame| output(frame, clock.now().plus_seconds(frame as f64 * 0.11)));
    fuse(fusion, &hub, clock, outputs.collect());
    let (events, _) = hub.events(EVENT_LOG_LEN);
    let messages: Vec<&str> = events
        .iter()
        .filter(|event| event.kind() == EventKind::HeightContradicted)
        .map(|event| event.message.as_str())
        .collect();
    let expected =
        "Roundels \"robot\": seen at a height of 3.00 m by north, and `height_m` says 2.50.";
    assert_eq!(messages.len(), 1, "{messages:?}");
    assert!(messages[0].starts_with(expected), "{messages:?}");
    // An object with several roundels is identified by its name.
    let wrong = WrongHeight {
        kind: Some(KindId(0)),
        body: Some(BodyId(0)),
        configured_m: 0.0,
        measured_m: 0.2,
        cameras: vec![CameraId(0)],
    };
    let message = messages::height_mismatch(&hub.installation(), &wrong);
    assert!(message.starts_with("\"carrier\": seen at a height of 0.20 m"), "{message}");
}

#[test]
fn a_wrong_print_size_is_an_event() {
    let clock = Clock::anchored_now();
    let hub = Arc::new(fixtures::hub(&["north", "west"], clock.now()));
    let mut fusion = Fusion::new(FusionParams::default());
    fusion.set_print_tolerance(KindId(0), 0.03, 0.0);
    // The western camera looks along x; both see the roundel at 94 % of its configured distance.
    let distance_m = 0.94 * fixtures::DEPTH_M;
    let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), FRAC_PI_2);
    let west = Rigid::from_parts(Vector3::new(-distance_m, 0.0, distance_m).into(), turn);
    for (id, world_from_camera) in [(0, Rigid::identity()), (1, west)] {
        let placement = CameraPlacement { world_from_camera, covariance: Covariance6::zeros() };
        fusion.set_camera(CameraId(id), Some(placement));
    }
    let outputs = (1..=120).flat_map(|number| {
        [0, 1].map(|camera| {
            let time = clock.now().plus_seconds(number as f64 * 0.05 + f64::from(camera) * 0.02);
            let observations = Arc::new(fixtures::frame(CameraId(camera), number, time));
            WorkerOutput { observations, placement: None }
        })
    });
    fuse(fusion, &hub, clock, outputs.collect());
    let (events, _) = hub.events(EVENT_LOG_LEN);
    let messages: Vec<&str> = events
        .iter()
        .filter(|event| event.kind() == EventKind::PrintSizeContradicted)
        .map(|event| event.message.as_str())
        .collect();
    let expected = "Roundels \"robot\" are 6.0 % smaller than configured, as seen by north, west.";
    assert_eq!(messages.len(), 1, "{messages:?}");
    assert!(messages[0].starts_with(expected), "{messages:?}");
}

#[test]
fn a_wrong_print_size_names_its_remedy() {
    let hub = hub(&Clock::anchored_now());
    let message = |factor, state| {
        let size = PrintSize { factor, deviation: 0.001, flatness_m: 0.0 };
        let wrong = KindPrintSize { kind: KindId(0), size, state, cameras: vec![CameraId(0)] };
        messages::wrong_print_size(&hub.installation(), &wrong)
    };
    let fitted = message(0.969, PrintSizeState::Measured);
    assert!(
        fitted.starts_with(
            "Roundels \"robot\" are 3.1 % smaller than configured, as seen by north. They may"
        ),
        "{fitted}"
    );
    assert!(fitted.contains("fit to page"), "{fitted}");
    let larger = message(1.02, PrintSizeState::Measured);
    assert!(larger.contains("2.0 % larger") && !larger.contains("fit to page"), "{larger}");
    let wrong = message(0.76, PrintSizeState::Contradicted);
    assert!(
        wrong.contains("24.0 % smaller") && wrong.contains("cannot be that far off"),
        "{wrong}"
    );
}

#[test]
fn a_prompt_snapshot_precedes_the_tick() {
    let clock = Clock::anchored_now();
    let hub = hub(&clock);
    let (sender, receiver) = sync_channel(QUEUE_FRAMES);
    let task = FusionTask::new(Fusion::new(FusionParams::default()), hub.clone(), clock, receiver);
    let stop = StopSignal::default();
    let running = std::thread::spawn({
        let stop = stop.clone();
        move || task.run(PublishSchedule::new(Duration::from_secs(3600), true), &stop)
    });
    for frame in 1..=3 {
        let sequence = hub.snapshots().borrow().sequence;
        sender.send(output(frame, clock.now())).unwrap();
        while hub.snapshots().borrow().sequence == sequence {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
    stop.stop();
    // Ends the wait for the tick.
    drop(sender);
    running.join().unwrap();
}

#[test]
fn ticks_continue_without_cameras() {
    let clock = Clock::anchored_now();
    let hub = hub(&clock);
    let (_, receiver) = sync_channel(1);
    let task = FusionTask::new(Fusion::new(FusionParams::default()), hub.clone(), clock, receiver);
    let stop = StopSignal::default();
    let ticking = std::thread::spawn({
        let stop = stop.clone();
        move || task.run(PublishSchedule::new(Duration::from_millis(2), false), &stop)
    });
    while hub.snapshots().borrow().sequence < 3 {
        std::thread::sleep(Duration::from_millis(1));
    }
    stop.stop();
    ticking.join().unwrap();
}
