//! Faulty streams: fusion must not panic, no pose may be wrong, and each fault must be counted.
//!
//! R4's robots on their loops, observed without pixels. Faults are injected between cameras and fusion.

use std::ops::{Range, RangeInclusive};

use roundel_core::{
    id::CameraId,
    world::{FrameObservations, FusionCounts},
};

use super::{
    Length, Row,
    run::{Run, Ticks},
    swarm::PRECISE,
};
use crate::{arena::Arena, sensor::Stream};

const BAR: &str = "no panic, no wrong pose, each counted";
/// A larger error is a wrong pose.
const MAX_ERROR_MM: f64 = 50.0;
const HOUR_S: f64 = 3600.0;
/// The faulty camera, and the duration of its fault.
const FAULTY: CameraId = CameraId(2);
const FAULTY_S: Range<f64> = 2.0..3.5;
/// Delays beyond and within the late window.
const OVERDUE_S: f64 = 0.5;
const DELAY_S: f64 = 0.2;
/// A frame that is this late counts as lost.
const LOST_S: f64 = 1.2;

/// An injected fault, and the range in which its count must lie.
struct Fault {
    what: &'static str,
    counted: fn(&FusionCounts) -> u64,
    expected: RangeInclusive<u64>,
}

impl Fault {
    fn exactly(what: &'static str, count: usize, counted: fn(&FusionCounts) -> u64) -> Self {
        Self { what, counted, expected: count as u64..=count as u64 }
    }
}

/// Frames in order of arrival, and the faults injected.
struct Case<'a> {
    arena: &'a Arena,
    seconds: f64,
    frames: Vec<FrameObservations>,
    faults: Vec<Fault>,
    /// Numbers of the frames that were removed.
    missing: RangeInclusive<u64>,
}

impl<'a> Case<'a> {
    fn new(arena: &'a Arena, length: Length) -> Self {
        let seconds = length.seconds(10.0, 5.0);
        let frames = Stream::new(arena, PRECISE, seconds).collect();
        Self { arena, seconds, frames, faults: Vec::new(), missing: 0..=0 }
    }

    fn seconds_of(&self, frame: &FrameObservations) -> f64 {
        (frame.received_time.as_ns() - self.arena.start_ns) as f64 * 1e-9
    }

    fn is_faulty(&self, frame: &FrameObservations, when_s: &Range<f64>) -> bool {
        frame.camera == FAULTY && when_s.contains(&self.seconds_of(frame))
    }

    /// Modifies the frames selected by `which`; returns the number of frames and of detections.
    fn each(
        &mut self,
        which: impl Fn(&Self, &FrameObservations) -> bool,
        change: impl Fn(&mut FrameObservations),
    ) -> (usize, usize) {
        let mut frames = std::mem::take(&mut self.frames);
        let (mut count, mut detections) = (0, 0);
        for frame in frames.iter_mut().filter(|frame| which(self, frame)) {
            change(frame);
            count += 1;
            detections += frame.detections.len();
        }
        frames.sort_by_key(|frame| frame.received_time);
        self.frames = frames;
        (count, detections)
    }

    /// Duplicates every frame.
    fn twice(mut self) -> Self {
        let count = self.frames.len();
        self.frames = self.frames.iter().flat_map(|frame| [frame.clone(), frame.clone()]).collect();
        let fault = Fault::exactly("frames twice", count, |counts| counts.duplicate_frames);
        self.faults.push(fault);
        self
    }

    /// Delays every tenth frame beyond the late window.
    fn overdue(mut self) -> Self {
        // At the end, no newer frame makes a delayed one late.
        let until_s = self.seconds - OVERDUE_S;
        let (count, _) = self.each(
            |case, frame| frame.frame.is_multiple_of(10) && case.seconds_of(frame) < until_s,
            |frame| frame.received_time = frame.received_time.plus_seconds(OVERDUE_S),
        );
        self.faults.push(Fault::exactly("frames too late", count, |counts| counts.late_frames));
        self
    }

    /// Delays every third frame by a dozen others of its camera.
    fn reordered(mut self) -> Self {
        let until_s = self.seconds - DELAY_S;
        let (_, moved) = self.each(
            |case, frame| frame.frame.is_multiple_of(3) && case.seconds_of(frame) < until_s,
            |frame| frame.received_time = frame.received_time.plus_seconds(DELAY_S),
        );
        let all: usize = self.frames.iter().map(|frame| frame.detections.len()).sum();
        self.faults.push(Fault::exactly("detections dropped", 0, |counts| counts.late));
        self.faults.push(Fault {
            what: "detections out of order",
            counted: |counts| counts.out_of_order,
            // A few meet no newer frame; frames of other cameras come out of order as well.
            expected: (moved as u64 * 9 / 10)..=all as u64,
        });
        self
    }

    /// The faulty camera sends nothing for a while.
    fn stopped(mut self) -> Self {
        let frames = std::mem::take(&mut self.frames);
        let stays = |frame: &FrameObservations| !self.is_faulty(frame, &FAULTY_S);
        let before = frames.len();
        self.frames = frames.into_iter().filter(stays).collect();
        let missing = (before - self.frames.len()) as u64;
        self.missing = missing..=missing;
        self
    }

