//! The fusion thread, sole owner of all tracks. Feeds observations from the workers to `core::world` and publishes
//! snapshots at steady ticks or, if configured, as soon as a frame was fused.

mod apply_command;
pub mod calibration;
pub mod camera_manager;
mod camera_monitor;
#[cfg(test)]
mod fixtures;
mod messages;
mod monitor_thread;
mod mounted_cameras;
mod reprojection;
mod schedule;
pub mod setup;

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{
        Arc,
        mpsc::{Receiver, RecvTimeoutError, Sender, channel},
    },
    time::Instant,
};

use roundel_core::{
    id::CameraId,
    time::Timestamp,
    world::{Event, Fusion, Landmark},
};

use crate::{
    capture::worker::{WorkerOutput, statistics::RunningMedian},
    model::{
        clock::Clock,
        command::{CameraChange, CameraUpdate, FusionCommand},
        hub::{EventKind, Hub},
        stop::StopSignal,
        tap::RecordedItem,
    },
};
use calibration::Calibrator;
use camera_monitor::CameraMonitor;
use mounted_cameras::MountedCameras;
use reprojection::ReprojectionMonitor;
pub use schedule::PublishSchedule;

/// Capacity of the queue from the workers. When it is full, the newest frame is dropped and counted.
pub const QUEUE_FRAMES: usize = 256;

/// Runs fusion until it is stopped.
pub struct FusionTask {
    fusion: Fusion,
    hub: Arc<Hub>,
    clock: Clock,
    worker_outputs: Receiver<WorkerOutput>,
    commands: Receiver<FusionCommand>,
    /// Frames of other cameras are ignored.
    cameras: BTreeSet<CameraId>,
    latency_ms: BTreeMap<CameraId, RunningMedian>,
    mounted_cameras: MountedCameras,
    reprojection: ReprojectionMonitor,
    camera_monitor: Option<CameraMonitor>,
}

impl FusionTask {
    /// `fusion` knows objects and landmarks. The poses and clocks of the cameras follow as commands.
    pub fn new(
        fusion: Fusion,
        hub: Arc<Hub>,
        clock: Clock,
        worker_outputs: Receiver<WorkerOutput>,
    ) -> Self {
        let cameras = hub.installation().cameras.keys().copied().collect();
        Self {
            fusion,
            hub,
            clock,
            worker_outputs,
            commands: channel().1,
            cameras,
            latency_ms: BTreeMap::new(),
            mounted_cameras: MountedCameras::default(),
            reprojection: ReprojectionMonitor::default(),
            camera_monitor: None,
        }
    }

    /// Detects bumped and drifted cameras.
    pub fn with_camera_monitor(self, landmarks: &[Landmark], calibrator: Arc<Calibrator>) -> Self {
        Self { camera_monitor: Some(CameraMonitor::new(landmarks, calibrator)), ..self }
    }

    /// Accepts commands through the returned sender.
    pub fn with_commands(self) -> (Self, Sender<FusionCommand>) {
        let (sender, commands) = channel();
        (Self { commands, ..self }, sender)
    }

    /// Publishes snapshots until `stop`, and a last one then.
    pub fn run(mut self, mut schedule: PublishSchedule, stop: &StopSignal) {
        while !stop.is_stopped() {
            self.collect_until_due(&schedule, stop);
            let begun = Instant::now();
            self.publish(self.clock.at(schedule.pose_time(begun)), None);
            schedule.publish(begun, Instant::now());
        }
        while let Ok(output) = self.worker_outputs.try_recv() {
            self.observe(&output);
        }
        self.process_commands();
        self.publish(self.clock.now(), None);
    }

    /// Processes frames until the next snapshot is due.
    fn collect_until_due(&mut self, schedule: &PublishSchedule, stop: &StopSignal) {
        let mut has_news = false;
        loop {
            self.process_commands();
            let now = Instant::now();
            if now >= schedule.tick() {
                return;
            }
            let rest = schedule.due(has_news).saturating_duration_since(now);
            match self.worker_outputs.recv_timeout(rest) {
                Ok(output) => {
                    self.observe(&output);
                    has_news = true;
                }
                Err(RecvTimeoutError::Timeout) => return,
                // All cameras have finished; tracks still age and are lost.
                Err(RecvTimeoutError::Disconnected) => {
                    stop.wait(rest);
                    return;
                }
            }
        }
    }

