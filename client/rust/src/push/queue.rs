//! Bounded, ordered queue of items to be sent and to be acknowledged. Counts every item.
//!
//! Keeps the newest waiting frame and two in flight, and the observations that the server can still use, up to a limit.
//! Items in flight are kept until the server acknowledges them or they have to be sent again.

use std::{collections::VecDeque, sync::Arc};

use crate::v1;

/// Default for the age at which observations are too old for the server, ns.
const LATE_WINDOW_NS: i64 = 300_000_000;
/// Maximum number of waiting items: a second of a very fast camera.
const MAX_WAITING: usize = 1024;
/// Maximum number of items in flight.
const MAX_IN_FLIGHT: usize = 64;
/// Maximum number of frames in flight: one in the detector, one in transit.
const MAX_FRAMES_IN_FLIGHT: usize = 2;

#[derive(Clone, Debug)]
pub(super) enum Item {
    Frame(Arc<v1::PushedFrame>),
    Observations(Arc<v1::PushedObservations>),
}

#[derive(Clone, Debug)]
struct Entry {
    sequence: u64,
    queued_ns: i64,
    item: Item,
}

/// captured = acknowledged + dropped + waiting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Counts {
    pub(super) captured: u64,
    pub(super) acknowledged: u64,
    pub(super) dropped: u64,
    pub(super) waiting: u64,
}

#[derive(Clone, Debug)]
pub(super) struct SendQueue {
    /// Oldest first.
    waiting: VecDeque<Entry>,
    /// Oldest first, all older than the waiting ones.
    in_flight: VecDeque<Entry>,
    captured: u64,
    acknowledged: u64,
    dropped: u64,
    window_ns: i64,
}

impl Default for SendQueue {
    fn default() -> Self {
        Self {
            waiting: VecDeque::new(),
            in_flight: VecDeque::new(),
            captured: 0,
            acknowledged: 0,
            dropped: 0,
            window_ns: LATE_WINDOW_NS,
        }
    }
}

