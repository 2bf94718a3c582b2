//! Tracking of roundels from frame to frame of one camera.
//!
//! In each frame, a track is measured at its prediction (constant velocity in the image), where only the pixels of disc
//! and ring are read (paper, section 3). If the ring is not there, a window around the prediction is searched. A missing
//! roundel keeps its number for a few frames, while its window grows. New roundels are searched for in a part of the
//! frame each time, so that tracked ones are never delayed.
//!
//! A ring belongs to one track: rings taken by a track are claimed.

use crate::{
    camera::PixelPoint,
    frame::{Frame, Window},
    id::TrackNumber,
    marker::{
        Ring, TrackedRing,
        batch::{BATCH_SIZE, BatchedRing},
        code::Vote,
        detector::{Detector, RESERVED_RINGS, Scratch},
        reject::{Reject, RejectCounts, Rejected},
        ring::{measure::UNEVEN, pixels::predicted::PredictedRims, probe::Probe},
        search::{claim::Claim, row_edges::ROW_STEP},
    },
};

/// Largest change of a track's radius per frame, as a share …
const GATE_RADIUS_SHARE: f64 = 0.25;
/// … plus pixels.
const GATE_RADIUS_PX: f64 = 1.0;
/// Largest distance of a ring from its prediction: a share of its radius. Faster roundels are lost,
/// and found again as new ones.
const GATE_SHARE: f64 = 1.0;
/// Added to [`GATE_SHARE`], pixels.
const GATE_PX: f64 = 6.0;
/// Size of the window measured first, as a multiple of the ring's bounding box.
const NEAR_SHARE: f64 = 1.3;
/// Added to [`NEAR_SHARE`], pixels.
const NEAR_PX: f64 = 5.0;
/// Weight of a frame's measured motion in the velocity.
const VELOCITY_GAIN: f64 = 0.7;

/// Tracks all roundels of one camera.
#[derive(Debug)]
pub struct Tracker {
    detector: Detector,
    scratch: Scratch,
    tracks: Vec<Track>,
    output: Vec<TrackedRing>,
    next_number: u64,
    size: (usize, usize),
    next_row: usize,
    /// Whether the newest frame has been searched for new roundels.
    has_searched: bool,
}

#[derive(Clone, Copy, Debug)]
struct Track {
    number: TrackNumber,
    ring: Ring,
    rims: PredictedRims,
    /// Motion of the centre, pixels per frame.
    velocity: (f64, f64),
    /// Frames since the last measurement; 0 if measured in the newest frame.
    missed: u32,
    /// Number of frames with a measurement.
    measured_frames: u32,
    vote: Vote,
}

impl Track {
    fn new(number: u64, ring: Ring) -> Self {
        let number = TrackNumber(number);
        let mut vote = Vote::default();
        ring.code.iter().for_each(|reading| vote.add(reading));
        let rims = PredictedRims::new(&ring.outer, &ring.inner);
        Self { number, ring, rims, velocity: (0.0, 0.0), missed: 0, measured_frames: 1, vote }
    }

    fn output(&self) -> TrackedRing {
        TrackedRing { track: self.number, ring: self.ring, code: self.vote.code() }
    }

    /// Predicted centre, `missed` frames after the last measurement.
    fn predicted(&self) -> PixelPoint {
        let frames = f64::from(self.missed);
        let PixelPoint { u, v } = self.ring.outer.center;
        PixelPoint { u: u + self.velocity.0 * frames, v: v + self.velocity.1 * frames }
    }

    fn gate_px(&self) -> f64 {
        let grown = 1.0 + 0.5 * f64::from(self.missed.saturating_sub(1));
        grown * (GATE_PX + GATE_SHARE * self.ring.outer.semi_major_px)
    }

    /// Distance of a ring from the prediction, pixels; `None` if it is outside the track's gate.
    fn distance_px(&self, ring: &Ring) -> Option<f64> {
        let at = self.predicted();
        let (du, dv) = (ring.outer.center.u - at.u, ring.outer.center.v - at.v);
        let distance = (du * du + dv * dv).sqrt();
        let frames = f64::from(self.missed.max(1));
        let radius_px = self.ring.outer.mean_radius_px();
        let change = (ring.outer.mean_radius_px() - radius_px).abs();
        let same_size = change <= frames * (GATE_RADIUS_PX + GATE_RADIUS_SHARE * radius_px);
        let same = same_size && ring.kind == self.ring.kind && distance <= self.gate_px();
        same.then_some(distance)
    }

