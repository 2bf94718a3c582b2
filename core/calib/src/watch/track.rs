//! Recent positions of one roundel in one camera, and its interpolated view at the centre of a bin.
//!
//! Positions within a bin, in the camera's frame, are fitted by a parabola in time and evaluated at the centre, so that
//! frames of different cameras need not be simultaneous and nothing is extrapolated. The model error is below
//! [`CURVATURE_M`] for a jerk of 5 m/s³. Outliers, such as reflections or another roundel, are rejected.

use nalgebra::{Matrix3, Vector3};

use super::BIN_S;
use roundel_vision::{
    id::KindId,
    marker::Code,
    pose::{Detection, RoundelPose},
    time::Timestamp,
};

/// Maximum number of positions: more than a second.
const MAX_SAMPLES: usize = 64;
/// Minimum interval of positions, nanoseconds. Half of the error persists between frames, so more than thirty a
/// second hardly add information.
const MIN_APART_NS: i64 = 18_000_000;
/// Minimum number of readings of a code …
const MIN_VOTES: u32 = 2;
/// … and minimum ratio to any other code.
const MAJORITY: u32 = 3;
/// Maximum number of votes for a code, so that a change of the roundel is noticed soon.
const MAX_VOTES: u32 = 30;
/// Maximum number of codes per roundel.
const MAX_CODES: usize = 4;
/// Minimum number of positions of a parabola.
const MIN_SAMPLES: usize = 3;
/// Minimum extent of the positions on both sides of the centre, as a share of half a bin.
const MIN_REACH: f64 = 0.3;
/// Maximum variance of the parabola at the centre, relative to one position.
const MAX_VARIANCE: f64 = 1.5;
/// Outliers are further than this and this number of squared deviations from the parabola.
const FAR_M: f64 = 0.005;
const FAR_SQUARED: f64 = 36.0;
/// Model error of the parabola, for each coordinate, metres.
const CURVATURE_M: f64 = 1.5e-4;
/// Maximum variance of usable positions, metres².
const WORST_M2: f64 = 1.0;

#[derive(Clone, Copy, Debug)]
struct Sample {
    time: Timestamp,
    position_m: Vector3<f64>,
    covariance: Matrix3<f64>,
}

/// View of a roundel at the centre of a bin.
#[derive(Clone, Copy, Debug)]
pub(super) struct RoundelView {
    pub(super) position_m: Vector3<f64>,
    /// Mean of the stated covariances.
    pub(super) covariance: Matrix3<f64>,
    /// Factor by which the average reduces independent noise.
    pub(super) fresh: f64,
    /// Additional independent variance per bin, for each coordinate, metres².
    pub(super) added_m2: f64,
}

#[derive(Clone, Debug)]
pub(super) struct RoundelTrack {
    pub(super) kind: KindId,
    pub(super) newest: Timestamp,
    samples: Vec<Sample>,
    votes: Vec<(Code, u32)>,
}

impl RoundelTrack {
    pub(super) fn new(kind: KindId, time: Timestamp) -> Self {
        Self { kind, newest: time, samples: Vec::new(), votes: Vec::new() }
    }

    /// Adds a detection with exposure at `time`.
    pub(super) fn add(&mut self, time: Timestamp, seen: &Detection, pose: &RoundelPose) {
        if let Some(reading) = &seen.ring.code {
            self.vote(reading.code);
        }
        self.newest = self.newest.max(time);
        let is_near = |sample: &Sample| time.ns_since(sample.time).saturating_abs() < MIN_APART_NS;
        if self.samples.last().is_some_and(is_near) {
            return;
        }
        let covariance = pose.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let is_valid = pose.position_m.iter().chain(covariance.iter()).all(|it| it.is_finite())
            && (0..3).all(|axis| covariance[(axis, axis)] > 0.0)
            && covariance.trace() < WORST_M2;
        if is_valid && self.samples.len() < MAX_SAMPLES {
            self.samples.push(Sample { time, position_m: pose.position_m, covariance });
        }
    }

    fn vote(&mut self, code: Code) {
        let Some(index) = self.votes.iter().position(|(voted, _)| *voted == code) else {
            if self.votes.len() < MAX_CODES {
                self.votes.push((code, 1));
            }
            return;
        };
        if self.votes[index].1 < MAX_VOTES {
            self.votes[index].1 += 1;
            return;
        }
        for (_, votes) in self.votes.iter_mut().filter(|(voted, _)| *voted != code) {
            *votes -= 1;
        }
        self.votes.retain(|(_, votes)| *votes > 0);
    }

