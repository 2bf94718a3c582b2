//! Records what cameras see for a calibration, and says meanwhile what is missing.

use std::collections::{BTreeMap, BTreeSet};

use roundel_core::{
    calib::arena::{Coverage, Recording},
    camera::Camera,
    id::{CameraId, KindId},
    marker::Code,
    time::Timestamp,
    world::FrameObservations,
};

/// Of one roundel in one camera so many detections a second are kept: more say little that is new.
const MAX_DETECTIONS_HZ: f64 = 20.0;
/// Two cameras that see one roundel within this time of each other see it together, seconds.
const MAX_TIME_DIFFERENCE_S: f64 = 0.1;

/// What has been recorded of one camera.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordedCamera {
    pub frames: u64,
    pub codes: usize,
    /// Share of the image's fields in which roundels were seen.
    pub coverage: f64,
    /// Sightings of codes that another camera saw at the same time, by that camera.
    pub together: BTreeMap<CameraId, u64>,
}

/// Takes in frames of all cameras.
pub(super) struct DetectionRecorder {
    recording: Recording,
    cameras: BTreeMap<CameraId, CameraSamples>,
    /// When and by whom each code was seen last.
    newest: BTreeMap<(KindId, Code), BTreeMap<CameraId, Timestamp>>,
}

struct CameraSamples {
    lens: Camera,
    frames: u64,
    codes: BTreeSet<(KindId, Code)>,
    coverage: Coverage,
    together: BTreeMap<CameraId, u64>,
}

impl DetectionRecorder {
    /// For these cameras; frames of others are left out.
    pub(super) fn new(cameras: impl Iterator<Item = (CameraId, Camera)>) -> Self {
        let samples = |lens| CameraSamples {
            lens,
            frames: 0,
            codes: BTreeSet::new(),
            coverage: Coverage::default(),
            together: BTreeMap::new(),
        };
        Self {
            recording: Recording::new(MAX_DETECTIONS_HZ),
            cameras: cameras.map(|(id, lens)| (id, samples(lens))).collect(),
            newest: BTreeMap::new(),
        }
    }

    pub(super) fn add(&mut self, frame: &FrameObservations) {
        let Some(samples) = self.cameras.get_mut(&frame.camera) else { return };
        self.recording.add(frame);
        samples.frames += 1;
        let now = frame.received_time;
        for detection in frame.detections.iter().filter(|detection| detection.pose.is_some()) {
            samples.coverage.add(&samples.lens, detection.ring.outer.center);
            let code = detection.ring.code.as_ref().map(|reading| reading.code);
            let Some(name) = detection.ring.kind.zip(code) else { continue };
            samples.codes.insert(name);
            let seen = self.newest.entry(name).or_default();
            for (other, time) in seen.iter().filter(|(other, _)| **other != frame.camera) {
                if now.seconds_since(*time).abs() < MAX_TIME_DIFFERENCE_S {
                    *samples.together.entry(*other).or_default() += 1;
                }
            }
            seen.insert(frame.camera, now);
        }
    }

    pub(super) fn cameras(&self) -> BTreeMap<CameraId, RecordedCamera> {
        self.cameras.iter().map(|(id, samples)| (*id, samples.summary())).collect()
    }

    pub(super) fn into_recording(self) -> Recording {
        self.recording
    }
}

impl CameraSamples {
    fn summary(&self) -> RecordedCamera {
        RecordedCamera {
            frames: self.frames,
            codes: self.codes.len(),
            coverage: self.coverage.share(),
            together: self.together.clone(),
        }
    }
}
