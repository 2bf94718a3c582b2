//! What is kept of tracks, without being told of their end.
//!
//! A ring that was none of the last [`REMEMBERED`] to be looked up is forgotten.

use crate::id::TrackNumber;

/// So many rings, at least, are remembered; twice as many at most.
const REMEMBERED: usize = 1024;

/// One thing of each track.
#[derive(Clone, Debug)]
pub struct Recall<T> {
    /// By the tracks' numbers.
    kept: Vec<Kept<T>>,
    /// Rings looked up so far.
    calls: u64,
}

#[derive(Clone, Copy, Debug)]
struct Kept<T> {
    track: TrackNumber,
    /// The call that kept it last.
    call: u64,
    what: T,
}

impl<T> Recall<T> {
    /// With room for all that it may come to keep.
    pub fn new() -> Self {
        Self { kept: Vec::with_capacity(2 * REMEMBERED), calls: 0 }
    }

    /// What is kept of a track.
    pub fn of(&self, track: TrackNumber) -> Option<&T> {
        self.place(track).ok().map(|index| &self.kept[index].what)
    }

    /// What is kept of a track becomes this, if it is something.
    pub fn renew(&mut self, track: TrackNumber, next: Option<T>) {
        self.calls += 1;
        let Some(what) = next else { return };
        let kept = Kept { track, call: self.calls, what };
        match self.place(track) {
            Ok(index) => self.kept[index] = kept,
            Err(index) => self.insert(index, kept),
        }
    }

    fn place(&self, track: TrackNumber) -> Result<usize, usize> {
        self.kept.binary_search_by_key(&track, |kept| kept.track)
    }

    /// Forgets all of them.
    pub fn clear(&mut self) {
        self.kept.clear();
    }

    /// Keeps a new track, at its place in the order of numbers, and never more than there is room for:
    /// each call keeps one, so that the last [`REMEMBERED`] calls' are no more than that.
    fn insert(&mut self, index: usize, kept: Kept<T>) {
        self.kept.insert(index, kept);
        if self.kept.len() >= 2 * REMEMBERED {
            let oldest = self.calls.saturating_sub(REMEMBERED as u64);
            self.kept.retain(|kept| kept.call > oldest);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_stays_away_is_forgotten_and_who_is_seen_is_not() {
        let mut recall = Recall::new();
        let most = 4 * REMEMBERED as u64;
        for number in 1..most {
            for track in [0, number] {
                let before = (track == 0 && number > 1).then(|| number - 1);
                assert_eq!(recall.of(TrackNumber(track)), before.as_ref(), "{track}");
                recall.renew(TrackNumber(track), Some(number));
                // Nothing new does not make it forgotten.
                recall.renew(TrackNumber(track), None);
                assert_eq!(recall.of(TrackNumber(track)), Some(&number));
            }
            assert!(recall.kept.len() < 2 * REMEMBERED);
        }
        assert_eq!(recall.of(TrackNumber(1)), None);
        assert_eq!(recall.of(TrackNumber(most - 1)), Some(&(most - 1)));
    }
}
