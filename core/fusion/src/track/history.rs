//! Rewind buffer: a window of measurements with filter states between them. A late measurement is inserted at its place
//! and the later ones are filtered again.
//!
//! The result depends on the measurements' times only, not on their order of arrival. A measurement is inserted at once
//! but filtered only when an estimate is requested, since the next one of another camera often belongs before it. Until
//! then [`History::newest`] lacks the pending measurements. For gating this is accurate enough while they are few
//! ([`MAX_PENDING`]) and recent ([`MAX_PENDING_NS`]) and the velocity is established ([`MIN_COUNT_TO_DEFER`]).
//!
//! Only some filter states are kept as checkpoints; others are computed again from these. One checkpoint lies as many
//! measurements back as late ones were inserted recently, the others at distances that double with age, since few
//! measurements are very late.

use std::collections::VecDeque;

use super::{Estimate, FilterState, Measurement, MotionModel};
use roundel_vision::{id::CameraId, time::Timestamp};

/// Largest spacing of checkpoints, measurements. PERF: a checkpoint costs some kilobytes of copying, a missing
/// one a few filter steps per late measurement; measure with `cargo bench -p roundel-core --bench fusion`.
const CHECKPOINT_SPACING: u64 = 8;
/// After this many measurements in order the larger spacing applies.
const IN_ORDER_COUNT: u64 = 512;
/// Largest spacing of old checkpoints, and of new ones while measurements arrive in order.
const MAX_CHECKPOINT_SPACING: u64 = 32;

/// Largest number of pending measurements. PERF: without deferral, measurements 0 to 40 ms late would cost some
/// twenty filter steps each; cameras in order with rolling shutters cost 1.3 (eight synchronized) to 1.5 (four
/// unsynchronized).
const MAX_PENDING: usize = 16;
/// A measurement later than the filtered state by more than this is filtered at once.
const MAX_PENDING_NS: i64 = 30_000_000;
/// The first measurements of an object are filtered at once.
const MIN_COUNT_TO_DEFER: u64 = 16;

/// Result of an insertion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inserted {
    /// Newest measurement.
    InOrder,
    /// Inserted before measurements that arrived earlier.
    OutOfOrder,
    /// Older than the window.
    TooLate,
    /// Already in the window.
    Duplicate,
}

/// Result of retracting a camera's measurements.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Retraction {
    /// Number of measurements that were removed, with all their effects.
    Removed(usize),
    /// No other measurement remains; nothing was removed.
    NothingLeft,
}

#[derive(Clone, Debug)]
struct Checkpoint {
    /// Measurements in the state, counted from the track's first.
    applied: u64,
    time: Timestamp,
    state: Box<FilterState>,
}

/// Measurements of one object within the window, and its newest filter state.
#[derive(Clone, Debug)]
pub struct History {
    entries: VecDeque<Measurement>,
    /// Number of the first entry, counted from the track's first.
    first: u64,
    /// Ascending; the first one contains the measurements that left the window.
    checkpoints: VecDeque<Checkpoint>,
    /// Allocations for reuse.
    free: Vec<Box<FilterState>>,
    newest: Box<FilterState>,
    /// Number of inserted measurements that are not filtered yet.
    pending: usize,
    /// Number of the oldest pending measurement.
    oldest_pending: u64,
    /// Decaying maximum of how many filtered measurements a late one preceded.
    overtaken_recently: u64,
    /// Count of measurements when that happened last.
    last_overtaken: u64,
    /// Measurements in the newest state.
    applied: u64,
}

impl History {
    /// History with one measurement.
    pub fn begin(measurement: Measurement, model: &MotionModel) -> Self {
        let newest = Box::new(FilterState::begin(&measurement, model));
        Self {
            entries: VecDeque::from([measurement]),
            first: 0,
            checkpoints: VecDeque::new(),
            free: Vec::new(),
            newest,
            pending: 0,
            oldest_pending: u64::MAX,
            overtaken_recently: 0,
            last_overtaken: 0,
            applied: 1,
        }
    }

    /// State after the newest filtered measurement, without pending ones.
    pub fn newest(&self) -> &FilterState {
        &self.newest
    }

    /// Time of the newest measurement, filtered or not.
    pub fn newest_time(&self) -> Timestamp {
        self.entries.back().map_or(self.newest.time, |entry| entry.time)
    }

    /// Measurements of the window, oldest first.
    pub fn measurements(&self) -> impl DoubleEndedIterator<Item = &Measurement> + Clone {
        self.entries.iter()
    }

