//! One track with its life stage: tentative until confirmed, tracked while observed, predicted while not, lost in the
//! end.
//!
//! A tentative track is confirmed by a score, the logarithm of the likelihood ratio of "object" to "clutter" (Blackman,
//! Popoli, *Design and Analysis of Modern Tracking Systems*, 1999, section 6.2). Each detection adds -½ d² - ½ ln
//! det(2π S) - ln λ for a density λ of clutter, so a hit in a narrow gate counts more than one in a wide gate. Each
//! frame without it, of a camera that had observed it, subtracts. A track is confirmed above [`CONFIRMED_SCORE`] with
//! enough hits, and dropped below [`DROPPED_SCORE`].

use super::coarse::Coarse;
use crate::track::{
    FilterState, History, Innovation, Inserted, Measurement, MotionModel, Retraction,
};
use crate::world::{
    Event, EventKind, FusionParams, LifeStage,
    clock::Clocks,
    clock::{self, Comparison},
    identity::CodeVote,
    identity::{Mark, Subject},
};
use roundel_vision::{
    id::{CameraId, ObjectId, TrackNumber},
    time::Timestamp,
};

/// e¹⁰: odds of twenty thousand to one.
const CONFIRMED_SCORE: f64 = 10.0;
const DROPPED_SCORE: f64 = -5.0;
/// Contribution of a frame without the track.
const MISS_SCORE: f64 = -2.0;
/// -ln λ: one false detection a frame in 100 m³.
const CLUTTER_SCORE: f64 = 4.6;
/// A camera that contradicts all others for longer than this observes something else.
const MAX_CONTRADICTION_NS: i64 = 1_000_000_000;
/// Time differences are taken against cameras that observed the track within this time.
const SEEN_TOGETHER_NS: i64 = 1_000_000_000;
/// ln 2π · 3 / 2.
const GAUSS_CONSTANT: f64 = 2.756_815_6;

/// Newest detection of a track by one camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CameraView {
    pub(crate) camera: CameraId,
    pub(crate) number: TrackNumber,
    pub(crate) frame: u64,
    pub(crate) time: Timestamp,
}

/// One object and its filters.
#[derive(Clone, Debug)]
pub(crate) struct Track {
    pub(crate) id: ObjectId,
    pub(crate) subject: Subject,
    pub(crate) codes: CodeVote,
    pub(crate) stage: LifeStage,
    pub(crate) history: History,
    /// Summary of the history's newest state.
    pub(crate) coarse: Coarse,
    pub(crate) model: MotionModel,
    pub(crate) first: Timestamp,
    pub(crate) newest: Timestamp,
    pub(crate) observations: u64,
    /// One per camera, ascending.
    pub(crate) views: Vec<CameraView>,
    /// Tracks that appeared together with this one in a frame.
    pub(crate) distinct_from: Vec<ObjectId>,
    /// Mark with which the id was claimed.
    pub(crate) claimed_mark: Option<Mark>,
    /// Time of the last comparison of its cameras' clocks.
    last_comparison: Option<Timestamp>,
    score: f64,
}

impl Track {
    /// Track from a detection that fits no other track.
    pub(crate) fn begin(
        id: ObjectId,
        subject: Subject,
        measurement: Measurement,
        model: MotionModel,
    ) -> Self {
        Self {
            id,
            subject,
            codes: CodeVote::default(),
            stage: LifeStage::Tentative,
            coarse: Coarse::from_state(
                &FilterState::begin(&measurement, &model),
                &model.acceleration_density_m2_s3,
            ),
            history: History::begin(measurement, &model),
            model,
            first: measurement.time,
            newest: measurement.time,
            observations: 1,
            views: vec![camera_view(&measurement)],
            distinct_from: Vec::new(),
            claimed_mark: None,
            last_comparison: None,
            score: 0.0,
        }
    }

    pub(crate) fn is_tentative(&self) -> bool {
        self.stage == LifeStage::Tentative
    }

    /// Settled code or body of a confirmed track with which no id was claimed yet.
    pub(crate) fn unclaimed_mark(&self) -> Option<Mark> {
        let settled = match self.subject.body {
            Some(body) => Some(Mark::Body(body)),
            None => self.codes.settled().map(Mark::Code),
        };
        settled.filter(|_| !self.is_tentative() && self.claimed_mark != settled)
    }

    /// Whether the camera's tracker assigns the measurement to this track.
    pub(crate) fn is_continued_by(&self, measurement: &Measurement) -> bool {
        self.has_number(measurement.camera, measurement.number)
    }

    /// Whether the camera's newest detection of the track has this number.
    pub(crate) fn has_number(&self, camera: CameraId, number: TrackNumber) -> bool {
        self.view_index(camera).is_ok_and(|index| self.views[index].number == number)
    }

    /// Time of a camera's newest detection of the track.
    pub(crate) fn last_seen_by(&self, camera: CameraId) -> Option<Timestamp> {
        self.view_index(camera).ok().map(|index| self.views[index].time)
    }

    /// Cameras with a detection at or after `since`.
    pub(crate) fn cameras_since(&self, since: Timestamp) -> impl Iterator<Item = CameraId> {
        self.views.iter().filter(move |view| view.time >= since).map(|view| view.camera)
    }

    /// Removes a camera's measurements from `since` on.
    pub(crate) fn retract(&mut self, camera: CameraId, since: Timestamp) -> Retraction {
        let retraction = self.history.retract(camera, since, &self.model);
        if matches!(retraction, Retraction::Removed(count) if count > 0) {
            self.newest = self.history.newest_time();
            self.refresh();
        }
        retraction
    }

