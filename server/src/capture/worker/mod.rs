//! One camera's worker: newest frame → detections → observations, on a thread of its own.
//!
//! | module | purpose |
//! | --- | --- |
//! | `supervisor` | restarts the worker after a failure, with backoff |
//! | `thread_pool` | threads that share the precise fits of one frame |
//! | [`pipeline`] | pixels → detections with poses and times |
//! | `pose_source`, `pose_search` | the camera's pose, and the search for an unknown one |
//! | [`calibration_update`] | a new lens and pose, applied between two frames |
//! | `frame_budget` | bounds the time of a frame |
//! | `rate_monitor` | compares the frame rate with the promised one |
//! | [`statistics`] | rates and medians over the newest frames |
//!
//! A worker waits only for its source: publishing to the hub never blocks, and observations that do not fit into the
//! fusion queue are dropped and counted.

pub mod calibration_update;
mod error_floor;
mod frame_budget;
pub mod pipeline;
mod pose_search;
mod pose_source;
mod rate_monitor;
pub mod statistics;
mod supervisor;
mod thread_pool;

use std::{
    sync::{Arc, mpsc::SyncSender},
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
    capture::source::{
        LentFrame, OpenSource, RemoteDetections, SourceError, SourceOutput, push::RemoteStats,
    },
    model::{
        clock::Clock,
        hub::{
            CameraPoseState, CameraStatus, DetectionCounts, EventKind, Hub, Picture, PoseStatus,
        },
        tap::RawFrame,
    },
};
use calibration_update::{CalibrationMailbox, CalibrationUpdate};
use frame_budget::FrameBudget;
use pipeline::{FrameHeader, Pipeline};
use pose_search::{PoseSearch, SearchProgress};
use rate_monitor::{RateEvent, RateMonitor};
use statistics::{RateMeter, RunningMedian};

#[derive(Clone, Debug)]
pub struct WorkerOutput {
    pub observations: Arc<FrameObservations>,
    /// The camera's pose from this frame on, if it is new.
    pub placement: Option<CameraPlacement>,
}

#[derive(Clone, Copy, Debug, Default)]
pub struct WorkerCounts {
    /// Frames processed; also the number of the newest frame.
    pub frames: u64,
    /// Frames skipped for newer ones.
    pub dropped: u64,
    pub broken: u64,
    pub detection: DetectionCounts,
}

impl WorkerCounts {
    /// Remote programs choose their numbers.
    fn add_dropped(&mut self, count: u64) {
        self.dropped = self.dropped.saturating_add(count);
    }
}

pub struct WorkerParts {
    pub id: CameraId,
    pub name: String,
    pub opener: Box<dyn OpenSource>,
    pub pipeline: Pipeline,
    pub pose: PoseSource,
    /// Version of the calibration that `pose` and the pipeline's lens belong to; 0: the configuration.
    pub calibration_version: u64,
    pub mailbox: CalibrationMailbox,
    pub hub: Arc<Hub>,
    /// Queue to fusion.
    pub fusion: SyncSender<WorkerOutput>,
    pub clock: Clock,
    /// Configured frame rate; `None`: the one that the source announces.
    pub promised_hz: Option<f64>,
    /// Least error of remote detections, pixels; see [`error_floor`].
    pub min_error_px: f64,
    /// Time for finding and locating the roundels of a frame, as a share of the interval between frames.
    pub time_budget: f64,
    /// Counts of the camera's previous worker.
    pub before: WorkerCounts,
}

pub struct Worker {
    parts: WorkerParts,
    pose_search: Option<PoseSearch>,
    /// A pose that fusion has not taken yet.
    placement: Option<CameraPlacement>,
    /// Without those of the detection, which the pipeline has.
    counts: WorkerCounts,
    statistics: FrameStatistics,
    rate_monitor: RateMonitor,
    budget: FrameBudget,
    /// Arrival of the first frame since the source was opened.
    running_since: Option<Instant>,
    has_run: bool,
}

#[derive(Default)]
struct FrameStatistics {
    rate: RateMeter,
    detect_ms: RunningMedian,
    find_ms: RunningMedian,
    locate_ms: RunningMedian,
    blur_px: RunningMedian,
    noise: RunningMedian,
    decode_ms: RunningMedian,
}

impl Worker {
    pub fn new(parts: WorkerParts) -> Self {
        let pose_search = parts.pose.start_search();
        parts.hub.update_camera(parts.id, |state| {
            if let Some(pose) = parts.pose.initial_state() {
                state.pose = pose;
            }
            state.camera = Some(parts.pipeline.camera().clone());
            state.calibration_version = parts.calibration_version;
            // Clears the state of the previous worker.
            state.status = CameraStatus::Starting;
            state.error.clear();
            state.rate_reason.clear();
            (state.rate_hz, state.promised_hz, state.detections) = (0.0, 0.0, 0);
        });
        Self {
            pose_search,
            placement: None,
            counts: parts.before,
            statistics: FrameStatistics::default(),
            rate_monitor: RateMonitor::default(),
            budget: FrameBudget::new(parts.time_budget),
            running_since: None,
            has_run: false,
            parts,
        }
    }

