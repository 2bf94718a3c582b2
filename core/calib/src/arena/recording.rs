//! Detections of all cameras during a calibration, sorted by roundel.
//!
//! Within a camera, a track number follows a roundel and its code is read now and then. The majority code identifies all
//! samples of the number; roundels of the same kind and code are the same in all cameras. A roundel without code is either
//! a reference, identified by its position, or associated with others by its motion ([`super::association`]).

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};

use super::Finding;
use roundel_fusion::world::FrameObservations;
use roundel_vision::{
    id::{CameraId, KindId, TrackNumber},
    marker::Code,
    time::Timestamp,
};

const MIN_READINGS: u32 = 3;
/// Minimum share of readings that must agree.
const AGREEMENT: f64 = 0.7;
/// Two tracks of one code in one camera that overlap for longer are two roundels, seconds.
const MAX_OVERLAP_S: f64 = 0.5;
/// Stamps that differ from the time of arrival by more have another epoch, seconds.
const ANOTHER_EPOCH_S: f64 = 1.0;

/// Samples of one track number of a camera.
#[derive(Clone, Debug, Default)]
struct TrackedRoundel {
    kind: Option<KindId>,
    readings: BTreeMap<Code, u32>,
    samples: Vec<Sample>,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// Seconds by the camera's clock, since the recording's epoch.
    pub(super) stamp_s: f64,
    pub(super) position_m: Vector3<f64>,
    pub(super) covariance: Matrix3<f64>,
}

/// Detections of all cameras: the input of the arena calibration.
#[derive(Clone, Debug)]
pub struct Recording {
    min_gap_s: f64,
    epoch: Option<Timestamp>,
    cameras: BTreeMap<CameraId, CameraTiming>,
    tracked: BTreeMap<(CameraId, TrackNumber), TrackedRoundel>,
}

/// Statistics of a camera's stamps.
#[derive(Clone, Copy, Debug)]
struct CameraTiming {
    frames: u64,
    first: Timestamp,
    last: Timestamp,
    /// Minimum time from stamp to arrival, seconds.
    min_lateness_s: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum RoundelKey {
    /// The same in all cameras.
    Coded(KindId, Code),
    /// Without code: track number of a camera, the first of an associated group.
    Uncoded(CameraId, TrackNumber),
}

pub(super) type SamplesByRoundel = BTreeMap<RoundelKey, BTreeMap<CameraId, RoundelSamples>>;

#[derive(Clone, Debug)]
pub(super) struct RoundelSamples {
    pub(super) kind: Option<KindId>,
    pub(super) samples: Vec<Sample>,
}

impl Recording {
    /// An empty recording that keeps up to `max_hz` detections per second of each roundel and camera.
    pub fn new(max_hz: f64) -> Self {
        Self {
            min_gap_s: 0.9 / max_hz,
            epoch: None,
            cameras: BTreeMap::new(),
            tracked: BTreeMap::new(),
        }
    }

    /// Adds a frame. Detections without a pose or with non-finite numbers are skipped.
    pub fn add(&mut self, frame: &FrameObservations) {
        let epoch = *self.epoch.get_or_insert(frame.received_time);
        let lateness_s = frame.received_time.seconds_since(frame.capture_time);
        let timing = self.cameras.entry(frame.camera).or_insert(CameraTiming {
            frames: 0,
            first: frame.received_time,
            last: frame.received_time,
            min_lateness_s: lateness_s,
        });
        timing.frames += 1;
        timing.last = timing.last.max(frame.received_time);
        timing.min_lateness_s = timing.min_lateness_s.min(lateness_s);
        for detection in &frame.detections {
            let Some(pose) = &detection.pose else { continue };
            let covariance: Matrix3<f64> = pose.covariance.fixed_view::<3, 3>(0, 0).into_owned();
            let is_finite =
                pose.position_m.iter().chain(&covariance).all(|value| value.is_finite());
            if !is_finite || covariance.cholesky().is_none() {
                continue;
            }
            let tracked = self.tracked.entry((frame.camera, detection.track)).or_default();
            tracked.kind = tracked.kind.or(detection.ring.kind);
            if let Some(code) = detection.ring.code.as_ref().map(|reading| reading.code) {
                *tracked.readings.entry(code).or_default() += 1;
            }
            let stamp_s = detection.capture_time.seconds_since(epoch);
            let is_due =
                tracked.samples.last().is_none_or(|last| stamp_s - last.stamp_s >= self.min_gap_s);
            if is_due {
                let position_m = pose.position_m;
                tracked.samples.push(Sample { stamp_s, position_m, covariance });
            }
        }
    }

