//! Estimation of the cameras' clock offsets from moving objects.
//!
//! A camera that stamps a frame t exposed it at t - δ(t), δ(t) = offset + skew · (t - now). Two cameras whose clocks
//! differ see a moving object in places v (δ₁ - δ₂) apart. `comparison` compares several cameras' views of one object
//! and derives information about the remaining errors of δ. A Kalman filter over all clocks adds the sums of a batch.
//!
//! Each clock has three unknowns: offset, skew, and the latency between capture and reception, which is nearly
//! constant: stamp less receiving time = δ - latency + jitter. The latency ties the mean of all clocks, which no moving
//! object shows, to the server's clock in the long run. When stamp less receiving time steps, either offset or latency
//! may have changed, and moving objects decide. Otherwise only their priors separate offset and latency.
//!
//! Only time differences are observable: [`Clocks::deviation_s`] is that of one clock against another. A camera that
//! joins later does not move the mean of the earlier ones.
//!
//! Accuracy: R4 with offsets to 40 ms and skews to 50 ppm, 24 robots, to 0.1 ms within 20 s
//! (`core/tests/fusion/clock.rs`).

use std::collections::BTreeSet;

use nalgebra::{DMatrix, DVector};

use super::evidence::Comparison;
use roundel_vision::{id::CameraId, time::Timestamp};

/// Prior knowledge of a clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockPrior {
    /// Standard deviation of the offset, seconds; 0: exact, nothing is estimated.
    pub offset_s: f64,
    /// Standard deviation of the skew, seconds per second.
    pub skew: f64,
}

impl ClockPrior {
    /// An exact clock.
    pub const EXACT: Self = Self { offset_s: 0.0, skew: 0.0 };
}

/// Estimate of a camera's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockEstimate {
    /// Delay of its stamps, seconds.
    pub offset_s: f64,
    /// Growth of the offset, seconds per second.
    pub skew: f64,
    /// Standard deviation of the offset's difference from the clock that it is best compared with, seconds; for a
    /// single clock, of the offset itself.
    pub deviation_s: f64,
    /// The same for the skew.
    pub skew_deviation: f64,
}

/// Duration of a batch of evidence.
const BATCH_S: f64 = 0.25;
/// Squared Mahalanobis length up to which a comparison has full weight.
const ROBUST_DISTANCE_SQUARED: f64 = 9.0;
/// Growth of the variances per second: of offset (s²), skew and latency (s²).
const OFFSET_WALK: f64 = 1e-12;
const SKEW_WALK: f64 = 2.5e-15;
const LATENCY_WALK: f64 = 4e-10;
/// Prior latency, seconds.
const LATENCY_S: f64 = 0.03;
/// Its standard deviation, seconds: so wide that receiving times determine skews, not offsets.
const LATENCY_DEVIATION_S: f64 = 1.0;
/// Smallest jitter of receiving times, seconds.
const MIN_JITTER_S: f64 = 1e-3;
/// Stamp less receiving time has stepped if it deviates by more standard deviations than this.
const STEP_SIGMAS: f64 = 3.0;

/// Uncertainty of a clock after its stamps were corrected for a step.
const STEP_PRIOR: ClockPrior = ClockPrior { offset_s: 0.03, skew: 1e-4 };

/// A clock is less certain than another if its uncertainty is larger by this factor. (If all clocks but one of n
/// are known, that one's uncertainty is n times theirs.)
const LESS_CERTAIN_RATIO: f64 = 1.5;

const STATES: usize = 3;

/// Sums over stamp less receiving time in a batch.
#[derive(Clone, Copy, Debug, Default)]
struct DelaySums {
    count: u32,
    sum_s: f64,
    sum_s2: f64,
}

/// One camera's clock.
#[derive(Clone, Debug)]
struct Clock {
    camera: CameraId,
    prior: ClockPrior,
    delays: DelaySums,
    /// Time of its last step.
    stepped_at: Option<Timestamp>,
}

/// All clocks.
#[derive(Clone, Debug, Default)]
pub struct Clocks {
    clocks: Vec<Clock>,
    /// Cameras that move, which give no evidence about clocks.
    moving: BTreeSet<CameraId>,
    /// Offset, skew and latency of each clock.
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    /// Variances of the differences of any two offsets.
    difference_variances: DMatrix<f64>,
    /// For each clock the sum of the variances of its differences from all others, and of its own.
    uncertainties_s2: Vec<f64>,
    /// Time at which the offsets are valid.
    time: Option<Timestamp>,
    /// Σ uᵀ W u and Σ uᵀ W ν of this batch.
    information: DMatrix<f64>,
    score: DVector<f64>,
    batch_since: Option<Timestamp>,
    /// Whether any clock is not exact.
    is_estimating: bool,
}

