//! Bounded queue of one `push:` camera.
//!
//! Only the newest frame is queued; replaced frames are counted. Detections are never replaced: the sender waits while the
//! queue is full, which is brief, since a worker takes detections within microseconds. The queue is bounded in frames and in
//! bytes. Sequence numbers reveal repeated items, which are ignored, and missing ones.

use std::{
    collections::{BTreeMap, VecDeque},
    sync::{
        Arc, Condvar, Mutex, MutexGuard, PoisonError, RwLock,
        atomic::{AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};

use roundel_core::{id::CameraId, time::Timestamp};
use thiserror::Error;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use super::{Payload, PushedItem, SenderClock};
use crate::{
    capture::source::SourceError,
    model::{hub::SenderLink, stop::StopSignal, untrusted_text::sanitized},
};

/// Capacity for detections, frames.
const QUEUE: usize = 64;
/// Capacity for detections, bytes; a single frame always fits.
const QUEUE_BYTES: usize = 8 * 1024 * 1024;
/// Shortest time between two failures of a sender, each of which is an event.
const FAILURE_INTERVAL: Duration = Duration::from_millis(100);
/// How often a wait checks the stop signal.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Another sender may replace one that has been silent for this long.
const REPLACEABLE_AFTER: Duration = Duration::from_secs(3);

/// First message of a sender.
#[derive(Clone, Debug, Default)]
pub struct SenderHello {
    pub sender: String,
    pub address: String,
    /// Unique for each run of the sender.
    pub run_id: String,
    pub times: SenderClock,
    /// The next sequence number that can arrive.
    pub next_sequence: u64,
    /// Items of this run before that number that will never come.
    pub dropped: u64,
}

/// Why an endpoint rejects a sender or its item.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum PushError {
    #[error(
        "{sender} ({address}) is feeding this camera; end it first, or give each its own camera"
    )]
    Taken { sender: String, address: String },
    #[error("the same run of this sender has opened another connection")]
    Superseded,
    #[error("this camera was removed, or has another source now")]
    Closed,
    #[error("sequence: expected a number from 1, found 0")]
    Sequence,
}

#[derive(Default)]
struct EndpointState {
    queue: VecDeque<PushedItem>,
    /// Number of the newest session; it feeds the camera while `link.connected`.
    session: u64,
    last_heard: Option<Instant>,
    run_id: String,
    /// Newest sequence number of that run that was taken or given up.
    newest: u64,
    /// Why the sender has no frames.
    failure: String,
    link: SenderLink,
    /// Frames replaced or missing that the worker has not counted yet.
    skipped: u64,
    /// Incremented when the reason of [`Self::failed`] changes.
    changes: u64,
    /// `changes` when the worker last got a reason.
    reported_changes: Option<u64>,
}

impl EndpointState {
    /// Counts the items before `next` that were not taken as missing.
    fn skip_to(&mut self, next: u64) {
        // Senders choose their numbers.
        let gap = next.saturating_sub(self.newest.saturating_add(1));
        self.count_missing(gap);
        self.newest = self.newest.saturating_add(gap);
    }

    fn count_missing(&mut self, count: u64) {
        self.link.missing = self.link.missing.saturating_add(count);
        self.skipped = self.skipped.saturating_add(count);
    }

    fn has_space(&self, item: &PushedItem) -> bool {
        let queued: usize = self.queue.iter().map(PushedItem::bytes).sum();
        self.queue.is_empty()
            || (self.queue.len() < QUEUE && queued.saturating_add(item.bytes()) <= QUEUE_BYTES)
    }

    fn sender_label(&self) -> String {
        format!("{} ({})", self.link.sender, self.link.address)
    }

    /// Whether a sender is connected that has frames.
    fn is_fed(&self) -> bool {
        self.link.connected && self.failure.is_empty()
    }

    /// The error of a worker that gets no item, with the reason.
    fn failed(&mut self) -> SourceError {
        self.reported_changes = Some(self.changes);
        let sender = &self.link.sender;
        SourceError::Failed(if self.link.connected {
            format!("at {sender}: {}", self.failure)
        } else if sender.is_empty() {
            "no program feeds it yet: start `roundel node` with a camera of this name, or send frames or detections \
             yourself (client/README.md)"
                .to_owned()
        } else {
            format!("{} has disconnected; frames resume when it reconnects", self.sender_label())
        })
    }
}

#[derive(Default)]
pub struct PushEndpoint {
    state: Mutex<EndpointState>,
    changed: Condvar,
    space: Notify,
    closing: CancellationToken,
}

impl PushEndpoint {
    fn lock(&self) -> MutexGuard<'_, EndpointState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Disconnects the sender and rejects all others.
    fn close(&self) {
        let mut state = self.lock();
        state.queue.clear();
        self.closing.cancel();
        drop(state);
        self.changed.notify_one();
        self.space.notify_waiters();
    }

