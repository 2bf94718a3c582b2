//! History: past object positions in an SQLite file that stays small enough to be kept for months.
//!
//! | module | purpose |
//! | --- | --- |
//! | [`export`] | tables for other programs |
//! | [`store`] | the file: adds, expires and selects points |
//! | `task` | the thread that adds points from the hub's snapshots |
//!
//! A history never keeps the server from starting, nor ends anything else: while its file cannot be used, [`History::error`]
//! says why, and the thread retries.
//!
//! Points are stored in tiers ([`TIERS`]), each ten times as coarse as the one before and kept for longer. A query reads
//! the finest tier that has no more points than requested.

pub mod export;
pub mod store;
mod task;

use std::{
    path::PathBuf,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc::channel,
    },
    thread::JoinHandle,
    time::Duration,
};

use thiserror::Error;

use crate::model::config::HistoryConfig;
use crate::model::{clock::Clock, hub::Hub, stop::StopSignal};
use store::{HistoryQuery, HistoryResult, Store};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tier {
    /// Step between points of an object.
    pub step_ns: i64,
    /// Retention as a multiple of that of the finest tier.
    pub retention: i64,
}

/// From fine to coarse.
pub const TIERS: [Tier; 5] = [
    Tier { step_ns: 100_000_000, retention: 1 },
    Tier { step_ns: 1_000_000_000, retention: 7 },
    Tier { step_ns: 10_000_000_000, retention: 30 },
    Tier { step_ns: 100_000_000_000, retention: 365 },
    Tier { step_ns: 1_000_000_000_000, retention: 3650 },
];

/// [`History::start`] waits this long for the file. A disk that hangs delays the start no longer.
const OPEN_TIMEOUT: Duration = Duration::from_secs(1);
/// State before the first attempt to open the file has ended.
const OPENING: &str = "the disk has not answered yet";

#[derive(Debug, Error)]
pub enum HistoryError {
    #[error("cannot use the history {}: {source}; check `file` in [history]", .path.display())]
    Store { path: PathBuf, source: rusqlite::Error },
    #[error("the history {} is damaged", .path.display())]
    Damaged { path: PathBuf },
    #[error("cannot keep the damaged history {}: {source}; remove it, or set another `file` in [history]", .path.display())]
    SetAside { path: PathBuf, source: std::io::Error },
    /// Why nothing is stored at the moment.
    #[error("the history is not available: {0}. The server keeps trying.")]
    Unavailable(String),
    #[error(
        "the history {} was written by a newer Roundel (format {found}): use that version, or another `file` in [history]",
        .path.display()
    )]
    Newer { path: PathBuf, found: i64 },
    #[error(
        "expected at most {max_points} points, found more: select fewer objects, a shorter time, a region, or a larger \
         step_s"
    )]
    TooManyPoints { max_points: usize },
    #[error("the query was cancelled")]
    Stopped,
    /// The export format is not available.
    #[error("{0}")]
    Format(String),
}

impl HistoryError {
    /// Whether the file is not a database, or a damaged one.
    fn is_damage(&self) -> bool {
        use rusqlite::ErrorCode::{DatabaseCorrupt, NotADatabase};
        match self {
            Self::Store { source, .. } => {
                matches!(source.sqlite_error_code(), Some(DatabaseCorrupt | NotADatabase))
            }
            Self::Damaged { .. } => true,
            _ => false,
        }
    }
}

/// State of the store, shared by the thread that fills it and by queries.
#[derive(Default)]
struct Health {
    /// Why nothing is stored; empty while it works.
    error: Mutex<String>,
    /// A query has found damage.
    is_damaged: AtomicBool,
}

impl Health {
    /// Returns the state before.
    fn set_error(&self, error: &str) -> String {
        std::mem::replace(&mut lock(&self.error), error.to_owned())
    }

    fn take_damage(&self) -> bool {
        self.is_damaged.swap(false, Ordering::Relaxed)
    }
}

/// Fills and queries a history.
pub struct History {
    config: HistoryConfig,
    health: Arc<Health>,
    stop: StopSignal,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl History {
    /// Starts to fill the file. If it cannot be used, that is reported and retried.
    pub fn start(config: HistoryConfig, hub: Arc<Hub>, clock: Clock) -> Self {
        let (health, stop) = (Arc::<Health>::default(), StopSignal::default());
        health.set_error(OPENING);
        let (opened, first) = channel();
        let task = task::HistoryTask {
            config: config.clone(),
            hub,
            clock,
            health: health.clone(),
            stop: stop.clone(),
            opened,
        };
        let builder = std::thread::Builder::new().name("history".to_owned());
        let thread = match builder.spawn(move || task.run()) {
            Ok(thread) => Some(thread),
            Err(error) => {
                tracing::error!(%error, "cannot start the thread of the history: nothing is stored");
                health.set_error(&format!("its thread cannot be started: {error}"));
                None
            }
        };
        let _ = first.recv_timeout(OPEN_TIMEOUT);
        Self { config, health, stop, thread: Mutex::new(thread) }
    }

    /// Why nothing is stored at the moment; empty while it works.
    pub fn error(&self) -> String {
        lock(&self.health.error).clone()
    }

    /// Blocks on the disk. Ends early when the signal comes.
    pub fn query(
        &self,
        query: &HistoryQuery,
        stop: &StopSignal,
    ) -> Result<HistoryResult, HistoryError> {
        let error = self.error();
        if !error.is_empty() {
            return Err(HistoryError::Unavailable(error));
        }
        // A separate connection, so that readers and the writer do not wait for each other.
        let result =
            Store::open(&self.config.file).and_then(|store| store.query_until(query, stop));
        if result.as_ref().is_err_and(HistoryError::is_damage) {
            self.health.is_damaged.store(true, Ordering::Relaxed);
        }
        result
    }

    /// Signals the thread to stop, and returns it for joining.
    pub fn shut_down(&self) -> Option<JoinHandle<()>> {
        self.stop.stop();
        lock(&self.thread).take()
    }
}

impl Drop for History {
    fn drop(&mut self) {
        self.stop.stop();
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
