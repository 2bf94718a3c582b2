//! The newest of everything, for whoever asks.
//!
//! Producers (workers, fusion) publish and never wait; consumers (the APIs) read at their own pace.
//! Full-policies: snapshots keep the newest only (`watch`), so a slow reader skips and counts by the
//! sequence; observations and events are rings of fixed size (`broadcast`) whose slow readers are
//! told how many they missed; pictures are made only when somebody has asked for one.

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
    world::{FrameObservations, FusionCounts, Snapshot},
};
use tokio::sync::{OnceCell, broadcast, watch};

pub use super::{
    camera::{
        CameraInfo, CameraPoseState, CameraState, CameraStatus, DetectionCounts, MountInfo,
        PoseStatus, SenderLink,
    },
    event::{ConfigChange, Event, EventKind},
    snapshot::FusedSnapshot,
};
use crate::model::tap::{RecordedItem, Tap};
pub use installation::{Installation, ObjectKey};
pub use objects::ObjectRecord;
use objects::RecentObjects;

/// Observations that a slow reader may lag behind before it misses some.
const OBSERVATION_QUEUE_LEN: usize = 256;
/// Events remembered for those who ask later.
pub const EVENT_LOG_LEN: usize = 1000;

/// A camera's frame with what was found in it.
#[derive(Debug)]
pub struct Picture {
    /// Columns, pixels.
    pub width: usize,
    /// Rows, pixels.
    pub height: usize,
    /// Grey values, row by row without gaps.
    pub pixels: Vec<u8>,
    /// Found in this very frame.
    pub observations: Arc<FrameObservations>,
    /// The same as a JPEG file, made once for all who look at it.
    pub jpeg: OnceCell<Bytes>,
}

impl Picture {
    /// Of columns and rows, with what was found in it.
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

struct EventLog {
    next_sequence: u64,
    newest: VecDeque<Arc<Event>>,
}

/// The meeting point of producers and consumers.
pub struct Hub {
    installation: watch::Sender<Arc<Installation>>,
    snapshot: watch::Sender<Arc<FusedSnapshot>>,
    observations: broadcast::Sender<Arc<FrameObservations>>,
    events: broadcast::Sender<Arc<Event>>,
    event_log: Mutex<EventLog>,
    objects: Mutex<RecentObjects>,
    /// One for each camera of the installation.
    cameras: RwLock<BTreeMap<CameraId, Arc<CameraSlot>>>,
    fusion_counts: Mutex<FusionCounts>,
    /// Where a recording takes what it records.
    tap: Tap,
    changes: [AtomicU64; 3],
}

impl Hub {
    /// A hub with nothing in it yet.
    pub fn new(installation: Installation) -> Self {
        let slot = |id: &CameraId| (*id, Arc::default());
        Self {
            cameras: RwLock::new(installation.cameras.keys().map(slot).collect()),
            installation: watch::Sender::new(Arc::new(installation)),
            snapshot: watch::Sender::default(),
            observations: broadcast::Sender::new(OBSERVATION_QUEUE_LEN),
            events: broadcast::Sender::new(EVENT_LOG_LEN),
            event_log: Mutex::new(EventLog { next_sequence: 1, newest: VecDeque::new() }),
            objects: Mutex::default(),
            fusion_counts: Mutex::default(),
            tap: Tap::default(),
            changes: Default::default(),
        }
    }

    /// The installation as it is now.
    pub fn installation(&self) -> Arc<Installation> {
        self.installation.borrow().clone()
    }

    /// The same, and a wait for its changes.
    pub fn installations(&self) -> watch::Receiver<Arc<Installation>> {
        self.installation.subscribe()
    }

    /// Adds a camera, or says of one that is there what it is from now on; its state stays.
    pub fn set_camera(&self, id: CameraId, info: CameraInfo) {
        // Its slot is there before anybody learns of it.
        let mut cameras = self.cameras.write().unwrap_or_else(PoisonError::into_inner);
        cameras.entry(id).or_default();
        drop(cameras);
        self.installation.send_modify(|installation| {
            Arc::make_mut(installation).cameras.insert(id, Arc::new(info));
        });
    }

    /// Takes a camera out, with all that is held of it; whoever waits for its pictures waits no more.
    pub fn remove_camera(&self, id: CameraId) {
        self.installation.send_modify(|installation| {
            Arc::make_mut(installation).cameras.remove(&id);
        });
        self.cameras.write().unwrap_or_else(PoisonError::into_inner).remove(&id);
    }

    /// Says how objects are named from now on: those that are known by a whole kind, and all others by body.
    pub fn set_object_names(&self, kinds: BTreeMap<KindId, String>, bodies: Vec<String>) {
        self.installation.send_modify(|installation| {
            let installation = Arc::make_mut(installation);
            installation.object_names = kinds;
            installation.body_names = bodies;
        });
    }

    /// As which an object of the configuration is followed, or was last, within the last minute.
    pub fn object_by_name(&self, name: &str) -> Option<ObjectId> {
        let named = self.installation().object_key(name)?;
        let matches = |record: &ObjectRecord| match named {
            ObjectKey::Kind(kind) => record.body.is_none() && record.kind == Some(kind),
            ObjectKey::Body(body) => record.body == Some(body),
        };
        lock(&self.objects).newest(matches)
    }

    /// The body of a name; one that is not known yet is from now on.
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

