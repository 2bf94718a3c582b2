//! The thread that plays a recording: processes each message when it is due, and reacts to controls in between.

use std::{
    sync::PoisonError,
    time::{Duration, Instant},
};

use roundel_core::time::Timestamp;

use super::{Replay, ReplayError, State, session::ReplaySession};
use crate::archive::record::{
    file_reader::{Channel, RecordedMessage},
    schema::Topic,
};

enum Step {
    Play,
    Seek(Timestamp),
    Stop,
}

pub struct Player {
    session: ReplaySession,
    replay: Replay,
    /// An instant, and the recorded time that was due then.
    base: (Instant, Timestamp),
    speed: f64,
    /// Set by a seek: the next snapshot is played even during a pause.
    needs_first_snapshot: bool,
}

impl Player {
    pub fn new(session: ReplaySession, replay: Replay) -> Self {
        let (begin, _) = session.reader.span();
        let base = (Instant::now(), begin);
        Self { session, replay, base, speed: 1.0, needs_first_snapshot: true }
    }

    /// Plays until the replay is stopped.
    pub fn run(mut self) {
        if let Err(error) = self.play() {
            tracing::error!("the replay failed: {error}");
            let mut state = self.replay.lock();
            state.status.ended = true;
            state.status.damage.push(error.to_string());
        }
    }

    fn play(&mut self) -> Result<(), ReplayError> {
        let begin = self.replay.status().position;
        self.seek(begin)?;
        loop {
            let message = self.session.reader.take()?;
            let step = match &message {
                Some(message) => self.wait_for(message.log_time),
                None => self.wait_at_the_end(),
            };
            match (step, message) {
                (Step::Seek(time), _) => self.seek(time)?,
                (Step::Play, Some(message)) => self.play_message(&message),
                (Step::Stop, _) | (Step::Play, None) => return Ok(()),
            }
        }
    }

    fn play_message(&mut self, message: &RecordedMessage) {
        self.session.engine.process(message, &mut self.session.reader);
        if message.channel == Channel::Topic(Topic::Snapshots) {
            self.needs_first_snapshot = false;
        }
        let mut state = self.replay.lock();
        state.status.position = message.log_time.max(state.status.position);
    }

    fn seek(&mut self, time: Timestamp) -> Result<(), ReplayError> {
        self.session.reader.seek(time);
        self.session.engine.restart(&self.session.updates, time)?;
        self.needs_first_snapshot = true;
        self.base = (Instant::now(), time);
        let damage = self.session.reader.file().damage().sentences.clone();
        let mut state = self.replay.lock();
        (state.status.damage, state.status.ended) = (damage, false);
        Ok(())
    }

    /// Waits until a recorded time is due.
    fn wait_for(&mut self, time: Timestamp) -> Step {
        let mut state = self.replay.lock();
        let changed = &self.replay.shared.1;
        let mut was_paused = false;
        loop {
            if let Some(step) = state.take_step() {
                return step;
            }
            let now = Instant::now();
            if self.needs_first_snapshot {
                self.base = (now, time);
                return Step::Play;
            }
            if state.status.paused {
                was_paused = true;
                state = changed.wait(state).unwrap_or_else(PoisonError::into_inner);
                continue;
            }
            if std::mem::take(&mut was_paused) || state.status.speed != self.speed {
                self.speed = state.status.speed;
                self.base = (now, state.status.position);
            }
            let (since, from) = self.base;
            let wait_s = time.seconds_since(from) / self.speed;
            let due = since + Duration::from_secs_f64(wait_s.max(0.0));
            if due <= now {
                return Step::Play;
            }
            let waited = changed.wait_timeout(state, due - now);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    fn wait_at_the_end(&mut self) -> Step {
        let mut state = self.replay.lock();
        let changed = &self.replay.shared.1;
        let (begin, end) = state.status.span;
        (state.status.ended, state.status.position) = (true, end);
        state.status.damage = self.session.reader.file().damage().sentences.clone();
        loop {
            if let Some(step) = state.take_step() {
                return step;
            }
            if state.status.looping && !state.status.paused {
                state.status.position = begin;
                return Step::Seek(begin);
            }
            state = changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }
}

impl State {
    /// A stop or a seek requested since the last call.
    fn take_step(&mut self) -> Option<Step> {
        if self.stopped { Some(Step::Stop) } else { self.seek.take().map(Step::Seek) }
    }
}
