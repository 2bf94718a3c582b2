//! Runs a camera's worker and restarts it after a failure, with backoff.

use std::{
    any::Any,
    panic::{AssertUnwindSafe, catch_unwind},
    time::Duration,
};

use backon::{BackoffBuilder, ExponentialBackoff, ExponentialBuilder};

use super::{End, Totals, Worker, helpers::with_helpers};
use crate::model::{
    hub::{CameraStatus, Happening},
    stop::Stop,
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
pub fn run(worker: Worker, stop: &Stop) -> Totals {
    let name = worker.parts.name.clone();
    with_helpers(&name, || keep_running(worker, stop))
}

fn keep_running(mut worker: Worker, stop: &Stop) -> Totals {
    let mut backoff = delays();
    while !stop.is_stopped() {
        // A worker begins each play by putting its state in order, so a panic leaves nothing behind
        // that could do harm.
        let outcome = catch_unwind(AssertUnwindSafe(|| worker.play()));
        worker.count_skipped();
        let failure = match outcome {
            Ok(End::Stopped) => return worker.totals(),
            Ok(End::Finished) => {
                let message = format!("Camera {} has no more frames.", worker.parts.name);
                report(&worker, CameraStatus::Finished, "", message);
                return worker.totals();
            }
            Ok(End::Failed(message)) => message,
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
            return worker.totals();
        }
        if !worker.parts.opener.is_fed() {
            worker.parts.hub.update_camera(worker.parts.id, |state| state.restarts += 1);
        }
    }
    worker.totals()
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
        let happening = Happening::Camera(worker.parts.id, status);
        worker.parts.hub.publish_event(worker.parts.clock.now(), happening, message);
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
                Place, Sighted, WorkerParts,
                adoption::{Adoption, Inbox},
                pipeline::{Pipeline, PipelineParts},
            },
        },
        model::{
            clock::Clock,
            hub::{CameraInfo, CameraPlace, Hub, Installation, PoseStatus},
        },
    };

    #[test]
    fn delays_double_up_to_the_cap() {
        for (delay, longest) in delays().zip([0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0]) {
            assert!((longest / 2.0..=longest).contains(&delay.as_secs_f64()), "{delay:?}");
        }
    }

    /// What a source of the test does, call by call.
    enum Act {
        Frame,
        Panic,
        Fail,
        Finish,
    }

    struct Actor {
        acts: VecDeque<Act>,
        clock: Clock,
    }

    impl FrameSource for Actor {
        fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError> {
            match self.acts.pop_front() {
                Some(Act::Frame) => {
                    let frame = Frame::new(&[200; 64 * 48], 64, 48, 64).unwrap();
                    let info = FrameInfo { skipped: 2, ..FrameInfo::at(self.clock.now()) };
                    Ok(LentFrame { frame, info })
                }
                Some(Act::Panic) => panic!("the cable bit me"),
                Some(Act::Fail) => Err(SourceError::Failed("unplugged".into())),
                Some(Act::Finish) | None => Err(SourceError::Finished),
            }
        }
    }

    /// One source after the other.
    struct Stage(VecDeque<Actor>);

    impl OpenSource for Stage {
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
            cameras: Installation::numbered([CameraInfo {
                name: "north".into(),
                ..CameraInfo::default()
            }]),
            kinds: Vec::new(),
            object_names: BTreeMap::new(),
            body_names: vec![],
        }))
    }

    fn actor<const N: usize>(clock: Clock, acts: [Act; N]) -> Actor {
        Actor { acts: VecDeque::from(acts), clock }
    }

    fn worker(
        stage: Stage,
        place: Place,
        hub: &Arc<Hub>,
        (fusion, clock, inbox): (SyncSender<Sighted>, Clock, &Inbox),
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
            place,
            calibration_version: 0,
            inbox: inbox.clone(),
            hub: hub.clone(),
            fusion,
            clock,
            promised_hz: None,
            before: Totals::default(),
        })
    }

    #[test]
    fn a_panic_and_a_failure_are_shown_and_the_camera_comes_back() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let stage = Stage(VecDeque::from([
            actor(clock, [Act::Frame, Act::Panic]),
            actor(clock, [Act::Fail]),
            actor(clock, [Act::Frame, Act::Frame, Act::Finish]),
        ]));
        let (fusion, from_worker) = sync_channel(1);
        let worker = worker(stage, Place::Rides, &hub, (fusion, clock, &Inbox::default()));
        run(worker, &Stop::default());

        let (events, _) = hub.events(10);
        let happened: Vec<Happening> = events.iter().map(|event| event.happening).collect();
        let [running, failed, finished] =
            [CameraStatus::Running, CameraStatus::Failed, CameraStatus::Finished]
                .map(|status| Happening::Camera(CameraId(0), status));
        assert_eq!(happened, [running, failed, failed, running, finished]);
        assert!(events[1].message.contains("internal error"), "{}", events[1].message);
        assert!(events[1].message.contains("the cable bit me"), "{}", events[1].message);
        assert!(events[2].message.contains("unplugged"), "{}", events[2].message);
        let state = &hub.cameras()[&CameraId(0)];
        assert_eq!((state.status, state.restarts, state.frames), (CameraStatus::Finished, 2, 3));
        // Two left out by the source before each frame, two that fusion had no room for, and one after the last
        // frame of each of three attempts.
        assert_eq!(state.dropped, 3 * 2 + 2 + 3);
        assert_eq!(from_worker.try_iter().map(|sighted| sighted.observations.frame).max(), Some(1));
    }

    /// A lens and a place that come between two frames hold from the next frame on, for fusion too.
    #[test]
    fn a_calibration_is_taken_over_between_two_frames() {
        let clock = Clock::anchored_now();
        let hub = hub(&clock);
        let (fusion, from_worker) = sync_channel(8);
        let inbox = Inbox::default();
        let stage = Stage(VecDeque::from([actor(
            clock,
            [Act::Frame, Act::Frame, Act::Frame, Act::Finish],
        )]));
        let place = Place::Unknown { references: Vec::new(), kinds: Vec::new() };
        let worker = worker(stage, place, &hub, (fusion, clock, &inbox));
        let longer = Intrinsics { fx_px: 61.0, ..camera().intrinsics().clone() };
        let placement = CameraPlacement {
            world_from_camera: Rigid::translation(1.0, 2.0, 3.0),
            covariance: Covariance6::identity(),
        };
        let place = Place::Standing(PoseStatus::Calibrated, Box::new(placement));
        inbox.put(Adoption { lens: camera(), place: place.clone(), version: 6 });
        let lens = Camera::new(longer.clone()).unwrap();
        inbox.put(Adoption { lens, place, version: 7 });
        run(worker, &Stop::default());

        let sighted: Vec<Sighted> = from_worker.try_iter().collect();
        let versions: Vec<u64> =
            sighted.iter().map(|it| it.observations.calibration_version).collect();
        assert_eq!(versions, [7, 7, 7]);
        let places: Vec<bool> = sighted.iter().map(|it| it.placement.is_some()).collect();
        assert_eq!(
            places,
            [true, false, false],
            "told once, with the first frame that it holds for"
        );
        let state = &hub.cameras()[&CameraId(0)];
        assert_eq!(state.calibration_version, 7);
        assert_eq!(state.place, CameraPlace::standing(PoseStatus::Calibrated, placement));
        assert_eq!(state.camera.as_ref().unwrap().intrinsics(), &longer);
    }
}
