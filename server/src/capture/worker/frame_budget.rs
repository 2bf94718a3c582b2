//! Time budget of a camera's frames: a share of the interval between them.
//!
//! Roundels are always followed and located by their rims. When the budget is spent, the remaining ones of the frame are
//! not fitted to the grey levels; those that have waited longest are fitted first
//! ([`roundel_core::pose::Locator::locate_all_until`]). So a camera keeps its rate, whatever its pictures show. Frames that
//! wait for the worker, such as those of a file played at full speed, have no budget.

use std::time::{Duration, Instant};

use roundel_core::time::Timestamp;

use super::statistics::RunningMedian;

/// Number of intervals from which a budget is set.
const MIN_INTERVALS: u32 = 8;
/// Longer intervals are gaps, seconds.
const MAX_INTERVAL_S: f64 = 2.0;

#[derive(Debug, Default)]
pub(super) struct FrameBudget {
    /// Share of the interval.
    share: f64,
    is_unpaced: bool,
    newest: Option<Timestamp>,
    intervals_s: RunningMedian,
    intervals: u32,
    used: RunningMedian,
}

impl FrameBudget {
    pub fn new(share: f64) -> Self {
        Self { share, ..Self::default() }
    }

    /// Starts again with another source ([`is_paced`](crate::capture::source::FrameSource::is_paced)).
    pub fn restart(&mut self, is_paced: bool) {
        *self = Self { is_unpaced: !is_paced, ..Self::new(self.share) };
    }

    /// Adds a frame, before which `missed` others did not reach the worker; returns its budget once the interval is known.
    pub fn add(&mut self, captured: Timestamp, missed: u64) -> Option<Duration> {
        if let Some(before) = self.newest.replace(captured) {
            let interval_s = captured.seconds_since(before) / missed.saturating_add(1) as f64;
            if interval_s > 0.0 && interval_s < MAX_INTERVAL_S {
                self.intervals_s.add(interval_s);
                self.intervals = self.intervals.saturating_add(1);
            }
        }
        let is_known = self.intervals >= MIN_INTERVALS && !self.is_unpaced;
        is_known.then(|| Duration::from_secs_f64(self.share * self.intervals_s.value()))
    }

    /// Adds the time that a frame with this budget took.
    pub fn note(&mut self, budget: Option<Duration>, begun: Instant) {
        if let Some(budget) = budget.filter(|budget| !budget.is_zero()) {
            self.used.add(begun.elapsed().as_secs_f64() / budget.as_secs_f64());
        }
    }

    /// Share of the budget that frames take, median; 0 while unknown.
    pub fn used(&self) -> f64 {
        self.used.value()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_budget_is_a_share_of_the_cameras_interval() {
        let mut budget = FrameBudget::new(0.5);
        let at = |number: f64| Timestamp::from_ns(1).plus_seconds(number / 20.0);
        for number in 0..8 {
            assert_eq!(budget.add(at(f64::from(number)), 0), None);
        }
        // Frames that were skipped do not lengthen the interval, and a gap does not count.
        let skipping = budget.add(at(11.0), 3).unwrap();
        let gap = budget.add(at(500.0), 0).unwrap();
        for budget in [skipping, gap] {
            assert!((budget.as_secs_f64() - 0.025).abs() < 1e-6, "{budget:?}");
        }
        budget.restart(true);
        assert_eq!(budget.add(at(501.0), 0), None);
    }

    #[test]
    fn frames_that_wait_for_the_worker_have_no_budget() {
        let mut budget = FrameBudget::new(0.5);
        budget.restart(false);
        for number in 0..20 {
            assert_eq!(budget.add(Timestamp::from_ns(number * 20_000_000), 0), None);
        }
    }
}
