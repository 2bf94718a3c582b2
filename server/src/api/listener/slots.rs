//! The slots of connections, and which connection gives its slot to a new one.
//!
//! A connection is *idle* while none of its requests is being answered: it waits for a request, or for the rest of one.
//! When all slots are taken, or all that one peer may have, the connection that has been idle for the longest time is
//! closed, unless that is shorter than [`MIN_IDLE`]. So clients that hold connections open, or send requests slowly, do
//! not lock out others, and those that receive something keep their connections.

use std::{
    collections::HashMap,
    net::{IpAddr, Ipv6Addr},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};

use axum::http::Extensions;
use tokio::{
    sync::{Notify, OwnedSemaphorePermit, Semaphore},
    time::sleep,
};

use crate::api::{ApiLimits, ApiState, encoding_budget::EncodingShare, error::ApiError};

/// Refused connections that may wait for their error response; further ones are closed without a response.
const MAX_REFUSALS: usize = 32;
/// Streams of events, observations and calibrations of one connection.
const STREAMS_PER_CONNECTION: usize = 16;
/// An idle connection is not closed for another one before this time.
const MIN_IDLE: Duration = Duration::from_secs(1);
/// How often a new connection looks for a slot after another one was closed, and how long it waits between.
const ATTEMPTS: u32 = 25;
const ATTEMPT_INTERVAL: Duration = Duration::from_millis(20);

/// The slots of all connections.
pub(super) struct Slots {
    max_clients: usize,
    max_per_peer: usize,
    free: Arc<Semaphore>,
    refusals: Arc<Semaphore>,
    /// Connections with a slot, except upgraded ones.
    open: Mutex<Vec<Arc<Activity>>>,
    per_peer: Mutex<HashMap<IpAddr, usize>>,
}

/// Why there is no slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Full {
    Peer,
    Server,
}

/// Whether a connection got a slot.
pub(super) enum Admission {
    Admitted(Arc<ConnectionSlot>),
    Refused(Refusal),
}

pub(super) struct Refusal {
    full: Full,
    /// Lasts as long as the connection; without one the client is not answered.
    permit: Option<OwnedSemaphorePermit>,
}

impl Slots {
    pub(super) fn new(limits: &ApiLimits) -> Self {
        // An upper bound of tokio's semaphores, far above the number of open files.
        let max_clients = limits.max_clients.clamp(1, u32::MAX as usize >> 4);
        Self {
            max_clients,
            max_per_peer: limits.max_connections_per_peer.clamp(1, max_clients),
            free: Arc::new(Semaphore::new(max_clients)),
            refusals: Arc::new(Semaphore::new(MAX_REFUSALS)),
            open: Mutex::default(),
            per_peer: Mutex::default(),
        }
    }

    pub(super) async fn all_free(&self) {
        let _ = self.free.acquire_many(self.max_clients as u32).await;
    }

    /// Takes a slot for a connection, if necessary that of an idle one.
    pub(super) async fn admit(
        self: &Arc<Self>,
        api: &Arc<ApiState>,
        activity: &Arc<Activity>,
    ) -> Admission {
        let mut full = match self.take(activity.peer) {
            Ok(permit) => return self.admitted(api, activity, permit),
            Err(full) => full,
        };
        if self.evict(full, activity.peer) {
            api.counters.connections_evicted.fetch_add(1, Ordering::Relaxed);
            for _ in 0..ATTEMPTS {
                sleep(ATTEMPT_INTERVAL).await;
                full = match self.take(activity.peer) {
                    Ok(permit) => return self.admitted(api, activity, permit),
                    Err(full) => full,
                };
            }
        }
        api.counters.connections_refused.fetch_add(1, Ordering::Relaxed);
        let permit = self.refusals.clone().try_acquire_owned().ok();
        Admission::Refused(Refusal { full, permit })
    }

    fn admitted(
        self: &Arc<Self>,
        api: &Arc<ApiState>,
        activity: &Arc<Activity>,
        permit: OwnedSemaphorePermit,
    ) -> Admission {
        lock(&self.open).push(activity.clone());
        api.counters.connections.fetch_add(1, Ordering::Relaxed);
        Admission::Admitted(Arc::new(ConnectionSlot {
            api: api.clone(),
            slots: self.clone(),
            peer: activity.peer,
            encoding_share: Arc::default(),
            streams: Arc::new(Semaphore::new(STREAMS_PER_CONNECTION)),
            _permit: permit,
        }))
    }

