//! Decides by their times which frames are used.
//!
//! Receiving times come from the server's one monotonic clock; capture times come from sources, whose clocks may jump.
//! Between two frames the capture times should advance as the receiving times do:
//!
//! - **lead** = (capture - newest capture) - (received - received then). A frame that leads by more than `max_lead_ns`
//!   is rejected: using it would make all others late. A pause of all cameras is no lead, since the receiving times
//!   show it too.
//! - A frame older than the late window is rejected as late.
//! - If rejected frames agree with one another for [`ADOPT_AFTER_NS`], by capture and by receiving times, and none has
//!   been accepted meanwhile, the timeline was wrong (its first frame came from the future, or the only camera's clock
//!   was set), and restarts with the rejected frames.
//!
//! A frame with the number or the capture time of an earlier one of the same camera is a duplicate.

use std::collections::{BTreeMap, VecDeque};

use super::FrameStamp;
use crate::world::FusionParams;
use roundel_vision::{id::CameraId, time::Timestamp};

/// Duration for which rejected frames must agree to restart the timeline.
const ADOPT_AFTER_NS: i64 = 1_000_000_000;
/// Smallest number of these frames.
const ADOPT_FRAMES: u32 = 10;
/// Frames remembered per camera to detect duplicates; at 1 kHz they cover the late window.
const REMEMBERED_FRAMES: usize = 512;

/// Verdict about a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    Use,
    /// Use it, after ending all tracks: the timeline has restarted.
    Restart,
    Duplicate,
    Late,
    Jumped,
}

#[derive(Clone, Copy, Debug)]
struct FrameInstant {
    capture: Timestamp,
    received: Timestamp,
}

#[derive(Clone, Copy, Debug)]
struct Candidate {
    since: FrameInstant,
    newest: FrameInstant,
    frames: u32,
}

/// Times of recent frames.
#[derive(Clone, Debug, Default)]
pub(crate) struct Timeline {
    newest: Option<FrameInstant>,
    candidate: Option<Candidate>,
    recent_frames: BTreeMap<CameraId, VecDeque<(u64, Timestamp)>>,
}

impl Timeline {
    /// Forgets a camera's frames.
    pub(crate) fn forget(&mut self, camera: CameraId) {
        self.recent_frames.remove(&camera);
    }

    /// Newest accepted capture time.
    pub(crate) fn newest(&self) -> Option<Timestamp> {
        self.newest.map(|newest| newest.capture)
    }

    /// Judges a frame and remembers it. `capture` is its corrected time.
    pub(crate) fn judge(
        &mut self,
        frame: &FrameStamp,
        capture: Timestamp,
        params: &FusionParams,
    ) -> Verdict {
        let FrameStamp { camera, number, stamp, received } = *frame;
        let FusionParams { late_window_ns, max_lead_ns, .. } = *params;
        let frames = self.recent_frames.entry(camera).or_default();
        if frames.iter().any(|&(other, time)| other == number || time == stamp) {
            return Verdict::Duplicate;
        }
        if frames.len() == REMEMBERED_FRAMES {
            frames.pop_front();
        }
        frames.push_back((number, stamp));
        let now = FrameInstant { capture, received };
        let Some(newest) = self.newest else {
            self.newest = Some(now);
            return Verdict::Use;
        };
        let late = newest.capture.ns_since(capture) > late_window_ns;
        let jumped = lead_ns(&now, &newest) > max_lead_ns;
        if !late && !jumped {
            self.candidate = None;
            if capture > newest.capture {
                self.newest = Some(now);
                for frames in self.recent_frames.values_mut() {
                    while frames.front().is_some_and(|&(_, time)| {
                        capture.ns_since(time) > late_window_ns.saturating_mul(2)
                    }) {
                        frames.pop_front();
                    }
                }
            }
            return Verdict::Use;
        }
        if self.adopt(now, max_lead_ns) {
            return Verdict::Restart;
        }
        if late { Verdict::Late } else { Verdict::Jumped }
    }

