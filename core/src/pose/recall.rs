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

impl<T: Copy> Recall<T> {
    /// With room for all that it may come to keep.
    pub fn new() -> Self {
        Self { kept: Vec::with_capacity(2 * REMEMBERED), calls: 0 }
    }

    /// What is kept of a track becomes what `next` makes of it, if that is something.
    pub fn renew(&mut self, track: TrackNumber, next: impl FnOnce(Option<T>) -> Option<T>) {
        self.calls += 1;
        let place = self.kept.binary_search_by_key(&track, |kept| kept.track);
        let before = place.ok().map(|index| self.kept[index].what);
        let Some(what) = next(before) else { return };
        let kept = Kept { track, call: self.calls, what };
        match place {
            Ok(index) => self.kept[index] = kept,
            Err(index) => self.insert(index, kept),
        }
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
                recall.renew(TrackNumber(track), |before| {
                    assert_eq!(before, (track == 0 && number > 1).then(|| number - 1), "{track}");
                    Some(number)
                });
            }
            assert!(recall.kept.len() < 2 * REMEMBERED);
        }
        let mut of = |track| {
            let mut found = None;
            recall.renew(TrackNumber(track), |before| {
                found = before;
                None
            });
            found
        };
        assert_eq!(of(1), None);
        assert_eq!(of(most - 1), Some(most - 1));
    }
}
