//! What cameras saw while robots drove about, sorted by roundel.
//!
//! A camera's tracker follows a roundel under one number and reads its code now and then; the reading that
//! most frames agree on names all sightings of that number, and roundels of one kind and code are one
//! subject in all cameras. What has no code is a reference if it stands where one is; else how it moves tells it
//! from its like in another camera ([`super::association`]).

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};

use roundel_fusion::world::FrameObservations;
use roundel_vision::{
    id::{CameraId, KindId, TrackNumber},
    marker::Code,
    time::Timestamp,
};

/// Fewer readings of a code name nothing.
const LEAST_READINGS: u32 = 3;
/// Of a number's readings so many must agree.
const AGREEMENT: f64 = 0.7;
/// Two sightings of one code in one camera that go on beside one another for longer are of two roundels, seconds.
const MOST_OVERLAP_S: f64 = 0.5;
/// Stamps that differ from the time of arrival by more than this are of another epoch, seconds.
const ANOTHER_EPOCH_S: f64 = 1.0;

/// One camera's detections of one roundel, with times of the camera's clock.
#[derive(Clone, Debug, Default)]
struct Followed {
    kind: Option<KindId>,
    readings: BTreeMap<Code, u32>,
    samples: Vec<Sample>,
}

/// One detection.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// By the camera's clock, on the recording's epoch.
    pub(super) stamp_s: f64,
    pub(super) place_m: Vector3<f64>,
    pub(super) covariance: Matrix3<f64>,
}

/// Detections of all cameras over some time: what the arena is calibrated from.
#[derive(Clone, Debug)]
pub struct Recording {
    least_gap_s: f64,
    epoch: Option<Timestamp>,
    cameras: BTreeMap<CameraId, Heard>,
    followed: BTreeMap<(CameraId, TrackNumber), Followed>,
}

/// What is known of a camera's stamps.
#[derive(Clone, Copy, Debug)]
struct Heard {
    frames: u64,
    first: Timestamp,
    last: Timestamp,
    /// Least time from stamp to arrival, seconds.
    least_lateness_s: f64,
}

/// Who a followed roundel is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Name {
    /// The same in all cameras.
    Coded(KindId, Code),
    /// Without a code: a camera's number of it, the first of those that move alike.
    Nameless(CameraId, TrackNumber),
}

/// By roundel and camera.
pub(super) type Sorted = BTreeMap<Name, BTreeMap<CameraId, Seen>>;

/// One camera's sightings of one roundel.
#[derive(Clone, Debug)]
pub(super) struct Seen {
    pub(super) kind: Option<KindId>,
    pub(super) samples: Vec<Sample>,
}

impl Recording {
    /// Empty. Of one roundel in one camera no more than `most_hz` detections a second are kept.
    pub fn new(most_hz: f64) -> Self {
        Self {
            least_gap_s: 0.9 / most_hz,
            epoch: None,
            cameras: BTreeMap::new(),
            followed: BTreeMap::new(),
        }
    }

    /// Adds a frame. Detections without a pose, or with numbers that are not finite, are left out.
    pub fn add(&mut self, frame: &FrameObservations) {
        let epoch = *self.epoch.get_or_insert(frame.received_time);
        let lateness_s = frame.received_time.seconds_since(frame.capture_time);
        let heard = self.cameras.entry(frame.camera).or_insert(Heard {
            frames: 0,
            first: frame.received_time,
            last: frame.received_time,
            least_lateness_s: lateness_s,
        });
        heard.frames += 1;
        heard.last = heard.last.max(frame.received_time);
        heard.least_lateness_s = heard.least_lateness_s.min(lateness_s);
        for detection in &frame.detections {
            let Some(pose) = &detection.pose else { continue };
            let covariance: Matrix3<f64> = pose.covariance.fixed_view::<3, 3>(0, 0).into_owned();
            let is_finite =
                pose.position_m.iter().chain(&covariance).all(|value| value.is_finite());
            if !is_finite || covariance.cholesky().is_none() {
                continue;
            }
            let followed = self.followed.entry((frame.camera, detection.track)).or_default();
            followed.kind = followed.kind.or(detection.ring.kind);
            if let Some(code) = detection.ring.code.as_ref().map(|reading| reading.code) {
                *followed.readings.entry(code).or_default() += 1;
            }
            let stamp_s = detection.capture_time.seconds_since(epoch);
            let is_due = followed
                .samples
                .last()
                .is_none_or(|last| stamp_s - last.stamp_s >= self.least_gap_s);
            if is_due {
                let place_m = pose.position_m;
                followed.samples.push(Sample { stamp_s, place_m, covariance });
            }
        }
    }