    fn update(&mut self, ring: &Ring, rims: PredictedRims) {
        let frames = f64::from(self.missed.max(1));
        let (from, to) = (self.ring.outer.center, ring.outer.center);
        let disc_motion = ((to.u - from.u) / frames, (to.v - from.v) / frames);
        let gain = if self.measured_frames == 1 { 1.0 } else { VELOCITY_GAIN };
        self.velocity.0 += gain * (disc_motion.0 - self.velocity.0);
        self.velocity.1 += gain * (disc_motion.1 - self.velocity.1);
        ring.code.iter().for_each(|reading| self.vote.add(reading));
        self.ring = *ring;
        self.rims = rims;
        self.missed = 0;
        self.measured_frames = self.measured_frames.saturating_add(1);
    }
}

impl Tracker {
    /// A tracker without tracks; it searches its first frame completely.
    pub fn new(detector: Detector) -> Self {
        let capacity = detector.params().max_roundels.min(RESERVED_RINGS);
        Self {
            detector,
            scratch: Scratch::default(),
            tracks: Vec::with_capacity(capacity),
            output: Vec::with_capacity(capacity),
            next_number: 1,
            size: (0, 0),
            next_row: 0,
            has_searched: false,
        }
    }

    /// The detector in use.
    pub fn detector(&self) -> &Detector {
        &self.detector
    }

    /// Rejected candidates of the newest frame, by stage.
    pub fn rejects(&self) -> &RejectCounts {
        self.scratch.rejects()
    }

    /// Enables keeping rejected candidates with their positions; off by default.
    pub fn explain(&mut self, on: bool) {
        self.scratch.explain(on);
    }

    /// Rejected candidates of the newest frame, if they are kept.
    pub fn rejected(&self) -> &[Rejected] {
        self.scratch.rejected()
    }

    /// Drops all tracks, as after a gap in the frames. Numbering continues.
    pub fn reset(&mut self) {
        self.tracks.clear();
        self.output.clear();
        self.next_row = 0;
    }

    /// The roundels of the next frame, with their track numbers. A frame of another size resets the
    /// tracker.
    pub fn process(&mut self, frame: &Frame) -> &[TrackedRing] {
        self.follow_tracks(frame);
        self.search_part(frame);
        self.update_output()
    }

    /// As [`Tracker::process`] without the search for new roundels, unless none is tracked, for
    /// callers that need the lowest latency. Pass the same frame to [`Tracker::seek`] afterwards.
    pub fn follow(&mut self, frame: &Frame) -> &[TrackedRing] {
        self.follow_tracks(frame);
        self.has_searched = self.tracks.iter().all(|track| track.missed > 0);
        if self.has_searched {
            self.search_part(frame);
        }
        self.update_output()
    }

    /// Searches the next part of a frame passed to [`Tracker::follow`] for new roundels, which
    /// appear from the next frame on. [`Tracker::rejects`] then counts this search only.
    pub fn seek(&mut self, frame: &Frame) {
        self.scratch.rejects.clear();
        if !std::mem::take(&mut self.has_searched) {
            self.search_part(frame);
        }
    }

    fn follow_tracks(&mut self, frame: &Frame) {
        let size = (frame.width(), frame.height());
        if size != self.size {
            self.reset();
            self.size = size;
        }
        self.scratch.rejects.clear();
        self.scratch.claims.clear();
        self.scratch.found.clear();
        for track in &mut self.tracks {
            track.missed += 1;
        }
        self.measure_tracks(frame);
        self.search_missing(frame);
    }

    /// Drops tracks that have been missing for too long, and collects the measured ones.
    fn update_output(&mut self) -> &[TrackedRing] {
        let coast = self.detector.params().coast_frames;
        self.tracks.retain(|track| track.missed <= coast);

        self.output.clear();
        let measured = self.tracks.iter().filter(|track| track.missed == 0);
        self.output.extend(measured.map(Track::output));
        &self.output
    }

    /// Measures every track's ring at its prediction.
    fn measure_tracks(&mut self, frame: &Frame) {
        for tracks in self.tracks.chunks_mut(BATCH_SIZE) {
            let scratch = &mut self.scratch;
            scratch.batch.probes = [None; BATCH_SIZE];
            for (probe, track) in scratch.batch.probes.iter_mut().zip(&*tracks) {
                *probe = probe_for(frame, track);
            }
            self.detector.measure_batch(frame, &mut scratch.batch);
            for (place, track) in tracks.iter_mut().enumerate() {
                let alone;
                let is_even = |found: &BatchedRing| found.ring.unevenness <= UNEVEN;
                let batched = scratch.batch.found[place].filter(is_even);
                let ring = match (&batched, scratch.batch.probes[place]) {
                    (Some(batched), _) => Ok(&batched.ring),
                    (None, None) => Err(Reject::FrameEdge),
                    (None, Some(probe)) => {
                        alone = self.detector.measure_tracked(frame, &probe, &track.ring, scratch);
                        alone.as_ref().map_err(|&reject| reject)
                    }
                };
                let measured = ring.and_then(|ring| {
                    if scratch.claims.iter().any(|claim| claim.covers(ring)) {
                        return Err(Reject::Claimed);
                    }
                    track.distance_px(ring).map(|_| ring).ok_or(Reject::Gate)
                });
                match measured {
                    Ok(ring) => {
                        let rims = match batched {
                            Some(batched) => batched.rims,
                            None => PredictedRims::new(&ring.outer, &ring.inner),
                        };
                        track.update(ring, rims);
                        let half_box_px = track.rims.outer.half_box_px();
                        scratch.claims.push(Claim::with_box(ring, half_box_px));
                    }
                    Err(reject) => {
                        let center = track.predicted();
                        let half_box_px = track.ring.outer.half_box_px();
                        scratch.rejects.add(Rejected { center, half_box_px, reject });
                    }
                }
            }
        }
    }

