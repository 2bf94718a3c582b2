//! Whether a camera gives as many frames a second as was promised.
//!
//! All frames that come count, those too that are left out because the worker is busy, or that are broken: this judges
//! the camera, not the worker. A rate that is off by more than [`MAX_DEVIATION`] over [`WINDOW_S`] is told; it is taken back once
//! it is within [`RESTORED_DEVIATION`], so that a camera on the edge is not told of again and again.

use std::collections::VecDeque;

use roundel_core::time::Timestamp;

/// Over so long a rate is taken, seconds.
const WINDOW_S: f64 = 5.0;
/// Frames that it is taken from at least, so that a camera of 0.5 Hz is judged too.
const MIN_FRAMES: u64 = 10;
/// Off by this share: told.
const MAX_DEVIATION: f64 = 0.2;
/// Off by no more than this share: taken back.
const RESTORED_DEVIATION: f64 = 0.1;
/// Arrivals remembered at most, whatever the rate.
const MAX_ARRIVALS: usize = 16_384;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum RateEvent {
    /// It gives so many a second, and so many were promised.
    Off { found_hz: f64, promised_hz: f64 },
    /// It gives what was promised again.
    Restored,
}

/// Counts what comes against what was promised.
#[derive(Clone, Debug, Default)]
pub(super) struct RateMonitor {
    promised_hz: Option<f64>,
    /// When frames came, and how many with it.
    arrivals: VecDeque<(Timestamp, u64)>,
    is_off: bool,
}

impl RateMonitor {
    /// Of a source that was opened just now; what was told stays told.
    pub(super) fn restart(&mut self, promised_hz: Option<f64>) {
        self.promised_hz = promised_hz.filter(|hz| *hz > 0.0);
        self.arrivals.clear();
    }

    /// So many frames came until `time`. What is new to tell.
    pub(super) fn add(&mut self, time: Timestamp, frames: u64) -> Option<RateEvent> {
        let promised_hz = self.promised_hz?;
        self.arrivals.push_back((time, frames));
        let window_s = WINDOW_S.max(MIN_FRAMES as f64 / promised_hz);
        let (first, _) = *self.arrivals.front()?;
        let elapsed_s = time.seconds_since(first);
        if elapsed_s < window_s && self.arrivals.len() < MAX_ARRIVALS {
            return None;
        }
        // What came at the beginning of the window came before it.
        let came: u64 = self.arrivals.iter().skip(1).map(|(_, frames)| frames).sum();
        self.arrivals.clear();
        self.arrivals.push_back((time, frames));
        let found_hz = came as f64 / elapsed_s;
        let off = (found_hz / promised_hz - 1.0).abs();
        if off > MAX_DEVIATION && !self.is_off {
            self.is_off = true;
            return Some(RateEvent::Off { found_hz, promised_hz });
        }
        if off <= RESTORED_DEVIATION && self.is_off {
            self.is_off = false;
            return Some(RateEvent::Restored);
        }
        None
    }
}

/// What a person is told of a rate that is off, and what may be the reason.
pub(super) fn rate_message(found_hz: f64, promised_hz: f64) -> String {
    let why = if found_hz < promised_hz {
        "many cameras expose longer in dim light (more light, or a fixed exposure), and a cable, hub or network may be \
         too slow for its pictures"
    } else {
        "it was set otherwise than was said; what comes too fast to be searched is left out"
    };
    format!("gives {found_hz:.1} frames a second where {promised_hz:.1} were promised: {why}")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is told of frames at that rate for so long.
    fn told(
        rate_monitor: &mut RateMonitor,
        begin_s: f64,
        rate_hz: f64,
        seconds: f64,
    ) -> Vec<RateEvent> {
        let frames = (seconds * rate_hz) as u32;
        let times = (1..=frames).map(|frame| begin_s + f64::from(frame) / rate_hz);
        times.filter_map(|s| rate_monitor.add(Timestamp::default().plus_seconds(s), 1)).collect()
    }

    #[test]
    fn a_rate_that_is_off_is_told_once_and_taken_back_once() {
        let mut rate_monitor = RateMonitor::default();
        rate_monitor.restart(Some(30.0));
        assert_eq!(told(&mut rate_monitor, 0.0, 30.0, 20.0), []);
        assert_eq!(told(&mut rate_monitor, 20.0, 27.0, 20.0), [], "a tenth is no lie");
        let lies = told(&mut rate_monitor, 40.0, 15.0, 30.0);
        let [RateEvent::Off { found_hz, promised_hz }] = lies[..] else { panic!("{lies:?}") };
        assert!(found_hz < 24.0 && promised_hz == 30.0, "{lies:?}");
        // Neither told again nor taken back on the edge.
        assert_eq!(told(&mut rate_monitor, 70.0, 25.5, 20.0), []);
        assert_eq!(told(&mut rate_monitor, 90.0, 30.0, 20.0), [RateEvent::Restored]);
        assert_eq!(told(&mut rate_monitor, 110.0, 60.0, 20.0).len(), 1);
    }

    #[test]
    fn frames_that_are_left_out_have_come() {
        let mut rate_monitor = RateMonitor::default();
        rate_monitor.restart(Some(30.0));
        let times =
            (1..300).map(|frame| Timestamp::default().plus_seconds(f64::from(frame) / 10.0));
        let told: Vec<RateEvent> = times.filter_map(|time| rate_monitor.add(time, 3)).collect();
        assert_eq!(told, []);
    }

    #[test]
    fn slow_cameras_are_judged_and_those_without_a_promise_are_not() {
        let mut rate_monitor = RateMonitor::default();
        rate_monitor.restart(Some(1.0));
        assert_eq!(told(&mut rate_monitor, 0.0, 0.5, 19.0).len(), 1);
        rate_monitor.restart(None);
        assert_eq!(told(&mut rate_monitor, 100.0, 0.5, 100.0), []);
    }

    #[test]
    fn what_is_told_says_what_may_be_done() {
        let slow = rate_message(14.93, 30.0);
        assert!(slow.starts_with("gives 14.9 frames a second where 30.0 were promised"), "{slow}");
        assert!(slow.contains("fixed exposure"), "{slow}");
        assert!(rate_message(60.0, 30.0).contains("set otherwise"));
    }
}
