//! Whether cameras still stand where they were found to: who was bumped, where it stands now, and who drifts.
//!
//! In: where cameras stand, what they see ([`Watch::observe`], at any rate, late and out of order by up to
//! [`WatchParams::delay_s`]) and the time ([`Watch::advance`]). Out: events that say which camera is to be left
//! out ([`WatchEvent::Bumped`]), where it stands once that is known again ([`WatchEvent::Returned`]), and small
//! corrections of those that drift ([`WatchEvent::Drifted`]). The caller puts them into effect; nothing here
//! touches tracks.
//!
//! Time is cut into bins of [`BIN_S`]. In each, every camera's view of a roundel is averaged (`track`), and
//! views of the same roundel meet (`co_observation`): one another's, and the places of reference roundels. The newest half
//! second and two seconds are judged four times a second (`attribution`, by fits of `pose_fit`); two verdicts in a row that
//! name the same camera are believed. It is then left out of everything, and its place found afresh from what
//! it sees from then on (`recovery`). What is slower than the two seconds shows in sums over a minute
//! (`drift`).
//!
//! Errors of a view: half of a detection's variance ([`WatchParams::systematic_share`]) stays for
//! [`WatchParams::systematic_time_s`], and of a roundel that stands for as long as it does, so that an hour of
//! one that is parked says no more than one look. What covariances do not say (lenses, clocks) is seen as
//! disagreement that no camera's move explains, and raises all limits alike.
//!
//! Reached on R4 (`cargo run --release -p roundel-tests --bin healing`, `tests/tests/healing.rs`): see the table
//! there. Lenses that are off by 0.05 % and 0.5 px are taken up by places within minutes, and nothing wanders from then on.
//!
//! PERF: 16 cameras with 60 frames a second and 50 objects in each cost 1.1 to 1.6 % of a core with codes, 1.9 % without
//! (5.8 before those that are near were looked for by place, and before more than 30 views a second were left out); `cargo
//! bench -p roundel-core --bench watch`, on a busy machine.
//!
//! Until a bump is noticed, about a second, fusion guards itself ([`roundel_fusion::world`], `guard`). Whom it holds back
//! ([`Watch::hold`]) has moved all of a sudden, so that of a camera that agreed with others before a millimetre is
//! believed; of others it might as well be the lens. R4, 1 mm or 0.01°: never held back, healed as drift within 80 s, no
//! track off by more than without; 2 to 6 mm, 0.03° and 0.06°: noticed within 0.91 s, back within 18 s. In the first
//! minute after a start 2 and 3 mm are drift as well, and tracks are off by up to 9 mm until then.
//!
//! Whose place was written by hand ([`Watch::distrust`]) is not called bumped before it has agreed with others: it may
//! never have stood there, and then a calibration is wanted, not healing.
//!
//! Limits. Two cameras without references contradict each other, and nobody is moved. One roundel alone says nothing,
//! since its code may be on show twice. Where there are no references, the common frame of all cameras may go where
//! corrections of single cameras lead. A bump that takes a camera's view off everything that others see leaves it
//! alone, or in quarantine, until a person comes. Of roundels without codes, a camera is recognized as long as they
//! appear within 0.2 m of where they are. Poses belong to the lenses that they were found with: where those are off by
//! 0.05 % and 0.5 px, poses from [`crate::arena`] agree (R4, 8 seeds, 60 s: nobody called bumped or held back, tracks
//! 1.0 mm off, rms), but exact ones look like bumps in the first minute, in 6 of 8 runs, until corrections for drift
//! have taken the lenses up.

mod attribution;
mod co_observation;
mod drift;
mod event;
mod params;
mod pose_fit;
mod recovery;
#[cfg(test)]
mod tests;
mod track;
mod verdicts;

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use nalgebra::{Matrix6, Vector6};

use co_observation::{Meeting, Single, Stands, meet};
use drift::Drift;
pub use event::{CameraHealth, WatchEvent, WatchState};
pub use params::WatchParams;
use recovery::Recovery;
use roundel_fusion::world::{CameraPlacement, FrameObservations, Landmark};
use roundel_vision::{
    id::{CameraId, TrackNumber},
    rigid::{Covariance6, Rigid},
    time::Timestamp,
};
use track::Trail;
use verdicts::Streak;

