//! From a ring in a frame to a pose, in both modes.
//!
//! A [`Locator`] holds one camera and its kinds of roundel. [`Locator::locate_all`] takes the rings
//! of a tracker, [`Locator::locate`] one of them, [`Locator::locate_single`] a ring of a single
//! image.
//!
//! Both modes start with the closed-form pose of the rims ([`super::locate`]). [`Mode::Precise`]
//! then fits the grey levels ([`super::photometry`]), for a tracked ring from the state of earlier
//! frames. When the fit rejects the ring (occlusion, washed out levels), the closed form with its
//! own covariance is returned, and [`Located::by`] is [`Mode::Fast`]. So it is with deferred fits: while a track has
//! spent more work than its allowance, which bounds the cost of a ring in any picture, and once it is late
//! ([`Locator::locate_all_until`]), for which the rings that have waited longest are fitted first.
//!
//! A camera with a rolling shutter ([`Locator::with_line_time`]) needs the time of each frame
//! ([`Locator::locate_all_at`]), so that moving rings are located at one instant
//! ([`super::shutter`]). Other cameras ignore the time.
//!
//! On a thread of a [`rayon`] pool the fits of a frame are distributed over its idle threads, with
//! identical results. The memory of tracks is bounded (`recent_tracks`); the locator needs no
//! notice when a track ends.

use std::cmp::Reverse;

use crate::{
    camera::Camera,
    frame::Frame,
    id::KindId,
    marker::{Kind, Mode, Ring, TrackedRing},
    parallel::PerThread,
    pose::{
        PoseError, RimNoise, RoundelPose, bend,
        circle::closed_form::LANES,
        locate_each, locate_printed,
        photometry::{self, FitHistory, FitInput, FitScratch},
        print_estimate::{PrintEstimate, PrintedRing},
        recent_tracks::RecentTracks,
        shutter::Shutter,
        tracked_fit::TrackedFit,
        yaw,
    },
    time::Timestamp,
};

/// A ring with its pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Located {
    /// The ring, with the rims that the pose implies.
    pub ring: Ring,
    /// Its pose.
    pub pose: RoundelPose,
    /// The mode that succeeded: [`Mode::Fast`] also where the precise fit rejected the ring.
    pub by: Mode,
    /// Whether the precise fit was left out to bound the cost.
    pub is_deferred: bool,
    /// Blur and noise, where they were fitted.
    pub image: Option<ImageQuality>,
    /// Work of the precise fit, also of one that rejected the ring ([`FitScratch::work`]).
    pub work: u64,
}

/// Blur and noise of the image at a ring.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageQuality {
    /// Standard deviation of the blur, pixels.
    pub blur_px: f64,
    /// Standard deviation of the noise and of all else that the fit does not explain, grey levels.
    pub noise: f64,
}

/// Locates the rings of one camera.
#[derive(Clone, Debug)]
pub struct Locator {
    camera: Camera,
    kinds: Vec<Kind>,
    mode: Mode,
    noise: RimNoise,
    shares: PerThread<FitScratch>,
    fits: RecentTracks<TrackedFit>,
    prints: RecentTracks<PrintEstimate>,
    /// Tracked rings of the current frame.
    pending: Vec<PendingRing>,
    /// `None` for a global shutter.
    shutter: Option<Shutter>,
}

/// A ring between the closed form and the fit.
#[derive(Clone, Debug)]
struct PendingRing {
    /// Its place in the frame.
    index: usize,
    located: Result<Located, PoseError>,
    printed: PrintedRing,
    /// State of its fits, in precise mode.
    fit: TrackedFit,
}

/// Growth of a fit's covariance where the edge of a shadow crosses the ring: near it, levels belong to neither side. From
/// rendered rings.
const SHADOW_GROWTH: f64 = 4.0;

/// Error of the outer rim by a narrow margin at which the covariance of a fit doubles, pixels; from rendered rings.
const NARROW_MARGIN_PX: f64 = 0.03;

/// Confidence of a track's code from which a frame that does not read it uses the teeth of earlier
/// frames.
const MIN_CODE_CONFIDENCE: f64 = 0.99;

impl Locator {
    /// For rings of these kinds, indexed by [`KindId`].
    pub fn new(camera: Camera, kinds: Vec<Kind>, mode: Mode) -> Self {
        let noise = RimNoise::default();
        Self {
            camera,
            kinds,
            mode,
            noise,
            shares: PerThread::default(),
            fits: RecentTracks::new(),
            prints: RecentTracks::new(),
            pending: Vec::new(),
            shutter: None,
        }
    }

    /// Sets the delay between the exposures of consecutive rows, seconds; 0 for a global shutter.
    pub fn with_line_time(self, line_time_s: f64) -> Self {
        Self { shutter: (line_time_s != 0.0).then(|| Shutter::new(line_time_s)), ..self }
    }

    /// The camera model.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// Replaces the camera model, and discards the state of all tracks.
    pub fn set_camera(&mut self, camera: Camera) {
        self.camera = camera;
        self.reset();
    }

