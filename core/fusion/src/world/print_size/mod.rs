//! Sizes of prints: estimates how much larger or smaller the prints of a kind are than configured.
//!
//! A detection's distance is proportional to the diameter of its kind. Let a be its position relative to the camera at
//! c, along the axes of the world. If prints are k times as large as configured, the roundel is at c + k a. Two cameras
//! that detect the same roundel give
//!
//! k (a_i - a_j) = c_j - c_i,
//!
//! three equations with one unknown. The two spare equations test whether both detections are of one roundel, so this
//! needs no tracks, and k may be far from 1. Pairs of different roundels give any k; those of the same roundel all give
//! the same one, which is the peak of a histogram of ln k. The mean around the peak is computed for each pair of
//! cameras, since their pose errors are common to all its comparisons, and the means of all pairs are averaged with the
//! tolerance of the kind as prior. If they contradict one another, the deviation grows accordingly.
//!
//! A reference takes the place of the second camera: c_j is its position, and a_j = 0. So a single camera measures the
//! scale where it sees references of the kind, if its pose does not stem from their size.
//!
//! Each camera is sampled ten times a second, up to [`MAX_SIGHTS`] detections. Positions are interpolated between two
//! samples to the time of the other camera's detection.
//!
//! Measurements use the estimate, and its deviation is part of their systematic error ([`super::measurement`]). An
//! estimate beyond [`MAX_USED_LN`] is only reported: that is a wrong entry in the configuration, not a print of another
//! scale.
//!
//! Results (`core/tests/fusion/print_size.rs`): nine objects under four cameras with prints at 94, 97 and 103 %: the
//! scale is within 0.03 % after 8 s, and positions are as exact as with the true size.
//!
//! Limits: all prints of a kind have the same scale. A single camera without references, or cameras at one place, reveal
//! nothing; the tolerance then remains in the covariance. Cameras that were calibrated with the same prints and without
//! references agree with any size.

mod comparison;

use std::{collections::BTreeMap, iter};

use nalgebra::{Matrix3, Vector3};

use super::{
    CameraPlacement, FrameObservations, Landmark,
    measurement::{PrintSize, StampCorrection, is_valid_pose, with_lever_arm},
};
use comparison::{Comparison, MAX_LN, Position, compare};
use roundel_vision::{
    id::{CameraId, KindId, TrackNumber},
    marker::Code,
    pose::{Detection, RoundelPose},
    rigid::{Covariance6, turned_covariance},
    time::Timestamp,
};

/// Interval between a camera's samples.
const SAMPLE_NS: i64 = 100_000_000;
/// Samples farther apart are not interpolated.
const MAX_GAP_NS: i64 = 250_000_000;
/// Most detections in a sample.
const MAX_SIGHTS: usize = 24;
/// Width of a bin of the histogram of ln k.
const BIN_LN: f64 = 0.01;
const BINS: usize = (2.0 * MAX_LN / BIN_LN) as usize;
/// Smallest number of comparisons in the peak.
const MIN_VOTES: u32 = 30;
/// The peak must have this many times the votes of any other.
const DOMINANCE: u32 = 3;
/// Distance to the peak, in bins, beyond which another begins.
const PEAK_BINS: usize = 4;
/// Votes are halved when the peak has this many.
const MAX_VOTES: u32 = 10_000;
/// Comparisons farther from the peak do not count.
const PEAK_LN: f64 = 0.03;
/// Share of a comparison's information that is new: errors are correlated over about a second.
const NEW_SHARE: f64 = 0.05;
/// Smallest standard deviation: lenses and prints vary by this much.
const MIN_DEVIATION: f64 = 3e-4;
/// Interval between estimates.
const ESTIMATE_NS: i64 = 250_000_000;
/// Largest |ln k| that measurements use.
const MAX_USED_LN: f64 = 0.12;
/// Evidence that contradicts the tolerance by more standard deviations overrules it.
const MAX_PRIOR_SIGMAS: f64 = 3.0;
/// Smallest significant error of size that is reported, and the largest deviation of a reported one.
const REPORTED_LN: f64 = 0.01;
const REPORTED_DEVIATION: f64 = 0.002;
/// An error that was reported is reported again if it changes by this much.
const CHANGED_LN: f64 = 0.02;

