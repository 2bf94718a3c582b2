//! Supervision of camera poses: detects cameras that were moved, finds their new poses, and corrects slow drift.
//!
//! Input: camera poses, detections ([`Watch::observe`]; at any rate, up to [`WatchParams::delay_s`] late and out of order)
//! and the time ([`Watch::advance`]). Output: events that a camera must be left out ([`WatchEvent::Bumped`]), has a new
//! pose ([`WatchEvent::Returned`]) or was corrected for drift ([`WatchEvent::Drifted`]). The caller applies them.
//!
//! | step | module |
//! | --- | --- |
//! | average the views of a roundel in bins of [`BIN_S`] | `track` |
//! | match the views of a roundel across cameras and landmarks | `co_observation` |
//! | measure disagreement, fit poses | `pose_fit` |
//! | decide which camera moved, four times a second over the last half second and two seconds | `attribution` |
//! | act on two identical verdicts in a row | `verdicts` |
//! | find the new pose of a moved camera | `recovery` |
//! | correct motion slower than two seconds, from sums over a minute | `drift` |
//!
//! Error model of a view: a share ([`WatchParams::systematic_share`]) of a detection's variance persists for
//! [`WatchParams::systematic_time_s`], or as long as the roundel rests, so an hour of a parked roundel counts as one
//! observation. Errors that covariances do not state (lenses, clocks) appear as disagreement that no motion explains, and
//! raise all thresholds.
//!
//! Accuracy: `tests/tests/healing.rs`; the table of `cargo run --release -p roundel-tests -- healing` for R4. Lens
//! errors of 0.05 % and 0.5 px are absorbed by the poses within minutes without further drift. Displacements of 1 mm or
//! 0.01° are corrected as drift within 80 s; 2 to 6 mm, 0.03° and 0.06° are detected within 0.91 s and recovered within
//! 18 s. In the first minute after a start, 2 and 3 mm are treated as drift too, with track errors of up to 9 mm.
//!
//! Cost: 16 cameras with 50 objects at 60 Hz take below 2 % of a core (`cargo bench -p roundel-core --bench watch`).
//!
//! Until an event, about a second, fusion protects itself ([`roundel_fusion::world`]). A camera that fusion holds back
//! ([`Watch::hold`]) has moved suddenly, so 1 mm suffices if it agreed with others before. A camera with a manually
//! entered pose ([`Watch::distrust`]) is not reported as moved before it has agreed with others; it needs a calibration.
//!
//! Limits. Two cameras without references contradict each other, and neither is corrected. A single roundel has no
//! effect, since its code may be shown twice. Without references, the common frame may drift with corrections. A camera
//! that sees nothing in common with others stays alone, or in quarantine, until recalibrated. Uncoded roundels match only
//! within 0.2 m. Poses are consistent with the lenses they were found with: with lens errors of 0.05 % and 0.5 px, poses
//! from [`crate::arena`] agree (R4, 8 seeds, 60 s: no event), but exact poses look moved during the first minute, in 6 of 8
//! runs, until drift correction has absorbed the lens errors.

mod attribution;
mod co_observation;
mod drift;
mod event;
mod pose_fit;
mod recovery;
#[cfg(test)]
mod tests;
mod track;
mod verdicts;

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use nalgebra::{Matrix6, Vector6};

use co_observation::{CoObservation, RestTimes, SingleView, match_views};
use drift::Drift;
pub use event::{CameraHealth, WatchEvent, WatchState};
use recovery::Recovery;
use roundel_fusion::world::{CameraPlacement, FrameObservations, Landmark};
use roundel_vision::{
    id::{CameraId, TrackNumber},
    rigid::{Covariance6, Rigid},
    time::Timestamp,
};
use track::RoundelTrack;
use verdicts::Streak;

/// Duration of a bin, seconds.
pub const BIN_S: f64 = 0.25;
const BIN_NS: i64 = 250_000_000;
/// Windows of bins that are judged; bins that leave the longer one go into the drift sums.
const WINDOWS: [usize; 2] = [2, 8];
/// Number of landmarks that fix a camera without others.
const MIN_FIXED: usize = 3;
/// A camera without common roundels for this many bins is alone.
const ALONE_BINS: i64 = 20;
/// Maximum number of bins processed after a pause.
const MAX_BEHIND: i64 = 40;
/// Maximum number of tracks per camera.
const MAX_TRACKS: usize = 1024;
/// A track without detections for this long is dropped.
const FORGOTTEN_NS: i64 = 2_000_000_000;
/// Stamps further in the future are invalid.
const AHEAD_NS: i64 = 5_000_000_000;

