//! Roundels followed from frame to frame of one camera.
//!
//! A track starts each frame where its last motion leads (constant velocity in the image): there
//! lies the disc, beside it the ring, and only their pixels are touched (paper, section 3). If the
//! ring is not there, a window round the prediction is searched. A roundel that stays away keeps its
//! number for a few frames, its window growing. New roundels are searched for in a part of the frame
//! each time, so that those followed are never delayed.
//!
//! A ring belongs to one track: what one has taken, no other can.

mod occupied;

use crate::{
    camera::PixelPoint,
    frame::Frame,
    id::TrackNumber,
    marker::{
        Ring, TrackedRing,
        batch::BATCH_SIZE,
        code::Vote,
        detector::{Detector, MAX_ROOM, Scratch},
        kind::Polarity,
        reject::{Reject, RejectCounts, Rejected},
        ring::{pixels::predicted::PredictedRims, probe::Probe},
        search::{claim::Claim, row_edges::ROW_STEP},
        track::occupied::OccupancyGrid,
    },
    segment::Window,
};

/// A track's ring may change its radius by this share a frame …
const GATE_RADIUS_SHARE: f64 = 0.25;
/// … and this many pixels on top.
const GATE_RADIUS_PX: f64 = 1.0;
/// How far from its prediction a ring may be: this share of its radius, and pixels on top. Faster
/// roundels are lost, and found again as new ones.
const GATE_SHARE: f64 = 1.0;
/// See [`GATE_SHARE`].
const GATE_PX: f64 = 6.0;
/// The window looked at first: this share of the ring's box, and pixels on top.
const NEAR_SHARE: f64 = 1.3;
/// See [`NEAR_SHARE`].
const NEAR_PX: f64 = 5.0;
/// Share of a frame's measured motion in the velocity; the rest is the velocity known.
const VELOCITY_GAIN: f64 = 0.7;

/// Follows all roundels of one camera.
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
    occupied: OccupancyGrid,
}

#[derive(Clone, Copy, Debug)]
struct Track {
    number: TrackNumber,
    ring: Ring,
    rims: PredictedRims,
    /// Motion of the centre, pixels a frame.
    velocity: (f64, f64),
    /// Frames since it was seen last; 0 if it is seen in the newest.
    missed: u32,
    /// Frames in which it was seen.
    seen: u32,
    vote: Vote,
}

impl Track {
    fn new(number: u64, ring: Ring) -> Self {
        let number = TrackNumber(number);
        let mut vote = Vote::default();
        ring.code.iter().for_each(|reading| vote.add(reading));
        let rims = PredictedRims::new(&ring.outer, &ring.inner);
        Self { number, ring, rims, velocity: (0.0, 0.0), missed: 0, seen: 1, vote }
    }

    fn output(&self) -> TrackedRing {
        TrackedRing { track: self.number, ring: self.ring, code: self.vote.code() }
    }

    /// Where the centre is expected in the frame after `missed` ones without it.
    fn predicted(&self) -> PixelPoint {
        let frames = f64::from(self.missed);
        let PixelPoint { u, v } = self.ring.outer.center;
        PixelPoint { u: u + self.velocity.0 * frames, v: v + self.velocity.1 * frames }
    }

    fn gate_px(&self) -> f64 {
        let grown = 1.0 + 0.5 * f64::from(self.missed.saturating_sub(1));
        grown * (GATE_PX + GATE_SHARE * self.ring.outer.semi_major_px)
    }

    /// Distance of a ring from the prediction, pixels; `None` if it cannot be this track's.
    fn distance_px(&self, ring: &Ring) -> Option<f64> {
        let at = self.predicted();
        let (du, dv) = (ring.outer.center.u - at.u, ring.outer.center.v - at.v);
        let distance = (du * du + dv * dv).sqrt();
        let frames = f64::from(self.missed.max(1));
        let known = self.ring.outer.mean_radius_px();
        let change = (ring.outer.mean_radius_px() - known).abs();
        let same_size = change <= frames * (GATE_RADIUS_PX + GATE_RADIUS_SHARE * known);
        let same = same_size && ring.kind == self.ring.kind && distance <= self.gate_px();
        same.then_some(distance)
    }

    fn update(&mut self, ring: &Ring, rims: PredictedRims) {
        let frames = f64::from(self.missed.max(1));
        let (from, to) = (self.ring.outer.center, ring.outer.center);
        let disc_motion = ((to.u - from.u) / frames, (to.v - from.v) / frames);
        let gain = if self.seen == 1 { 1.0 } else { VELOCITY_GAIN };
        self.velocity.0 += gain * (disc_motion.0 - self.velocity.0);
        self.velocity.1 += gain * (disc_motion.1 - self.velocity.1);
        ring.code.iter().for_each(|reading| self.vote.add(reading));
        self.ring = *ring;
        self.rims = rims;
        self.missed = 0;
        self.seen = self.seen.saturating_add(1);
    }
}

impl Tracker {
    /// A tracker with no tracks yet; its first frame is searched wholly.
    pub fn new(detector: Detector) -> Self {
        let room = detector.params().max_roundels.min(MAX_ROOM);
        Self {
            detector,
            scratch: Scratch::default(),
            tracks: Vec::with_capacity(room),
            output: Vec::with_capacity(room),
            next_number: 1,
            size: (0, 0),
            next_row: 0,
            has_searched: false,
            occupied: OccupancyGrid::default(),
        }
    }

    /// The detector in use.
    pub fn detector(&self) -> &Detector {
        &self.detector
    }

    /// Candidates of the newest frame that died, by stage.
    pub fn rejects(&self) -> &RejectCounts {
        self.scratch.rejects()
    }