/// Size of a kind's prints.
#[derive(Clone, Debug, PartialEq)]
pub struct KindPrintSize {
    /// The kind.
    pub kind: KindId,
    /// Measured size; the configured one with its tolerance until it is measured.
    pub size: PrintSize,
    /// Whether it is measured.
    pub state: PrintSizeState,
    /// Cameras that measured it, ascending.
    pub cameras: Vec<CameraId>,
}

/// Whether the size of a kind's prints is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PrintSizeState {
    /// Not measured yet.
    Assumed,
    /// Measured; positions are corrected by it.
    Measured,
    /// Measured, but too far from the configured size for a print of this kind; positions are not corrected.
    Contradicted,
}

/// A detection of a sample.
#[derive(Clone, Copy, Debug)]
struct Sight {
    kind: KindId,
    number: TrackNumber,
    code: Option<Code>,
    time: Timestamp,
    /// Position relative to the camera along the axes of the world, metres.
    arm_m: Vector3<f64>,
    /// Error of the detection.
    covariance: Matrix3<f64>,
}

/// Last two samples of a camera.
#[derive(Clone, Debug)]
struct CameraSamples {
    origin_m: Vector3<f64>,
    pose_covariance: Covariance6,
    older: Vec<Sight>,
    newer: Vec<Sight>,
    sampled: Timestamp,
}

/// The cameras of a comparison, in ascending order; a camera alone is compared with references.
type Pair = (CameraId, Option<CameraId>);

/// Comparisons between the same two cameras, or of one camera with references.
#[derive(Clone, Copy, Debug, Default)]
struct PairSum {
    information: f64,
    weighted_ln: f64,
    weighted_pose_variance: f64,
}

#[derive(Clone, Debug)]
struct KindSize {
    /// Without evidence.
    prior: PrintSize,
    /// Number of comparisons by ln k.
    votes: Vec<u32>,
    /// ln k at the peak.
    peak: Option<f64>,
    pairs: BTreeMap<Pair, PairSum>,
    measured: Option<PrintSize>,
    reported_ln: Option<f64>,
}

/// Sizes of all kinds.
#[derive(Clone, Debug, Default)]
pub(super) struct PrintSizes {
    kinds: BTreeMap<KindId, KindSize>,
    cameras: BTreeMap<CameraId, CameraSamples>,
    estimated: Option<Timestamp>,
    reports: Vec<KindPrintSize>,
}

impl PrintSizes {
    /// Sets the relative tolerance of a kind's size, twice its standard deviation without evidence, and forgets the
    /// estimate. With 0 the size is exact, and the print flat.
    pub(super) fn set_tolerance(&mut self, kind: KindId, tolerance: f64, flatness_m: f64) {
        if tolerance > 0.0 {
            let prior = PrintSize { factor: 1.0, deviation: 0.5 * tolerance, flatness_m };
            self.kinds.insert(kind, KindSize::new(prior));
        } else {
            self.kinds.remove(&kind);
        }
    }

    /// Size of a kind's prints.
    pub(super) fn get(&self, kind: Option<KindId>) -> PrintSize {
        kind.and_then(|kind| self.kinds.get(&kind)).map_or(PrintSize::EXACT, KindSize::used)
    }

    /// Whether all sizes are as configured.
    pub(super) fn is_exact(&self) -> bool {
        self.kinds.is_empty()
    }

    /// Whether the configured size of the kind cannot be right.
    pub(super) fn is_wrong(&self, kind: Option<KindId>) -> bool {
        let state = kind.and_then(|kind| self.kinds.get(&kind)).map(KindSize::state);
        state == Some(PrintSizeState::Contradicted)
    }

