//! Runs a camera's worker and restarts it after a failure, with backoff.

use std::{
    any::Any,
    panic::{AssertUnwindSafe, catch_unwind},
    time::Duration,
};

use backon::{BackoffBuilder, ExponentialBackoff, ExponentialBuilder};

use super::{Worker, WorkerCounts, thread_pool::in_thread_pool};
use crate::{
    capture::source::SourceError,
    model::{
        hub::{CameraStatus, EventKind},
        redact::redact,
        stop::StopSignal,
    },
};

/// A worker that has run for this long resets the backoff.
const HEALTHY_AFTER: Duration = Duration::from_secs(10);

/// Delays that double from 0.5 s to 30 s, each shortened at random by up to a half, so that the cameras of a broken
/// switch do not reconnect at the same time.
fn delays() -> ExponentialBackoff {
    // The jitter at most doubles a delay.
    ExponentialBuilder::new()
        .with_min_delay(Duration::from_millis(250))
        .with_max_delay(Duration::from_secs(15))
        .without_max_times()
        .with_jitter()
        .build()
}

/// Runs a worker until its source is finished or the stop signal comes. Failures, including panics, are shown as the
/// camera's state and retried with backoff.
pub fn run(worker: Worker, stop: &StopSignal) -> WorkerCounts {
    let name = worker.parts.name.clone();
    in_thread_pool(&name, || supervise(worker, stop))
}

fn supervise(mut worker: Worker, stop: &StopSignal) -> WorkerCounts {
    let mut backoff = delays();
    while !stop.is_stopped() {
        // `run_once` resets the state that a panic may leave inconsistent.
        let outcome = catch_unwind(AssertUnwindSafe(|| worker.run_once()));
        worker.count_skipped();
        let failure = match outcome {
            Ok(SourceError::Stopped) => break,
            Ok(SourceError::Finished) => {
                let message = format!("Camera {} has no more frames.", worker.parts.name);
                report(&worker, CameraStatus::Finished, "", message);
                break;
            }
            Ok(error) => error.to_string(),
            Err(panic) => {
                let message = redact(panic_message(&*panic));
                format!("internal error, please report it: {message}")
            }
        };
        if worker.running_since.is_some_and(|since| since.elapsed() >= HEALTHY_AFTER) {
            backoff = delays();
        }
        let pause = backoff.next().unwrap_or_default();
        let message = format!("Camera {} failed: {failure}", worker.parts.name);
        report(&worker, CameraStatus::Failed, &failure, message);
        tracing::info!(camera = worker.parts.name, pause_s = pause.as_secs_f64(), "trying again");
        if worker.parts.opener.pause(pause, stop) {
            break;
        }
        if !worker.parts.opener.is_pushed() {
            worker.parts.hub.update_camera(worker.parts.id, |state| state.restarts += 1);
        }
    }
    worker.counts()
}

/// Shows the status, and publishes an event if it has changed.
fn report(worker: &Worker, status: CameraStatus, error: &str, message: String) {
    let mut changed = false;
    worker.parts.hub.update_camera(worker.parts.id, |state| {
        changed = state.status != status || state.error != error;
        state.status = status;
        error.clone_into(&mut state.error);
        state.rate_hz = 0.0;
        state.detections = 0;
    });
    if changed {
        let kind = if status == CameraStatus::Failed {
            tracing::warn!("{message}");
            EventKind::CameraFailed
        } else {
            tracing::info!("{message}");
            EventKind::CameraFinished
        };
        let now = worker.parts.clock.now();
        worker.parts.hub.publish_camera_event(now, kind, worker.parts.id, message);
    }
}

fn panic_message(panic: &(dyn Any + Send)) -> &str {
    panic
        .downcast_ref::<&str>()
        .copied()
        .or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("a panic without a message")
}

#[cfg(test)]
mod tests {
    use std::{
        collections::{BTreeMap, VecDeque},
        sync::{
            Arc,
            mpsc::{Receiver, sync_channel},
        },
    };

    use roundel_core::{
        frame::Frame,
        id::CameraId,
        marker::Mode,
        rigid::{Covariance6, Rigid},
        world::CameraPlacement,
    };

    use super::*;
    use crate::{
        capture::{
            source::{FrameInfo, FrameSource, LentFrame, OpenSource, SourceError},
            worker::{
                PoseSource, WorkerOutput, WorkerParts,
                calibration_update::{CalibrationMailbox, CalibrationUpdate},
                pipeline::{
                    Pipeline, PipelineParts,
                    tests::{HEIGHT, WIDTH, camera, parts},
                },
            },
        },
        model::{
            clock::Clock,
            hub::{CameraInfo, CameraPoseState, Hub, Installation, PoseStatus},
        },
    };

    /// Capacity of the queue to fusion.
    const QUEUE: usize = 3;

    #[test]
    fn delays_double_up_to_the_cap() {
        for (delay, longest) in delays().zip([0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0]) {
            assert!((longest / 2.0..=longest).contains(&delay.as_secs_f64()), "{delay:?}");
        }
    }

    /// A step of a source, which finishes after the last one.
    #[derive(Clone)]
    enum Step {
        Frame,
        Panic,
        Fail,
    }

    struct ScriptedSource(VecDeque<Step>, Clock);

