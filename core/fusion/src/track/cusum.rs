//! Detection of manoeuvres: Page's cumulative sum (*Continuous inspection schemes*, 1954) of log-likelihood ratios,
//! bounded below by zero.

/// Log-odds at which a manoeuvre is reported.
const THRESHOLD: f64 = 8.0;
/// Largest contribution of a single measurement.
const MAX_LOG_RATIO: f64 = 6.0;
/// An object that was not observed for this long may have begun a manoeuvre, seconds.
pub(super) const UNOBSERVED_S: f64 = 0.15;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Cusum(f64);

impl Cusum {
    /// Adds a log-likelihood ratio. Returns true and resets when the threshold is passed.
    pub(super) fn is_raised_by(&mut self, log_ratio: f64) -> bool {
        self.0 = (self.0 + log_ratio.min(MAX_LOG_RATIO)).max(0.0);
        let is_raised = self.0 > THRESHOLD;
        if is_raised {
            self.reset();
        }
        is_raised
    }

    pub(super) fn reset(&mut self) {
        self.0 = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_measurement_is_not_enough() {
        let mut cusum = Cusum::default();
        assert!(!cusum.is_raised_by(1e9));
        assert!(cusum.is_raised_by(2.5), "6 and 2.5 are more than 8");
        assert!(!cusum.is_raised_by(6.0), "the sum was reset");
    }

    #[test]
    fn evidence_against_does_not_accumulate() {
        let mut cusum = Cusum::default();
        (0..1000).for_each(|_| assert!(!cusum.is_raised_by(-5.0)));
        assert!(!cusum.is_raised_by(5.0));
        assert!(cusum.is_raised_by(5.0));
    }
}