    /// The kinds, indexed by [`KindId`].
    pub fn kinds(&self) -> &[Kind] {
        &self.kinds
    }

    /// The mode.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// Discards the state of all tracks, as after a gap in the frames.
    pub fn reset(&mut self) {
        self.fits.clear();
        self.prints.clear();
        self.shutter.iter_mut().for_each(Shutter::reset);
    }

    /// Poses of tracked rings, in their order. Equal to [`Self::locate`] for each, in a fraction of
    /// the time.
    pub fn locate_all(
        &mut self,
        frame: &Frame,
        tracked: &[TrackedRing],
        located: &mut Vec<Result<Located, PoseError>>,
    ) {
        self.locate_pending(frame, None, tracked, None);
        located.clear();
        located.extend(self.pending.drain(..).map(|one| one.located));
    }

    /// As [`Self::locate_all`] for a frame whose middle row was exposed at `time`. Each pose is
    /// that at the exposure of the row of the ring's centre ([`crate::time::row_time`]).
    pub fn locate_all_at(
        &mut self,
        frame: &Frame,
        time: Timestamp,
        tracked: &[TrackedRing],
        located: &mut Vec<Result<Located, PoseError>>,
    ) {
        self.locate_pending(frame, Some(time), tracked, None);
        located.clear();
        located.extend(self.pending.drain(..).map(|one| one.located));
    }

    /// As [`Self::locate_all_at`], but once `is_late`, which is called before each fit, further rings are not fitted.
    /// Those that have waited longest are fitted first.
    pub fn locate_all_until(
        &mut self,
        frame: &Frame,
        time: Timestamp,
        tracked: &[TrackedRing],
        located: &mut Vec<Result<Located, PoseError>>,
        is_late: &(dyn Fn() -> bool + Sync),
    ) {
        self.locate_pending(frame, Some(time), tracked, Some(is_late));
        located.clear();
        located.extend(self.pending.drain(..).map(|one| one.located));
    }

    /// Pose of one tracked ring, in the frame that it was found in.
    pub fn locate(&mut self, frame: &Frame, tracked: &TrackedRing) -> Result<Located, PoseError> {
        self.locate_pending(frame, None, std::slice::from_ref(tracked), None);
        self.pending.pop().map_or(Err(PoseError::NoCircle), |one| one.located)
    }

    /// Pose of a ring in a single image; its kind need not be one of this locator's.
    pub fn locate_single(
        &mut self,
        frame: &Frame,
        kind: &Kind,
        ring: &Ring,
    ) -> Result<Located, PoseError> {
        let Self { camera, noise, .. } = self;
        let printed = PrintEstimate::default().update(kind, ring, focal_px(camera), noise, true);
        let pose = locate_printed(camera, kind, &printed, noise)?;
        let mut located = Located::from_rims(&printed.ring, pose);
        let PrintedRing { ring, print, .. } = printed;
        let input = FitInput { frame, camera, kind, ring: &ring, print, skew: None };
        let fit = &mut TrackedFit::default();
        located.refine(&input, self.mode, false, fit, self.shares.first());
        printed.widen(&mut located.pose);
        Ok(located)
    }

    /// Fills `pending` with the poses of a frame's rings.
    fn locate_pending(
        &mut self,
        frame: &Frame,
        time: Option<Timestamp>,
        tracked: &[TrackedRing],
        is_late: Option<&(dyn Fn() -> bool + Sync)>,
    ) {
        if let Some(shutter) = &mut self.shutter {
            shutter.update(time, frame.height(), tracked, &self.kinds, &self.noise);
        }
        self.pending.clear();
        let skews = self.shutter.as_ref().map(Shutter::skews);
        let focal_px = focal_px(&self.camera);
        for (index, one) in tracked.iter().enumerate() {
            let ring = skews.map_or(one.ring, |skews| skews[index].ring(&one.ring));
            let mut printed = PrintedRing::designed(&ring);
            if let Ok(kind) = kind_of(&self.kinds, ring.kind) {
                let mut print = self.prints.get(one.track).copied().unwrap_or_default();
                let is_sharp = self.mode == Mode::Fast
                    || self.fits.get(one.track).is_some_and(TrackedFit::shows_no_motion);
                printed = print.update(kind, &ring, focal_px, &self.noise, is_sharp);
                self.prints.update(one.track, Some(print));
            }
            let located = Err(PoseError::NoCircle);
            let fit = self.fits.get(one.track).copied().unwrap_or_default();
            self.pending.push(PendingRing { index, located, printed, fit });
        }
        let mut poses = [const { Err(PoseError::NoCircle) }; LANES];
        for (tracked, pending) in tracked.chunks(LANES).zip(self.pending.chunks_mut(LANES)) {
            let rings = pending
                .iter()
                .map(|one| Ok((kind_of(&self.kinds, one.printed.ring.kind)?, &one.printed)));
            locate_each(&self.camera, rings, &self.noise, &mut poses);
            for ((one, pending), pose) in tracked.iter().zip(pending).zip(&mut poses) {
                let pose = std::mem::replace(pose, Err(PoseError::NoCircle));
                let ring = pending.printed.compensated(&one.ring);
                pending.located = pose.map(|pose| Located::from_rims(&ring, pose));
            }
        }
        self.refine_all(frame, tracked, is_late);
    }

