//! The newest snapshot at any time, for loops that run at a rate of their own.

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

/// The newest snapshot. A task reads all the time, through losses of the connection; whoever asks gets the newest, and
/// nothing is queued. Ends when dropped.
///
/// While there is no connection the newest snapshot stays where it is and grows old: who steers by it asks for one that is
/// [`recent`](Self::recent), and stops without one.
#[derive(Debug)]
pub struct Latest {
    newest: watch::Receiver<Option<Result<Received, Error>>>,
    link: watch::Receiver<Link>,
    counts: Arc<Counts>,
    reader: JoinHandle<()>,
}

/// How the connection of a [`Latest`] is, at one instant.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Link {
    /// Whether snapshots come.
    pub state: LinkState,
    /// Why the last connection or try ended, also after it has healed; `None` before any did.
    pub reason: Option<String>,
    /// That have failed since the loss, or since the begin; 0 just after a loss, and while there is a connection.
    pub tries: u32,
    /// Of connections that had brought snapshots.
    pub losses: u64,
    /// Times that the server was found started anew, with ids that begin anew.
    pub restarts: u64,
}

/// Whether snapshots come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LinkState {
    /// None has come yet.
    #[default]
    Connecting,
    /// They do, as far as is known: see the age of the newest one.
    Connected,
    /// There is no connection; it is tried again and again.
    Lost,
    /// The server refuses the subscription: nothing will come any more.
    Ended,
}

impl fmt::Display for Link {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let word = match self.state {
            LinkState::Connecting => "connecting",
            LinkState::Connected => "connected",
            LinkState::Lost => "lost",
            LinkState::Ended => "ended",
        };
        write!(formatter, "the connection is {word}")?;
        match &self.reason {
            Some(reason) if self.state != LinkState::Connected => write!(formatter, ": {reason}"),
            _ => Ok(()),
        }
    }
}

/// A snapshot, and when it came.
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
    /// The newest snapshot at any time. To be called within a tokio runtime.
    pub fn latest(&self, subscription: Subscription) -> Latest {
        let (newest_sender, newest) = watch::channel(None);
        let (link_sender, link) = watch::channel(Link::default());
        let counts = Arc::<Counts>::default();
        let reader = Reader { newest: newest_sender, link: link_sender, counts: counts.clone() };
        let reader = tokio::spawn(reader.run(self.snapshots(subscription)));
        Latest { newest, link, counts, reader }
    }
}

/// Takes what comes.
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
                Ok(update) => self.take(update),
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

    fn take(&self, update: Update) {
        match update {
            Update::Snapshot(snapshot) => {
                self.counts.received.fetch_add(1, Ordering::Relaxed);
                let received = Received { snapshot: Arc::new(snapshot), at: Instant::now() };
                // Whoever sees that there is a connection sees what it brought, too.
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
    /// That which has ended the subscription, since asking again cannot heal it.
    pub fn value(&mut self) -> Result<Option<Arc<v1::Snapshot>>, Error> {
        let is_new = self.newest.has_changed().unwrap_or(false);
        let value = self.newest.borrow_and_update().clone().transpose()?;
        if is_new && value.is_some() {
            self.counts.taken.fetch_add(1, Ordering::Relaxed);
        }
        Ok(value.map(|received| received.snapshot))
    }

    /// The newest snapshot, if it came within the last `longest`. Does not wait. To that comes how old it was when it came:
    /// its `pose_time_ns` says so, by the server's clock ([`Client::clock_offset`]).
    ///
    /// # Errors
    /// [`Error::Stale`] if it is older or none has come: who steers by it had better stop. As of [`Latest::value`].
    pub fn recent(&mut self, longest: Duration) -> Result<Arc<v1::Snapshot>, Error> {
        let newest = self.value()?;
        let age = self.age();
        match newest {
            Some(snapshot) if age.is_some_and(|age| age <= longest) => Ok(snapshot),
            _ => Err(Error::Stale { longest, age, link: Box::new(self.link()) }),
        }
    }

    /// How long ago the newest snapshot came, by this machine's monotonic clock; `None` before the first.
    pub fn age(&self) -> Option<Duration> {
        match &*self.newest.borrow() {
            Some(Ok(received)) => Some(received.at.elapsed()),
            _ => None,
        }
    }

    /// How the connection is now.
    pub fn link(&self) -> Link {
        self.link.borrow().clone()
    }

    /// Waits until the connection is otherwise than when this last said how it is, and says it; for ever once it has ended.
    pub async fn link_changed(&mut self) -> Link {
        if self.link.changed().await.is_err() {
            std::future::pending::<()>().await;
        }
        self.link.borrow_and_update().clone()
    }

    /// The newest snapshot that was not taken yet; waits for one, through losses of the connection.
    ///
    /// # Errors
    /// As of [`Latest::value`].
    pub async fn next(&mut self) -> Result<Arc<v1::Snapshot>, Error> {
        loop {
            // The reader has ended: its last word stays.
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

    /// Snapshots that came and were replaced before they were taken, the newest one apart.
    pub fn skipped(&self) -> u64 {
        let waiting = u64::from(self.newest.has_changed().unwrap_or(false));
        let [received, taken] =
            [&self.counts.received, &self.counts.taken].map(|count| count.load(Ordering::Relaxed));
        received.saturating_sub(taken + waiting)
    }

    /// Snapshots that never came, as of [`Snapshots::missed`].
    pub fn missed(&self) -> u64 {
        self.counts.missed.load(Ordering::Relaxed)
    }
}

impl Drop for Latest {
    fn drop(&mut self) {
        self.reader.abort();
    }
}
