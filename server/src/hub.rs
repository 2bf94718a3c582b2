//! The newest of everything, for whoever asks.
//!
//! Producers (workers, fusion) publish and never wait; consumers (the APIs) read at their own pace.
//! Full-policies: snapshots keep the newest only (`watch`), so a slow reader skips and counts by the
//! sequence; observations and events are rings of fixed size (`broadcast`) whose slow readers are
//! told how many they missed; pictures are made only when somebody has asked for one.

mod camera;

use std::{
    collections::{BTreeMap, VecDeque},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
};

use roundel_core::{
    id::{BodyId, CameraId, KindId, ObjectId},
    marker::Code,
    time::Timestamp,
    world::{self, FrameObservations, FusionCounts, LifeStage, Snapshot},
};
use tokio::sync::{broadcast, watch};

pub use camera::{
    CameraInfo, CameraPlace, CameraState, CameraStatus, DetectionCounts, PoseStatus, RideInfo,
};

/// Observations that a slow reader may lag behind before it misses some.
const OBSERVATIONS_KEPT: usize = 256;
/// Events remembered for those who ask later.
pub const EVENTS_KEPT: usize = 1000;
/// How long a lost object stays in the list of objects.
const LOST_KEPT_SECONDS: f64 = 60.0;

/// What is fixed while a server runs.
#[derive(Clone, Debug)]
pub struct Installation {
    /// The configured name.
    pub name: String,
    /// Tells this run of this server from every other.
    pub source_id: String,
    /// When it started.
    pub started: Timestamp,
    /// Snapshots a second.
    pub snapshot_rate_hz: f64,
    /// Cameras by [`CameraId`].
    pub cameras: Vec<CameraInfo>,
    /// Names of the kinds of roundel, by [`KindId`].
    pub kinds: Vec<String>,
    /// Configured names of objects that are known by a whole kind, by that.
    pub object_names: BTreeMap<KindId, String>,
    /// Configured names of all others, by [`BodyId`].
    pub body_names: Vec<String>,
}

impl Installation {
    /// The camera's name; empty for an id of another installation.
    pub fn camera_name(&self, id: CameraId) -> &str {
        self.cameras.get(id.0 as usize).map_or("", |camera| &camera.name)
    }

    /// The camera of that name.
    pub fn camera_id(&self, name: &str) -> Option<CameraId> {
        let place = self.cameras.iter().position(|camera| camera.name == name)?;
        u32::try_from(place).ok().map(CameraId)
    }

    /// The kind's name; empty for no kind.
    pub fn kind_name(&self, kind: Option<KindId>) -> &str {
        kind.and_then(|kind| self.kinds.get(usize::from(kind.0))).map_or("", String::as_str)
    }

    /// The configured name of an object, or empty.
    pub fn object_name(&self, kind: Option<KindId>, body: Option<BodyId>) -> &str {
        let name = match body {
            Some(body) => self.body_names.get(body.0 as usize),
            None => kind.and_then(|kind| self.object_names.get(&kind)),
        };
        name.map_or("", String::as_str)
    }
}

/// A snapshot with what the server adds to it.
#[derive(Clone, Debug, Default)]
pub struct FusedSnapshot {
    /// Grows by one with each snapshot; 0 before the first.
    pub sequence: u64,
    /// When fusion made it.
    pub fused_time: Timestamp,
    /// The estimates.
    pub snapshot: Snapshot,
}

/// A camera's frame with what was found in it.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Columns, pixels.
    pub width: usize,
    /// Rows, pixels.
    pub height: usize,
    /// Grey values, row by row without gaps.
    pub pixels: Vec<u8>,
    /// Found in this very frame.
    pub observations: Arc<FrameObservations>,
}