impl Clocks {
    /// Sets the prior of a clock, which restarts its estimate.
    pub fn set_prior(&mut self, camera: CameraId, prior: ClockPrior) {
        let index = self.find_or_insert(camera);
        self.clocks[index].prior = prior;
        self.is_estimating = self.clocks.iter().any(|clock| clock.prior != ClockPrior::EXACT);
        let base = index * STATES;
        for state in base..base + STATES {
            self.covariance.row_mut(state).fill(0.0);
            self.covariance.column_mut(state).fill(0.0);
        }
        let latency = if prior == ClockPrior::EXACT { 0.0 } else { LATENCY_DEVIATION_S };
        for (state, deviation) in [prior.offset_s, prior.skew, latency].into_iter().enumerate() {
            self.covariance[(base + state, base + state)] = deviation * deviation;
        }
        self.mean[base] = 0.0;
        self.mean[base + 1] = 0.0;
        self.mean[base + 2] = LATENCY_S;
        self.update_differences();
    }

    /// Removes a camera's clock; what it contributed to the others remains.
    pub(crate) fn remove(&mut self, camera: CameraId) {
        let Some(index) = self.index(camera) else { return };
        self.fix_mean();
        self.clocks.remove(index);
        let base = index * STATES;
        let (mean, covariance) =
            (std::mem::take(&mut self.mean), std::mem::take(&mut self.covariance));
        self.mean = mean.remove_rows(base, STATES);
        self.covariance = covariance.remove_rows(base, STATES).remove_columns(base, STATES);
        let size = self.clocks.len();
        self.information = DMatrix::zeros(size, size);
        self.score = DVector::zeros(size);
        self.is_estimating = self.clocks.iter().any(|clock| clock.prior != ClockPrior::EXACT);
        self.update_differences();
    }

    /// Sets whether a camera moves. A moving camera's own motion delays what it detects, so it is not compared.
    pub(crate) fn set_moving(&mut self, camera: CameraId, moving: bool) {
        if moving {
            self.moving.insert(camera);
        } else {
            self.moving.remove(&camera);
        }
    }

    /// Whether what a camera detected at `time` may be compared.
    pub(crate) fn is_compared(&self, camera: CameraId, time: Timestamp) -> bool {
        let stepped_at = self.index(camera).and_then(|index| self.clocks[index].stepped_at);
        !self.moving.contains(&camera) && stepped_at.is_none_or(|stepped_at| time > stepped_at)
    }

    /// Notes that a camera's clock was set before this frame. Its offset gets the uncertainty of a step, and
    /// earlier evidence is discarded.
    pub(crate) fn note_clock_step(&mut self, camera: CameraId, frame: Timestamp) {
        let index = self.find_or_insert(camera);
        self.information.fill(0.0);
        self.score.fill(0.0);
        let clock = &mut self.clocks[index];
        clock.stepped_at = Some(frame.plus_seconds(-STEP_PRIOR.offset_s));
        if clock.prior == ClockPrior::EXACT {
            return self.set_prior(camera, STEP_PRIOR);
        }
        clock.delays = DelaySums::default();
        self.covariance[(index * STATES, index * STATES)] += STEP_PRIOR.offset_s.powi(2);
        self.update_differences();
    }

    /// Whether any clock is estimated.
    pub fn is_estimating(&self) -> bool {
        self.is_estimating
    }

    /// Delay of a camera's stamps at `time`, seconds.
    pub fn offset_s(&self, camera: CameraId, time: Timestamp) -> f64 {
        let (Some(index), Some(reference)) = (self.index(camera), self.time) else { return 0.0 };
        let base = index * STATES;
        self.mean[base] + self.mean[base + 1] * time.seconds_since(reference)
    }

    /// The same at the newest update.
    pub(crate) fn offset_now_s(&self, camera: CameraId) -> f64 {
        self.index(camera).map_or(0.0, |index| self.mean[index * STATES])
    }

    /// Standard deviation of the difference of two cameras' clocks, seconds.
    pub fn deviation_s(&self, one: CameraId, other: CameraId) -> f64 {
        match (self.index(one), self.index(other)) {
            (Some(one), Some(other)) => self.difference_variances[(one, other)].sqrt(),
            _ => 0.0,
        }
    }

