//! History: where objects were, in an SQLite file that stays small enough to keep for months.
//!
//! | module | what it does |
//! | --- | --- |
//! | [`export`] | tables for other programs |
//! | [`store`] | the file: what is kept, what is forgotten, what is asked |
//! | `task` | the thread that fills it from the hub's snapshots |
//!
//! Points are kept in tiers ([`TIERS`]), each ten times as coarse as the one before and kept for longer; a query is
//! answered out of the finest tier that gives no more points than are wanted.

pub mod export;
pub mod store;
mod task;

use std::{path::PathBuf, sync::Arc, thread::JoinHandle};

use thiserror::Error;

use crate::model::config::HistoryConfig;
use crate::model::{hub::Hub, stop::StopSignal};
use store::{HistoryQuery, HistoryResult, Store};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tier {
    /// From one point of an object to the next.
    pub step_ns: i64,
    /// How many times as long as the finest tier it is kept.
    pub kept: i64,
}

/// All of them, the finest first.
pub const TIERS: [Tier; 5] = [
    Tier { step_ns: 100_000_000, kept: 1 },
    Tier { step_ns: 1_000_000_000, kept: 7 },
    Tier { step_ns: 10_000_000_000, kept: 30 },
    Tier { step_ns: 100_000_000_000, kept: 365 },
    Tier { step_ns: 1_000_000_000_000, kept: 3650 },
];

/// Why there is no answer.
#[derive(Debug, Error)]
pub enum HistoryError {
    /// The file is not one, or cannot be used.
    #[error("the history {}: {source}; `file` in [history] says where it is", .path.display())]
    Store { path: PathBuf, source: rusqlite::Error },
    /// It is of a later version.
    #[error(
        "the history {} was written by a newer Roundel (format {found}): use that one, or name another `file` in [history]",
        .path.display()
    )]
    Newer { path: PathBuf, found: i64 },
    /// The query is for too much.
    #[error("{0}")]
    TooManyPoints(String),
    /// The form that is asked for cannot be written.
    #[error("{0}")]
    Format(String),
}

/// Fills a history and answers questions about it.
pub struct History {
    config: HistoryConfig,
    stop: StopSignal,
    thread: std::sync::Mutex<Option<JoinHandle<()>>>,
}

impl History {
    /// Opens the file, which is made if it is not there, and begins to fill it.
    pub fn start(config: HistoryConfig, hub: Arc<Hub>) -> Result<Self, HistoryError> {
        let store = Store::open(&config.file)?;
        let stop = StopSignal::default();
        let (until, keep) = (stop.clone(), config.keep);
        let builder = std::thread::Builder::new().name("history".to_owned());
        let thread = match builder.spawn(move || task::run(store, &hub, keep, &until)) {
            Ok(thread) => Some(thread),
            Err(error) => {
                tracing::error!(%error, "no history is kept: the system gives no thread");
                None
            }
        };
        Ok(Self { config, stop, thread: std::sync::Mutex::new(thread) })
    }

    /// Answers a query; may wait for the disk.
    pub fn query(&self, query: &HistoryQuery) -> Result<HistoryResult, HistoryError> {
        // Readers do not wait for the writer, nor it for them.
        Store::open(&self.config.file)?.query(query)
    }

    /// Ends, and gives its thread to be waited for.
    pub fn shut_down(&self) -> Option<JoinHandle<()>> {
        self.stop.stop();
        self.thread.lock().unwrap_or_else(std::sync::PoisonError::into_inner).take()
    }
}

impl Drop for History {
    fn drop(&mut self) {
        self.stop.stop();
    }
}
