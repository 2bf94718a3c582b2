//! One camera's worker: newest frame → detections → observations, on a thread of its own.
//!
//! | module | what it does |
//! | --- | --- |
//! | `supervisor` | runs the worker again after a failure, with backoff |
//! | `thread_pool` | threads that fit a part of a frame's rings |
//! | [`pipeline`] | pixels → detections with poses and times |
//! | `remote` | what was seen elsewhere, and only passes through |
//! | `pose_source`, `pose_search` | where the camera stands, and what finds that where it is unknown |
//! | [`calibration_update`] | a new lens and pose, taken over between two frames |
//! | `rate_monitor` | whether the camera gives as many frames as was promised |
//! | [`statistics`] | rates and medians over the newest frames |
//!
//! Nothing here waits for anybody but the source: the hub's publishing never blocks, and what
//! fusion has no room for is dropped and counted.

pub mod calibration_update;
pub mod pipeline;
mod pose_search;
mod pose_source;
mod rate_monitor;
mod remote;
pub mod statistics;
mod supervisor;
mod thread_pool;

use std::{
    sync::{
        Arc,
        mpsc::{SyncSender, TrySendError},
    },
    time::Instant,
};

use roundel_core::{
    id::CameraId,
    time::Timestamp,
    world::{CameraPlacement, FrameObservations},
};

pub use pose_source::PoseSource;
pub use supervisor::run;

use crate::{
    capture::source::{LentFrame, OpenSource, SourceError, SourceOutput},
    model::{
        clock::Clock,
        hub::{
            CameraPoseState, CameraStatus, DetectionCounts, EventKind, Hub, Picture, PoseStatus,
        },
        tap::RawFrame,
    },
};
use calibration_update::{CalibrationMailbox, CalibrationUpdate};
use pipeline::{FrameHeader, Pipeline};
use pose_search::{PoseSearch, SearchProgress};
use rate_monitor::{RateEvent, RateMonitor};
use statistics::{RateMeter, RunningMedian};

#[derive(Clone, Debug)]
pub struct WorkerOutput {
    /// What was seen in one frame.
    pub observations: Arc<FrameObservations>,
    /// The camera's pose from this frame on, where it is new.
    pub placement: Option<CameraPlacement>,
}

#[derive(Clone, Copy, Debug, Default)]
pub struct WorkerCounts {
    /// Frames processed, which their numbers go on from.
    pub frames: u64,
    /// Frames that gave way to newer ones.
    pub dropped: u64,
    pub broken: u64,
    /// What became of rings and candidates.
    pub detection: DetectionCounts,
}

/// What a worker is made of.
pub struct WorkerParts {
    pub id: CameraId,
    pub name: String,
    pub opener: Box<dyn OpenSource>,
    pub pipeline: Pipeline,
    pub pose: PoseSource,
    /// Of the calibration that `pose_source` and the pipeline's lens are of; 0: of the configuration.
    pub calibration_version: u64,
    /// Where news of both arrive.
    pub mailbox: CalibrationMailbox,
    pub hub: Arc<Hub>,
    /// To fusion; when it is full, the observations are dropped and counted.
    pub fusion: SyncSender<WorkerOutput>,
    pub clock: Clock,
    /// Frames a second that the camera is to give, as a person has said; `None`: as its driver says.
    pub promised_hz: Option<f64>,
    /// What the camera's worker before this one has counted.
    pub before: WorkerCounts,
}

pub struct Worker {
    parts: WorkerParts,
    pose_search: Option<PoseSearch>,
    /// Found and not yet taken by fusion.
    placement: Option<CameraPlacement>,
    frames: u64,
    dropped: u64,
    rate: RateMeter,
    rate_monitor: RateMonitor,
    detect_ms: RunningMedian,
    find_ms: RunningMedian,
    locate_ms: RunningMedian,
    blur_px: RunningMedian,
    noise: RunningMedian,
    decode_ms: RunningMedian,
    broken: u64,
    /// Since when frames arrive.
    running_since: Option<Instant>,
    has_run: bool,
}

/// Why a worker stopped taking frames.
#[derive(Clone, Debug, PartialEq, Eq)]
enum RunOutcome {
    Stopped,
    Finished,
    Failed(String),
}

