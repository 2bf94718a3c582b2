//! Where a remote program's frames and detections arrive: a bounded queue with a memory of who has sent what.
//!
//! Of frames the newest waits; one that it replaces is counted. Of detections each counts, so a sender is made to
//! wait while the queue is full, which it never is for long: handing detections on takes microseconds. Sequence
//! numbers tell what came twice (it counts once) and what never came.

use std::{
    collections::VecDeque,
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use thiserror::Error;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use super::{Payload, PushedItem, SenderClock};
use crate::model::hub::SenderLink;
use crate::{capture::source::SourceError, model::stop::StopSignal};

/// Detections that wait at most, frames.
const QUEUE: usize = 64;
/// How often a wait looks whether the server goes down.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// A sender that says nothing for so long may be replaced by another one.
const REPLACEABLE_AFTER: Duration = Duration::from_secs(3);

/// What a sender says first.
#[derive(Clone, Debug, Default)]
pub struct SenderHello {
    pub sender: String,
    pub address: String,
    /// Tells this run of it from every other.
    pub run_id: String,
    pub times: SenderClock,
    /// The least sequence that is still to come.
    pub next_sequence: u64,
    /// Those of this run before it that will never come.
    pub dropped: u64,
}

/// Why something is not taken.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum PushError {
    #[error(
        "{sender} ({address}) is feeding this camera; end it first, or give each its own camera"
    )]
    Taken { sender: String, address: String },
    /// The same sender has come back over another connection.
    #[error("the same run of this sender has connected anew")]
    Superseded,
    /// There is no camera to be fed any more.
    #[error("this camera was removed, or takes its frames from elsewhere now")]
    Closed,
    /// Numbers begin at 1.
    #[error("sequence: expected a number from 1, found 0")]
    Sequence,
}

#[derive(Default)]
struct EndpointState {
    queue: VecDeque<PushedItem>,
    /// Number of the connection that feeds it now.
    active_session: Option<u64>,
    session_count: u64,
    last_heard: Option<Instant>,
    run_id: String,
    /// Newest sequence of that run that was taken or given up.
    newest: u64,
    /// Why the sender has no frames.
    failure: String,
    link: SenderLink,
    /// Frames that gave way or never came since the worker asked.
    skipped: u64,
    /// Grows with each change of what is to be told of the connection.
    changes: u64,
    /// `changes` when the worker was last told that it has to wait.
    reported_changes: Option<u64>,
    /// Its camera is fed no more.
    closed: bool,
}

impl EndpointState {
    /// What lies before `next` and was not taken will never come.
    fn skip_to(&mut self, next: u64) {
        let gap = next.saturating_sub(self.newest + 1);
        self.link.missing += gap;
        self.skipped += gap;
        self.newest += gap;
    }

    fn failure_reason(&self) -> String {
        let SenderLink { sender, address, connected, .. } = &self.link;
        match (connected, sender.as_str()) {
            (true, _) if !self.failure.is_empty() => format!("at {sender}: {}", self.failure),
            (true, _) => format!("{sender} ({address}) has connected and sent nothing yet"),
            (false, "") => {
                "no program feeds it yet: start `roundel node` with a camera of this name, or send \
                            frames or detections yourself (client/README.md)"
                    .to_owned()
            }
            (false, _) => {
                format!("{sender} ({address}) has gone; it goes on when it connects again")
            }
        }
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

    /// Sends away who feeds it, for good.
    pub(super) fn close(&self) {
        let mut state = self.lock();
        state.closed = true;
        state.queue.clear();
        drop(state);
        self.closing.cancel();
        self.changed.notify_one();
        self.space.notify_waiters();
    }

    /// Ends when its camera is fed no more.
    pub async fn closed(&self) {
        self.closing.cancelled().await;
    }

    /// Who feeds it, and how that goes.
    pub fn link(&self) -> SenderLink {
        self.lock().link.clone()
    }

    /// Lets a sender in. The same run of a sender takes its own place over; another one only where nothing was
    /// heard for a while.
    pub fn connect(self: &Arc<Self>, greeting: &SenderHello) -> Result<SenderSession, PushError> {
        let mut state = self.lock();
        if state.closed {
            return Err(PushError::Closed);
        }
        let is_live = state.active_session.is_some()
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
            // It cannot have dropped more than it had.
            let dropped = greeting.dropped.min(state.newest);
            state.link.missing += dropped;
            state.skipped += dropped;
            0
        };
        state.session_count += 1;
        state.active_session = Some(state.session_count);
        state.last_heard = Some(Instant::now());
        state.failure.clear();
        state.link.sender.clone_from(&greeting.sender);
        state.link.address.clone_from(&greeting.address);
        state.link.connected = true;
        (state.link.round_trip_ms, state.link.clock_deviation_ms) = (0.0, 0.0);
        state.changes += 1;
        let number = state.session_count;
        drop(state);
        self.changed.notify_one();
        self.space.notify_waiters();
        Ok(SenderSession { endpoint: self.clone(), number, newest_sequence: newest })
    }

