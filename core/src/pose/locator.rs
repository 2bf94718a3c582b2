//! The one way from a ring in a frame to a pose, for both modes.
//!
//! A [`Locator`] knows one camera and its kinds of roundel. [`Locator::locate`] takes the rings that a
//! tracker follows, [`Locator::locate_single`] a ring of a picture that stands alone.
//!
//! Both modes begin with the rims' pose in closed form. [`Mode::Precise`] fits the grey levels from
//! there (`photometry`); of a followed ring it starts from the blur of the frame before, and from that
//! of the two normals which was right there. Where the fit refuses the ring (a cover, white and black
//! washed out), the closed form stands, with its own covariance, and [`Located::by`] says so.
//!
//! Memory of tracks is bounded without being told of their end: a ring that was none of the last
//! [`REMEMBERED`] to be located is forgotten.

use nalgebra::Vector3;

use super::{
    PoseError, RimNoise, RoundelPose, locate,
    photometry::{self, DEFAULT_BLUR_PX, FitScratch, Start},
    yaw,
};
use crate::{
    camera::Camera,
    frame::Frame,
    id::{KindId, TrackNumber},
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
    /// Deviation of the blur, pixels, and of the noise, grey levels, where they were fitted.
    pub image: Option<ImageQuality>,
}

/// What a fit says of the picture itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageQuality {
    /// Deviation of the blur, pixels.
    pub blur_px: f64,
    /// Deviation of the noise, and of whatever else the fit does not explain, grey levels.
    pub noise: f64,
}

/// Locates the rings of one camera.
#[derive(Clone, Debug)]
pub struct Locator {
    camera: Camera,
    kinds: Vec<Kind>,
    mode: Mode,
    noise: RimNoise,
    scratch: FitScratch,
    /// By the tracks' numbers.
    warm: Vec<Warm>,
    /// Rings located so far.
    calls: u64,
}

/// So many rings, at least, are remembered; twice as many at most.
const REMEMBERED: usize = 1024;

/// What is kept of a track.
#[derive(Clone, Copy, Debug)]
struct Warm {
    track: TrackNumber,
    /// The call that located it last.
    call: u64,
    normal: Vector3<f64>,
    blur_px: f64,
}

impl Locator {
    /// For rings of these kinds, in the order that [`KindId`] counts them.
    pub fn new(camera: Camera, kinds: Vec<Kind>, mode: Mode) -> Self {
        let noise = RimNoise::default();
        let scratch = FitScratch::default();
        let warm = Vec::with_capacity(2 * REMEMBERED);
        Self { camera, kinds, mode, noise, scratch, warm, calls: 0 }
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

    /// Forgets all tracks, as after a gap in the frames.
    pub fn reset(&mut self) {
        self.warm.clear();
    }

    /// The pose of a ring that a tracker follows, in the frame that it was found in.
    pub fn locate(&mut self, frame: &Frame, tracked: &TrackedRing) -> Result<Located, PoseError> {
        let kind = kind_of(&self.kinds, tracked.ring.kind)?;
        self.calls += 1;
        let place = self.warm.binary_search_by_key(&tracked.track, |warm| warm.track);
        let before = place.ok().map(|index| self.warm[index]);
        let located = locate_from(
            (&self.camera, kind, &self.noise, self.mode),
            frame,
            &tracked.ring,
            before,
            &mut self.scratch,
        )?;
        if let Some(image) = located.image {
            let warm = Warm {
                track: tracked.track,
                call: self.calls,
                normal: located.pose.normal,
                blur_px: image.blur_px,
            };
            match place {
                Ok(index) => self.warm[index] = warm,
                Err(index) => self.remember(index, warm),
            }
        }
        Ok(located)
    }

    /// The pose of a ring of a picture that stands alone, of a kind that need not be one of this
    /// locator's.
    pub fn locate_single(
        &mut self,
        frame: &Frame,
        kind: &Kind,
        ring: &Ring,
    ) -> Result<Located, PoseError> {
        let with = (&self.camera, kind, &self.noise, self.mode);
        locate_from(with, frame, ring, None, &mut self.scratch)
    }

    /// Keeps a new track, at its place in the order of numbers, and never more than there is room for:
    /// each call remembers one, so that the last [`REMEMBERED`] calls' are no more than that.
    fn remember(&mut self, index: usize, warm: Warm) {
        self.warm.insert(index, warm);
        if self.warm.len() >= 2 * REMEMBERED {
            let oldest = self.calls.saturating_sub(REMEMBERED as u64);
            self.warm.retain(|warm| warm.call > oldest);
        }
    }
}

fn kind_of(kinds: &[Kind], id: Option<KindId>) -> Result<&Kind, PoseError> {
    id.and_then(|id| kinds.get(usize::from(id.0))).ok_or(PoseError::UnknownKind)
}

fn locate_from(
    (camera, kind, noise, mode): (&Camera, &Kind, &RimNoise, Mode),
    frame: &Frame,
    ring: &Ring,
    before: Option<Warm>,
    scratch: &mut FitScratch,
) -> Result<Located, PoseError> {
    let pose = locate(camera, kind, ring, noise)?;
    let mut located = match mode {
        Mode::Fast => None,
        Mode::Precise => {
            let start = start(&pose, before);
            photometry::fit(frame, camera, kind, ring, &start, scratch).ok().map(|fit| Located {
                ring: fit.ring,
                pose: fit.pose,
                by: Mode::Precise,
                image: Some(ImageQuality { blur_px: fit.blur_px, noise: fit.noise }),
            })
        }
    }
    .unwrap_or(Located { ring: *ring, pose, by: Mode::Fast, image: None });
    if let Some(reading) = &ring.code {
        yaw::add(&mut located.pose, camera, reading);
    }
    Ok(located)
}

/// Where a fit starts: of the rims' normals, from the one that the frame before says.
fn start(pose: &RoundelPose, before: Option<Warm>) -> Start {
    let Some(before) = before else {
        return Start { pose: pose.clone(), blur_px: DEFAULT_BLUR_PX };
    };
    let mut pose = pose.clone();
    if pose.other_normal.dot(&before.normal) > pose.normal.dot(&before.normal) {
        pose.yaw_rad = pose.other_yaw_rad();
        std::mem::swap(&mut pose.normal, &mut pose.other_normal);
    }
    Start { pose, blur_px: before.blur_px }
}
