//! Pixels → detections with poses and times: what a worker does with each frame.

use std::time::{Duration, Instant};

use roundel_core::{
    camera::Camera,
    frame::{Frame, FrameError},
    id::CameraId,
    marker::{Detector, DetectorError, Kind, Mask, Mode, Params, Tracker},
    pose::{Detection, Locator},
    time::{Timestamp, row_time},
    world::FrameObservations,
};

use crate::{hub::DetectionCounts, source::FrameInfo};

/// Calibrations do not change while this version of the server runs: all are the first.
pub const CALIBRATION_VERSION: u64 = 1;

/// What a pipeline is made of.
#[derive(Clone, Debug)]
pub struct PipelineParts {
    /// The roundels looked for.
    pub kinds: Vec<Kind>,
    /// How they are looked for; with the mode, how they are located too.
    pub params: Params,
    /// Where they are not looked for.
    pub mask: Mask,
    /// The camera's model.
    pub camera: Camera,
    /// Time between the exposures of two image rows.
    pub line_time_s: f64,
}

/// How long a frame took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StageTimes {
    /// Following and searching.
    pub find_ms: f64,
    /// Locating what was found.
    pub locate_ms: f64,
}

/// Follows the roundels of one camera and locates them.
pub struct Pipeline {
    tracker: Tracker,
    locator: Locator,
    line_time_s: f64,
    counts: DetectionCounts,
    times: StageTimes,
}

impl Pipeline {
    /// A pipeline that has not seen a frame.
    pub fn new(parts: PipelineParts) -> Result<Self, DetectorError> {
        let PipelineParts { kinds, params, mask, camera, line_time_s } = parts;
        let locator = Locator::new(camera, kinds.clone(), params.mode);
        let tracker = Tracker::new(Detector::new(kinds, params)?.with_mask(mask));
        let (counts, times) = (DetectionCounts::default(), StageTimes::default());
        Ok(Self { tracker, locator, line_time_s, counts, times })
    }

    /// What became of all rings and candidates so far.
    pub fn counts(&self) -> &DetectionCounts {
        &self.counts
    }

    /// How long the newest frame took.
    pub fn times(&self) -> StageTimes {
        self.times
    }

    /// The camera's model.
    pub fn camera(&self) -> &Camera {
        self.locator.camera()
    }

    /// Forgets all tracks, as after a gap in the frames.
    pub fn reset(&mut self) {
        self.tracker.reset();
    }

    /// What is seen in one frame, each detection with the capture time of its own row. Pixels are
    /// row by row without gaps; too few of them are an error. A ring whose pose cannot be computed
    /// is a detection without a pose.
    pub fn process(
        &mut self,
        pixels: &[u8],
        info: &FrameInfo,
        frame: u64,
        received_time: Timestamp,
        camera: CameraId,
    ) -> Result<FrameObservations, FrameError> {
        let view = Frame::new(pixels, info.width, info.height, info.width)?;
        let begun = Instant::now();
        let rings = self.tracker.process(&view);
        let found = Instant::now();
        let mut detections = Vec::with_capacity(rings.len());
        for tracked in rings {
            let row_px = tracked.ring.outer.center.v;
            let located = self.locator.locate(&view, tracked).ok();
            let counted = match located.as_ref().map(|located| located.by) {
                Some(Mode::Precise) => &mut self.counts.precise,
                Some(Mode::Fast) => &mut self.counts.fast,
                None => &mut self.counts.unlocated,
            };
            *counted += 1;
            let (ring, pose) = located.map_or((tracked.ring, None), |it| (it.ring, Some(it.pose)));
            let capture_time = row_time(info.capture_time, row_px, info.height, self.line_time_s);
            detections.push(Detection { track: tracked.track, ring, capture_time, pose });
        }
        let milliseconds = |time: Duration| time.as_secs_f64() * 1e3;
        self.times = StageTimes {
            find_ms: milliseconds(found - begun),
            locate_ms: milliseconds(found.elapsed()),
        };
        let rejects = self.tracker.rejects().iter();
        for (total, (_, count)) in self.counts.rejects.iter_mut().zip(rejects) {
            *total += u64::from(count);
        }
        Ok(FrameObservations {
            camera,
            frame,
            capture_time: info.capture_time,
            received_time,
            calibration_version: CALIBRATION_VERSION,
            detections,
        })
    }
}