    /// Whether there is something to wait for; if not, why.
    pub(super) fn ready(&self) -> Result<(), SourceError> {
        let mut state = self.lock();
        if !state.queue.is_empty() || (state.link.connected && state.failure.is_empty()) {
            return Ok(());
        }
        state.reported_changes = Some(state.changes);
        Err(SourceError::Failed(state.failure_reason()))
    }

    /// Waits for what was not taken yet, and counts what was left out before it.
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
            let rest = patience.saturating_sub(since.elapsed());
            let is_gone = !state.link.connected || !state.failure.is_empty();
            if is_gone || rest.is_zero() {
                state.reported_changes = Some(state.changes);
                let why = if is_gone {
                    state.failure_reason()
                } else {
                    format!(
                        "nothing from {} ({}) for {:.1} s: its camera stands still, or the network between is cut \
                         (a slow camera: `push:?stall=SECONDS`)",
                        state.link.sender,
                        state.link.address,
                        patience.as_secs_f64()
                    )
                };
                return Err(SourceError::Failed(why));
            }
            let wait = self.changed.wait_timeout(state, rest.min(POLL_INTERVAL));
            state = wait.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// What was left out before anything that is still to come.
    pub(in crate::capture::source) fn take_skipped(&self) -> u64 {
        std::mem::take(&mut self.lock().skipped)
    }

    /// The pause before another attempt: after a failure of what was sent, so long; while nobody sends, until
    /// somebody does, or there is something else to tell. Whether the server goes down.
    pub(in crate::capture::source) fn pause(&self, pause: Duration, stop: &StopSignal) -> bool {
        let mut state = self.lock();
        let Some(told) = state.reported_changes else {
            drop(state);
            return stop.wait(pause);
        };
        while state.queue.is_empty() && state.changes == told {
            if stop.is_stopped() {
                return true;
            }
            let wait = self.changed.wait_timeout(state, POLL_INTERVAL);
            state = wait.unwrap_or_else(PoisonError::into_inner).0;
        }
        stop.is_stopped()
    }

    pub(super) fn sender_label(&self) -> String {
        let state = self.lock();
        format!("{} ({})", state.link.sender, state.link.address)
    }
}

/// A sender's hold on a camera, until it is dropped.
pub struct SenderSession {
    endpoint: Arc<PushEndpoint>,
    number: u64,
    /// Newest sequence that was taken of this run before; 0: none.
    pub newest_sequence: u64,
}

impl SenderSession {
    /// The state, while it is this connection that feeds the camera.
    fn state(&self) -> Result<MutexGuard<'_, EndpointState>, PushError> {
        let mut state = self.endpoint.lock();
        if state.closed {
            return Err(PushError::Closed);
        }
        if state.active_session != Some(self.number) {
            return Err(PushError::Superseded);
        }
        state.last_heard = Some(Instant::now());
        Ok(state)
    }

    /// Puts in what came with that number. Detections wait for room.
    pub async fn put(&self, sequence: u64, pushed: PushedItem) -> Result<(), PushError> {
        if sequence == 0 {
            return Err(PushError::Sequence);
        }
        let is_frame = !matches!(pushed.what, Payload::Detections(..));
        loop {
            let room = self.endpoint.space.notified();
            {
                let mut state = self.state()?;
                if sequence <= state.newest {
                    state.link.repeated += 1;
                    return Ok(());
                }
                if is_frame || state.queue.len() < QUEUE {
                    state.skip_to(sequence);
                    state.newest = sequence;
                    state.link.received += 1;
                    state.failure.clear();
                    if is_frame {
                        let before = state.queue.len();
                        state.queue.retain(|it| matches!(it.what, Payload::Detections(..)));
                        state.skipped += (before - state.queue.len()) as u64;
                    }
                    state.queue.push_back(pushed);
                    break;
                }
            }
            // A look now and then too: the worker may take between the look above and this wait.
            let _ = tokio::time::timeout(POLL_INTERVAL, room).await;
        }
        self.endpoint.changed.notify_one();
        Ok(())
    }

    /// The sender lives, and says what will never come, and how well it knows the time.
    pub fn keep_alive(
        &self,
        next_sequence: u64,
        [round_trip_ms, clock_deviation_ms]: [f64; 2],
    ) -> Result<(), PushError> {
        let mut state = self.state()?;
        state.skip_to(next_sequence);
        state.link.round_trip_ms = round_trip_ms;
        state.link.clock_deviation_ms = clock_deviation_ms;
        Ok(())
    }

    /// The sender has given a picture, or says why it cannot.
    pub fn picture_answered(&self, no_picture: String) -> Result<(), PushError> {
        self.state()?.link.no_picture = no_picture;
        Ok(())
    }

    /// The sender has no frames, and says why.
    pub fn report_failure(&self, error: String) -> Result<(), PushError> {
        let mut state = self.state()?;
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
        if state.active_session == Some(self.number) {
            state.active_session = None;
            state.link.connected = false;
            state.changes += 1;
            drop(state);
            self.endpoint.changed.notify_one();
        }
    }
}

#[cfg(test)]
mod tests;
