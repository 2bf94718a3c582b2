//! What one camera saw of one roundel of late, and its view of it in the middle of a bin.
//!
//! Positions in the camera's frame within a bin are fitted by a parabola over the time and taken in its middle,
//! so that frames of different cameras need not be at the same time and nothing is extrapolated. What a
//! motion with a jerk of 5 m/s³ leaves there is below [`BENT_M`]. A position far off the parabola, of another
//! roundel or a reflection, is left out.

use nalgebra::{Matrix3, Vector3};

use super::BIN_S;
use roundel_vision::{
    id::KindId,
    marker::Code,
    pose::{Detection, RoundelPose},
    time::Timestamp,
};

/// Positions kept of a roundel: more than a second of them.
const MOST_SAMPLES: usize = 64;
/// Positions that follow one another sooner are left out, nanoseconds: half of the error stays from frame to frame, so that
/// more than thirty a second say little and only cost time.
const LEAST_APART_NS: i64 = 18_000_000;
/// A code is believed when it was read so often …
const LEAST_VOTES: u32 = 2;
/// … and so many times as often as any other.
const MAJORITY: u32 = 3;
/// Votes of one code are held at this, so that a number that goes over to another roundel is believed soon.
const MOST_VOTES: u32 = 30;
/// Codes remembered of one roundel.
const MOST_CODES: usize = 4;
/// Fewer positions make no parabola.
const LEAST_SAMPLES: usize = 3;
/// Positions reach at least so far to either side of the bin's middle, as a share of its half.
const LEAST_REACH: f64 = 0.3;
/// The parabola's variance in the middle is at most so many times that of one position.
const MOST_VARIANCE: f64 = 1.5;
/// A position is left out that is further off the parabola than this and so many deviations.
const FAR_M: f64 = 0.005;
const FAR_SQUARED: f64 = 36.0;
/// What the parabola leaves of a motion, each coordinate, metres.
const BENT_M: f64 = 1.5e-4;
/// Worse positions say nothing, metres².
const WORST_M2: f64 = 1.0;

/// A position in the camera's frame.
#[derive(Clone, Copy, Debug)]
struct Sample {
    time: Timestamp,
    position_m: Vector3<f64>,
    covariance: Matrix3<f64>,
}

/// A camera's view of a roundel in the middle of a bin.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sight {
    /// Camera's frame, metres.
    pub(super) position_m: Vector3<f64>,
    /// As stated of one position.
    pub(super) covariance: Matrix3<f64>,
    /// By how much the bin averages what is fresh in every frame.
    pub(super) fresh: f64,
    /// What errs afresh in every bin beside, each coordinate, metres².
    pub(super) added_m2: f64,
}

/// One roundel as followed by one camera.
#[derive(Clone, Debug)]
pub(super) struct Trail {
    pub(super) kind: KindId,
    pub(super) newest: Timestamp,
    samples: Vec<Sample>,
    votes: Vec<(Code, u32)>,
}

impl Trail {
    pub(super) fn new(kind: KindId, time: Timestamp) -> Self {
        Self { kind, newest: time, samples: Vec::new(), votes: Vec::new() }
    }

    /// Takes in a detection whose exposure was at `time`.
    pub(super) fn add(&mut self, time: Timestamp, seen: &Detection, pose: &RoundelPose) {
        if let Some(reading) = &seen.ring.code {
            self.vote(reading.code);
        }
        self.newest = self.newest.max(time);
        let is_near =
            |sample: &Sample| time.ns_since(sample.time).saturating_abs() < LEAST_APART_NS;
        if self.samples.last().is_some_and(is_near) {
            return;
        }
        let covariance = pose.covariance.fixed_view::<3, 3>(0, 0).into_owned();
        let is_sound = pose.position_m.iter().chain(covariance.iter()).all(|it| it.is_finite())
            && (0..3).all(|axis| covariance[(axis, axis)] > 0.0)
            && covariance.trace() < WORST_M2;
        if is_sound && self.samples.len() < MOST_SAMPLES {
            self.samples.push(Sample { time, position_m: pose.position_m, covariance });
        }
    }

