//! Replay: serves a recording through the hub and APIs as if it were live, or fuses it again into another file.
//!
//! | module | purpose |
//! | --- | --- |
//! | [`reader`] | messages of the file in order, from any time |
//! | [`engine`] | feeds messages to the hub: as recorded, fused again, or detected and fused again |
//! | [`player`] | thread that paces messages: pause, speed, seek |
//! | [`session`] | an opened recording with its reader, engine, hub and clock |
//! | [`from_recording`] | recorded messages as core's and the hub's types |
//! | [`copy`] | fuses at full speed into a file |
//! | [`correspondences`] | fuses without one camera, and matches its detections to the others' tracks |
//!
//! Message times are those of the recording. The server's clock starts at the recording's start and runs in real time, so
//! after a pause, a seek or a change of speed it differs from the playback position, which the status reports.

pub mod copy;
pub mod correspondences;
pub mod engine;
pub mod from_recording;
pub mod player;
pub mod reader;
pub mod session;

use std::{
    path::PathBuf,
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
};

use roundel_core::time::Timestamp;
use roundel_proto::v1;
use thiserror::Error;

use crate::fusion::setup::ObjectError;
use crate::{archive::record::file_reader::ReadError, model::config::Problem};

/// Minimum and maximum speed: recorded seconds per second.
pub const SPEEDS: [f64; 2] = [0.01, 100.0];

/// The recorded messages that a replay starts from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ReplayFrom {
    /// Plays snapshots and events as recorded.
    #[default]
    Snapshots,
    /// Fuses observations again.
    Observations,
    /// Searches frames and fuses their observations again.
    Frames,
}

#[derive(Debug, Error)]
pub enum ReplayError {
    #[error(transparent)]
    Read(#[from] ReadError),
    #[error("cannot read {}: {source}", .path.display())]
    Io { path: PathBuf, source: std::io::Error },
    #[error("{}: the recording has no {what}; {remedy}", .path.display())]
    Lacks { path: PathBuf, what: &'static str, remedy: &'static str },
    #[error(
        "{}: the configuration {origin} cannot be used: {}; use another one with --config FILE",
        .path.display(), sentences(.problems)
    )]
    Config { path: PathBuf, origin: String, problems: Vec<Problem> },
    #[error(transparent)]
    Object(#[from] ObjectError),
}

fn sentences(problems: &[Problem]) -> String {
    problems.iter().map(|problem| problem.message.as_str()).collect::<Vec<_>>().join("; ")
}

/// Settings and position of a replay.
#[derive(Clone, Debug, Default)]
pub struct ReplayStatus {
    pub file: PathBuf,
    pub from: ReplayFrom,
    pub paused: bool,
    /// Recorded seconds per second.
    pub speed: f64,
    /// Whether it restarts after the end.
    pub looping: bool,
    /// Log times of the first and the last message.
    pub span: (Timestamp, Timestamp),
    /// Recorded time of the newest message played.
    pub position: Timestamp,
    /// Whether it waits at the end.
    pub ended: bool,
    /// Unreadable parts of the file.
    pub damage: Vec<String>,
}

#[derive(Default)]
struct State {
    status: ReplayStatus,
    seek: Option<Timestamp>,
    stopped: bool,
}

/// Handle of a replay. Clones control the same replay.
#[derive(Clone, Default)]
pub struct Replay {
    shared: Arc<(Mutex<State>, Condvar)>,
}

impl Replay {
    pub fn new(status: ReplayStatus) -> Self {
        let state = State { status, ..State::default() };
        Self { shared: Arc::new((Mutex::new(state), Condvar::new())) }
    }

    pub fn status(&self) -> ReplayStatus {
        self.lock().status.clone()
    }

    /// Applies checked changes: a speed within [`SPEEDS`], a position within the recording.
    pub fn control(&self, control: &v1::ControlReplayRequest) {
        let mut state = self.lock();
        let status = &mut state.status;
        status.paused = control.paused.unwrap_or(status.paused);
        status.speed = control.speed.unwrap_or(status.speed);
        status.looping = control.looping.unwrap_or(status.looping);
        let (begin, end) = status.span;
        // Resuming at the end restarts.
        let again = (status.ended && control.paused == Some(false)).then_some(0.0);
        if let Some(position_s) = control.position_s.or(again) {
            let position = begin.plus_seconds(position_s.max(0.0)).min(end);
            (status.position, status.ended) = (position, false);
            state.seek = Some(position);
        }
        drop(state);
        self.shared.1.notify_all();
    }

    pub fn stop(&self) {
        self.lock().stopped = true;
        self.shared.1.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.shared.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
