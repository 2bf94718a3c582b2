//! Where a recording takes what it records: beside the way of the data, never in it.
//!
//! Fusion, workers and the hub offer what they have anyway; while nothing is recorded that costs a look at a flag.
//! The queue is bounded; full: what is offered is dropped and counted, so that a slow disk slows nobody but the file.
//! What fusion takes, is told and gives goes through in its order, which is what makes a recording repeatable.

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
    command::{Change, Known, Stand, Told, WrittenSettings},
    event::Event,
    snapshot::FusedSnapshot,
};

/// Messages that may wait for the disk: seconds of the largest installations. Full: dropped and counted.
const QUEUE_ITEMS: usize = 4096;
/// Frames that may wait to be compressed; they are large. Full: dropped and counted.
const QUEUE_FRAMES: usize = 8;

/// What is recorded.
#[derive(Clone, Debug)]
pub enum Item {
    /// Fusion has made it.
    Snapshot(Arc<FusedSnapshot>),
    /// Fusion has taken it, then.
    Observed(Arc<FrameObservations>, Timestamp),
    /// It has happened.
    Event(Arc<Event>),
    /// Fusion was told it.
    Told(Told),
    /// Fusion goes by it from now on.
    Settings(WrittenSettings),
    /// A camera's picture, compressed.
    Picture(Picture),
}

/// A frame of a camera, as it was searched.
#[derive(Clone, Debug)]
pub struct RawFrame {
    /// Which camera.
    pub camera: CameraId,
    /// Counts its frames.
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
pub struct Picture {
    /// Which camera.
    pub camera: CameraId,
    /// Counts its frames.
    pub number: u64,
    /// Middle of the exposure.
    pub capture_time: Timestamp,
    /// When the worker had it.
    pub received_time: Timestamp,
    /// `jpeg` or `png`.
    pub format: &'static str,
    /// The image file.
    pub data: Vec<u8>,
}

/// What a recording reads from.
pub struct Outlet {
    /// Everything but frames.
    pub items: Receiver<Item>,
    /// Frames to be compressed.
    pub frames: Receiver<RawFrame>,
    /// Takes them back as pictures.
    pub back: SyncSender<Item>,
    /// What fusion knew of cameras as the recording began.
    pub known: Vec<Told>,
}

struct Inlet {
    items: SyncSender<Item>,
    frames: SyncSender<RawFrame>,
}

/// What fusion was told last of a camera.
#[derive(Clone, Debug, Default)]
pub(crate) struct Memory {
    known: Option<Known>,
    spared: Option<bool>,
}

/// Takes what is recorded, while something is.
#[derive(Default)]
pub struct Tap {
    inlet: RwLock<Option<Inlet>>,
    /// One in so many frames is wanted; 0: none.
    frames_every: AtomicU32,
    dropped: AtomicU64,
    told: Mutex<BTreeMap<CameraId, Memory>>,
}

impl Tap {
    /// Begins to take what is offered, of frames one in so many.
    pub fn open(&self, frames_every: u32) -> Outlet {
        let (items, item_outlet) = sync_channel(QUEUE_ITEMS);
        let (frames, frame_outlet) = sync_channel(QUEUE_FRAMES);
        self.dropped.store(0, Ordering::Relaxed);
        let back = items.clone();
        // What is told while this is held waits, and so comes neither twice nor never.
        let told = self.told.lock().unwrap_or_else(PoisonError::into_inner);
        let known = told.iter().flat_map(|(camera, memory)| memory.told(*camera)).collect();
        *self.inlet.write().unwrap_or_else(PoisonError::into_inner) = Some(Inlet { items, frames });
        self.frames_every.store(frames_every, Ordering::Relaxed);
        Outlet { items: item_outlet, frames: frame_outlet, back, known }
    }

    /// Takes nothing any more; what was taken before can still be read.
    pub fn close(&self) {
        self.frames_every.store(0, Ordering::Relaxed);
        *self.inlet.write().unwrap_or_else(PoisonError::into_inner) = None;
    }

