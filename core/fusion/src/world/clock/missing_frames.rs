//! Frames that never came.
//!
//! Two things tell of them. A camera's frames are numbered without gaps, so that a number left out is of a frame
//! lost on its way; it counts as missing when it has not come within [`GIVEN_UP_NS`] (till then it may be late, and
//! what comes late is counted as that). And most cameras take frames at a regular interval: where that, as the
//! median of the last ones, passes more than once between successive numbers, the camera or its link
//! has left some out. A source whose frames come whenever they like has no such interval, and is told
//! by its numbers only; one that has changed its interval is misjudged until the median has followed.
//!
//! `tests/src/scenario/fault.rs` (`missing`, `stopped`, and none in the others) holds the counts.

use std::collections::{BTreeMap, VecDeque};

use roundel_vision::{id::CameraId, time::Timestamp};

/// A number that has not come for so long after a higher one is that of a missing frame.
const GIVEN_UP_NS: i64 = 1_000_000_000;
/// More numbers than this at once are not left out: the source counts anew.
const MOST_NUMBERS: u64 = 1000;
/// Gaps that are waited for; of more, the oldest are given up.
const MOST_GAPS: usize = 64;
/// Intervals of which the median is taken …
const INTERVALS: usize = 9;
/// … and how many of them must be as long, …
const REGULAR: usize = 7;
/// … give or take this share.
const TOLERANCE: f64 = 0.15;
/// A longer pause is no frame left out but a source that rests.
const LONGEST_PAUSE_NS: i64 = 1_000_000_000;
/// Frames are on their way for about as long; where stamps say otherwise, the clock was set.
const UNSTEADY_NS: i64 = 250_000_000;

/// What all cameras left out.
#[derive(Clone, Debug, Default)]
pub(in crate::world) struct Gaps {
    cameras: BTreeMap<CameraId, Camera>,
}

#[derive(Clone, Debug)]
struct Camera {
    /// Of the highest number.
    newest: Seen,
    /// From one number to the next, oldest first.
    intervals_ns: VecDeque<i64>,
    /// Numbers left out that may come still, the longest known first.
    gaps: VecDeque<Gap>,
}

#[derive(Clone, Copy, Debug)]
struct Seen {
    frame: u64,
    stamp: Timestamp,
    received: Timestamp,
}

/// From `first` up to but not with `end`.
#[derive(Clone, Copy, Debug)]
struct Gap {
    first: u64,
    end: u64,
    since: Timestamp,
}

impl Gaps {
    /// Waits for nothing of a camera any more.
    pub(in crate::world) fn forget(&mut self, camera: CameraId) {
        self.cameras.remove(&camera);
    }

    /// Takes note of a frame, whatever becomes of it; gives how many of its camera are found missing.
    pub(in crate::world) fn see(
        &mut self,
        camera: CameraId,
        frame: u64,
        (stamp, received): (Timestamp, Timestamp),
    ) -> u64 {
        let seen = Seen { frame, stamp, received };
        match self.cameras.get_mut(&camera) {
            Some(camera) => camera.see(seen),
            None => {
                self.cameras.insert(camera, Camera::new(seen));
                0
            }
        }
    }
}

impl Camera {
    fn new(newest: Seen) -> Self {
        let intervals_ns = VecDeque::with_capacity(INTERVALS);
        Self { newest, intervals_ns, gaps: VecDeque::new() }
    }

    fn see(&mut self, seen: Seen) -> u64 {
        let mut missing = 0;
        while let Some(gap) = self.gaps.front()
            && (seen.received.ns_since(gap.since) > GIVEN_UP_NS || self.gaps.len() > MOST_GAPS)
        {
            missing += gap.end - gap.first;
            self.gaps.pop_front();
        }
        let steps = seen.frame.saturating_sub(self.newest.frame);
        if steps == 0 {
            let is_old = seen.frame == self.newest.frame || self.fill(seen.frame);
            if !is_old && self.span_ns(&seen).is_some_and(|span_ns| span_ns > 0) {
                missing += self.begin_anew(seen);
            }
            return missing;
        }
        if steps > MOST_NUMBERS {
            return missing + self.begin_anew(seen);
        }
        if steps > 1 {
            let first = self.newest.frame + 1;
            self.gaps.push_back(Gap { first, end: seen.frame, since: seen.received });
        }
        missing += self.left_out(&seen, steps);
        self.newest = seen;
        missing
    }

    /// Numbers are told from the start again; what was waited for is missing.
    fn begin_anew(&mut self, seen: Seen) -> u64 {
        let missing = self.gaps.iter().map(|gap| gap.end - gap.first).sum();
        *self = Self::new(seen);
        missing
    }

    /// A number that was waited for; false if it was not.
    fn fill(&mut self, frame: u64) -> bool {
        let holds = |gap: &Gap| (gap.first..gap.end).contains(&frame);
        let Some(index) = self.gaps.iter().position(holds) else { return false };
        let gap = self.gaps[index];
        self.gaps[index].end = frame;
        if frame + 1 < gap.end {
            self.gaps.insert(index + 1, Gap { first: frame + 1, ..gap });
        }
        self.gaps.retain(|gap| gap.first < gap.end);
        true
    }

