//! Snapshots through losses of the connection.

use std::{
    pin::Pin,
    task::{Context, Poll},
    time::Duration,
};

use futures::{Stream, StreamExt, stream};
use tokio::time::{Instant, sleep};
use tonic::Streaming;

use crate::{Client, Error, Subscription, backoff::Backoff, v1};

/// What happens on a subscription to snapshots.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Update {
    /// A new snapshot.
    Snapshot(v1::Snapshot),
    /// The connection is lost, or the try to get it back failed; the next try follows.
    Disconnected {
        /// What happened.
        reason: String,
        /// Tries that have failed since the loss, or since the begin, by bringing no snapshot: 0 for the loss itself, 1
        /// for the first try after it, and for the first of all.
        tries: u32,
        /// Pause before the next try.
        retry_in: Duration,
    },
    /// The connection is back after a loss, whose length is known: the next update is a snapshot. Not said before the
    /// first snapshot.
    Reconnected {
        /// From the last snapshot before the loss to the first one after it, by this machine's monotonic clock.
        gap: Duration,
        /// It is another run of the server: ids are given anew, so that those of a subscription are other objects', and
        /// the clock may be another.
        restarted: bool,
        /// Snapshots that the server made meanwhile, whether they were wanted or not; `None` if it was started anew, since
        /// nobody counted then.
        missed: Option<u64>,
    },
}

/// Snapshots from the newest one on, as a stream of [`Update`]s.
///
/// A lost connection is said and tried again with growing pauses (100 ms to 5 s, with jitter) until
/// the stream is dropped. It ends only after an error that asking again cannot heal, such as a
/// subscription that the server refuses.
pub struct Snapshots {
    updates: Pin<Box<dyn Stream<Item = Result<Update, Error>> + Send>>,
    missed: u64,
}

impl Snapshots {
    pub(crate) fn new(client: Client, subscription: Subscription) -> Self {
        let follower = Follower {
            client,
            request: subscription.into_request(),
            phase: Phase::Subscribing,
            backoff: Backoff::default(),
            newest: None,
            held: None,
            tries: 0,
            is_up: false,
            was_lost: false,
        };
        let updates = stream::unfold(follower, |mut follower| async move {
            let update = follower.next().await?;
            Some((update, follower))
        });
        Self { updates: Box::pin(updates), missed: 0 }
    }

    /// Snapshots missed so far: those that this client was too slow for, and those of the times
    /// without a connection to a server that went on.
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

/// What is remembered of the newest snapshot.
struct Newest {
    source_id: String,
    sequence: u64,
    came: Instant,
}

struct Follower {
    client: Client,
    request: v1::SubscribeSnapshotsRequest,
    phase: Phase,
    backoff: Backoff,
    newest: Option<Newest>,
    /// Came with the reconnection that is being told.
    held: Option<v1::Snapshot>,
    /// That have failed since the loss or the begin.
    tries: u32,
    /// Whether this connection has brought a snapshot: its end is a loss then, and else a try that failed.
    is_up: bool,
    was_lost: bool,
}

impl Follower {
    async fn next(&mut self) -> Option<Result<Update, Error>> {
        if let Some(snapshot) = self.held.take() {
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
        self.backoff.reset();
        self.is_up = true;
        let (source_id, sequence) = (snapshot.source_id.clone(), snapshot.sequence);
        let newest = Newest { source_id, sequence, came: Instant::now() };
        let before = self.newest.replace(newest);
        let was_lost = std::mem::take(&mut self.was_lost);
        let Some(before) = before.filter(|_| was_lost) else {
            return Update::Snapshot(snapshot);
        };
        let restarted = before.source_id != snapshot.source_id;
        let made = snapshot.sequence.saturating_sub(before.sequence.saturating_add(1));
        self.held = Some(snapshot);
        let missed = (!restarted).then_some(made);
        Update::Reconnected { gap: before.came.elapsed(), restarted, missed }
    }

    fn lost(&mut self, error: Error) -> Result<Update, Error> {
        if !error.is_temporary() {
            self.phase = Phase::Ended;
            return Err(error);
        }
        self.was_lost = true;
        let was_up = std::mem::take(&mut self.is_up);
        self.tries = if was_up { 0 } else { self.tries.saturating_add(1) };
        let retry_in = self.backoff.next_pause();
        self.phase = Phase::Pausing(retry_in);
        let reason = match error {
            Error::Unreachable { reason, .. } => reason,
            Error::Server { message, .. } | Error::TimedOut { message, .. } => message,
            other => other.to_string(),
        };
        Ok(Update::Disconnected { reason, tries: self.tries, retry_in })
    }
}
