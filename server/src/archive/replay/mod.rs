//! Replay: serves a recording through the hub and APIs as if it were live, or fuses it again into another file.
//!
//! | module | what it does |
//! | --- | --- |
//! | [`reader`] | messages of the file in order, from any time |
//! | [`engine`] | feeds messages to the hub: as recorded, fused again, or detected and fused again |
//! | `player` | thread that paces messages: pause, speed, seek |
//! | [`session`] | a recording that is ready to be played |
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
use thiserror::Error;

use crate::fusion::setup::ObjectError;
use crate::{archive::record::file_reader::ReadError, model::config::Problem};

/// How many recorded seconds may pass in one.
pub const SPEEDS: [f64; 2] = [0.01, 100.0];

/// What is taken from a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ReplayFrom {
    /// Snapshots and events, as they are.
    #[default]
    Snapshots,
    /// Observations, to be fused anew.
    Observations,
    /// Frames, to be searched and fused anew.
    Frames,
}

/// Why a recording is not played.
#[derive(Debug, Error)]
pub enum ReplayError {
    /// It cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    #[error("cannot read {}: {source}", .path.display())]
    Io { path: PathBuf, source: std::io::Error },
    /// It has no message of the kind that is asked for.
    #[error("{}: has no {what}; {remedy}", .path.display())]
    Lacks { path: PathBuf, what: &'static str, remedy: &'static str },
    /// Its configuration is not one.
    #[error(
        "{}: the configuration {origin} cannot be used: {}; give another one with --config FILE",
        .path.display(), sentences(.problems)
    )]
    Config { path: PathBuf, origin: String, problems: Vec<Problem> },
    /// What is configured cannot be.
    #[error(transparent)]
    Object(#[from] ObjectError),
}

fn sentences(problems: &[Problem]) -> String {
    problems.iter().map(|problem| problem.message.as_str()).collect::<Vec<_>>().join("; ")
}

/// What is to be done, and how far it is.
#[derive(Clone, Debug, Default)]
pub struct ReplayStatus {
    pub file: PathBuf,
    pub from: ReplayFrom,
    pub paused: bool,
    /// Recorded seconds in one.
    pub speed: f64,
    /// It begins again after the end.
    pub looping: bool,
    /// Log times of the first and the last message.
    pub span: (Timestamp, Timestamp),
    /// The recorded instant that is being played.
    pub position: Timestamp,
    /// It waits at the end.
    pub ended: bool,
    /// What cannot be read.
    pub damage: Vec<String>,
}

/// What is to become of a replay; `None`: as before.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Control {
    /// Whether nothing is to go on.
    pub paused: Option<bool>,
    /// Recorded seconds in one, within [`SPEEDS`].
    pub speed: Option<f64>,
    /// Where to go on, seconds from the begin.
    pub position_s: Option<f64>,
    /// Whether it begins again after the end.
    pub looping: Option<bool>,
}

#[derive(Default)]
struct State {
    status: ReplayStatus,
    seek: Option<Timestamp>,
    stopped: bool,
}

/// A handle on a recording that is being played; clones are the same.
#[derive(Clone, Default)]
pub struct Replay {
    shared: Arc<(Mutex<State>, Condvar)>,
}

impl Replay {
    /// Of a recording that has not begun.
    pub fn new(status: ReplayStatus) -> Self {
        let state = State { status, ..State::default() };
        Self { shared: Arc::new((Mutex::new(state), Condvar::new())) }
    }

    pub fn status(&self) -> ReplayStatus {
        self.lock().status.clone()
    }

    /// Has it obey, at once.
    pub fn control(&self, control: &Control) {
        let mut state = self.lock();
        let status = &mut state.status;
        control.paused.into_iter().for_each(|paused| status.paused = paused);
        control.speed.into_iter().for_each(|speed| status.speed = speed);
        control.looping.into_iter().for_each(|looping| status.looping = looping);
        let (begin, end) = status.span;
        // Playing on from the end is beginning again.
        let again = (status.ended && control.paused == Some(false)).then_some(0.0);
        if let Some(position_s) = control.position_s.or(again) {
            let position = begin.plus_seconds(position_s.max(0.0)).min(end);
            (status.position, status.ended) = (position, false);
            state.seek = Some(position);
        }
        drop(state);
        self.shared.1.notify_all();
    }

    /// Ends it for good.
    pub fn stop(&self) {
        self.lock().stopped = true;
        self.shared.1.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.shared.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
