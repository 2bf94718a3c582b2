//! Recording: writes everything that is served into MCAP files, for inspection, replay and evaluation.
//!
//! | module | purpose |
//! | --- | --- |
//! | `task` | the thread that writes items, rotates files and enforces the disk budget |
//! | [`item`] | items of the [tap](crate::model::tap) as messages |
//! | [`file_writer`] | writes one MCAP file, readable to its last complete chunk at any time |
//! | [`schema`] | topics and their schemas |
//! | [`frame_compression`] | frames as image files |
//! | [`standing`] | the recording that starts with the server, retried with backoff |
//! | [`folder`] | names, disk budget and free space |
//! | [`file_reader`] | reads a file, even a damaged one |
//! | `chunk` | parses records and chunks within bounds |
//!
//! One recording runs at a time. An error ends the recording, is reported, and affects nothing else.

mod chunk;
pub mod file_reader;
pub mod file_writer;
pub mod folder;
pub mod frame_compression;
pub mod item;
pub mod schema;
pub mod standing;
mod task;

use std::{
    io,
    panic::{AssertUnwindSafe, catch_unwind},
    path::PathBuf,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    thread::JoinHandle,
    time::Duration,
};

use roundel_core::time::Timestamp;
use roundel_proto::v1;
use thiserror::Error;

use crate::model::config::RecordingConfig;
use crate::model::{
    clock::Clock,
    hub::{EventKind, Hub},
};
use folder::RecordingFile;

#[derive(Clone, Debug, Default)]
pub struct RecordingOptions {
    /// Prefix of the file names; empty: the installation's name.
    pub name: String,
    /// Records every n-th frame, 0: none; `None`: as configured.
    pub frames_every: Option<u32>,
    /// `None`: until it is stopped.
    pub length: Option<Duration>,
    /// A client has started it: files of other recordings younger than `keep_hours` in \[recording\] are not deleted for it.
    pub by_client: bool,
}

#[derive(Debug, Error)]
pub enum RecordError {
    #[error("a recording into {0} is running: stop it first")]
    Busy(String),
    #[error("no recording is running")]
    NotRecording,
    #[error("{0}")]
    Name(String),
    #[error("cannot record into {}: {source}; correct `folder` in [recording], or its permissions", .folder.display())]
    Folder { folder: PathBuf, source: io::Error },
    #[error(
        "the disk of {} has {} left, less than `min_free_mb` = {} in [recording]: free some space, or change `folder`",
        .folder.display(), megabytes(*.free_bytes), megabytes(*.min_free_bytes)
    )]
    Full { folder: PathBuf, free_bytes: u64, min_free_bytes: u64 },
    #[error(
        "the recordings of the last `keep_hours` = {} in [recording] take up {} of `budget_gb` = {}, which leaves too little \
         for another one: delete or pin (`chmod a-w`) some, raise `budget_gb`, or lower `keep_hours`",
        .keep.as_secs_f64() / 3600.0, megabytes(*.kept_bytes), *.budget_bytes as f64 / 1e9
    )]
    Budget { keep: Duration, kept_bytes: u64, budget_bytes: u64 },
    #[error("cannot start the recording thread: {0}")]
    Thread(io::Error),
}

/// `12 MB`.
pub fn megabytes(bytes: u64) -> String {
    match bytes {
        0..10_000_000 => format!("{:.1} MB", bytes as f64 / 1e6),
        10_000_000..10_000_000_000 => format!("{:.0} MB", bytes as f64 / 1e6),
        _ => format!("{:.1} GB", bytes as f64 / 1e9),
    }
}

/// Returns the current text of the configuration, without secrets.
pub type ConfigurationText = Box<dyn Fn() -> String + Send + Sync>;

/// Starts, stops and reports recordings.
pub struct Recorder {
    shared: Arc<RecorderShared>,
    running: Mutex<Option<JoinHandle<()>>>,
}

/// State shared with the recording thread.
struct RecorderShared {
    hub: Arc<Hub>,
    clock: Clock,
    config: RecordingConfig,
    text: ConfigurationText,
    status: Mutex<v1::Recording>,
}

