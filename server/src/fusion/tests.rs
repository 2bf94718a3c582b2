use std::{sync::mpsc::sync_channel, time::Duration};

use nalgebra::Vector3;
use roundel_core::{
    id::{BodyId, KindId},
    rigid::{Covariance6, Rigid},
    world::{CameraPlacement, FusionParams, MotionClass, WrongHeight},
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

#[test]
fn what_was_sent_before_the_end_is_fused_and_told() {
    let clock = Clock::anchored_now();
    let hub = hub(&clock);
    let (sender, receiver) = sync_channel(QUEUE_FRAMES);
    let placement = CameraPlacement {
        world_from_camera: Rigid::translation(1.0, 0.0, 0.0),
        covariance: Covariance6::zeros(),
    };
    for frame in 1..=10 {
        // The camera's place comes with its first frame, as from a worker that has found it.
        let placement = (frame == 1).then_some(placement);
        let seen = output(frame, clock.now().plus_seconds((frame as f64 - 10.0) * 0.01));
        sender.send(WorkerOutput { placement, ..seen }).unwrap();
    }
    drop(sender);
    let task = FusionTask::new(Fusion::new(FusionParams::default()), hub.clone(), clock, receiver);
    let stop = StopSignal::default();
    stop.stop();
    task.run(PublishSchedule::new(Duration::from_millis(10), false), &stop);

    let newest = hub.snapshots().borrow().clone();
    assert_eq!(newest.sequence, 1, "the last one");
    let object = &newest.snapshot.objects[0];
    assert!((object.position_m - Vector3::new(1.0, 0.0, 3.0)).norm() < 0.01, "{object:?}");
    let (events, _) = hub.events(10);
    let messages: Vec<&str> = events.iter().map(|event| event.message.as_str()).collect();
    assert_eq!(messages, [format!("Object {} (robot one) has appeared.", object.id)]);
    assert!(hub.cameras()[&CameraId(0)].latency_ms >= 0.0);
}

#[test]
fn a_clock_that_was_set_is_told() {
    let clock = Clock::anchored_now();
    let hub = hub(&clock);
    let (sender, receiver) = sync_channel(QUEUE_FRAMES);
    for frame in 1..=30 {
        let received_time = clock.now().plus_seconds(frame as f64 * 0.03);
        let set_s = if frame > 10 { 3600.0 } else { 0.0 };
        let mut seen = output(frame, received_time.plus_seconds(set_s));
        Arc::get_mut(&mut seen.observations).unwrap().received_time = received_time;
        sender.send(seen).unwrap();
    }
    drop(sender);
    let task = FusionTask::new(Fusion::new(FusionParams::default()), hub.clone(), clock, receiver);
    let stop = StopSignal::default();
    stop.stop();
    task.run(PublishSchedule::new(Duration::from_millis(10), false), &stop);
    let (events, _) = hub.events(10);
    let told: Vec<_> = events.iter().map(|event| event.kind).collect();
    assert_eq!(told, [EventKind::CameraClockSet(CameraId(0))]);
    assert!(events[0].message.contains("camera north was set"), "{}", events[0].message);
    assert!(hub.cameras()[&CameraId(0)].clock.is_some());
}

#[test]
fn a_height_that_cameras_contradict_is_told() {
    let clock = Clock::anchored_now();
    let hub = hub(&clock);
    let (sender, receiver) = sync_channel(QUEUE_FRAMES);
    for frame in 1..=200 {
        sender.send(output(frame, clock.now().plus_seconds(frame as f64 * 0.11))).unwrap();
    }
    drop(sender);
    let mut fusion = Fusion::new(FusionParams::default());
    let world_from_camera = Rigid::identity();
    let placement = CameraPlacement { world_from_camera, covariance: Covariance6::zeros() };
    fusion.set_camera(CameraId(0), Some(placement));
    fusion.set_motion(KindId(0), MotionClass::Ground { height_m: Some(2.5) });
    let task = FusionTask::new(fusion, hub.clone(), clock, receiver);
    let stop = StopSignal::default();
    stop.stop();
    task.run(PublishSchedule::new(Duration::from_millis(10), false), &stop);
    let (events, _) = hub.events(EVENT_LOG_LEN);
    let told: Vec<&str> = events
        .iter()
        .filter(|event| event.kind == EventKind::HeightContradicted)
        .map(|event| event.message.as_str())
        .collect();
    let expected =
        "Roundels \"robot\": seen at a height of 3.00 m by north, and `height_m` says 2.50.";
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(told[0].starts_with(expected), "{told:?}");
    // Of an object that is known by several roundels, by its name.
    let wrong = WrongHeight {
        kind: Some(KindId(0)),
        body: Some(BodyId(0)),
        said_m: 0.0,
        seen_m: 0.2,
        cameras: vec![CameraId(0)],
    };
    let messages = messages::height_mismatch(&hub.installation(), &wrong);
    assert!(messages.starts_with("\"carrier\": seen at a height of 0.20 m"), "{messages}");
}

#[test]
fn a_prompt_one_tells_of_a_frame_long_before_the_tick() {
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
fn ticks_go_on_when_no_camera_is_left() {
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
