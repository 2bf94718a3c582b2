//! Objects with several roundels at known places, or with one of known code.
//!
//! The kind of a detection, if it is a plain kind of one object, or its code decides which roundel of which object it
//! shows. A camera's tracker keeps its number while it follows a roundel, so a vote over the readings identifies it
//! where the code is unreadable or misread once. `joint_measurement` makes one measurement from all parts in a frame. A
//! body without roundels is observed only through its own camera (`mobile_camera`).
//!
//! A body is filtered at the centroid of its roundels, where errors of position and orientation are least correlated,
//! and reported at its origin.

pub(super) mod joint_measurement;

use std::collections::BTreeMap;

use nalgebra::Vector3;
use thiserror::Error;

use super::{FusionParams, MotionClass, identity::CodeVote};
use crate::track::{Measurement, MotionModel};
use roundel_vision::{
    id::{BodyId, CameraId, KindId, TrackNumber},
    marker::Code,
    pose::Detection,
    rigid::Rigid,
    time::Timestamp,
};

/// A roundel on an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mount {
    /// Kind of the roundel.
    pub kind: KindId,
    /// Code of the roundel; `None` if it is the only one of its kind.
    pub code: Option<Code>,
    /// Pose of the roundel on the object.
    pub object_from_roundel: Rigid,
}

/// An object and its roundels. Its frame is the caller's choice; z should point up where that has a meaning.
#[derive(Clone, Debug, PartialEq)]
pub struct Body {
    /// How it moves; heights are those of its origin.
    pub motion: MotionClass,
    /// Its roundels. Without any, only a camera on it that localizes determines its pose.
    pub mounts: Vec<Mount>,
}

/// Reason why a body is rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum BodyError {
    /// A number is not finite.
    #[error(
        "expected finite poses of roundels on the object, found one that is not at roundel {mount}"
    )]
    NotFinite {
        /// Index of the roundel.
        mount: usize,
    },
    /// The roundel belongs to another object, or occurs twice.
    #[error(
        "roundel {mount} of the object belongs to another object already, or its whole kind does"
    )]
    Taken {
        /// Index of the roundel.
        mount: usize,
    },
}

/// One roundel of one body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct MountRef {
    pub(super) body: BodyId,
    mount: usize,
}

/// Code readings of one of a camera's tracks.
#[derive(Clone, Copy, Debug)]
struct CodeReadings {
    vote: CodeVote,
    newest: Timestamp,
}

/// Measurement of a body's roundel in a frame, with an exact camera pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct PartMeasurement {
    part: MountRef,
    /// With the body's origin at the centroid of its roundels.
    pub(super) body_from_roundel: Rigid,
    pub(super) measurement: Measurement,
}

/// All bodies, the cameras' code readings of their roundels, and the parts in the current frame.
#[derive(Clone, Debug, Default)]
pub(super) struct Bodies {
    bodies: Vec<Body>,
    /// Centroids of their roundels, object frame.
    centroids_m: Vec<Vector3<f64>>,
    by_roundel: BTreeMap<(KindId, Option<Code>), MountRef>,
    readings: BTreeMap<(CameraId, TrackNumber), CodeReadings>,
    parts: Vec<PartMeasurement>,
}

impl Bodies {
    pub(super) fn add(&mut self, body: Body) -> Result<BodyId, BodyError> {
        let id = BodyId(self.bodies.len() as u32);
        self.replace(&[(id, body)])?;
        Ok(id)
    }

    /// Replaces bodies, or adds new ones, all at once, so that they may exchange roundels. Changes nothing on
    /// error.
    pub(super) fn replace(&mut self, changed: &[(BodyId, Body)]) -> Result<(), BodyError> {
        let mut by_roundel = self.by_roundel.clone();
        by_roundel.retain(|_, part| changed.iter().all(|(id, _)| *id != part.body));
        for (id, body) in changed {
            let claims = checked_claims(*id, body, &by_roundel)?;
            by_roundel.extend(claims);
        }
        self.by_roundel = by_roundel;
        for (id, body) in changed {
            let index = id.0 as usize;
            if index >= self.bodies.len() {
                let nothing = Body { motion: MotionClass::default(), mounts: Vec::new() };
                self.bodies.resize(index + 1, nothing);
                self.centroids_m.resize(index + 1, Vector3::zeros());
            }
            let places = body.mounts.iter().map(|it| it.object_from_roundel.translation.vector);
            let count = body.mounts.len().max(1) as f64;
            self.centroids_m[index] = places.sum::<Vector3<f64>>() / count;
            self.bodies[index].clone_from(body);
        }
        Ok(())
    }

    /// The body with its origin at the centroid of its roundels.
    pub(super) fn centred(&self, body: BodyId) -> Option<Body> {
        let (mut centred, centroid_m) =
            (self.bodies.get(body.0 as usize)?.clone(), self.centroids_m[body.0 as usize]);
        for mount in &mut centred.mounts {
            mount.object_from_roundel.translation.vector -= centroid_m;
        }
        centred.motion = centred.motion.raised(centroid_m.z);
        Some(centred)
    }

    /// Notes the code of a roundel that cameras already track under these numbers.
    pub(super) fn set_readings(
        &mut self,
        code: Code,
        views: impl Iterator<Item = (CameraId, TrackNumber, Timestamp)>,
    ) {
        for (camera, number, newest) in views {
            let mut vote = CodeVote::default();
            vote.set(code);
            self.readings.insert((camera, number), CodeReadings { vote, newest });
        }
    }

