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
use roundel_proto::v1::Event;

use crate::model::{
    command::{AppliedConfig, CameraChange, CameraModel, CameraPose, CameraUpdate},
    snapshot::FusedSnapshot,
};

/// Capacity of the item queue: seconds of the largest installations.
const QUEUE_ITEMS: usize = 4096;
/// Capacity of the queue of frames to compress, which are large.
const QUEUE_FRAMES: usize = 8;

#[derive(Clone, Debug)]
pub enum RecordedItem {
    Snapshot(Arc<FusedSnapshot>),
    Detections(Arc<FrameObservations>, Timestamp),
    Event(Arc<Event>),
    CameraUpdate(CameraUpdate),
    /// The configuration that fusion applied.
    Settings(AppliedConfig),
    CompressedFrame(CompressedFrame),
}

/// A frame to compress.
#[derive(Clone, Debug)]
pub struct RawFrame {
    pub camera: CameraId,
    pub number: u64,
    /// Middle of the exposure.
    pub capture_time: Timestamp,
    pub received_time: Timestamp,
    /// Columns and rows.
    pub size: (usize, usize),
    /// Row by row, without gaps.
    pub pixels: Vec<u8>,
}

#[derive(Clone, Debug)]
pub struct CompressedFrame {
    pub camera: CameraId,
    pub number: u64,
    /// Middle of the exposure.
    pub capture_time: Timestamp,
    pub received_time: Timestamp,
    /// `jpeg` or `png`.
    pub format: &'static str,
    pub data: Vec<u8>,
}

pub struct TapReceiver {
    pub items: Receiver<RecordedItem>,
    pub frames: Receiver<RawFrame>,
    pub compressed: SyncSender<RecordedItem>,
    /// State of the cameras in fusion when the recording began.
    pub camera_updates: Vec<CameraUpdate>,
}

struct TapSender {
    items: SyncSender<RecordedItem>,
    frames: SyncSender<RawFrame>,
}

/// State of a camera in fusion.
#[derive(Clone, Debug, Default)]
pub(crate) struct LatestCameraUpdate {
    known: Option<CameraModel>,
    exempt: Option<bool>,
}

#[derive(Default)]
pub struct Tap {
    sender: RwLock<Option<TapSender>>,
    /// Every how many frames one is recorded; 0: none.
    frames_every: AtomicU32,
    dropped: AtomicU64,
    latest: Mutex<BTreeMap<CameraId, LatestCameraUpdate>>,
}

impl Tap {
    /// Starts a recording with every `frames_every`th frame; 0: none.
    pub fn open(&self, frames_every: u32) -> TapReceiver {
        let (items, item_receiver) = sync_channel(QUEUE_ITEMS);
        let (frames, frame_receiver) = sync_channel(QUEUE_FRAMES);
        self.dropped.store(0, Ordering::Relaxed);
        let compressed = items.clone();
        // While this is locked, updates wait: each is recorded once.
        let latest = self.latest.lock().unwrap_or_else(PoisonError::into_inner);
        let camera_updates =
            latest.iter().flat_map(|(camera, memory)| memory.updates(*camera)).collect();
        *self.sender.write().unwrap_or_else(PoisonError::into_inner) =
            Some(TapSender { items, frames });
        self.frames_every.store(frames_every, Ordering::Relaxed);
        TapReceiver { items: item_receiver, frames: frame_receiver, compressed, camera_updates }
    }

    /// Ends the recording; queued items can still be read.
    pub fn close(&self) {
        self.frames_every.store(0, Ordering::Relaxed);
        *self.sender.write().unwrap_or_else(PoisonError::into_inner) = None;
    }

    /// Items dropped since the recording began.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Offers an item, which is dropped and counted if the queue is full.
    pub fn offer(&self, item: impl FnOnce() -> RecordedItem) {
        let sender = self.sender.read().unwrap_or_else(PoisonError::into_inner);
        if let Some(sender) = &*sender
            && sender.items.try_send(item()).is_err()
        {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Offers a camera update, and keeps it for recordings that begin later.
    pub fn update_camera(&self, update: CameraUpdate) {
        let mut latest = self.latest.lock().unwrap_or_else(PoisonError::into_inner);
        let memory = latest.entry(update.camera).or_default();
        match &update.change {
            // Repeated with each snapshot, and rarely changed.
            CameraChange::HoldBackExempt(is_exempt) if memory.exempt == Some(*is_exempt) => return,
            CameraChange::Removed => {
                latest.remove(&update.camera);
            }
            change => memory.apply(change),
        }
        self.offer(|| RecordedItem::CameraUpdate(update));
    }

    /// Whether the frame with this number is recorded.
    pub fn wants_frame(&self, number: u64) -> bool {
        let every = u64::from(self.frames_every.load(Ordering::Relaxed));
        every > 0 && number.is_multiple_of(every)
    }

    /// Offers a frame, which is dropped and counted if the queue is full.
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
        let known = self.known.get_or_insert_default();
        match change {
            CameraChange::Set(news) => {
                known.pose = news.pose.clone().or(known.pose.take());
                known.clock = news.clock.or(known.clock);
                known.trust = news.trust.or(known.trust);
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

    /// Updates that restore this state.
    pub(crate) fn updates(&self, camera: CameraId) -> impl Iterator<Item = CameraUpdate> + use<> {
        let set = self.known.clone().map(|known| CameraChange::Set(Box::new(known)));
        let spared = self.exempt.map(CameraChange::HoldBackExempt);
        set.into_iter().chain(spared).map(move |change| CameraUpdate { camera, change })
    }
}

#[cfg(test)]
mod tests {
    use roundel_core::{
        rigid::{Covariance6, Rigid},
        world::CameraPlacement,
    };

    use super::*;
    use crate::model::command::ClockModel;

    const NORTH: CameraId = CameraId(0);

    fn update_camera(tap: &Tap, change: CameraChange) {
        tap.update_camera(CameraUpdate { camera: NORTH, change });
    }

    #[test]
    fn a_recording_starts_with_the_state_of_the_cameras() {
        let tap = Tap::default();
        let (pose, clock) = (Some(CameraPose::Unknown), Some(ClockModel::Exact));
        let model = CameraModel { pose, clock, trust: Some(0) };
        update_camera(&tap, CameraChange::Set(Box::new(model)));
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
            receiver.camera_updates.iter().map(|update| format!("{update:?}")).collect();
        assert_eq!(known.len(), 2, "{known:?}");
        assert!(known[0].contains("[1.0, 2.0, 3.0]") && known[0].contains("Exact"), "{known:?}");
        assert!(known[0].contains("trust: Some(0)"), "{known:?}");
        assert!(known[1].contains("HoldBackExempt(true)"), "{known:?}");
        // A repeated exemption is not recorded.
        update_camera(&tap, CameraChange::HoldBackExempt(true));
        assert!(receiver.items.try_recv().is_err());
        update_camera(&tap, CameraChange::Quarantined);
        assert!(matches!(receiver.items.try_recv(), Ok(RecordedItem::CameraUpdate(_))));
    }

    #[test]
    fn a_full_queue_drops_and_counts() {
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
        tap.offer(|| unreachable!("the recording has ended"));
        assert_eq!(receiver.items.try_iter().count(), QUEUE_ITEMS);
    }
}
