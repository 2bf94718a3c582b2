//! A track's life: tentative until enough speaks for it, tracked while it is seen, predicted while
//! it is not, lost in the end.
//!
//! What speaks for a tentative track is a score, the logarithm of the likelihood ratio of "an
//! object" to "clutter" (Blackman, Popoli, *Design and Analysis of Modern Tracking Systems*, 1999,
//! section 6.2): each detection that fits adds -½ d² - ½ ln det(2π S) - ln λ for a density λ of
//! clutter, so a hit in a narrow gate counts much and one in a wide gate little; each frame of a
//! camera that saw it and sees it no more takes away. Trusted above [`TRUSTED_SCORE`] with enough
//! hits, dropped below [`DROPPED_SCORE`].

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

/// e¹⁰: twenty thousand to one that it is an object.
const TRUSTED_SCORE: f64 = 10.0;
const DROPPED_SCORE: f64 = -5.0;
/// What a frame without the track says.
const MISS_SCORE: f64 = -2.0;
/// -ln λ: one false detection a frame in 100 m³.
const CLUTTER_SCORE: f64 = 4.6;
/// A camera that contradicts all others for longer than this is believed to see something else.
const MAX_CONTRADICTION_NS: i64 = 1_000_000_000;
/// Cameras that saw it within this time are those that a time is compared with.
const SEEN_TOGETHER_NS: i64 = 1_000_000_000;
/// ln 2π · 3 / 2.
const GAUSS_CONSTANT: f64 = 2.756_815_6;

/// A camera's last sight of a track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::world) struct CameraView {
    pub(in crate::world) camera: CameraId,
    pub(in crate::world) number: TrackNumber,
    pub(in crate::world) frame: u64,
    pub(in crate::world) time: Timestamp,
}

/// One object as fusion follows it.
#[derive(Clone, Debug)]
pub(in crate::world) struct Track {
    pub(in crate::world) id: ObjectId,
    pub(in crate::world) subject: Subject,
    pub(in crate::world) codes: CodeVote,
    pub(in crate::world) stage: LifeStage,
    pub(in crate::world) history: History,
    /// Of the history's newest estimate.
    pub(in crate::world) coarse: Coarse,
    pub(in crate::world) model: MotionModel,
    pub(in crate::world) first: Timestamp,
    pub(in crate::world) newest: Timestamp,
    pub(in crate::world) observations: u64,
    /// By camera.
    pub(in crate::world) views: Vec<CameraView>,
    /// Tracks that a camera saw beside this one.
    pub(in crate::world) distinct_from: Vec<ObjectId>,
    /// What has said whose id it has.
    pub(in crate::world) claimed_mark: Option<Mark>,
    /// When its cameras' views were compared last.
    last_comparison: Option<Timestamp>,
    score: f64,
}