/// Parameters of the camera supervision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WatchParams {
    /// Maximum delay of frames after their exposure, by corrected stamps, seconds.
    pub delay_s: f64,
    /// Standard deviation of clock offsets, seconds.
    pub clock_deviation_s: f64,
    /// Share of a detection's variance that persists from frame to frame, 0 to 1.
    pub systematic_share: f64,
    /// Duration of that persistence, seconds.
    pub systematic_time_s: f64,
    /// Persistent error that covariances do not state, for each coordinate, metres.
    pub min_deviation_m: f64,
    /// Minimum rms displacement of a camera's observations for an event, metres.
    pub min_bump_m: f64,
    /// The same for a camera that fusion holds back.
    pub min_held_bump_m: f64,
    /// The same for a camera that is not held back and has not agreed with others for a minute. Smaller
    /// displacements, such as those of a wrong lens, are corrected as drift.
    pub min_first_bump_m: f64,
    /// Minimum rms displacement for a drift correction, metres.
    pub min_drift_m: f64,
    /// Time constant of the drift sums, seconds.
    pub drift_window_s: f64,
    /// A camera returns when its position is known to this, metres …
    pub return_deviation_m: f64,
    /// … and its rotation to this, radians …
    pub return_deviation_rad: f64,
    /// … or after this many seconds at rest if both are known to four times that.
    pub return_after_s: f64,
}

impl Default for WatchParams {
    fn default() -> Self {
        Self {
            delay_s: 0.15,
            clock_deviation_s: 1e-4,
            systematic_share: 0.5,
            systematic_time_s: 1.0,
            min_deviation_m: 1e-4,
            min_bump_m: 0.004,
            min_held_bump_m: 0.001,
            min_first_bump_m: 0.008,
            min_drift_m: 4e-4,
            drift_window_s: 60.0,
            return_deviation_m: 3e-4,
            return_deviation_rad: 0.003 * std::f64::consts::PI / 180.0,
            return_after_s: 22.0,
        }
    }
}

#[derive(Clone, Debug)]
struct CameraSlot {
    camera: CameraId,
    placement: CameraPlacement,
    /// Its pose was measured or has agreed with others.
    is_trusted: bool,
    /// It has agreed with others for a drift window.
    is_settled: bool,
    /// Fusion holds it back because of sudden motion.
    is_held: bool,
    tracks: BTreeMap<TrackNumber, RoundelTrack>,
    recovery: Option<Recovery>,
    /// Last bin with a view that matched.
    last_matched: Option<i64>,
}

/// Supervision of all cameras of an installation.
#[derive(Clone, Debug, Default)]
pub struct Watch {
    params: WatchParams,
    landmarks: Vec<Landmark>,
    slots: Vec<CameraSlot>,
    /// The newest is the last.
    bins: VecDeque<Vec<CoObservation>>,
    next_bin: Option<i64>,
    now: Option<Timestamp>,
    rest_times: RestTimes,
    streaks: [Streak; WINDOWS.len()],
    drift: Drift,
    /// Cameras of an unresolved contradiction, ascending.
    contradiction: Option<Vec<CameraId>>,
    /// Manually placed cameras that disagree, ascending.
    misplaced: Vec<CameraId>,
    events: Vec<WatchEvent>,
}

impl Watch {
    /// Without cameras.
    pub fn new(params: WatchParams) -> Self {
        Self { params, ..Self::default() }
    }

    /// Sets the pose of a camera and drops the evidence about it. Setting the current pose has no effect.
    pub fn set_camera(&mut self, camera: CameraId, placement: CameraPlacement) {
        match self.slot(camera) {
            Some(slot) if self.slots[slot].placement == placement => {}
            Some(slot) => {
                self.slots[slot].placement = placement;
                self.slots[slot].recovery = None;
                self.slots[slot].is_trusted = true;
                self.slots[slot].is_settled = false;
                self.forget_camera(slot);
            }
            None => {
                self.slots.push(CameraSlot {
                    camera,
                    placement,
                    is_trusted: true,
                    is_settled: false,
                    is_held: false,
                    tracks: BTreeMap::new(),
                    recovery: None,
                    last_matched: None,
                });
                self.drift.grow();
            }
        }
    }