    /// Removes three of ten frames of each camera.
    fn missing(mut self) -> Self {
        let (frames, missing): (Vec<_>, Vec<_>) =
            std::mem::take(&mut self.frames).into_iter().partition(|frame| frame.frame % 10 > 2);
        self.frames = frames;
        // Frames before the first that arrives cannot be known to be missing, and the last ones not yet.
        let until_s = self.seconds - LOST_S;
        let is_known =
            |frame: &&FrameObservations| frame.frame > 2 && self.seconds_of(frame) < until_s;
        self.missing = missing.iter().filter(is_known).count() as u64..=missing.len() as u64;
        self
    }

    /// Sets the faulty camera's clock to another hour, and back at the end of the interval.
    fn jumped(mut self, hours: f64, when_s: Range<f64>) -> Self {
        let change = |frame: &mut FrameObservations| {
            frame.capture_time = frame.capture_time.plus_seconds(hours * HOUR_S);
            for seen in &mut frame.detections {
                seen.capture_time = seen.capture_time.plus_seconds(hours * HOUR_S);
            }
        };
        let (count, _) = self.each(|case, frame| case.is_faulty(frame, &when_s), change);
        let steps = if when_s.end < self.seconds { 2 } else { 1 };
        self.faults.push(Fault::exactly("steps of a clock", steps, |counts| counts.clock_steps));
        self.faults.push(Fault {
            what: "frames refused until it is believed",
            counted: |counts| counts.jumped_frames + counts.late_frames,
            // Half a second must be enough.
            expected: 0..=count.min(30 * steps) as u64,
        });
        self
    }

    fn judge(self, name: &str) -> Vec<Row> {
        let run = Run::new(self.arena, Ticks { rate_hz: 60.0, judged_from_s: 1.0 });
        let outcome = run.take_all(self.frames).finish();
        let (score, counts) = (outcome.score, outcome.counts);
        let worst_mm = score.position.max() * 1e3;
        let mut row = Row::new(name, BAR)
            .check_identities(self.arena.robots.len(), &score)
            .check(format!("worst pose {worst_mm:.0} mm off"), worst_mm <= MAX_ERROR_MM);
        for fault in &self.faults {
            let count = (fault.counted)(&counts);
            let (min, max) = (fault.expected.start(), fault.expected.end());
            let of = if min == max { format!(" of {min}") } else { String::new() };
            let text = format!("{count}{of} {}", fault.what);
            row = row.check(text, fault.expected.contains(&count));
        }
        let (missing, known) =
            (counts.missing_frames, self.missing.contains(&counts.missing_frames));
        let of = format!("{missing} of {} frames missing", self.missing.end());
        row = row.check(of, known);
        let known = counts.used
            + counts.late
            + counts.duplicate
            + counts.jumped
            + counts.no_camera_pose
            + counts.no_pose
            + counts.invalid
            + counts.contradicted
            + counts.outranked
            + counts.over_max_objects
            + counts.joined
            + counts.left_out
            + counts.held;
        let lost = counts.detections.abs_diff(known);
        if lost > 0 {
            row = row.check(format!("{lost} detections without account"), false);
        }
        vec![row.scored(score)]
    }
}

fn arena() -> Arena {
    Arena::r4(41)
}

/// Every frame arrives twice.
pub fn twice(length: Length) -> Vec<Row> {
    Case::new(&arena(), length).twice().judge("every frame twice")
}

/// Frames beyond the late window.
pub fn overdue(length: Length) -> Vec<Row> {
    Case::new(&arena(), length).overdue().judge("every tenth frame half a second late")
}

/// Frames within the late window.
pub fn reordered(length: Length) -> Vec<Row> {
    Case::new(&arena(), length).reordered().judge("every third frame 0.2 s late")
}

/// Lost frames.
pub fn missing(length: Length) -> Vec<Row> {
    Case::new(&arena(), length).missing().judge("three frames of ten missing")
}

/// A camera that stops and returns.
pub fn stopped(length: Length) -> Vec<Row> {
    Case::new(&arena(), length).stopped().judge("a camera that stops for 1.5 s and returns")
}

/// A clock that is set forward, and back.
pub fn hour_ahead(length: Length) -> Vec<Row> {
    Case::new(&arena(), length).jumped(1.0, FAULTY_S).judge("a clock an hour ahead for 1.5 s")
}

/// A clock that is set back, and forward.
pub fn hour_behind(length: Length) -> Vec<Row> {
    Case::new(&arena(), length).jumped(-1.0, FAULTY_S).judge("a clock an hour behind for 1.5 s")
}

/// A clock that is set forward permanently.
pub fn hour_for_good(length: Length) -> Vec<Row> {
    let when_s = FAULTY_S.start..f64::INFINITY;
    Case::new(&arena(), length).jumped(1.0, when_s).judge("a clock an hour ahead permanently")
}

/// A clock that jumps while frames arrive late and out of order.
pub fn everything(length: Length) -> Vec<Row> {
    let arena = arena();
    let mut case = Case::new(&arena, length).jumped(1.0, FAULTY_S).overdue().reordered().twice();
    // A frame with several faults is counted once, so only the sums are checked.
    case.faults.clear();
    case.judge("a clock an hour ahead, frames late, reordered and twice")
}