impl Track {
    /// From a detection that was no other track's.
    pub(in crate::world) fn begin(
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
            coarse: Coarse::of(
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

    pub(in crate::world) fn is_tentative(&self) -> bool {
        self.stage == LifeStage::Tentative
    }

    /// A settled code of a trusted track, or its body, that nothing has followed from yet.
    pub(in crate::world) fn unclaimed_mark(&self) -> Option<Mark> {
        let settled = match self.subject.body {
            Some(body) => Some(Mark::Body(body)),
            None => self.codes.settled().map(Mark::Code),
        };
        settled.filter(|_| !self.is_tentative() && self.claimed_mark != settled)
    }

    /// Whether the camera's tracker says that this is the roundel it saw as this track before.
    pub(in crate::world) fn is_continued_by(&self, measurement: &Measurement) -> bool {
        self.is_known_as(measurement.camera, measurement.number)
    }

    /// Whether the camera saw it under this number last.
    pub(in crate::world) fn is_known_as(&self, camera: CameraId, number: TrackNumber) -> bool {
        self.view_index(camera).is_ok_and(|index| self.views[index].number == number)
    }

    /// When a camera saw it last.
    pub(in crate::world) fn seen_by(&self, camera: CameraId) -> Option<Timestamp> {
        self.view_index(camera).ok().map(|index| self.views[index].time)
    }

    /// Cameras that saw it at or after `since`; whoever measured it then is among them.
    pub(in crate::world) fn seen_since(&self, since: Timestamp) -> impl Iterator<Item = CameraId> {
        self.views.iter().filter(move |view| view.time >= since).map(|view| view.camera)
    }

    /// Takes back what a camera measured from `since` on.
    pub(in crate::world) fn retract(&mut self, camera: CameraId, since: Timestamp) -> Retraction {
        let taken = self.history.retract(camera, since, &self.model);
        if matches!(taken, Retraction::Removed(count) if count > 0) {
            self.newest = self.history.newest_time();
            self.refresh();
        }
        taken
    }

    /// Whether a measurement that its camera takes for this object, but that does not fit, is the
    /// camera's error (a ring half covered, the other normal): another camera sees the object now, and
    /// not long ago this one agreed with it.
    pub(in crate::world) fn is_contradicted(
        &self,
        measurement: &Measurement,
        params: &FusionParams,
    ) -> bool {
        let within =
            |view: &CameraView, span_ns: i64| measurement.time.ns_since(view.time) <= span_ns;
        let agreed = self
            .view_index(measurement.camera)
            .is_ok_and(|index| within(&self.views[index], MAX_CONTRADICTION_NS));
        let is_witness = |view: &CameraView| {
            view.camera != measurement.camera && within(view, params.predicted_after_ns)
        };
        agreed && !self.is_tentative() && self.views.iter().any(is_witness)
    }

    /// How far the measurement's time may be off from those of the other cameras that see this, seconds. A
    /// clock that was just set makes its own camera's times uncertain, not those of the others.
    pub(in crate::world) fn timing_s(&self, measurement: &Measurement, clocks: &Clocks) -> f64 {
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

    /// The cameras' views of this held against one another, from time to time.
    pub(in crate::world) fn compare(&mut self, clocks: &Clocks) -> Option<Comparison> {
        let now = self.history.newest_time();
        if self.last_comparison.is_some_and(|time| now.ns_since(time) < clock::WINDOW_NS) {
            return None;
        }
        self.last_comparison = Some(now);
        (!self.is_tentative())
            .then(|| clock::compare(&self.history, now, clocks, self.model.systematic_time_s))
            .flatten()
    }

    /// Takes in a measurement; gives what became of it and what happened to the track.
    pub(in crate::world) fn observe(
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
                let trusted =
                    self.score >= TRUSTED_SCORE && self.observations >= params.confirm_hits;
                trusted.then_some(EventKind::Appeared)
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

    /// To be called after the history has changed.
    pub(in crate::world) fn refresh(&mut self) {
        self.coarse = Coarse::of(self.history.newest(), &self.model.acceleration_density_m2_s3);
    }

    /// A frame of this camera did not show the track.
    pub(in crate::world) fn miss(&mut self, camera: CameraId, time: Timestamp) {
        if self.is_tentative()
            && self.view_index(camera).is_ok_and(|index| self.views[index].time < time)
        {
            self.score += MISS_SCORE;
        }
    }

    /// Lets time pass. `Err` when the track has come to its end, with an event if it was known.
    pub(in crate::world) fn advance(
        &mut self,
        now: Timestamp,
        params: &FusionParams,
    ) -> Result<Option<Event>, Option<Event>> {
        let unseen_ns = now.ns_since(self.newest);
        if self.is_tentative() {
            let ends = unseen_ns > params.tentative_after_ns || self.score < DROPPED_SCORE;
            return if ends { Err(None) } else { Ok(None) };
        }
        if unseen_ns > params.lost_after_ns {
            return Err(Some(self.mark_lost(self.newest.plus_ns(params.lost_after_ns))));
        }
        if self.stage == LifeStage::Tracked && unseen_ns > params.predicted_after_ns {
            self.stage = LifeStage::Predicted;
            let time = self.newest.plus_ns(params.predicted_after_ns);
            return Ok(Some(Event { time, object: self.id, kind: EventKind::Predicted }));
        }
        Ok(None)
    }

    /// Gives the track up.
    pub(in crate::world) fn mark_lost(&mut self, time: Timestamp) -> Event {
        self.stage = LifeStage::Lost;
        Event { time, object: self.id, kind: EventKind::Lost }
    }

    /// Takes over how cameras number a track that is the same object.
    pub(in crate::world) fn adopt_views(&mut self, other: &Track) {
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
