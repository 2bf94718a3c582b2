//! When what a filter was told of its object does not hold any more: Page's cumulative sum (*Continuous inspection
//! schemes*, 1954) of the evidence against it, which never falls below none.

/// Evidence for a manoeuvre, e⁸ to one …
const ALARM_LOG_RATIO: f64 = 8.0;
/// … of which a single measurement says so much at most.
const LOG_LIMIT: f64 = 6.0;
/// Unseen for so long, an object may have begun one.
pub(super) const UNSEEN_S: f64 = 0.15;

/// The evidence so far, as a logarithm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Alarm(f64);

impl Alarm {
    /// Adds the logarithm of a likelihood ratio; true, and all is forgotten, if that is enough for a manoeuvre.
    pub(super) fn is_raised_by(&mut self, log_ratio: f64) -> bool {
        self.0 = (self.0 + log_ratio.min(LOG_LIMIT)).max(0.0);
        let is_raised = self.0 > ALARM_LOG_RATIO;
        if is_raised {
            self.forget();
        }
        is_raised
    }

    /// The same of a logarithm that is no more than `most`, and is asked for where that does not settle it.
    pub(super) fn is_raised_at_most(&mut self, most: f64, log_ratio: impl FnOnce() -> f64) -> bool {
        if self.0 + most <= 0.0 {
            self.forget();
            return false;
        }
        self.is_raised_by(log_ratio())
    }

    /// Makes it as new.
    pub(super) fn forget(&mut self) {
        self.0 = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_measurement_is_no_manoeuvre_and_two_may_be() {
        let mut alarm = Alarm::default();
        assert!(!alarm.is_raised_by(1e9));
        assert!(alarm.is_raised_by(2.5), "6 and 2.5 are more than 8");
        assert!(!alarm.is_raised_by(6.0), "the first ones are forgotten");
    }

    #[test]
    fn what_speaks_against_it_never_counts_for_later() {
        let mut alarm = Alarm::default();
        (0..1000).for_each(|_| assert!(!alarm.is_raised_by(-5.0)));
        assert!(!alarm.is_raised_by(5.0));
        assert!(alarm.is_raised_by(5.0));
    }

    #[test]
    fn a_logarithm_is_asked_for_only_where_it_counts() {
        let mut alarm = Alarm::default();
        assert!(!alarm.is_raised_at_most(-1.0, || panic!("it is below none anyway")));
        assert!(!alarm.is_raised_at_most(9.0, || 5.0));
        assert!(!alarm.is_raised_at_most(-2.0, || -3.0), "2 are left");
        assert!(!alarm.is_raised_at_most(-2.0, || panic!("nothing is left")));
        assert!(!alarm.is_raised_at_most(9.0, || 6.0));
        assert!(alarm.is_raised_at_most(9.0, || 3.0));
    }
}