    /// Whether a clock is far less certain than another, so that their difference is its error.
    pub(crate) fn is_less_certain(&self, one: CameraId, other: CameraId) -> bool {
        match (self.index(one), self.index(other)) {
            (Some(one), Some(other)) => {
                self.uncertainties_s2[one] > LESS_CERTAIN_RATIO * self.uncertainties_s2[other]
            }
            _ => false,
        }
    }

    /// Largest [`Self::deviation_s`] of a camera, seconds.
    pub(crate) fn max_deviation_s(&self, camera: CameraId) -> f64 {
        let of = |index: usize| {
            self.difference_variances
                .row(index)
                .iter()
                .fold(0.0, |largest: f64, it| largest.max(*it))
        };
        self.index(camera).map_or(0.0, |index| of(index).sqrt())
    }

    /// Estimate of a camera's clock; `None` for an unknown camera.
    pub fn estimate(&self, camera: CameraId) -> Option<ClockEstimate> {
        let index = self.index(camera)?;
        let base = index * STATES;
        let deviation = |state: usize| {
            let others = (0..self.clocks.len()).filter(|other| *other != index);
            let smallest = others
                .map(|other| self.difference(index, other, state))
                .reduce(f64::min)
                .unwrap_or(self.covariance[(base + state, base + state)]);
            smallest.sqrt()
        };
        Some(ClockEstimate {
            offset_s: self.mean[base],
            skew: self.mean[base + 1],
            deviation_s: deviation(0),
            skew_deviation: deviation(1),
        })
    }

    /// Adds the evidence of several cameras' views of one object.
    pub(crate) fn add_comparison(&mut self, comparison: &Comparison) {
        let Some(evidence) = comparison.evidence() else { return };
        let distance_squared = evidence.distance_squared;
        let robust_weight =
            (ROBUST_DISTANCE_SQUARED / distance_squared.max(ROBUST_DISTANCE_SQUARED)).sqrt();
        for (one, camera) in comparison.cameras().enumerate() {
            let Some(row) = self.index(camera) else { continue };
            self.score[row] += robust_weight * evidence.score[one];
            for (other, camera) in comparison.cameras().enumerate() {
                let Some(column) = self.index(camera) else { continue };
                self.information[(row, column)] +=
                    robust_weight * evidence.information[(one, other)];
            }
        }
    }

    /// Adds stamp and receiving time of a frame; updates the estimate when a batch is complete.
    pub fn note_delay(&mut self, camera: CameraId, stamp: Timestamp, received: Timestamp) {
        let Some(index) = self.index(camera) else { return };
        if !self.is_estimating() {
            return;
        }
        let delay_s = stamp.seconds_since(received);
        let delays = &mut self.clocks[index].delays;
        delays.count += 1;
        delays.sum_s += delay_s;
        delays.sum_s2 += delay_s * delay_s;
        let time = *self.time.get_or_insert(received);
        let since = *self.batch_since.get_or_insert(received);
        if received.seconds_since(since) >= BATCH_S && received > time {
            self.batch_since = Some(received);
            self.predict(received);
            self.update_from_delays();
            self.update_from_comparisons();
            self.update_differences();
        }
    }

    fn index(&self, camera: CameraId) -> Option<usize> {
        self.clocks.iter().position(|clock| clock.camera == camera)
    }

    /// Index of a camera; a new one has an exact clock until a prior is set.
    pub(crate) fn find_or_insert(&mut self, camera: CameraId) -> usize {
        if let Some(index) = self.index(camera) {
            return index;
        }
        self.fix_mean();
        let index = self.clocks.len();
        let clock = Clock {
            camera,
            prior: ClockPrior::EXACT,
            delays: DelaySums::default(),
            stepped_at: None,
        };
        self.clocks.push(clock);
        let size = self.clocks.len();
        let old = std::mem::take(&mut self.covariance);
        self.covariance = old.resize(size * STATES, size * STATES, 0.0);
        let old = std::mem::take(&mut self.mean);
        self.mean = old.resize_vertically(size * STATES, 0.0);
        self.information = DMatrix::zeros(size, size);
        self.score = DVector::zeros(size);
        self.update_differences();
        index
    }