/// Time is cut into bins of this.
pub const BIN_S: f64 = 0.25;
const BIN_NS: i64 = 250_000_000;
/// Bins that are judged together; of the longest the oldest goes over to the slow sums.
const WINDOWS: [usize; 2] = [2, 8];
/// Landmarks that tie a camera to the world by themselves.
const LEAST_FIXED: usize = 3;
/// A camera that met no other for so many bins is alone.
const ALONE_BINS: i64 = 20;
/// Bins that are caught up on after a pause.
const MOST_BEHIND: i64 = 40;
/// Roundels followed by one camera.
const MOST_TRAILS: usize = 1024;
/// One that is not seen for so long is forgotten.
const FORGOTTEN_NS: i64 = 2_000_000_000;
/// Stamps that are so far ahead of the time are wrong.
const AHEAD_NS: i64 = 5_000_000_000;

/// One camera.
#[derive(Clone, Debug)]
struct Post {
    camera: CameraId,
    placement: CameraPlacement,
    /// Measured, or found to agree with others: that it does not any more has a cause.
    is_trusted: bool,
    /// It agreed with others for as long as drift is looked at.
    is_settled: bool,
    /// Fusion says that it moved all of a sudden.
    is_held: bool,
    trails: BTreeMap<TrackNumber, Trail>,
    recovery: Option<Recovery>,
    /// When it met another.
    met: Option<i64>,
}

/// All cameras of an installation.
#[derive(Clone, Debug)]
pub struct Watch {
    params: WatchParams,
    landmarks: Vec<Landmark>,
    posts: Vec<Post>,
    /// The newest is the last.
    bins: VecDeque<Vec<Meeting>>,
    next_bin: Option<i64>,
    now: Option<Timestamp>,
    stands: Stands,
    streaks: [Streak; WINDOWS.len()],
    drift: Drift,
    /// Those of which one moved, ascending.
    contradiction: Option<Vec<CameraId>>,
    /// Those who were said to stand elsewhere than others see, ascending.
    misplaced: Vec<CameraId>,
    events: Vec<WatchEvent>,
}

impl Watch {
    /// Watches nobody yet.
    pub fn new(params: WatchParams) -> Self {
        Self {
            params,
            landmarks: Vec::new(),
            posts: Vec::new(),
            bins: VecDeque::new(),
            next_bin: None,
            now: None,
            stands: Stands::default(),
            streaks: Default::default(),
            drift: Drift::new(0),
            contradiction: None,
            misplaced: Vec::new(),
            events: Vec::new(),
        }
    }

    /// Says where a camera stands: what was known of how it agrees with others is forgotten. The place that an
    /// event told may be said again, which changes nothing.
    pub fn set_camera(&mut self, camera: CameraId, placement: CameraPlacement) {
        match self.post(camera) {
            Some(post) if self.posts[post].placement == placement => {}
            Some(post) => {
                self.posts[post].placement = placement;
                self.posts[post].recovery = None;
                self.posts[post].is_trusted = true;
                self.posts[post].is_settled = false;
                self.forget_camera(post);
            }
            None => {
                let trails = BTreeMap::new();
                self.posts.push(Post {
                    camera,
                    placement,
                    is_trusted: true,
                    is_settled: false,
                    is_held: false,
                    trails,
                    recovery: None,
                    met: None,
                });
                self.drift.grow();
            }
        }
    }

    /// Says that where a camera stands was written by a person, and may be rough: until it has agreed with others once,
    /// nobody who disagrees with it is called bumped, nor is it.
    pub fn distrust(&mut self, camera: CameraId) {
        if let Some(post) = self.post(camera) {
            self.posts[post].is_trusted = false;
        }
    }

    /// Whether a camera's place was measured, or it has agreed with others since it was distrusted. Of no other is it
    /// sensible to hold it back.
    pub fn is_trusted(&self, camera: CameraId) -> bool {
        self.post(camera).is_none_or(|post| self.posts[post].is_trusted)
    }

