//! The newest snapshot at any time, for loops that run at their own rate.

use std::{
    fmt,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use futures::StreamExt;
use tokio::{sync::watch, task::JoinHandle, time::Instant};

use crate::{Client, Error, Snapshots, Subscription, Update, v1};

/// The newest snapshot, read by a background task that reconnects automatically. Nothing is queued. Dropping it ends the task.
///
/// While there is no connection the newest snapshot stays and grows old. A control loop uses [`recent`](Self::recent), and
/// stops on its error.
#[derive(Debug)]
pub struct Latest {
    newest: watch::Receiver<Option<Result<Received, Error>>>,
    link: watch::Receiver<Link>,
    counts: Arc<Counts>,
    reader: JoinHandle<()>,
}

/// State of the connection of a [`Latest`] at one instant.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Link {
    /// Whether snapshots arrive.
    pub state: LinkState,
    /// Why the last connection or attempt ended, also after recovery; `None` before any.
    pub reason: Option<String>,
    /// Failed attempts since the loss or since the start; 0 right after a loss and while connected.
    pub tries: u32,
    /// Lost connections that had delivered snapshots.
    pub losses: u64,
    /// Server restarts noticed so far. A restarted server assigns new ids.
    pub restarts: u64,
}

/// Whether snapshots arrive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LinkState {
    /// No snapshot has arrived yet.
    #[default]
    Connecting,
    /// Snapshots arrive; the age of the newest one tells how recently.
    Connected,
    /// The connection is lost and being retried.
    Lost,
    /// The server rejected the subscription. No more snapshots will arrive.
    Ended,
}

impl fmt::Display for Link {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let state = match self.state {
            LinkState::Connecting => "connecting",
            LinkState::Connected => "connected",
            LinkState::Lost => "lost",
            LinkState::Ended => "ended",
        };
        write!(formatter, "the connection is {state}")?;
        match &self.reason {
            Some(reason) if self.state != LinkState::Connected => write!(formatter, ": {reason}"),
            _ => Ok(()),
        }
    }
}

/// A snapshot with its time of arrival.
#[derive(Clone, Debug)]
struct Received {
    snapshot: Arc<v1::Snapshot>,
    at: Instant,
}

#[derive(Debug, Default)]
struct Counts {
    received: AtomicU64,
    missed: AtomicU64,
    taken: AtomicU64,
}

impl Client {
    /// The newest snapshot at any time. Must be called within a tokio runtime.
    pub fn latest(&self, subscription: Subscription) -> Latest {
        let (newest_sender, newest) = watch::channel(None);
        let (link_sender, link) = watch::channel(Link::default());
        let counts = Arc::<Counts>::default();
        let reader = Reader { newest: newest_sender, link: link_sender, counts: counts.clone() };
        let reader = tokio::spawn(reader.run(self.snapshots(subscription)));
        Latest { newest, link, counts, reader }
    }
}

/// The background task.
struct Reader {
    newest: watch::Sender<Option<Result<Received, Error>>>,
    link: watch::Sender<Link>,
    counts: Arc<Counts>,
}

impl Reader {
    async fn run(self, mut snapshots: Snapshots) {
        while let Some(update) = snapshots.next().await {
            self.counts.missed.store(snapshots.missed(), Ordering::Relaxed);
            match update {
                Ok(update) => self.apply(update),
                Err(error) => {
                    self.link.send_modify(|link| {
                        link.state = LinkState::Ended;
                        link.reason = Some(error.to_string());
                    });
                    self.newest.send_replace(Some(Err(error)));
                }
            }
        }
    }