    /// Sizes of all kinds with a tolerance.
    pub(super) fn all(&self) -> impl Iterator<Item = KindPrintSize> + '_ {
        self.kinds.iter().map(|(&kind, size)| size.named(kind))
    }

    /// Takes the wrong sizes found since the last call.
    pub(super) fn drain(&mut self) -> impl Iterator<Item = KindPrintSize> + '_ {
        self.reports.drain(..)
    }

    /// Forgets a camera whose pose has changed.
    pub(super) fn forget_camera(&mut self, camera: CameraId) {
        self.cameras.remove(&camera);
        for kind in self.kinds.values_mut() {
            kind.pairs.retain(|pair, _| pair.0 != camera && pair.1 != Some(camera));
        }
    }

    /// Adds a frame of a stationary camera.
    pub(super) fn observe(
        &mut self,
        frame: &FrameObservations,
        placement: &CameraPlacement,
        correction: StampCorrection,
        references: &[Landmark],
    ) {
        if self.is_exact() || !self.sample(frame, placement, correction) {
            return;
        }
        self.compare_with_others(frame.camera);
        self.compare_with_references(frame.camera, references);
        let time = correction.corrected(frame.capture_time);
        let is_due = |last: Timestamp| time.ns_since(last).saturating_abs() >= ESTIMATE_NS;
        if self.estimated.is_none_or(is_due) {
            self.estimated = Some(time);
            self.estimate();
        }
    }

    /// Adds the frame to its camera's samples; false if none is due.
    fn sample(
        &mut self,
        frame: &FrameObservations,
        placement: &CameraPlacement,
        correction: StampCorrection,
    ) -> bool {
        let time = correction.corrected(frame.capture_time);
        let samples = self.cameras.entry(frame.camera).or_insert_with(|| CameraSamples {
            origin_m: placement.world_from_camera.translation.vector,
            pose_covariance: placement.covariance,
            older: Vec::new(),
            newer: Vec::new(),
            sampled: Timestamp::default(),
        });
        let elapsed_ns = time.ns_since(samples.sampled);
        if (0..SAMPLE_NS).contains(&elapsed_ns) {
            return false;
        }
        samples.sampled = time;
        std::mem::swap(&mut samples.older, &mut samples.newer);
        samples.newer.clear();
        let rotation = placement.world_from_camera.rotation;
        let turn = rotation.to_rotation_matrix().into_inner();
        let sight = |detection: &Detection| {
            let kind = detection.ring.kind.filter(|kind| self.kinds.contains_key(kind))?;
            let pose = detection.pose.as_ref().filter(|pose| is_valid_pose(pose))?;
            let own = pose.covariance.fixed_view::<3, 3>(0, 0).into_owned();
            Some(Sight {
                kind,
                number: detection.track,
                code: detection.ring.code.map(|reading| reading.code),
                time: correction.corrected(detection.capture_time),
                arm_m: rotation * pose.position_m,
                covariance: turned_covariance(&turn, &own),
            })
        };
        samples.newer.extend(frame.detections.iter().filter_map(sight).take(MAX_SIGHTS));
        true
    }

    /// Compares the last two samples of a camera with those of the others that lie between them.
    fn compare_with_others(&mut self, camera: CameraId) {
        let Some(own) = self.cameras.get(&camera) else { return };
        for older in &own.older {
            let Some(newer) = own.newer.iter().find(|newer| newer.number == older.number) else {
                continue;
            };
            let Some(kind) = self.kinds.get_mut(&newer.kind) else { continue };
            for (&other, samples) in self.cameras.iter().filter(|(other, _)| **other != camera) {
                let pair = (camera.min(other), Some(camera.max(other)));
                for theirs in
                    samples.newer.iter().filter(|theirs| theirs.may_be(newer.kind, newer.code))
                {
                    let comparison = older.interpolated(newer, theirs.time).and_then(|moved| {
                        compare(&own.position(&moved), &samples.position(theirs))
                    });
                    if let Some(comparison) = comparison {
                        kind.add(pair, comparison);
                    }
                }
            }
        }
    }

    /// Compares the newest sample of a camera with the references.
    fn compare_with_references(&mut self, camera: CameraId, references: &[Landmark]) {
        let Some(samples) = self.cameras.get(&camera) else { return };
        for sight in &samples.newer {
            let Some(kind) = self.kinds.get_mut(&sight.kind) else { continue };
            let own = samples.position(sight);
            for reference in references.iter().filter(|it| sight.may_be(it.kind, it.code)) {
                if let Some(comparison) = compare(&own, &Position::from(reference)) {
                    kind.add((camera, None), comparison);
                }
            }
        }
    }

    fn estimate(&mut self) {
        for (&kind, state) in &mut self.kinds {
            let Some((ln, deviation)) = state.estimate() else { continue };
            state.measured = Some(PrintSize { factor: ln.exp(), deviation, ..state.prior });
            let is_significant =
                deviation < REPORTED_DEVIATION && ln.abs() - 2.0 * deviation > REPORTED_LN;
            let is_known = state.reported_ln.is_some_and(|known| (ln - known).abs() < CHANGED_LN);
            if is_significant && !is_known {
                state.reported_ln = Some(ln);
                self.reports.push(state.named(kind));
            }
        }
    }
}

