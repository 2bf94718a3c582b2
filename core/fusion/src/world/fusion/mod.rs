//! The fusion state machine: frames in, snapshots and events out.
//!
//! | module | content |
//! | --- | --- |
//! | `sightings` | from detections to sightings, with the pose of stationary or mobile cameras |
//! | `body_parts` | joint sighting of a body from those of its roundels |
//! | `lifecycle` | start and end of tracks |
//! | `camera_outlier` | cameras that are held back |
//! | `reconfigure` | changes of the configuration at run time |
//! | `leave_one_out` | predictions without one camera, for reprojection errors |

mod body_parts;
mod camera_outlier;
mod leave_one_out;
mod lifecycle;
mod reconfigure;
mod sightings;

pub use leave_one_out::LeaveOneOut;

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use nalgebra::Vector3;

use super::{
    CameraPlacement, Event, EventKind, FrameObservations, FusionParams, MotionClass, ObjectState,
    Snapshot,
    association::{Scratch, Sighting, associate},
    body::Bodies,
    camera_outlier::CameraOutliers,
    clock::{
        ClockEstimate, ClockPrior, Clocks, FrameStamp, MissingFrames, StampCorrector, StampVerdict,
        Timeline, Verdict,
    },
    counts::FusionCounts,
    height_check::{ConstrainedHeight, HeightChecks, WrongHeight},
    identity::{CARRIER_NUMBER, Mark, Subject},
    lifecycle::{Claim, IdRegistry, Track, Trust},
    measurement::{PrintSize, StampCorrection},
    mobile_camera::{Landmark, MobileCameras},
    print_size::{KindPrintSize, PrintSizes, resize},
    snapshot::object_state,
};
use crate::track::{Inserted, Measurement};
use roundel_vision::{
    id::{CameraId, KindId, ObjectId, TrackNumber},
    time::Timestamp,
};

/// Interval of comparisons between tracks.
const MERGE_EVERY_NS: i64 = 50_000_000;

/// All objects and cameras of an installation.
#[derive(Clone, Debug, Default)]
pub struct Fusion {
    params: FusionParams,
    classes: BTreeMap<KindId, MotionClass>,
    cameras: BTreeMap<CameraId, CameraPlacement>,
    mobile_cameras: MobileCameras,
    landmarks: Vec<Landmark>,
    stamp_corrector: StampCorrector,
    clocks: Clocks,
    offsets_m: BTreeMap<KindId, Vector3<f64>>,
    id_registry: IdRegistry,
    bodies: Bodies,
    height_checks: HeightChecks,
    print_sizes: PrintSizes,
    timeline: Timeline,
    missing_frames: MissingFrames,
    camera_outliers: CameraOutliers,
    /// Cameras that are never held back.
    exempt: BTreeSet<CameraId>,
    trust: Trust,
    /// In order of their start.
    tracks: Vec<Track>,
    /// Lost tracks, until the next snapshot.
    lost: Vec<Track>,
    last_id: u64,
    next_merge: Option<Timestamp>,
    newest_used: Option<Timestamp>,
    events: VecDeque<Event>,
    counts: FusionCounts,
    scratch: Scratch,
    sightings: Vec<Sighting>,
    /// Track numbers in the current frame, except those of bodies.
    numbers: Vec<TrackNumber>,
}

impl Fusion {
    /// A machine without cameras and objects.
    pub fn new(params: FusionParams) -> Self {
        Self { params, ..Self::default() }
    }

    /// Sets the pose of a stationary camera. With `None`, its detections are not used.
    pub fn set_camera(&mut self, camera: CameraId, placement: Option<CameraPlacement>) {
        match placement {
            Some(placement) => self.cameras.insert(camera, placement),
            None => self.cameras.remove(&camera),
        };
        self.camera_outliers.forget(camera);
        self.print_sizes.forget_camera(camera);
    }

    /// Sets a camera's rank, 1 by default. Its detections are not used for objects that cameras of a higher rank
    /// observe.
    pub fn set_trust(&mut self, camera: CameraId, rank: u8) {
        self.trust.set(camera, rank);
    }

    /// Sets the prior of a camera's clock; exact by default.
    pub fn set_clock(&mut self, camera: CameraId, prior: ClockPrior) {
        self.clocks.set_prior(camera, prior);
    }

    /// Estimate of a camera's clock; `None` before its first frame.
    pub fn clock(&self, camera: CameraId) -> Option<ClockEstimate> {
        self.clocks.estimate(camera)
    }

