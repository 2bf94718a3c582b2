//! The history's thread: opens the store, and adds the hub's newest snapshots to it.
//!
//! Whatever fails is reported and retried with backoff, and affects nothing else. A damaged file is set aside, and a new
//! one begun.

use std::{
    collections::BTreeMap,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, mpsc::Sender},
    time::{Duration, Instant},
};

use backon::{BackoffBuilder, ExponentialBackoff, ExponentialBuilder};
use nalgebra::Vector3;
use roundel_core::{
    id::ObjectId,
    time::Timestamp,
    world::{LifeStage, ObjectState},
};

use super::{
    Health, HistoryError, OPENING, TIERS,
    store::{HistoryObject, HistoryPoint, Store},
};
use crate::model::{
    clock::Clock,
    config::HistoryConfig,
    hub::{EventKind, Hub},
    stop::StopSignal,
};

const POLL_INTERVAL: Duration = Duration::from_millis(50);
const WRITE_EVERY: Duration = Duration::from_secs(1);
const EXPIRE_EVERY: Duration = Duration::from_secs(60);
/// A store that has worked for this long resets the backoff.
const HEALTHY_AFTER: Duration = Duration::from_secs(60);

/// Delays that double from 1 s to 60 s. Points of the time between are not stored.
fn delays() -> ExponentialBackoff {
    ExponentialBuilder::new()
        .with_min_delay(Duration::from_secs(1))
        .with_max_delay(Duration::from_secs(60))
        .without_max_times()
        .build()
}

#[derive(Default)]
struct TrackedObject {
    key: i64,
    identity: HistoryObject,
    /// For each tier, the index of the newest point's time slot.
    slots: [Option<i64>; TIERS.len()],
}

/// Adds snapshots to one store.
struct Filler<'a> {
    store: Store,
    hub: &'a Hub,
    tracked: BTreeMap<ObjectId, TrackedObject>,
    /// Points to write, with their tiers and object keys.
    pending: Vec<(usize, i64, HistoryPoint)>,
}

pub(super) struct HistoryTask {
    pub(super) config: HistoryConfig,
    pub(super) hub: Arc<Hub>,
    pub(super) clock: Clock,
    pub(super) health: Arc<Health>,
    pub(super) stop: StopSignal,
    /// Receives a message when an attempt to open the store has ended.
    pub(super) opened: Sender<()>,
}

impl HistoryTask {
    /// Runs until the stop signal.
    pub(super) fn run(self) {
        let mut backoff = delays();
        while !self.stop.is_stopped() {
            let begun = Instant::now();
            // Each attempt begins with a new store, so a panic leaves nothing behind.
            let failure = match catch_unwind(AssertUnwindSafe(|| self.fill())) {
                Ok(Ok(())) => return,
                Ok(Err(error)) => error.to_string(),
                Err(_) => "internal error, please report it with the log".to_owned(),
            };
            if begun.elapsed() >= HEALTHY_AFTER {
                backoff = delays();
            }
            let before = self.health.set_error(&failure);
            let _ = self.opened.send(());
            if before.is_empty() || before == OPENING {
                let message = format!(
                    "Past positions are not stored: {failure}. Retried until it works; nothing else is affected."
                );
                tracing::warn!("{message}");
                self.publish(EventKind::HistoryFailed, message);
            }
            self.stop.wait(backoff.next().unwrap_or_default());
        }
    }

    /// Opens the store and fills it until it fails, or until the stop signal.
    fn fill(&self) -> Result<(), HistoryError> {
        let store = match Store::open(&self.config.file) {
            Err(error) if error.is_damage() => {
                self.set_aside()?;
                Store::open(&self.config.file)
            }
            opened => opened,
        }?;
        let before = self.health.set_error("");
        if !before.is_empty() && before != OPENING {
            let message = "Past positions are stored again.".to_owned();
            tracing::info!("{message}");
            self.publish(EventKind::HistoryRestored, message);
        }
        let _ = self.opened.send(());
        let (tracked, pending) = (BTreeMap::new(), Vec::new());
        let mut filler = Filler { store, hub: &self.hub, tracked, pending };
        let filled = filler.run(&self.config, &self.stop, &self.health);
        drop(filler);
        if filled.as_ref().is_err_and(HistoryError::is_damage) {
            self.set_aside()?;
        }
        filled
    }