impl KindSize {
    fn new(prior: PrintSize) -> Self {
        Self {
            prior,
            votes: vec![0; BINS],
            peak: None,
            pairs: BTreeMap::new(),
            measured: None,
            reported_ln: None,
        }
    }

    fn state(&self) -> PrintSizeState {
        match self.measured {
            None => PrintSizeState::Assumed,
            Some(size) if size.factor.ln().abs() <= MAX_USED_LN => PrintSizeState::Measured,
            Some(_) => PrintSizeState::Contradicted,
        }
    }

    /// The size that measurements use.
    fn used(&self) -> PrintSize {
        let assumed = self.prior;
        self.measured.filter(|_| self.state() == PrintSizeState::Measured).unwrap_or(assumed)
    }

    fn named(&self, kind: KindId) -> KindPrintSize {
        let pairs = self.pairs.keys();
        let mut cameras: Vec<_> = pairs.flat_map(|pair| iter::once(pair.0).chain(pair.1)).collect();
        cameras.sort_unstable();
        cameras.dedup();
        let size = self.measured.unwrap_or_else(|| self.used());
        KindPrintSize { kind, size, state: self.state(), cameras }
    }

    fn add(&mut self, pair: Pair, comparison: Comparison) {
        let Comparison { ln, variance, pose_variance } = comparison;
        let bin = (ln + MAX_LN) / BIN_LN;
        if bin < 0.0 || bin >= BINS as f64 {
            return;
        }
        self.votes[bin as usize] += 1;
        if self.peak.is_none_or(|peak| (ln - peak).abs() > PEAK_LN) {
            return;
        }
        let information = NEW_SHARE / variance;
        let sum = self.pairs.entry(pair).or_default();
        sum.information += information;
        sum.weighted_ln += information * ln;
        sum.weighted_pose_variance += information * pose_variance;
    }