impl Worker {
    /// A worker that has not begun.
    pub fn new(parts: WorkerParts) -> Self {
        let pose_search = parts.pose.start_search();
        let (pose, camera) = (parts.pose.initial_state(), parts.pipeline.camera().clone());
        parts.hub.update_camera(parts.id, |state| {
            pose.into_iter().for_each(|pose| state.pose = pose);
            state.camera = Some(camera);
            state.calibration_version = parts.calibration_version;
            // Of one before it that is nobody's news any more.
            state.status = CameraStatus::Starting;
            state.error.clear();
            state.rate_reason.clear();
            (state.rate_hz, state.promised_hz, state.detections) = (0.0, 0.0, 0);
        });
        let WorkerCounts { frames, dropped, broken, .. } = parts.before;
        Self {
            parts,
            pose_search,
            placement: None,
            frames,
            dropped,
            rate: RateMeter::default(),
            rate_monitor: RateMonitor::default(),
            detect_ms: RunningMedian::default(),
            find_ms: RunningMedian::default(),
            locate_ms: RunningMedian::default(),
            blur_px: RunningMedian::default(),
            noise: RunningMedian::default(),
            decode_ms: RunningMedian::default(),
            broken,
            running_since: None,
            has_run: false,
        }
    }

    fn counts(&self) -> WorkerCounts {
        let Self { frames, dropped, broken, .. } = *self;
        WorkerCounts { frames, dropped, broken, detection: *self.parts.pipeline.counts() }
    }

    /// Opens the source and works until it ends.
    fn run_once(&mut self) -> RunOutcome {
        self.running_since = None;
        self.rate = RateMeter::default();
        self.parts.pipeline.reset();
        let mut source = match self.parts.opener.open() {
            Ok(source) => source,
            Err(error) => return outcome_of(error),
        };
        self.rate_monitor.restart(None);
        let mut is_first = true;
        loop {
            match source.next() {
                Ok(SourceOutput::Frame(lent)) => self.process_frame(&lent),
                Ok(SourceOutput::Detections(remote)) => self.process_remote(*remote),
                Err(error) => return outcome_of(error),
            }
            if std::mem::take(&mut is_first) {
                self.set_promised_rate(source.promised_hz());
            }
        }
    }

    /// Who set the camera up knows best.
    fn set_promised_rate(&mut self, of_source_hz: Option<f64>) {
        let promised_hz = self.parts.promised_hz.or(of_source_hz);
        self.rate_monitor.restart(promised_hz);
        self.parts.hub.update_camera(self.parts.id, |state| {
            state.promised_hz = promised_hz.unwrap_or(0.0);
        });
    }

    /// Counts what no frame has told of, since no frame may come any more.
    fn count_skipped(&mut self) {
        let skipped = self.parts.opener.take_skipped();
        if skipped > 0 {
            self.dropped += skipped;
            self.parts.hub.update_camera(self.parts.id, |state| state.dropped += skipped);
        }
    }

    fn process_frame(&mut self, lent: &LentFrame<'_>) {
        let info = &lent.info;
        let received = self.parts.clock.now();
        if let Some(calibration_update) = self.parts.mailbox.take() {
            self.apply_calibration(calibration_update);
        }
        self.frames += 1;
        self.dropped += info.skipped;
        self.broken += info.broken;
        self.decode_ms.add(info.decoding.as_secs_f64() * 1e3);
        let begun = Instant::now();
        let by = FrameHeader {
            camera: self.parts.id,
            calibration_version: self.parts.calibration_version,
            frame: self.frames,
            capture_time: info.capture_time,
            received_time: received,
        };
        let observations = Arc::new(self.parts.pipeline.process(&lent.frame, &by));
        if self.running_since.is_none() {
            self.running_since = Some(begun);
            self.report_running((lent.frame.width(), lent.frame.height()), received);
        }
        self.search_pose(&observations, received);
        self.send_to_fusion(observations.clone());
        // Nobody waits for what follows.
        self.parts.pipeline.seek(&lent.frame);
        self.detect_ms.add(begun.elapsed().as_secs_f64() * 1e3);
        let times = self.parts.pipeline.times();
        self.find_ms.add(times.find_ms);
        self.locate_ms.add(times.locate_ms);
        if let Some(quality) = self.parts.pipeline.image_quality() {
            self.blur_px.add(quality.blur_px);
            self.noise.add(quality.noise);
        }
        self.rate.add(received);
        self.check_rate(received, 1 + info.skipped + info.broken);
        self.publish(lent, observations);
    }

    /// From this frame on. Fusion hears of the pose with what is seen in it.
    fn apply_calibration(&mut self, CalibrationUpdate { lens, pose, version }: CalibrationUpdate) {
        match &pose {
            PoseSource::Unchanged => {}
            PoseSource::Fixed(_, placement) => {
                (self.pose_search, self.placement) = (None, Some(**placement));
            }
            PoseSource::Unknown { .. } | PoseSource::Mounted => {
                (self.pose_search, self.placement) = (pose.start_search(), None);
            }
        }
        self.parts.calibration_version = version;
        self.parts.pipeline.set_camera(&lens);
        self.parts.hub.update_camera(self.parts.id, |state| {
            pose.initial_state().into_iter().for_each(|pose| state.pose = pose);
            state.camera = Some(lens);
            state.calibration_version = version;
        });
    }

