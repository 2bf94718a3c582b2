//! The newest snapshot at any time, for loops that run at a rate of their own.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

use futures::StreamExt;
use tokio::{sync::watch, task::JoinHandle};

use crate::{Client, Error, Snapshots, Subscription, Update, v1};

/// The newest snapshot. A task reads all the time, through losses of the connection; whoever asks gets the newest, and
/// nothing is queued. Ends when dropped.
#[derive(Debug)]
pub struct Latest {
    newest: watch::Receiver<Option<Result<Arc<v1::Snapshot>, Error>>>,
    counts: Arc<Counts>,
    reader: JoinHandle<()>,
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
        let (sender, newest) = watch::channel(None);
        let counts = Arc::<Counts>::default();
        let reader = tokio::spawn(read(self.snapshots(subscription), sender, counts.clone()));
        Latest { newest, counts, reader }
    }
}

async fn read(
    mut snapshots: Snapshots,
    newest: watch::Sender<Option<Result<Arc<v1::Snapshot>, Error>>>,
    counts: Arc<Counts>,
) {
    while let Some(update) = snapshots.next().await {
        counts.missed.store(snapshots.missed(), Ordering::Relaxed);
        match update {
            Ok(Update::Snapshot(snapshot)) => {
                counts.received.fetch_add(1, Ordering::Relaxed);
                newest.send_replace(Some(Ok(Arc::new(snapshot))));
            }
            Ok(_) => {}
            Err(error) => {
                newest.send_replace(Some(Err(error)));
            }
        }
    }
}

impl Latest {
    /// The newest snapshot; `None` before the first. Does not wait.
    ///
    /// # Errors
    /// That which has ended the subscription, since asking again cannot heal it.
    pub fn value(&mut self) -> Result<Option<Arc<v1::Snapshot>>, Error> {
        let is_new = self.newest.has_changed().unwrap_or(false);
        let value = self.newest.borrow_and_update().clone().transpose()?;
        if is_new && value.is_some() {
            self.counts.taken.fetch_add(1, Ordering::Relaxed);
        }
        Ok(value)
    }

    /// The newest snapshot that was not taken yet; waits for one.
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
                Some(Ok(snapshot)) => {
                    self.counts.taken.fetch_add(1, Ordering::Relaxed);
                    return Ok(snapshot);
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
