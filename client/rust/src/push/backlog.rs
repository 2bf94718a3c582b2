//! What waits to be sent and what waits to be acknowledged: bounded, in order, and every one counted.
//!
//! Memory is bounded: of pictures the newest waits and two are under way; of observations those that the server
//! could still use, at most so many. What is under way stays until it is known whether it arrived: it is neither
//! acknowledged nor dropped before.

use std::{collections::VecDeque, sync::Arc};

use crate::v1;

/// Until the server says which observations are too old for it, ns.
const WINDOW_NS: i64 = 300_000_000;
/// Observations that wait at most: a second of a very fast camera.
const MAX_WAITING: usize = 1024;
/// Observations that are under way at most.
const MAX_OBSERVATIONS_UNDER_WAY: usize = 64;
/// Pictures that are under way at most: one is being searched, one is on its way.
const MAX_FRAMES_UNDER_WAY: usize = 2;

/// What is sent.
#[derive(Clone, Debug)]
pub(super) enum Item {
    Frame(Arc<v1::PushedFrame>),
    Observations(Arc<v1::PushedObservations>),
}

#[derive(Clone, Debug)]
struct Entry {
    sequence: u64,
    /// When it was handed over.
    since_ns: i64,
    item: Item,
}

/// What became of everything so far: captured = acknowledged + dropped + waiting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Counts {
    pub(super) captured: u64,
    pub(super) acknowledged: u64,
    pub(super) dropped: u64,
    pub(super) waiting: u64,
}

#[derive(Clone, Debug)]
pub(super) struct Backlog {
    /// Oldest first.
    waiting: VecDeque<Entry>,
    /// Oldest first, all older than those that wait.
    under_way: VecDeque<Entry>,
    captured: u64,
    acknowledged: u64,
    dropped: u64,
    window_ns: i64,
}

impl Default for Backlog {
    fn default() -> Self {
        Self {
            waiting: VecDeque::new(),
            under_way: VecDeque::new(),
            captured: 0,
            acknowledged: 0,
            dropped: 0,
            window_ns: WINDOW_NS,
        }
    }
}

impl Backlog {
    /// Takes an item, and gives it its sequence number.
    pub(super) fn add(&mut self, item: Item, now_ns: i64) -> u64 {
        self.captured += 1;
        self.expire(now_ns);
        if matches!(item, Item::Frame(_)) {
            let before = self.waiting.len();
            self.waiting.retain(|entry| !matches!(entry.item, Item::Frame(_)));
            self.dropped += (before - self.waiting.len()) as u64;
        }
        if self.waiting.len() == MAX_WAITING {
            self.waiting.pop_front();
            self.dropped += 1;
        }
        self.waiting.push_back(Entry { sequence: self.captured, since_ns: now_ns, item });
        self.captured
    }

    /// Drops what the server could no longer use. A clock that was set back makes nothing old.
    pub(super) fn expire(&mut self, now_ns: i64) {
        let window_ns = self.window_ns;
        while self
            .waiting
            .front()
            .is_some_and(|entry| now_ns.saturating_sub(entry.since_ns) > window_ns)
        {
            self.waiting.pop_front();
            self.dropped += 1;
        }
    }

    /// Whether something waits and the way is not full.
    pub(super) fn can_take(&self) -> bool {
        let frames = |entry: &&Entry| matches!(entry.item, Item::Frame(_));
        !self.waiting.is_empty()
            && self.under_way.len() < MAX_OBSERVATIONS_UNDER_WAY
            && self.under_way.iter().filter(frames).count() < MAX_FRAMES_UNDER_WAY
    }

    /// The next one to be sent, if the way is not full; from now on it is under way.
    pub(super) fn take(&mut self, now_ns: i64) -> Option<(u64, Item)> {
        self.expire(now_ns);
        if !self.can_take() {
            return None;
        }
        let entry = self.waiting.pop_front()?;
        let taken = (entry.sequence, entry.item.clone());
        self.under_way.push_back(entry);
        Some(taken)
    }

    /// The server has everything up to `sequence` that was sent.
    pub(super) fn acknowledge(&mut self, sequence: u64) {
        while self.under_way.front().is_some_and(|entry| entry.sequence <= sequence) {
            self.under_way.pop_front();
            self.acknowledged += 1;
        }
    }

    /// A new connection, over which the server says what it has, and what is too old for it: what it has not is to
    /// be sent again.
    pub(super) fn welcome(&mut self, newest_sequence: u64, window_ns: i64, now_ns: i64) {
        self.window_ns = window_ns;
        self.acknowledge(newest_sequence);
        while let Some(entry) = self.under_way.pop_back() {
            self.waiting.push_front(entry);
        }
        self.expire(now_ns);
    }

