//! What is found in one image after the other.

use std::{path::Path, time::Instant};

use anyhow::{Context, bail};
use roundel_core::{
    camera::Camera,
    frame::Frame,
    id::TrackNumber,
    marker::{Detector, Params, RejectCounts, Rejected, Ring, Scratch, TrackedRing, Tracker},
    pose::{Locator, RoundelPose},
};

use crate::{
    capture::image_file::{self, GreyImage},
    lab::print::spec::PrintSpec,
};

/// What was found in one image.
pub(super) struct ImageDetections {
    pub(super) image: GreyImage,
    pub(super) elapsed_us: f64,
    pub(super) roundels: Vec<Roundel>,
    pub(super) rejects: RejectCounts,
    /// Rejected candidates with their places, if they were asked for.
    pub(super) rejected: Vec<Rejected>,
}

/// One roundel in one image.
pub(super) struct Roundel {
    pub(super) track: Option<TrackNumber>,
    pub(super) ring: Ring,
    pub(super) pose: Option<RoundelPose>,
}

/// How images are searched.
pub(super) struct SearchOptions {
    pub(super) print: PrintSpec,
    pub(super) camera: Option<Camera>,
    pub(super) params: Params,
    /// The images are frames of one camera.
    pub(super) sequence: bool,
    /// Rejected candidates are wanted with their places.
    pub(super) explain: bool,
}

/// Searches images one after the other.
pub(super) struct ImageSearch {
    finder: ImageDetector,
    locator: Option<Locator>,
    print: PrintSpec,
}

enum ImageDetector {
    /// Each image for itself.
    Single { detector: Box<Detector>, scratch: Box<Scratch> },
    /// Frames of one camera.
    Sequence { tracker: Box<Tracker> },
}

impl ImageSearch {
    pub(super) fn new(options: SearchOptions) -> anyhow::Result<Self> {
        let SearchOptions { print, camera, params, sequence, explain } = options;
        let mode = params.mode;
        let kinds = print.kind().into_iter().collect();
        let detector =
            Detector::new(kinds, params).context("--marker")?.with_polarity_of_any(print.polarity);
        let locator = camera.map(|camera| Locator::new(camera, detector.kinds().to_vec(), mode));
        let finder = if sequence {
            let mut tracker = Box::new(Tracker::new(detector));
            tracker.explain(explain);
            ImageDetector::Sequence { tracker }
        } else {
            let mut scratch = Box::<Scratch>::default();
            scratch.explain(explain);
            ImageDetector::Single { detector: Box::new(detector), scratch }
        };
        Ok(Self { finder, locator, print })
    }

    pub(super) fn image(&mut self, path: &Path) -> anyhow::Result<ImageDetections> {
        let image = image_file::load(path)?;
        if let Some(camera) = self.locator.as_ref().map(Locator::camera)
            && (camera.width(), camera.height()) != (image.width, image.height)
        {
            bail!(
                "{}: expected an image of {} x {} pixels as the camera file says, found {} x {}",
                path.display(),
                camera.width(),
                camera.height(),
                image.width,
                image.height
            );
        }
        let frame = image.frame().with_context(|| path.display().to_string())?;
        let begun = Instant::now();
        let (mut roundels, rejects) = self.finder.find(&frame);
        if let Some(locator) = &mut self.locator {
            for roundel in &mut roundels {
                locate(locator, &self.print, &frame, roundel);
            }
        }
        let elapsed_us = begun.elapsed().as_secs_f64() * 1e6;
        let rejected = self.finder.rejected().to_vec();
        Ok(ImageDetections { image, elapsed_us, roundels, rejects, rejected })
    }
}

impl ImageDetector {
    fn find(&mut self, frame: &Frame) -> (Vec<Roundel>, RejectCounts) {
        match self {
            Self::Single { detector, scratch } => {
                let rings = detector.detect(frame, scratch).iter();
                let found = rings.map(|&ring| Roundel { track: None, ring, pose: None }).collect();
                (found, *scratch.rejects())
            }
            Self::Sequence { tracker } => {
                let rings = tracker.process(frame).iter();
                let roundel = |tracked: &TrackedRing| Roundel {
                    track: Some(tracked.track),
                    ring: tracked.ring,
                    pose: None,
                };
                (rings.map(roundel).collect(), *tracker.rejects())
            }
        }
    }

    fn rejected(&self) -> &[Rejected] {
        match self {
            Self::Single { scratch, .. } => scratch.rejected(),
            Self::Sequence { tracker } => tracker.rejected(),
        }
    }
}

/// Adds the pose, where something says the roundel's size.
fn locate(locator: &mut Locator, print: &PrintSpec, frame: &Frame, roundel: &mut Roundel) {
    let ring = roundel.ring;
    let Some(kind) = print.kind_of(&ring) else { return };
    let located = match (roundel.track, ring.kind) {
        (Some(track), Some(_)) => locator.locate(frame, &TrackedRing { track, ring, code: None }),
        _ => locator.locate_single(frame, &kind, &ring),
    };
    if let Ok(located) = located {
        roundel.ring = located.ring;
        roundel.pose = Some(located.pose);
    }
}