    /// Time from the arrival of the first frame to that of the last, seconds.
    pub fn length_s(&self) -> f64 {
        let first = self.cameras.values().map(|timing| timing.first).min();
        let last = self.cameras.values().map(|timing| timing.last).max();
        first.zip(last).map_or(0.0, |(first, last)| last.seconds_since(first))
    }

    /// Number of frames of a camera.
    pub fn frames(&self, camera: CameraId) -> u64 {
        self.cameras.get(&camera).map_or(0, |timing| timing.frames)
    }

    pub(super) fn has_seen(&self, camera: CameraId) -> bool {
        self.tracked.keys().any(|(of, _)| *of == camera)
    }

    /// Samples by roundel and camera, sorted by time, with stamps relative to the middle of the recording on the
    /// server's epoch; and the codes that a camera saw at two positions at once, which are left out.
    pub(super) fn by_roundel(&self) -> (SamplesByRoundel, Vec<Finding>) {
        let middle_s = self.length_s() / 2.0;
        let mut by_roundel = SamplesByRoundel::new();
        let mut duplicates: BTreeMap<RoundelKey, CameraId> = BTreeMap::new();
        for (&(camera, number), tracked) in &self.tracked {
            let name = tracked.name().unwrap_or(RoundelKey::Uncoded(camera, number));
            let seen = by_roundel.entry(name).or_default().entry(camera);
            let seen = seen.or_insert(RoundelSamples { kind: tracked.kind, samples: Vec::new() });
            let shift_s = self.epoch_shift_s(camera) - middle_s;
            let shifted = |it: &Sample| Sample { stamp_s: it.stamp_s + shift_s, ..*it };
            let samples: Vec<Sample> = tracked.samples.iter().map(shifted).collect();
            if overlap(&seen.samples, &samples) > MAX_OVERLAP_S {
                duplicates.insert(name, camera);
            }
            seen.samples.extend(samples);
            seen.samples.sort_by(|one, other| one.stamp_s.total_cmp(&other.stamp_s));
        }
        let twice = duplicates.into_iter().filter_map(|(name, camera)| match name {
            RoundelKey::Coded(kind, code) => {
                by_roundel.remove(&name);
                Some(Finding::Twice { camera, kind, code })
            }
            RoundelKey::Uncoded(..) => None,
        });
        let twice = twice.collect();
        (by_roundel, twice)
    }

    /// Shift of a camera's stamps to the server's epoch; 0 if they have it.
    fn epoch_shift_s(&self, camera: CameraId) -> f64 {
        let lateness_s = self.cameras.get(&camera).map_or(0.0, |timing| timing.min_lateness_s);
        if lateness_s.abs() > ANOTHER_EPOCH_S { lateness_s } else { 0.0 }
    }
}

/// Duration for which two tracks overlap, seconds.
pub(super) fn overlap(ones: &[Sample], others: &[Sample]) -> f64 {
    let span = |samples: &[Sample]| Some((samples.first()?.stamp_s, samples.last()?.stamp_s));
    let Some((one, other)) = span(ones).zip(span(others)) else { return 0.0 };
    let (from_s, to_s) = (one.0.max(other.0), one.1.min(other.1));
    let within = |samples: &[Sample]| {
        samples.iter().filter(|sample| (from_s..=to_s).contains(&sample.stamp_s)).count()
    };
    // A track that comes and goes may have had another number in between.
    if within(ones) < 3 || within(others) < 3 { 0.0 } else { to_s - from_s }
}

impl TrackedRoundel {
    fn name(&self) -> Option<RoundelKey> {
        let (&code, &readings) = self.readings.iter().max_by_key(|(_, readings)| **readings)?;
        let all: u32 = self.readings.values().sum();
        let is_clear =
            readings >= MIN_READINGS && f64::from(readings) >= AGREEMENT * f64::from(all);
        is_clear.then_some(RoundelKey::Coded(self.kind?, code))
    }
}
