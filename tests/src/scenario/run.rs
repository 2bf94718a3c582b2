//! Feeds frames to fusion as they arrive, and scores snapshots at regular ticks.

use std::time::{Duration, Instant};

use roundel_core::{
    time::Timestamp,
    world::{EventKind, FrameObservations, Fusion, FusionCounts, FusionParams},
};

use crate::{
    arena::Arena,
    pipeline::{fusion, message},
    score::{Judge, Score},
};

/// Frames that are generated at a time.
const BLOCK: usize = 100;

/// Ticks at which snapshots are made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ticks {
    pub rate_hz: f64,
    /// Time of the first scored tick, seconds after the arena's start.
    pub judged_from_s: f64,
}

/// One run in virtual time, which is the frames' arrival time.
#[derive(Clone, Debug)]
pub struct Run<'a> {
    arena: &'a Arena,
    ticks: Ticks,
    fusion: Fusion,
    judge: Judge,
    done: u64,
    /// Time in fusion's calls, tick by tick.
    spent: Vec<Duration>,
    events: Vec<EventKind>,
}

#[derive(Clone, Debug)]
pub struct Outcome {
    pub score: Score,
    pub counts: FusionCounts,
    pub events: Vec<EventKind>,
    /// Time in fusion's calls, tick by tick.
    pub spent: Vec<Duration>,
}

impl<'a> Run<'a> {
    /// With default fusion parameters and known camera poses.
    pub fn new(arena: &'a Arena, ticks: Ticks) -> Self {
        Self::with(arena, ticks, fusion(arena, FusionParams::default()))
    }

    /// With the caller's fusion.
    pub fn with(arena: &'a Arena, ticks: Ticks, fusion: Fusion) -> Self {
        Self {
            arena,
            ticks,
            fusion,
            judge: Judge::default(),
            done: 0,
            spent: vec![Duration::ZERO],
            events: Vec::new(),
        }
    }

    /// A copy of the current fusion state with a new score, which begins this many seconds after the arena's start.
    pub fn continued(&self, judged_from_s: f64) -> Self {
        let ticks = Ticks { judged_from_s, ..self.ticks };
        Self { judge: Judge::default(), ticks, ..self.clone() }
    }

    /// Processes a frame, after the snapshots that were due before its arrival.
    pub fn take(&mut self, frame: &FrameObservations) {
        while self.tick_ns() < frame.received_time.as_ns() {
            self.score_due_ticks();
        }
        let started = Instant::now();
        self.fusion.observe(frame);
        self.spend(started);
    }

    pub fn take_all(mut self, frames: impl IntoIterator<Item = FrameObservations>) -> Self {
        let mut frames = frames.into_iter();
        loop {
            // Generated beforehand, so that generating them does not evict fusion's data from the caches.
            let block: Vec<_> = frames.by_ref().take(BLOCK).collect();
            if block.is_empty() {
                return self;
            }
            block.iter().for_each(|frame| self.take(frame));
        }
    }

    pub fn fusion(&self) -> &Fusion {
        &self.fusion
    }

    pub fn finish(self) -> Outcome {
        Outcome {
            score: self.judge.finish(),
            counts: self.fusion.counts(),
            events: self.events,
            spent: self.spent,
        }
    }

    fn spend(&mut self, since: Instant) {
        if let Some(spent) = self.spent.last_mut() {
            *spent += since.elapsed();
        }
    }

    fn tick_ns(&self) -> i64 {
        self.arena.start_ns + ((self.done + 1) as f64 / self.ticks.rate_hz * 1e9) as i64
    }

    fn score_due_ticks(&mut self) {
        let tick_ns = self.tick_ns();
        let started = Instant::now();
        let snapshot = self.fusion.snapshot(Timestamp::from_ns(tick_ns));
        self.spend(started);
        self.spent.push(Duration::ZERO);
        self.done += 1;
        self.events.extend(self.fusion.drain_events().map(|event| event.kind));
        if (tick_ns - self.arena.start_ns) as f64 * 1e-9 >= self.ticks.judged_from_s {
            self.judge.take(&message(&snapshot), &self.arena.truth(tick_ns));
        }
    }
}

impl Outcome {
    /// Number of events of this kind.
    pub fn happened(&self, kind: EventKind) -> usize {
        self.events.iter().filter(|event| **event == kind).count()
    }
}

/// Seconds in fusion's calls: the sum over ticks of the minimum over several equal runs, which removes most of the
/// load of other processes.
pub fn min_seconds(runs: &[Outcome]) -> f64 {
    let ticks = runs.iter().map(|run| run.spent.len()).min().unwrap_or(0);
    let min = |tick: usize| runs.iter().map(|run| run.spent[tick]).min().unwrap_or_default();
    (0..ticks).map(|tick| min(tick).as_secs_f64()).sum()
}
