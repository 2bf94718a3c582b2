//! Bodies within fusion: their parts in a frame become one sighting.

use super::{Fusion, FusionCounts};
use crate::{
    track::Measurement,
    world::{
        association::Sighting,
        body::{
            Body, BodyError,
            joint_measurement::{PredictedPose, joint_measurement},
        },
        identity::{Subject, body_number},
        lifecycle::Track,
        measurement::{
            ExposurePose, FrameId, MeasurementReject, StampCorrection, add_camera_pose_error,
            measure,
        },
    },
};
use roundel_vision::{
    id::{BodyId, CameraId, TrackNumber},
    pose::Detection,
    rigid::Covariance6,
    time::Timestamp,
};

impl FusionCounts {
    pub(super) fn count_reject(&mut self, reject: MeasurementReject) {
        match reject {
            MeasurementReject::NoPose => self.no_pose += 1,
            MeasurementReject::Invalid => self.invalid += 1,
        }
    }
}

impl Fusion {
    /// Tracks an object with several roundels, by its origin and axes. Its roundels ignore [`Fusion::set_offset`]
    /// and [`Fusion::set_motion`] of their kinds.
    pub fn add_body(&mut self, body: Body) -> Result<BodyId, BodyError> {
        self.bodies.add(body)
    }

    /// Takes a detection that is part of a body; false if it is not.
    pub(super) fn take_part(
        &mut self,
        detection: &Detection,
        frame: FrameId,
        camera_pose: &ExposurePose,
        correction: StampCorrection,
        now: Timestamp,
    ) -> bool {
        let Some((part, is_new)) = self.bodies.part_of(detection, frame.camera, now) else {
            return false;
        };
        // The error of the camera pose is common to all parts: it is added last.
        let zero = Covariance6::zeros();
        let exact = ExposurePose { systematic: zero, fresh: zero, ..*camera_pose };
        let size = self.print_sizes.get(detection.ring.kind);
        match measure(detection, frame, &exact, correction, size, &self.params) {
            Ok(measurement) => self.bodies.add_part(part, measurement),
            Err(reject) => self.counts.count_reject(reject),
        }
        if is_new {
            self.absorb(frame.camera, detection.track, now);
        }
        true
    }

    /// Makes one sighting from all parts of each body in the frame.
    pub(super) fn join_parts(&mut self, camera_pose: &ExposurePose) {
        let all_parts = self.bodies.take_parts();
        for parts in all_parts.chunk_by(|a, b| a.body() == b.body()) {
            let body = parts[0].body();
            let subject = Subject { kind: self.bodies.kind(body), body: Some(body) };
            let of_body = self.tracks.iter().filter(|track| track.subject == subject);
            let track = of_body.max_by_key(|track| (!track.is_tentative(), track.newest));
            let prediction = track.map(|track| {
                PredictedPose::from_track(
                    track,
                    &parts[0].measurement,
                    self.params.predicted_after_ns,
                )
            });
            let share = self.params.systematic_share.clamp(0.0, 1.0);
            let Some((measurement, left_out)) =
                joint_measurement(parts, prediction.as_ref(), share)
            else {
                self.counts.invalid += parts.len() as u64;
                continue;
            };
            self.counts.left_out += left_out as u64;
            self.counts.joined += (parts.len() - 1 - left_out) as u64;
            let measurement = Measurement { number: body_number(body), ..measurement };
            let measurement = add_camera_pose_error(measurement, camera_pose);
            self.sightings.push(Sighting { subject, code: None, measurement });
        }
    }

    /// Ends a track whose roundel was identified as a part of a body.
    fn absorb(&mut self, camera: CameraId, number: TrackNumber, now: Timestamp) {
        let is_it =
            |track: &Track| track.subject.body.is_none() && track.has_number(camera, number);
        let Some(index) = self.tracks.iter().position(is_it) else { return };
        let ended = self.tracks.remove(index);
        self.counts.merged += 1;
        self.end(ended, now);
    }
}