    /// From the first frame's arrival to the last one's, seconds.
    pub fn length_s(&self) -> f64 {
        let first = self.cameras.values().map(|heard| heard.first).min();
        let last = self.cameras.values().map(|heard| heard.last).max();
        first.zip(last).map_or(0.0, |(first, last)| last.seconds_since(first))
    }

    /// Frames of a camera.
    pub fn frames(&self, camera: CameraId) -> u64 {
        self.cameras.get(&camera).map_or(0, |heard| heard.frames)
    }

    /// Whether a camera saw any roundel.
    pub(super) fn has_seen(&self, camera: CameraId) -> bool {
        self.followed.keys().any(|(of, _)| *of == camera)
    }

    /// All sightings by roundel and camera, in the order of time, stamps since the recording's middle and on
    /// the server's epoch where a camera's clock has another; and whose code a camera saw in two places at
    /// once, which tells nothing and is left out.
    pub(super) fn sorted(&self) -> (Sorted, Vec<(CameraId, KindId, Code)>) {
        let middle_s = self.length_s() / 2.0;
        let mut sorted = Sorted::new();
        let mut twice: BTreeMap<Name, CameraId> = BTreeMap::new();
        for (&(camera, number), followed) in &self.followed {
            let name = followed.name().unwrap_or(Name::Nameless(camera, number));
            let seen = sorted.entry(name).or_default().entry(camera);
            let seen = seen.or_insert(Seen { kind: followed.kind, samples: Vec::new() });
            let shift_s = self.epoch_shift_s(camera) - middle_s;
            let samples: Vec<Sample> = followed
                .samples
                .iter()
                .map(|sample| Sample { stamp_s: sample.stamp_s + shift_s, ..*sample })
                .collect();
            if overlap(&seen.samples, &samples) > MOST_OVERLAP_S {
                twice.insert(name, camera);
            }
            seen.samples.extend(samples);
            seen.samples.sort_by(|one, other| one.stamp_s.total_cmp(&other.stamp_s));
        }
        let coded = twice.into_iter().filter_map(|(name, camera)| match name {
            Name::Coded(kind, code) => {
                sorted.remove(&name);
                Some((camera, kind, code))
            }
            Name::Nameless(..) => None,
        });
        let coded = coded.collect();
        (sorted, coded)
    }

    /// What brings a camera's stamps near the server's time: nothing where they are.
    pub(super) fn epoch_shift_s(&self, camera: CameraId) -> f64 {
        let lateness_s = self.cameras.get(&camera).map_or(0.0, |heard| heard.least_lateness_s);
        if lateness_s.abs() > ANOTHER_EPOCH_S { lateness_s } else { 0.0 }
    }
}

/// How long two sightings of one name go on beside one another, seconds.
pub(super) fn overlap(ones: &[Sample], others: &[Sample]) -> f64 {
    let span = |samples: &[Sample]| Some((samples.first()?.stamp_s, samples.last()?.stamp_s));
    let Some((one, other)) = span(ones).zip(span(others)) else { return 0.0 };
    let (from_s, to_s) = (one.0.max(other.0), one.1.min(other.1));
    let within = |samples: &[Sample]| {
        samples.iter().filter(|sample| (from_s..=to_s).contains(&sample.stamp_s)).count()
    };
    // One that comes and goes may have been another number in between.
    if within(ones) < 3 || within(others) < 3 { 0.0 } else { to_s - from_s }
}

impl Followed {
    fn name(&self) -> Option<Name> {
        let (&code, &readings) = self.readings.iter().max_by_key(|(_, readings)| **readings)?;
        let all: u32 = self.readings.values().sum();
        let is_clear =
            readings >= LEAST_READINGS && f64::from(readings) >= AGREEMENT * f64::from(all);
        is_clear.then_some(Name::Coded(self.kind?, code))
    }
}
