//! The clock of a server: monotonic, anchored to Unix time at start, so that corrections of the system's clock do not move
//! capture times.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use roundel_core::time::Timestamp;

#[derive(Clone, Copy, Debug)]
pub struct Clock {
    anchor: Instant,
    anchor_time: Timestamp,
}

impl Clock {
    pub fn anchored_now() -> Self {
        let unix = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let ns = i64::try_from(unix.as_nanos()).unwrap_or(i64::MAX);
        Self::anchored(Instant::now(), Timestamp::from_ns(ns))
    }

    /// `anchor` is `anchor_time`, as in the playback of a recording.
    pub fn anchored(anchor: Instant, anchor_time: Timestamp) -> Self {
        Self { anchor, anchor_time }
    }

    /// The anchor, the earliest time of this clock.
    pub fn start(&self) -> Timestamp {
        self.anchor_time
    }

    pub fn now(&self) -> Timestamp {
        self.at(Instant::now())
    }

    /// Earlier instants than the anchor map to it.
    pub fn at(&self, instant: Instant) -> Timestamp {
        let elapsed = instant.saturating_duration_since(self.anchor);
        self.anchor_time.plus_ns(i64::try_from(elapsed.as_nanos()).unwrap_or(i64::MAX))
    }

    /// Duration from now to `time`; zero if it has passed.
    pub fn until(&self, time: Timestamp) -> Duration {
        Duration::from_nanos(u64::try_from(time.ns_since(self.now())).unwrap_or(0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_runs_forward_from_the_anchor() {
        let clock = Clock::anchored_now();
        let first = clock.now();
        assert!(clock.now() >= first);
        assert_eq!(
            clock.at(clock.anchor + Duration::from_millis(3)).ns_since(clock.anchor_time),
            3_000_000
        );
        assert_eq!(clock.until(first.plus_seconds(-1.0)), Duration::ZERO);
    }
}
