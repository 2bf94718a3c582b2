//! Frames into fusion as they arrive, and snapshots at steady ticks against the truth.

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

/// Frames that are made at a time.
const BLOCK: usize = 100;

/// Ticks at which snapshots are made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ticks {
    /// A second.
    pub rate_hz: f64,
    /// The first one that is judged, seconds after the arena's start.
    pub judged_from_s: f64,
}

/// One run in virtual time: the receiving times say what the time is.
#[derive(Clone, Debug)]
pub struct Run<'a> {
    arena: &'a Arena,
    ticks: Ticks,
    fusion: Fusion,
    judge: Judge,
    /// Ticks so far.
    done: u64,
    /// In fusion's calls, tick by tick.
    spent: Vec<Duration>,
    events: Vec<EventKind>,
}

/// What came of a run.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Snapshots against the truth.
    pub score: Score,
    /// What became of the frames.
    pub counts: FusionCounts,
    /// What happened to tracks.
    pub events: Vec<EventKind>,
    /// Time in fusion's calls, tick by tick.
    pub spent: Vec<Duration>,
}

impl<'a> Run<'a> {
    /// With fusion as a server has it without configuration, and cameras whose places are known.
    pub fn new(arena: &'a Arena, ticks: Ticks) -> Self {
        Self::with(arena, ticks, fusion(arena, FusionParams::default()))
    }

    /// With fusion as the caller has it.
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

    /// The same fusion from here on, with nothing judged until so many seconds after the start.
    pub fn anew(&self, judged_from_s: f64) -> Self {
        let ticks = Ticks { judged_from_s, ..self.ticks };
        Self { judge: Judge::default(), ticks, ..self.clone() }
    }

    /// Takes a frame, after the snapshots that were due before it came.
    pub fn take(&mut self, frame: &FrameObservations) {
        while self.tick_ns() < frame.received_time.as_ns() {
            self.look();
        }
        let begun = Instant::now();
        self.fusion.observe(frame);
        self.spend(begun);
    }

    /// Takes frames one by one.
    pub fn take_all(mut self, frames: impl IntoIterator<Item = FrameObservations>) -> Self {
        let mut frames = frames.into_iter();
        loop {
            // Made beforehand, so that making them leaves fusion's data in the caches.
            let block: Vec<_> = frames.by_ref().take(BLOCK).collect();
            if block.is_empty() {
                return self;
            }
            block.iter().for_each(|frame| self.take(frame));
        }
    }

    /// What came of it.
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

    fn look(&mut self) {
        let tick_ns = self.tick_ns();
        let begun = Instant::now();
        let snapshot = self.fusion.snapshot(Timestamp::from_ns(tick_ns));
        self.spend(begun);
        self.spent.push(Duration::ZERO);
        self.done += 1;
        self.events.extend(self.fusion.drain_events().map(|event| event.kind));
        if (tick_ns - self.arena.start_ns) as f64 * 1e-9 >= self.ticks.judged_from_s {
            self.judge.take(&message(&snapshot), &self.arena.truth(tick_ns));
        }
    }
}

impl Outcome {
    /// How often something happened to a track.
    pub fn happened(&self, kind: EventKind) -> usize {
        self.events.iter().filter(|event| **event == kind).count()
    }
}

/// Seconds in fusion's calls: each tick's least of several equal runs, so that what else runs on the
/// machine hardly shows.
pub fn least_seconds(runs: &[Outcome]) -> f64 {
    let ticks = runs.iter().map(|run| run.spent.len()).min().unwrap_or(0);
    let least = |tick: usize| runs.iter().map(|run| run.spent[tick]).min().unwrap_or_default();
    (0..ticks).map(|tick| least(tick).as_secs_f64()).sum()
}