    /// Whether candidates that die are kept with their places; off at first.
    pub fn explain(&mut self, on: bool) {
        self.scratch.explain(on);
    }

    /// Candidates of the newest frame that died, if they are kept.
    pub fn rejected(&self) -> &[Rejected] {
        self.scratch.rejected()
    }

    /// Forgets all tracks, as after a gap in the frames. Numbers go on.
    pub fn reset(&mut self) {
        self.tracks.clear();
        self.output.clear();
        self.next_row = 0;
    }

    /// The roundels of the next frame, by the number of their track. A frame of another size than
    /// the one before starts afresh.
    pub fn process(&mut self, frame: &Frame) -> &[TrackedRing] {
        self.follow_tracks(frame);
        self.search_part(frame);
        self.update_output()
    }

    /// The same without a search for new roundels, unless none is followed: for those to whom each fraction of a
    /// millisecond counts. [`Tracker::seek`] is to have the same frame then.
    pub fn follow(&mut self, frame: &Frame) -> &[TrackedRing] {
        self.follow_tracks(frame);
        self.has_searched = self.tracks.iter().all(|track| track.missed > 0);
        if self.has_searched {
            self.search_part(frame);
        }
        self.update_output()
    }

    /// Searches the next part of a frame that was followed for new roundels; the frame after it is the first that
    /// shows them. [`Tracker::rejects`] are those of this search then.
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

    /// Gives up those that are missing for too long; the others that are seen.
    fn update_output(&mut self) -> &[TrackedRing] {
        let coast = self.detector.params().coast_frames;
        self.tracks.retain(|track| track.missed <= coast);

        self.output.clear();
        let seen = self.tracks.iter().filter(|track| track.missed == 0);
        self.output.extend(seen.map(Track::output));
        &self.output
    }

    /// Measures every track's ring at its prediction.
    fn measure_tracks(&mut self, frame: &Frame) {
        self.occupied.begin(frame);
        for tracks in self.tracks.chunks_mut(BATCH_SIZE) {
            let scratch = &mut self.scratch;
            scratch.batch.probes = [None; BATCH_SIZE];
            for (probe, track) in scratch.batch.probes.iter_mut().zip(&*tracks) {
                *probe = probe_for(frame, track);
            }
            self.detector.measure_batch(frame, &mut scratch.batch);
            for (place, track) in tracks.iter_mut().enumerate() {
                let alone;
                let ring = match (&scratch.batch.rings[place], &scratch.batch.probes[place]) {
                    (Some(ring), _) => Ok(ring),
                    (None, None) => Err(Reject::FrameEdge),
                    (None, Some(probe)) => {
                        alone = self.detector.measure(frame, probe, &mut scratch.measure);
                        alone.as_ref().map_err(|&reject| reject)
                    }
                };
                let measured = ring.and_then(|ring| {
                    let near = self.occupied.is_occupied(ring.outer.center);
                    if near && scratch.claims.iter().any(|claim| claim.covers(ring)) {
                        return Err(Reject::Claimed);
                    }
                    track.distance_px(ring).map(|_| ring).ok_or(Reject::Gate)
                });
                match measured {
                    Ok(ring) => {
                        let rims = scratch.batch.rims(place);
                        let rims =
                            rims.unwrap_or_else(|| PredictedRims::new(&ring.outer, &ring.inner));
                        track.update(ring, rims);
                        let half_box_px = track.rims.outer.half_box_px();
                        self.occupied.add(ring.outer.center, half_box_px);
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

    /// Searches the neighbourhood of the predictions at which there was no ring.
    fn search_missing(&mut self, frame: &Frame) {
        for index in 0..self.tracks.len() {
            let track = &self.tracks[index];
            if track.missed == 0 {
                continue;
            }
            let at = track.predicted();
            let half_u = track.ring.outer.half_box_px().0;
            let gate = track.gate_px();
            // RowBits are needed where the disc can be, columns where the ring can.
            let half = (gate + half_u + 4.0, gate + 1.0);
            let window = Window::around(frame, (at.u, at.v), half);
            self.assign_found(|detector, scratch| {
                detector.search(frame, window, usize::MAX, scratch);
            });
        }
    }

    /// Searches the next part of the frame for new roundels; all of it while none is followed.
    fn search_part(&mut self, frame: &Frame) {
        let seen = self.tracks.iter().filter(|track| track.missed == 0).count();
        if seen >= self.detector.params().max_roundels {
            return;
        }
        let none = seen == 0;
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

    /// Gives each ring that `search` finds to the nearest missing track whose gate it passes, or to
    /// a new one, for which the track that has been missing longest gives way where there is no more room.
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

/// Takes out the track that has been missing longest; whether there was one.
fn remove_longest_missing(tracks: &mut Vec<Track>) -> bool {
    let missing = tracks.iter().enumerate().filter(|(_, track)| track.missed > 0);
    let longest = missing.max_by_key(|(_, track)| track.missed).map(|(place, _)| place);
    longest.map(|place| tracks.remove(place)).is_some()
}

/// Where to look for a track: within half a radius or so, since most move less from where they are
/// expected. The few others are searched for. `None` beyond the frame's edge.
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
    let threshold = match polarity {
        Polarity::BlackRing => track.ring.threshold,
        Polarity::WhiteRing => 0u8.wrapping_sub(track.ring.threshold),
    };
    let from = track.ring.outer.center;
    let predicted = Some(track.rims.moved(at.u - from.u, at.v - from.v));
    Some(Probe { center, threshold, bounds, polarity, predicted })
}