    /// Whether the rejected frames, with this one as the newest, have become the timeline.
    fn adopt(&mut self, now: FrameInstant, max_lead_ns: i64) -> bool {
        let agrees = |candidate: &Candidate| {
            lead_ns(&now, &candidate.newest).saturating_abs() <= max_lead_ns
        };
        let candidate = match self.candidate.filter(agrees) {
            Some(candidate) => Candidate {
                newest: if now.capture > candidate.newest.capture { now } else { candidate.newest },
                frames: candidate.frames.saturating_add(1),
                ..candidate
            },
            None => Candidate { since: now, newest: now, frames: 1 },
        };
        // Frames that a stalled link delivers at once agree as well, but arrive while others are accepted.
        let accepted = self.newest.map_or(candidate.since.received, |newest| newest.received);
        let span_ns = candidate
            .newest
            .capture
            .ns_since(candidate.since.capture)
            .min(now.received.ns_since(candidate.since.received.max(accepted)));
        if candidate.frames < ADOPT_FRAMES || span_ns < ADOPT_AFTER_NS {
            self.candidate = Some(candidate);
            return false;
        }
        self.candidate = None;
        self.newest = Some(candidate.newest);
        true
    }
}

fn lead_ns(now: &FrameInstant, then: &FrameInstant) -> i64 {
    now.capture.ns_since(then.capture).saturating_sub(now.received.ns_since(then.received))
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME_NS: i64 = 66_000_000;

    struct Feed(Timeline, u64);

    impl Feed {
        fn frame(&mut self, camera: u32, capture_ns: i64, received_ns: i64) -> Verdict {
            self.1 += 1;
            let [capture, received] = [capture_ns, received_ns].map(Timestamp::from_ns);
            let camera = CameraId(camera);
            let frame = FrameStamp { camera, number: self.1, stamp: capture, received };
            let params = FusionParams {
                late_window_ns: 100_000_000,
                max_lead_ns: 1_000_000_000,
                ..FusionParams::default()
            };
            self.0.judge(&frame, capture, &params)
        }
    }

    #[test]
    fn frames_that_a_stalled_link_delivers_at_once_are_late() {
        let mut feed = Feed(Timeline::default(), 0);
        let now_ns = 100 * FRAME_NS;
        assert_eq!(feed.frame(0, now_ns, now_ns), Verdict::Use);
        for number in 0..30 {
            let (capture_ns, received_ns) = (60 * FRAME_NS + number * FRAME_NS, now_ns + number);
            assert_eq!(feed.frame(1, capture_ns, received_ns), Verdict::Late, "{number}");
        }
        assert_eq!(feed.frame(0, now_ns + FRAME_NS, now_ns + FRAME_NS), Verdict::Use);
    }

    #[test]
    fn late_frames_with_the_senders_receiving_time_are_late() {
        let mut feed = Feed(Timeline::default(), 0);
        let now_ns = 100 * FRAME_NS;
        assert_eq!(feed.frame(0, now_ns, now_ns), Verdict::Use);
        for number in 60..95 {
            assert_eq!(feed.frame(1, number * FRAME_NS, number * FRAME_NS), Verdict::Late);
        }
        assert_eq!(feed.frame(0, now_ns + FRAME_NS, now_ns + FRAME_NS), Verdict::Use);
    }

    #[test]
    fn a_clock_step_back_restarts_the_timeline_after_a_second() {
        let mut feed = Feed(Timeline::default(), 0);
        assert_eq!(feed.frame(0, 1_000 * FRAME_NS, 0), Verdict::Use);
        let verdicts: Vec<_> =
            (1..=30).map(|number| feed.frame(0, number * FRAME_NS, number * FRAME_NS)).collect();
        let restarts = verdicts.iter().filter(|it| **it == Verdict::Restart).count();
        assert_eq!(restarts, 1, "{verdicts:?}");
        assert_eq!(verdicts.last(), Some(&Verdict::Use));
    }
}
