//! Exponential backoff between connection attempts.

use std::time::Duration;

const INITIAL: Duration = Duration::from_millis(100);
const MAX: Duration = Duration::from_secs(5);

/// Pauses that double up to a cap, with random jitter of up to half of each. The jitter spreads the reconnections of
/// many clients after a server restart.
#[derive(Debug, Default)]
pub(crate) struct Backoff {
    attempts: u32,
}

impl Backoff {
    /// The pause before the next attempt.
    pub fn next_pause(&mut self) -> Duration {
        let doubled = INITIAL.saturating_mul(1 << self.attempts.min(16));
        self.attempts = self.attempts.saturating_add(1);
        doubled.min(MAX).mul_f64(1.0 - 0.5 * fastrand::f64())
    }

    /// Starts over with a short pause, after a success.
    pub fn reset(&mut self) {
        self.attempts = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_to_the_cap_and_reset() {
        let mut backoff = Backoff::default();
        let first = backoff.next_pause();
        assert!(first <= INITIAL && first >= INITIAL / 2);
        let last = (0..100).map(|_| backoff.next_pause()).last().unwrap();
        assert!(last <= MAX && last >= MAX / 2);
        backoff.reset();
        assert!(backoff.next_pause() <= INITIAL);
    }
}
