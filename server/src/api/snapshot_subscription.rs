//! Snapshots for one subscriber: always the newest one, with the number of those missed before it.
//!
//! A rate limit divides time into slots of 1 / rate and admits the snapshot nearest to the start of each slot. The mean rate
//! therefore equals the limit for any rate of the server. Snapshots between slots do not count as missed. Selections that
//! exceed their share of the processors are slowed down, too (`encoding_budget`); what they skip counts as missed.

use std::sync::{Arc, atomic::Ordering};

use axum::body::Bytes;
use roundel_core::time::Timestamp;
use tokio::sync::watch;

use crate::{
    api::{
        ApiState,
        encoding_budget::{EncodingAccount, EncodingShare},
        selection::Selection,
        snapshot_encoder::{Encoding, SubscriberFields},
    },
    model::hub::FusedSnapshot,
};

/// Limits from this rate on are ignored, since no server reaches it.
const UNLIMITED_HZ: f64 = 1e6;

#[derive(Debug)]
struct RateLimiter {
    /// `None`: no limit.
    slot_s: Option<f64>,
    /// A snapshot up to this much before the start of a slot belongs to it.
    tolerance_s: f64,
    next_slot: Option<Timestamp>,
    seen_sequence: Option<u64>,
}

impl RateLimiter {
    fn new(max_rate_hz: Option<f64>, server_rate_hz: f64) -> Self {
        let slot_s = max_rate_hz.filter(|&rate_hz| rate_hz < UNLIMITED_HZ).map(f64::recip);
        let server_period_s = if server_rate_hz > 0.0 { server_rate_hz.recip() } else { 0.0 };
        let tolerance_s = server_period_s.min(slot_s.unwrap_or(0.0)) / 2.0;
        Self { slot_s, tolerance_s, next_slot: None, seen_sequence: None }
    }

    /// The number of snapshots missed since the previous one; `None` if this one is not due.
    fn admit(&mut self, sequence: u64, time: Timestamp) -> Option<u64> {
        let skipped = match self.seen_sequence {
            Some(seen) => sequence.saturating_sub(seen + 1),
            None => 0,
        };
        self.seen_sequence = Some(sequence);
        let Some(slot_s) = self.slot_s else {
            return Some(skipped);
        };
        let Some(slot) = self.next_slot else {
            self.next_slot = Some(time.plus_seconds(slot_s));
            return Some(skipped);
        };
        // Number of slots without a snapshot before this one's.
        let late_slots = ((time.seconds_since(slot) + self.tolerance_s) / slot_s).floor();
        if late_slots >= 0.0 {
            self.next_slot = Some(slot.plus_seconds((late_slots + 1.0) * slot_s));
            return Some(skipped.min(late_slots as u64));
        }
        None
    }
}

/// An encoded snapshot for one subscriber.
#[derive(Clone, Debug)]
pub struct EncodedSnapshot {
    /// Fields that only this subscriber gets.
    pub own: SubscriberFields,
    /// All other fields, shared by the subscribers with the same filter.
    pub shared: Bytes,
}

/// Yields the newest snapshot to one subscriber, and counts those it skipped.
pub struct SnapshotSubscription {
    api: Arc<ApiState>,
    receiver: watch::Receiver<Arc<FusedSnapshot>>,
    selection: Selection,
    rate_limiter: RateLimiter,
    /// `None` for a filter that needs no encoding of its own.
    account: Option<EncodingAccount>,
}

impl SnapshotSubscription {
    /// Starts with the newest snapshot, if there is one. `share` is that of the client's connection.
    pub fn new(api: Arc<ApiState>, selection: Selection, share: Arc<EncodingShare>) -> Self {
        let mut receiver = api.hub.snapshots();
        let is_first_there = receiver.borrow_and_update().sequence > 0;
        if is_first_there {
            receiver.mark_changed();
        }
        let rate_limiter =
            RateLimiter::new(selection.max_rate_hz, api.hub.installation().snapshot_rate_hz);
        api.counters.snapshot_subscribers.fetch_add(1, Ordering::Relaxed);
        let account = (!selection.filter.selects_all())
            .then(|| EncodingAccount::new(api.encoding_budget.clone(), share));
        Self { api, receiver, selection, rate_limiter, account }
    }