    fn report_running(&mut self, (width, height): (usize, usize), now: Timestamp) {
        let (id, name) = (self.parts.id, &self.parts.name);
        tracing::info!(camera = name, width, height, "frames arrive");
        // Nobody opens one that is fed: what counts is that it has come back.
        let came_back = self.has_run && self.parts.opener.is_pushed();
        self.has_run = true;
        self.parts.hub.update_camera(id, |state| {
            state.status = CameraStatus::Running;
            state.error.clear();
            (state.width, state.height) = (width, height);
            state.restarts += u64::from(came_back);
        });
        let kind = EventKind::CameraStatusChanged(id, CameraStatus::Running);
        self.parts.hub.publish_event(now, kind, format!("Camera {name} is running."));
    }

    /// So many frames have come; tells where that is another number than was promised.
    fn check_rate(&mut self, now: Timestamp, frames: u64) {
        let Some(told) = self.rate_monitor.add(now, frames) else { return };
        let (id, name) = (self.parts.id, &self.parts.name);
        let (kind, reason, message) = match told {
            RateEvent::Off { found_hz, promised_hz } => {
                let reason = rate_monitor::rate_message(found_hz, promised_hz);
                let message = format!("Camera {name} {reason}.");
                tracing::warn!("{message}");
                (EventKind::CameraRateOff(id), reason, message)
            }
            RateEvent::Restored => {
                let message = format!("Camera {name} gives as many frames as was promised again.");
                tracing::info!("{message}");
                (EventKind::CameraRateAgrees(id), String::new(), message)
            }
        };
        self.parts.hub.update_camera(id, |state| state.rate_reason = reason);
        self.parts.hub.publish_event(now, kind, message);
    }

    fn search_pose(&mut self, observations: &FrameObservations, now: Timestamp) {
        let Some(pose_search) = &mut self.pose_search else { return };
        let (id, name, hub) = (self.parts.id, &self.parts.name, &self.parts.hub);
        match pose_search.observe(observations) {
            SearchProgress::Waiting => {}
            SearchProgress::Failed(reason) => {
                hub.update_camera(id, |state| state.pose = CameraPoseState::searching(reason));
            }
            SearchProgress::Found { placement, references, rms_m } => {
                self.pose_search = None;
                self.placement = Some(*placement);
                let pose = CameraPoseState::fixed(PoseStatus::Found, *placement);
                hub.update_camera(id, |state| state.pose = pose);
                let millimetres = rms_m * 1e3;
                let message = format!(
                    "Camera {name} found its place from {references} references, which fit to \
                     {millimetres:.1} mm."
                );
                tracing::info!(camera = name, "{message}");
                hub.publish_event(now, EventKind::CameraPlaced(id), message);
            }
        }
    }

    fn send_to_fusion(&mut self, observations: Arc<FrameObservations>) {
        let output = WorkerOutput { observations, placement: self.placement };
        match self.parts.fusion.try_send(output) {
            Ok(()) => self.placement = None,
            // Fusion gone means shutdown, which the source's next wait notices.
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => self.dropped += 1,
        }
    }

    fn publish(&mut self, lent: &LentFrame<'_>, observations: Arc<FrameObservations>) {
        let (id, hub) = (self.parts.id, &self.parts.hub);
        let (width, height) = (lent.frame.width(), lent.frame.height());
        let copied = || (0..height).flat_map(|v| lent.frame.row(v)).copied().collect();
        if hub.tap().wants_frame(observations.frame) {
            let FrameObservations { frame: number, capture_time, received_time, .. } =
                *observations;
            let (pixels, size) = (copied(), (width, height));
            let camera = id;
            hub.tap().offer_frame(RawFrame {
                camera,
                number,
                capture_time,
                received_time,
                size,
                pixels,
            });
        }
        if hub.take_picture_request(id) {
            let pixels = copied();
            let picture = Picture::new((width, height), pixels, observations.clone());
            hub.publish_picture(id, picture);
        }
        hub.update_camera(id, |state| {
            state.frames = self.frames;
            state.dropped = self.dropped;
            state.broken = self.broken;
            state.capture_clock = Some(lent.info.clock);
            state.decode_ms = self.decode_ms.value();
            state.rate_hz = self.rate.hz();
            state.detections = observations.detections.len();
            state.detect_ms = self.detect_ms.value();
            state.find_ms = self.find_ms.value();
            state.locate_ms = self.locate_ms.value();
            (state.blur_px, state.noise) = (self.blur_px.value(), self.noise.value());
            state.counts = *self.parts.pipeline.counts();
        });
        hub.publish_observations(observations);
    }
}

fn outcome_of(error: SourceError) -> RunOutcome {
    match error {
        SourceError::Stopped => RunOutcome::Stopped,
        SourceError::Finished => RunOutcome::Finished,
        SourceError::Failed(message) => RunOutcome::Failed(message),
        error @ SourceError::Size { .. } => RunOutcome::Failed(error.to_string()),
    }
}