    /// The accepted code: `Ok(None)` if none was read, an error while ambiguous.
    pub(super) fn code(&self) -> Result<Option<Code>, AmbiguousCode> {
        let Some(&(code, votes)) = self.votes.iter().max_by_key(|(_, votes)| *votes) else {
            return Ok(None);
        };
        let others = self.votes.iter().filter(|(other, _)| *other != code);
        let second = others.map(|(_, votes)| *votes).max().unwrap_or(0);
        if votes >= MIN_VOTES && votes >= MAJORITY * second {
            Ok(Some(code))
        } else {
            Err(AmbiguousCode)
        }
    }

    /// Drops the positions but not the code.
    pub(super) fn restart(&mut self) {
        self.samples.clear();
    }

    /// Drops the positions within the bin at this centre, and older ones.
    pub(super) fn forget(&mut self, bin_center: Timestamp) {
        let end = bin_center.plus_seconds(0.5 * BIN_S);
        self.samples.retain(|sample| sample.time >= end);
    }

    /// View at the centre of the bin; `None` with too few positions. `clock_s` is the uncertainty of the cameras'
    /// clocks.
    pub(super) fn view(&self, bin_center: Timestamp, clock_s: f64) -> Option<RoundelView> {
        let half_s = 0.5 * BIN_S;
        let samples =
            self.samples.iter().map(|it| (it.time.seconds_since(bin_center) / half_s, it));
        let mut in_bin: Vec<(f64, &Sample)> =
            samples.filter(|(time, _)| time.abs() <= 1.0).collect();
        let max_left_out = in_bin.len() / 4;
        for _ in 0..=max_left_out {
            let parabola = parabola(&in_bin)?;
            let Some(worst) = worst_outlier(&in_bin, &parabola) else {
                let count = in_bin.len() as f64;
                let covariance = in_bin.iter().map(|(_, it)| it.covariance).sum::<Matrix3<f64>>();
                let slip_m = parabola.terms[1].norm() / half_s * clock_s;
                return Some(RoundelView {
                    position_m: parabola.terms[0],
                    covariance: covariance / count,
                    fresh: parabola.variance,
                    added_m2: CURVATURE_M * CURVATURE_M + slip_m * slip_m,
                });
            };
            in_bin.swap_remove(worst);
        }
        None
    }
}

/// Codes were read, but none has a clear majority.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct AmbiguousCode;

/// Value, slope and curvature at the centre, and the variance of the value relative to one position.
struct Parabola {
    terms: [Vector3<f64>; 3],
    variance: f64,
}

fn parabola(in_bin: &[(f64, &Sample)]) -> Option<Parabola> {
    let reaches = |sign: f64| in_bin.iter().any(|(time, _)| time * sign >= MIN_REACH);
    if in_bin.len() < MIN_SAMPLES || !reaches(1.0) || !reaches(-1.0) {
        return None;
    }
    let (mut powers, mut sums) = ([0.0; 5], [Vector3::zeros(); 3]);
    for (time, sample) in in_bin {
        let mut power = 1.0;
        for index in 0..5 {
            powers[index] += power;
            if index < 3 {
                sums[index] += sample.position_m * power;
            }
            power *= time;
        }
    }
    let [p0, p1, p2, p3, p4] = powers;
    let inverse = Matrix3::new(p0, p1, p2, p1, p2, p3, p2, p3, p4).try_inverse()?;
    let variance = inverse[(0, 0)];
    let term = |row: usize| (0..3).map(|column| sums[column] * inverse[(row, column)]).sum();
    (variance > 0.0 && variance <= MAX_VARIANCE)
        .then(|| Parabola { terms: [term(0), term(1), term(2)], variance })
}

/// Index of the worst outlier, if there is one.
fn worst_outlier(in_bin: &[(f64, &Sample)], parabola: &Parabola) -> Option<usize> {
    let excess = |(time, sample): &(f64, &Sample)| {
        let [at, slope, bend] = &parabola.terms;
        let off_m = (sample.position_m - (at + slope * *time + bend * (time * time))).norm();
        let max_m = FAR_M + (FAR_SQUARED * sample.covariance.trace()).sqrt();
        off_m / max_m
    };
    let (worst, excess) =
        in_bin.iter().map(excess).enumerate().max_by(|one, other| one.1.total_cmp(&other.1))?;
    (excess > 1.0).then_some(worst)
}
