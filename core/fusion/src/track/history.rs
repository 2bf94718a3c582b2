//! The rewind buffer: a window of measurements and the estimates between them, so that a late
//! measurement is put where it belongs and what came after it is filtered again.
//!
//! The result depends on the measurements' times alone, not on the order in which they came. A
//! measurement is put in its place at once, but the filtering waits until the estimate is asked for: the next
//! measurement, of another camera, often belongs before this one. Until then [`History::newest`] lacks those
//! that wait, which is good enough for gating as long as they are few ([`WAITING_MOST`]) and recent
//! ([`WAITING_NS`]), and the velocity is known ([`WAITING_FROM`]).
//!
//! Full estimates are kept only here and there, the rest is computed again when needed: one before as many
//! measurements as late ones were put before of late, and others at distances that double with their age, since few
//! measurements are very late.

use std::collections::VecDeque;

use super::{Estimate, Look, Measurement, MotionModel};
use roundel_vision::{id::CameraId, time::Timestamp};

/// Measurements from one kept estimate to the next at most. PERF: each kept estimate costs some kilobytes of copying,
/// each one not kept a few filter steps when something is late; measure with `cargo bench -p roundel-core --bench
/// fusion`.
const CHECKPOINT_EVERY: u64 = 8;
/// The same where so many measurements in a row were filtered in their order …
const IN_ORDER: u64 = 512;
/// … and as old ones are let go.
const CHECKPOINT_EVERY_AT_MOST: u64 = 32;

/// Measurements that may wait for the filter. PERF: with measurements 0 to 40 ms late, each
/// would otherwise cost some twenty filter steps; of cameras in order whose rolling shutters see an object at
/// different times, 1.3 (eight synchronized ones) to 1.5 (four that are not).
const WAITING_MOST: usize = 16;
/// And for so long: what is later than the newest estimate by more does not wait.
const WAITING_NS: i64 = 30_000_000;
/// An object's first so many measurements do not wait.
const WAITING_FROM: u64 = 16;

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

/// What became of a camera's measurements that were to be taken back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TakenBack {
    /// So many, and all that they had done is undone.
    All(usize),
    /// There is nothing without them; they are still there.
    NothingElse,
}

#[derive(Clone, Debug)]
struct Checkpoint {
    /// Measurements in the estimate, counted from the track's first.
    applied: u64,
    /// The estimate's.
    time: Timestamp,
    estimate: Box<Estimate>,
}

/// One object's measurements of the window and its newest estimate.
#[derive(Clone, Debug)]
pub struct History {
    entries: VecDeque<Measurement>,
    /// Number of the first entry, counted from the track's first.
    first: u64,
    /// Ascending; the first one covers what has left the window.
    checkpoints: VecDeque<Checkpoint>,
    /// Memory of those let go.
    spare: Vec<Box<Estimate>>,
    newest: Box<Estimate>,
    /// Measurements put in their place and not filtered yet.
    waiting: usize,
    /// Number of the oldest of these.
    oldest_waiting: u64,
    /// Filtered measurements that had late ones put before them, of late.
    reach: u64,
    /// Measurements there were when that happened last.
    overtaken: u64,
    /// Measurements in the newest estimate.
    applied: u64,
}

impl History {
    /// Starts with one measurement.
    pub fn begin(measurement: Measurement, model: &MotionModel) -> Self {
        let newest = Box::new(Estimate::begin(&measurement, model));
        Self {
            entries: VecDeque::from([measurement]),
            first: 0,
            checkpoints: VecDeque::new(),
            spare: Vec::new(),
            newest,
            waiting: 0,
            oldest_waiting: u64::MAX,
            reach: 0,
            overtaken: 0,
            applied: 1,
        }
    }

    /// The estimate after the newest measurement that was filtered; those that wait are not in it.
    pub fn newest(&self) -> &Estimate {
        &self.newest
    }

    /// When the newest measurement was made, filtered or not.
    pub fn newest_time(&self) -> Timestamp {
        self.entries.back().map_or(self.newest.time, |entry| entry.time)
    }

