//! Records what cameras see for a calibration, and says meanwhile what is missing.

use std::collections::{BTreeMap, BTreeSet};

use roundel_core::{
    calib::arena::Recording,
    camera::{Camera, PixelPoint},
    id::{CameraId, KindId},
    marker::Code,
    time::Timestamp,
    world::FrameObservations,
};

/// Of one roundel in one camera so many detections a second are kept: more say little that is new.
const MOST_HZ: f64 = 20.0;
/// Two cameras that see one roundel within this time of each other see it together, seconds.
const TOGETHER_S: f64 = 0.1;
/// Fields of an image, across and down, as in the calibration's report.
const FIELDS: (usize, usize) = (8, 6);

/// What has been recorded of one camera.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordedCamera {
    /// Frames that came.
    pub frames: u64,
    /// Different codes that were read.
    pub codes: usize,
    /// Share of the image's fields in which roundels were seen.
    pub coverage: f64,
    /// Sightings of codes that another camera saw at the same time, by that camera.
    pub together: BTreeMap<CameraId, u64>,
}

/// Takes in frames of all cameras.
pub(super) struct Recorder {
    recording: Recording,
    cameras: BTreeMap<CameraId, Heard>,
    /// When and by whom each code was seen last.
    newest: BTreeMap<(KindId, Code), BTreeMap<CameraId, Timestamp>>,
}

struct Heard {
    lens: Camera,
    frames: u64,
    codes: BTreeSet<(KindId, Code)>,
    fields: [bool; FIELDS.0 * FIELDS.1],
    together: BTreeMap<CameraId, u64>,
}

impl Recorder {
    /// For these cameras; frames of others are left out.
    pub(super) fn new(cameras: impl Iterator<Item = (CameraId, Camera)>) -> Self {
        let heard = |lens| Heard {
            lens,
            frames: 0,
            codes: BTreeSet::new(),
            fields: [false; FIELDS.0 * FIELDS.1],
            together: BTreeMap::new(),
        };
        Self {
            recording: Recording::new(MOST_HZ),
            cameras: cameras.map(|(id, lens)| (id, heard(lens))).collect(),
            newest: BTreeMap::new(),
        }
    }

    pub(super) fn add(&mut self, frame: &FrameObservations) {
        let Some(heard) = self.cameras.get_mut(&frame.camera) else { return };
        self.recording.add(frame);
        heard.frames += 1;
        let now = frame.received_time;
        for detection in frame.detections.iter().filter(|detection| detection.pose.is_some()) {
            heard.mark(detection.ring.outer.center);
            let code = detection.ring.code.as_ref().map(|reading| reading.code);
            let Some(name) = detection.ring.kind.zip(code) else { continue };
            heard.codes.insert(name);
            let seen = self.newest.entry(name).or_default();
            for (other, time) in seen.iter().filter(|(other, _)| **other != frame.camera) {
                if now.seconds_since(*time).abs() < TOGETHER_S {
                    *heard.together.entry(*other).or_default() += 1;
                }
            }
            seen.insert(frame.camera, now);
        }
    }

    pub(super) fn cameras(&self) -> BTreeMap<CameraId, RecordedCamera> {
        self.cameras.iter().map(|(id, heard)| (*id, heard.told())).collect()
    }

    pub(super) fn into_recording(self) -> Recording {
        self.recording
    }
}

impl Heard {
    fn mark(&mut self, at: PixelPoint) {
        let field = |value: f64, size: usize, count: usize| {
            ((value / size as f64 * count as f64).max(0.0) as usize).min(count - 1)
        };
        let column = field(at.u, self.lens.width(), FIELDS.0);
        self.fields[field(at.v, self.lens.height(), FIELDS.1) * FIELDS.0 + column] = true;
    }

    fn told(&self) -> RecordedCamera {
        let seen = self.fields.iter().filter(|&&is_seen| is_seen).count();
        RecordedCamera {
            frames: self.frames,
            codes: self.codes.len(),
            coverage: seen as f64 / self.fields.len() as f64,
            together: self.together.clone(),
        }
    }
}
