//! Searches images one after the other.

use std::{path::Path, time::Instant};

use anyhow::{Context, bail};
use roundel_core::{
    frame::Frame,
    id::TrackNumber,
    marker::{Detector, Params, RejectCounts, Rejected, Ring, Scratch, TrackedRing, Tracker},
    pose::{Locator, RoundelPose},
};

use super::DetectArgs;
use crate::{
    capture::image_file::{self, Expectation, GreyImage, UNSCALED_HINT},
    lab::print::spec::PrintSpec,
    model::camera_file,
};

pub(super) struct ImageDetections {
    pub(super) image: GreyImage,
    pub(super) elapsed_us: f64,
    pub(super) roundels: Vec<Roundel>,
    pub(super) rejects: RejectCounts,
    /// Rejected candidates with their places; empty without `--explain`.
    pub(super) rejected: Vec<Rejected>,
}

pub(super) struct Roundel {
    pub(super) track: Option<TrackNumber>,
    pub(super) ring: Ring,
    pub(super) pose: Option<RoundelPose>,
}

pub(super) struct ImageSearch {
    finder: Finder,
    locator: Option<Locator>,
    print: PrintSpec,
    /// Kept from image to image in a sequence.
    expected: Expectation,
}

enum Finder {
    /// Searches each image independently.
    Single(Box<(Detector, Scratch)>),
    /// Follows tracks through the frames of one camera.
    Sequence(Box<Tracker>),
}

impl ImageSearch {
    pub(super) fn new(arguments: &DetectArgs) -> anyhow::Result<Self> {
        let DetectArgs { marker, code, polarity, mode, .. } = *arguments;
        if marker.is_some_and(|diameters| diameters.minor_m.is_some()) && code.is_some() {
            bail!("--marker with an elliptical disc and --code exclude each other");
        }
        let print = PrintSpec { diameters: marker, code, polarity: polarity.into() };
        let camera = arguments.camera.as_deref().map(camera_file::load).transpose()?;
        let params = Params { mode, ..Params::default() };
        let detector = Detector::new(print.kind().into_iter().collect(), params)
            .context("--marker")?
            .with_default_polarity(print.polarity);
        let locator = camera.map(|camera| Locator::new(camera, detector.kinds().to_vec(), mode));
        let finder = if arguments.sequence {
            let mut tracker = Tracker::new(detector);
            tracker.explain(arguments.explain);
            Finder::Sequence(Box::new(tracker))
        } else {
            let mut scratch = Scratch::default();
            scratch.explain(arguments.explain);
            Finder::Single(Box::new((detector, scratch)))
        };
        Ok(Self { finder, locator, print, expected: Expectation::default() })
    }

    pub(super) fn image(&mut self, path: &Path) -> anyhow::Result<ImageDetections> {
        if matches!(self.finder, Finder::Single(_)) {
            self.expected = Expectation::default();
        }
        let bits = self.expected.depth.unscaled_bits();
        let image = image_file::load_expected(path, &mut self.expected)?;
        let now = self.expected.depth.unscaled_bits();
        if let Some(bits) = now.filter(|_| now != bits) {
            eprintln!("{}: {bits} bits: {UNSCALED_HINT}", path.display());
        }
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
        let (mut roundels, rejects, rejected) = self.finder.find(&frame);
        if let Some(locator) = &mut self.locator {
            for roundel in &mut roundels {
                locate(locator, &self.print, &frame, roundel);
            }
        }
        let elapsed_us = begun.elapsed().as_secs_f64() * 1e6;
        Ok(ImageDetections { image, elapsed_us, roundels, rejects, rejected })
    }
}

impl Finder {
    fn find(&mut self, frame: &Frame) -> (Vec<Roundel>, RejectCounts, Vec<Rejected>) {
        let roundel = |track, ring| Roundel { track, ring, pose: None };
        match self {
            Self::Single(search) => {
                let (detector, scratch) = &mut **search;
                let rings = detector.detect(frame, scratch).iter();
                let found = rings.map(|ring| roundel(None, *ring)).collect();
                (found, *scratch.rejects(), scratch.rejected().to_vec())
            }
            Self::Sequence(tracker) => {
                let rings = tracker.process(frame).iter();
                let found = rings.map(|it| roundel(Some(it.track), it.ring)).collect();
                (found, *tracker.rejects(), tracker.rejected().to_vec())
            }
        }
    }
}

/// Adds the pose where the roundel's size is known.
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
