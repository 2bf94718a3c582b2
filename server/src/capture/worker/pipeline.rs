//! Pixels → detections with poses and times: what a worker does with each frame.

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

/// What a pipeline is made of.
#[derive(Clone, Debug)]
pub struct PipelineParts {
    pub kinds: Vec<Kind>,
    /// How they are looked for; with the mode, how they are located too.
    pub params: Params,
    /// Where they are not looked for.
    pub mask: Mask,
    pub camera: Camera,
    /// Time between the exposures of two image rows.
    pub line_time_s: f64,
    /// What became of rings and candidates before.
    pub counts: DetectionCounts,
}

/// Of what camera a frame is, and which of its frames.
#[derive(Clone, Copy, Debug)]
pub struct FrameHeader {
    pub camera: CameraId,
    pub calibration_version: u64,
    /// Counts the camera's frames.
    pub frame: u64,
    /// When its middle row was exposed.
    pub capture_time: Timestamp,
    pub received_time: Timestamp,
}

/// How long a frame took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StageTimes {
    pub find_ms: f64,
    pub locate_ms: f64,
}

/// Follows the roundels of one camera and locates them.
pub struct Pipeline {
    tracker: Tracker,
    locator: Locator,
    /// What became of the newest frame's rings.
    located: Vec<Result<Located, PoseError>>,
    line_time_s: f64,
    counts: DetectionCounts,
    times: StageTimes,
    /// Of the rings of the newest frame that were fitted.
    qualities: Vec<ImageQuality>,
}

impl Pipeline {
    /// A pipeline that has not seen a frame.
    pub fn new(parts: PipelineParts) -> Result<Self, DetectorError> {
        let PipelineParts { kinds, params, mask, camera, line_time_s, counts } = parts;
        let locator = Locator::new(camera, kinds.clone(), params.mode).with_line_time(line_time_s);
        let tracker = Tracker::new(Detector::new(kinds, params)?.with_mask(mask));
        let times = StageTimes::default();
        Ok(Self {
            tracker,
            locator,
            located: Vec::new(),
            line_time_s,
            counts,
            times,
            qualities: Vec::new(),
        })
    }

    /// What became of all rings and candidates so far.
    pub fn counts(&self) -> &DetectionCounts {
        &self.counts
    }

    /// How long the newest frame took.
    pub fn times(&self) -> StageTimes {
        self.times
    }

    /// How sharp and how clean the newest frame is: medians over its rings that were fitted, each for
    /// itself; `None` without any, as in fast mode.
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

    /// Another model from the next frame on; what is followed goes on being followed.
    pub fn set_camera(&mut self, camera: &Camera) {
        if camera.intrinsics() != self.locator.camera().intrinsics() {
            self.locator.set_camera(camera.clone());
        }
    }

    /// Forgets all tracks, as after a gap in the frames.
    pub fn reset(&mut self) {
        self.tracker.reset();
        self.locator.reset();
    }

    /// What is seen in one frame, each detection with the capture time of its own row. A ring whose
    /// pose cannot be computed is a detection without a pose. [`Pipeline::seek`] is to have the same frame once this
    /// has been handed on.
    pub fn process(&mut self, view: &Frame<'_>, by: &FrameHeader) -> FrameObservations {
        let begun = Instant::now();
        let rings = self.tracker.follow(view);
        let found = Instant::now();
        self.locator.locate_all_at(view, by.capture_time, rings, &mut self.located);
        let mut detections = Vec::with_capacity(rings.len());
        self.qualities.clear();
        for (tracked, located) in rings.iter().zip(self.located.drain(..)) {
            let row_px = tracked.ring.outer.center.v;
            let located = located.ok();
            let counted = match located.as_ref().map(|located| located.by) {
                Some(Mode::Precise) => &mut self.counts.precise,
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

    /// Searches a part of the frame for roundels that are not followed yet; they are in the next frame's observations.
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
mod tests {
    use roundel_core::{
        camera::{Intrinsics, Lens, PixelPoint},
        marker::Reject,
    };

    use super::*;

    const WIDTH: usize = 320;
    const HEIGHT: usize = 240;

    /// White, with a black ring of 20 px round a white disc of 8 px at each place.
    fn frame(places: &[(f64, f64)]) -> Vec<u8> {
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

    fn camera(focal_px: f64) -> Camera {
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

    fn parts(mode: Mode) -> PipelineParts {
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

    fn detections_of(pipeline: &mut Pipeline, pixels: &[u8]) -> Vec<Detection> {
        detections_at(pipeline, pixels, Timestamp::default())
    }

    fn detections_at(
        pipeline: &mut Pipeline,
        pixels: &[u8],
        capture_time: Timestamp,
    ) -> Vec<Detection> {
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
    fn nothing_is_seen_where_the_mask_lies() {
        let pixels = frame(&[(80.0, 120.0), (240.0, 120.0)]);
        let left = [(0.0, 0.0), (160.0, 0.0), (160.0, 240.0), (0.0, 240.0)];
        let left = left.map(|(u, v)| PixelPoint { u, v }).to_vec();
        assert_eq!(detections_of(&mut pipeline(Mode::Fast, &[]), &pixels).len(), 2);
        let mut masked = pipeline(Mode::Fast, &[left]);
        let found = detections_of(&mut masked, &pixels);
        assert_eq!(found.len(), 1);
        assert!((found[0].ring.outer.center.u - 240.0).abs() < 0.5, "{found:?}");
        // Nor where one moves behind it.
        assert_eq!(detections_of(&mut masked, &frame(&[(80.0, 120.0)])).len(), 0);
        assert!(masked.counts().rejects[Reject::Masked as usize] > 0);
    }

    /// It is as if it had been there from the beginning, the rows' times included.
    #[test]
    fn another_model_of_a_rolling_camera_keeps_its_shutter() {
        let rolling = |focal_px: f64, line_time_s: f64| {
            let parts = parts(Mode::Precise);
            Pipeline::new(PipelineParts { camera: camera(focal_px), line_time_s, ..parts }).unwrap()
        };
        let run = |mut pipeline: Pipeline| {
            let mut last = Vec::new();
            for frame_number in 0..8 {
                let time = Timestamp::default().plus_seconds(f64::from(frame_number) / 30.0);
                let pixels = frame(&[(80.0 + 12.0 * f64::from(frame_number), 60.0)]);
                last = detections_at(&mut pipeline, &pixels, time);
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
    fn what_became_of_rings_is_counted() {
        let pixels = frame(&[(80.0, 120.0), (240.0, 120.0)]);
        for mode in [Mode::Fast, Mode::Precise] {
            let mut pipeline = pipeline(mode, &[]);
            for _ in 0..3 {
                let found = detections_of(&mut pipeline, &pixels);
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
