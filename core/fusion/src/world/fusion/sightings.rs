//! Camera poses at the time of a frame, and the frame's detections as sightings.

use super::{Fusion, FusionCounts};
use crate::world::{
    CameraPlacement, FrameObservations,
    association::Sighting,
    identity::Subject,
    measurement::{ExposurePose, FrameId, StampCorrection, measure},
    mobile_camera::{CameraMount, Carrier, CarrierState, Landmark, LocalizationInput, Unplaced},
};
use roundel_vision::{
    id::{CameraId, TrackNumber},
    rigid::rotate_covariance,
    time::Timestamp,
};

/// Largest difference of a detection's capture time from its frame's (half a slow rolling shutter).
const MAX_ROW_TIME_NS: i64 = 500_000_000;

impl FusionCounts {
    fn count_unplaced(&mut self, reason: Unplaced, detections: usize) {
        let detections = detections as u64;
        self.no_camera_pose += detections;
        match reason {
            Unplaced::Unknown => {}
            Unplaced::CarrierUnseen => self.carrier_unseen += detections,
            Unplaced::CarrierWithoutYaw | Unplaced::CarrierUncertain => {
                self.carrier_orientation_unknown += detections;
            }
        }
    }
}

impl Fusion {
    /// Fixes a camera to an object; a body must exist. With `None` the camera is stationary, with the pose of
    /// [`Self::set_camera`].
    pub fn set_mount(&mut self, camera: CameraId, mount: Option<CameraMount>) {
        self.clocks.set_moving(camera, mount.is_some());
        let mount = mount.map(|mount| self.relative_to_tracked_point(mount));
        self.mobile_cameras.set(camera, mount);
    }

    /// The mount relative to the point that the track follows; on the body that has the roundel, if there is one.
    fn relative_to_tracked_point(&self, mut mount: CameraMount) -> CameraMount {
        if let Carrier::Roundel { kind, code } = mount.carrier
            && let Some((body, object_from_roundel)) = self.bodies.find_roundel(kind, code)
        {
            mount.carrier = Carrier::Body(body);
            mount.object_from_camera = object_from_roundel * mount.object_from_camera;
            mount.covariance = rotate_covariance(&object_from_roundel.rotation, &mount.covariance);
        }
        if let Carrier::Body(body) = mount.carrier {
            mount.object_from_camera.translation.vector += self.bodies.origin_m(body);
        }
        mount
    }

    /// Sets the roundels at known positions, by which cameras localize their carriers.
    pub fn set_landmarks(&mut self, landmarks: Vec<Landmark>) {
        self.landmarks = landmarks;
    }

    /// Pose of a camera at a time.
    pub fn camera_placement(
        &mut self,
        camera: CameraId,
        time: Timestamp,
    ) -> Result<CameraPlacement, Unplaced> {
        if !self.mobile_cameras.contains(camera) {
            return self.cameras.get(&camera).copied().ok_or(Unplaced::Unknown);
        }
        let (world_from_camera, covariance) =
            self.mobile_cameras.carrier_state(camera, &mut self.tracks, time, 0.0)?.mean_pose();
        Ok(CameraPlacement { world_from_camera, covariance })
    }

    /// Lets a camera that localizes measure its carrier; returns the detections of landmarks.
    pub(super) fn localize(
        &mut self,
        frame: &FrameObservations,
        correction: StampCorrection,
        now: Timestamp,
    ) -> Vec<TrackNumber> {
        let (camera, time) = (frame.camera, correction.corrected(frame.capture_time));
        let carrier = self.carrier_state(camera, time).ok();
        let Some(mobile) =
            self.mobile_cameras.get_mut(camera).filter(|mobile| mobile.mount.localizes)
        else {
            return Vec::new();
        };
        let (mount, landmarks, params) = (mobile.mount, &self.landmarks[..], &self.params);
        let (subject, code) = match mount.carrier {
            Carrier::Roundel { kind, code } => {
                (Subject { kind: Some(kind), body: None }, Some(code))
            }
            Carrier::Body(body) => {
                (Subject { kind: self.bodies.kind(body), body: Some(body) }, None)
            }
        };
        let input = LocalizationInput {
            frame,
            correction,
            mount,
            subject,
            code,
            carrier,
            landmarks,
            params,
        };
        let found = mobile.localizer.localize(&input);
        self.counts.landmark_detections += found.landmarks.len() as u64;
        self.sightings.clear();
        self.sightings.extend(found.sighting);
        if found.sighting.is_some() {
            self.counts.localized += 1;
            self.assign(camera, None, now);
        }
        found.landmarks
    }

    fn carrier_state(
        &mut self,
        camera: CameraId,
        time: Timestamp,
    ) -> Result<CarrierState, Unplaced> {
        let clock = self.clocks.estimate(camera);
        let clock_s = clock.map_or(0.0, |clock| clock.deviation_s);
        self.mobile_cameras.carrier_state(camera, &mut self.tracks, time, clock_s)
    }

    /// Pose of the camera at the time of a frame, and the state of its carrier.
    fn exposure_pose(
        &mut self,
        camera: CameraId,
        time: Timestamp,
    ) -> Result<(ExposurePose, Option<CarrierState>), Unplaced> {
        if self.mobile_cameras.contains(camera) {
            return self
                .carrier_state(camera, time)
                .map(|carrier| (carrier.pose_at(time), Some(carrier)));
        }
        let placement = self.cameras.get(&camera).ok_or(Unplaced::Unknown)?;
        Ok((placement.into(), None))
    }

    /// Turns the frame's detections into sightings, except those of landmarks; false if the camera's pose is
    /// unknown.
    pub(super) fn collect(
        &mut self,
        frame: &FrameObservations,
        correction: StampCorrection,
        now: Timestamp,
        landmarks: &[TrackNumber],
    ) -> bool {
        let (mut camera_pose, carrier) =
            match self.exposure_pose(frame.camera, correction.corrected(frame.capture_time)) {
                Ok(pose) => pose,
                Err(reason) => {
                    self.counts.count_unplaced(reason, frame.detections.len() - landmarks.len());
                    return false;
                }
            };
        self.sightings.clear();
        self.numbers.clear();
        for detection in &frame.detections {
            if landmarks.contains(&detection.track) {
                continue;
            }
            let row_ns = detection.capture_time.ns_since(frame.capture_time);
            if row_ns.saturating_abs() > MAX_ROW_TIME_NS {
                self.counts.invalid += 1;
                continue;
            }
            if now.ns_since(correction.corrected(detection.capture_time))
                > self.params.late_window_ns
            {
                self.counts.late += 1;
                continue;
            }
            if self.numbers.contains(&detection.track) || self.bodies.has_part(detection.track) {
                self.counts.duplicate += 1;
                continue;
            }
            let frame_id = FrameId { camera: frame.camera, number: frame.frame };
            let ring = &detection.ring;
            let code = ring.code.map(|reading| reading.code);
            if let Some(carrier) = &carrier {
                camera_pose = carrier.pose_at(correction.corrected(detection.capture_time));
            }
            if self.take_part(detection, frame_id, &camera_pose, correction, now) {
                continue;
            }
            let size = self.print_sizes.get(ring.kind);
            match measure(detection, frame_id, &camera_pose, correction, size, &self.params) {
                Ok(measurement) => {
                    let subject = Subject { kind: ring.kind, body: None };
                    self.numbers.push(detection.track);
                    self.sightings.push(Sighting { subject, code, measurement });
                }
                Err(reject) => self.counts.count_reject(reject),
            }
        }
        self.join_parts(&camera_pose);
        true
    }
}
