//! Changes of objects, cameras and parameters at run time.
//!
//! A track follows the centroid of its object's roundels. It continues if neither its roundels around the centroid nor
//! its motion class change: only the name or the tracked point of the object does. An object with a single coded
//! roundel has one track whether it is a body or not, so it continues when it becomes a body and when it ceases to be
//! one. All other tracks of a changed object end. The object that starts in its place keeps the id, as far as a body or
//! code identifies it.

use nalgebra::Vector3;

use super::{Fusion, FusionParams, MotionClass};
use crate::world::{
    Body, BodyError, Carrier, Mount,
    body::Bodies,
    identity::{CodeVote, Mark, Subject, body_number},
    lifecycle::{DEFAULT_TRUST, Track},
};
use roundel_vision::{
    id::{BodyId, CameraId, KindId},
    marker::Code,
};

/// A roundel that its kind and code identify.
#[derive(Clone, Copy)]
struct CodedRoundel {
    kind: KindId,
    code: Code,
}

impl CodedRoundel {
    fn mark(self) -> (Option<KindId>, Mark) {
        (Some(self.kind), Mark::Code(self.code))
    }
}

/// The roundel of a body that is a single coded roundel with the same orientation.
fn single_roundel(body: Option<&Body>) -> Option<CodedRoundel> {
    let Body { mounts, .. } = body?;
    let [Mount { kind, code: Some(code), object_from_roundel }] = mounts[..] else { return None };
    (object_from_roundel.rotation.angle() < 1e-9).then_some(CodedRoundel { kind, code })
}

impl Fusion {
    /// Replaces bodies, or adds new ones, all at once, so that they may exchange roundels. A body without
    /// roundels is observed only by its own camera. Tracks of all other objects continue. Changes nothing on
    /// error.
    pub fn set_bodies(&mut self, changed: &[(BodyId, Body)]) -> Result<(), BodyError> {
        let before = self.bodies.clone();
        self.bodies.replace(changed)?;
        for &(id, _) in changed {
            self.replace_body(id, &before);
        }
        let mut mounts: Vec<_> = self.mobile_cameras.mounts_mut().collect();
        for mount in &mut mounts {
            let Carrier::Body(body) = mount.carrier else { continue };
            if changed.iter().any(|(id, _)| *id == body) {
                let existed = before.centred(body).is_some();
                let origin_m = if existed { before.origin_m(body) } else { Vector3::zeros() };
                let moved_m = self.bodies.origin_m(body) - origin_m;
                mount.object_from_camera.translation.vector += moved_m;
            }
        }
        Ok(())
    }

    /// Changes how a kind's objects move. If the class differs, their tracks start again.
    pub fn change_motion(&mut self, kind: KindId, class: MotionClass) {
        let before = self.classes.insert(kind, class).unwrap_or_default();
        if before != class {
            let subject = Subject { kind: Some(kind), body: None };
            self.height_checks.forget(&subject);
            self.end_all(&subject);
        }
    }

    /// Changes the parameters. Those of motion apply to tracks that start from now on.
    pub fn set_params(&mut self, params: FusionParams) {
        self.params = params;
    }

    /// Current parameters.
    pub fn params(&self) -> FusionParams {
        self.params
    }

    /// Forgets a camera. Tracks keep its measurements until they leave the window. Later frames count as those of
    /// a new camera.
    pub fn remove_camera(&mut self, camera: CameraId) {
        self.set_camera(camera, None);
        self.set_mount(camera, None);
        self.set_hold_back_exempt(camera, false);
        self.set_trust(camera, DEFAULT_TRUST);
        self.forget_source(camera);
    }

    /// Notes that a camera's frames have a new source: forgets its stamps, numbers and clock, which is exact
    /// until [`Self::set_clock`]. Its pose is kept.
    pub fn forget_source(&mut self, camera: CameraId) {
        self.clocks.remove(camera);
        self.stamp_corrector.forget(camera);
        self.missing_frames.forget(camera);
        self.timeline.forget(camera);
    }

    fn replace_body(&mut self, id: BodyId, before: &Bodies) {
        let (old, new) = (before.centred(id), self.bodies.centred(id));
        let subject = Subject { kind: old.as_ref().and_then(|_| before.kind(id)), body: Some(id) };
        self.height_checks.forget(&subject);
        if old == new {
            return;
        }
        let (old_single, new_single) = (single_roundel(old.as_ref()), single_roundel(new.as_ref()));
        let mark = (subject.kind, Mark::Body(id));
        match old_single.filter(|_| new.as_ref().is_some_and(|new| new.mounts.is_empty())) {
            Some(roundel) => {
                let (kind, code_mark) = roundel.mark();
                self.id_registry.remove(kind, code_mark);
                self.id_registry.alias(mark, roundel.mark());
                self.id_registry.remove(mark.0, mark.1);
                let motion = old.map(|old| old.motion).unwrap_or_default();
                self.follow_as_code(id, roundel, motion);
            }
            None => {
                let kind = self.bodies.kind(id);
                self.id_registry.alias(mark, (kind, Mark::Body(id)));
                if let Some(roundel) = new_single {
                    self.id_registry.alias(roundel.mark(), (Some(roundel.kind), Mark::Body(id)));
                }
            }
        }
        self.end_all(&subject);
        if let Some(roundel) = new_single {
            self.follow_as_body(id, roundel, new.map(|new| new.motion).unwrap_or_default());
        }
    }

