//! Hook through which the hub, fusion and workers offer data to a recording.
//!
//! Without a recording, an offer costs one atomic load. The queue is bounded and drops and counts items when it is full,
//! so a slow disk never blocks a producer. Fusion's inputs and outputs keep their order, so replays are repeatable.

use std::{
    collections::BTreeMap,
    sync::{
        Arc, Mutex, PoisonError, RwLock,
        atomic::{AtomicU32, AtomicU64, Ordering},
        mpsc::{Receiver, SyncSender, sync_channel},
    },
};

use roundel_core::{id::CameraId, time::Timestamp, world::FrameObservations};

use crate::model::{
    command::{AppliedConfig, CameraChange, CameraModel, CameraPose, CameraUpdate},
    event::Event,
    snapshot::FusedSnapshot,
};

/// Messages that may wait for the disk: seconds of the largest installations. Full: dropped and counted.
const QUEUE_ITEMS: usize = 4096;
/// Frames that may wait to be compressed; they are large. Full: dropped and counted.
const QUEUE_FRAMES: usize = 8;

#[derive(Clone, Debug)]
pub enum RecordedItem {
    Snapshot(Arc<FusedSnapshot>),
    Detections(Arc<FrameObservations>, Timestamp),
    Event(Arc<Event>),
    CameraUpdate(CameraUpdate),
    /// Fusion goes by it from now on.
    Settings(AppliedConfig),
    /// A camera's picture, compressed.
    CompressedFrame(CompressedFrame),
}

/// A frame of a camera, as it was searched.
#[derive(Clone, Debug)]
pub struct RawFrame {
    pub camera: CameraId,
    pub number: u64,
    /// Middle of the exposure.
    pub capture_time: Timestamp,
    /// When the worker had it.
    pub received_time: Timestamp,
    /// Columns and rows.
    pub size: (usize, usize),
    /// Row by row, without gaps.
    pub pixels: Vec<u8>,
}

/// The same as the bytes of an image file.
#[derive(Clone, Debug)]
pub struct CompressedFrame {
    pub camera: CameraId,
    pub number: u64,
    /// Middle of the exposure.
    pub capture_time: Timestamp,
    /// When the worker had it.
    pub received_time: Timestamp,
    /// `jpeg` or `png`.
    pub format: &'static str,
    pub data: Vec<u8>,
}

pub struct TapReceiver {
    pub items: Receiver<RecordedItem>,
    /// Frames to be compressed.
    pub frames: Receiver<RawFrame>,
    pub compressed: SyncSender<RecordedItem>,
    /// What fusion knew of cameras as the recording began.
    pub camera_updates: Vec<CameraUpdate>,
}

struct TapSender {
    items: SyncSender<RecordedItem>,
    frames: SyncSender<RawFrame>,
}

/// What fusion was told last of a camera.
#[derive(Clone, Debug, Default)]
pub(crate) struct LatestCameraUpdate {
    known: Option<CameraModel>,
    exempt: Option<bool>,
}

/// Takes what is recorded, while something is.
#[derive(Default)]
pub struct Tap {
    sender: RwLock<Option<TapSender>>,
    /// One in so many frames is wanted; 0: none.
    frames_every: AtomicU32,
    dropped: AtomicU64,
    latest: Mutex<BTreeMap<CameraId, LatestCameraUpdate>>,
}

impl Tap {
    /// Begins to take what is offered, of frames one in so many.
    pub fn open(&self, frames_every: u32) -> TapReceiver {
        let (items, item_receiver) = sync_channel(QUEUE_ITEMS);
        let (frames, frame_receiver) = sync_channel(QUEUE_FRAMES);
        self.dropped.store(0, Ordering::Relaxed);
        let compressed = items.clone();
        // What is told while this is held waits, and so comes neither twice nor never.
        let told = self.latest.lock().unwrap_or_else(PoisonError::into_inner);
        let camera_updates =
            told.iter().flat_map(|(camera, memory)| memory.updates(*camera)).collect();
        *self.sender.write().unwrap_or_else(PoisonError::into_inner) =
            Some(TapSender { items, frames });
        self.frames_every.store(frames_every, Ordering::Relaxed);
        TapReceiver { items: item_receiver, frames: frame_receiver, compressed, camera_updates }
    }

    /// Takes nothing any more; what was taken before can still be read.
    pub fn close(&self) {
        self.frames_every.store(0, Ordering::Relaxed);
        *self.sender.write().unwrap_or_else(PoisonError::into_inner) = None;
    }

