//! Processor time for the encodings of selections.
//!
//! Subscribers with equal filters share an encoding, so those that select nothing cost the same for any number of them.
//! Each different selection costs an encoding of its own. These encodings together get a share of the processors: once
//! they exceed it, a connection that has used more than its part of the share waits before its next encoding, and then
//! gets the newest snapshot. A connection with few selections is not delayed by one with thousands.
//!
//! An encoding of length c moves the paid time of its connection forward by c · n / s, where n is the number of
//! connections with selections and s the share in processors, and the paid time of all connections by c / s. A connection
//! waits until its paid time while the common one lies in the future.

use std::{
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};

/// Encodings may exceed the share for this long before any waits: a few snapshots.
const TOLERANCE: Duration = Duration::from_millis(50);
/// Longest time that is paid in advance.
const MAX_COMMON_DEBT: Duration = Duration::from_millis(500);
const MAX_DEBT: Duration = Duration::from_secs(5);

/// The share of all connections.
pub struct EncodingBudget {
    processors: f64,
    paid_until: Mutex<Option<Instant>>,
    sharers: AtomicUsize,
}

impl Default for EncodingBudget {
    /// An eighth of the processors.
    fn default() -> Self {
        let processors = std::thread::available_parallelism().map_or(1, |count| count.get());
        Self::new(processors as f64 / 8.0)
    }
}

impl EncodingBudget {
    pub fn new(processors: f64) -> Self {
        Self { processors, paid_until: Mutex::default(), sharers: AtomicUsize::new(0) }
    }

    /// Charges an encoding of one connection, and returns from when on the next one may begin; `None`: at once.
    fn charge(&self, share: &EncodingShare, cost: Duration, now: Instant) -> Option<Instant> {
        let cost = cost.div_f64(self.processors);
        let sharers = self.sharers.load(Ordering::Relaxed).max(1) as f64;
        let common = advance(&self.paid_until, now, cost, MAX_COMMON_DEBT);
        let own = advance(&share.paid_until, now, cost.mul_f64(sharers), MAX_DEBT);
        (common > now + TOLERANCE && own > now + TOLERANCE).then_some(own)
    }
}

/// Moves a paid time forward from `now` or later, and returns it.
fn advance(
    paid_until: &Mutex<Option<Instant>>,
    now: Instant,
    by: Duration,
    most: Duration,
) -> Instant {
    let mut paid_until = paid_until.lock().unwrap_or_else(PoisonError::into_inner);
    let from = paid_until.map_or(now, |paid| paid.max(now));
    *paid_until.insert((from + by).min(now + most))
}

/// The part of one connection, which its subscriptions hold.
#[derive(Default)]
pub struct EncodingShare {
    paid_until: Mutex<Option<Instant>>,
    subscriptions: AtomicUsize,
}

/// The access of one subscription with a selection to its connection's part.
pub(super) struct EncodingAccount {
    budget: Arc<EncodingBudget>,
    share: Arc<EncodingShare>,
    /// When the next encoding may begin.
    turn: Option<Instant>,
}

impl EncodingAccount {
    pub(super) fn new(budget: Arc<EncodingBudget>, share: Arc<EncodingShare>) -> Self {
        if share.subscriptions.fetch_add(1, Ordering::Relaxed) == 0 {
            budget.sharers.fetch_add(1, Ordering::Relaxed);
        }
        // A connection does not avoid its turn with a new subscription.
        let turn = *share.paid_until.lock().unwrap_or_else(PoisonError::into_inner);
        let is_far = |turn: &Instant| *turn > Instant::now() + TOLERANCE;
        Self { budget, share, turn: turn.filter(is_far) }
    }

    /// Waits until the next encoding may begin. Cancel safe.
    pub(super) async fn turn(&self) {
        if let Some(turn) = self.turn {
            tokio::time::sleep_until(turn.into()).await;
        }
    }

    pub(super) fn charge(&mut self, cost: Duration) {
        self.turn = self.budget.charge(&self.share, cost, Instant::now());
    }
}

impl Drop for EncodingAccount {
    fn drop(&mut self) {
        if self.share.subscriptions.fetch_sub(1, Ordering::Relaxed) == 1 {
            self.budget.sharers.fetch_sub(1, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    /// Encodings of 1 ms that each connection gets within a simulated second. Each of its subscriptions makes one per tick
    /// of a 60 Hz server unless it has to wait.
    fn encodings(budget: &Arc<EncodingBudget>, subscriptions: &[usize]) -> Vec<usize> {
        let account =
            |share: &Arc<EncodingShare>| EncodingAccount::new(budget.clone(), share.clone());
        let mut connections: Vec<Vec<EncodingAccount>> = subscriptions
            .iter()
            .map(|&count| {
                let share = Arc::new(EncodingShare::default());
                (0..count).map(|_| account(&share)).collect()
            })
            .collect();
        let begin = Instant::now();
        let mut counts = vec![0; connections.len()];
        for tick in 0..60 {
            let now = begin + tick * Duration::from_secs(1) / 60;
            for (accounts, count) in connections.iter_mut().zip(&mut counts) {
                for account in
                    accounts.iter_mut().filter(|it| it.turn.is_none_or(|turn| turn <= now))
                {
                    account.turn = account.budget.charge(&account.share, MS, now);
                    *count += 1;
                }
            }
        }
        counts
    }

    #[test]
    fn within_the_share_every_snapshot_is_encoded() {
        let budget = Arc::new(EncodingBudget::new(0.5));
        assert_eq!(encodings(&budget, &[3, 4]), [180, 240], "0.42 processors");
    }

    #[test]
    fn a_connection_with_many_selections_does_not_delay_one_with_few() {
        let budget = Arc::new(EncodingBudget::new(0.5));
        let counts = encodings(&budget, &[1, 500, 500, 1]);
        assert_eq!([counts[0], counts[3]], [60, 60]);
        // Each new subscription has one encoding before it has to wait.
        assert!(counts[1] + counts[2] < 1000 + 500, "{counts:?}");
        assert_eq!(budget.sharers.load(Ordering::Relaxed), 0, "all have ended");
    }
}