    fn counts(&self) -> WorkerCounts {
        WorkerCounts { detection: *self.parts.pipeline.counts(), ..self.counts }
    }

    /// Opens the source and processes its frames until it ends; returns the reason.
    fn run_once(&mut self) -> SourceError {
        self.running_since = None;
        self.statistics.rate = RateMeter::default();
        self.parts.pipeline.reset();
        let mut source = match self.parts.opener.open() {
            Ok(source) => source,
            Err(error) => return error,
        };
        self.rate_monitor.restart(None);
        self.budget.restart(source.is_paced());
        let mut is_first = true;
        loop {
            match source.next() {
                Ok(SourceOutput::Frame(lent)) => self.process_frame(&lent),
                Ok(SourceOutput::Detections(remote)) => self.process_remote(*remote),
                Err(error) => return error,
            }
            if std::mem::take(&mut is_first) {
                // The configured rate takes precedence over the source's.
                let promised_hz = self.parts.promised_hz.or(source.promised_hz());
                self.rate_monitor.restart(promised_hz);
                self.parts.hub.update_camera(self.parts.id, |state| {
                    state.promised_hz = promised_hz.unwrap_or(0.0);
                });
            }
        }
    }

    /// Counts skipped frames that no later frame has reported.
    fn count_skipped(&mut self) {
        let skipped = self.parts.opener.take_skipped();
        if skipped > 0 {
            self.counts.add_dropped(skipped);
            self.parts.hub.update_camera(self.parts.id, |state| {
                state.dropped = state.dropped.saturating_add(skipped);
            });
        }
    }

    fn process_frame(&mut self, lent: &LentFrame<'_>) {
        let info = &lent.info;
        let received = self.parts.clock.now();
        self.take_calibration();
        self.counts.frames += 1;
        self.counts.add_dropped(info.skipped);
        self.counts.broken += info.broken;
        let begun = Instant::now();
        let header = FrameHeader {
            camera: self.parts.id,
            calibration_version: self.parts.calibration_version,
            frame: self.counts.frames,
            capture_time: info.capture_time,
            received_time: received,
        };
        let missed = info.skipped.saturating_add(info.broken);
        let budget = self.budget.add(info.capture_time, missed);
        self.parts.pipeline.set_deadline(budget.map(|budget| begun + budget));
        let observations = self.parts.pipeline.process(&lent.frame, &header);
        self.budget.note(budget, begun);
        let size = (lent.frame.width(), lent.frame.height());
        let observations = self.deliver(observations, size, received);
        // After the delivery, so that it adds no latency.
        self.parts.pipeline.seek(&lent.frame);
        let times = self.parts.pipeline.times();
        let statistics = &mut self.statistics;
        statistics.detect_ms.add(begun.elapsed().as_secs_f64() * 1e3);
        statistics.find_ms.add(times.find_ms);
        statistics.locate_ms.add(times.locate_ms);
        statistics.decode_ms.add(info.decoding.as_secs_f64() * 1e3);
        if let Some(quality) = self.parts.pipeline.image_quality() {
            statistics.blur_px.add(quality.blur_px);
            statistics.noise.add(quality.noise);
        }
        statistics.rate.add(received);
        self.check_rate(received, missed.saturating_add(1));
        self.publish(lent, observations);
    }

    /// Numbers and forwards detections that were made elsewhere.
    fn process_remote(&mut self, remote: RemoteDetections) {
        let RemoteDetections { mut observations, clock, skipped, figures } = remote;
        self.take_calibration();
        let now = self.parts.clock.now();
        self.counts.frames += 1;
        self.counts.add_dropped(skipped);
        observations.camera = self.parts.id;
        observations.frame = self.counts.frames;
        for detection in &mut observations.detections {
            error_floor::apply(detection, self.parts.pipeline.camera(), self.parts.min_error_px);
        }
        self.statistics.rate.add(now);
        self.check_rate(now, 1);
        let figures = figures.unwrap_or_else(|| {
            let camera = self.parts.pipeline.camera();
            RemoteStats { width: camera.width(), height: camera.height(), ..RemoteStats::default() }
        });
        let observations = self.deliver(observations, (figures.width, figures.height), now);
        self.parts.hub.update_camera(self.parts.id, |state| {
            state.frames = self.counts.frames;
            // Frames lost at the sender, and on the way.
            state.dropped = self.counts.dropped.saturating_add(figures.dropped);
            state.broken = self.counts.broken.saturating_add(figures.broken);
            state.capture_clock = Some(clock);
            state.rate_hz = self.statistics.rate.hz();
            state.detections = observations.detections.len();
            (state.detect_ms, state.decode_ms) = (figures.detect_ms, figures.decode_ms);
            (state.blur_px, state.noise) = (figures.blur_px, figures.noise);
        });
        self.parts.hub.publish_observations(observations);
    }

