//! The fusion thread: the one owner of all tracks. Takes what workers saw, drives the pure machine
//! of `core::world`, and publishes snapshots at steady ticks.

use std::{
    collections::BTreeMap,
    sync::{
        Arc,
        mpsc::{Receiver, RecvTimeoutError},
    },
    time::{Duration, Instant},
};

use roundel_core::{
    id::{CameraId, KindId, ObjectId},
    time::Timestamp,
    world::{Event, EventKind, Fusion, Snapshot},
};

use crate::{
    clock::Clock,
    hub::{Happening, Hub},
    stop::Stop,
    worker::{Sighted, meter::Median},
};

/// Frames from all cameras that may wait for fusion; full: the newest is dropped and counted.
pub const QUEUE_FRAMES: usize = 256;

/// Drives fusion until the signal comes.
pub struct FusionTask {
    fusion: Fusion,
    hub: Arc<Hub>,
    clock: Clock,
    received: Receiver<Sighted>,
    latency_ms: BTreeMap<CameraId, Median>,
    kinds: BTreeMap<ObjectId, Option<KindId>>,
}

impl FusionTask {
    /// A task for a fusion machine whose cameras of known pose are set already.
    pub fn new(fusion: Fusion, hub: Arc<Hub>, clock: Clock, received: Receiver<Sighted>) -> Self {
        let (latency_ms, kinds) = (BTreeMap::new(), BTreeMap::new());
        Self { fusion, hub, clock, received, latency_ms, kinds }
    }

    /// Publishes a snapshot each `period` until the signal comes, and a last one then.
    pub fn run(mut self, period: Duration, stop: &Stop) {
        let mut tick = Instant::now() + period;
        while !stop.is_stopped() {
            self.take_until(tick, stop);
            self.publish(self.clock.at(tick));
            tick += period;
            // After a stall the missed ticks are left out instead of being caught up in a burst.
            let now = Instant::now();
            while tick <= now {
                tick += period;
            }
        }
        while let Ok(sighted) = self.received.try_recv() {
            self.observe(&sighted);
        }
        self.publish(self.clock.now());
    }

    fn take_until(&mut self, tick: Instant, stop: &Stop) {
        loop {
            let rest = tick.saturating_duration_since(Instant::now());
            if rest.is_zero() {
                return;
            }
            match self.received.recv_timeout(rest) {
                Ok(sighted) => self.observe(&sighted),
                Err(RecvTimeoutError::Timeout) => return,
                // All cameras have finished; tracks still grow old and are lost.
                Err(RecvTimeoutError::Disconnected) => {
                    stop.wait(rest);
                    return;
                }
            }
        }
    }

    fn observe(&mut self, sighted: &Sighted) {
        let camera = sighted.observations.camera;
        if let Some(placement) = sighted.placement {
            self.fusion.set_camera(camera, Some(placement));
        }
        self.fusion.observe(&sighted.observations);
        let latency_s = self.clock.now().seconds_since(sighted.observations.capture_time);
        let median = self.latency_ms.entry(camera).or_default();
        median.add(latency_s * 1e3);
        let latency_ms = median.value();
        self.hub.update_camera(camera, |state| state.latency_ms = latency_ms);
    }

    fn publish(&mut self, pose_time: Timestamp) {
        let snapshot = self.fusion.snapshot(pose_time);
        let events: Vec<Event> = self.fusion.drain_events().collect();
        self.remember_kinds(&snapshot);
        self.hub.set_fusion_counts(self.fusion.counts());
        self.hub.publish_snapshot(snapshot, self.clock.now());
        for event in events {
            let message = self.sentence(&event);
            let happening = Happening::Object(event.object, event.kind);
            self.hub.publish_event(event.time, happening, message);
        }
    }

    fn remember_kinds(&mut self, snapshot: &Snapshot) {
        self.kinds.clear();
        self.kinds.extend(snapshot.objects.iter().map(|object| (object.id, object.kind)));
    }

    fn sentence(&self, event: &Event) -> String {
        let kind = self.kinds.get(&event.object).copied().flatten();
        let name = match self.hub.installation().object_name(kind) {
            "" => format!("Object {}", event.object),
            name => format!("Object {} ({name})", event.object),
        };
        match event.kind {
            EventKind::Appeared => format!("{name} has appeared."),
            EventKind::Predicted => {
                format!("{name} is not seen by any camera; its pose is predicted.")
            }
            EventKind::Recovered => format!("{name} is seen again."),
            EventKind::Lost => format!("{name} is lost."),
        }
    }
}
