//! The thread that plays: each message when it is due, and obedience in between.

use std::{
    sync::PoisonError,
    time::{Duration, Instant},
};

use roundel_core::time::Timestamp;

use super::{
    Replay, ReplayError,
    script::{Script, Told},
    stage::Stage,
};
use crate::archive::record::{
    reader::{Raw, Source},
    schema::Topic,
};

/// What is to be done before a message happens.
enum Turn {
    /// It is due.
    Play,
    /// Go on elsewhere.
    Seek(Timestamp),
    /// End.
    Stop,
}

/// Plays a recording.
pub struct Player {
    pub script: Script,
    pub stage: Stage,
    pub told: Vec<(Timestamp, Told)>,
    pub replay: Replay,
    /// When what was due.
    base: (Instant, Timestamp),
    speed: f64,
    /// The first snapshot of a new place is shown even while nothing goes on.
    shows_one: bool,
}

impl Player {
    pub fn new(
        (script, stage): (Script, Stage),
        told: Vec<(Timestamp, Told)>,
        replay: Replay,
    ) -> Self {
        let (begin, _) = script.span();
        let base = (Instant::now(), begin);
        Self { script, stage, told, replay, base, speed: 1.0, shows_one: true }
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
            let Some(raw) = self.script.take()? else {
                match self.wait_at_the_end() {
                    Turn::Seek(time) => self.seek(time)?,
                    Turn::Play | Turn::Stop => return Ok(()),
                }
                continue;
            };
            match self.wait_for(raw.log_time) {
                Turn::Stop => return Ok(()),
                Turn::Seek(time) => self.seek(time)?,
                Turn::Play => self.show(&raw),
            }
        }
    }

    fn show(&mut self, raw: &Raw) {
        self.stage.show(raw, &mut self.script);
        if raw.source == Source::Topic(Topic::Snapshots) {
            self.shows_one = false;
        }
        let mut state = self.replay.lock();
        let position = state.status.position.max(raw.log_time);
        state.status.position = position;
    }

    fn seek(&mut self, time: Timestamp) -> Result<(), ReplayError> {
        self.script.seek(time);
        self.stage.restart(&self.told, time)?;
        self.shows_one = true;
        self.base = (Instant::now(), time);
        let damage = self.script.reader().damage().sentences.clone();
        let mut state = self.replay.lock();
        (state.status.damage, state.status.ended) = (damage, false);
        Ok(())
    }

    /// Waits until what was recorded then is due.
    fn wait_for(&mut self, time: Timestamp) -> Turn {
        let (mutex, changed) = &*self.replay.shared;
        let mut state = mutex.lock().unwrap_or_else(PoisonError::into_inner);
        let mut was_paused = false;
        loop {
            if state.stopped {
                return Turn::Stop;
            }
            if let Some(time) = state.seek.take() {
                return Turn::Seek(time);
            }
            let now = Instant::now();
            if self.shows_one {
                self.base = (now, time);
                return Turn::Play;
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
                return Turn::Play;
            }
            let waited = changed.wait_timeout(state, due - now);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    fn wait_at_the_end(&mut self) -> Turn {
        let (mutex, changed) = &*self.replay.shared;
        let mut state = mutex.lock().unwrap_or_else(PoisonError::into_inner);
        let (begin, end) = state.status.span;
        (state.status.ended, state.status.position) = (true, end);
        state.status.damage = self.script.reader().damage().sentences.clone();
        loop {
            if state.stopped {
                return Turn::Stop;
            }
            if let Some(time) = state.seek.take() {
                return Turn::Seek(time);
            }
            if state.status.looping && !state.status.paused {
                state.status.position = begin;
                return Turn::Seek(begin);
            }
            state = changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }
}
