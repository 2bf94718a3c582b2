//! Instants as nanoseconds since the Unix epoch. Reads no clock.

use std::fmt;

/// An instant: nanoseconds since the Unix epoch. Covers the years 1677 to 2262.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Timestamp(i64);

impl Timestamp {
    /// The instant `ns` nanoseconds after the Unix epoch.
    pub const fn from_ns(ns: i64) -> Self {
        Self(ns)
    }

    /// Nanoseconds since the Unix epoch.
    pub const fn as_ns(self) -> i64 {
        self.0
    }

    /// Seconds from `earlier` to this instant; negative if `earlier` is later.
    pub fn seconds_since(self, earlier: Timestamp) -> f64 {
        self.ns_since(earlier) as f64 * 1e-9
    }

    /// Nanoseconds from `earlier` to this instant, saturating.
    pub fn ns_since(self, earlier: Timestamp) -> i64 {
        self.0.saturating_sub(earlier.0)
    }

    /// The instant `seconds` later (earlier if negative), rounded to nanoseconds.
    pub fn plus_seconds(self, seconds: f64) -> Self {
        Self(self.0.saturating_add((seconds * 1e9).round() as i64))
    }

    /// The instant `ns` later, saturating.
    pub fn plus_ns(self, ns: i64) -> Self {
        Self(self.0.saturating_add(ns))
    }
}

impl fmt::Display for Timestamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (seconds, rest) = (self.0.div_euclid(1_000_000_000), self.0.rem_euclid(1_000_000_000));
        write!(f, "{seconds}.{rest:09} s")
    }
}

/// Middle of the exposure of row `v_px` of an image of `height` rows, if the middle row was exposed
/// at `frame` and each row follows the one above it by `line_time_s` (0 for a global shutter).
pub fn row_time(frame: Timestamp, v_px: f64, height: usize, line_time_s: f64) -> Timestamp {
    frame.plus_seconds((v_px - 0.5 * (height as f64 - 1.0)) * line_time_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nanoseconds_survive_far_from_the_epoch() {
        let t = Timestamp::from_ns(1_800_000_000_000_000_001);
        assert_eq!(t.plus_seconds(1e-9).ns_since(t), 1);
        assert_eq!(t.plus_seconds(-0.5).seconds_since(t), -0.5);
        assert_eq!(t.to_string(), "1800000000.000000001 s");
    }

    #[test]
    fn extremes_do_not_overflow() {
        let (first, last) = (Timestamp::from_ns(i64::MIN), Timestamp::from_ns(i64::MAX));
        assert_eq!(last.ns_since(first), i64::MAX);
        assert_eq!(last.plus_ns(1), last);
        assert_eq!(first.plus_seconds(-1.0), first);
    }
}