    /// Resolves when the endpoint is closed.
    pub async fn closed(&self) {
        self.closing.cancelled().await;
    }

    pub fn link(&self) -> SenderLink {
        self.lock().link.clone()
    }

    /// Opens a session. The same run of a sender replaces its own session; another one only a silent one.
    pub fn connect(self: &Arc<Self>, greeting: &SenderHello) -> Result<SenderSession, PushError> {
        let mut state = self.lock();
        if self.closing.is_cancelled() {
            return Err(PushError::Closed);
        }
        let is_live = state.link.connected
            && state.last_heard.is_some_and(|heard| heard.elapsed() < REPLACEABLE_AFTER);
        if is_live && state.run_id != greeting.run_id {
            let SenderLink { sender, address, .. } = state.link.clone();
            return Err(PushError::Taken { sender, address });
        }
        let newest = if state.run_id == greeting.run_id {
            state.newest
        } else {
            state.run_id.clone_from(&greeting.run_id);
            state.newest = greeting.next_sequence.saturating_sub(1);
            // Guards against a count that exceeds the items there were.
            let dropped = greeting.dropped.min(state.newest);
            state.count_missing(dropped);
            0
        };
        state.session += 1;
        state.last_heard = Some(Instant::now());
        state.failure.clear();
        state.link.sender.clone_from(&greeting.sender);
        state.link.address.clone_from(&greeting.address);
        state.link.connected = true;
        (state.link.round_trip_ms, state.link.clock_deviation_ms) = (0.0, 0.0);
        state.changes += 1;
        let number = state.session;
        drop(state);
        self.changed.notify_one();
        self.space.notify_waiters();
        Ok(SenderSession { endpoint: self.clone(), number, newest_sequence: newest })
    }

    /// An error if no item can be expected, with the reason.
    pub(super) fn ready(&self) -> Result<(), SourceError> {
        let mut state = self.lock();
        if state.queue.is_empty() && !state.is_fed() { Err(state.failed()) } else { Ok(()) }
    }

