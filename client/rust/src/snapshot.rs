//! Streams of snapshots that survive lost connections.

use std::{
    pin::Pin,
    task::{Context, Poll},
    time::Duration,
};

use backon::ExponentialBackoff;
use futures::{Stream, StreamExt, stream};
use tokio::time::{Instant, sleep};
use tonic::Streaming;

use crate::{Client, Error, Subscription, backoff, v1};

/// An item of a stream of snapshots.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Update {
    /// A new snapshot.
    Snapshot(v1::Snapshot),
    /// The connection is lost, or an attempt to restore it failed. The next attempt follows.
    Disconnected {
        /// The cause.
        reason: String,
        /// Attempts since the loss or since the start that delivered no snapshot; 0 for the loss itself.
        tries: u32,
        /// Pause before the next attempt.
        retry_in: Duration,
    },
    /// The connection is back after a loss; the next update is a snapshot. Never precedes the first snapshot.
    Reconnected {
        /// Time from the last snapshot before the loss to the first one after it, by this machine's monotonic clock.
        gap: Duration,
        /// Whether the server was restarted. A restarted server assigns new ids, also to the objects of a subscription, and
        /// its clock may differ.
        restarted: bool,
        /// Snapshots that the server published during the gap, subscribed or not; `None` if it was restarted.
        missed: Option<u64>,
    },
}

/// Snapshots from the newest one on, as a stream of [`Update`]s.
///
/// Reports a lost connection and retries with backoff (100 ms to 5 s, with jitter) until the stream is dropped. Ends only
/// after an error that a retry cannot fix, such as a rejected subscription.
pub struct Snapshots {
    updates: Pin<Box<dyn Stream<Item = Result<Update, Error>> + Send>>,
    missed: u64,
}

impl Snapshots {
    pub(crate) fn new(client: Client, subscription: Subscription) -> Self {
        let state = StreamState {
            client,
            request: subscription.into_request(),
            phase: Phase::Subscribing,
            backoff: backoff::delays(),
            newest: None,
            pending: None,
            tries: 0,
            is_up: false,
            was_lost: false,
        };
        let updates = stream::unfold(state, |mut state| async move {
            let update = state.next().await?;
            Some((update, state))
        });
        Self { updates: Box::pin(updates), missed: 0 }
    }

    /// Snapshots missed so far, by reading slowly and without a connection.
    pub fn missed(&self) -> u64 {
        self.missed
    }
}

impl Stream for Snapshots {
    type Item = Result<Update, Error>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let polled = self.updates.poll_next_unpin(context);
        if let Poll::Ready(Some(Ok(update))) = &polled {
            self.missed += match update {
                Update::Snapshot(snapshot) => snapshot.missed,
                Update::Reconnected { missed, .. } => missed.unwrap_or(0),
                Update::Disconnected { .. } => 0,
            };
        }
        polled
    }
}

enum Phase {
    Subscribing,
    Receiving(Box<Streaming<v1::Snapshot>>),
    Pausing(Duration),
    Ended,
}

/// Identity and time of arrival of the newest snapshot.
struct Newest {
    source_id: String,
    sequence: u64,
    arrived: Instant,
}

struct StreamState {
    client: Client,
    request: v1::SubscribeSnapshotsRequest,
    phase: Phase,
    backoff: ExponentialBackoff,
    newest: Option<Newest>,
    /// The snapshot to return after `Reconnected`.
    pending: Option<v1::Snapshot>,
    /// Failed attempts since the loss or since the start.
    tries: u32,
    /// Whether this connection has delivered a snapshot. Its end is a loss then, and otherwise a failed attempt.
    is_up: bool,
    was_lost: bool,
}

impl StreamState {
    async fn next(&mut self) -> Option<Result<Update, Error>> {
        if let Some(snapshot) = self.pending.take() {
            return Some(Ok(Update::Snapshot(snapshot)));
        }
        loop {
            match &mut self.phase {
                Phase::Ended => return None,
                Phase::Pausing(pause) => {
                    sleep(*pause).await;
                    self.phase = Phase::Subscribing;
                }
                Phase::Subscribing => match self.client.subscribe(self.request.clone()).await {
                    Ok(messages) => self.phase = Phase::Receiving(Box::new(messages)),
                    Err(error) => return Some(self.lost(error)),
                },
                Phase::Receiving(messages) => match messages.message().await {
                    Ok(Some(snapshot)) => return Some(Ok(self.received(snapshot))),
                    Ok(None) => {
                        let reason = "the server ended the stream".to_owned();
                        let address = self.client.address().to_owned();
                        return Some(self.lost(Error::Unreachable { address, reason }));
                    }
                    Err(status) => {
                        let error = self.client.error(&status);
                        return Some(self.lost(error));
                    }
                },
            }
        }
    }

    fn received(&mut self, snapshot: v1::Snapshot) -> Update {
        self.backoff = backoff::delays();
        self.is_up = true;
        let (source_id, sequence) = (snapshot.source_id.clone(), snapshot.sequence);
        let newest = Newest { source_id, sequence, arrived: Instant::now() };
        let previous = self.newest.replace(newest);
        let was_lost = std::mem::take(&mut self.was_lost);
        let Some(previous) = previous.filter(|_| was_lost) else {
            return Update::Snapshot(snapshot);
        };
        let restarted = previous.source_id != snapshot.source_id;
        let published = snapshot.sequence.saturating_sub(previous.sequence.saturating_add(1));
        self.pending = Some(snapshot);
        let missed = (!restarted).then_some(published);
        Update::Reconnected { gap: previous.arrived.elapsed(), restarted, missed }
    }

    fn lost(&mut self, error: Error) -> Result<Update, Error> {
        if !error.is_temporary() {
            self.phase = Phase::Ended;
            return Err(error);
        }
        self.was_lost = true;
        let was_up = std::mem::take(&mut self.is_up);
        self.tries = if was_up { 0 } else { self.tries.saturating_add(1) };
        let retry_in = self.backoff.next().unwrap_or_default();
        self.phase = Phase::Pausing(retry_in);
        let reason = match error {
            Error::Unreachable { reason, .. } => reason,
            Error::Server { message, .. } | Error::TimedOut { message, .. } => message,
            other => other.to_string(),
        };
        Ok(Update::Disconnected { reason, tries: self.tries, retry_in })
    }
}
