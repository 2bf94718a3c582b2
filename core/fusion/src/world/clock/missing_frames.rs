//! Counts frames that never arrived.
//!
//! A camera's frames are numbered without gaps. A skipped number counts as missing when it has not arrived within
//! [`WAIT_NS`]; until then it may be late, and late frames have a counter of their own. Besides, most cameras have a
//! regular interval. Where it, as the median of the last ones, fits more than once between successive numbers, the
//! camera or its link has dropped frames. A source without a regular interval is judged by its numbers only. After a
//! change of interval the count is wrong until the median has followed.
//!
//! `tests/src/scenario/fault.rs` (`missing`, `stopped`, and none in the others) checks the counts.

use std::collections::{BTreeMap, VecDeque};

use super::FrameStamp;
use roundel_vision::{id::CameraId, time::Timestamp};

/// Time after which a skipped number counts as missing.
const WAIT_NS: i64 = 1_000_000_000;
/// A larger step of numbers is a restart of the source.
const MAX_NUMBER_STEP: u64 = 1000;
/// Number of gaps that are waited for; beyond it the oldest counts as missing.
const MAX_GAPS: usize = 64;
/// Number of intervals in the median.
const INTERVALS: usize = 9;
/// Number of these that must agree with the median.
const MIN_REGULAR: usize = 7;
/// Tolerance of the agreement, relative.
const TOLERANCE: f64 = 0.15;
/// A longer pause is not counted: the source paused.
const MAX_PAUSE_NS: i64 = 1_000_000_000;
/// A larger change of the transport delay means that the clock was set.
const MAX_DELAY_CHANGE_NS: i64 = 250_000_000;

/// All cameras.
#[derive(Clone, Debug, Default)]
pub(crate) struct MissingFrames {
    cameras: BTreeMap<CameraId, Camera>,
}

#[derive(Clone, Debug)]
struct Camera {
    /// Times of the highest number.
    newest: FrameStamp,
    /// Between successive numbers, oldest first.
    intervals_ns: VecDeque<i64>,
    /// Skipped numbers that may still arrive, oldest first.
    gaps: VecDeque<Gap>,
}

/// Numbers from `first` up to, but not including, `end`.
#[derive(Clone, Copy, Debug)]
struct Gap {
    first: u64,
    end: u64,
    since: Timestamp,
}

impl MissingFrames {
    /// Discards all gaps of a camera.
    pub(crate) fn forget(&mut self, camera: CameraId) {
        self.cameras.remove(&camera);
    }

    /// Notes a frame, whether it is used or not; returns the number of frames now found missing.
    pub(crate) fn observe(&mut self, frame: FrameStamp) -> u64 {
        match self.cameras.get_mut(&frame.camera) {
            Some(camera) => camera.observe(frame),
            None => {
                self.cameras.insert(frame.camera, Camera::new(frame));
                0
            }
        }
    }
}

impl Camera {
    fn new(newest: FrameStamp) -> Self {
        let intervals_ns = VecDeque::with_capacity(INTERVALS);
        Self { newest, intervals_ns, gaps: VecDeque::new() }
    }

    fn observe(&mut self, frame: FrameStamp) -> u64 {
        let mut missing = 0;
        while let Some(gap) = self.gaps.front()
            && (frame.received.ns_since(gap.since) > WAIT_NS || self.gaps.len() > MAX_GAPS)
        {
            missing += gap.end - gap.first;
            self.gaps.pop_front();
        }
        let steps = frame.number.saturating_sub(self.newest.number);
        if steps == 0 {
            let is_old = frame.number == self.newest.number || self.fill(frame.number);
            if !is_old && self.span_ns(&frame).is_some_and(|span_ns| span_ns > 0) {
                missing += self.restart(frame);
            }
            return missing;
        }
        if steps > MAX_NUMBER_STEP {
            return missing + self.restart(frame);
        }
        if steps > 1 {
            let first = self.newest.number + 1;
            self.gaps.push_back(Gap { first, end: frame.number, since: frame.received });
        }
        missing += self.missing_by_interval(&frame, steps);
        self.newest = frame;
        missing
    }

    /// Restarts the numbering; pending gaps count as missing.
    fn restart(&mut self, frame: FrameStamp) -> u64 {
        let missing = self.gaps.iter().map(|gap| gap.end - gap.first).sum();
        *self = Self::new(frame);
        missing
    }

    /// Removes a number from the gaps; returns whether it was in one.
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

