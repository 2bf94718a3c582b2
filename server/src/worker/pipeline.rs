//! Pixels → detections with poses and times: what a worker does with each frame.

use roundel_core::{
    camera::Camera,
    frame::{Frame, FrameError},
    id::CameraId,
    marker::{Detector, DetectorError, Kind, Params, Tracker},
    pose::{Detection, Locator},
    time::{Timestamp, row_time},
    world::FrameObservations,
};

use crate::source::FrameInfo;

/// Calibrations do not change while this version of the server runs: all are the first.
pub const CALIBRATION_VERSION: u64 = 1;

/// Follows the roundels of one camera and locates them.
pub struct Pipeline {
    tracker: Tracker,
    locator: Locator,
    line_time_s: f64,
}

impl Pipeline {
    /// A pipeline for one camera that follows `max_roundels` of the given kinds; `line_time_s` lies
    /// between the exposures of two image rows.
    pub fn new(
        kinds: Vec<Kind>,
        max_roundels: usize,
        camera: Camera,
        line_time_s: f64,
    ) -> Result<Self, DetectorError> {
        let params = Params { max_roundels, ..Params::default() };
        let locator = Locator::new(camera, kinds.clone(), params.mode);
        let tracker = Tracker::new(Detector::new(kinds, params)?);
        Ok(Self { tracker, locator, line_time_s })
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
        let rings = self.tracker.process(&view);
        let mut detections = Vec::with_capacity(rings.len());
        for tracked in rings {
            let row_px = tracked.ring.outer.center.v;
            let located = self.locator.locate(&view, tracked).ok();
            let (ring, pose) = located.map_or((tracked.ring, None), |it| (it.ring, Some(it.pose)));
            let capture_time = row_time(info.capture_time, row_px, info.height, self.line_time_s);
            detections.push(Detection { track: tracked.track, ring, capture_time, pose });
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