    /// What was offered and found no room, since the recording began.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Offers something that is recorded if there is room.
    pub fn offer(&self, item: impl FnOnce() -> Item) {
        let inlet = self.inlet.read().unwrap_or_else(PoisonError::into_inner);
        if let Some(inlet) = &*inlet
            && inlet.items.try_send(item()).is_err()
        {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Offers what fusion was told, which is remembered for recordings that begin later.
    pub fn tell(&self, told: Told) {
        let mut memories = self.told.lock().unwrap_or_else(PoisonError::into_inner);
        let memory = memories.entry(told.camera).or_default();
        match &told.change {
            // Said with each snapshot, and seldom another thing than before.
            Change::Spared(is_spared) if memory.spared == Some(*is_spared) => return,
            Change::Removed => {
                memories.remove(&told.camera);
            }
            change => memory.take(change),
        }
        self.offer(|| Item::Told(told));
    }

    /// Whether a frame of this number is recorded.
    pub fn wants_frame(&self, number: u64) -> bool {
        let every = u64::from(self.frames_every.load(Ordering::Relaxed));
        every > 0 && number.is_multiple_of(every)
    }

    /// Offers a frame that is recorded if there is room.
    pub fn offer_frame(&self, frame: RawFrame) {
        let inlet = self.inlet.read().unwrap_or_else(PoisonError::into_inner);
        if let Some(inlet) = &*inlet
            && inlet.frames.try_send(frame).is_err()
        {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Memory {
    /// Takes news.
    pub(crate) fn take(&mut self, change: &Change) {
        let known = self.known.get_or_insert(Known { place: None, clock: None });
        match change {
            Change::Set(news) => {
                known.place = news.place.clone().or(known.place.take());
                known.clock = news.clock.or(known.clock);
            }
            Change::Placed(placement) => {
                known.place = Some(Stand::At { placement: **placement, is_written: false });
            }
            Change::Quarantined => known.place = Some(Stand::Unknown),
            Change::Spared(is_spared) => self.spared = Some(*is_spared),
            Change::Removed => {}
        }
    }

    /// All of it, as it would be told now.
    pub(crate) fn told(&self, camera: CameraId) -> impl Iterator<Item = Told> + use<> {
        let set = self.known.clone().map(|known| Change::Set(Box::new(known)));
        let spared = self.spared.map(Change::Spared);
        set.into_iter().chain(spared).map(move |change| Told { camera, change })
    }
}

#[cfg(test)]
mod tests {
    use roundel_core::rigid::{Covariance6, Rigid};

    use roundel_core::world::CameraPlacement;

    use super::*;

    use crate::model::command::Timekeeping;

    const NORTH: CameraId = CameraId(0);

    fn tell(tap: &Tap, change: Change) {
        tap.tell(Told { camera: NORTH, change });
    }

    #[test]
    fn a_recording_that_begins_late_knows_what_fusion_was_told_before() {
        let tap = Tap::default();
        let (place, clock) = (Some(Stand::Unknown), Some(Timekeeping::Exact));
        tell(&tap, Change::Set(Box::new(Known { place, clock })));
        let placement = CameraPlacement {
            world_from_camera: Rigid::translation(1.0, 2.0, 3.0),
            covariance: Covariance6::zeros(),
        };
        tell(&tap, Change::Placed(Box::new(placement)));
        tell(&tap, Change::Spared(true));
        tap.tell(Told { camera: CameraId(1), change: Change::Spared(true) });
        tap.tell(Told { camera: CameraId(1), change: Change::Removed });
        let outlet = tap.open(0);
        let known: Vec<String> = outlet.known.iter().map(|told| format!("{told:?}")).collect();
        assert_eq!(known.len(), 2, "{known:?}");
        assert!(known[0].contains("[1.0, 2.0, 3.0]") && known[0].contains("Exact"), "{known:?}");
        assert!(known[1].contains("Spared(true)"), "{known:?}");
        // The same once more is no news.
        tell(&tap, Change::Spared(true));
        assert!(outlet.items.try_recv().is_err());
        tell(&tap, Change::Quarantined);
        assert!(matches!(outlet.items.try_recv(), Ok(Item::Told(_))));
    }

    #[test]
    fn what_finds_no_room_is_counted_and_holds_nobody_up() {
        let tap = Tap::default();
        tap.offer(|| unreachable!("nothing is recorded"));
        assert!(!tap.wants_frame(4));
        let outlet = tap.open(2);
        assert!(tap.wants_frame(4) && !tap.wants_frame(5));
        for _ in 0..QUEUE_ITEMS + 3 {
            tap.offer(|| Item::Snapshot(Arc::default()));
        }
        assert_eq!(tap.dropped(), 3);
        tap.close();
        tap.offer(|| unreachable!("it was ended"));
        assert_eq!(outlet.items.try_iter().count(), QUEUE_ITEMS);
    }
}