    fn take(&self, peer: Option<IpAddr>) -> Result<OwnedSemaphorePermit, Full> {
        let mut per_peer = lock(&self.per_peer);
        let count = peer.map(|peer| per_peer.entry(peer).or_default());
        let is_shared = self.max_per_peer < self.max_clients;
        if is_shared && count.as_ref().is_some_and(|count| **count >= self.max_per_peer) {
            return Err(Full::Peer);
        }
        let permit = self.free.clone().try_acquire_owned().map_err(|_| Full::Server);
        if let (Some(count), Ok(_)) = (count, &permit) {
            *count += 1;
        }
        permit
    }

    /// Closes the connection that has been idle for the longest time; returns whether there is one.
    fn evict(&self, full: Full, peer: Option<IpAddr>) -> bool {
        let open = lock(&self.open);
        let counts = |it: &&Arc<Activity>| full == Full::Server || it.peer == peer;
        let idle = open.iter().filter(counts).filter_map(|it| Some((it.idle_for()?, it)));
        let Some((idle_for, oldest)) = idle.max_by_key(|(idle_for, _)| *idle_for) else {
            return false;
        };
        if idle_for >= MIN_IDLE {
            oldest.close();
        }
        idle_for >= MIN_IDLE
    }

    /// Forgets a connection that has ended or was upgraded.
    pub(super) fn forget(&self, activity: &Arc<Activity>) {
        lock(&self.open).retain(|other| !Arc::ptr_eq(other, activity));
    }

    fn release(&self, peer: IpAddr) {
        let mut per_peer = lock(&self.per_peer);
        if let Some(count) = per_peer.get_mut(&peer) {
            *count -= 1;
            if *count == 0 {
                per_peer.remove(&peer);
            }
        }
    }
}

/// Counts stay valid when a thread panics.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Refusal {
    /// The error to answer with, unless too many others are being answered.
    pub(super) fn error(&self, limits: &ApiLimits) -> Option<ApiError> {
        self.permit.as_ref()?;
        let ApiLimits { max_clients, max_connections_per_peer, .. } = limits;
        Some(ApiError::ResourceExhausted(match self.full {
            Full::Server => format!(
                "all {max_clients} connections that this server allows are in use; close one, or raise limits.max_clients"
            ),
            Full::Peer => format!(
                "all {max_connections_per_peer} connections that this server allows from one address are in use; close one, \
                 or raise limits.max_connections_per_peer"
            ),
        }))
    }
}

/// Held while a connection is open, by its task and by the WebSocket that it was upgraded to.
pub(in crate::api) struct ConnectionSlot {
    api: Arc<ApiState>,
    slots: Arc<Slots>,
    peer: Option<IpAddr>,
    encoding_share: Arc<EncodingShare>,
    streams: Arc<Semaphore>,
    _permit: OwnedSemaphorePermit,
}

/// The share of the connection that a request came with.
pub(in crate::api) fn encoding_share(extensions: &Extensions) -> Arc<EncodingShare> {
    let slot = extensions.get::<Arc<ConnectionSlot>>();
    slot.map(|slot| slot.encoding_share.clone()).unwrap_or_default()
}

/// Held by a stream of events, observations or calibrations; the connection that its request came with has a limit of
/// them.
pub(in crate::api) fn stream_permit(
    extensions: &Extensions,
) -> Result<Option<OwnedSemaphorePermit>, ApiError> {
    let Some(slot) = extensions.get::<Arc<ConnectionSlot>>() else { return Ok(None) };
    slot.streams.clone().try_acquire_owned().map(Some).map_err(|_| {
        ApiError::ResourceExhausted(format!(
            "all {STREAMS_PER_CONNECTION} streams of events, observations and calibrations that a connection may have are in \
             use: one stream of observations serves all cameras; close one, or open another connection"
        ))
    })
}

impl Drop for ConnectionSlot {
    fn drop(&mut self) {
        self.api.counters.connections.fetch_sub(1, Ordering::Relaxed);
        if let Some(peer) = self.peer {
            self.slots.release(peer);
        }
    }
}

