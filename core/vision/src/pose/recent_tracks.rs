//! What is kept of tracks, without being told of their end.
//!
//! A ring that was none of the last [`REMEMBERED`] to be looked up is forgotten.

use crate::id::TrackNumber;

/// So many rings, at least, are remembered; twice as many at most.
const CAPACITY: usize = 1024;

/// One thing of each track.
#[derive(Clone, Debug)]
pub struct RecentTracks<T> {
    /// By the tracks' numbers.
    entries: Vec<Entry<T>>,
    /// Rings looked up so far.
    calls: u64,
}

#[derive(Clone, Copy, Debug)]
struct Entry<T> {
    track: TrackNumber,
    /// The call that kept it last.
    call: u64,
    value: T,
}

impl<T> RecentTracks<T> {
    /// With room for all that it may come to keep.
    pub fn new() -> Self {
        Self { entries: Vec::with_capacity(2 * CAPACITY), calls: 0 }
    }

    /// What is kept of a track.
    pub fn of(&self, track: TrackNumber) -> Option<&T> {
        self.position(track).ok().map(|index| &self.entries[index].value)
    }

    /// What is kept of a track becomes this, if it is something.
    pub fn renew(&mut self, track: TrackNumber, next: Option<T>) {
        self.calls += 1;
        let Some(value) = next else { return };
        let entries = Entry { track, call: self.calls, value };
        match self.position(track) {
            Ok(index) => self.entries[index] = entries,
            Err(index) => self.insert(index, entries),
        }
    }

    fn position(&self, track: TrackNumber) -> Result<usize, usize> {
        self.entries.binary_search_by_key(&track, |entries| entries.track)
    }

    /// Forgets all of them.
    pub fn clear(&mut self) {
        self.entries.clear();
    }

    /// Keeps a new track, at its place in the order of numbers, and never more than there is room for:
    /// each call keeps one, so that the last [`REMEMBERED`] calls' are no more than that.
    fn insert(&mut self, index: usize, entries: Entry<T>) {
        self.entries.insert(index, entries);
        if self.entries.len() >= 2 * CAPACITY {
            let oldest = self.calls.saturating_sub(CAPACITY as u64);
            self.entries.retain(|entries| entries.call > oldest);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_stays_away_is_forgotten_and_who_is_seen_is_not() {
        let mut recall = RecentTracks::new();
        let end = 4 * CAPACITY as u64;
        for number in 1..end {
            for track in [0, number] {
                let before = (track == 0 && number > 1).then(|| number - 1);
                assert_eq!(recall.of(TrackNumber(track)), before.as_ref(), "{track}");
                recall.renew(TrackNumber(track), Some(number));
                // Nothing new does not make it forgotten.
                recall.renew(TrackNumber(track), None);
                assert_eq!(recall.of(TrackNumber(track)), Some(&number));
            }
            assert!(recall.entries.len() < 2 * CAPACITY);
        }
        assert_eq!(recall.of(TrackNumber(1)), None);
        assert_eq!(recall.of(TrackNumber(end - 1)), Some(&(end - 1)));
    }
}