    fn vote(&mut self, code: Code) {
        let Some(index) = self.votes.iter().position(|(voted, _)| *voted == code) else {
            if self.votes.len() < MOST_CODES {
                self.votes.push((code, 1));
            }
            return;
        };
        if self.votes[index].1 < MOST_VOTES {
            self.votes[index].1 += 1;
            return;
        }
        for (_, votes) in self.votes.iter_mut().filter(|(voted, _)| *voted != code) {
            *votes -= 1;
        }
        self.votes.retain(|(_, votes)| *votes > 0);
    }

    /// The code that it is believed to have: `Ok(None)` if none was read, an error while that is in doubt.
    pub(super) fn code(&self) -> Result<Option<Code>, InDoubt> {
        let Some(&(code, votes)) = self.votes.iter().max_by_key(|(_, votes)| *votes) else {
            return Ok(None);
        };
        let others = self.votes.iter().filter(|(other, _)| *other != code);
        let second = others.map(|(_, votes)| *votes).max().unwrap_or(0);
        if votes >= LEAST_VOTES && votes >= MAJORITY * second {
            Ok(Some(code))
        } else {
            Err(InDoubt)
        }
    }

    /// Forgets where it was seen, not its code.
    pub(super) fn restart(&mut self) {
        self.samples.clear();
    }

    /// Forgets what is older than the end of the bin with this middle.
    pub(super) fn forget(&mut self, middle: Timestamp) {
        let end = middle.plus_seconds(0.5 * BIN_S);
        self.samples.retain(|sample| sample.time >= end);
    }

    /// The view in the middle of the bin; `None` if there is too little for it. `clock_s` is how well the
    /// cameras' clocks are known.
    pub(super) fn sight(&self, middle: Timestamp, clock_s: f64) -> Option<Sight> {
        let half_s = 0.5 * BIN_S;
        let mut within: Vec<(f64, &Sample)> = self
            .samples
            .iter()
            .map(|sample| (sample.time.seconds_since(middle) / half_s, sample))
            .filter(|(time, _)| time.abs() <= 1.0)
            .collect();
        let most_left_out = within.len() / 4;
        for _ in 0..=most_left_out {
            let parabola = parabola(&within)?;
            let Some(worst) = furthest(&within, &parabola) else {
                let count = within.len() as f64;
                let covariance = within.iter().map(|(_, it)| it.covariance).sum::<Matrix3<f64>>();
                let slip_m = parabola.terms[1].norm() / half_s * clock_s;
                return Some(Sight {
                    position_m: parabola.terms[0],
                    covariance: covariance / count,
                    fresh: parabola.variance,
                    added_m2: BENT_M * BENT_M + slip_m * slip_m,
                });
            };
            within.swap_remove(worst);
        }
        None
    }
}

/// A code was read, but which is not sure yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct InDoubt;

/// Value, slope and curvature in the middle, and the value's variance as a share of one position's.
struct Parabola {
    terms: [Vector3<f64>; 3],
    variance: f64,
}

fn parabola(within: &[(f64, &Sample)]) -> Option<Parabola> {
    let reaches = |sign: f64| within.iter().any(|(time, _)| time * sign >= LEAST_REACH);
    if within.len() < LEAST_SAMPLES || !reaches(1.0) || !reaches(-1.0) {
        return None;
    }
    let (mut powers, mut sums) = ([0.0; 5], [Vector3::zeros(); 3]);
    for (time, sample) in within {
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
    (variance > 0.0 && variance <= MOST_VARIANCE)
        .then(|| Parabola { terms: [term(0), term(1), term(2)], variance })
}

/// The position furthest off the parabola, if it is too far.
fn furthest(within: &[(f64, &Sample)], parabola: &Parabola) -> Option<usize> {
    let excess = |(time, sample): &(f64, &Sample)| {
        let [at, slope, bend] = &parabola.terms;
        let off_m = (sample.position_m - (at + slope * *time + bend * (time * time))).norm();
        let most_m = FAR_M + (FAR_SQUARED * sample.covariance.trace()).sqrt();
        off_m / most_m
    };
    let (worst, excess) =
        within.iter().map(excess).enumerate().max_by(|one, other| one.1.total_cmp(&other.1))?;
    (excess > 1.0).then_some(worst)
}
