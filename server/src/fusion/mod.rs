//! The fusion thread: the one owner of all tracks. Takes what workers saw, drives the pure machine
//! of `core::world`, and publishes snapshots at steady ticks, or sooner where there is news.

pub mod calibration;
mod order;
mod reprojection;
mod rhythm;
mod riding;
pub mod roster;
#[cfg(test)]
mod sample;
mod sentence;
pub mod setup;
mod watching;
mod watchman;

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
    capture::worker::{Sighted, meter::Median},
    model::{
        clock::Clock,
        command::{Change, Order, Told},
        hub::{Happening, Hub},
        stop::Stop,
        tap::Item,
    },
};
use reprojection::Reprojection;
pub use rhythm::Rhythm;
use riding::Riding;
use sentence::Subject;
use watching::Watching;
pub use watching::WatchingParts;

/// Frames from all cameras that may wait for fusion; full: the newest is dropped and counted.
pub const QUEUE_FRAMES: usize = 256;

/// Drives fusion until the signal comes.
pub struct FusionTask {
    fusion: Fusion,
    hub: Arc<Hub>,
    clock: Clock,
    received: Receiver<Sighted>,
    orders: Receiver<Order>,
    /// Those of which frames are used.
    cameras: BTreeSet<CameraId>,
    latency_ms: BTreeMap<CameraId, Median>,
    /// What the newest snapshot says of each object, for messages about it.
    known: BTreeMap<ObjectId, Subject>,
    riding: Riding,
    reprojection: Reprojection,
    watching: Option<Watching>,
}

impl FusionTask {
    /// A task with a fusion machine that knows objects and landmarks. What it is to know of the installation's cameras
    /// comes by [`FusionTask::taking_orders`], unless it was told already.
    pub fn new(fusion: Fusion, hub: Arc<Hub>, clock: Clock, received: Receiver<Sighted>) -> Self {
        let cameras = hub.installation().cameras.keys().copied().collect();
        Self {
            fusion,
            hub,
            clock,
            received,
            // Nobody sends any.
            orders: channel().1,
            cameras,
            latency_ms: BTreeMap::new(),
            known: BTreeMap::new(),
            riding: Riding::default(),
            reprojection: Reprojection::default(),
            watching: None,
        }
    }

    /// The same, which notices cameras that no longer stand where they did.
    pub fn watching(self, parts: WatchingParts) -> Self {
        Self { watching: Some(Watching::new(parts)), ..self }
    }

    /// The same, which hears of cameras that come, change and go.
    pub fn taking_orders(self) -> (Self, Sender<Order>) {
        let (sender, orders) = channel();
        (Self { orders, ..self }, sender)
    }

    /// Publishes snapshots in this rhythm until the signal comes, and a last one then.
    pub fn run(mut self, mut rhythm: Rhythm, stop: &Stop) {
        while !stop.is_stopped() {
            self.take(&rhythm, stop);
            let begun = Instant::now();
            self.publish(self.clock.at(rhythm.pose_time(begun)), None);
            rhythm.publish(begun, Instant::now());
        }
        while let Ok(sighted) = self.received.try_recv() {
            self.observe(&sighted);
        }
        self.obey();
        self.publish(self.clock.now(), None);
    }

    /// Takes frames until a snapshot is due; what waits already belongs to that as well.
    fn take(&mut self, rhythm: &Rhythm, stop: &Stop) {
        let mut has_news = false;
        loop {
            self.obey();
            let now = Instant::now();
            if now >= rhythm.tick() {
                return;
            }
            let rest = rhythm.due(has_news).saturating_duration_since(now);
            match self.received.recv_timeout(rest) {
                Ok(sighted) => {
                    self.observe(&sighted);
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
    pub fn observe(&mut self, sighted: &Sighted) {
        let camera = sighted.observations.camera;
        // What it was told of came before the frame that was taken with it.
        self.obey();
        if !self.cameras.contains(&camera) {
            return;
        }
        if let Some(placement) = sighted.placement {
            self.be_told(Told { camera, change: Change::Placed(Box::new(placement)) });
        }
        let (hub, taken) = (&self.hub, self.clock.now());
        hub.tap().offer(|| Item::Observed(sighted.observations.clone(), taken));
        let steps = self.fusion.counts().clock_steps;
        self.fusion.observe(&sighted.observations);
        if self.fusion.counts().clock_steps > steps {
            self.tell_clock_set(camera, sighted.observations.received_time);
        }
        if let Some(watching) = &mut self.watching {
            watching.observe(&sighted.observations, &self.fusion);
        }
        let latency_s = taken.seconds_since(sighted.observations.capture_time);
        let median = self.latency_ms.entry(camera).or_default();
        median.add(latency_s * 1e3);
        let latency_ms = median.value();
        let clock = self.fusion.clock(camera);
        self.hub.update_camera(camera, |state| {
            state.latency_ms = latency_ms;
            state.clock = clock;
        });
    }

    fn tell_clock_set(&self, camera: CameraId, time: Timestamp) {
        let installation = self.hub.installation();
        let name = installation.camera_name(camera);
        let message = sentence::of_clock(name);
        tracing::warn!(camera = name, "{message}");
        self.hub.publish_event(time, Happening::ClockSet(camera), message);
    }

    /// Publishes a snapshot of an instant, fused then, or now.
    pub fn publish(&mut self, pose_time: Timestamp, fused_time: Option<Timestamp>) {
        let snapshot = self.fusion.snapshot(pose_time);
        let gives_frames = |camera| self.latency_ms.contains_key(&camera);
        self.riding.publish(&mut self.fusion, &self.hub, pose_time, gives_frames);
        self.hub.set_fusion_counts(self.fusion.counts());
        self.remember(&snapshot);
        self.hub.publish_snapshot(snapshot, fused_time.unwrap_or_else(|| self.clock.now()));
        // After the snapshot, as whoever fuses a recording anew does it.
        if let Some(watching) = &mut self.watching {
            watching.advance(self.clock.now(), &mut self.fusion, &self.hub);
        } else {
            // Nobody judges who is held back.
            self.fusion.drain_held_back().for_each(drop);
        }
        self.reprojection.advance(pose_time, &self.cameras, (&mut self.fusion, &self.hub));
        let events: Vec<Event> = self.fusion.drain_events().collect();
        for wrong in self.fusion.drain_wrong_heights() {
            let message = sentence::of_height(&self.hub.installation(), &wrong);
            tracing::warn!("{message}");
            self.hub.publish_event(pose_time, Happening::WrongHeight, message);
        }
        for event in events {
            let subject = self.known.get(&event.object).copied().unwrap_or_default();
            let message = sentence::of_object(&self.hub.installation(), &event, subject);
            let happening = Happening::Object(event.object, event.kind);
            self.hub.publish_event(event.time, happening, message);
        }
    }

    fn remember(&mut self, snapshot: &Snapshot) {
        self.known.clear();
        let each = snapshot.objects.iter();
        self.known.extend(each.map(|object| (object.id, (object.kind, object.body, object.code))));
    }
}

#[cfg(test)]
mod tests;