    /// Whether a measurement outside the gate, which its camera assigns to this track, is the camera's error (a
    /// half covered ring, the wrong normal): another camera observes the object now, and this one agreed with it
    /// not long ago.
    pub(crate) fn is_contradicted(&self, measurement: &Measurement, params: &FusionParams) -> bool {
        let within =
            |view: &CameraView, span_ns: i64| measurement.time.ns_since(view.time) <= span_ns;
        let agreed = self
            .view_index(measurement.camera)
            .is_ok_and(|index| within(&self.views[index], MAX_CONTRADICTION_NS));
        let is_contradicting = |view: &CameraView| {
            view.camera != measurement.camera && within(view, params.predicted_after_ns)
        };
        agreed && !self.is_tentative() && self.views.iter().any(is_contradicting)
    }

    /// Standard deviation of the measurement's time against the other cameras that observe the track, seconds. A
    /// clock that was just set makes its own camera's times uncertain, not those of the others.
    pub(crate) fn timing_s(&self, measurement: &Measurement, clocks: &Clocks) -> f64 {
        if !clocks.is_estimating() {
            return 0.0;
        }
        let is_other = |view: &&CameraView| {
            view.camera != measurement.camera
                && measurement.time.ns_since(view.time).saturating_abs() < SEEN_TOGETHER_NS
                && !clocks.is_less_certain(view.camera, measurement.camera)
        };
        let others = self.views.iter().filter(is_other);
        others.map(|view| clocks.deviation_s(measurement.camera, view.camera)).fold(0.0, f64::max)
    }

    /// Compares the clocks of the cameras that observe the track, once per window.
    pub(crate) fn compare(&mut self, clocks: &Clocks) -> Option<Comparison> {
        let now = self.history.newest_time();
        if self.last_comparison.is_some_and(|time| now.ns_since(time) < clock::WINDOW_NS) {
            return None;
        }
        self.last_comparison = Some(now);
        (!self.is_tentative())
            .then(|| clock::compare(&self.history, now, clocks, self.model.systematic_time_s))
            .flatten()
    }

    /// Adds a measurement; returns the result of the insertion and the change of the life stage.
    pub(crate) fn observe(
        &mut self,
        measurement: &Measurement,
        innovation: &Innovation,
        params: &FusionParams,
    ) -> (Inserted, Option<Event>) {
        let inserted = self.history.insert(measurement, &self.model);
        self.refresh();
        if matches!(inserted, Inserted::TooLate | Inserted::Duplicate) {
            return (inserted, None);
        }
        self.observations += 1;
        self.first = self.first.min(measurement.time);
        let is_newest = measurement.time > self.newest;
        self.newest = self.newest.max(measurement.time);
        match self.view_index(measurement.camera) {
            Ok(index) if self.views[index].time <= measurement.time => {
                self.views[index] = camera_view(measurement)
            }
            Ok(_) => {}
            Err(index) => self.views.insert(index, camera_view(measurement)),
        }
        let kind = match self.stage {
            LifeStage::Tentative => {
                self.score += CLUTTER_SCORE
                    - GAUSS_CONSTANT
                    - 0.5 * (innovation.distance_squared + innovation.log_det());
                let is_confirmed =
                    self.score >= CONFIRMED_SCORE && self.observations >= params.confirm_hits;
                is_confirmed.then_some(EventKind::Appeared)
            }
            LifeStage::Predicted => is_newest.then_some(EventKind::Recovered),
            LifeStage::Tracked | LifeStage::Lost => None,
        };
        if kind.is_some() {
            self.stage = LifeStage::Tracked;
        }
        let event = kind.map(|kind| Event { time: measurement.time, object: self.id, kind });
        (inserted, event)
    }

    /// Updates the summary after a change of the history.
    pub(crate) fn refresh(&mut self) {
        self.coarse =
            Coarse::from_state(self.history.newest(), &self.model.acceleration_density_m2_s3);
    }

    /// Notes a frame of this camera without the track.
    pub(crate) fn miss(&mut self, camera: CameraId, time: Timestamp) {
        if self.is_tentative()
            && self.view_index(camera).is_ok_and(|index| self.views[index].time < time)
        {
            self.score += MISS_SCORE;
        }
    }

    /// Time at which the track has ended, if it has by `now`.
    pub(crate) fn end_time(&self, now: Timestamp, params: &FusionParams) -> Option<Timestamp> {
        let limit_ns =
            if self.is_tentative() { params.tentative_after_ns } else { params.lost_after_ns };
        let is_dropped = self.is_tentative() && self.score < DROPPED_SCORE;
        let has_ended = is_dropped || now.ns_since(self.newest) > limit_ns;
        has_ended.then(|| self.newest.plus_ns(limit_ns))
    }

    /// Advances the life stage to `now`.
    pub(crate) fn advance(&mut self, now: Timestamp, params: &FusionParams) -> Option<Event> {
        let time = self.newest.plus_ns(params.predicted_after_ns);
        if self.stage != LifeStage::Tracked || now <= time {
            return None;
        }
        self.stage = LifeStage::Predicted;
        Some(Event { time, object: self.id, kind: EventKind::Predicted })
    }

    /// Takes over the camera views of a merged track.
    pub(crate) fn adopt_views(&mut self, other: &Track) {
        for view in &other.views {
            match self.view_index(view.camera) {
                Ok(index) if self.views[index].time < view.time => self.views[index] = *view,
                Ok(_) => {}
                Err(index) => self.views.insert(index, *view),
            }
        }
    }

    fn view_index(&self, camera: CameraId) -> Result<usize, usize> {
        self.views.binary_search_by_key(&camera, |view| view.camera)
    }
}

fn camera_view(measurement: &Measurement) -> CameraView {
    CameraView {
        camera: measurement.camera,
        number: measurement.number,
        frame: measurement.frame,
        time: measurement.time,
    }
}