    /// Marks a camera's pose as manually entered: until it has agreed with others, neither it nor a camera that
    /// disagrees with it is reported as moved.
    pub fn distrust(&mut self, camera: CameraId) {
        if let Some(slot) = self.slot(camera) {
            self.slots[slot].is_trusted = false;
        }
    }

    /// Whether a camera's pose was measured or has agreed with others. Only such a camera should be held back.
    pub fn is_trusted(&self, camera: CameraId) -> bool {
        self.slot(camera).is_none_or(|slot| self.slots[slot].is_trusted)
    }

    /// Sets whether fusion holds a camera back. Its motion was then sudden, so a smaller disagreement suffices.
    pub fn hold(&mut self, camera: CameraId, is_held: bool) {
        if let Some(slot) = self.slot(camera) {
            self.slots[slot].is_held = is_held;
        }
    }

    /// Removes a camera.
    pub fn remove_camera(&mut self, camera: CameraId) {
        if let Some(slot) = self.slot(camera) {
            self.slots.remove(slot);
            self.forget();
        }
    }

    /// Sets the reference roundels.
    pub fn set_landmarks(&mut self, landmarks: &[Landmark]) {
        if self.landmarks != landmarks {
            self.landmarks = landmarks.to_vec();
            self.forget();
        }
    }

    /// Adds a frame; the camera's stamps are `clock_offset_s` late.
    pub fn observe(&mut self, frame: &FrameObservations, clock_offset_s: f64) {
        let (Some(slot), now) = (self.slot(frame.camera), self.now) else { return };
        let tracks = &mut self.slots[slot].tracks;
        for seen in &frame.detections {
            let (Some(pose), Some(kind)) = (&seen.pose, seen.ring.kind) else { continue };
            let time = seen.capture_time.plus_seconds(-clock_offset_s);
            let is_ahead = now.is_some_and(|now| time.ns_since(now) > AHEAD_NS);
            if is_ahead || tracks.len() >= MAX_TRACKS && !tracks.contains_key(&seen.track) {
                continue;
            }
            let track = tracks.entry(seen.track).or_insert_with(|| RoundelTrack::new(kind, time));
            track.add(time, seen, pose);
        }
    }

    /// Processes all bins up to `now` (corrected time) and returns the events.
    pub fn advance(&mut self, now: Timestamp) -> Vec<WatchEvent> {
        self.now = Some(now);
        let newest = now.plus_seconds(-self.params.delay_s).as_ns().div_euclid(BIN_NS) - 1;
        let next = self.next_bin.unwrap_or(newest).max(newest.saturating_sub(MAX_BEHIND));
        for bin in next..=newest {
            self.close(bin);
        }
        self.next_bin = Some(next.max(newest + 1));
        std::mem::take(&mut self.events)
    }

    /// Quality of a camera's pose; `None` if the camera is unknown.
    pub fn health(&self, camera: CameraId) -> Option<CameraHealth> {
        let slot = self.slot(camera)?;
        let offset = self.drift.offset(slot);
        let (change, covariance) =
            offset.map_or((Vector6::zeros(), Matrix6::zeros()), |it| (it.change, it.covariance));
        let deviation =
            |corner: usize| covariance.fixed_view::<3, 3>(corner, corner).trace().sqrt();
        Some(CameraHealth {
            state: self.state(slot),
            error_m: change.fixed_rows::<3>(0).norm(),
            error_rad: change.fixed_rows::<3>(3).norm(),
            deviation_m: deviation(0),
            deviation_rad: deviation(3),
            seen_error_m: offset.map_or(0.0, |it| it.moved_m),
        })
    }

    fn state(&self, slot: usize) -> WatchState {
        let camera = &self.slots[slot].camera;
        let newest = self.next_bin.unwrap_or_default();
        if self.slots[slot].recovery.is_some() {
            WatchState::Quarantined
        } else if self.contradiction.as_ref().is_some_and(|cameras| cameras.contains(camera))
            || self.streaks.iter().any(|streak| streak.slots.contains(&slot))
        {
            WatchState::Suspected
        } else if self.slots[slot].last_matched.is_none_or(|last| newest - last > ALONE_BINS) {
            WatchState::Alone
        } else {
            WatchState::Watched
        }
    }

    fn slot(&self, camera: CameraId) -> Option<usize> {
        self.slots.iter().position(|slot| slot.camera == camera)
    }

