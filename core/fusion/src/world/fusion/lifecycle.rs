//! Start, ageing, merging and end of tracks within fusion, with their events.

use super::Fusion;
use crate::world::{
    Event, EventKind, LifeStage,
    association::Sighting,
    identity::CARRIER_NUMBER,
    lifecycle::{Track, find_duplicates},
};
use roundel_vision::{id::ObjectId, time::Timestamp};

/// Largest number of events kept for the caller; the oldest are dropped.
const MAX_EVENTS: usize = 10_000;

impl Fusion {
    pub(super) fn begin(&mut self, sighting: &Sighting) {
        if self.tracks.len() >= self.params.max_objects {
            self.counts.over_max_objects += 1;
            return;
        }
        self.last_id += 1;
        self.counts.used += 1;
        self.counts.begun += 1;
        self.newest_used = self.newest_used.max(Some(sighting.measurement.time));
        let subject = sighting.subject;
        let class = subject.kind.and_then(|kind| self.classes.get(&kind)).copied();
        let mut model = match subject.body {
            Some(body) => self.bodies.model(body, &self.params),
            None => self.params.motion_model(&class.unwrap_or_default()),
        };
        // For an object measured by its own camera, the position depends on the orientation, whose errors last.
        model.learns_rotation_density &= sighting.measurement.number != CARRIER_NUMBER;
        let mut track = Track::begin(ObjectId(self.last_id), subject, sighting.measurement, model);
        if let Some(code) = sighting.code {
            track.codes.add(code);
        }
        self.tracks.push(track);
    }

    /// Advances all tracks to `now`.
    pub(super) fn advance(&mut self, now: Timestamp) {
        let mut index = 0;
        while index < self.tracks.len() {
            let track = &mut self.tracks[index];
            if let Some(time) = track.end_time(now, &self.params) {
                let ended = self.tracks.remove(index);
                self.end(ended, time);
                continue;
            }
            index += 1;
            if let Some(event) = track.advance(now, &self.params) {
                self.push_event(event);
            }
        }
    }

    /// Ends all tracks after a jump of the timeline.
    pub(super) fn restart(&mut self) {
        self.counts.restarts += 1;
        self.next_merge = None;
        self.newest_used = None;
        for track in std::mem::take(&mut self.tracks) {
            let newest = track.newest;
            self.end(track, newest);
        }
    }

    pub(super) fn merge(&mut self, now: Timestamp) {
        while let Some((stays, goes)) = find_duplicates(&mut self.tracks, now) {
            let ended = self.tracks[goes].clone();
            self.tracks[stays].adopt_views(&ended);
            self.tracks[stays].codes.merge(&ended.codes);
            self.tracks.remove(goes);
            self.counts.merged += 1;
            self.end(ended, now);
        }
    }

    /// Ends a track. A confirmed one gives an event, and appears in the next snapshot as lost.
    pub(super) fn end(&mut self, mut track: Track, time: Timestamp) {
        if track.subject.body.is_some() {
            // Another track of the body may claim the id now.
            let twins = self.tracks.iter_mut().filter(|other| other.subject == track.subject);
            twins.for_each(|twin| twin.claimed_mark = None);
        }
        if track.is_tentative() {
            return;
        }
        track.stage = LifeStage::Lost;
        self.push_event(Event { time, object: track.id, kind: EventKind::Lost });
        if self.lost.len() >= self.params.max_objects {
            self.lost.remove(0);
        }
        self.lost.push(track);
    }

    pub(super) fn push_event(&mut self, event: Event) {
        if self.events.len() == MAX_EVENTS {
            self.events.pop_front();
        }
        self.events.push_back(event);
    }
}
