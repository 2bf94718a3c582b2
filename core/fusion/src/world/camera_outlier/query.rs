//! How much of a frame is held against what other cameras saw, and what says that all of it has to be.

use roundel_vision::id::CameraId;

/// As many of a frame's sightings are enough for a baseline, which sums up what some twenty frames said.
const MIN_SAMPLED: usize = 16;
/// An innovation's squared length counts up to this in what is usual.
pub(crate) const MAX_SQUARED: f64 = 50.0;

/// What a frame's innovations come to.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct InnovationSum {
    /// Of squared lengths, each up to [`MOST_SQUARED`].
    pub(crate) sum: f64,
    pub(crate) count: usize,
}

/// Of whom it is asked how far a frame lies from what they saw.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Query {
    /// This other camera; `None`: all.
    pub(crate) by: Option<CameraId>,
    /// One sighting in so many …
    pub(crate) every: usize,
    /// … of which so many are left out before the first.
    pub(crate) skipped: usize,
}

impl Query {
    /// About all sightings.
    pub(super) fn whole(by: Option<CameraId>) -> Self {
        Self { by, every: 1, skipped: 0 }
    }

    /// About as many of so many sightings as a baseline needs, others at each turn; `None` where that is all of them.
    pub(super) fn part(sightings: usize, turn: u64) -> Option<Self> {
        let every = sightings / MIN_SAMPLED;
        let skipped = turn.checked_rem(every as u64)? as usize;
        (every > 1).then_some(Self { by: None, every, skipped })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_a_crowd_each_is_asked_about_in_turn() {
        for sightings in [0, 1, MIN_SAMPLED, 2 * MIN_SAMPLED - 1] {
            assert!(Query::part(sightings, 7).is_none(), "{sightings}");
        }
        for sightings in [2 * MIN_SAMPLED, 64, 1000] {
            let mut queried = vec![0; sightings];
            let turns = sightings / MIN_SAMPLED;
            for turn in 0..turns {
                let Query { every, skipped, .. } = Query::part(sightings, turn as u64).unwrap();
                let part = (0..sightings).skip(skipped).step_by(every);
                assert!(part.clone().count() >= MIN_SAMPLED, "{sightings}");
                part.for_each(|index| queried[index] += 1);
            }
            assert!(queried.iter().all(|count| *count == 1), "{sightings}: {queried:?}");
        }
    }
}
