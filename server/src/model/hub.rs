//! Newest state of everything: producers publish, consumers read, neither waits.
//!
//! Snapshots are kept in a `watch` channel: a slow reader skips to the newest one and counts the missed ones by their
//! sequence. Observations and events are `broadcast` rings, which report missed items to slow readers. Pictures are made
//! only on request.

mod installation;
mod objects;

use std::{
    collections::{BTreeMap, VecDeque},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError, RwLock,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
};

use axum::body::Bytes;
use roundel_core::{
    id::{BodyId, CameraId, KindId, ObjectId},
    time::Timestamp,
    world::{FrameObservations, FusionCounts, KindPrintSize, Snapshot},
};
use tokio::sync::{OnceCell, broadcast, watch};

pub use super::{
    camera::{
        CameraInfo, CameraPoseState, CameraState, CameraStatus, DetectionCounts, MountInfo,
        PoseStatus, SenderLink,
    },
    snapshot::FusedSnapshot,
};
use crate::model::{
    redact::redact,
    tap::{RecordedItem, Tap},
};
pub use installation::{Installation, ObjectKey};
pub use objects::ObjectRecord;
use objects::RecentObjects;
pub use roundel_proto::v1::{Event, EventKind};

/// A reader that lags further behind misses observations.
const OBSERVATION_QUEUE_LEN: usize = 256;
/// Events kept for later readers.
pub const EVENT_LOG_LEN: usize = 1000;

/// A frame of a camera with its detections.
#[derive(Debug)]
pub struct Picture {
    pub width: usize,
    pub height: usize,
    /// Grey values, row by row without gaps.
    pub pixels: Vec<u8>,
    /// Detections in this frame.
    pub observations: Arc<FrameObservations>,
    /// JPEG file, encoded once on request.
    pub jpeg: OnceCell<Bytes>,
}

impl Picture {
    pub fn new(
        (width, height): (usize, usize),
        pixels: Vec<u8>,
        observations: Arc<FrameObservations>,
    ) -> Self {
        Self { width, height, pixels, observations, jpeg: OnceCell::new() }
    }
}

#[derive(Default)]
struct CameraSlot {
    state: Mutex<CameraState>,
    newest: Mutex<Option<Arc<FrameObservations>>>,
    picture_wanted: AtomicBool,
    picture: watch::Sender<Option<Arc<Picture>>>,
}

pub struct Hub {
    installation: watch::Sender<Arc<Installation>>,
    snapshot: watch::Sender<Arc<FusedSnapshot>>,
    observations: broadcast::Sender<Arc<FrameObservations>>,
    events: broadcast::Sender<Arc<Event>>,
    /// The newest events.
    event_log: Mutex<VecDeque<Arc<Event>>>,
    objects: Mutex<RecentObjects>,
    cameras: RwLock<BTreeMap<CameraId, Arc<CameraSlot>>>,
    fusion_counts: Mutex<FusionCounts>,
    print_sizes: Mutex<Vec<KindPrintSize>>,
    fusion_has_ended: AtomicBool,
    tap: Tap,
    /// Cameras added, changed and removed.
    changes: [AtomicU64; 3],
}

impl Hub {
    pub fn new(installation: Installation) -> Self {
        let slot = |id: &CameraId| (*id, Arc::default());
        Self {
            cameras: RwLock::new(installation.cameras.keys().map(slot).collect()),
            installation: watch::Sender::new(Arc::new(installation)),
            snapshot: watch::Sender::default(),
            observations: broadcast::Sender::new(OBSERVATION_QUEUE_LEN),
            events: broadcast::Sender::new(EVENT_LOG_LEN),
            event_log: Mutex::default(),
            objects: Mutex::default(),
            fusion_counts: Mutex::default(),
            print_sizes: Mutex::default(),
            fusion_has_ended: AtomicBool::new(false),
            tap: Tap::default(),
            changes: Default::default(),
        }
    }

    pub fn installation(&self) -> Arc<Installation> {
        self.installation.borrow().clone()
    }

    /// Receives each change of the installation.
    pub fn installations(&self) -> watch::Receiver<Arc<Installation>> {
        self.installation.subscribe()
    }

    /// Adds a camera, or changes it; its state stays.
    pub fn set_camera(&self, id: CameraId, info: CameraInfo) {
        // The slot must exist before readers see the camera.
        let mut cameras = self.cameras.write().unwrap_or_else(PoisonError::into_inner);
        cameras.entry(id).or_default();
        drop(cameras);
        self.installation.send_modify(|installation| {
            Arc::make_mut(installation).cameras.insert(id, Arc::new(info));
        });
    }

