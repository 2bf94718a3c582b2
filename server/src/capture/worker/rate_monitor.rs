//! Compares the frame rate with the promised one.
//!
//! The rate includes frames that were skipped or broken: it judges the camera, not the worker. A deviation of more than
//! [`MAX_DEVIATION`] over [`WINDOW_S`] is reported, and its end once the deviation is within [`RESTORED_DEVIATION`], so
//! that a camera at the limit does not cause a series of events.

use roundel_core::time::Timestamp;

/// Measurement window, seconds.
const WINDOW_S: f64 = 5.0;
/// The window of slow cameras is extended to this many promised frames.
const MIN_FRAMES: f64 = 10.0;
const MAX_DEVIATION: f64 = 0.2;
const RESTORED_DEVIATION: f64 = 0.1;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum RateEvent {
    Off { found_hz: f64, promised_hz: f64 },
    Restored,
}

#[derive(Clone, Debug, Default)]
pub(super) struct RateMonitor {
    promised_hz: Option<f64>,
    /// Begin of the window, and frames since then.
    window: Option<(Timestamp, u64)>,
    is_off: bool,
}

impl RateMonitor {
    /// Restarts the measurement when a source was opened; a reported deviation stays reported.
    pub(super) fn restart(&mut self, promised_hz: Option<f64>) {
        self.promised_hz = promised_hz.filter(|hz| *hz > 0.0);
        self.window = None;
    }

    /// Counts frames that arrived until `time`.
    pub(super) fn add(&mut self, time: Timestamp, frames: u64) -> Option<RateEvent> {
        let promised_hz = self.promised_hz?;
        let Some((begin, arrived)) = &mut self.window else {
            // These frames arrived before the window.
            self.window = Some((time, 0));
            return None;
        };
        *arrived = arrived.saturating_add(frames);
        let elapsed_s = time.seconds_since(*begin);
        if elapsed_s < WINDOW_S.max(MIN_FRAMES / promised_hz) {
            return None;
        }
        let found_hz = *arrived as f64 / elapsed_s;
        self.window = Some((time, 0));
        let deviation = (found_hz / promised_hz - 1.0).abs();
        if deviation > MAX_DEVIATION && !self.is_off {
            self.is_off = true;
            return Some(RateEvent::Off { found_hz, promised_hz });
        }
        if deviation <= RESTORED_DEVIATION && self.is_off {
            self.is_off = false;
            return Some(RateEvent::Restored);
        }
        None
    }
}

/// Describes a deviation and its likely causes.
pub(super) fn rate_message(found_hz: f64, promised_hz: f64) -> String {
    let why = if found_hz < promised_hz {
        "many cameras expose longer in dim light (add light, or fix the exposure), and a cable, hub or network may be too \
         slow for its pictures"
    } else {
        "it is set to another rate; frames that arrive too fast to be searched are skipped"
    };
    format!("delivers {found_hz:.1} frames a second where {promised_hz:.1} were promised: {why}")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Events of frames at a rate.
    fn events(monitor: &mut RateMonitor, begin_s: f64, hz: f64, seconds: f64) -> Vec<RateEvent> {
        let times = (1..=(seconds * hz) as u32).map(|frame| begin_s + f64::from(frame) / hz);
        times.filter_map(|s| monitor.add(Timestamp::default().plus_seconds(s), 1)).collect()
    }

    fn monitor(promised_hz: f64) -> RateMonitor {
        let mut monitor = RateMonitor::default();
        monitor.restart(Some(promised_hz));
        monitor
    }

    #[test]
    fn a_deviation_is_reported_once_and_so_is_its_end() {
        let mut monitor = monitor(30.0);
        assert_eq!(events(&mut monitor, 0.0, 30.0, 20.0), []);
        assert_eq!(events(&mut monitor, 20.0, 27.0, 20.0), [], "a tenth is tolerated");
        let off = events(&mut monitor, 40.0, 15.0, 30.0);
        let [RateEvent::Off { found_hz, promised_hz }] = off[..] else { panic!("{off:?}") };
        assert!(found_hz < 24.0 && promised_hz == 30.0, "{off:?}");
        // Between the two limits nothing is reported.
        assert_eq!(events(&mut monitor, 70.0, 25.5, 20.0), []);
        assert_eq!(events(&mut monitor, 90.0, 30.0, 20.0), [RateEvent::Restored]);
        assert_eq!(events(&mut monitor, 110.0, 60.0, 20.0).len(), 1);
    }

    #[test]
    fn skipped_frames_count() {
        let mut monitor = monitor(30.0);
        let times = (1..300).map(|i| Timestamp::default().plus_seconds(f64::from(i) / 10.0));
        assert_eq!(times.filter_map(|time| monitor.add(time, 3)).count(), 0);
    }

    #[test]
    fn slow_cameras_are_judged_and_those_without_a_promise_are_not() {
        let mut monitor = monitor(1.0);
        assert_eq!(events(&mut monitor, 0.0, 0.5, 19.0).len(), 1);
        monitor.restart(None);
        assert_eq!(events(&mut monitor, 100.0, 0.5, 100.0), []);
    }

    #[test]
    fn messages_name_likely_causes() {
        let slow = rate_message(14.93, 30.0);
        assert!(
            slow.starts_with("delivers 14.9 frames a second where 30.0 were promised"),
            "{slow}"
        );
        assert!(slow.contains("fix the exposure"), "{slow}");
        assert!(rate_message(60.0, 30.0).contains("set to another rate"));
    }
}
