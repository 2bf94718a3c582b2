//! Pixels → detections with poses and times.

use std::time::{Duration, Instant};

use roundel_core::{
    camera::Camera,
    frame::Frame,
    id::CameraId,
    marker::{Detector, DetectorError, Kind, Mask, Mode, Params, Tracker},
    pose::{Detection, ImageQuality, Located, Locator, PoseError},
    time::{Timestamp, row_time},
    world::FrameObservations,
};

use crate::model::hub::DetectionCounts;

#[derive(Clone, Debug)]
pub struct PipelineParts {
    pub kinds: Vec<Kind>,
    pub params: Params,
    pub mask: Mask,
    pub camera: Camera,
    /// Time between the exposures of two image rows.
    pub line_time_s: f64,
    pub counts: DetectionCounts,
}

/// Camera, number, times and calibration version of one frame.
#[derive(Clone, Copy, Debug)]
pub struct FrameHeader {
    pub camera: CameraId,
    pub calibration_version: u64,
    pub frame: u64,
    /// Middle of the exposure of the middle row.
    pub capture_time: Timestamp,
    pub received_time: Timestamp,
}

/// Processing times of one frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StageTimes {
    pub find_ms: f64,
    pub locate_ms: f64,
}

/// Tracks the roundels of one camera and locates them.
pub struct Pipeline {
    tracker: Tracker,
    locator: Locator,
    /// Buffer for the results of one frame.
    located: Vec<Result<Located, PoseError>>,
    line_time_s: f64,
    counts: DetectionCounts,
    times: StageTimes,
    deadline: Option<Instant>,
    /// Quality at each ring of the newest frame that was fitted.
    qualities: Vec<ImageQuality>,
}

impl Pipeline {
    pub fn new(parts: PipelineParts) -> Result<Self, DetectorError> {
        let PipelineParts { kinds, params, mask, camera, line_time_s, counts } = parts;
        let locator = Locator::new(camera, kinds.clone(), params.mode).with_line_time(line_time_s);
        let tracker = Tracker::new(Detector::new(kinds, params)?.with_mask(mask));
        let (located, qualities, times, deadline) = Default::default();
        Ok(Self { tracker, locator, located, line_time_s, counts, times, deadline, qualities })
    }

    pub fn counts(&self) -> &DetectionCounts {
        &self.counts
    }

    /// Times of the newest frame.
    pub fn times(&self) -> StageTimes {
        self.times
    }

    /// Blur and noise of the newest frame: medians over the rings that were fitted; `None` without any, as in fast mode.
    pub fn image_quality(&self) -> Option<ImageQuality> {
        let median = |number: fn(&ImageQuality) -> f64| {
            let mut numbers: Vec<f64> = self.qualities.iter().map(number).collect();
            numbers.sort_by(f64::total_cmp);
            numbers.get(numbers.len() / 2).copied()
        };
        Some(ImageQuality { blur_px: median(|it| it.blur_px)?, noise: median(|it| it.noise)? })
    }

    pub fn camera(&self) -> &Camera {
        self.locator.camera()
    }

    /// Uses another camera model from the next frame on; all tracks continue.
    pub fn set_camera(&mut self, camera: &Camera) {
        if camera.intrinsics() != self.locator.camera().intrinsics() {
            self.locator.set_camera(camera.clone());
        }
    }

    /// Sets the time after which no further ring of a frame is fitted to the grey levels; none by default.
    pub fn set_deadline(&mut self, deadline: Option<Instant>) {
        self.deadline = deadline;
    }

    /// Forgets all tracks, as after a gap in the frames.
    pub fn reset(&mut self) {
        self.tracker.reset();
        self.locator.reset();
    }