    /// The least sequence that is still to be sent or acknowledged.
    pub(super) fn next_sequence(&self) -> u64 {
        let oldest = self.under_way.front().or(self.waiting.front());
        oldest.map_or(self.captured + 1, |entry| entry.sequence)
    }

    /// How many before [`Self::next_sequence`] were dropped; who gets a later one knows of those between by their numbers.
    pub(super) fn dropped_before_next(&self) -> u64 {
        self.next_sequence() - 1 - self.acknowledged
    }

    /// Nothing is sent any more.
    pub(super) fn give_up(&mut self) {
        self.dropped += (self.waiting.len() + self.under_way.len()) as u64;
        self.waiting.clear();
        self.under_way.clear();
    }

    pub(super) fn counts(&self) -> Counts {
        Counts {
            captured: self.captured,
            acknowledged: self.acknowledged,
            dropped: self.dropped,
            waiting: (self.waiting.len() + self.under_way.len()) as u64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    fn seen() -> Item {
        Item::Observations(Arc::default())
    }

    fn add_up(backlog: &Backlog) -> [u64; 3] {
        let Counts { captured, acknowledged, dropped, waiting } = backlog.counts();
        assert_eq!(captured, acknowledged + dropped + waiting);
        [acknowledged, dropped, waiting]
    }

    #[test]
    fn a_lost_link_loses_what_is_too_old_and_nothing_else() {
        let mut backlog = Backlog::default();
        for frame in 0..300 {
            backlog.add(seen(), frame * 10 * MS);
            if frame < 3 {
                assert_eq!(backlog.take(frame * 10 * MS).unwrap().0, frame as u64 + 1);
            }
        }
        backlog.acknowledge(1);
        // Two under way, of which the server got one; those of the last 300 ms wait.
        assert_eq!(add_up(&backlog), [1, 266, 33]);
        assert_eq!((backlog.next_sequence(), backlog.dropped_before_next()), (2, 0));
        backlog.welcome(2, 300 * MS, 2_990 * MS);
        assert_eq!(add_up(&backlog), [2, 267, 31]);
        assert_eq!((backlog.next_sequence(), backlog.dropped_before_next()), (270, 267));
        let mut sent = Vec::new();
        while let Some((sequence, _)) = backlog.take(2_990 * MS) {
            sent.push(sequence);
        }
        assert_eq!(sent, (270..=300).collect::<Vec<u64>>());
        backlog.acknowledge(299);
        assert_eq!(add_up(&backlog), [32, 267, 1]);
        backlog.give_up();
        assert_eq!(add_up(&backlog), [32, 268, 0]);
        assert_eq!(backlog.next_sequence(), 301);
    }

    #[test]
    fn what_was_under_way_is_sent_again_in_order() {
        let mut backlog = Backlog::default();
        (0..5).for_each(|_| _ = backlog.add(seen(), 0));
        (0..4).for_each(|_| _ = backlog.take(0));
        backlog.welcome(0, 300 * MS, MS);
        let again: Vec<u64> = std::iter::from_fn(|| backlog.take(MS)).map(|(it, _)| it).collect();
        assert_eq!(again, [1, 2, 3, 4, 5]);
        backlog.acknowledge(5);
        assert_eq!(add_up(&backlog), [5, 0, 0]);
    }

    #[test]
    fn of_pictures_the_newest_waits() {
        let mut backlog = Backlog::default();
        for _ in 0..3 {
            backlog.add(Item::Frame(Arc::default()), 0);
            backlog.take(0);
        }
        // Two are under way, and there is no room for a third one.
        (0..4).for_each(|_| _ = backlog.add(Item::Frame(Arc::default()), 0));
        assert_eq!(add_up(&backlog), [0, 4, 3]);
        backlog.acknowledge(1);
        assert_eq!(backlog.take(0).unwrap().0, 7);
    }

    #[test]
    fn memory_is_bounded_whatever_the_rate() {
        let mut backlog = Backlog::default();
        (0..5000).for_each(|_| _ = backlog.add(seen(), 0));
        (0..5000).for_each(|_| _ = backlog.take(0));
        let [_, dropped, waiting] = add_up(&backlog);
        assert_eq!((dropped, waiting), (5000 - MAX_WAITING as u64, MAX_WAITING as u64));
        assert_eq!(backlog.under_way.len(), MAX_OBSERVATIONS_UNDER_WAY);
    }
}
