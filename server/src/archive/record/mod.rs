//! Recording: what is served goes into files as well, to be looked at, replayed and judged later.
//!
//! | module | what it does |
//! | --- | --- |
//! | [`tap`] | takes what is recorded, without holding anybody up |
//! | `task` | the thread that writes it, rotates files and keeps to the budget |
//! | [`item`] | what was taken, as messages |
//! | [`file_writer`] | one MCAP file, readable to its last complete chunk whatever happens |
//! | [`schema`] | its topics and their schemas |
//! | [`frame_compression`] | frames as image files |
//! | [`folder`] | names, the budget, what room there is |
//! | [`file_reader`] | a file again, however broken |
//!
//! One recording at a time. Whatever goes wrong with it ends it, is told, and touches nothing else.

pub mod file_reader;
pub mod file_writer;
pub mod folder;
pub mod frame_compression;
pub mod item;
pub mod schema;
mod task;

use std::{
    io,
    path::PathBuf,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    thread::JoinHandle,
    time::Duration,
};

use roundel_core::time::Timestamp;
use thiserror::Error;

use crate::model::config::RecordingConfig;
use crate::model::{clock::Clock, hub::Hub};
use folder::RecordingFile;

/// What a recording is to be.
#[derive(Clone, Debug, Default)]
pub struct RecordingOptions {
    /// Begin of its files' names; empty: the installation's.
    pub name: String,
    /// One in so many frames; `None`: as configured.
    pub frames_every: Option<u32>,
    /// `None`: until it is ended.
    pub length: Option<Duration>,
}

/// Why nothing is recorded, or not ended.
#[derive(Debug, Error)]
pub enum RecordError {
    #[error("a recording is being made, into {0}: end it first")]
    Busy(String),
    /// There is none.
    #[error("nothing is being recorded")]
    NotRecording,
    #[error("{0}")]
    Name(String),
    /// The folder cannot be written.
    #[error("cannot record into {}: {source}; correct `folder` in [recording], or its permissions", .folder.display())]
    Folder { folder: PathBuf, source: io::Error },
    #[error(
        "the disk of {} has {} left, and `min_free_mb` in [recording] keeps {} of it: make room, or record elsewhere",
        .folder.display(), megabytes(*.free_bytes), megabytes(*.min_free_bytes)
    )]
    Full { folder: PathBuf, free_bytes: u64, min_free_bytes: u64 },
    /// The system gives no thread.
    #[error("cannot start the thread of the recording: {0}")]
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

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RecordingState {
    /// There was none.
    #[default]
    Idle,
    Recording,
    Stopped,
    Failed,
}

/// How the recording that is being made is doing, or the last one did.
#[derive(Clone, Debug, Default)]
pub struct RecordingStatus {
    pub state: RecordingState,
    /// Its newest file, without folder.
    pub file: String,
    pub folder: PathBuf,
    pub started: Timestamp,
    /// How long it has lasted, seconds.
    pub seconds: f64,
    pub bytes: u64,
    pub files: u32,
    pub messages: u64,
    /// Messages that are missing, since the disk is too slow.
    pub dropped: u64,
    pub disk_free_bytes: u64,
    pub budget_bytes: u64,
    pub deleted: u32,
    /// Why it ended by itself, and what to do.
    pub error: String,
    /// One in so many frames is kept; 0: none.
    pub frames_every: u32,
}

/// The configuration's text as it is now, without passwords.
pub type ConfigurationText = Box<dyn Fn() -> String + Send + Sync>;

/// Starts, follows and ends recordings.
pub struct Recorder {
    shared: Arc<RecorderShared>,
    running: Mutex<Option<JoinHandle<()>>>,
}

/// What the task's thread needs, too.
struct RecorderShared {
    hub: Arc<Hub>,
    clock: Clock,
    config: RecordingConfig,
    text: ConfigurationText,
    status: Mutex<RecordingStatus>,
}

impl Recorder {
    /// One that has not recorded anything.
    pub fn new(
        hub: Arc<Hub>,
        clock: Clock,
        config: RecordingConfig,
        text: ConfigurationText,
    ) -> Self {
        let status = RecordingStatus {
            folder: config.folder.clone(),
            budget_bytes: config.budget_bytes,
            frames_every: config.frames_every,
            ..RecordingStatus::default()
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
        if let Some(strange) = options.name.chars().find(|it| !folder::is_allowed_char(*it)) {
            return Err(RecordError::Name(format!(
                "expected a name of letters, digits, `-`, `_` and `.`, found {strange:?} in {:?}",
                options.name
            )));
        }
        if options.name.len() > folder::MAX_NAME_LEN {
            return Err(RecordError::Name(format!(
                "expected a name of at most {} characters, found {}",
                folder::MAX_NAME_LEN,
                options.name.len()
            )));
        }
        let task = task::RecordingTask::start(self.shared.clone(), options)?;
        let builder = std::thread::Builder::new().name("recording".to_owned());
        *running = Some(builder.spawn(move || task.run()).map_err(RecordError::Thread)?);
        Ok(())
    }

    /// Ends the recording; when this returns its file is whole.
    pub fn stop(&self) -> Result<(), RecordError> {
        let thread = lock(&self.running).take().filter(|thread| !thread.is_finished());
        let thread = thread.ok_or(RecordError::NotRecording)?;
        self.shared.hub.tap().close();
        if thread.join().is_err() {
            tracing::error!("the recording ended with a panic");
        }
        Ok(())
    }

    pub fn status(&self) -> RecordingStatus {
        let mut status = self.shared.status().clone();
        if status.state == RecordingState::Recording {
            status.seconds = self.shared.clock.now().seconds_since(status.started);
            status.dropped = self.shared.hub.tap().dropped();
        }
        status
    }

    /// The files in the folder, the oldest first.
    pub fn list(&self) -> Result<Vec<RecordingFile>, RecordError> {
        let folder = &self.shared.config.folder;
        folder::list(folder)
            .map_err(|source| RecordError::Folder { folder: folder.clone(), source })
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        // Nothing runs, mostly.
        let _ = self.stop();
    }
}

impl RecorderShared {
    fn status(&self) -> MutexGuard<'_, RecordingStatus> {
        lock(&self.status)
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