    /// Refines the closed-form poses of the frame's rings as the mode demands.
    fn refine_all(
        &mut self,
        frame: &Frame,
        tracked: &[TrackedRing],
        is_late: Option<&(dyn Fn() -> bool + Sync)>,
    ) {
        let Self { camera, kinds, mode, shares, fits, pending, shutter, .. } = self;
        let skews = shutter.as_ref().map(Shutter::skews);
        let (camera, kinds, mode) = (&*camera, &*kinds, *mode);
        if is_late.is_some() {
            pending.sort_unstable_by_key(|one| (Reverse(one.fit.waited), one.index));
        }
        // Without a fit there is too little work to share.
        let at_a_time = if mode == Mode::Precise { 1 } else { usize::MAX };
        shares.for_each_chunk(pending, at_a_time, |scratch, _, pending| {
            for one in pending {
                let tracked = &tracked[one.index];
                let (Ok(located), Ok(kind)) = (&mut one.located, kind_of(kinds, tracked.ring.kind))
                else {
                    continue;
                };
                let skew = skews.map(|skews| skews[one.index]);
                let is_certain =
                    tracked.code.is_some_and(|code| code.confidence >= MIN_CODE_CONFIDENCE);
                if !is_certain {
                    one.fit.history = one.fit.history.map(FitHistory::without_teeth);
                }
                let (ring, print) = (located.ring, one.printed.print);
                let input = FitInput { frame, camera, kind, ring: &ring, print, skew };
                let is_late = is_late.is_some_and(|is_late| is_late());
                located.refine(&input, mode, is_late, &mut one.fit, scratch);
                one.printed.widen(&mut located.pose);
                if let Some(skew) = skew {
                    skew.widen(&mut located.pose, camera, kind);
                }
            }
        });
        if is_late.is_some() {
            pending.sort_unstable_by_key(|one| one.index);
        }
        if mode == Mode::Precise {
            for (tracked, one) in tracked.iter().zip(pending).filter(|(_, one)| one.located.is_ok())
            {
                fits.update(tracked.track, Some(one.fit));
            }
        }
    }
}

fn focal_px(camera: &Camera) -> f64 {
    let intrinsics = camera.intrinsics();
    (intrinsics.fx_px * intrinsics.fy_px).sqrt()
}

fn kind_of(kinds: &[Kind], id: Option<KindId>) -> Result<&Kind, PoseError> {
    id.and_then(|id| kinds.get(usize::from(id.0))).ok_or(PoseError::UnknownKind)
}

impl Located {
    fn from_rims(ring: &Ring, pose: RoundelPose) -> Self {
        Self { ring: *ring, pose, by: Mode::Fast, is_deferred: false, image: None, work: 0 }
    }

    /// Fits the grey levels in precise mode, except if it is late, and adds the yaw of a code.
    fn refine(
        &mut self,
        input: &FitInput,
        mode: Mode,
        is_late: bool,
        fit: &mut TrackedFit,
        scratch: &mut FitScratch,
    ) {
        let is_due = mode == Mode::Precise && fit.is_due(&input.ring.outer) && !is_late;
        self.is_deferred = mode == Mode::Precise && !is_due;
        fit.waited = if is_due { 0 } else { fit.waited.saturating_add(1) };
        if is_due {
            let before = scratch.work();
            let found = photometry::fit_tracked(input, &self.pose, fit.history.as_ref(), scratch);
            if let Ok((fitted, next)) = found {
                fit.history = Some(next);
                *self = Self {
                    ring: fitted.ring,
                    pose: fitted.pose,
                    by: Mode::Precise,
                    is_deferred: false,
                    image: Some(ImageQuality { blur_px: fitted.blur_px, noise: fitted.noise }),
                    work: 0,
                };
                if input.ring.shadow_px > 0.0 {
                    self.pose.covariance *= SHADOW_GROWTH;
                }
                self.pose.covariance *= 1.0 + (input.ring.margin_px / NARROW_MARGIN_PX).powi(2);
            }
            self.work = scratch.work() - before;
            fit.credit = fit.credit.map(|credit| credit - self.work as f64);
        }
        bend::limit_likelihood(&mut self.pose);
        // A fit of the teeth includes the yaw.
        if let Some(reading) = &input.ring.code
            && self.pose.yaw_rad.is_none()
        {
            let reading = input.skew.map_or(*reading, |skew| skew.code(reading));
            yaw::add(&mut self.pose, input.camera, &reading);
        }
    }
}

#[cfg(test)]
mod tests;