    /// Sets the tracked point of a kind's objects: metres, in the roundel's frame.
    pub fn set_offset(&mut self, kind: KindId, offset_m: Vector3<f64>) {
        self.offsets_m.insert(kind, offset_m);
    }

    /// Sets how a kind's objects move; freely by default. Applies to tracks that start from now on.
    pub fn set_motion(&mut self, kind: KindId, class: MotionClass) {
        self.classes.insert(kind, class);
    }

    /// Sets the relative tolerance of a kind's printed size: twice its standard deviation until cameras have measured
    /// it. 0, the default: the size is exact and not measured, and prints are flat. Forgets an earlier estimate.
    ///
    /// `flatness_m` is the standard deviation of a print's centre from the plane of its rims, metres
    /// ([`roundel_vision::pose::flatness_m`]).
    pub fn set_print_tolerance(&mut self, kind: KindId, tolerance: f64, flatness_m: f64) {
        self.print_sizes.set_tolerance(kind, tolerance, flatness_m);
    }

    /// Estimated size of a kind's prints, relative to the configured size.
    pub fn print_size(&self, kind: KindId) -> PrintSize {
        self.print_sizes.get(Some(kind))
    }

    /// Sizes of the prints of all kinds with a tolerance.
    pub fn print_sizes(&self) -> impl Iterator<Item = KindPrintSize> + '_ {
        self.print_sizes.all()
    }

    /// Takes the measured sizes that differ from the configured ones, found since the last call.
    pub fn drain_wrong_print_sizes(&mut self) -> impl Iterator<Item = KindPrintSize> + '_ {
        self.print_sizes.drain()
    }

    /// The frame with poses and covariances corrected by the estimated sizes of prints, without detections of kinds
    /// whose configured size cannot be right. `None` if all sizes are exact.
    pub fn resized(&self, frame: &FrameObservations) -> Option<FrameObservations> {
        if self.print_sizes.is_exact() {
            return None;
        }
        let mut resized = frame.clone();
        resized.detections.retain(|detection| !self.print_sizes.is_wrong(detection.ring.kind));
        for detection in &mut resized.detections {
            if let Some(pose) = &mut detection.pose {
                resize(pose, self.print_sizes.get(detection.ring.kind));
            }
        }
        Some(resized)
    }

    /// Counters since the start.
    pub fn counts(&self) -> FusionCounts {
        self.counts
    }

    /// Takes the events since the last call, in the order of their detection.
    pub fn drain_events(&mut self) -> impl Iterator<Item = Event> + '_ {
        self.events.drain(..)
    }

    /// Takes the wrong heights found since the last call. Each is reported once, until cameras agree with it
    /// again.
    pub fn drain_wrong_heights(&mut self) -> impl Iterator<Item = WrongHeight> + '_ {
        self.height_checks.drain()
    }

    /// Adds one frame of a camera. Frames may come in any order. No content can cause a panic or corrupt a track:
    /// what cannot be used is counted.
    pub fn observe(&mut self, frame: &FrameObservations) {
        let detections = frame.detections.len() as u64;
        self.counts.frames += 1;
        self.counts.detections += detections;
        let stamp = FrameStamp::from(frame);
        self.counts.missing_frames += self.missing_frames.observe(stamp);
        let Some(correction) = self.stamp_correction(&stamp) else {
            self.counts.jumped_frames += 1;
            self.counts.jumped += detections;
            return;
        };
        let capture_time = correction.corrected(frame.capture_time);
        match self.timeline.judge(&stamp, capture_time, &self.params) {
            Verdict::Use => {}
            Verdict::Restart => self.restart(),
            Verdict::Duplicate => {
                self.counts.duplicate_frames += 1;
                self.counts.duplicate += detections;
                return;
            }
            Verdict::Late => {
                self.counts.late_frames += 1;
                self.counts.late += detections;
                return;
            }
            Verdict::Jumped => {
                self.counts.jumped_frames += 1;
                self.counts.jumped += detections;
                return;
            }
        }
        let Some(now) = self.timeline.newest() else { return };
        self.clocks.note_delay(
            frame.camera,
            correction.based(frame.capture_time),
            frame.received_time,
        );
        self.advance(now);
        self.mobile_cameras.note_exposure(frame.camera, capture_time);
        if let Some(placement) = self.cameras.get(&frame.camera)
            && !self.mobile_cameras.contains(frame.camera)
        {
            self.print_sizes.observe(frame, placement, correction, &self.landmarks);
        }
        let landmarks = self.localize(frame, correction, now);
        if !self.collect(frame, correction, now, &landmarks) {
            return;
        }
        self.assign(frame.camera, Some(capture_time), now);
        self.retract_held_back();
        if self.next_merge.is_none_or(|time| now >= time) {
            self.next_merge = Some(now.plus_ns(MERGE_EVERY_NS));
            self.merge(now);
            self.bodies.forget(now.plus_ns(-self.params.lost_after_ns));
        }
    }

    /// All tracks, predicted to `pose_time` from the measurements until then. Advances time: objects not observed
    /// until `pose_time` become predicted or lost; a lost one appears in one snapshot.
    pub fn snapshot(&mut self, pose_time: Timestamp) -> Snapshot {
        self.advance(self.timeline.newest().map_or(pose_time, |newest| newest.max(pose_time)));
        // States are large, so the tracks are sorted instead.
        let mut tracks: Vec<_> = self.tracks.iter_mut().chain(&mut self.lost).collect();
        tracks.sort_unstable_by_key(|track| track.id);
        let ranks = &self.trust;
        let objects = tracks
            .into_iter()
            .map(|track| {
                let trust = ranks.of_track(track);
                let Subject { kind, body } = track.subject;
                if let Some(body) = body {
                    let code = self.bodies.code(body);
                    let state = object_state(track, pose_time, &self.bodies.origin_m(body));
                    return ObjectState { code, trust, ..state };
                }
                let offset = kind.and_then(|kind| self.offsets_m.get(&kind));
                let offset_m = offset.copied().unwrap_or_else(Vector3::zeros);
                ObjectState { trust, ..object_state(track, pose_time, &offset_m) }
            })
            .collect();
        self.lost.clear();
        Snapshot { pose_time, capture_time: self.newest_used, objects }
    }

    /// Correction of the frame's stamps; `None` if they are rejected.
    fn stamp_correction(&mut self, frame: &FrameStamp) -> Option<StampCorrection> {
        let &FrameStamp { camera, stamp, received, .. } = frame;
        self.clocks.find_or_insert(camera);
        let base_ns = match self.stamp_corrector.judge(frame, self.params.max_lead_ns) {
            StampVerdict::Valid(base_ns) => base_ns,
            StampVerdict::Stepped(base_ns) => {
                self.counts.clock_steps += 1;
                let offset_s = self.clocks.offset_s(camera, received);
                let correction = StampCorrection { base_ns, offset_s };
                self.clocks.note_clock_step(camera, correction.corrected(stamp));
                base_ns
            }
            StampVerdict::Rejected => return None,
        };
        Some(StampCorrection { base_ns, offset_s: self.clocks.offset_s(camera, received) })
    }

    /// Assigns each sighting to a track, or starts one. With `complete_at`, the sightings are all that the camera
    /// detected in its frame of that time.
    fn assign(&mut self, camera: CameraId, complete_at: Option<Timestamp>, now: Timestamp) {
        let is_mobile = self.mobile_cameras.contains(camera);
        let decisions =
            associate(&self.tracks, &self.sightings, &self.params, &self.clocks, &mut self.scratch);
        if let Some(time) = complete_at.filter(|_| !is_mobile)
            && !self.admits(camera, time, &decisions)
        {
            self.counts.held_frames += 1;
            self.counts.held += self.sightings.len() as u64;
            return;
        }
        self.check_heights();
        let forgotten = now.plus_ns(-self.params.late_window_ns);
        let existing = self.tracks.len();
        let mut claims = Vec::new();
        let mut is_observed = vec![false; existing];
        // Taken out to avoid copies.
        let mut sightings = std::mem::take(&mut self.sightings);
        for (sighting, decision) in sightings.iter_mut().zip(&decisions) {
            let is_mobile = is_mobile && sighting.measurement.number != CARRIER_NUMBER;
            if is_mobile && self.mobile_cameras.is_carrier(&sighting.subject, sighting.code) {
                self.counts.carrier_detections += 1;
                if let &Some((track, _)) = decision {
                    is_observed[track] = true;
                }
                continue;
            }
            let Some((track, innovation)) = *decision else {
                if !self.is_contradiction(&sighting.measurement, existing) {
                    self.begin(sighting);
                }
                continue;
            };
            is_observed[track] = true;
            let track = &mut self.tracks[track];
            if self.trust.is_outranked(camera, track, sighting.measurement.time) {
                self.counts.outranked += 1;
                continue;
            }
            if is_mobile && self.mobile_cameras.is_carrier(&track.subject, track.codes.leader()) {
                self.counts.carrier_detections += 1;
                continue;
            }
            let timing_s = track.timing_s(&sighting.measurement, &self.clocks);
            sighting.measurement.set_timing(timing_s);
            let (inserted, event) = track.observe(&sighting.measurement, &innovation, &self.params);
            if self.clocks.is_estimating()
                && let Some(comparison) = track.compare(&self.clocks)
            {
                self.clocks.add_comparison(&comparison);
            }
            track.history.discard_before(forgotten);
            if matches!(inserted, Inserted::InOrder | Inserted::OutOfOrder) {
                if let Some(code) = sighting.code {
                    track.codes.add(code);
                }
                self.newest_used = self.newest_used.max(Some(sighting.measurement.time));
            }
            match inserted {
                Inserted::InOrder => self.counts.used += 1,
                Inserted::OutOfOrder => {
                    self.counts.used += 1;
                    self.counts.out_of_order += 1;
                }
                Inserted::TooLate => self.counts.late += 1,
                Inserted::Duplicate => self.counts.duplicate += 1,
            }
            if let Some(mark) = track.unclaimed_mark() {
                claims.push((track.id, mark, event));
            } else if let Some(event) = event {
                self.push_event(event);
            }
        }
        self.sightings = sightings;
        for (track, is_observed) in self.tracks[..existing].iter_mut().zip(is_observed) {
            if let Some(time) = complete_at.filter(|_| !is_observed) {
                track.miss(camera, time);
            }
        }
        for (id, mark, event) in claims {
            self.identify(id, mark, event, now);
        }
    }

    /// Adds the current sightings to the checks of the heights to which their objects are constrained.
    fn check_heights(&mut self) {
        for Sighting { subject, measurement, .. } in &self.sightings {
            let (class, raised_m) = match subject.body {
                Some(body) => (Some(self.bodies.motion(body)), -self.bodies.origin_m(body).z),
                None => (subject.kind.and_then(|kind| self.classes.get(&kind).copied()), 0.0),
            };
            let Some(configured_m) = class.and_then(MotionClass::height_m) else { continue };
            let heights = ConstrainedHeight { tracked_m: configured_m + raised_m, configured_m };
            self.height_checks.observe(*subject, measurement, heights);
        }
    }

    /// Gives a track with a settled code, or of a body, the id of that object; `event` is the track's newest
    /// event.
    fn identify(&mut self, id: ObjectId, mark: Mark, event: Option<Event>, now: Timestamp) {
        let Some(index) = self.tracks.iter().position(|track| track.id == id) else { return };
        self.tracks[index].claimed_mark = Some(mark);
        let fresh_since = now.plus_ns(-self.params.predicted_after_ns);
        let (object, kind, replaced) =
            match self.id_registry.claim(&self.tracks, index, mark, &self.trust, fresh_since) {
                claim @ (Claim::Own | Claim::Ambiguous) => {
                    self.counts.ambiguous_codes += u64::from(claim == Claim::Ambiguous);
                    if let Some(event) = event {
                        self.push_event(event);
                    }
                    return;
                }
                Claim::Reappeared(object) => (object, EventKind::Appeared, None),
                Claim::Moved(other, object) => (object, EventKind::Recovered, Some(other)),
            };
        self.counts.returned += 1;
        let is_new = event.is_some_and(|event| event.kind == EventKind::Appeared);
        if !is_new {
            // It was reported under another id, which ends here.
            self.end(self.tracks[index].clone(), now);
        }
        // No longer lost.
        self.lost.retain(|lost| lost.id != object);
        self.tracks[index].id = object;
        let time = self.tracks[index].newest;
        if let Some(other) = replaced {
            self.tracks.remove(other);
        }
        self.push_event(Event { time, object, kind });
    }

    /// Whether a sighting that fits no track is an error about one of the first `known` tracks: its camera
    /// assigns it to that track, and other cameras observe the object where it is expected.
    fn is_contradiction(&mut self, measurement: &Measurement, existing: usize) -> bool {
        let Some(track) =
            self.tracks[..existing].iter().find(|track| track.is_continued_by(measurement))
        else {
            return false;
        };
        self.counts.gated += 1;
        let contradicted = track.is_contradicted(measurement, &self.params);
        self.counts.contradicted += u64::from(contradicted);
        contradicted
    }
}