    fn apply(&self, update: Update) {
        match update {
            Update::Snapshot(snapshot) => {
                self.counts.received.fetch_add(1, Ordering::Relaxed);
                let received = Received { snapshot: Arc::new(snapshot), at: Instant::now() };
                // Publishes the snapshot before the connection, so that `Connected` implies a snapshot.
                self.newest.send_replace(Some(Ok(received)));
                self.link.send_if_modified(|link| {
                    let is_new = link.state != LinkState::Connected;
                    (link.state, link.tries) = (LinkState::Connected, 0);
                    is_new
                });
            }
            Update::Disconnected { reason, tries, .. } => self.link.send_modify(|link| {
                if link.state == LinkState::Connected {
                    (link.state, link.losses) = (LinkState::Lost, link.losses + 1);
                }
                (link.reason, link.tries) = (Some(reason), tries);
            }),
            Update::Reconnected { restarted, .. } => {
                self.link.send_modify(|link| link.restarts += u64::from(restarted));
            }
        }
    }
}

impl Latest {
    /// The newest snapshot, however old; `None` before the first. Does not wait.
    ///
    /// # Errors
    /// The error that ended the subscription, which a retry cannot fix.
    pub fn value(&mut self) -> Result<Option<Arc<v1::Snapshot>>, Error> {
        let is_new = self.newest.has_changed().unwrap_or(false);
        let value = self.newest.borrow_and_update().clone().transpose()?;
        if is_new && value.is_some() {
            self.counts.taken.fetch_add(1, Ordering::Relaxed);
        }
        Ok(value.map(|received| received.snapshot))
    }

    /// The newest snapshot if it arrived within the last `longest`. Does not wait. Its age on arrival follows from its
    /// `pose_time_ns` and [`Client::clock_offset`].
    ///
    /// # Errors
    /// [`Error::Stale`] if it is older or none has arrived: a control loop should stop. As for [`Latest::value`].
    pub fn recent(&mut self, longest: Duration) -> Result<Arc<v1::Snapshot>, Error> {
        let newest = self.value()?;
        let age = self.age();
        match newest {
            Some(snapshot) if age.is_some_and(|age| age <= longest) => Ok(snapshot),
            _ => Err(Error::Stale { longest, age, link: Box::new(self.link()) }),
        }
    }

    /// Time since the newest snapshot arrived, by this machine's monotonic clock; `None` before the first.
    pub fn age(&self) -> Option<Duration> {
        match &*self.newest.borrow() {
            Some(Ok(received)) => Some(received.at.elapsed()),
            _ => None,
        }
    }

    /// The current state of the connection.
    pub fn link(&self) -> Link {
        self.link.borrow().clone()
    }

    /// Waits until the state differs from the last one returned here, and returns it. Waits forever once it has ended.
    pub async fn link_changed(&mut self) -> Link {
        if self.link.changed().await.is_err() {
            std::future::pending::<()>().await;
        }
        self.link.borrow_and_update().clone()
    }

    /// The newest snapshot that has not been read yet; waits for one, also without a connection.
    ///
    /// # Errors
    /// As for [`Latest::value`].
    pub async fn next(&mut self) -> Result<Arc<v1::Snapshot>, Error> {
        loop {
            // After the end of the task its last value stays.
            let ended = self.newest.changed().await.is_err();
            let value = self.newest.borrow_and_update().clone();
            match value {
                Some(Ok(_)) if ended => std::future::pending().await,
                Some(Ok(received)) => {
                    self.counts.taken.fetch_add(1, Ordering::Relaxed);
                    return Ok(received.snapshot);
                }
                Some(Err(error)) => return Err(error),
                None => {}
            }
        }
    }

    /// Snapshots that arrived and were replaced before they were read.
    pub fn skipped(&self) -> u64 {
        let waiting = u64::from(self.newest.has_changed().unwrap_or(false));
        let [received, taken] =
            [&self.counts.received, &self.counts.taken].map(|count| count.load(Ordering::Relaxed));
        received.saturating_sub(taken + waiting)
    }

    /// Snapshots that never arrived, as for [`Snapshots::missed`].
    pub fn missed(&self) -> u64 {
        self.counts.missed.load(Ordering::Relaxed)
    }
}

impl Drop for Latest {
    fn drop(&mut self) {
        self.reader.abort();
    }
}