/// What a connection is doing.
pub(super) struct Activity {
    peer: Option<IpAddr>,
    /// Requests that are being answered.
    answering: AtomicUsize,
    idle_since: Mutex<Instant>,
    closing: Notify,
}

impl Activity {
    pub(super) fn new(address: Option<IpAddr>) -> Arc<Self> {
        Arc::new(Self {
            peer: address.map(peer_of),
            answering: AtomicUsize::new(0),
            idle_since: Mutex::new(Instant::now()),
            closing: Notify::new(),
        })
    }

    /// The connection is not idle until the guard is dropped.
    pub(super) fn begin(self: &Arc<Self>) -> Answering {
        self.answering.fetch_add(1, Ordering::AcqRel);
        Answering(self.clone())
    }

    fn idle_for(&self) -> Option<Duration> {
        let is_idle = self.answering.load(Ordering::Acquire) == 0;
        is_idle.then(|| lock(&self.idle_since).elapsed())
    }

    fn close(&self) {
        // The next search must find another one.
        *lock(&self.idle_since) = Instant::now();
        self.closing.notify_one();
    }

    /// Completes when the connection must be closed for another one.
    pub(super) async fn closed(&self) {
        self.closing.notified().await;
    }
}

pub(super) struct Answering(Arc<Activity>);

impl Drop for Answering {
    fn drop(&mut self) {
        *lock(&self.0.idle_since) = Instant::now();
        self.0.answering.fetch_sub(1, Ordering::AcqRel);
    }
}

/// The address whose connections count together: IPv6 hosts have a network of their own.
fn peer_of(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(address) if !address.is_loopback() => {
            IpAddr::V6(Ipv6Addr::from_bits(address.to_bits() >> 64 << 64))
        }
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::api::ApiLimits;

    fn slots(max_clients: usize, max_connections_per_peer: usize) -> Slots {
        Slots::new(&ApiLimits { max_clients, max_connections_per_peer, ..ApiLimits::default() })
    }

    fn activity(address: &str) -> Arc<Activity> {
        Activity::new(Some(address.parse().unwrap()))
    }

    #[test]
    fn peers_share_the_slots() {
        let slots = slots(3, 2);
        let [near, far] = ["10.0.0.1", "10.0.0.2"].map(|it| activity(it).peer);
        let taken = [slots.take(near).unwrap(), slots.take(near).unwrap()];
        assert_eq!(slots.take(near).unwrap_err(), Full::Peer);
        let other = slots.take(far).unwrap();
        assert_eq!(slots.take(far).unwrap_err(), Full::Server);
        slots.release(near.unwrap());
        drop((taken, other));
        assert!(slots.take(near).is_ok());
    }

    #[test]
    fn hosts_are_counted_by_address_or_ipv6_network() {
        for (one, other, is_same) in [
            ("10.0.0.1", "::ffff:10.0.0.1", true),
            ("10.0.0.1", "10.0.0.2", false),
            ("2001:db8::1", "2001:db8::ffff:0:2", true),
            ("2001:db8::1", "2001:db8:0:1::1", false),
        ] {
            assert_eq!(activity(one).peer == activity(other).peer, is_same, "{one} {other}");
        }
    }

    #[test]
    fn the_connection_that_is_idle_longest_is_closed() {
        let slots = slots(9, 9);
        let all: Vec<_> =
            ["10.0.0.1", "10.0.0.1", "10.0.0.2", "10.0.0.2"].map(activity).into_iter().collect();
        lock(&slots.open).extend(all.iter().cloned());
        assert!(!slots.evict(Full::Server, all[0].peer), "none has been idle long enough");
        for (activity, seconds) in all.iter().zip([9, 5, 7, 8]) {
            *lock(&activity.idle_since) = Instant::now() - Duration::from_secs(seconds);
        }
        let answering = all[0].begin();
        let is_closed =
            |index: usize| futures::FutureExt::now_or_never(all[index].closed()).is_some();
        assert!(slots.evict(Full::Server, all[0].peer) && is_closed(3));
        assert!(slots.evict(Full::Peer, all[0].peer) && is_closed(1), "only of that peer");
        assert!(!slots.evict(Full::Peer, all[0].peer), "the other one is being answered");
        drop(answering);
        assert!(!slots.evict(Full::Peer, all[0].peer), "it has just become idle");
    }
}
