//! The mapping of a camera's counter to the server's clock.

use std::collections::VecDeque;

use roundel_core::time::Timestamp;

/// Buckets of the window in which the least delay counts.
const DELAY_BUCKETS: usize = 10;
/// Length of a bucket: within the window, 100 ppm of skew amount to a millisecond.
const BUCKET_NS: i64 = 1_000_000_000;
/// A change of the delay by more than this means that the camera restarted or its clock was set.
const MAX_DELAY_CHANGE_NS: i64 = 1_000_000_000;
/// A frame that arrives faster than all others by more than this means that they were late.
const SETTLED_NS: i64 = 20_000_000;

/// Maps a camera's counter to the server's clock: stamp + min(arrival - stamp) over the last ten seconds.
#[derive(Clone, Debug, Default)]
pub struct CameraTimeline {
    /// Start of each bucket on the server's clock and the least delay in it, newest last.
    buckets: VecDeque<(Timestamp, i64)>,
}

impl CameraTimeline {
    /// Capture time of a frame with the camera's time stamp (ns since an arbitrary epoch); never later than its arrival.
    pub fn capture_time(&mut self, stamp_ns: i64, arrival: Timestamp) -> Timestamp {
        self.capture_time_before(stamp_ns, arrival, &[])
    }

    /// The same, when later frames have already arrived: their stamps and arrivals. After an interruption the first
    /// frames come late and all at once, so their own delays say little.
    pub fn capture_time_before(
        &mut self,
        stamp_ns: i64,
        arrival: Timestamp,
        following: &[(i64, Timestamp)],
    ) -> Timestamp {
        let delays = following.iter().map(|(stamp_ns, arrival)| delay_ns(*stamp_ns, *arrival));
        let new_least = delays.fold(delay_ns(stamp_ns, arrival), i64::min);
        if self
            .min_delay_ns()
            .is_some_and(|least| new_least.abs_diff(least) > MAX_DELAY_CHANGE_NS as u64)
        {
            self.buckets.clear();
        }
        match self.buckets.back_mut() {
            Some((begin, least)) if arrival.ns_since(*begin) < BUCKET_NS => {
                *least = new_least.min(*least);
            }
            _ => self.buckets.push_back((arrival, new_least)),
        }
        if self.buckets.len() > DELAY_BUCKETS {
            self.buckets.pop_front();
        }
        let least = self.min_delay_ns().unwrap_or(new_least);
        Timestamp::from_ns(stamp_ns.saturating_add(least))
    }

    /// Whether the delay of this frame does not fit those of earlier ones, so that later frames should be awaited.
    pub fn is_unsettled(&self, stamp_ns: i64, arrival: Timestamp) -> bool {
        self.min_delay_ns().is_none_or(|least| {
            let later_ns = delay_ns(stamp_ns, arrival).saturating_sub(least);
            !(-SETTLED_NS..=MAX_DELAY_CHANGE_NS).contains(&later_ns)
        })
    }

    fn min_delay_ns(&self) -> Option<i64> {
        self.buckets.iter().map(|(_, least)| *least).min()
    }
}

fn delay_ns(stamp_ns: i64, arrival: Timestamp) -> i64 {
    arrival.as_ns().saturating_sub(stamp_ns)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    /// Frames 40 ms apart, of a counter that begins at 7 s and is 50 ppm too fast. The delay is 20 ms, and up to 30 ms
    /// more except for every eighth frame.
    #[test]
    fn jitter_is_removed_and_the_least_delay_remains() {
        let mut timeline = CameraTimeline::default();
        for frame in 0..1000 {
            let truth = Timestamp::from_ns(1_700_000_000_000_000_000 + frame * 40 * MS);
            let stamp_ns = 7_000 * MS + frame * 40 * MS + frame * 40 * MS / 20_000;
            let jitter_ns = if frame % 8 == 0 { 0 } else { (frame * 7919) % 30 * MS };
            let arrival = truth.plus_ns(20 * MS + jitter_ns);
            let error_ms = timeline.capture_time(stamp_ns, arrival).seconds_since(truth) * 1e3;
            assert!((error_ms - 20.0).abs() < 0.6, "frame {frame}: {error_ms} ms");
        }
    }

    #[test]
    fn a_restart_of_the_camera_is_followed() {
        let mut timeline = CameraTimeline::default();
        let arrival = |ms: i64| Timestamp::from_ns(1_700_000_000_000_000_000 + ms * MS);
        timeline.capture_time(900_000 * MS, arrival(0));
        assert_eq!(timeline.capture_time(900_040 * MS, arrival(55)), arrival(40));
        // Its counter begins at 0 again.
        assert_eq!(timeline.capture_time(500 * MS, arrival(3000)), arrival(3000));
        assert_eq!(timeline.capture_time(540 * MS, arrival(3070)), arrival(3040));
    }

    #[test]
    fn frames_that_were_held_up_together_get_their_own_times() {
        let arrival = |ms: i64| Timestamp::from_ns(1_700_000_000_000_000_000 + ms * MS);
        // Two seconds of frames that arrive at once, the newest without delay.
        let frames: Vec<_> = (0..50).map(|frame| (frame * 40 * MS, arrival(1960))).collect();
        let mut at_the_start = CameraTimeline::default();
        assert!(at_the_start.is_unsettled(frames[0].0, frames[0].1));
        let mut later = CameraTimeline::default();
        later.capture_time(-40 * MS, arrival(-40));
        assert!(later.is_unsettled(frames[0].0, frames[0].1));
        for (index, (stamp_ns, arrived)) in frames.iter().enumerate() {
            for timeline in [&mut at_the_start, &mut later] {
                let following = &frames[index + 1..];
                let time = timeline.capture_time_before(*stamp_ns, *arrived, following);
                assert_eq!(time, arrival(index as i64 * 40), "{index}");
            }
        }
        assert!(!later.is_unsettled(2_000 * MS, arrival(2_010)));
        assert!(!later.is_unsettled(2_040 * MS, arrival(2_030)));
        assert!(later.is_unsettled(2_080 * MS, arrival(2_050)));
    }

    #[test]
    fn extreme_stamps_are_clamped_to_the_arrival() {
        let mut timeline = CameraTimeline::default();
        let now = Timestamp::from_ns(1_700_000_000_000_000_000);
        for stamp_ns in [i64::MAX, i64::MIN, 0, -1] {
            assert!(timeline.capture_time(stamp_ns, now) <= now, "{stamp_ns}");
        }
    }
}