    fn set_aside(&self) -> Result<(), HistoryError> {
        let kept = Store::set_aside(&self.config.file, self.clock.now())?;
        self.health.take_damage();
        let message = format!(
            "The history {} is damaged. It was kept as {}, and a new one begun.",
            self.config.file.display(),
            kept.display()
        );
        tracing::warn!("{message}");
        self.publish(EventKind::HistoryReplaced, message);
        Ok(())
    }

    fn publish(&self, kind: EventKind, message: String) {
        self.hub.publish_event(self.clock.now(), kind, message);
    }
}

impl Filler<'_> {
    fn run(
        &mut self,
        config: &HistoryConfig,
        stop: &StopSignal,
        health: &Health,
    ) -> Result<(), HistoryError> {
        let begun = Instant::now();
        let (mut next_write, mut next_expiry) = (begun + WRITE_EVERY, begun);
        let mut sequence = 0;
        while !stop.is_stopped() {
            if health.take_damage() {
                return Err(HistoryError::Damaged { path: config.file.clone() });
            }
            let newest = self.hub.snapshots().borrow().clone();
            if newest.sequence != sequence {
                sequence = newest.sequence;
                let (time, objects) = (newest.snapshot.pose_time, &newest.snapshot.objects);
                self.take(time, objects).map_err(|error| self.store.failed(error))?;
            }
            let now = Instant::now();
            if now >= next_write {
                next_write = now + WRITE_EVERY;
                self.write().map_err(|error| self.store.failed(error))?;
            }
            if now >= next_expiry {
                let expired = self.store.expire(newest.snapshot.pose_time, config.keep);
                let more = expired.map_err(|error| self.store.failed(error))?;
                next_expiry = now + if more { WRITE_EVERY } else { EXPIRE_EVERY };
            }
            stop.wait(POLL_INTERVAL);
        }
        self.write().map_err(|error| self.store.failed(error))
    }

    fn take(&mut self, time: Timestamp, objects: &[ObjectState]) -> rusqlite::Result<()> {
        for state in objects.iter().filter(|state| state.stage == LifeStage::Tracked) {
            self.sample(time, state)?;
        }
        self.tracked.retain(|id, _| objects.binary_search_by_key(id, |it| it.id).is_ok());
        Ok(())
    }

    fn sample(&mut self, time: Timestamp, state: &ObjectState) -> rusqlite::Result<()> {
        let installation = self.hub.installation();
        let identity = HistoryObject {
            run: installation.source_id.clone(),
            id: state.id.0,
            name: installation.object_name(state.kind, state.body).to_owned(),
            kind: installation.kind_name(state.kind).to_owned(),
            code: state.code.map_or(0, |code| u32::from(code.number)),
        };
        let tracked = self.tracked.entry(state.id).or_default();
        if tracked.identity != identity {
            tracked.key = self.store.key(&identity, time)?;
            tracked.identity = identity;
        }
        let ahead = state.orientation * Vector3::x();
        let point = HistoryPoint {
            time,
            position_m: state.position_m.into(),
            yaw_rad: state.yaw_observed.then(|| ahead.y.atan2(ahead.x)),
        };
        for (index, (tier, slot)) in TIERS.iter().zip(&mut tracked.slots).enumerate() {
            let now = time.as_ns().div_euclid(tier.step_ns);
            if slot.replace(now) != Some(now) {
                self.pending.push((index, tracked.key, point));
            }
        }
        Ok(())
    }

    fn write(&mut self) -> rusqlite::Result<()> {
        if self.pending.is_empty() {
            return Ok(());
        }
        self.store.add(&self.pending)?;
        self.pending.clear();
        Ok(())
    }
}
