//! The rewind buffer: a window of measurements and the estimates between them, so that a late
//! measurement is put where it belongs and what came after it is filtered again.
//!
//! The result depends on the measurements' times alone, not on the order in which they came. Full
//! estimates are kept only every few measurements; the rest is computed again when needed: a late
//! measurement is put in its place at once, but the filtering waits until the estimate is asked for
//! or [`PENDING_MOST`] of them have gathered. Until then [`History::newest`] lacks them, which is
//! good enough for gating.

use std::collections::VecDeque;

use super::{Estimate, Look, Measurement, MotionModel};
use crate::time::Timestamp;

/// Measurements from one kept estimate to the next. PERF: each kept estimate costs about 4 kB of
/// copying, each one not kept a few filter steps when something is late; measure with
/// `cargo bench -p roundel-core --bench fusion`.
const CHECKPOINT_EVERY: u64 = 8;

/// Late measurements that may wait for the filter. PERF: with measurements 0 to 40 ms late, each
/// would otherwise cost some twenty filter steps.
const PENDING_MOST: usize = 16;

/// What became of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inserted {
    /// It is the newest.
    InOrder,
    /// It went in before measurements that had come earlier.
    OutOfOrder,
    /// It is older than all that is remembered.
    TooLate,
    /// It was there already.
    Duplicate,
}

#[derive(Clone, Debug)]
struct Checkpoint {
    /// Measurements in the estimate, counted from the track's first.
    applied: u64,
    estimate: Estimate,
}

/// One object's measurements of the window and its newest estimate.
#[derive(Clone, Debug)]
pub struct History {
    entries: VecDeque<Measurement>,
    /// Number of the first entry, counted from the track's first.
    first: u64,
    /// Ascending; the first one covers what has left the window.
    checkpoints: VecDeque<Checkpoint>,
    newest: Estimate,
    /// Measurements put in their place and not filtered yet.
    pending: usize,
}

impl History {
    /// Starts with one measurement.
    pub fn begin(measurement: Measurement, model: &MotionModel) -> Self {
        let newest = Estimate::begin(&measurement, model);
        Self {
            entries: VecDeque::from([measurement]),
            first: 0,
            checkpoints: VecDeque::new(),
            newest,
            pending: 0,
        }
    }

    /// The estimate after the newest measurement; late ones that wait are not in it.
    pub fn newest(&self) -> &Estimate {
        &self.newest
    }

    /// The measurements of the window, oldest first.
    pub fn measurements(&self) -> impl Iterator<Item = &Measurement> {
        self.entries.iter()
    }

    /// What is told of `time`, as [`History::at`] has it; nothing of what only the filter needs is computed.
    pub fn look(&mut self, time: Timestamp, model: &MotionModel) -> Look {
        self.settle(model);
        if time >= self.newest.time {
            self.newest.look(time, model)
        } else {
            let until = self.entries.partition_point(|entry| entry.time <= time);
            self.replayed(until.max(1), model).look(time, model)
        }
    }

    /// The estimate at `time` from what was measured until then; before the window, the oldest
    /// estimate there is, predicted back.
    pub fn at(&mut self, time: Timestamp, model: &MotionModel) -> Estimate {
        self.settle(model);
        let mut estimate = if time >= self.newest.time {
            self.newest
        } else {
            let until = self.entries.partition_point(|entry| entry.time <= time);
            self.replayed(until.max(1), model)
        };
        estimate.predict(time, model);
        estimate
    }

    /// Puts a measurement in its place.
    pub fn insert(&mut self, measurement: Measurement, model: &MotionModel) -> Inserted {
        let key = measurement.key();
        let newer = self.entries.iter().rev().take_while(|entry| entry.key() > key).count();
        // All before `place` have the same key or lower ones.
        let place = self.entries.len() - newer;
        if place > 0 && self.entries[place - 1].key() == key {
            return Inserted::Duplicate;
        }
        if newer == 0 {
            self.newest.update(&measurement, model);
            self.entries.push_back(measurement);
            if self.pending == 0 {
                self.keep_checkpoint();
            }
            return Inserted::InOrder;
        }
        if place == 0 && self.first > 0 {
            return Inserted::TooLate;
        }
        let number = self.first + place as u64;
        while self.checkpoints.back().is_some_and(|kept| kept.applied > number) {
            self.checkpoints.pop_back();
        }
        self.entries.insert(place, measurement);
        self.pending += 1;
        if self.pending >= PENDING_MOST {
            self.settle(model);
        }
        Inserted::OutOfOrder
    }

    /// Filters what waits.
    fn settle(&mut self, model: &MotionModel) {
        if self.pending > 0 {
            self.pending = 0;
            self.replay(model);
        }
    }

    /// Lets go of measurements from before `time`, as far as a kept estimate covers them.
    pub fn forget(&mut self, time: Timestamp) {
        while self.checkpoints.len() > 1 && self.checkpoints[1].estimate.time < time {
            self.checkpoints.pop_front();
        }
        let Some(kept) = self.checkpoints.front().filter(|kept| kept.estimate.time < time) else {
            return;
        };
        // One entry stays, so that there is something to place others before or after.
        while self.first + 1 < kept.applied && self.entries.len() > 1 {
            self.entries.pop_front();
            self.first += 1;
        }
    }

    fn keep_checkpoint(&mut self) {
        let applied = self.first + self.entries.len() as u64;
        if applied.is_multiple_of(CHECKPOINT_EVERY) {
            self.checkpoints.push_back(Checkpoint { applied, estimate: self.newest });
        }
    }

    /// Filters everything after the last checkpoint again, keeping new ones on the way.
    fn replay(&mut self, model: &MotionModel) {
        let (mut done, mut estimate) = match self.checkpoints.back() {
            Some(kept) => ((kept.applied - self.first) as usize, kept.estimate),
            None => (1, Estimate::begin(&self.entries[0], model)),
        };
        while done < self.entries.len() {
            estimate.update(&self.entries[done], model);
            done += 1;
            let applied = self.first + done as u64;
            if applied.is_multiple_of(CHECKPOINT_EVERY) {
                self.checkpoints.push_back(Checkpoint { applied, estimate });
            }
        }
        self.newest = estimate;
    }

    /// The estimate after the first `count` entries (at least one).
    fn replayed(&self, count: usize, model: &MotionModel) -> Estimate {
        let number = self.first + count as u64;
        let kept = self.checkpoints.iter().rev().find(|kept| kept.applied <= number);
        let (mut done, mut estimate) = match kept.or(self.checkpoints.front()) {
            Some(kept) => ((kept.applied - self.first) as usize, kept.estimate),
            None => (1, Estimate::begin(&self.entries[0], model)),
        };
        while done < count {
            estimate.update(&self.entries[done], model);
            done += 1;
        }
        estimate
    }
}