impl SendQueue {
    /// Appends an item and returns its sequence number.
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
        self.waiting.push_back(Entry { sequence: self.captured, queued_ns: now_ns, item });
        self.captured
    }

    /// Drops items that are too old for the server. A clock that was set back expires nothing.
    pub(super) fn expire(&mut self, now_ns: i64) {
        let window_ns = self.window_ns;
        while self
            .waiting
            .front()
            .is_some_and(|entry| now_ns.saturating_sub(entry.queued_ns) > window_ns)
        {
            self.waiting.pop_front();
            self.dropped += 1;
        }
    }

    /// Whether an item waits and the limits in flight are not reached.
    pub(super) fn can_send(&self) -> bool {
        let frames = |entry: &&Entry| matches!(entry.item, Item::Frame(_));
        !self.waiting.is_empty()
            && self.in_flight.len() < MAX_IN_FLIGHT
            && self.in_flight.iter().filter(frames).count() < MAX_FRAMES_IN_FLIGHT
    }

    /// The next item to send, if any; it is in flight from now on.
    pub(super) fn take(&mut self, now_ns: i64) -> Option<(u64, Item)> {
        self.expire(now_ns);
        if !self.can_send() {
            return None;
        }
        let entry = self.waiting.pop_front()?;
        let taken = (entry.sequence, entry.item.clone());
        self.in_flight.push_back(entry);
        Some(taken)
    }

    /// Removes items in flight up to `sequence`, which have reached the server.
    pub(super) fn acknowledge(&mut self, sequence: u64) {
        while self.in_flight.front().is_some_and(|entry| entry.sequence <= sequence) {
            self.in_flight.pop_front();
            self.acknowledged += 1;
        }
    }

    /// Starts a new connection: queues items in flight that are newer than `newest_sequence` again.
    pub(super) fn reconnect(&mut self, newest_sequence: u64, window_ns: i64, now_ns: i64) {
        self.window_ns = window_ns;
        self.acknowledge(newest_sequence);
        while let Some(entry) = self.in_flight.pop_back() {
            self.waiting.push_front(entry);
        }
        self.expire(now_ns);
    }

    /// The lowest sequence number still to be sent or acknowledged.
    pub(super) fn next_sequence(&self) -> u64 {
        let oldest = self.in_flight.front().or(self.waiting.front());
        oldest.map_or(self.captured + 1, |entry| entry.sequence)
    }

    /// Number of dropped items before [`Self::next_sequence`]. Later ones appear as gaps in the sequence numbers.
    pub(super) fn dropped_before_next(&self) -> u64 {
        self.next_sequence() - 1 - self.acknowledged
    }

    /// Drops all items.
    pub(super) fn drop_all(&mut self) {
        self.dropped += (self.waiting.len() + self.in_flight.len()) as u64;
        self.waiting.clear();
        self.in_flight.clear();
    }

    pub(super) fn counts(&self) -> Counts {
        Counts {
            captured: self.captured,
            acknowledged: self.acknowledged,
            dropped: self.dropped,
            waiting: (self.waiting.len() + self.in_flight.len()) as u64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    fn observations() -> Item {
        Item::Observations(Arc::default())
    }

    fn checked_counts(queue: &SendQueue) -> [u64; 3] {
        let Counts { captured, acknowledged, dropped, waiting } = queue.counts();
        assert_eq!(captured, acknowledged + dropped + waiting);
        [acknowledged, dropped, waiting]
    }

    #[test]
    fn a_lost_connection_drops_only_items_that_are_too_old() {
        let mut queue = SendQueue::default();
        for frame in 0..300 {
            queue.add(observations(), frame * 10 * MS);
            if frame < 3 {
                assert_eq!(queue.take(frame * 10 * MS).unwrap().0, frame as u64 + 1);
            }
        }
        queue.acknowledge(1);
        // Two in flight, one of which reached the server; those of the last 300 ms wait.
        assert_eq!(checked_counts(&queue), [1, 266, 33]);
        assert_eq!((queue.next_sequence(), queue.dropped_before_next()), (2, 0));
        queue.reconnect(2, 300 * MS, 2_990 * MS);
        assert_eq!(checked_counts(&queue), [2, 267, 31]);
        assert_eq!((queue.next_sequence(), queue.dropped_before_next()), (270, 267));
        let mut sent = Vec::new();
        while let Some((sequence, _)) = queue.take(2_990 * MS) {
            sent.push(sequence);
        }
        assert_eq!(sent, (270..=300).collect::<Vec<u64>>());
        queue.acknowledge(299);
        assert_eq!(checked_counts(&queue), [32, 267, 1]);
        queue.drop_all();
        assert_eq!(checked_counts(&queue), [32, 268, 0]);
        assert_eq!(queue.next_sequence(), 301);
    }

    #[test]
    fn items_in_flight_are_sent_again_in_order() {
        let mut queue = SendQueue::default();
        (0..5).for_each(|_| _ = queue.add(observations(), 0));
        (0..4).for_each(|_| _ = queue.take(0));
        queue.reconnect(0, 300 * MS, MS);
        let again: Vec<u64> = std::iter::from_fn(|| queue.take(MS)).map(|(it, _)| it).collect();
        assert_eq!(again, [1, 2, 3, 4, 5]);
        queue.acknowledge(5);
        assert_eq!(checked_counts(&queue), [5, 0, 0]);
    }

    #[test]
    fn only_the_newest_frame_waits() {
        let mut queue = SendQueue::default();
        for _ in 0..3 {
            queue.add(Item::Frame(Arc::default()), 0);
            queue.take(0);
        }
        // Two frames are in flight, which is the limit.
        (0..4).for_each(|_| _ = queue.add(Item::Frame(Arc::default()), 0));
        assert_eq!(checked_counts(&queue), [0, 4, 3]);
        queue.acknowledge(1);
        assert_eq!(queue.take(0).unwrap().0, 7);
    }

    #[test]
    fn memory_is_bounded_whatever_the_rate() {
        let mut queue = SendQueue::default();
        (0..5000).for_each(|_| _ = queue.add(observations(), 0));
        (0..5000).for_each(|_| _ = queue.take(0));
        let [_, dropped, waiting] = checked_counts(&queue);
        assert_eq!((dropped, waiting), (5000 - MAX_WAITING as u64, MAX_WAITING as u64));
        assert_eq!(queue.in_flight.len(), MAX_IN_FLIGHT);
    }
}
