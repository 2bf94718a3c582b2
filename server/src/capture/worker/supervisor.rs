//! Runs a camera's worker and restarts it after a failure, with backoff.

use std::{
    any::Any,
    panic::{AssertUnwindSafe, catch_unwind},
    time::Duration,
};

use backon::{BackoffBuilder, ExponentialBackoff, ExponentialBuilder};

use super::{RunOutcome, Worker, WorkerCounts, thread_pool::in_thread_pool};
use crate::model::{
    hub::{CameraStatus, EventKind},
    stop::StopSignal,
};

/// Frames for this long reset the backoff.
const HEALTHY_AFTER: Duration = Duration::from_secs(10);

/// Delays that double from 0.5 s to 30 s, each shortened at random by up to a half, so that the cameras of a broken
/// switch do not reconnect at the same time.
fn delays() -> ExponentialBackoff {
    // The jitter adds up to as much again.
    ExponentialBuilder::new()
        .with_min_delay(Duration::from_millis(250))
        .with_max_delay(Duration::from_secs(15))
        .without_max_times()
        .with_jitter()
        .build()
}

/// Runs a worker until its source is finished or the signal comes; every failure, panics included,
/// is shown as the camera's state and tried again. Gives what it has counted.
pub fn run(worker: Worker, stop: &StopSignal) -> WorkerCounts {
    let name = worker.parts.name.clone();
    in_thread_pool(&name, || supervise(worker, stop))
}

fn supervise(mut worker: Worker, stop: &StopSignal) -> WorkerCounts {
    let mut backoff = delays();
    while !stop.is_stopped() {
        // A worker begins each play by putting its state in order, so a panic leaves nothing behind
        // that could do harm.
        let outcome = catch_unwind(AssertUnwindSafe(|| worker.run_once()));
        worker.count_skipped();
        let failure = match outcome {
            Ok(RunOutcome::Stopped) => return worker.counts(),
            Ok(RunOutcome::Finished) => {
                let message = format!("Camera {} has no more frames.", worker.parts.name);
                report(&worker, CameraStatus::Finished, "", message);
                return worker.counts();
            }
            Ok(RunOutcome::Failed(message)) => message,
            Err(panic) => format!("internal error, please report it: {}", panic_message(&*panic)),
        };
        if worker.running_since.is_some_and(|since| since.elapsed() >= HEALTHY_AFTER) {
            backoff = delays();
        }
        let pause = backoff.next().unwrap_or_default();
        let message = format!("Camera {} failed: {failure}", worker.parts.name);
        report(&worker, CameraStatus::Failed, &failure, message);
        tracing::info!(camera = worker.parts.name, pause_s = pause.as_secs_f64(), "trying again");
        if worker.parts.opener.pause(pause, stop) {
            return worker.counts();
        }
        if !worker.parts.opener.is_pushed() {
            worker.parts.hub.update_camera(worker.parts.id, |state| state.restarts += 1);
        }
    }
    worker.counts()
}