    /// Waits for the next item, and returns it with the number of frames skipped before it.
    pub(super) fn next(
        &self,
        since: Instant,
        patience: Duration,
        stop: &StopSignal,
    ) -> Result<(PushedItem, u64), SourceError> {
        let mut state = self.lock();
        loop {
            if stop.is_stopped() {
                return Err(SourceError::Stopped);
            }
            if let Some(pushed) = state.queue.pop_front() {
                let skipped = std::mem::take(&mut state.skipped);
                state.reported_changes = None;
                drop(state);
                self.space.notify_one();
                return Ok((pushed, skipped));
            }
            if !state.is_fed() {
                return Err(state.failed());
            }
            let rest = patience.saturating_sub(since.elapsed());
            if rest.is_zero() {
                state.reported_changes = Some(state.changes);
                return Err(SourceError::Failed(format!(
                    "nothing from {} for {:.1} s: its camera has stopped, or the network is interrupted (a slow camera: \
                     `push:?stall=SECONDS`)",
                    state.sender_label(),
                    patience.as_secs_f64()
                )));
            }
            let wait = self.changed.wait_timeout(state, rest.min(POLL_INTERVAL));
            state = wait.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Counters' stamps of the queued items, ns, and their arrivals.
    pub(super) fn queued_stamps(&self) -> Vec<(i64, Timestamp)> {
        let state = self.lock();
        let items = state.queue.iter().filter(|it| it.times == SenderClock::Counter);
        items.map(|it| (it.stamp().as_ns(), it.arrived)).collect()
    }

    /// Frames skipped that no item has reported.
    pub(in crate::capture::source) fn take_skipped(&self) -> u64 {
        std::mem::take(&mut self.lock().skipped)
    }

    /// Waits before the source is opened again, and returns whether the stop signal came. If the worker got a
    /// reason, the wait lasts until an item arrives or the reason changes; otherwise for `pause`.
    pub(in crate::capture::source) fn pause(&self, pause: Duration, stop: &StopSignal) -> bool {
        let mut state = self.lock();
        let Some(reported) = state.reported_changes else {
            drop(state);
            return stop.wait(pause);
        };
        drop(state);
        if stop.wait(FAILURE_INTERVAL) {
            return true;
        }
        state = self.lock();
        while state.queue.is_empty() && state.changes == reported {
            if stop.is_stopped() {
                return true;
            }
            let wait = self.changed.wait_timeout(state, POLL_INTERVAL);
            state = wait.unwrap_or_else(PoisonError::into_inner).0;
        }
        stop.is_stopped()
    }

    pub(super) fn sender_label(&self) -> String {
        self.lock().sender_label()
    }
}

/// A sender's exclusive connection to an endpoint, until it is dropped.
pub struct SenderSession {
    endpoint: Arc<PushEndpoint>,
    number: u64,
    /// Newest sequence number that was taken in an earlier session of this run; 0: none.
    pub newest_sequence: u64,
}

impl SenderSession {
    /// The state, if this session still feeds the camera.
    fn state(&self) -> Result<MutexGuard<'_, EndpointState>, PushError> {
        let mut state = self.endpoint.lock();
        if self.endpoint.closing.is_cancelled() {
            return Err(PushError::Closed);
        }
        if !state.link.connected || state.session != self.number {
            return Err(PushError::Superseded);
        }
        state.last_heard = Some(Instant::now());
        Ok(state)
    }

    /// Queues an item; detections wait until the queue has space.
    pub async fn put(&self, sequence: u64, pushed: PushedItem) -> Result<(), PushError> {
        if sequence == 0 {
            return Err(PushError::Sequence);
        }
        let is_frame = !matches!(pushed.what, Payload::Detections(..));
        loop {
            let space = self.endpoint.space.notified();
            {
                let mut state = self.state()?;
                if sequence <= state.newest {
                    state.link.repeated += 1;
                    return Ok(());
                }
                if is_frame || state.has_space(&pushed) {
                    state.skip_to(sequence);
                    state.newest = sequence;
                    state.link.received += 1;
                    state.failure.clear();
                    if is_frame {
                        let before = state.queue.len();
                        state.queue.retain(|it| matches!(it.what, Payload::Detections(..)));
                        let replaced = (before - state.queue.len()) as u64;
                        state.skipped = state.skipped.saturating_add(replaced);
                    }
                    state.queue.push_back(pushed);
                    break;
                }
            }
            // With a timeout, because the worker may take an item before this wait begins.
            let _ = tokio::time::timeout(POLL_INTERVAL, space).await;
        }
        self.endpoint.changed.notify_one();
        Ok(())
    }

    /// Records a sign of life: the next sequence number, and how well the sender knows the server's clock.
    pub fn keep_alive(
        &self,
        next_sequence: u64,
        [round_trip_ms, clock_deviation_ms]: [f64; 2],
    ) -> Result<(), PushError> {
        let mut state = self.state()?;
        state.skip_to(next_sequence);
        (state.link.round_trip_ms, state.link.clock_deviation_ms) =
            (round_trip_ms, clock_deviation_ms);
        Ok(())
    }

    /// Records why the sender sent no picture; empty if it sent one.
    pub fn picture_answered(&self, no_picture: String) -> Result<(), PushError> {
        self.state()?.link.no_picture = no_picture;
        Ok(())
    }

    /// Records why the sender has no frames.
    pub fn report_failure(&self, error: &str) -> Result<(), PushError> {
        let mut state = self.state()?;
        let error = sanitized(error);
        if state.failure != error {
            state.failure = error;
            state.changes += 1;
        }
        drop(state);
        self.endpoint.changed.notify_one();
        Ok(())
    }
}

impl Drop for SenderSession {
    fn drop(&mut self) {
        let mut state = self.endpoint.lock();
        if state.session == self.number {
            state.link.connected = false;
            state.changes += 1;
            drop(state);
            self.endpoint.changed.notify_one();
        }
    }
}

/// The endpoints of all `push:` cameras.
#[derive(Default)]
pub struct PushEndpoints {
    endpoints: RwLock<BTreeMap<CameraId, Arc<PushEndpoint>>>,
    max_detections: AtomicUsize,
}

impl PushEndpoints {
    /// The camera's endpoint; `None` if its source is not `push:`.
    pub fn get(&self, camera: CameraId) -> Option<Arc<PushEndpoint>> {
        self.endpoints.read().unwrap_or_else(PoisonError::into_inner).get(&camera).cloned()
    }

    /// Opens an endpoint for a camera, unless it has one. `max_detections` per frame applies to all of them.
    pub fn open(&self, camera: CameraId, max_detections: usize) {
        self.max_detections.store(max_detections, Ordering::Relaxed);
        self.endpoints.write().unwrap_or_else(PoisonError::into_inner).entry(camera).or_default();
    }

    /// Largest number of detections in a frame.
    pub fn max_detections(&self) -> usize {
        self.max_detections.load(Ordering::Relaxed)
    }

    /// Closes a camera's endpoint and disconnects its sender.
    pub fn close(&self, camera: CameraId) {
        let mut endpoints = self.endpoints.write().unwrap_or_else(PoisonError::into_inner);
        if let Some(endpoint) = endpoints.remove(&camera) {
            endpoint.close();
        }
    }
}

#[cfg(test)]
mod tests;