    /// What was offered and found no room, since the recording began.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Offers something that is recorded if there is room.
    pub fn offer(&self, item: impl FnOnce() -> RecordedItem) {
        let sender = self.sender.read().unwrap_or_else(PoisonError::into_inner);
        if let Some(sender) = &*sender
            && sender.items.try_send(item()).is_err()
        {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Offers what fusion was told, which is remembered for recordings that begin later.
    pub fn update_camera(&self, told: CameraUpdate) {
        let mut latest = self.latest.lock().unwrap_or_else(PoisonError::into_inner);
        let memory = latest.entry(told.camera).or_default();
        match &told.change {
            // Said with each snapshot, and seldom another thing than before.
            CameraChange::HoldBackExempt(is_exempt) if memory.exempt == Some(*is_exempt) => return,
            CameraChange::Removed => {
                latest.remove(&told.camera);
            }
            change => memory.apply(change),
        }
        self.offer(|| RecordedItem::CameraUpdate(told));
    }

    /// Whether a frame of this number is recorded.
    pub fn wants_frame(&self, number: u64) -> bool {
        let every = u64::from(self.frames_every.load(Ordering::Relaxed));
        every > 0 && number.is_multiple_of(every)
    }

    /// Offers a frame that is recorded if there is room.
    pub fn offer_frame(&self, frame: RawFrame) {
        let sender = self.sender.read().unwrap_or_else(PoisonError::into_inner);
        if let Some(sender) = &*sender
            && sender.frames.try_send(frame).is_err()
        {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl LatestCameraUpdate {
    pub(crate) fn apply(&mut self, change: &CameraChange) {
        let known = self.known.get_or_insert(CameraModel { pose: None, clock: None });
        match change {
            CameraChange::Set(news) => {
                known.pose = news.pose.clone().or(known.pose.take());
                known.clock = news.clock.or(known.clock);
            }
            CameraChange::Localized(placement) => {
                known.pose =
                    Some(CameraPose::Fixed { placement: **placement, is_configured: false });
            }
            CameraChange::Quarantined => known.pose = Some(CameraPose::Unknown),
            CameraChange::HoldBackExempt(is_exempt) => self.exempt = Some(*is_exempt),
            CameraChange::Removed => {}
        }
    }

    /// All of it, as it would be told now.
    pub(crate) fn updates(&self, camera: CameraId) -> impl Iterator<Item = CameraUpdate> + use<> {
        let set = self.known.clone().map(|known| CameraChange::Set(Box::new(known)));
        let spared = self.exempt.map(CameraChange::HoldBackExempt);
        set.into_iter().chain(spared).map(move |change| CameraUpdate { camera, change })
    }
}

#[cfg(test)]
mod tests {
    use roundel_core::rigid::{Covariance6, Rigid};

    use roundel_core::world::CameraPlacement;

    use super::*;

    use crate::model::command::ClockModel;

    const NORTH: CameraId = CameraId(0);

    fn update_camera(tap: &Tap, change: CameraChange) {
        tap.update_camera(CameraUpdate { camera: NORTH, change });
    }

    #[test]
    fn a_recording_that_begins_late_knows_what_fusion_was_told_before() {
        let tap = Tap::default();
        let (place, clock) = (Some(CameraPose::Unknown), Some(ClockModel::Exact));
        update_camera(&tap, CameraChange::Set(Box::new(CameraModel { pose: place, clock })));
        let placement = CameraPlacement {
            world_from_camera: Rigid::translation(1.0, 2.0, 3.0),
            covariance: Covariance6::zeros(),
        };
        update_camera(&tap, CameraChange::Localized(Box::new(placement)));
        update_camera(&tap, CameraChange::HoldBackExempt(true));
        tap.update_camera(CameraUpdate {
            camera: CameraId(1),
            change: CameraChange::HoldBackExempt(true),
        });
        tap.update_camera(CameraUpdate { camera: CameraId(1), change: CameraChange::Removed });
        let receiver = tap.open(0);
        let known: Vec<String> =
            receiver.camera_updates.iter().map(|told| format!("{told:?}")).collect();
        assert_eq!(known.len(), 2, "{known:?}");
        assert!(known[0].contains("[1.0, 2.0, 3.0]") && known[0].contains("Exact"), "{known:?}");
        assert!(known[1].contains("HoldBackExempt(true)"), "{known:?}");
        // The same once more is no news.
        update_camera(&tap, CameraChange::HoldBackExempt(true));
        assert!(receiver.items.try_recv().is_err());
        update_camera(&tap, CameraChange::Quarantined);
        assert!(matches!(receiver.items.try_recv(), Ok(RecordedItem::CameraUpdate(_))));
    }

    #[test]
    fn what_finds_no_room_is_counted_and_holds_nobody_up() {
        let tap = Tap::default();
        tap.offer(|| unreachable!("nothing is recorded"));
        assert!(!tap.wants_frame(4));
        let receiver = tap.open(2);
        assert!(tap.wants_frame(4) && !tap.wants_frame(5));
        for _ in 0..QUEUE_ITEMS + 3 {
            tap.offer(|| RecordedItem::Snapshot(Arc::default()));
        }
        assert_eq!(tap.dropped(), 3);
        tap.close();
        tap.offer(|| unreachable!("it was ended"));
        assert_eq!(receiver.items.try_iter().count(), QUEUE_ITEMS);
    }
}