    /// Removes a camera and its state; waits for its pictures end.
    pub fn remove_camera(&self, id: CameraId) {
        self.installation.send_modify(|installation| {
            Arc::make_mut(installation).cameras.remove(&id);
        });
        self.cameras.write().unwrap_or_else(PoisonError::into_inner).remove(&id);
    }

    /// Sets the names of objects that are identified by their kind, and of bodies.
    pub fn set_object_names(&self, kinds: BTreeMap<KindId, String>, bodies: Vec<String>) {
        self.installation.send_modify(|installation| {
            let installation = Arc::make_mut(installation);
            installation.object_names = kinds;
            installation.body_names = bodies;
        });
    }

    /// Id under which a configured object was tracked within the last minute.
    pub fn object_by_name(&self, name: &str) -> Option<ObjectId> {
        let named = self.installation().object_key(name)?;
        let matches = |record: &ObjectRecord| match named {
            ObjectKey::Kind(kind) => record.body.is_none() && record.kind == Some(kind),
            ObjectKey::Body(body) => record.body == Some(body),
        };
        lock(&self.objects).newest(matches)
    }

    /// The body of a name, which is added if unknown.
    pub fn intern_body_name(&self, name: &str) -> BodyId {
        let place = |installation: &Installation| {
            installation.body_names.iter().position(|body| body == name)
        };
        if let Some(place) = place(&self.installation.borrow()) {
            return BodyId(place as u32);
        }
        let mut body = BodyId(0);
        self.installation.send_modify(|installation| {
            let names = &mut Arc::make_mut(installation).body_names;
            body = BodyId(names.len() as u32);
            names.push(name.to_owned());
        });
        body
    }

    fn slot(&self, id: CameraId) -> Option<Arc<CameraSlot>> {
        self.cameras.read().unwrap_or_else(PoisonError::into_inner).get(&id).cloned()
    }

    /// Numbers and publishes a snapshot.
    pub fn publish_snapshot(&self, snapshot: Snapshot, fused_time: Timestamp) {
        lock(&self.objects).take(&snapshot);
        self.snapshot.send_modify(|newest| {
            let sequence = newest.sequence + 1;
            *newest = Arc::new(FusedSnapshot { sequence, fused_time, snapshot });
            self.tap.offer(|| RecordedItem::Snapshot(newest.clone()));
        });
    }

    pub fn snapshots(&self) -> watch::Receiver<Arc<FusedSnapshot>> {
        self.snapshot.subscribe()
    }

    pub fn publish_observations(&self, observations: Arc<FrameObservations>) {
        if let Some(slot) = self.slot(observations.camera) {
            *lock(&slot.newest) = Some(observations.clone());
        }
        // Fails without receivers.
        let _ = self.observations.send(observations);
    }

    /// The newest frame of each camera.
    pub fn newest_observations(&self) -> Vec<Arc<FrameObservations>> {
        let cameras = self.cameras.read().unwrap_or_else(PoisonError::into_inner);
        cameras.values().filter_map(|slot| lock(&slot.newest).clone()).collect()
    }

    pub fn observations(&self) -> broadcast::Receiver<Arc<FrameObservations>> {
        self.observations.subscribe()
    }

    /// Publishes an event that concerns neither a camera nor an object.
    pub fn publish_event(&self, time: Timestamp, kind: EventKind, message: String) {
        self.publish(Event {
            time_ns: time.as_ns(),
            kind: kind.into(),
            message,
            ..Event::default()
        });
    }

    pub fn publish_camera_event(
        &self,
        time: Timestamp,
        kind: EventKind,
        camera: CameraId,
        message: String,
    ) {
        let camera = self.installation().camera_name(camera).to_owned();
        let (time_ns, kind) = (time.as_ns(), kind.into());
        self.publish(Event { time_ns, kind, camera, message, ..Event::default() });
    }

    /// Without an id, the object is configured but not tracked.
    pub fn publish_object_event(
        &self,
        time: Timestamp,
        kind: EventKind,
        object: Option<ObjectId>,
        message: String,
    ) {
        let object_id = object.map_or(0, |object| object.0);
        let (time_ns, kind) = (time.as_ns(), kind.into());
        self.publish(Event { time_ns, kind, object_id, message, ..Event::default() });
    }

