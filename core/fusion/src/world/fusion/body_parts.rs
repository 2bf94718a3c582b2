//! Objects of several roundels within fusion: their parts in a frame become one sighting.

use super::{Fusion, FusionCounts};
use crate::{
    track::Measurement,
    world::{
        association::Sighting,
        body::joint_measurement::{Expected, assemble},
        body::{Body, BodyError},
        camera_pose::Stand,
        identity::Subject,
        identity::body_number,
        lifecycle::Track,
        measurement::{Lateness, Refused, measure, with_stand},
    },
};
use roundel_vision::{
    id::{BodyId, CameraId, TrackNumber},
    pose::Detection,
    rigid::Covariance6,
    time::Timestamp,
};

impl FusionCounts {
    pub(super) fn count_refused(&mut self, refused: Refused) {
        match refused {
            Refused::NoPose => self.no_pose += 1,
            Refused::Invalid => self.invalid += 1,
        }
    }
}

impl Fusion {
    /// Follows what carries these roundels as one object, by its origin and axes. What
    /// [`Fusion::set_offset`] and [`Fusion::set_motion`] say of their kinds is not heeded for it.
    pub fn add_body(&mut self, body: Body) -> Result<BodyId, BodyError> {
        self.bodies.add(body)
    }

    /// Takes a detection that is a part of a body; false if it is of none.
    pub(super) fn take_part(
        &mut self,
        detection: &Detection,
        (camera, frame): (CameraId, u64),
        stand: &Stand,
        (late, now): (Lateness, Timestamp),
    ) -> bool {
        let Some((part, is_new)) = self.bodies.part_of(detection, camera, now) else {
            return false;
        };
        // Errors of the camera's place are common to all parts: they come last.
        let zero = Covariance6::zeros();
        let exact = Stand { systematic: zero, fresh: zero, ..*stand };
        match measure(detection, (camera, frame), &exact, late, &self.params) {
            Ok(measurement) => self.bodies.see(part, measurement),
            Err(refused) => self.counts.count_refused(refused),
        }
        if is_new {
            self.absorb(camera, detection.track, now);
        }
        true
    }

    /// Makes one sighting of all parts of each body that the frame shows.
    pub(super) fn join_parts(&mut self, stand: &Stand) {
        let seen = self.bodies.take_seen();
        for parts in seen.chunk_by(|a, b| a.body() == b.body()) {
            let body = parts[0].body();
            let subject = Subject { kind: self.bodies.kind(body), body: Some(body) };
            let of_body = self.tracks.iter().filter(|track| track.subject == subject);
            let track = of_body.max_by_key(|track| (!track.is_tentative(), track.newest));
            let expected = track.map(|track| {
                Expected::of(track, &parts[0].measurement, self.params.predicted_after_ns)
            });
            let share = self.params.systematic_share.clamp(0.0, 1.0);
            let Some((measurement, left_out)) = assemble(parts, expected.as_ref(), share) else {
                self.counts.invalid += parts.len() as u64;
                continue;
            };
            self.counts.left_out += left_out as u64;
            self.counts.joined += (parts.len() - 1 - left_out) as u64;
            let measurement = Measurement { number: body_number(body), ..measurement };
            let measurement = with_stand(measurement, stand);
            self.sightings.push(Sighting { subject, code: None, measurement });
        }
    }

    /// Ends a track that turns out to be a roundel of a body, as a camera that follows it says.
    fn absorb(&mut self, camera: CameraId, number: TrackNumber, now: Timestamp) {
        let is_it =
            |track: &Track| track.subject.body.is_none() && track.is_known_as(camera, number);
        let Some(index) = self.tracks.iter().position(is_it) else { return };
        let mut gone = self.tracks.remove(index);
        self.counts.merged += 1;
        let known = !gone.is_tentative();
        let event = gone.lose(now);
        self.end(gone, known.then_some(event));
    }
}