    pub fn observe(&mut self, output: &WorkerOutput) {
        let camera = output.observations.camera;
        // Commands sent before this frame was captured apply to it.
        self.process_commands();
        if !self.cameras.contains(&camera) {
            return;
        }
        if let Some(placement) = output.placement {
            let change = CameraChange::Localized(Box::new(placement));
            self.apply_camera_update(CameraUpdate { camera, change });
        }
        let (hub, taken) = (&self.hub, self.clock.now());
        hub.tap().offer(|| RecordedItem::Detections(output.observations.clone(), taken));
        let steps = self.fusion.counts().clock_steps;
        self.fusion.observe(&output.observations);
        if self.fusion.counts().clock_steps > steps {
            let installation = hub.installation();
            let name = installation.camera_name(camera);
            let message = messages::clock_step(name);
            tracing::warn!(camera = name, "{message}");
            let time = output.observations.received_time;
            hub.publish_camera_event(time, EventKind::CameraClockSet, camera, message);
        }
        if let Some(camera_monitor) = &mut self.camera_monitor {
            camera_monitor.observe(&output.observations, &self.fusion);
        }
        let latency_s = taken.seconds_since(output.observations.capture_time);
        let median = self.latency_ms.entry(camera).or_default();
        median.add(latency_s * 1e3);
        let latency_ms = median.value();
        let clock = self.fusion.clock(camera);
        hub.update_camera(camera, |state| {
            state.latency_ms = latency_ms;
            state.clock = clock;
        });
    }

    /// Publishes the snapshot of `pose_time`; `fused_time` defaults to now.
    pub fn publish(&mut self, pose_time: Timestamp, fused_time: Option<Timestamp>) {
        let snapshot = self.fusion.snapshot(pose_time);
        let gives_frames = |camera| self.latency_ms.contains_key(&camera);
        self.mounted_cameras.publish(&mut self.fusion, &self.hub, pose_time, gives_frames);
        self.hub.set_fusion_counts(self.fusion.counts());
        self.hub.set_print_sizes(self.fusion.print_sizes());
        self.hub.publish_snapshot(snapshot, fused_time.unwrap_or_else(|| self.clock.now()));
        // After the snapshot, in the order in which a replay repeats it.
        if let Some(camera_monitor) = &mut self.camera_monitor {
            camera_monitor.advance(self.clock.now(), &mut self.fusion, &self.hub);
        } else {
            self.fusion.drain_held_back().for_each(drop);
        }
        self.reprojection.advance(pose_time, &self.cameras, (&mut self.fusion, &self.hub));
        let events: Vec<Event> = self.fusion.drain_events().collect();
        for wrong in self.fusion.drain_wrong_heights() {
            let message = messages::height_mismatch(&self.hub.installation(), &wrong);
            tracing::warn!("{message}");
            self.hub.publish_event(pose_time, EventKind::HeightContradicted, message);
        }
        for wrong in self.fusion.drain_wrong_print_sizes() {
            let message = messages::wrong_print_size(&self.hub.installation(), &wrong);
            tracing::warn!("{message}");
            self.hub.publish_event(pose_time, EventKind::PrintSizeContradicted, message);
        }
        for event in events {
            let newest = self.hub.snapshots().borrow().clone();
            let object = newest.snapshot.objects.iter().find(|object| object.id == event.object);
            let installation = self.hub.installation();
            let name = object.map_or("", |it| installation.object_name(it.kind, it.body));
            let code = object.and_then(|object| object.code);
            let (kind, message) = messages::object_event(&event, name, code);
            self.hub.publish_object_event(event.time, kind, Some(event.object), message);
        }
    }
}

#[cfg(test)]
mod tests;