    /// Says whether fusion holds a camera back: then it did move all of a sudden, and less of a disagreement is believed.
    pub fn hold(&mut self, camera: CameraId, is_held: bool) {
        if let Some(post) = self.post(camera) {
            self.posts[post].is_held = is_held;
        }
    }

    /// No longer watches a camera.
    pub fn remove_camera(&mut self, camera: CameraId) {
        if let Some(post) = self.post(camera) {
            self.posts.remove(post);
            self.forget();
        }
    }

    /// Says where reference roundels are.
    pub fn set_landmarks(&mut self, landmarks: &[Landmark]) {
        if self.landmarks != landmarks {
            self.landmarks = landmarks.to_vec();
            self.forget();
        }
    }

    /// Takes in what a camera saw; its stamps are late by `clock_offset_s`.
    pub fn observe(&mut self, frame: &FrameObservations, clock_offset_s: f64) {
        let (Some(post), now) = (self.post(frame.camera), self.now) else { return };
        let trails = &mut self.posts[post].trails;
        for seen in &frame.detections {
            let (Some(pose), Some(kind)) = (&seen.pose, seen.ring.kind) else { continue };
            let time = seen.capture_time.plus_seconds(-clock_offset_s);
            let is_ahead = now.is_some_and(|now| time.ns_since(now) > AHEAD_NS);
            if is_ahead || trails.len() >= MOST_TRAILS && !trails.contains_key(&seen.track) {
                continue;
            }
            let trail = trails.entry(seen.track).or_insert_with(|| Trail::new(kind, time));
            trail.add(time, seen, pose);
        }
    }

    /// Lets time pass until `now`, by the corrected stamps; what became known.
    pub fn advance(&mut self, now: Timestamp) -> Vec<WatchEvent> {
        self.now = Some(now);
        let newest = now.plus_seconds(-self.params.delay_s).as_ns().div_euclid(BIN_NS) - 1;
        let next = self.next_bin.unwrap_or(newest).max(newest.saturating_sub(MOST_BEHIND));
        for bin in next..=newest {
            self.close(bin);
        }
        self.next_bin = Some(next.max(newest + 1));
        std::mem::take(&mut self.events)
    }

    /// What is known of a camera; `None` if it is not watched.
    pub fn health(&self, camera: CameraId) -> Option<CameraHealth> {
        let post = self.post(camera)?;
        let offset = self.drift.offset(post);
        let (change, covariance) =
            offset.map_or((Vector6::zeros(), Matrix6::zeros()), |it| (it.change, it.covariance));
        let deviation =
            |corner: usize| covariance.fixed_view::<3, 3>(corner, corner).trace().sqrt();
        Some(CameraHealth {
            state: self.state(post),
            error_m: change.fixed_rows::<3>(0).norm(),
            error_rad: change.fixed_rows::<3>(3).norm(),
            deviation_m: deviation(0),
            deviation_rad: deviation(3),
            seen_error_m: offset.map_or(0.0, |it| it.moved_m),
        })
    }

    fn state(&self, post: usize) -> WatchState {
        let camera = &self.posts[post].camera;
        let newest = self.next_bin.unwrap_or_default();
        if self.posts[post].recovery.is_some() {
            WatchState::Quarantined
        } else if self.contradiction.as_ref().is_some_and(|cameras| cameras.contains(camera))
            || self.streaks.iter().any(|streak| streak.posts.contains(&post))
        {
            WatchState::Suspected
        } else if self.posts[post].met.is_none_or(|met| newest - met > ALONE_BINS) {
            WatchState::Alone
        } else {
            WatchState::Watched
        }
    }

    fn post(&self, camera: CameraId) -> Option<usize> {
        self.posts.iter().position(|post| post.camera == camera)
    }

