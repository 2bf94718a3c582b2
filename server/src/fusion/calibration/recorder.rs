//! Records observations for a calibration, and reports coverage meanwhile.

use std::collections::{BTreeMap, BTreeSet};

use roundel_core::{
    calib::arena::{ImageCoverage, Recording},
    camera::Camera,
    id::{CameraId, KindId},
    marker::Code,
    time::Timestamp,
    world::FrameObservations,
};

/// Recorded rate of detections of one roundel in one camera: more add little information.
const MAX_DETECTIONS_HZ: f64 = 20.0;
/// Two sightings of a roundel within this time count as simultaneous, seconds.
const MAX_TIME_DIFFERENCE_S: f64 = 0.1;

/// Recorded so far of one camera.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordedCamera {
    pub frames: u64,
    pub codes: usize,
    /// Share of the image's cells in which roundels were seen.
    pub coverage: f64,
    /// Sightings shared with each other camera.
    pub together: BTreeMap<CameraId, u64>,
}

pub(super) struct DetectionRecorder {
    recording: Recording,
    cameras: BTreeMap<CameraId, CameraSamples>,
    /// Time of the newest sighting of each code by each camera.
    newest: BTreeMap<(KindId, Code), BTreeMap<CameraId, Timestamp>>,
}

struct CameraSamples {
    lens: Camera,
    summary: RecordedCamera,
    codes: BTreeSet<(KindId, Code)>,
    coverage: ImageCoverage,
}

impl DetectionRecorder {
    /// Frames of other cameras are ignored.
    pub(super) fn new(cameras: &BTreeMap<CameraId, Camera>) -> Self {
        let samples = |lens: &Camera| CameraSamples {
            lens: lens.clone(),
            summary: RecordedCamera::default(),
            codes: BTreeSet::new(),
            coverage: ImageCoverage::default(),
        };
        Self {
            recording: Recording::new(MAX_DETECTIONS_HZ),
            cameras: cameras.iter().map(|(id, lens)| (*id, samples(lens))).collect(),
            newest: BTreeMap::new(),
        }
    }

    pub(super) fn add(&mut self, frame: &FrameObservations) {
        let Some(samples) = self.cameras.get_mut(&frame.camera) else { return };
        self.recording.add(frame);
        let summary = &mut samples.summary;
        summary.frames += 1;
        let now = frame.received_time;
        for detection in frame.detections.iter().filter(|detection| detection.pose.is_some()) {
            samples.coverage.add(&samples.lens, detection.ring.outer.center);
            let code = detection.ring.code.as_ref().map(|reading| reading.code);
            let Some(name) = detection.ring.kind.zip(code) else { continue };
            samples.codes.insert(name);
            let seen = self.newest.entry(name).or_default();
            for (other, time) in seen.iter().filter(|(other, _)| **other != frame.camera) {
                if now.seconds_since(*time).abs() < MAX_TIME_DIFFERENCE_S {
                    *summary.together.entry(*other).or_default() += 1;
                }
            }
            seen.insert(frame.camera, now);
        }
        summary.codes = samples.codes.len();
        summary.coverage = samples.coverage.share();
    }

    pub(super) fn cameras(&self) -> BTreeMap<CameraId, RecordedCamera> {
        self.cameras.iter().map(|(id, samples)| (*id, samples.summary.clone())).collect()
    }

    pub(super) fn into_recording(self) -> Recording {
        self.recording
    }
}