    /// Searches around the predictions without a ring.
    fn search_missing(&mut self, frame: &Frame) {
        for index in 0..self.tracks.len() {
            let track = &self.tracks[index];
            if track.missed == 0 {
                continue;
            }
            let at = track.predicted();
            let half_u = track.ring.outer.half_box_px().0;
            let gate = track.gate_px();
            // Rows where the disc can be, columns where the ring can be.
            let half = (gate + half_u + 4.0, gate + 1.0);
            let window = Window::around(frame, (at.u, at.v), half);
            self.assign_found(|detector, scratch| {
                detector.search(frame, window, usize::MAX, scratch);
            });
        }
    }

    /// Searches the next part of the frame for new roundels; all of it while none is tracked.
    fn search_part(&mut self, frame: &Frame) {
        let measured = self.tracks.iter().filter(|track| track.missed == 0).count();
        if measured >= self.detector.params().max_roundels {
            return;
        }
        let none = measured == 0;
        let parts = if none { 1 } else { self.detector.params().search_frames as usize };
        let rows = frame.height().div_ceil(parts).next_multiple_of(ROW_STEP);
        if none || self.next_row >= frame.height() {
            self.next_row = 0;
        }
        let bottom = (self.next_row + rows).min(frame.height());
        let window = Window { top: self.next_row, bottom, ..Window::of(frame) };
        self.next_row = bottom;
        self.assign_found(|detector, scratch| {
            detector.search(frame, window, usize::MAX, scratch);
        });
    }

    /// Assigns each ring found to the closest missing track whose gate it passes, or to a new
    /// track, which replaces the longest missing one if the limit is reached.
    fn assign_found(&mut self, search: impl FnOnce(&Detector, &mut Scratch)) {
        self.scratch.found.clear();
        search(&self.detector, &mut self.scratch);
        let max = self.detector.params().max_roundels;
        for ring in &self.scratch.found {
            let missing = self.tracks.iter_mut().filter(|track| track.missed > 0);
            let near = missing
                .filter_map(|track| track.distance_px(ring).map(|distance| (distance, track)))
                .min_by(|a, b| a.0.total_cmp(&b.0));
            if let Some((_, track)) = near {
                track.update(ring, PredictedRims::new(&ring.outer, &ring.inner));
            } else if self.tracks.len() < max || remove_longest_missing(&mut self.tracks) {
                self.tracks.push(Track::new(self.next_number, *ring));
                self.next_number += 1;
            }
        }
    }
}

/// Removes the track that has been missing longest; false if none is missing.
fn remove_longest_missing(tracks: &mut Vec<Track>) -> bool {
    let missing = tracks.iter().enumerate().filter(|(_, track)| track.missed > 0);
    let longest = missing.max_by_key(|(_, track)| track.missed).map(|(place, _)| place);
    longest.map(|place| tracks.remove(place)).is_some()
}

/// The probe of a track: within about half a radius of its prediction, which most do not leave; the
/// others are searched for. `None` outside the frame.
fn probe_for(frame: &Frame, track: &Track) -> Option<Probe> {
    let at = track.predicted();
    let (half_u, half_v) = track.rims.outer.half_box_px();
    let inside =
        at.u >= 0.0 && at.v >= 0.0 && at.u < frame.width() as f64 && at.v < frame.height() as f64;
    if !inside {
        return None;
    }
    let center = (
        (at.u.round() as usize).min(frame.width() - 1),
        (at.v.round() as usize).min(frame.height() - 1),
    );
    let slack = |half: f64| NEAR_SHARE * half + NEAR_PX;
    let bounds = Window::around(frame, (at.u, at.v), (slack(half_u), slack(half_v)));
    let polarity = track.ring.polarity;
    let threshold = polarity.threshold(track.ring.threshold);
    let from = track.ring.outer.center;
    let predicted = Some(track.rims.moved(at.u - from.u, at.v - from.v));
    Some(Probe { center, threshold, bounds, polarity, predicted })
}
