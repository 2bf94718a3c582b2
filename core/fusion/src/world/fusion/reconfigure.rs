//! Changes of objects and parameters at run time.
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
    lifecycle::Track,
};
use roundel_vision::{
    id::{BodyId, KindId},
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