    /// Removes secrets from an event, numbers it, keeps it in the log and sends it to subscribers and the recording.
    pub fn publish(&self, mut event: Event) {
        let counter = match event.kind() {
            EventKind::CameraAdded => Some(0),
            EventKind::CameraChanged => Some(1),
            EventKind::CameraRemoved => Some(2),
            _ => None,
        };
        if let Some(counter) = counter {
            self.changes[counter].fetch_add(1, Ordering::Relaxed);
        }
        event.message = redact(&event.message);
        let mut log = lock(&self.event_log);
        event.sequence = log.back().map_or(0, |newest| newest.sequence) + 1;
        let event = Arc::new(event);
        if log.len() == EVENT_LOG_LEN {
            log.pop_front();
        }
        log.push_back(event.clone());
        self.tap.offer(|| RecordedItem::Event(event.clone()));
        let _ = self.events.send(event);
    }

    pub fn tap(&self) -> &Tap {
        &self.tap
    }

    /// Numbers of cameras added, changed and removed since the start.
    pub fn camera_change_counts(&self) -> [u64; 3] {
        [0, 1, 2].map(|index| self.changes[index].load(Ordering::Relaxed))
    }

    /// The newest `backlog` events, oldest first, and a receiver of all later ones.
    pub fn events(&self, backlog: usize) -> (Vec<Arc<Event>>, broadcast::Receiver<Arc<Event>>) {
        let log = lock(&self.event_log);
        let skipped = log.len().saturating_sub(backlog);
        (log.iter().skip(skipped).cloned().collect(), self.events.subscribe())
    }

    /// Objects tracked within the last minute, by id.
    pub fn objects(&self) -> Vec<ObjectRecord> {
        lock(&self.objects).all()
    }

    /// Forgets all objects, when a replay jumps.
    pub fn clear_objects(&self) {
        *lock(&self.objects) = RecentObjects::default();
    }

    /// Changes the state of a camera, unless it was removed.
    pub fn update_camera(&self, id: CameraId, change: impl FnOnce(&mut CameraState)) {
        if let Some(slot) = self.slot(id) {
            change(&mut lock(&slot.state));
        }
    }

    pub fn set_fusion_counts(&self, counts: FusionCounts) {
        *lock(&self.fusion_counts) = counts;
    }

    pub fn set_print_sizes(&self, sizes: impl Iterator<Item = KindPrintSize>) {
        let mut own = lock(&self.print_sizes);
        own.clear();
        own.extend(sizes);
    }

    /// Sizes of the prints of all kinds with a tolerance.
    pub fn print_sizes(&self) -> Vec<KindPrintSize> {
        lock(&self.print_sizes).clone()
    }

    pub fn set_fusion_ended(&self) {
        self.fusion_has_ended.store(true, Ordering::Release);
    }

    /// Whether the fusion thread has ended, so that no snapshot follows.
    pub fn fusion_has_ended(&self) -> bool {
        self.fusion_has_ended.load(Ordering::Acquire)
    }

    /// Counts since the start.
    pub fn fusion_counts(&self) -> FusionCounts {
        *lock(&self.fusion_counts)
    }

    pub fn cameras(&self) -> BTreeMap<CameraId, CameraState> {
        let cameras = self.cameras.read().unwrap_or_else(PoisonError::into_inner);
        cameras.iter().map(|(id, slot)| (*id, lock(&slot.state).clone())).collect()
    }

    pub fn camera(&self, id: CameraId) -> Option<CameraState> {
        self.slot(id).map(|slot| lock(&slot.state).clone())
    }

    /// Requests a picture of the next frame; `None` for an unknown camera.
    pub fn request_picture(&self, id: CameraId) -> Option<watch::Receiver<Option<Arc<Picture>>>> {
        let slot = self.slot(id)?;
        slot.picture_wanted.store(true, Ordering::Release);
        Some(slot.picture.subscribe())
    }

    /// Whether a picture was requested since the last call.
    pub fn take_picture_request(&self, id: CameraId) -> bool {
        self.slot(id).is_some_and(|slot| slot.picture_wanted.swap(false, Ordering::AcqRel))
    }

    pub fn publish_picture(&self, id: CameraId, picture: Picture) {
        if let Some(slot) = self.slot(id) {
            slot.picture.send_replace(Some(Arc::new(picture)));
        }
    }
}

/// Plain values stay valid when a thread panics.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests;