impl Recorder {
    pub fn new(
        hub: Arc<Hub>,
        clock: Clock,
        config: RecordingConfig,
        text: ConfigurationText,
    ) -> Self {
        let status = v1::Recording {
            state: v1::RecordingState::Idle.into(),
            folder: config.folder.display().to_string(),
            budget_bytes: config.budget_bytes,
            frames_every: config.frames_every,
            ..v1::Recording::default()
        };
        let status = Mutex::new(status);
        let shared = Arc::new(RecorderShared { hub, clock, config, text, status });
        Self { shared, running: Mutex::default() }
    }

    pub fn start(&self, options: &RecordingOptions) -> Result<(), RecordError> {
        let mut running = lock(&self.running);
        if running.as_ref().is_some_and(|thread| !thread.is_finished()) {
            return Err(RecordError::Busy(self.status().file));
        }
        let (name, max_len) = (&options.name, folder::MAX_NAME_LEN);
        if let Some(other) = name.chars().find(|it| !folder::is_allowed_char(*it)) {
            return Err(RecordError::Name(format!(
                "expected a name of letters, digits, `-`, `_` and `.`, found {other:?} in {name:?}"
            )));
        }
        if name.len() > max_len {
            return Err(RecordError::Name(format!(
                "expected a name of at most {max_len} characters, found {}",
                name.len()
            )));
        }
        let task = task::RecordingTask::start(self.shared.clone(), options)?;
        let shared = self.shared.clone();
        let run = move || {
            // Ends this recording and nothing else. The task is not used again.
            if catch_unwind(AssertUnwindSafe(|| task.run())).is_err() {
                shared.hub.tap().close();
                shared.fail("internal error, please report it with the log");
            }
        };
        let builder = std::thread::Builder::new().name("recording".to_owned());
        *running = Some(builder.spawn(run).map_err(RecordError::Thread)?);
        Ok(())
    }

    /// Shows why the recording was not started, with an event unless that was reported before.
    fn note_not_started(&self, error: &str, is_reported: bool) {
        let mut status = self.shared.status();
        status.state = v1::RecordingState::Failed.into();
        error.clone_into(&mut status.error);
        drop(status);
        if !is_reported {
            let message = format!(
                "The recording was not started: {error}. Retried until it works; nothing else is affected."
            );
            tracing::error!("{message}");
            let now = self.shared.clock.now();
            self.shared.hub.publish_event(now, EventKind::RecordingFailed, message);
        }
    }

    /// Ends the recording; its file is complete when this returns.
    pub fn stop(&self) -> Result<(), RecordError> {
        let thread = lock(&self.running).take().filter(|thread| !thread.is_finished());
        let thread = thread.ok_or(RecordError::NotRecording)?;
        self.shared.hub.tap().close();
        // A panic was reported by the thread.
        let _ = thread.join();
        Ok(())
    }

    /// Status of the running recording, or of the last one.
    pub fn status(&self) -> v1::Recording {
        let mut status = self.shared.status().clone();
        if status.state() == v1::RecordingState::Recording {
            let started = Timestamp::from_ns(status.started_time_ns);
            status.seconds = self.shared.clock.now().seconds_since(started);
            status.dropped = self.shared.hub.tap().dropped();
        }
        status
    }

    /// Files of recordings, the oldest first.
    pub fn list(&self) -> Result<Vec<RecordingFile>, RecordError> {
        let folder = &self.shared.config.folder;
        folder::list(folder)
            .map_err(|source| RecordError::Folder { folder: folder.clone(), source })
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // Fails if no recording is running.
        let _ = self.stop();
    }
}

impl RecorderShared {
    /// Reports a failed recording.
    fn fail(&self, error: &str) {
        let mut status = self.status();
        status.state = v1::RecordingState::Failed.into();
        error.clone_into(&mut status.error);
        drop(status);
        let message = format!(
            "The recording failed: {error}. Data recorded before the failure remain readable; nothing else is affected."
        );
        tracing::error!("{message}");
        self.hub.publish_event(self.clock.now(), EventKind::RecordingFailed, message);
    }

    fn status(&self) -> MutexGuard<'_, v1::Recording> {
        lock(&self.status)
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