    /// Detections of one frame, each with the capture time of its own row. A ring whose pose cannot be computed is a
    /// detection without a pose. [`Pipeline::seek`] must get the same frame after the detections have been passed on.
    pub fn process(&mut self, view: &Frame<'_>, by: &FrameHeader) -> FrameObservations {
        let begun = Instant::now();
        let rings = self.tracker.follow(view);
        let found = Instant::now();
        let (time, located) = (by.capture_time, &mut self.located);
        match self.deadline {
            None => self.locator.locate_all_at(view, time, rings, located),
            Some(deadline) => {
                let is_late = || Instant::now() >= deadline;
                self.locator.locate_all_until(view, time, rings, located, &is_late);
            }
        }
        let mut detections = Vec::with_capacity(rings.len());
        self.qualities.clear();
        for (tracked, located) in rings.iter().zip(self.located.drain(..)) {
            let row_px = tracked.ring.outer.center.v;
            let located = located.ok();
            let counted = match located.as_ref().map(|located| located.by) {
                Some(Mode::Precise) => &mut self.counts.precise,
                Some(Mode::Fast) if located.as_ref().is_some_and(|located| located.is_deferred) => {
                    &mut self.counts.deferred
                }
                Some(Mode::Fast) => &mut self.counts.fast,
                None => &mut self.counts.unlocated,
            };
            *counted += 1;
            self.qualities.extend(located.as_ref().and_then(|located| located.image));
            let (ring, pose) = located.map_or((tracked.ring, None), |it| (it.ring, Some(it.pose)));
            let capture_time = row_time(by.capture_time, row_px, view.height(), self.line_time_s);
            detections.push(Detection { track: tracked.track, ring, capture_time, pose });
        }
        let milliseconds = |time: Duration| time.as_secs_f64() * 1e3;
        self.times = StageTimes {
            find_ms: milliseconds(found - begun),
            locate_ms: milliseconds(found.elapsed()),
        };
        self.count_rejects();
        FrameObservations {
            camera: by.camera,
            frame: by.frame,
            capture_time: by.capture_time,
            received_time: by.received_time,
            calibration_version: by.calibration_version,
            detections,
        }
    }

    /// Searches a part of the frame for roundels that are not tracked yet; the next frame's observations include them.
    pub fn seek(&mut self, view: &Frame<'_>) {
        let begun = Instant::now();
        self.tracker.seek(view);
        self.count_rejects();
        self.times.find_ms += begun.elapsed().as_secs_f64() * 1e3;
    }

    fn count_rejects(&mut self) {
        let rejects = self.tracker.rejects().iter();
        for (total, (_, count)) in self.counts.rejects.iter_mut().zip(rejects) {
            *total += u64::from(count);
        }
    }
}

#[cfg(test)]
pub(in crate::capture) mod tests {
    use roundel_core::{
        camera::{Intrinsics, Lens, PixelPoint},
        marker::Reject,
    };

    use super::*;

    pub(in crate::capture) const WIDTH: usize = 320;
    pub(in crate::capture) const HEIGHT: usize = 240;

    /// White, with a black ring of 20 px radius around a white disc of 8 px at each place.
    pub(in crate::capture) fn frame(places: &[(f64, f64)]) -> Vec<u8> {
        let level = |u: f64, v: f64| {
            let ink = places.iter().map(|place| {
                let radius = (u - place.0).hypot(v - place.1);
                (20.5 - radius).clamp(0.0, 1.0) - (8.5 - radius).clamp(0.0, 1.0)
            });
            (220.0 - 190.0 * ink.sum::<f64>()).round() as u8
        };
        let pixels = (0..HEIGHT).flat_map(|v| (0..WIDTH).map(move |u| (u, v)));
        pixels.map(|(u, v)| level(u as f64, v as f64)).collect()
    }

    pub(in crate::capture) fn camera(focal_px: f64) -> Camera {
        let camera = Camera::new(Intrinsics {
            width: WIDTH,
            height: HEIGHT,
            fx_px: focal_px,
            fy_px: focal_px,
            cx_px: 159.5,
            cy_px: 119.5,
            lens: Lens::PlumbBob([0.0; 5]),
        });
        camera.unwrap()
    }

    pub(in crate::capture) fn parts(mode: Mode) -> PipelineParts {
        PipelineParts {
            kinds: vec![Kind::plain("robot", 0.16, 0.064)],
            params: Params { mode, ..Params::default() },
            mask: Mask::default(),
            camera: camera(300.0),
            line_time_s: 0.0,
            counts: DetectionCounts::default(),
        }
    }