    /// The next due snapshot; `None` when the hub is gone. Cancel safe.
    pub async fn next(&mut self, encoding: Encoding) -> Option<EncodedSnapshot> {
        loop {
            if let Some(account) = &self.account {
                account.turn().await;
            }
            self.receiver.changed().await.ok()?;
            let fused = self.receiver.borrow_and_update().clone();
            // The fusion times of a replay may run fast or backwards.
            let is_played = self.api.replay.is_some();
            let time = if is_played { self.api.clock.now() } else { fused.fused_time };
            let Some(missed) = self.rate_limiter.admit(fused.sequence, time) else {
                continue;
            };
            let (api, filter) = (&self.api, &self.selection.filter);
            let (shared, cost) = api.encoder.shared_at_cost(&api.hub, &fused, filter, encoding);
            if let Some(account) = &mut self.account {
                account.charge(cost);
            }
            let own = SubscriberFields { sent_time_ns: api.clock.now().as_ns(), missed };
            self.api.counters.snapshots_sent.fetch_add(1, Ordering::Relaxed);
            self.api.counters.snapshots_missed.fetch_add(missed, Ordering::Relaxed);
            return Some(EncodedSnapshot { own, shared });
        }
    }
}

impl Drop for SnapshotSubscription {
    fn drop(&mut self) {
        self.api.counters.snapshot_subscribers.fetch_sub(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Offers the snapshots with these numbers, made at 60 Hz, and returns those admitted with their missed counts.
    fn admitted(
        max_rate_hz: Option<f64>,
        places: impl IntoIterator<Item = u64>,
    ) -> Vec<(u64, u64)> {
        let mut rate_limiter = RateLimiter::new(max_rate_hz, 60.0);
        let start = Timestamp::from_ns(1_700_000_000_000_000_000);
        let offer = |place: u64| {
            // Publishing jitters.
            let jitter_s = if place.is_multiple_of(2) { 0.001 } else { -0.001 };
            let time = start.plus_seconds(place as f64 / 60.0 + jitter_s);
            rate_limiter.admit(place, time).map(|missed| (place, missed))
        };
        places.into_iter().filter_map(offer).collect()
    }

    #[test]
    fn without_a_limit_each_is_due_and_gaps_are_missed() {
        assert_eq!(admitted(None, [7, 8, 12, 13]), [(7, 0), (8, 0), (12, 3), (13, 0)]);
    }

    #[test]
    fn a_rate_limit_is_met_on_average_without_missed_snapshots() {
        for (rate_hz, expected) in [(60.0, 600), (50.0, 500), (30.0, 300), (7.0, 70), (1.0, 10)] {
            let admitted = admitted(Some(rate_hz), 0..600);
            assert!(admitted.len().abs_diff(expected) <= 1, "{rate_hz}: {}", admitted.len());
            assert!(admitted.iter().all(|&(_, missed)| missed == 0), "{rate_hz}");
        }
    }

    #[test]
    fn a_limit_above_the_servers_rate_changes_nothing() {
        let admitted = admitted(Some(1000.0), (0..60).chain(70..80));
        assert_eq!(admitted.len(), 70);
        assert_eq!(admitted.iter().map(|&(_, missed)| missed).sum::<u64>(), 10);
        assert_eq!(admitted[60], (70, 10));
    }

    #[test]
    fn a_slow_subscriber_with_a_limit_misses_slots_and_not_snapshots() {
        // One second without reading at 30 Hz: 60 snapshots passed in 30 slots, and only the last one is delivered.
        let admitted = admitted(Some(30.0), (0..60).chain(120..180));
        let missed: u64 = admitted.iter().map(|&(_, missed)| missed).sum();
        assert_eq!(admitted.len() as u64 + missed, 90);
        assert_eq!(missed, 30);
    }
}
