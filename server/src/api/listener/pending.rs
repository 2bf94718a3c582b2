//! Connections whose first request has not arrived yet.
//!
//! Their number is bounded: when a new connection exceeds it, the oldest ones that have had time to send a request are
//! closed. `ApiLimits::request_timeout` closes the others.

use std::{
    collections::VecDeque,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use tokio::sync::Notify;

const MAX_PENDING: usize = 256;
/// A pending connection is not evicted before this age.
const MIN_AGE: Duration = Duration::from_secs(1);

#[derive(Default)]
pub(super) struct PendingConnections(VecDeque<Arc<Pending>>);

pub(super) struct Pending {
    since: Instant,
    is_over: AtomicBool,
    eviction: Notify,
}

impl PendingConnections {
    /// Adds a connection, and evicts old ones if there are too many.
    pub(super) fn add(&mut self) -> Arc<Pending> {
        if self.0.len() >= MAX_PENDING {
            self.0.retain(|connection| !connection.is_over());
        }
        while self.0.len() >= MAX_PENDING
            && let Some(oldest) = self.0.front()
            && oldest.since.elapsed() > MIN_AGE
        {
            oldest.eviction.notify_one();
            self.0.pop_front();
        }
        let connection = Arc::new(Pending {
            since: Instant::now(),
            is_over: AtomicBool::new(false),
            eviction: Notify::new(),
        });
        self.0.push_back(connection.clone());
        connection
    }
}

impl Pending {
    /// Marks the connection as established or closed: it is no longer counted.
    pub(super) fn end(&self) {
        self.is_over.store(true, Ordering::Relaxed);
    }

    pub(super) fn is_over(&self) -> bool {
        self.is_over.load(Ordering::Relaxed)
    }

    /// Completes when the connection must be closed in favour of a newer one.
    pub(super) async fn evicted(&self) {
        self.eviction.notified().await;
    }
}

#[cfg(test)]
mod tests {
    use futures::FutureExt as _;

    use super::*;

    #[test]
    fn old_pending_connections_are_evicted_for_new_ones() {
        let mut pending = PendingConnections::default();
        let mut added: Vec<_> = (0..MAX_PENDING).map(|_| pending.add()).collect();
        let is_evicted = |it: &Arc<Pending>| it.evicted().now_or_never().is_some();
        added.push(pending.add());
        assert!(!added.iter().any(is_evicted), "none is old enough");
        std::thread::sleep(MIN_AGE);
        added[0].end();
        let newest = pending.add();
        assert!(!is_evicted(&added[0]) && is_evicted(&added[1]), "the first one was over");
        assert!(!is_evicted(&added[3]) && !is_evicted(&newest));
    }
}