    /// A camera's number of the roundel with this code.
    pub(super) fn number_at(&self, camera: CameraId, code: Code) -> Option<TrackNumber> {
        let of_camera =
            self.readings.range((camera, TrackNumber(0))..=(camera, TrackNumber(u64::MAX)));
        let reads = of_camera.filter(|(_, reading)| reading.vote.leader() == Some(code));
        reads.max_by_key(|(_, reading)| reading.newest).map(|((_, number), _)| *number)
    }

    /// Origin of the body from the centroid of its roundels.
    pub(super) fn origin_m(&self, body: BodyId) -> Vector3<f64> {
        -self.centroids_m[body.0 as usize]
    }

    /// Kind under which it is reported: that of its first roundel.
    pub(super) fn kind(&self, body: BodyId) -> Option<KindId> {
        self.bodies[body.0 as usize].mounts.first().map(|mount| mount.kind)
    }

    /// The body with this roundel, and the roundel's pose on it.
    pub(super) fn find_roundel(&self, kind: KindId, code: Code) -> Option<(BodyId, Rigid)> {
        let part = self.by_roundel.get(&(kind, Some(code)))?;
        let mount = &self.bodies[part.body.0 as usize].mounts[part.mount];
        Some((part.body, mount.object_from_roundel))
    }

    /// Code of a body with a single roundel.
    pub(super) fn code(&self, body: BodyId) -> Option<Code> {
        let [only] = &self.bodies[body.0 as usize].mounts[..] else { return None };
        only.code
    }

    /// Motion of the origin.
    pub(super) fn motion(&self, body: BodyId) -> MotionClass {
        self.bodies[body.0 as usize].motion
    }

    /// Motion model of the centroid.
    pub(super) fn model(&self, body: BodyId, params: &FusionParams) -> MotionModel {
        let class = self.motion(body).raised(self.centroids_m[body.0 as usize].z);
        MotionModel { learns_rotation_density: false, ..params.motion_model(&class) }
    }

    /// The roundel that a camera's detection shows, and whether this camera's track was not known as that before.
    pub(super) fn part_of(
        &mut self,
        detection: &Detection,
        camera: CameraId,
        now: Timestamp,
    ) -> Option<(MountRef, bool)> {
        let kind = detection.ring.kind.filter(|_| !self.bodies.is_empty())?;
        let (&(first, code), &part) = self.by_roundel.range((kind, None)..).next()?;
        if first != kind || code.is_none() {
            return (first == kind).then_some((part, false));
        }
        let unread = CodeReadings { vote: CodeVote::default(), newest: now };
        let reading = self.readings.entry((camera, detection.track)).or_insert(unread);
        reading.newest = now;
        let part = |reading: &CodeReadings| {
            let code = reading.vote.leader();
            code.and_then(|code| self.by_roundel.get(&(kind, Some(code))).copied())
        };
        let before = part(reading);
        if let Some(read) = detection.ring.code {
            reading.vote.add(read.code);
        }
        part(reading).map(|part| (part, before != Some(part)))
    }

    /// Discards readings from before `since`.
    pub(super) fn forget(&mut self, since: Timestamp) {
        self.readings.retain(|_, reading| reading.newest >= since);
    }

    /// Adds a part of the current frame.
    pub(super) fn add_part(&mut self, part: MountRef, measurement: Measurement) {
        let body = part.body.0 as usize;
        let mut body_from_roundel = self.bodies[body].mounts[part.mount].object_from_roundel;
        body_from_roundel.translation.vector -= self.centroids_m[body];
        self.parts.push(PartMeasurement { part, body_from_roundel, measurement });
    }

    /// Whether the current frame has a part with this number.
    pub(super) fn has_part(&self, number: TrackNumber) -> bool {
        self.parts.iter().any(|part| part.measurement.number == number)
    }

    /// Takes the parts of the current frame, ordered by body.
    pub(super) fn take_parts(&mut self) -> Vec<PartMeasurement> {
        let mut parts = std::mem::take(&mut self.parts);
        parts.sort_by_key(|part| (part.part, part.measurement.number));
        parts
    }
}

impl PartMeasurement {
    pub(super) fn body(&self) -> BodyId {
        self.part.body
    }
}

/// A roundel and where it is mounted.
type Claim = ((KindId, Option<Code>), MountRef);

/// The roundels of a body, unless another body has one of them.
fn checked_claims(
    id: BodyId,
    body: &Body,
    taken: &BTreeMap<(KindId, Option<Code>), MountRef>,
) -> Result<Vec<Claim>, BodyError> {
    let mut claims = Vec::new();
    for (mount, it) in body.mounts.iter().enumerate() {
        if !it.object_from_roundel.to_homogeneous().iter().all(|number| number.is_finite()) {
            return Err(BodyError::NotFinite { mount });
        }
        let others = taken.keys().copied();
        let overlaps = |(kind, code): (KindId, Option<Code>)| {
            kind == it.kind && (code == it.code || code.is_none() || it.code.is_none())
        };
        if others.chain(claims.iter().map(|(claim, _)| *claim)).any(overlaps) {
            return Err(BodyError::Taken { mount });
        }
        claims.push(((it.kind, it.code), MountRef { body: id, mount }));
    }
    Ok(claims)
}