    /// Uses one frame's detections for the pose search, and sends them to fusion.
    fn deliver(
        &mut self,
        observations: FrameObservations,
        size: (usize, usize),
        now: Timestamp,
    ) -> Arc<FrameObservations> {
        if self.running_since.is_none() {
            self.running_since = Some(Instant::now());
            self.report_running(size, now);
        }
        self.search_pose(&observations, now);
        let observations = Arc::new(observations);
        let output = WorkerOutput { observations: observations.clone(), placement: self.placement };
        match self.parts.fusion.try_send(output) {
            Ok(()) => self.placement = None,
            // A disconnected queue means shutdown, which the source's next wait notices.
            Err(_) => self.counts.add_dropped(1),
        }
        observations
    }

    /// Applies a calibration update that is waiting. Fusion gets a new pose with this frame's observations.
    fn take_calibration(&mut self) {
        let Some(CalibrationUpdate { lens, pose, version }) = self.parts.mailbox.take() else {
            return;
        };
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
            if let Some(pose) = pose.initial_state() {
                state.pose = pose;
            }
            state.camera = Some(lens);
            state.calibration_version = version;
        });
    }

    fn report_running(&mut self, (width, height): (usize, usize), now: Timestamp) {
        let (id, name) = (self.parts.id, &self.parts.name);
        tracing::info!(camera = name, width, height, "frames arrive");
        // The supervisor counts the restarts of all other sources.
        let came_back = self.has_run && self.parts.opener.is_pushed();
        self.has_run = true;
        self.parts.hub.update_camera(id, |state| {
            state.status = CameraStatus::Running;
            state.error.clear();
            (state.width, state.height) = (width, height);
            state.restarts += u64::from(came_back);
        });
        let message = format!("Camera {name} is running.");
        self.parts.hub.publish_camera_event(now, EventKind::CameraRunning, id, message);
    }

    /// Counts frames, and reports a rate that begins or ceases to deviate from the promised one.
    fn check_rate(&mut self, now: Timestamp, frames: u64) {
        let Some(event) = self.rate_monitor.add(now, frames) else { return };
        let (id, name) = (self.parts.id, &self.parts.name);
        let (kind, reason, message) = match event {
            RateEvent::Off { found_hz, promised_hz } => {
                let reason = rate_monitor::rate_message(found_hz, promised_hz);
                let message = format!("Camera {name} {reason}.");
                tracing::warn!("{message}");
                (EventKind::CameraRateOff, reason, message)
            }
            RateEvent::Restored => {
                let message = format!("Camera {name} delivers the promised frame rate again.");
                tracing::info!("{message}");
                (EventKind::CameraRateAgrees, String::new(), message)
            }
        };
        self.parts.hub.update_camera(id, |state| state.rate_reason = reason);
        self.parts.hub.publish_camera_event(now, kind, id, message);
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
                    "Camera {name} found its pose from {references} references, which fit to {millimetres:.1} mm."
                );
                tracing::info!(camera = name, "{message}");
                hub.publish_camera_event(now, EventKind::CameraPlaced, id, message);
            }
        }
    }

    fn publish(&self, lent: &LentFrame<'_>, observations: Arc<FrameObservations>) {
        let (id, hub) = (self.parts.id, &self.parts.hub);
        let size = (lent.frame.width(), lent.frame.height());
        let pixels = || (0..size.1).flat_map(|v| lent.frame.row(v)).copied().collect();
        if hub.tap().wants_frame(observations.frame) {
            hub.tap().offer_frame(RawFrame {
                camera: id,
                number: observations.frame,
                capture_time: observations.capture_time,
                received_time: observations.received_time,
                size,
                pixels: pixels(),
            });
        }
        if hub.take_picture_request(id) {
            hub.publish_picture(id, Picture::new(size, pixels(), observations.clone()));
        }
        let (counts, statistics) = (self.counts(), &self.statistics);
        let budget_used = self.budget.used();
        hub.update_camera(id, |state| {
            state.frames = counts.frames;
            state.dropped = counts.dropped;
            state.broken = counts.broken;
            state.counts = counts.detection;
            state.capture_clock = Some(lent.info.clock);
            state.rate_hz = statistics.rate.hz();
            state.detections = observations.detections.len();
            state.decode_ms = statistics.decode_ms.value();
            state.detect_ms = statistics.detect_ms.value();
            state.find_ms = statistics.find_ms.value();
            state.locate_ms = statistics.locate_ms.value();
            state.budget_used = budget_used;
            state.blur_px = statistics.blur_px.value();
            state.noise = statistics.noise.value();
        });
        hub.publish_observations(observations);
    }
}
