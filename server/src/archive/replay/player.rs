//! The thread that plays: each message when it is due, and obedience in between.

use std::{
    sync::PoisonError,
    time::{Duration, Instant},
};

use roundel_core::time::Timestamp;

use super::{
    Replay, ReplayError,
    engine::Engine,
    reader::{FusionUpdate, Reader},
};
use crate::archive::record::{
    file_reader::{Channel, RecordedMessage},
    schema::Topic,
};

/// What is to be done before a message happens.
enum PlayerStep {
    Play,
    Seek(Timestamp),
    /// End.
    StopSignal,
}

pub struct Player {
    pub reader: Reader,
    pub engine: Engine,
    pub updates: Vec<(Timestamp, FusionUpdate)>,
    pub replay: Replay,
    /// When what was due.
    base: (Instant, Timestamp),
    speed: f64,
    /// The first snapshot of a new place is shown even while nothing goes on.
    needs_first_snapshot: bool,
}

impl Player {
    pub fn new(
        (reader, engine): (Reader, Engine),
        updates: Vec<(Timestamp, FusionUpdate)>,
        replay: Replay,
    ) -> Self {
        let (begin, _) = reader.span();
        let base = (Instant::now(), begin);
        Self { reader, engine, updates, replay, base, speed: 1.0, needs_first_snapshot: true }
    }

    /// Plays until it is told to end.
    pub fn run(mut self) {
        if let Err(error) = self.play() {
            tracing::error!("the replay ends: {error}");
            let mut state = self.replay.lock();
            state.status.ended = true;
            state.status.damage.push(error.to_string());
        }
    }

    fn play(&mut self) -> Result<(), ReplayError> {
        let begin = self.replay.status().position;
        self.seek(begin)?;
        loop {
            let Some(message) = self.reader.take()? else {
                match self.wait_at_the_end() {
                    PlayerStep::Seek(time) => self.seek(time)?,
                    PlayerStep::Play | PlayerStep::StopSignal => return Ok(()),
                }
                continue;
            };
            match self.wait_for(message.log_time) {
                PlayerStep::StopSignal => return Ok(()),
                PlayerStep::Seek(time) => self.seek(time)?,
                PlayerStep::Play => self.play_message(&message),
            }
        }
    }

    fn play_message(&mut self, message: &RecordedMessage) {
        self.engine.process(message, &mut self.reader);
        if message.channel == Channel::Topic(Topic::Snapshots) {
            self.needs_first_snapshot = false;
        }
        let mut state = self.replay.lock();
        let position = state.status.position.max(message.log_time);
        state.status.position = position;
    }

    fn seek(&mut self, time: Timestamp) -> Result<(), ReplayError> {
        self.reader.seek(time);
        self.engine.restart(&self.updates, time)?;
        self.needs_first_snapshot = true;
        self.base = (Instant::now(), time);
        let damage = self.reader.file().damage().sentences.clone();
        let mut state = self.replay.lock();
        (state.status.damage, state.status.ended) = (damage, false);
        Ok(())
    }

    /// Waits until what was recorded then is due.
    fn wait_for(&mut self, time: Timestamp) -> PlayerStep {
        let (mutex, changed) = &*self.replay.shared;
        let mut state = mutex.lock().unwrap_or_else(PoisonError::into_inner);
        let mut was_paused = false;
        loop {
            if state.stopped {
                return PlayerStep::StopSignal;
            }
            if let Some(time) = state.seek.take() {
                return PlayerStep::Seek(time);
            }
            let now = Instant::now();
            if self.needs_first_snapshot {
                self.base = (now, time);
                return PlayerStep::Play;
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
                return PlayerStep::Play;
            }
            let waited = changed.wait_timeout(state, due - now);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    fn wait_at_the_end(&mut self) -> PlayerStep {
        let (mutex, changed) = &*self.replay.shared;
        let mut state = mutex.lock().unwrap_or_else(PoisonError::into_inner);
        let (begin, end) = state.status.span;
        (state.status.ended, state.status.position) = (true, end);
        state.status.damage = self.reader.file().damage().sentences.clone();
        loop {
            if state.stopped {
                return PlayerStep::StopSignal;
            }
            if let Some(time) = state.seek.take() {
                return PlayerStep::Seek(time);
            }
            if state.status.looping && !state.status.paused {
                state.status.position = begin;
                return PlayerStep::Seek(begin);
            }
            state = changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }
}