/// What an event is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Happening {
    /// A change in an object's life.
    Object(ObjectId, world::EventKind),
    /// A camera's new status.
    Camera(CameraId, CameraStatus),
    /// A camera gives another number of frames a second than was promised.
    RateOff(CameraId),
    /// It gives what was promised again.
    RateAgrees(CameraId),
    /// A camera's clock was set, or is of another epoch.
    ClockSet(CameraId),
    /// Where a camera is became known.
    Placed(CameraId),
    /// Where a camera is has not been known for a while.
    Unplaced(CameraId),
    /// A camera moved, and is left out.
    Bumped(CameraId),
    /// Where it stands now is known.
    Returned(CameraId),
    /// A camera's place was corrected a little.
    Drifted(CameraId),
    /// Cameras contradict one another, and which of them moved cannot be known.
    Contradicted,
    /// Cameras never agreed: their configured poses are not exact enough.
    Misplaced,
    /// They agree again.
    Agreed,
    /// What drives is not as high as was configured.
    WrongHeight,
    /// A calibration of the arena records.
    CalibrationBegun,
    /// There is a result.
    CalibrationDone,
    /// There is none, and why.
    CalibrationFailed,
    /// Cameras take a result over, or a kept one is left out.
    CalibrationApplied,
}

/// Something that happened once.
#[derive(Clone, Debug)]
pub struct Event {
    /// Grows by one with each event.
    pub sequence: u64,
    /// When.
    pub time: Timestamp,
    /// What.
    pub happening: Happening,
    /// One sentence for a person.
    pub message: String,
}

/// An object as the list of objects shows it.
#[derive(Clone, Debug)]
pub struct ObjectRecord {
    /// Whose.
    pub id: ObjectId,
    /// Its kind of roundel.
    pub kind: Option<KindId>,
    /// Which body, if it is one.
    pub body: Option<BodyId>,
    /// The code that it was seen with most of late.
    pub code: Option<Code>,
    /// In the newest snapshot, or Lost.
    pub stage: LifeStage,
    /// Capture time of the first detection.
    pub first_seen: Timestamp,
    /// Capture time of the newest detection.
    pub last_seen: Timestamp,
    /// Detections used.
    pub observations: u64,
}

struct CameraSlot {
    state: Mutex<CameraState>,
    picture_wanted: AtomicBool,
    picture: watch::Sender<Option<Arc<Picture>>>,
}

struct EventLog {
    next_sequence: u64,
    newest: VecDeque<Arc<Event>>,
}

/// The meeting point of producers and consumers.
pub struct Hub {
    installation: Installation,
    snapshot: watch::Sender<Arc<FusedSnapshot>>,
    observations: broadcast::Sender<Arc<FrameObservations>>,
    events: broadcast::Sender<Arc<Event>>,
    event_log: Mutex<EventLog>,
    objects: Mutex<BTreeMap<ObjectId, ObjectRecord>>,
    cameras: Vec<CameraSlot>,
    fusion_counts: Mutex<FusionCounts>,
}

impl Hub {
    /// A hub with nothing in it yet.
    pub fn new(installation: Installation) -> Self {
        let slot = |_: &CameraInfo| CameraSlot {
            state: Mutex::default(),
            picture_wanted: AtomicBool::new(false),
            picture: watch::Sender::new(None),
        };
        Self {
            cameras: installation.cameras.iter().map(slot).collect(),
            installation,
            snapshot: watch::Sender::default(),
            observations: broadcast::Sender::new(OBSERVATIONS_KEPT),
            events: broadcast::Sender::new(EVENTS_KEPT),
            event_log: Mutex::new(EventLog { next_sequence: 1, newest: VecDeque::new() }),
            objects: Mutex::default(),
            fusion_counts: Mutex::default(),
        }
    }

    /// What is fixed while the server runs.
    pub fn installation(&self) -> &Installation {
        &self.installation
    }