/// Shows the new status; what was shown already is no event again.
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
        match status {
            CameraStatus::Failed => tracing::warn!("{message}"),
            _ => tracing::info!("{message}"),
        }
        let kind = EventKind::CameraStatusChanged(worker.parts.id, status);
        worker.parts.hub.publish_event(worker.parts.clock.now(), kind, message);
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
            mpsc::{SyncSender, sync_channel},
        },
    };

    use roundel_core::{
        camera::{Camera, Intrinsics, Lens},
        frame::Frame,
        id::CameraId,
        marker::{Mask, Params},
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
                pipeline::{Pipeline, PipelineParts},
            },
        },
        model::{
            clock::Clock,
            hub::{CameraInfo, CameraPoseState, Hub, Installation, PoseStatus},
        },
    };

    #[test]
    fn delays_double_up_to_the_cap() {
        for (delay, longest) in delays().zip([0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0]) {
            assert!((longest / 2.0..=longest).contains(&delay.as_secs_f64()), "{delay:?}");
        }
    }

    /// What a source of the test does, call by call.
    enum Step {
        Frame,
        Panic,
        Fail,
        Finish,
    }

    struct ScriptedSource {
        steps: VecDeque<Step>,
        clock: Clock,
    }

    impl FrameSource for ScriptedSource {
        fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError> {
            match self.steps.pop_front() {
                Some(Step::Frame) => {
                    let frame = Frame::new(&[200; 64 * 48], 64, 48, 64).unwrap();
                    let info = FrameInfo { skipped: 2, ..FrameInfo::at(self.clock.now()) };
                    Ok(LentFrame { frame, info })
                }
                Some(Step::Panic) => panic!("the cable bit me"),
                Some(Step::Fail) => Err(SourceError::Failed("unplugged".into())),
                Some(Step::Finish) | None => Err(SourceError::Finished),
            }
        }
    }

    struct ScriptedOpener(VecDeque<ScriptedSource>);

    impl OpenSource for ScriptedOpener {
        fn open(&mut self) -> Result<Box<dyn FrameSource>, SourceError> {
            let actor = self.0.pop_front();
            actor.map(|actor| Box::new(actor) as Box<dyn FrameSource>).ok_or(SourceError::Finished)
        }

        fn take_skipped(&mut self) -> u64 {
            1
        }
    }

    fn camera() -> Camera {
        Camera::new(Intrinsics {
            width: 64,
            height: 48,
            fx_px: 60.0,
            fy_px: 60.0,
            cx_px: 31.5,
            cy_px: 23.5,
            lens: Lens::PlumbBob([0.0; 5]),
        })
        .unwrap()
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

    fn actor<const N: usize>(clock: Clock, steps: [Step; N]) -> ScriptedSource {
        ScriptedSource { steps: VecDeque::from(steps), clock }
    }

    fn worker(
        stage: ScriptedOpener,
        pose: PoseSource,
        hub: &Arc<Hub>,
        (fusion, clock, mailbox): (SyncSender<WorkerOutput>, Clock, &CalibrationMailbox),
    ) -> Worker {
        let pipeline = Pipeline::new(PipelineParts {
            kinds: Vec::new(),
            params: Params::default(),
            mask: Mask::default(),
            camera: camera(),
            line_time_s: 0.0,
            counts: Default::default(),
        });
        Worker::new(WorkerParts {
            id: CameraId(0),
            name: "north".into(),
            opener: Box::new(stage),
            pipeline: pipeline.unwrap(),
            pose,
            calibration_version: 0,
            mailbox: mailbox.clone(),
            hub: hub.clone(),
            fusion,
            clock,
            promised_hz: None,
            before: WorkerCounts::default(),
        })
    }

    #[test]
    fn a_panic_and_a_failure_are_shown_and_the_camera_comes_back() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let stage = ScriptedOpener(VecDeque::from([
            actor(clock, [Step::Frame, Step::Panic]),
            actor(clock, [Step::Fail]),
            actor(clock, [Step::Frame, Step::Frame, Step::Finish]),
        ]));
        let (fusion, from_worker) = sync_channel(1);
        let worker = worker(
            stage,
            PoseSource::Mounted,
            &hub,
            (fusion, clock, &CalibrationMailbox::default()),
        );
        run(worker, &StopSignal::default());

        let (events, _) = hub.events(10);
        let happened: Vec<EventKind> = events.iter().map(|event| event.kind).collect();
        let [running, failed, finished] =
            [CameraStatus::Running, CameraStatus::Failed, CameraStatus::Finished]
                .map(|status| EventKind::CameraStatusChanged(CameraId(0), status));
        assert_eq!(happened, [running, failed, failed, running, finished]);
        assert!(events[1].message.contains("internal error"), "{}", events[1].message);
        assert!(events[1].message.contains("the cable bit me"), "{}", events[1].message);
        assert!(events[2].message.contains("unplugged"), "{}", events[2].message);
        let state = &hub.cameras()[&CameraId(0)];
        assert_eq!((state.status, state.restarts, state.frames), (CameraStatus::Finished, 2, 3));
        // Two left out by the source before each frame, two that fusion had no room for, and one after the last
        // frame of each of three attempts.
        assert_eq!(state.dropped, 3 * 2 + 2 + 3);
        assert_eq!(from_worker.try_iter().map(|output| output.observations.frame).max(), Some(1));
    }

    /// A lens and a pose that come between two frames hold from the next frame on, for fusion too.
    #[test]
    fn a_calibration_is_taken_over_between_two_frames() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let (fusion, from_worker) = sync_channel(8);
        let mailbox = CalibrationMailbox::default();
        let stage = ScriptedOpener(VecDeque::from([actor(
            clock,
            [Step::Frame, Step::Frame, Step::Frame, Step::Finish],
        )]));
        let pose = PoseSource::Unknown { references: Vec::new(), kinds: Vec::new() };
        let worker = worker(stage, pose, &hub, (fusion, clock, &mailbox));
        let longer = Intrinsics { fx_px: 61.0, ..camera().intrinsics().clone() };
        let placement = CameraPlacement {
            world_from_camera: Rigid::translation(1.0, 2.0, 3.0),
            covariance: Covariance6::identity(),
        };
        let pose = PoseSource::Fixed(PoseStatus::Calibrated, Box::new(placement));
        mailbox.put(CalibrationUpdate { lens: camera(), pose: pose.clone(), version: 6 });
        let lens = Camera::new(longer.clone()).unwrap();
        mailbox.put(CalibrationUpdate { lens, pose, version: 7 });
        run(worker, &StopSignal::default());

        let output: Vec<WorkerOutput> = from_worker.try_iter().collect();
        let versions: Vec<u64> =
            output.iter().map(|it| it.observations.calibration_version).collect();
        assert_eq!(versions, [7, 7, 7]);
        let places: Vec<bool> = output.iter().map(|it| it.placement.is_some()).collect();
        assert_eq!(
            places,
            [true, false, false],
            "told once, with the first frame that it holds for"
        );
        let state = &hub.cameras()[&CameraId(0)];
        assert_eq!(state.calibration_version, 7);
        assert_eq!(state.pose, CameraPoseState::fixed(PoseStatus::Calibrated, placement));
        assert_eq!(state.camera.as_ref().unwrap().intrinsics(), &longer);
    }
}