    /// Number of frames without a number that fit into the time since the last one.
    fn missing_by_interval(&mut self, frame: &FrameStamp, steps: u64) -> u64 {
        let is_plausible = |span_ns: &i64| (1..=MAX_PAUSE_NS).contains(span_ns);
        let Some(span_ns) = self.span_ns(frame).filter(is_plausible) else { return 0 };
        let regular_ns = self.regular_ns();
        if self.intervals_ns.len() == INTERVALS {
            self.intervals_ns.pop_front();
        }
        self.intervals_ns.push_back(span_ns / steps as i64);
        match regular_ns {
            // Skipped numbers are counted already.
            Some(regular_ns) if steps == 1 => {
                ((span_ns as f64 / regular_ns).round() as u64).saturating_sub(1)
            }
            _ => 0,
        }
    }

    /// Time since the newest frame by the stamps; `None` if the clock was set in between.
    fn span_ns(&self, frame: &FrameStamp) -> Option<i64> {
        let span_ns = frame.stamp.ns_since(self.newest.stamp);
        let received_ns = frame.received.ns_since(self.newest.received);
        let is_steady = span_ns.saturating_sub(received_ns).saturating_abs() < MAX_DELAY_CHANGE_NS;
        is_steady.then_some(span_ns)
    }

    /// Median interval, if the camera is regular.
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
        (sorted.iter().filter(is_regular).count() >= MIN_REGULAR).then_some(median_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INTERVAL_NS: i64 = 10_000_000;
    const CAMERA: CameraId = CameraId(1);

    /// Missing frames among these numbers and capture times (in intervals), received in this order.
    fn missing(frames: impl IntoIterator<Item = (u64, i64)>) -> u64 {
        let mut missing_frames = MissingFrames::default();
        let mut last_ns = 0;
        let observe = |(number, time): (u64, i64)| {
            let stamp_ns = time * INTERVAL_NS;
            // A late frame is received right after the one before it.
            last_ns = (stamp_ns + 5_000_000).max(last_ns + 1);
            let received = Timestamp::from_ns(last_ns);
            let stamp = Timestamp::from_ns(stamp_ns);
            missing_frames.observe(FrameStamp { camera: CAMERA, number, stamp, received })
        };
        frames.into_iter().map(observe).sum()
    }

    fn regular(frames: std::ops::Range<u64>) -> impl Iterator<Item = (u64, i64)> {
        frames.map(|frame| (frame, frame as i64))
    }

    #[test]
    fn skipped_numbers_count_as_missing_unless_they_arrive() {
        assert_eq!(missing(regular(1..400)), 0);
        assert_eq!(missing(regular(1..50).chain(regular(53..100))), 0, "they may still arrive");
        assert_eq!(missing(regular(1..50).chain(regular(53..400))), 3);
        let in_disorder = regular(1..50).chain([(52, 52), (50, 50), (53, 53), (51, 51)]);
        assert_eq!(missing(in_disorder.chain(regular(54..400))), 0);
        let one_of_three = regular(1..50).chain([(53, 53), (51, 51)]);
        assert_eq!(missing(one_of_three.chain(regular(54..400))), 2);
    }

    #[test]
    fn gaps_of_a_regular_interval_count_as_missing() {
        let later = |frames: std::ops::Range<u64>, by: i64| {
            frames.map(move |frame| (frame, frame as i64 + by))
        };
        assert_eq!(missing(regular(1..50).chain(later(50..400, 2))), 2);
        // A pause.
        assert_eq!(missing(regular(1..50).chain(later(50..400, 200))), 0);
        // Irregular.
        let squares = (1..30).map(|frame| (frame, (frame * frame) as i64));
        assert_eq!(missing(squares), 0);
        // A source that becomes half as fast is misjudged a few times.
        let slower = (50..400).map(|frame| (frame, 2 * frame as i64 - 49));
        assert!(missing(regular(1..50).chain(slower)) <= INTERVALS as u64);
    }

    #[test]
    fn clock_steps_and_restarted_numbers_count_nothing() {
        let restarted = (1..300).map(|frame| (frame, 50 + frame as i64));
        assert_eq!(missing(regular(1..50).chain(restarted)), 0);
        assert_eq!(missing(regular(1..50).chain([(u64::MAX, 50)])), 0);
        let mut missing_frames = MissingFrames::default();
        let mut count = 0;
        for frame in 1..300 {
            let received_ns = frame as i64 * INTERVAL_NS;
            let set_ns = if (100..200).contains(&frame) { 3_600_000_000_000 } else { 0 };
            let stamp = Timestamp::from_ns(received_ns + set_ns);
            let received = Timestamp::from_ns(received_ns);
            count += missing_frames.observe(FrameStamp {
                camera: CAMERA,
                number: frame,
                stamp,
                received,
            });
        }
        assert_eq!(count, 0);
    }
}