    /// Drops all common evidence of a camera and others.
    fn forget_camera(&mut self, slot: usize) {
        self.bins.iter_mut().flatten().for_each(|group| group.forget(slot));
        self.drift.forget(slot);
        self.slots[slot].last_matched = None;
        // It may have been elsewhere when it saw them.
        self.slots[slot].tracks.values_mut().for_each(RoundelTrack::restart);
        self.slots.iter_mut().filter_map(|it| it.recovery.as_mut()).for_each(|it| it.forget(slot));
        if self.streaks.iter().any(|streak| streak.slots.contains(&slot)) {
            self.streaks = Default::default();
        }
        let camera = self.slots[slot].camera;
        if self.contradiction.as_ref().is_some_and(|cameras| cameras.contains(&camera)) {
            self.end_contradiction();
        }
    }

    fn forget(&mut self) {
        self.bins.clear();
        self.drift = Drift::new(self.slots.len());
        self.streaks = Default::default();
        self.rest_times = RestTimes::default();
        for slot in &mut self.slots {
            slot.last_matched = None;
            if let Some(recovery) = &mut slot.recovery {
                recovery.restart();
            }
        }
        self.end_contradiction();
    }

    /// Poses of the cameras in use.
    fn poses(&self) -> Vec<Option<Rigid>> {
        let pose =
            |slot: &CameraSlot| slot.recovery.is_none().then_some(slot.placement.world_from_camera);
        self.slots.iter().map(pose).collect()
    }

    /// Processes a completed bin.
    fn close(&mut self, bin: i64) {
        let groups = self.groups(bin);
        for slot in groups.iter().flat_map(|group| &group.views).map(|(slot, _)| *slot) {
            self.slots[slot].last_matched = Some(bin);
        }
        self.recover(&groups);
        self.bins.push_back(groups);
        let is_calm = self.update_verdicts();
        if self.bins.len() > WINDOWS[1] {
            let oldest = self.bins.pop_front().unwrap_or_default();
            if is_calm {
                self.follow_drift(&oldest, bin);
            }
        }
    }

    /// Matched views of a bin.
    fn groups(&mut self, bin: i64) -> Vec<CoObservation> {
        let bin_center = Timestamp::from_ns(bin * BIN_NS + BIN_NS / 2);
        let mut singles = Vec::new();
        for (index, slot) in self.slots.iter_mut().enumerate() {
            for (number, track) in &mut slot.tracks {
                let view = track.view(bin_center, self.params.clock_deviation_s);
                track.forget(bin_center);
                if let (Some(view), Ok(code)) = (view, track.code()) {
                    let kind = track.kind;
                    singles.push(SingleView { slot: index, number: *number, kind, code, view });
                }
            }
            slot.tracks.retain(|_, track| bin_center.ns_since(track.newest) < FORGOTTEN_NS);
        }
        let pose = |slot: &CameraSlot| match &slot.recovery {
            Some(recovery) => recovery.pose,
            None => slot.placement.world_from_camera,
        };
        let poses: Vec<Rigid> = self.slots.iter().map(pose).collect();
        match_views(&singles, &poses, &self.landmarks, &mut self.rest_times, bin)
    }

    fn recover(&mut self, groups: &[CoObservation]) {
        let others = self.poses();
        for index in 0..self.slots.len() {
            let slot = &mut self.slots[index];
            let Some(recovery) = &mut slot.recovery else { continue };
            let Some(fit) = recovery.advance(index, groups, &others, &self.params) else {
                continue;
            };
            let (fixed, last_matched) = recovery.counterparts(index);
            slot.recovery = None;
            slot.placement.world_from_camera = fit.pose;
            slot.placement.covariance = fit.covariance;
            if fixed.len() < MIN_FIXED {
                // A pose found relative to others has their error too.
                let best = self.best_of(&last_matched);
                self.slots[index].placement.covariance += best;
            }
            let (camera, placement) = (self.slots[index].camera, self.slots[index].placement);
            self.events.push(WatchEvent::Returned { camera, placement });
        }
    }

    /// Covariance of the most precise of these cameras.
    fn best_of(&self, slots: &BTreeSet<usize>) -> Covariance6 {
        let covariances = slots.iter().map(|slot| self.slots[*slot].placement.covariance);
        let spread = |it: &Covariance6| it.fixed_view::<3, 3>(0, 0).trace();
        covariances
            .min_by(|one, other| spread(one).total_cmp(&spread(other)))
            .unwrap_or_else(Covariance6::zeros)
    }
}