    /// The measurements of the window, oldest first.
    pub fn measurements(&self) -> impl DoubleEndedIterator<Item = &Measurement> + Clone {
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
            *self.newest
        } else {
            let until = self.entries.partition_point(|entry| entry.time <= time);
            self.replayed(until.max(1), model)
        };
        estimate.predict(time, model);
        estimate
    }

    /// Puts a measurement in its place.
    pub fn insert(&mut self, measurement: &Measurement, model: &MotionModel) -> Inserted {
        let key = measurement.key();
        let newer = self.entries.iter().rev().take_while(|entry| entry.key() > key).count();
        // All before `place` have the same key or lower ones.
        let place = self.entries.len() - newer;
        if place > 0 && self.entries[place - 1].key() == key {
            return Inserted::Duplicate;
        }
        if place == 0 && self.first > 0 {
            return Inserted::TooLate;
        }
        let number = self.first + place as u64;
        while self.kept() > number {
            self.spare.extend(self.checkpoints.pop_back().map(|kept| kept.estimate));
        }
        if newer == 0 {
            self.entries.push_back(*measurement);
        } else {
            self.entries.insert(place, *measurement);
        }
        self.waiting += 1;
        self.oldest_waiting = self.oldest_waiting.min(number);
        let ahead_ns = self.newest_time().ns_since(self.newest.time);
        if self.waiting >= WAITING_MOST || ahead_ns > WAITING_NS || self.count() <= WAITING_FROM {
            self.settle(model);
        }
        if newer > 0 { Inserted::OutOfOrder } else { Inserted::InOrder }
    }

    /// Takes back what a camera measured from `since` on, as if it had never been there. Where that reaches
    /// beyond what is remembered, the estimate begins anew with what others measured within the window.
    pub fn take_back(
        &mut self,
        camera: CameraId,
        since: Timestamp,
        model: &MotionModel,
    ) -> TakenBack {
        let is_gone = |entry: &Measurement| entry.camera == camera && entry.time >= since;
        let Some(place) = self.entries.iter().position(is_gone) else { return TakenBack::All(0) };
        let taken = self.entries.iter().filter(|entry| is_gone(entry)).count();
        if taken == self.entries.len() && self.first == 0 {
            return TakenBack::NothingElse;
        }
        let number = self.first + place as u64;
        let is_before = |kept: &Checkpoint| kept.applied <= number;
        if self.first > 0 && !self.checkpoints.front().is_some_and(is_before) {
            return self.begin_without(camera, since, model);
        }
        while self.kept() > number {
            self.spare.extend(self.checkpoints.pop_back().map(|kept| kept.estimate));
        }
        self.entries.retain(|entry| !is_gone(entry));
        (self.waiting, self.oldest_waiting) = (0, u64::MAX);
        // Who is left sees it worse, maybe: how quietly it moves is not known any more.
        if let Some(kept) = self.checkpoints.back_mut() {
            kept.estimate.motion.doubt(model);
        }
        self.rewind(model);
        self.filter(model);
        TakenBack::All(taken)
    }

    /// Begins anew with the measurements of the window, but for a camera's from `since` on.
    fn begin_without(
        &mut self,
        camera: CameraId,
        since: Timestamp,
        model: &MotionModel,
    ) -> TakenBack {
        let stays = |entry: &&Measurement| entry.camera != camera || entry.time < since;
        let mut staying = self.entries.iter().filter(stays);
        let Some(first) = staying.next() else { return TakenBack::NothingElse };
        let mut anew = Self::begin(*first, model);
        staying.for_each(|entry| {
            anew.insert(entry, model);
        });
        let taken = self.entries.len() - anew.entries.len();
        *self = anew;
        TakenBack::All(taken)
    }

    /// Filters what waits, from the last checkpoint on.
    fn settle(&mut self, model: &MotionModel) {
        if self.waiting == 0 {
            return;
        }
        let count = self.count();
        let overtaken = count - self.oldest_waiting - self.waiting as u64;
        self.reach = overtaken.max(self.reach.saturating_sub(1));
        if self.oldest_waiting < self.applied {
            self.overtaken = count;
            self.go_back(model);
        }
        (self.waiting, self.oldest_waiting) = (0, u64::MAX);
        self.filter(model);
    }

    /// As [`Self::rewind`], where the estimate that is kept next is a later one.
    ///
    /// PERF: that one stands in for the last one kept, which need not be copied then.
    fn go_back(&mut self, model: &MotionModel) {
        let is_replaced = self.kept() + self.reach < self.count() && self.checkpoints.len() > 1;
        if !is_replaced {
            return self.rewind(model);
        }
        let Some(kept) = self.checkpoints.pop_back() else { return };
        self.spare.push(std::mem::replace(&mut self.newest, kept.estimate));
        self.applied = kept.applied;
    }

    /// Takes into the newest estimate what comes after it.
    fn filter(&mut self, model: &MotionModel) {
        let count = self.count();
        while self.applied < count {
            self.newest.update(&self.entries[(self.applied - self.first) as usize], model);
            self.applied += 1;
            let is_reached = self.reach > 0 && self.reach == count - self.applied;
            let is_in_order = self.applied.saturating_sub(self.overtaken) >= IN_ORDER;
            let most = if is_in_order { CHECKPOINT_EVERY_AT_MOST } else { CHECKPOINT_EVERY };
            if is_reached || self.applied - self.kept() >= most {
                self.keep();
            }
        }
    }

    /// Makes the last kept estimate the newest.
    fn rewind(&mut self, model: &MotionModel) {
        match self.checkpoints.back() {
            Some(kept) => {
                self.newest.copy_from(&kept.estimate);
                self.applied = kept.applied;
            }
            None => {
                *self.newest = Estimate::begin(&self.entries[0], model);
                self.applied = self.first + 1;
            }
        }
    }

    /// Measurements so far.
    fn count(&self) -> u64 {
        self.first + self.entries.len() as u64
    }

    /// Lets go of measurements from before `time`, as far as a kept estimate covers them.
    pub fn forget(&mut self, time: Timestamp) {
        while self.checkpoints.len() > 1 && self.checkpoints[1].time < time {
            self.spare.extend(self.checkpoints.pop_front().map(|kept| kept.estimate));
        }
        let Some(kept) = self.checkpoints.front().filter(|kept| kept.time < time) else {
            return;
        };
        // One entry stays, so that there is something to place others before or after.
        while self.first + 1 < kept.applied && self.entries.len() > 1 {
            self.entries.pop_front();
            self.first += 1;
        }
    }

    /// Measurements in the last kept estimate.
    fn kept(&self) -> u64 {
        self.checkpoints.back().map_or(0, |kept| kept.applied)
    }

    /// Keeps the newest estimate, and lets go of one that its neighbours can stand in for.
    fn keep(&mut self) {
        let applied = self.applied;
        let estimate = match self.spare.pop() {
            Some(mut spare) => {
                spare.copy_from(&self.newest);
                spare
            }
            None => self.newest.clone(),
        };
        self.checkpoints.push_back(Checkpoint { applied, time: estimate.time, estimate });
        let is_between = |middle: &usize| {
            let [before, after] = [middle - 1, middle + 1].map(|at| self.checkpoints[at].applied);
            after - before <= (applied - after).min(CHECKPOINT_EVERY_AT_MOST)
        };
        let dispensable = (1..self.checkpoints.len() - 1).rev().find(is_between);
        if let Some(middle) = dispensable {
            self.spare.extend(self.checkpoints.remove(middle).map(|kept| kept.estimate));
        }
    }

    /// The estimate after the first `count` entries (at least one).
    fn replayed(&self, count: usize, model: &MotionModel) -> Estimate {
        let number = self.first + count as u64;
        let kept = self.checkpoints.iter().rev().find(|kept| kept.applied <= number);
        let (mut done, mut estimate) = match kept.or(self.checkpoints.front()) {
            Some(kept) => ((kept.applied - self.first) as usize, *kept.estimate),
            None => (1, Estimate::begin(&self.entries[0], model)),
        };
        while done < count {
            estimate.update(&self.entries[done], model);
            done += 1;
        }
        estimate
    }
}

#[cfg(test)]
mod tests;
