//! The one way from a ring in a frame to a pose, for both modes.
//!
//! A [`Locator`] knows one camera and its kinds of roundel. [`Locator::locate`] takes the rings that a
//! tracker follows, [`Locator::locate_single`] a ring of a picture that stands alone.

use super::{PoseError, RimNoise, RoundelPose, locate};
use crate::{
    camera::Camera,
    frame::Frame,
    id::KindId,
    marker::{Kind, Mode, Ring, TrackedRing},
};

/// A ring with its pose, and how it was found.
#[derive(Clone, Debug, PartialEq)]
pub struct Located {
    /// The ring, with its rims as the pose has them.
    pub ring: Ring,
    /// Where it is.
    pub pose: RoundelPose,
    /// How it was located: [`Mode::Fast`] also where the precise way refused the ring.
    pub by: Mode,
}

/// Locates the rings of one camera.
#[derive(Clone, Debug)]
pub struct Locator {
    camera: Camera,
    kinds: Vec<Kind>,
    mode: Mode,
    noise: RimNoise,
}

impl Locator {
    /// For rings of these kinds, in the order that [`KindId`] counts them.
    pub fn new(camera: Camera, kinds: Vec<Kind>, mode: Mode) -> Self {
        Self { camera, kinds, mode, noise: RimNoise::default() }
    }

    /// The camera's model.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The kinds.
    pub fn kinds(&self) -> &[Kind] {
        &self.kinds
    }

    /// What is worth more.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// The pose of a ring that a tracker follows, in the frame that it was found in.
    pub fn locate(&mut self, frame: &Frame, tracked: &TrackedRing) -> Result<Located, PoseError> {
        let kind = kind_of(&self.kinds, tracked.ring.kind)?;
        self.single(frame, kind, &tracked.ring)
    }

    /// The pose of a ring of a picture that stands alone, of a kind that need not be one of this
    /// locator's.
    pub fn locate_single(
        &mut self,
        frame: &Frame,
        kind: &Kind,
        ring: &Ring,
    ) -> Result<Located, PoseError> {
        self.single(frame, kind, ring)
    }

    fn single(&self, _frame: &Frame, kind: &Kind, ring: &Ring) -> Result<Located, PoseError> {
        let pose = locate(&self.camera, kind, ring, &self.noise)?;
        Ok(Located { ring: *ring, pose, by: Mode::Fast })
    }
}

fn kind_of(kinds: &[Kind], id: Option<KindId>) -> Result<&Kind, PoseError> {
    id.and_then(|id| kinds.get(usize::from(id.0))).ok_or(PoseError::UnknownKind)
}