    /// Continues the track of a code as that of the body with this roundel.
    fn follow_as_body(&mut self, id: BodyId, roundel: CodedRoundel, motion: MotionClass) {
        let CodedRoundel { kind, code } = roundel;
        let subject = Subject { kind: Some(kind), body: None };
        let class = self.classes.get(&kind).copied().unwrap_or_default();
        let is_followed =
            |track: &&mut Track| track.subject == subject && track.codes.settled() == Some(code);
        let Some(track) =
            self.tracks.iter_mut().filter(is_followed).max_by_key(|track| track.newest)
        else {
            return;
        };
        let views = track.views.iter().map(|view| (view.camera, view.number, view.time));
        self.bodies.set_readings(code, views);
        if motion != class {
            let track = track.id;
            return self.end_where(|it| it.id == track);
        }
        track.subject.body = Some(id);
        track.model = self.bodies.model(id, &self.params);
        track.claimed_mark = None;
        track.views.iter_mut().for_each(|view| view.number = body_number(id));
        track.refresh();
    }

    /// Continues the track of a body as that of its code.
    fn follow_as_code(&mut self, id: BodyId, roundel: CodedRoundel, motion: MotionClass) {
        let CodedRoundel { kind, code } = roundel;
        let subject = Subject { kind: Some(kind), body: Some(id) };
        let class = self.classes.get(&kind).copied().unwrap_or_default();
        if motion != class || self.bodies.find_roundel(kind, code).is_some() {
            return;
        }
        let Some(track) = self.tracks.iter_mut().find(|track| track.subject == subject) else {
            return;
        };
        track.subject.body = None;
        track.model = self.params.motion_model(&class);
        track.codes = CodeVote::default();
        track.codes.set(code);
        track.claimed_mark = None;
        let bodies = &self.bodies;
        track.views.retain_mut(|view| {
            let number = bodies.number_at(view.camera, code);
            if let Some(number) = number {
                view.number = number;
            }
            number.is_some()
        });
        track.refresh();
    }

    fn end_all(&mut self, subject: &Subject) {
        self.end_where(|track| track.subject == *subject);
    }

    fn end_where(&mut self, ends: impl Fn(&Track) -> bool) {
        while let Some(index) = self.tracks.iter().position(&ends) {
            let ended = self.tracks.remove(index);
            let newest = ended.newest;
            self.end(ended, newest);
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::world::{CameraPlacement, ClockPrior, FrameObservations, Fusion, FusionParams};
    use roundel_vision::{
        id::CameraId,
        rigid::{Covariance6, Rigid},
        time::Timestamp,
    };

    fn frame(camera: u32, number: u64, capture: Timestamp) -> FrameObservations {
        FrameObservations {
            camera: CameraId(camera),
            frame: number,
            capture_time: capture,
            received_time: capture,
            calibration_version: 0,
            detections: Vec::new(),
        }
    }

    fn placement() -> CameraPlacement {
        let (world_from_camera, covariance) = (Rigid::identity(), Covariance6::zeros());
        CameraPlacement { world_from_camera, covariance }
    }

    #[test]
    fn a_removed_camera_is_forgotten_and_the_others_continue() {
        let mut fusion = Fusion::new(FusionParams::default());
        for (camera, offset_s) in [(0, 0.001), (1, 0.02), (2, 0.003)] {
            fusion.set_camera(CameraId(camera), Some(placement()));
            fusion.set_clock(CameraId(camera), ClockPrior { offset_s, skew: 1e-5 });
        }
        let start = Timestamp::from_ns(1_700_000_000_000_000_000);
        for number in 1..50_u32 {
            let capture = start.plus_seconds(0.033 * f64::from(number));
            (0..3).for_each(|camera| {
                fusion.observe(&frame(camera, number.into(), capture.plus_ns(camera.into())));
            });
        }
        let before = [0, 2].map(|camera| fusion.clock(CameraId(camera)).unwrap());
        fusion.remove_camera(CameraId(1));
        assert_eq!(fusion.clock(CameraId(1)), None);
        assert!(fusion.camera_placement(CameraId(1), start).is_err());
        let after = [0, 2].map(|camera| fusion.clock(CameraId(camera)).unwrap());
        // Differences of offsets determine the deviations that remain.
        assert_eq!(before.map(|it| it.offset_s), after.map(|it| it.offset_s));
        assert!(after[0].deviation_s < before[0].deviation_s + 0.02, "{before:?} {after:?}");
        let counts = fusion.counts();
        for number in 50..60_u32 {
            let capture = start.plus_seconds(0.033 * f64::from(number));
            for camera in [0, 2] {
                fusion.observe(&frame(camera, number.into(), capture.plus_ns(camera.into())));
            }
        }
        assert_eq!(fusion.counts().frames, counts.frames + 20);
        assert_eq!(
            fusion.counts().missing_frames,
            counts.missing_frames,
            "its frames are not expected"
        );
    }

    #[test]
    fn a_new_source_causes_no_duplicates_and_no_clock_step() {
        let mut fusion = Fusion::new(FusionParams::default());
        let start = Timestamp::from_ns(1_700_000_000_000_000_000);
        for number in 1..20_u32 {
            fusion.observe(&frame(0, number.into(), start.plus_seconds(0.033 * f64::from(number))));
        }
        fusion.forget_source(CameraId(0));
        // Numbered from 1 again, with stamps of another epoch.
        for number in 1..20_u32 {
            let received = start.plus_seconds(0.7 + 0.033 * f64::from(number));
            let stamped = received.plus_seconds(-0.04);
            fusion.observe(&FrameObservations {
                received_time: received,
                ..frame(0, number.into(), stamped)
            });
        }
        let counts = fusion.counts();
        assert_eq!((counts.duplicate_frames, counts.clock_steps, counts.missing_frames), (0, 0, 0));
        assert_eq!(counts.frames, 38);
    }
}
