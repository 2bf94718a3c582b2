//! Rates and medians over the newest frames.

use std::collections::VecDeque;

use roundel_core::time::Timestamp;

/// Number of values of a median.
const MEDIAN_OVER: usize = 61;
/// Window of a rate.
const RATE_OVER_S: f64 = 3.0;
/// Limit of stored times.
const MAX_TIMES: usize = 4096;

/// Median of the newest values.
#[derive(Clone, Debug, Default)]
pub struct RunningMedian(VecDeque<f64>);

impl RunningMedian {
    /// Adds a value, and drops the oldest one if there are too many.
    pub fn add(&mut self, value: f64) {
        if self.0.len() == MEDIAN_OVER {
            self.0.pop_front();
        }
        self.0.push_back(value);
    }

    /// The median; 0 before the first value.
    pub fn value(&self) -> f64 {
        let mut sorted: Vec<f64> = self.0.iter().copied().collect();
        if sorted.is_empty() {
            return 0.0;
        }
        let middle = sorted.len() / 2;
        *sorted.select_nth_unstable_by(middle, f64::total_cmp).1
    }
}

/// Mean rate of the last seconds.
#[derive(Clone, Debug, Default)]
pub struct RateMeter(VecDeque<Timestamp>);

impl RateMeter {
    /// Counts an event; times must not decrease.
    pub fn add(&mut self, time: Timestamp) {
        self.0.push_back(time);
        while self.0.len() > MAX_TIMES
            || self.0.front().is_some_and(|old| time.seconds_since(*old) > RATE_OVER_S)
        {
            self.0.pop_front();
        }
    }

    /// Intervals a second; 0 with fewer than two events.
    pub fn hz(&self) -> f64 {
        match (self.0.front(), self.0.back()) {
            (Some(first), Some(last)) if last > first => {
                (self.0.len() - 1) as f64 / last.seconds_since(*first)
            }
            _ => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_ignores_outliers_and_old_values() {
        let mut median = RunningMedian::default();
        assert_eq!(median.value(), 0.0);
        for value in [1e9, 3.0, 1.0, 2.0, -1e9] {
            median.add(value);
        }
        assert_eq!(median.value(), 2.0);
        (0..MEDIAN_OVER).for_each(|_| median.add(7.0));
        assert_eq!(median.value(), 7.0);
    }

    #[test]
    fn the_rate_is_that_of_the_last_seconds() {
        let mut rate = RateMeter::default();
        assert_eq!(rate.hz(), 0.0);
        (0..100).for_each(|i| rate.add(Timestamp::default().plus_seconds(f64::from(i))));
        assert!((rate.hz() - 1.0).abs() < 1e-9);
        (0..400)
            .for_each(|i| rate.add(Timestamp::default().plus_seconds(100.0 + f64::from(i) * 0.01)));
        assert!((rate.hz() - 100.0).abs() < 1e-6, "{}", rate.hz());
    }
}