    /// How many the time since the last one wants that have no number.
    fn left_out(&mut self, seen: &Seen, steps: u64) -> u64 {
        let is_usual = |span_ns: &i64| (1..=LONGEST_PAUSE_NS).contains(span_ns);
        let Some(span_ns) = self.span_ns(seen).filter(is_usual) else { return 0 };
        let regular_ns = self.regular_ns();
        if self.intervals_ns.len() == INTERVALS {
            self.intervals_ns.pop_front();
        }
        self.intervals_ns.push_back(span_ns / steps as i64);
        match regular_ns {
            // Where numbers are left out, they say enough.
            Some(regular_ns) if steps == 1 => {
                ((span_ns as f64 / regular_ns).round() as u64).saturating_sub(1)
            }
            _ => 0,
        }
    }

    /// How much later than the newest one by its stamp; `None` if the clock was set between.
    fn span_ns(&self, seen: &Seen) -> Option<i64> {
        let span_ns = seen.stamp.ns_since(self.newest.stamp);
        let received_ns = seen.received.ns_since(self.newest.received);
        let is_steady = span_ns.saturating_sub(received_ns).saturating_abs() < UNSTEADY_NS;
        is_steady.then_some(span_ns)
    }

    /// The interval of a camera that has one.
    fn regular_ns(&self) -> Option<f64> {
        if self.intervals_ns.len() < INTERVALS {
            return None;
        }
        let mut sorted = [0; INTERVALS];
        for (to, interval_ns) in sorted.iter_mut().zip(&self.intervals_ns) {
            *to = *interval_ns;
        }
        sorted.sort_unstable();
        let median_ns = sorted[INTERVALS / 2] as f64;
        let is_regular =
            |interval_ns: &&i64| (**interval_ns as f64 / median_ns - 1.0).abs() < TOLERANCE;
        (sorted.iter().filter(is_regular).count() >= REGULAR).then_some(median_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INTERVAL_NS: i64 = 10_000_000;
    const CAMERA: CameraId = CameraId(1);

    /// Frames of these numbers, taken at these times in intervals and received in this order.
    fn missing(frames: impl IntoIterator<Item = (u64, i64)>) -> u64 {
        let mut gaps = Gaps::default();
        let mut last_ns = 0;
        let see = |(frame, time): (u64, i64)| {
            let stamp_ns = time * INTERVAL_NS;
            // What is late comes right after those before it.
            last_ns = (stamp_ns + 5_000_000).max(last_ns + 1);
            let received = Timestamp::from_ns(last_ns);
            gaps.see(CAMERA, frame, (Timestamp::from_ns(stamp_ns), received))
        };
        frames.into_iter().map(see).sum()
    }

    fn regular(frames: std::ops::Range<u64>) -> impl Iterator<Item = (u64, i64)> {
        frames.map(|frame| (frame, frame as i64))
    }

    #[test]
    fn numbers_left_out_are_missing_when_they_do_not_come() {
        assert_eq!(missing(regular(1..400)), 0);
        assert_eq!(missing(regular(1..50).chain(regular(53..100))), 0, "they may come still");
        assert_eq!(missing(regular(1..50).chain(regular(53..400))), 3);
        let in_disorder = regular(1..50).chain([(52, 52), (50, 50), (53, 53), (51, 51)]);
        assert_eq!(missing(in_disorder.chain(regular(54..400))), 0);
        let one_of_three = regular(1..50).chain([(53, 53), (51, 51)]);
        assert_eq!(missing(one_of_three.chain(regular(54..400))), 2);
    }

    #[test]
    fn what_a_regular_camera_leaves_out_is_missing() {
        let later = |frames: std::ops::Range<u64>, by: i64| {
            frames.map(move |frame| (frame, frame as i64 + by))
        };
        assert_eq!(missing(regular(1..50).chain(later(50..400, 2))), 2);
        // It rests.
        assert_eq!(missing(regular(1..50).chain(later(50..400, 200))), 0);
        // Whenever it likes.
        let squares = (1..30).map(|frame| (frame, (frame * frame) as i64));
        assert_eq!(missing(squares), 0);
        // Half as fast from now on: misjudged a few times.
        let slower = (50..400).map(|frame| (frame, 2 * frame as i64 - 49));
        assert!(missing(regular(1..50).chain(slower)) <= INTERVALS as u64);
    }

    #[test]
    fn a_clock_that_is_set_and_numbers_that_begin_anew_miss_nothing() {
        let anew = (1..300).map(|frame| (frame, 50 + frame as i64));
        assert_eq!(missing(regular(1..50).chain(anew)), 0);
        assert_eq!(missing(regular(1..50).chain([(u64::MAX, 50)])), 0);
        let mut gaps = Gaps::default();
        let mut count = 0;
        for frame in 1..300 {
            let received_ns = frame as i64 * INTERVAL_NS;
            let set_ns = if (100..200).contains(&frame) { 3_600_000_000_000 } else { 0 };
            let times = (Timestamp::from_ns(received_ns + set_ns), Timestamp::from_ns(received_ns));
            count += gaps.see(CAMERA, frame, times);
        }
        assert_eq!(count, 0);
    }
}