    /// Estimate at `time`, as from [`History::state_at`]; cheaper, since nothing that only the filter needs is
    /// computed.
    pub fn estimate(&mut self, time: Timestamp, model: &MotionModel) -> Estimate {
        self.filter_pending(model);
        if time >= self.newest.time {
            self.newest.estimate(time, model)
        } else {
            let until = self.entries.partition_point(|entry| entry.time <= time);
            self.replay(until.max(1), model).estimate(time, model)
        }
    }

    /// Filter state at `time` from the measurements until then; before the window, the oldest state predicted
    /// back.
    pub fn state_at(&mut self, time: Timestamp, model: &MotionModel) -> FilterState {
        self.filter_pending(model);
        let mut state = if time >= self.newest.time {
            *self.newest
        } else {
            let until = self.entries.partition_point(|entry| entry.time <= time);
            self.replay(until.max(1), model)
        };
        state.predict(time, model);
        state
    }

    /// Inserts a measurement at its place.
    pub fn insert(&mut self, measurement: &Measurement, model: &MotionModel) -> Inserted {
        let key = measurement.key();
        let newer = self.entries.iter().rev().take_while(|entry| entry.key() > key).count();
        // All entries before `place` have the same key or lower ones.
        let place = self.entries.len() - newer;
        if place > 0 && self.entries[place - 1].key() == key {
            return Inserted::Duplicate;
        }
        if place == 0 && self.first > 0 {
            return Inserted::TooLate;
        }
        let number = self.first + place as u64;
        while self.last_checkpoint() > number {
            self.free.extend(self.checkpoints.pop_back().map(|checkpoint| checkpoint.state));
        }
        if newer == 0 {
            self.entries.push_back(*measurement);
        } else {
            self.entries.insert(place, *measurement);
        }
        self.pending += 1;
        self.oldest_pending = self.oldest_pending.min(number);
        let ahead_ns = self.newest_time().ns_since(self.newest.time);
        if self.pending >= MAX_PENDING
            || ahead_ns > MAX_PENDING_NS
            || self.count() <= MIN_COUNT_TO_DEFER
        {
            self.filter_pending(model);
        }
        if newer > 0 { Inserted::OutOfOrder } else { Inserted::InOrder }
    }

    /// Removes a camera's measurements from `since` on, as if they had never been there. Where that reaches
    /// beyond the window, the filter restarts from the other measurements of the window.
    pub fn retract(
        &mut self,
        camera: CameraId,
        since: Timestamp,
        model: &MotionModel,
    ) -> Retraction {
        let is_retracted = |entry: &Measurement| entry.camera == camera && entry.time >= since;
        let Some(place) = self.entries.iter().position(is_retracted) else {
            return Retraction::Removed(0);
        };
        let removed = self.entries.iter().filter(|entry| is_retracted(entry)).count();
        if removed == self.entries.len() && self.first == 0 {
            return Retraction::NothingLeft;
        }
        let number = self.first + place as u64;
        let is_before = |checkpoint: &Checkpoint| checkpoint.applied <= number;
        if self.first > 0 && !self.checkpoints.front().is_some_and(is_before) {
            return self.rebuild_without(camera, since, model);
        }
        while self.last_checkpoint() > number {
            self.free.extend(self.checkpoints.pop_back().map(|checkpoint| checkpoint.state));
        }
        self.entries.retain(|entry| !is_retracted(entry));
        (self.pending, self.oldest_pending) = (0, u64::MAX);
        // The remaining cameras may be less precise, so the learned process noise no longer applies.
        if let Some(checkpoint) = self.checkpoints.back_mut() {
            checkpoint.state.motion.reset_adaptation(model);
        }
        self.rewind(model);
        self.filter(model);
        Retraction::Removed(removed)
    }

    /// Restarts from the window's measurements without a camera's from `since` on.
    fn rebuild_without(
        &mut self,
        camera: CameraId,
        since: Timestamp,
        model: &MotionModel,
    ) -> Retraction {
        let stays = |entry: &&Measurement| entry.camera != camera || entry.time < since;
        let mut remaining = self.entries.iter().filter(stays);
        let Some(first) = remaining.next() else { return Retraction::NothingLeft };
        let mut rebuilt = Self::begin(*first, model);
        for entry in remaining {
            rebuilt.insert(entry, model);
        }
        let removed = self.entries.len() - rebuilt.entries.len();
        *self = rebuilt;
        Retraction::Removed(removed)
    }