    impl FrameSource for ScriptedSource {
        fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError> {
            match self.0.pop_front() {
                Some(Step::Frame) => {
                    let frame = Frame::new(&[200; WIDTH * HEIGHT], WIDTH, HEIGHT, WIDTH).unwrap();
                    let info = FrameInfo { skipped: 2, ..FrameInfo::at(self.1.now()) };
                    Ok(LentFrame { frame, info })
                }
                Some(Step::Panic) => panic!("the cable bit me"),
                Some(Step::Fail) => Err(SourceError::Failed("unplugged".into())),
                None => Err(SourceError::Finished),
            }
        }
    }

    /// Opens one source after the other.
    struct ScriptedOpener(VecDeque<ScriptedSource>);

    impl OpenSource for ScriptedOpener {
        fn open(&mut self) -> Result<Box<dyn FrameSource>, SourceError> {
            Ok(Box::new(self.0.pop_front().ok_or(SourceError::Finished)?))
        }

        fn take_skipped(&mut self) -> u64 {
            1
        }
    }

    fn hub(clock: &Clock) -> Arc<Hub> {
        Arc::new(Hub::new(Installation {
            name: "lab".into(),
            source_id: "s".into(),
            started: clock.now(),
            snapshot_rate_hz: 60.0,
            cameras: Installation::number_cameras([CameraInfo {
                name: "north".into(),
                ..CameraInfo::default()
            }]),
            kinds: Vec::new(),
            object_names: BTreeMap::new(),
            body_names: vec![],
        }))
    }

    fn worker<const N: usize>(
        scripts: [Vec<Step>; N],
        pose: PoseSource,
        hub: &Arc<Hub>,
        clock: Clock,
    ) -> (Worker, Receiver<WorkerOutput>) {
        let source = |steps| ScriptedSource(VecDeque::from(steps), clock);
        let (fusion, from_worker) = sync_channel(QUEUE);
        let parts = PipelineParts { kinds: Vec::new(), ..parts(Mode::Precise) };
        let worker = Worker::new(WorkerParts {
            id: CameraId(0),
            name: "north".into(),
            opener: Box::new(ScriptedOpener(scripts.map(source).into())),
            pipeline: Pipeline::new(parts).unwrap(),
            pose,
            calibration_version: 0,
            mailbox: CalibrationMailbox::default(),
            hub: hub.clone(),
            fusion,
            clock,
            promised_hz: None,
            min_error_px: 0.0,
            time_budget: 1.0,
            before: WorkerCounts::default(),
        });
        (worker, from_worker)
    }

    #[test]
    fn a_panic_and_a_failure_are_shown_and_the_camera_comes_back() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let scripts = [vec![Step::Frame, Step::Panic], vec![Step::Fail], vec![Step::Frame; 4]];
        let (worker, from_worker) = worker(scripts, PoseSource::Mounted, &hub, clock);
        run(worker, &StopSignal::default());

        let (events, _) = hub.events(10);
        let happened: Vec<EventKind> = events.iter().map(|event| event.kind()).collect();
        let (running, failed, finished) =
            (EventKind::CameraRunning, EventKind::CameraFailed, EventKind::CameraFinished);
        assert_eq!(happened, [running, failed, failed, running, finished]);
        assert!(events[1].message.contains("internal error"), "{}", events[1].message);
        assert!(events[1].message.contains("the cable bit me"), "{}", events[1].message);
        assert!(events[2].message.contains("unplugged"), "{}", events[2].message);
        let state = &hub.cameras()[&CameraId(0)];
        assert_eq!((state.status, state.restarts, state.frames), (CameraStatus::Finished, 2, 5));
        // Two skipped before each frame, two that did not fit into the queue to fusion, and one after the last frame of
        // each of three runs.
        assert_eq!(state.dropped, 5 * 2 + 2 + 3);
        let numbers: Vec<u64> = from_worker.try_iter().map(|it| it.observations.frame).collect();
        assert_eq!(numbers, [1, 2, 3]);
    }

    #[test]
    fn the_newest_calibration_holds_from_the_next_frame_on() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let pose = PoseSource::Unknown { references: Vec::new(), kinds: Vec::new() };
        let (worker, from_worker) = worker([vec![Step::Frame; 3]], pose, &hub, clock);
        let mailbox = worker.parts.mailbox.clone();
        let lens = camera(301.0);
        let placement = CameraPlacement {
            world_from_camera: Rigid::translation(1.0, 2.0, 3.0),
            covariance: Covariance6::identity(),
        };
        let pose = PoseSource::Fixed(PoseStatus::Calibrated, Box::new(placement));
        mailbox.put(CalibrationUpdate { lens: camera(299.0), pose: pose.clone(), version: 6 });
        mailbox.put(CalibrationUpdate { lens: lens.clone(), pose, version: 7 });
        run(worker, &StopSignal::default());

        let output: Vec<WorkerOutput> = from_worker.try_iter().collect();
        let versions: Vec<u64> =
            output.iter().map(|it| it.observations.calibration_version).collect();
        assert_eq!(versions, [7, 7, 7]);
        let places: Vec<bool> = output.iter().map(|it| it.placement.is_some()).collect();
        assert_eq!(places, [true, false, false], "sent once, with the first frame");
        let state = &hub.cameras()[&CameraId(0)];
        assert_eq!(state.calibration_version, 7);
        assert_eq!(state.pose, CameraPoseState::fixed(PoseStatus::Calibrated, placement));
        assert_eq!(state.camera.as_ref().unwrap().intrinsics(), lens.intrinsics());
    }
}