    /// Hands on a new snapshot; the sequence is counted here.
    pub fn publish_snapshot(&self, snapshot: Snapshot, fused_time: Timestamp) {
        lock(&self.objects).take(&snapshot);
        self.snapshot.send_modify(|newest| {
            let sequence = newest.sequence + 1;
            *newest = Arc::new(FusedSnapshot { sequence, fused_time, snapshot });
            self.tap.offer(|| RecordedItem::Snapshot(newest.clone()));
        });
    }

    /// The newest snapshot, and a wait for the next ones.
    pub fn snapshots(&self) -> watch::Receiver<Arc<FusedSnapshot>> {
        self.snapshot.subscribe()
    }

    /// Hands on what one camera saw in one frame.
    pub fn publish_observations(&self, observations: Arc<FrameObservations>) {
        if let Some(slot) = self.slot(observations.camera) {
            *lock(&slot.newest) = Some(observations.clone());
        }
        // An error only says that nobody listens.
        let _ = self.observations.send(observations);
    }

    /// The newest frame of each camera that gave one, by camera.
    pub fn newest_observations(&self) -> Vec<Arc<FrameObservations>> {
        let cameras = self.cameras.read().unwrap_or_else(PoisonError::into_inner);
        cameras.values().filter_map(|slot| lock(&slot.newest).clone()).collect()
    }

    pub fn observations(&self) -> broadcast::Receiver<Arc<FrameObservations>> {
        self.observations.subscribe()
    }

    /// Remembers and hands on an event.
    pub fn publish_event(&self, time: Timestamp, kind: EventKind, message: String) {
        match kind {
            EventKind::CameraAdded(_) => self.changes[0].fetch_add(1, Ordering::Relaxed),
            EventKind::CameraChanged(_) => self.changes[1].fetch_add(1, Ordering::Relaxed),
            EventKind::CameraRemoved(_) => self.changes[2].fetch_add(1, Ordering::Relaxed),
            _ => 0,
        };
        let installation = self.installation();
        let camera = kind.camera().map(|id| installation.camera_name(id).to_owned());
        let camera = camera.unwrap_or_default();
        let mut log = lock(&self.event_log);
        let event = Arc::new(Event { sequence: log.next_sequence, time, kind, camera, message });
        log.next_sequence += 1;
        if log.newest.len() == EVENT_LOG_LEN {
            log.newest.pop_front();
        }
        log.newest.push_back(event.clone());
        self.tap.offer(|| RecordedItem::Event(event.clone()));
        let _ = self.events.send(event);
    }

    /// Where a recording takes what it records.
    pub fn tap(&self) -> &Tap {
        &self.tap
    }

    /// How many cameras were added, changed and removed since the start.
    pub fn camera_change_counts(&self) -> [u64; 3] {
        [0, 1, 2].map(|index| self.changes[index].load(Ordering::Relaxed))
    }

    /// The newest remembered events, oldest first, at most `backlog`, and those from now on; none
    /// between the two is missing or given twice.
    pub fn events(&self, backlog: usize) -> (Vec<Arc<Event>>, broadcast::Receiver<Arc<Event>>) {
        let log = lock(&self.event_log);
        let skipped = log.newest.len().saturating_sub(backlog);
        (log.newest.iter().skip(skipped).cloned().collect(), self.events.subscribe())
    }

    /// Every object of now and of the last minute, by id.
    pub fn objects(&self) -> Vec<ObjectRecord> {
        lock(&self.objects).all()
    }

    /// Forgets all objects, as where time goes on elsewhere.
    pub fn clear_objects(&self) {
        *lock(&self.objects) = RecentObjects::default();
    }

    /// Changes a camera's state; of one that was removed nothing is kept.
    pub fn update_camera(&self, id: CameraId, change: impl FnOnce(&mut CameraState)) {
        if let Some(slot) = self.slot(id) {
            change(&mut lock(&slot.state));
        }
    }

    /// What became of all that was observed, as of now.
    pub fn set_fusion_counts(&self, counts: FusionCounts) {
        *lock(&self.fusion_counts) = counts;
    }

    /// What became of all that was observed, since the start.
    pub fn fusion_counts(&self) -> FusionCounts {
        *lock(&self.fusion_counts)
    }

    pub fn cameras(&self) -> BTreeMap<CameraId, CameraState> {
        let cameras = self.cameras.read().unwrap_or_else(PoisonError::into_inner);
        cameras.iter().map(|(id, slot)| (*id, lock(&slot.state).clone())).collect()
    }

    /// One camera's state; `None` if there is no such camera.
    pub fn camera(&self, id: CameraId) -> Option<CameraState> {
        self.slot(id).map(|slot| lock(&slot.state).clone())
    }

    /// Asks the worker for a picture of its next frame, and gives the newest one and a wait for the
    /// next; `None` if there is no such camera.
    pub fn request_picture(&self, id: CameraId) -> Option<watch::Receiver<Option<Arc<Picture>>>> {
        let slot = self.slot(id)?;
        slot.picture_wanted.store(true, Ordering::Release);
        Some(slot.picture.subscribe())
    }

    /// Whether somebody waits for a picture; asking takes the request.
    pub fn take_picture_request(&self, id: CameraId) -> bool {
        self.slot(id).is_some_and(|slot| slot.picture_wanted.swap(false, Ordering::AcqRel))
    }

    /// Hands on a picture that was asked for.
    pub fn publish_picture(&self, id: CameraId, picture: Picture) {
        if let Some(slot) = self.slot(id) {
            slot.picture.send_replace(Some(Arc::new(picture)));
        }
    }
}

/// A panic elsewhere cannot leave these plain values half written in a way that matters: go on.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests;