    /// Makes the mean of all offsets exact, since it defines the time scale. An exact clock defines it otherwise.
    fn fix_mean(&mut self) {
        if self.clocks.iter().any(|clock| clock.prior == ClockPrior::EXACT) {
            return;
        }
        let mut observed = DVector::zeros(self.mean.len());
        for index in 0..self.clocks.len() {
            observed[index * STATES] = 1.0;
        }
        let with_mean = &self.covariance * &observed;
        let variance = observed.dot(&with_mean);
        if self.time.is_some() && variance > 0.0 {
            self.covariance -= &with_mean * with_mean.transpose() / variance;
        }
    }

    fn predict(&mut self, to: Timestamp) {
        let Some(time) = self.time else { return };
        let dt = to.seconds_since(time);
        self.time = Some(to);
        for (index, clock) in self.clocks.iter().enumerate() {
            let base = index * STATES;
            self.mean[base] += self.mean[base + 1] * dt;
            // F P Fᵀ by one row and one column at a time.
            let skew = self.covariance.row(base + 1).clone_owned();
            let mut offset = self.covariance.row_mut(base);
            offset += skew * dt;
            let skew = self.covariance.column(base + 1).clone_owned();
            let mut offset = self.covariance.column_mut(base);
            offset += skew * dt;
            if clock.prior != ClockPrior::EXACT {
                self.covariance[(base, base)] += OFFSET_WALK * dt;
                self.covariance[(base + 1, base + 1)] += SKEW_WALK * dt;
                self.covariance[(base + 2, base + 2)] += LATENCY_WALK * dt;
            }
        }
    }

    /// Updates each clock by stamp less receiving time.
    fn update_from_delays(&mut self) {
        for index in 0..self.clocks.len() {
            let DelaySums { count, sum_s, sum_s2 } = std::mem::take(&mut self.clocks[index].delays);
            if count == 0 || self.clocks[index].prior == ClockPrior::EXACT {
                continue;
            }
            let base = index * STATES;
            let delay_s = sum_s / f64::from(count);
            let jitter = sum_s2 / f64::from(count) - delay_s * delay_s;
            let noise = jitter.max(MIN_JITTER_S * MIN_JITTER_S);
            let residual = delay_s - (self.mean[base] - self.mean[base + 2]);
            let mut observed = DVector::zeros(self.mean.len());
            (observed[base], observed[base + 2]) = (1.0, -1.0);
            let variance = observed.dot(&(&self.covariance * &observed)) + noise;
            if residual * residual > STEP_SIGMAS * STEP_SIGMAS * variance {
                self.covariance[(base, base)] += residual * residual;
                self.covariance[(base + 2, base + 2)] += residual * residual;
            }
            let with_delay = &self.covariance * &observed;
            let variance = observed.dot(&with_delay) + noise;
            self.mean += &with_delay * (residual / variance);
            self.covariance -= &with_delay * with_delay.transpose() / variance;
        }
    }

    /// Updates all clocks by the batch's evidence.
    fn update_from_comparisons(&mut self) {
        let size = self.clocks.len();
        let information = std::mem::replace(&mut self.information, DMatrix::zeros(size, size));
        let score = std::mem::replace(&mut self.score, DVector::zeros(size));
        let all = DMatrix::from_fn(self.mean.len(), size, |row, index| {
            self.covariance[(row, index * STATES)]
        });
        let offsets = DMatrix::from_fn(size, size, |row, column| all[(row * STATES, column)]);
        // (I + Λ P)⁻¹ Λ and (I + Λ P)⁻¹ η need no inverse of P or Λ.
        let system = (DMatrix::identity(size, size) + &information * offsets).lu();
        let (Some(gain), Some(weighted_score)) = (system.solve(&information), system.solve(&score))
        else {
            return;
        };
        let change = &all * weighted_score;
        self.mean += &change;
        self.covariance -= &all * gain * all.transpose();
        self.covariance = (&self.covariance + self.covariance.transpose()) * 0.5;
    }

    /// Updates the variances of the differences.
    fn update_differences(&mut self) {
        let size = self.clocks.len();
        self.difference_variances =
            DMatrix::from_fn(size, size, |one, other| self.difference(one, other, 0));
        self.uncertainties_s2.clear();
        for (index, row) in self.difference_variances.row_iter().enumerate() {
            self.uncertainties_s2
                .push(row.sum() + self.covariance[(index * STATES, index * STATES)]);
        }
    }

    fn difference(&self, one: usize, other: usize, state: usize) -> f64 {
        let at = |one: usize, other: usize| {
            self.covariance[(one * STATES + state, other * STATES + state)]
        };
        (at(one, one) + at(other, other) - 2.0 * at(one, other)).max(0.0)
    }
}