    /// Forgets what was seen of a camera together with others.
    fn forget_camera(&mut self, post: usize) {
        self.bins.iter_mut().flatten().for_each(|meeting| meeting.forget(post));
        self.drift.forget(post);
        self.posts[post].met = None;
        // It may have stood elsewhere while it saw that.
        self.posts[post].trails.values_mut().for_each(Trail::restart);
        self.posts.iter_mut().filter_map(|it| it.recovery.as_mut()).for_each(|it| it.forget(post));
        if self.streaks.iter().any(|streak| streak.posts.contains(&post)) {
            self.streaks = Default::default();
        }
        let camera = self.posts[post].camera;
        if self.contradiction.as_ref().is_some_and(|cameras| cameras.contains(&camera)) {
            self.end_contradiction();
        }
    }

    /// Forgets all evidence: what it says of was changed.
    fn forget(&mut self) {
        self.bins.clear();
        self.drift = Drift::new(self.posts.len());
        self.streaks = Default::default();
        self.stands = Stands::default();
        for post in &mut self.posts {
            post.met = None;
            if let Some(recovery) = &mut post.recovery {
                recovery.restart();
            }
        }
        self.end_contradiction();
    }

    /// Places of cameras in service.
    fn places(&self) -> Vec<Option<Rigid>> {
        let place =
            |post: &Post| post.recovery.is_none().then_some(post.placement.world_from_camera);
        self.posts.iter().map(place).collect()
    }

    /// Takes in a bin that is over.
    fn close(&mut self, bin: i64) {
        let meetings = self.meetings(bin);
        for post in meetings.iter().flat_map(|meeting| &meeting.sights).map(|(post, _)| *post) {
            self.posts[post].met = Some(bin);
        }
        self.recover(&meetings);
        self.bins.push_back(meetings);
        let is_calm = self.judge();
        if self.bins.len() > WINDOWS[1] {
            let oldest = self.bins.pop_front().unwrap_or_default();
            if is_calm {
                self.follow(&oldest, bin);
            }
        }
    }

    /// Who met in a bin.
    fn meetings(&mut self, bin: i64) -> Vec<Meeting> {
        let middle = Timestamp::from_ns(bin * BIN_NS + BIN_NS / 2);
        let mut singles = Vec::new();
        for (index, post) in self.posts.iter_mut().enumerate() {
            for (number, trail) in &mut post.trails {
                let sight = trail.sight(middle, self.params.clock_deviation_s);
                trail.forget(middle);
                if let (Some(sight), Ok(code)) = (sight, trail.code()) {
                    let kind = trail.kind;
                    singles.push(Single { post: index, number: *number, kind, code, sight });
                }
            }
            post.trails.retain(|_, trail| middle.ns_since(trail.newest) < FORGOTTEN_NS);
        }
        let place = |post: &Post| match &post.recovery {
            Some(recovery) => recovery.place,
            None => post.placement.world_from_camera,
        };
        let places: Vec<Rigid> = self.posts.iter().map(place).collect();
        meet(&singles, &places, &self.landmarks, (&mut self.stands, bin))
    }

    /// Cameras out of service.
    fn recover(&mut self, meetings: &[Meeting]) {
        let others = self.places();
        for index in 0..self.posts.len() {
            let post = &mut self.posts[index];
            let Some(recovery) = &mut post.recovery else { continue };
            let Some(fit) = recovery.advance(index, meetings, &others, &self.params) else {
                continue;
            };
            let (fixed, met) = recovery.met(index);
            post.recovery = None;
            post.placement.world_from_camera = fit.place;
            post.placement.covariance = fit.covariance;
            if fixed.len() < LEAST_FIXED {
                // Found against others, it errs with them.
                let best = self.best_of(&met);
                self.posts[index].placement.covariance += best;
            }
            let (camera, placement) = (self.posts[index].camera, self.posts[index].placement);
            self.events.push(WatchEvent::Returned { camera, placement });
        }
    }

    /// The covariance of the place that is known best among these cameras.
    fn best_of(&self, posts: &BTreeSet<usize>) -> Covariance6 {
        let covariances = posts.iter().map(|post| self.posts[*post].placement.covariance);
        let spread = |it: &Covariance6| it.fixed_view::<3, 3>(0, 0).trace();
        covariances
            .min_by(|one, other| spread(one).total_cmp(&spread(other)))
            .unwrap_or_else(Covariance6::zeros)
    }
}
