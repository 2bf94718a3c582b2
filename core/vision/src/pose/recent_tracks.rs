//! Bounded per-track state that needs no notice when a track ends.
//!
//! A track that was not among the last [`CAPACITY`] updates is discarded.

use crate::id::TrackNumber;

/// Minimum number of tracks that are kept; at most twice as many.
const CAPACITY: usize = 1024;

#[derive(Clone, Debug)]
pub struct RecentTracks<T> {
    /// Sorted by track.
    entries: Vec<Entry<T>>,
    /// Number of updates.
    calls: u64,
}

#[derive(Clone, Copy, Debug)]
struct Entry<T> {
    track: TrackNumber,
    /// Number of its last update.
    call: u64,
    value: T,
}

impl<T> RecentTracks<T> {
    /// Reserves all its memory.
    pub fn new() -> Self {
        Self { entries: Vec::with_capacity(2 * CAPACITY), calls: 0 }
    }

    pub fn get(&self, track: TrackNumber) -> Option<&T> {
        self.position(track).ok().map(|index| &self.entries[index].value)
    }

    /// Replaces the value of a track; `None` keeps it.
    pub fn update(&mut self, track: TrackNumber, next: Option<T>) {
        self.calls += 1;
        let Some(value) = next else { return };
        let entry = Entry { track, call: self.calls, value };
        match self.position(track) {
            Ok(index) => self.entries[index] = entry,
            Err(index) => self.insert(index, entry),
        }
    }

    fn position(&self, track: TrackNumber) -> Result<usize, usize> {
        self.entries.binary_search_by_key(&track, |entry| entry.track)
    }

    pub fn clear(&mut self) {
        self.entries.clear();
    }

    /// Inserts a new track in order, and discards the oldest ones when the memory is full. Each
    /// update keeps one track, so the last [`CAPACITY`] updates are at most as many tracks.
    fn insert(&mut self, index: usize, entry: Entry<T>) {
        self.entries.insert(index, entry);
        if self.entries.len() >= 2 * CAPACITY {
            let oldest = self.calls.saturating_sub(CAPACITY as u64);
            self.entries.retain(|entry| entry.call > oldest);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absent_tracks_are_discarded_and_updated_ones_are_not() {
        let mut tracks = RecentTracks::new();
        let end = 4 * CAPACITY as u64;
        for number in 1..end {
            for track in [0, number] {
                let before = (track == 0 && number > 1).then(|| number - 1);
                assert_eq!(tracks.get(TrackNumber(track)), before.as_ref(), "{track}");
                tracks.update(TrackNumber(track), Some(number));
                // `None` does not discard it.
                tracks.update(TrackNumber(track), None);
                assert_eq!(tracks.get(TrackNumber(track)), Some(&number));
            }
            assert!(tracks.entries.len() < 2 * CAPACITY);
        }
        assert_eq!(tracks.get(TrackNumber(1)), None);
        assert_eq!(tracks.get(TrackNumber(end - 1)), Some(&(end - 1)));
    }
}