    /// ln k with its standard deviation; `None` without evidence.
    fn estimate(&mut self) -> Option<(f64, f64)> {
        self.find_peak();
        let means = || self.pairs.values().map(PairSum::mean);
        let weight: f64 = means().map(|(_, variance)| 1.0 / variance).sum();
        if weight == 0.0 {
            return None;
        }
        let ln = means().map(|(ln, variance)| ln / variance).sum::<f64>() / weight;
        let misfit: f64 = means().map(|(other, variance)| (other - ln).powi(2) / variance).sum();
        let spare = self.pairs.len().saturating_sub(1).max(1) as f64;
        let variance = (misfit / spare).max(1.0) / weight;
        let prior_variance = self.prior.deviation * self.prior.deviation;
        let contradiction = ln * ln / (variance + prior_variance);
        let (ln, variance) = if contradiction > MAX_PRIOR_SIGMAS * MAX_PRIOR_SIGMAS {
            (ln, variance)
        } else {
            let share = prior_variance / (variance + prior_variance);
            (ln * share, variance * share)
        };
        Some((ln, variance.sqrt().max(MIN_DEVIATION)))
    }

    /// Finds the peak of the histogram. If it has moved, the means begin again.
    fn find_peak(&mut self) {
        let around = |bin: usize| -> u32 {
            self.votes[bin.saturating_sub(1)..(bin + 2).min(BINS)].iter().sum()
        };
        let Some((votes, best)) = (0..BINS).map(|bin| (around(bin), bin)).max() else { return };
        let is_other = |bin: &usize| bin.abs_diff(best) > PEAK_BINS;
        let second = (0..BINS).filter(is_other).map(around).max().unwrap_or(0);
        if votes < MIN_VOTES || votes < DOMINANCE * second {
            return;
        }
        let ln = (best as f64 + 0.5) * BIN_LN - MAX_LN;
        if self.peak.is_none_or(|peak| (ln - peak).abs() > PEAK_LN - BIN_LN) {
            self.peak = Some(ln);
            self.pairs.clear();
        }
        if votes > MAX_VOTES {
            self.votes.iter_mut().for_each(|votes| *votes /= 2);
        }
    }
}

impl PairSum {
    /// Mean of ln k and its variance.
    fn mean(&self) -> (f64, f64) {
        let pose_variance = self.weighted_pose_variance / self.information;
        let variance = 1.0 / self.information + pose_variance + MIN_DEVIATION * MIN_DEVIATION;
        (self.weighted_ln / self.information, variance)
    }
}

impl Sight {
    /// Whether it may show a roundel of this kind and code.
    fn may_be(&self, kind: KindId, code: Option<Code>) -> bool {
        self.kind == kind && self.code.zip(code).is_none_or(|(own, other)| own == other)
    }

    /// The detection interpolated to a time between this sample and the newer one of the same camera.
    fn interpolated(&self, newer: &Self, time: Timestamp) -> Option<Self> {
        let (gap_ns, elapsed_ns) = (newer.time.ns_since(self.time), time.ns_since(self.time));
        if !(1..MAX_GAP_NS).contains(&gap_ns) || !(0..=gap_ns).contains(&elapsed_ns) {
            return None;
        }
        let share = elapsed_ns as f64 / gap_ns as f64;
        let arm_m = self.arm_m.lerp(&newer.arm_m, share);
        Some(Self { time, arm_m, ..*newer })
    }
}

impl CameraSamples {
    fn position(&self, sight: &Sight) -> Position {
        let arm_m = sight.arm_m;
        // The covariance of a position by the error of the camera's pose.
        let origin =
            with_lever_arm(&self.pose_covariance, &arm_m).fixed_view::<3, 3>(0, 0).into_owned();
        Position { origin_m: self.origin_m, arm_m, own: sight.covariance, origin }
    }
}

/// Corrects a pose by the size of its print.
pub(super) fn resize(pose: &mut RoundelPose, size: PrintSize) {
    pose.position_m *= size.factor;
    // The factor scales the rows of the position and its columns.
    let mut rows = pose.covariance.fixed_rows_mut::<3>(0);
    rows *= size.factor;
    let mut columns = pose.covariance.fixed_columns_mut::<3>(0);
    columns *= size.factor;
    let mut position = pose.covariance.fixed_view_mut::<3, 3>(0, 0);
    position += size.position_error(&pose.position_m, &pose.normal);
}
