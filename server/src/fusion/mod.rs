//! The fusion thread: the one owner of all tracks. Takes what workers saw, drives the pure machine
//! of `core::world`, and publishes snapshots at steady ticks, or sooner where there is news.

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
    id::{CameraId, ObjectId},
    time::Timestamp,
    world::{Event, Fusion, Snapshot},
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
use camera_monitor::CameraMonitor;
pub use camera_monitor::CameraMonitorParts;
use messages::ObjectIdentity;
use mounted_cameras::MountedCameras;
use reprojection::ReprojectionMonitor;
pub use schedule::PublishSchedule;

/// Frames from all cameras that may wait for fusion; full: the newest is dropped and counted.
pub const QUEUE_FRAMES: usize = 256;

/// Drives fusion until the signal comes.
pub struct FusionTask {
    fusion: Fusion,
    hub: Arc<Hub>,
    clock: Clock,
    worker_outputs: Receiver<WorkerOutput>,
    commands: Receiver<FusionCommand>,
    /// Those of which frames are used.
    cameras: BTreeSet<CameraId>,
    latency_ms: BTreeMap<CameraId, RunningMedian>,
    /// What the newest snapshot says of each object, for messages about it.
    identities: BTreeMap<ObjectId, ObjectIdentity>,
    mounted_cameras: MountedCameras,
    reprojection: ReprojectionMonitor,
    camera_monitor: Option<CameraMonitor>,
}

impl FusionTask {
    /// A task with a fusion machine that knows objects and landmarks. What it is to know of the installation's cameras
    /// comes by [`FusionTask::with_commands`], unless it was told already.
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
            // Nobody sends any.
            commands: channel().1,
            cameras,
            latency_ms: BTreeMap::new(),
            identities: BTreeMap::new(),
            mounted_cameras: MountedCameras::default(),
            reprojection: ReprojectionMonitor::default(),
            camera_monitor: None,
        }
    }

    /// The same, which notices cameras that no longer stand where they did.
    pub fn with_camera_monitor(self, parts: CameraMonitorParts) -> Self {
        Self { camera_monitor: Some(CameraMonitor::new(parts)), ..self }
    }

    /// The same, which hears of cameras that come, change and go.
    pub fn with_commands(self) -> (Self, Sender<FusionCommand>) {
        let (sender, commands) = channel();
        (Self { commands, ..self }, sender)
    }

    /// Publishes snapshots in this schedule until the signal comes, and a last one then.
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

    /// Takes frames until a snapshot is due; what waits already belongs to that as well.
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
                // All cameras have finished; tracks still grow old and are lost.
                Err(RecvTimeoutError::Disconnected) => {
                    stop.wait(rest);
                    return;
                }
            }
        }
    }

    /// Takes in what was seen in a frame.
    pub fn observe(&mut self, output: &WorkerOutput) {
        let camera = output.observations.camera;
        // What it was told of came before the frame that was taken with it.
        self.process_commands();
        if !self.cameras.contains(&camera) {
            return;
        }
        if let Some(placement) = output.placement {
            self.apply_camera_update(CameraUpdate {
                camera,
                change: CameraChange::Localized(Box::new(placement)),
            });
        }
        let (hub, taken) = (&self.hub, self.clock.now());
        hub.tap().offer(|| RecordedItem::Detections(output.observations.clone(), taken));
        let steps = self.fusion.counts().clock_steps;
        self.fusion.observe(&output.observations);
        if self.fusion.counts().clock_steps > steps {
            self.report_clock_step(camera, output.observations.received_time);
        }
        if let Some(camera_monitor) = &mut self.camera_monitor {
            camera_monitor.observe(&output.observations, &self.fusion);
        }
        let latency_s = taken.seconds_since(output.observations.capture_time);
        let median = self.latency_ms.entry(camera).or_default();
        median.add(latency_s * 1e3);
        let latency_ms = median.value();
        let clock = self.fusion.clock(camera);
        self.hub.update_camera(camera, |state| {
            state.latency_ms = latency_ms;
            state.clock = clock;
        });
    }

    fn report_clock_step(&self, camera: CameraId, time: Timestamp) {
        let installation = self.hub.installation();
        let name = installation.camera_name(camera);
        let message = messages::clock_step(name);
        tracing::warn!(camera = name, "{message}");
        self.hub.publish_event(time, EventKind::CameraClockSet(camera), message);
    }

    /// Publishes a snapshot of an instant, fused then, or now.
    pub fn publish(&mut self, pose_time: Timestamp, fused_time: Option<Timestamp>) {
        let snapshot = self.fusion.snapshot(pose_time);
        let gives_frames = |camera| self.latency_ms.contains_key(&camera);
        self.mounted_cameras.publish(&mut self.fusion, &self.hub, pose_time, gives_frames);
        self.hub.set_fusion_counts(self.fusion.counts());
        self.update_identities(&snapshot);
        self.hub.publish_snapshot(snapshot, fused_time.unwrap_or_else(|| self.clock.now()));
        // After the snapshot, as whoever fuses a recording anew does it.
        if let Some(camera_monitor) = &mut self.camera_monitor {
            camera_monitor.advance(self.clock.now(), &mut self.fusion, &self.hub);
        } else {
            // Nobody judges who is held back.
            self.fusion.drain_held_back().for_each(drop);
        }
        self.reprojection.advance(pose_time, &self.cameras, (&mut self.fusion, &self.hub));
        let events: Vec<Event> = self.fusion.drain_events().collect();
        for wrong in self.fusion.drain_wrong_heights() {
            let message = messages::height_mismatch(&self.hub.installation(), &wrong);
            tracing::warn!("{message}");
            self.hub.publish_event(pose_time, EventKind::HeightContradicted, message);
        }
        for event in events {
            let subject = self.identities.get(&event.object).copied().unwrap_or_default();
            let message = messages::object_event(&self.hub.installation(), &event, subject);
            let kind = EventKind::ObjectStageChanged(event.object, event.kind);
            self.hub.publish_event(event.time, kind, message);
        }
    }

    fn update_identities(&mut self, snapshot: &Snapshot) {
        self.identities.clear();
        let each = snapshot.objects.iter();
        self.identities
            .extend(each.map(|object| (object.id, (object.kind, object.body, object.code))));
    }
}

#[cfg(test)]
mod tests;
