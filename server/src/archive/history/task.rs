//! The history's thread: the hub's newest snapshot, ten times a second.

use std::{
    collections::BTreeMap,
    sync::Arc,
    time::{Duration, Instant},
};

use nalgebra::Vector3;
use roundel_core::{
    id::ObjectId,
    time::Timestamp,
    world::{LifeStage, ObjectState},
};

use super::{
    HistoryError, TIERS,
    store::{HistoryObject, HistoryPoint, Store},
};
use crate::model::{hub::Hub, stop::StopSignal};

const POLL_INTERVAL: Duration = Duration::from_millis(50);
const WRITE_EVERY: Duration = Duration::from_secs(1);
const FORGET_EVERY: Duration = Duration::from_secs(60);
/// A disk that fails is tried again after this; what was to be written meanwhile is lost.
const RETRY_DELAY: Duration = Duration::from_secs(10);

/// What is known of an object that is being tracked.
struct TrackedObject {
    key: i64,
    identity: HistoryObject,
    /// The slot of its newest point, of each tier.
    slots: [Option<i64>; TIERS.len()],
}

struct Task<'a> {
    store: Store,
    hub: &'a Hub,
    tracked: BTreeMap<ObjectId, TrackedObject>,
    pending: Vec<(usize, i64, HistoryPoint)>,
}

/// Fills the store until the signal comes.
pub(super) fn run(store: Store, hub: &Arc<Hub>, keep: Duration, stop: &StopSignal) {
    let (tracked, pending) = (BTreeMap::new(), Vec::new());
    let mut task = Task { store, hub, tracked, pending };
    let begun = Instant::now();
    let (mut next_write, mut next_forget) = (begun + WRITE_EVERY, begun);
    let mut sequence = 0;
    while !stop.is_stopped() {
        let newest = hub.snapshots().borrow().clone();
        let mut done = Ok(());
        if newest.sequence != sequence {
            sequence = newest.sequence;
            let (time, objects) = (newest.snapshot.pose_time, &newest.snapshot.objects);
            done = task.take(time, objects);
        }
        let now = Instant::now();
        if done.is_ok() && now >= next_write {
            next_write = now + WRITE_EVERY;
            done = task.write();
        }
        if done.is_ok() && now >= next_forget {
            let time = newest.snapshot.pose_time;
            match task.store.forget(time, keep) {
                Ok(more) => next_forget = now + if more { WRITE_EVERY } else { FORGET_EVERY },
                Err(error) => done = Err(error),
            }
        }
        if let Err(error) = done {
            tracing::error!("{error}");
            task.pending.clear();
            stop.wait(RETRY_DELAY);
        }
        stop.wait(POLL_INTERVAL);
    }
    if let Err(error) = task.write() {
        tracing::error!("{error}");
    }
}

impl Task<'_> {
    fn take(&mut self, time: Timestamp, objects: &[ObjectState]) -> Result<(), HistoryError> {
        for state in objects.iter().filter(|state| state.stage == LifeStage::Tracked) {
            self.sample(time, state)?;
        }
        self.tracked.retain(|id, _| objects.binary_search_by_key(id, |it| it.id).is_ok());
        Ok(())
    }

    fn sample(&mut self, time: Timestamp, state: &ObjectState) -> Result<(), HistoryError> {
        let installation = self.hub.installation();
        let identity = HistoryObject {
            run: installation.source_id.clone(),
            id: state.id.0,
            name: installation.object_name(state.kind, state.body).to_owned(),
            kind: installation.kind_name(state.kind).to_owned(),
            code: state.code.map_or(0, |code| u32::from(code.number)),
        };
        let known = self.tracked.get(&state.id).filter(|it| it.identity == identity);
        if known.is_none() {
            let key = self.store.key(&identity, time)?;
            let before = self.tracked.get(&state.id).map(|it| it.slots);
            let slots = before.unwrap_or_default();
            self.tracked.insert(state.id, TrackedObject { key, identity, slots });
        }
        let Some(tracked) = self.tracked.get_mut(&state.id) else { return Ok(()) };
        let ahead = state.orientation * Vector3::x();
        let point = HistoryPoint {
            time,
            position_m: state.position_m.into(),
            yaw_rad: state.yaw_observed.then(|| ahead.y.atan2(ahead.x)),
        };
        for (tier, (grade, slot)) in TIERS.iter().zip(&mut tracked.slots).enumerate() {
            let now = time.as_ns().div_euclid(grade.step_ns);
            if slot.replace(now) != Some(now) {
                self.pending.push((tier, tracked.key, point));
            }
        }
        Ok(())
    }

    fn write(&mut self) -> Result<(), HistoryError> {
        if self.pending.is_empty() {
            return Ok(());
        }
        self.store.add(&self.pending)?;
        self.pending.clear();
        Ok(())
    }
}