    fn pipeline(mode: Mode, mask: &[Vec<PixelPoint>]) -> Pipeline {
        Pipeline::new(PipelineParts { mask: Mask::of_polygons(mask).unwrap(), ..parts(mode) })
            .unwrap()
    }

    fn detections_of(pipeline: &mut Pipeline, pixels: &[u8], time_s: f64) -> Vec<Detection> {
        let capture_time = Timestamp::default().plus_seconds(time_s);
        let by = FrameHeader {
            camera: CameraId(0),
            calibration_version: 0,
            frame: 1,
            capture_time,
            received_time: capture_time,
        };
        let view = Frame::new(pixels, WIDTH, HEIGHT, WIDTH).unwrap();
        let found = pipeline.process(&view, &by).detections;
        pipeline.seek(&view);
        found
    }

    #[test]
    fn nothing_is_detected_behind_the_mask() {
        let pixels = frame(&[(80.0, 120.0), (240.0, 120.0)]);
        let left = [(0.0, 0.0), (160.0, 0.0), (160.0, 240.0), (0.0, 240.0)];
        let left = left.map(|(u, v)| PixelPoint { u, v }).to_vec();
        assert_eq!(detections_of(&mut pipeline(Mode::Fast, &[]), &pixels, 0.0).len(), 2);
        let mut masked = pipeline(Mode::Fast, &[left]);
        let found = detections_of(&mut masked, &pixels, 0.0);
        assert_eq!(found.len(), 1);
        assert!((found[0].ring.outer.center.u - 240.0).abs() < 0.5, "{found:?}");
        // A tracked roundel that moves behind the mask disappears.
        assert_eq!(detections_of(&mut masked, &frame(&[(80.0, 120.0)]), 0.1).len(), 0);
        assert!(masked.counts().rejects[Reject::Masked as usize] > 0);
    }

    /// The result, including the times of rows, is that of a pipeline that was created with the new model.
    #[test]
    fn a_new_camera_model_keeps_the_rolling_shutter() {
        let rolling = |focal_px: f64, line_time_s: f64| {
            let parts = parts(Mode::Precise);
            Pipeline::new(PipelineParts { camera: camera(focal_px), line_time_s, ..parts }).unwrap()
        };
        let run = |mut pipeline: Pipeline| {
            let mut last = Vec::new();
            for number in (0..8).map(f64::from) {
                let pixels = frame(&[(80.0 + 12.0 * number, 60.0)]);
                last = detections_of(&mut pipeline, &pixels, number / 30.0);
            }
            last
        };
        let mut changed = rolling(300.0, 1e-4);
        changed.set_camera(&camera(320.0));
        let changed = run(changed);
        assert_eq!(changed.len(), 1);
        assert_eq!(changed, run(rolling(320.0, 1e-4)));
        assert_ne!(changed, run(rolling(320.0, 0.0)));
    }

    #[test]
    fn rings_are_counted() {
        let pixels = frame(&[(80.0, 120.0), (240.0, 120.0)]);
        for mode in [Mode::Fast, Mode::Precise] {
            let mut pipeline = pipeline(mode, &[]);
            for _ in 0..3 {
                let found = detections_of(&mut pipeline, &pixels, 0.0);
                let pose = found[0].pose.as_ref().unwrap();
                // 300 px focal length, 160 mm over 40 px.
                assert!((pose.position_m.z - 300.0 * 0.16 / 40.0).abs() < 0.02, "{pose:?}");
            }
            let counts = pipeline.counts();
            assert_eq!(counts.precise + counts.fast + counts.unlocated, 6);
            assert_eq!(counts.unlocated, 0);
            assert!(mode == Mode::Precise || counts.precise == 0, "{counts:?}");
            let times = pipeline.times();
            assert!(times.find_ms > 0.0 && times.locate_ms > 0.0, "{times:?}");
        }
    }
}