    /// Hands on a new snapshot; the sequence is counted here.
    pub fn publish_snapshot(&self, snapshot: Snapshot, fused_time: Timestamp) {
        self.record_objects(&snapshot);
        self.snapshot.send_modify(|newest| {
            let sequence = newest.sequence + 1;
            *newest = Arc::new(FusedSnapshot { sequence, fused_time, snapshot });
        });
    }

    /// The newest snapshot, and a wait for the next ones.
    pub fn snapshots(&self) -> watch::Receiver<Arc<FusedSnapshot>> {
        self.snapshot.subscribe()
    }

    /// Hands on what one camera saw in one frame.
    pub fn publish_observations(&self, observations: Arc<FrameObservations>) {
        // An error only says that nobody listens.
        let _ = self.observations.send(observations);
    }

    /// Observations from now on.
    pub fn observations(&self) -> broadcast::Receiver<Arc<FrameObservations>> {
        self.observations.subscribe()
    }

    /// Remembers and hands on an event.
    pub fn publish_event(&self, time: Timestamp, happening: Happening, message: String) {
        let mut log = lock(&self.event_log);
        let event = Arc::new(Event { sequence: log.next_sequence, time, happening, message });
        log.next_sequence += 1;
        if log.newest.len() == EVENTS_KEPT {
            log.newest.pop_front();
        }
        log.newest.push_back(event.clone());
        let _ = self.events.send(event);
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
        lock(&self.objects).values().cloned().collect()
    }

    /// Changes a camera's state; ids of another installation are ignored.
    pub fn update_camera(&self, id: CameraId, change: impl FnOnce(&mut CameraState)) {
        if let Some(slot) = self.cameras.get(id.0 as usize) {
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

    /// Every camera's state, by [`CameraId`].
    pub fn cameras(&self) -> Vec<CameraState> {
        self.cameras.iter().map(|slot| lock(&slot.state).clone()).collect()
    }

    /// One camera's state; `None` for an id of another installation.
    pub fn camera(&self, id: CameraId) -> Option<CameraState> {
        self.cameras.get(id.0 as usize).map(|slot| lock(&slot.state).clone())
    }

    /// Asks the worker for a picture of its next frame, and gives the newest one and a wait for the
    /// next; `None` for an id of another installation.
    pub fn request_picture(&self, id: CameraId) -> Option<watch::Receiver<Option<Arc<Picture>>>> {
        let slot = self.cameras.get(id.0 as usize)?;
        slot.picture_wanted.store(true, Ordering::Release);
        Some(slot.picture.subscribe())
    }

    /// Whether somebody waits for a picture; asking takes the request.
    pub fn take_picture_request(&self, id: CameraId) -> bool {
        self.cameras
            .get(id.0 as usize)
            .is_some_and(|slot| slot.picture_wanted.swap(false, Ordering::AcqRel))
    }

    /// Hands on a picture that was asked for.
    pub fn publish_picture(&self, id: CameraId, picture: Picture) {
        if let Some(slot) = self.cameras.get(id.0 as usize) {
            slot.picture.send_replace(Some(Arc::new(picture)));
        }
    }

    fn record_objects(&self, snapshot: &Snapshot) {
        let mut objects = lock(&self.objects);
        for record in objects.values_mut() {
            let gone = snapshot.objects.binary_search_by_key(&record.id, |o| o.id).is_err();
            if gone {
                record.stage = LifeStage::Lost;
            }
        }
        for state in &snapshot.objects {
            objects.insert(
                state.id,
                ObjectRecord {
                    id: state.id,
                    kind: state.kind,
                    body: state.body,
                    code: state.code,
                    stage: state.stage,
                    first_seen: state.first_observation,
                    last_seen: state.newest_observation,
                    observations: state.observations,
                },
            );
        }
        objects.retain(|_, record| {
            record.stage != LifeStage::Lost
                || snapshot.pose_time.seconds_since(record.last_seen) < LOST_KEPT_SECONDS
        });
    }
}

/// A panic elsewhere cannot leave these plain values half written in a way that matters: go on.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests;