    /// Filters pending measurements, from the last suitable checkpoint on.
    fn filter_pending(&mut self, model: &MotionModel) {
        if self.pending == 0 {
            return;
        }
        let count = self.count();
        let overtaken = count - self.oldest_pending - self.pending as u64;
        self.overtaken_recently = overtaken.max(self.overtaken_recently.saturating_sub(1));
        if self.oldest_pending < self.applied {
            self.last_overtaken = count;
            self.rewind_and_reuse(model);
        }
        (self.pending, self.oldest_pending) = (0, u64::MAX);
        self.filter(model);
    }

    /// As [`Self::rewind`], for the case that a later checkpoint will replace the last one.
    ///
    /// PERF: the state is moved instead of copied.
    fn rewind_and_reuse(&mut self, model: &MotionModel) {
        let is_replaced = self.last_checkpoint() + self.overtaken_recently < self.count()
            && self.checkpoints.len() > 1;
        if !is_replaced {
            return self.rewind(model);
        }
        let Some(checkpoint) = self.checkpoints.pop_back() else { return };
        self.free.push(std::mem::replace(&mut self.newest, checkpoint.state));
        self.applied = checkpoint.applied;
    }

    /// Filters the entries after the newest state.
    fn filter(&mut self, model: &MotionModel) {
        let count = self.count();
        while self.applied < count {
            self.newest.update(&self.entries[(self.applied - self.first) as usize], model);
            self.applied += 1;
            let is_reached =
                self.overtaken_recently > 0 && self.overtaken_recently == count - self.applied;
            let is_in_order = self.applied.saturating_sub(self.last_overtaken) >= IN_ORDER_COUNT;
            let spacing = if is_in_order { MAX_CHECKPOINT_SPACING } else { CHECKPOINT_SPACING };
            if is_reached || self.applied - self.last_checkpoint() >= spacing {
                self.add_checkpoint();
            }
        }
    }

    /// Restores the newest state from the last checkpoint.
    fn rewind(&mut self, model: &MotionModel) {
        match self.checkpoints.back() {
            Some(checkpoint) => {
                self.newest.copy_from(&checkpoint.state);
                self.applied = checkpoint.applied;
            }
            None => {
                *self.newest = FilterState::begin(&self.entries[0], model);
                self.applied = self.first + 1;
            }
        }
    }

    /// Measurements since the track began.
    fn count(&self) -> u64 {
        self.first + self.entries.len() as u64
    }

    /// Discards measurements before `time` that a checkpoint covers.
    pub fn discard_before(&mut self, time: Timestamp) {
        while self.checkpoints.len() > 1 && self.checkpoints[1].time < time {
            self.free.extend(self.checkpoints.pop_front().map(|checkpoint| checkpoint.state));
        }
        let Some(checkpoint) = self.checkpoints.front().filter(|checkpoint| checkpoint.time < time)
        else {
            return;
        };
        // One entry remains as a reference for the place of others.
        while self.first + 1 < checkpoint.applied && self.entries.len() > 1 {
            self.entries.pop_front();
            self.first += 1;
        }
    }

    /// Measurements in the last checkpoint.
    fn last_checkpoint(&self) -> u64 {
        self.checkpoints.back().map_or(0, |checkpoint| checkpoint.applied)
    }

    /// Adds the newest state as a checkpoint and drops one that its neighbours can replace.
    fn add_checkpoint(&mut self) {
        let applied = self.applied;
        let state = match self.free.pop() {
            Some(mut free) => {
                free.copy_from(&self.newest);
                free
            }
            None => self.newest.clone(),
        };
        self.checkpoints.push_back(Checkpoint { applied, time: state.time, state });
        let is_redundant = |middle: &usize| {
            let [before, after] =
                [middle - 1, middle + 1].map(|index| self.checkpoints[index].applied);
            after - before <= (applied - after).min(MAX_CHECKPOINT_SPACING)
        };
        let redundant = (1..self.checkpoints.len() - 1).rev().find(is_redundant);
        if let Some(middle) = redundant {
            self.free.extend(self.checkpoints.remove(middle).map(|checkpoint| checkpoint.state));
        }
    }

    /// State after the first `count` entries of the window (at least one).
    fn replay(&self, count: usize, model: &MotionModel) -> FilterState {
        let number = self.first + count as u64;
        let checkpoint =
            self.checkpoints.iter().rev().find(|checkpoint| checkpoint.applied <= number);
        let (mut done, mut state) = match checkpoint.or(self.checkpoints.front()) {
            Some(checkpoint) => ((checkpoint.applied - self.first) as usize, *checkpoint.state),
            None => (1, FilterState::begin(&self.entries[0], model)),
        };
        while done < count {
            state.update(&self.entries[done], model);
            done += 1;
        }
        state
    }
}

#[cfg(test)]
mod tests;
