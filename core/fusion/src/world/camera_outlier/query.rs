//! Which sightings of a frame are compared with other cameras, and the sum of innovations that decides it.

use roundel_vision::id::CameraId;

/// Number of sightings that suffice for the baseline, which averages some twenty frames.
const MIN_SAMPLED: usize = 16;
/// Limit of an innovation's squared length in the usual sum.
pub(crate) const MAX_SQUARED: f64 = 50.0;

/// Sum over a frame's innovations.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct InnovationSum {
    /// Squared lengths, each at most [`MAX_SQUARED`].
    pub(crate) sum: f64,
    pub(crate) count: usize,
}

/// Selects the cameras and sightings to compare.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Query {
    /// The other camera; `None`: all others.
    pub(crate) by: Option<CameraId>,
    /// Every how many sightings one is selected.
    pub(crate) every: usize,
    /// Number of sightings before the first selected one.
    pub(crate) skipped: usize,
}

impl Query {
    /// All sightings.
    pub(super) fn whole(by: Option<CameraId>) -> Self {
        Self { by, every: 1, skipped: 0 }
    }

    /// A part of the sightings that suffices for the baseline, another one for each `turn`; `None` if that is all
    /// of them.
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
    fn parts_cover_all_sightings_in_turn() {
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
