//! Bundle adjustment over all cameras and times.
//!
//! Unknowns: pose, clock and optionally lens of each camera, and the spline of each roundel. The splines are eliminated
//! exactly ([`super::track_block`]), in parallel over roundels; sums are made in the order of roundels, so the result is
//! reproducible. The reduced camera equations are solved by damped steps
//! ([`crate::least_squares`]).
//!
//! The initial poses may be off by centimetres while a sighting is good to half a millimetre. The scale of the robust loss
//! therefore starts at the observed residuals and decreases with their median (graduated non-convexity: Blake, Zisserman
//! 1987).
//!
//! The covariance is K = H⁻¹ M H⁻¹ with the information H of the cameras and the scatter M of the gradients of time blocks
//! of [`BLOCK_S`] (White 1980; Liang, Zeger 1986), because errors of a roundel in a camera are correlated over about a
//! second. References and priors contribute to M as stated.

use nalgebra::DMatrix;
use rayon::prelude::*;

use super::{
    super::error::ArenaError,
    camera_block::CameraBlock,
    spline::Spline,
    track_block::{Reduced, TrackBlock, loss, unknowns_per_camera},
};
use crate::{
    least_squares::{Damping, LeastSquares, NormalEquations},
    robust::median,
};

/// Final scale of the robust loss (χ², 3 degrees of freedom: 1 - 10⁻³).
const SCALE: f64 = 16.0;
/// Scale without robust weights.
const UNWEIGHTED: f64 = 1e12;
/// Median of χ² with 3 degrees of freedom.
const MEDIAN: f64 = 2.366;
/// Duration of independent time blocks, seconds.
const BLOCK_S: f64 = 5.0;
const MAX_STEPS: usize = 60;
/// The adjustment ends when no unknown changes by more than this, in standard deviations.
const CONVERGED: f64 = 1e-3;
const MAX_DAMPING: f64 = 1e6;

pub(crate) struct Bundle {
    pub(crate) blocks: Vec<CameraBlock>,
    pub(crate) tracks: Vec<TrackBlock>,
    /// Largest change of an unknown in the last step, in its conditional standard deviation.
    step_length: f64,
}

pub(crate) struct Outcome {
    /// Over the unknowns of all cameras.
    pub(crate) covariance: DMatrix<f64>,
    pub(crate) steps: usize,
    /// Median ratio of errors to stated deviations.
    pub(crate) excess: f64,
}

pub(crate) struct Equations {
    normal: NormalEquations,
    reduced: Vec<Reduced>,
}

impl LeastSquares for Bundle {
    type Normal = Equations;

    fn cost(&self, scale: f64) -> Option<f64> {
        let parts: Vec<f64> =
            self.tracks.par_iter().map(|track| track.cost(&self.blocks, scale)).collect();
        let dims = unknowns_per_camera(&self.blocks);
        let priors = self.blocks.iter().flat_map(|block| block.priors(dims));
        let priors = priors.map(|(_, value, weight)| value * value * weight);
        Some(parts.iter().sum::<f64>() + priors.sum::<f64>())
    }

    fn normal(&self, scale: f64) -> Option<Equations> {
        let dims = unknowns_per_camera(&self.blocks);
        let size = dims * self.blocks.len();
        let reduced = self.tracks.par_iter().map(|track| track.reduce(&self.blocks, scale));
        let reduced: Vec<Reduced> = reduced.collect::<Option<_>>()?;
        let mut normal = NormalEquations::zeros(size);
        let NormalEquations { information, gradient } = &mut normal;
        for (track, part) in self.tracks.iter().zip(&reduced) {
            let columns = columns_of(&track.cameras, dims);
            for (i, &row) in columns.iter().enumerate() {
                gradient[row] += part.gradient[i];
            }
            add_block(information, &columns, |i, j| part.information[i * columns.len() + j]);
        }
        for (camera, block) in self.blocks.iter().enumerate() {
            for (number, value, weight) in block.priors(dims) {
                let at = camera * dims + number;
                information[(at, at)] += weight;
                gradient[at] -= weight * value;
            }
        }
        Some(Equations { normal, reduced })
    }

    fn stepped(&self, equations: &Equations, damping: f64) -> Option<Self> {
        let change = equations.normal.step(damping)?;
        let along = |i: usize| change[i].abs() * equations.normal.information[(i, i)].sqrt();
        let step_length = (0..change.len()).map(along).fold(0.0, f64::max);
        let dims = unknowns_per_camera(&self.blocks);
        let blocks = std::iter::zip(&self.blocks, change.as_slice().chunks_exact(dims))
            .map(|(block, step)| block.moved(step))
            .collect();
        let stepped = |(track, reduced): (&TrackBlock, &Reduced)| {
            let columns = columns_of(&track.cameras, dims);
            let step: Vec<f64> = columns.iter().map(|&column| change[column]).collect();
            TrackBlock { spline: track.stepped(reduced, &step), ..track.clone() }
        };
        let tracks = self.tracks.par_iter().zip(&equations.reduced).map(stepped).collect();
        Some(Self { blocks, tracks, step_length })
    }
}

impl Bundle {
    pub(crate) fn new(blocks: Vec<CameraBlock>, tracks: Vec<TrackBlock>) -> Self {
        Self { blocks, tracks, step_length: f64::INFINITY }
    }

    /// Adjusts everything. Calls `go_on` before each step with the number of steps and the length of the last one
    /// in standard deviations.
    pub(crate) fn adjust(
        &mut self,
        mut go_on: impl FnMut(usize, f64) -> bool,
    ) -> Result<Outcome, ArenaError> {
        self.solve_splines().ok_or(ArenaError::Undetermined)?;
        let mut damping = Damping { value: 1e-6, min: 1e-9, max: MAX_DAMPING };
        for step in 0..MAX_STEPS {
            if !go_on(step, self.step_length) {
                return Err(ArenaError::Cancelled);
            }
            let scale = self.scale();
            let lower = self.cost(scale).and_then(|cost| damping.step(self, scale, cost));
            let lower = lower.ok_or(ArenaError::Undetermined)?;
            if lower.is_none() || self.step_length < CONVERGED {
                return self.outcome(step + 1).ok_or(ArenaError::Undetermined);
            }
        }
        self.outcome(MAX_STEPS).ok_or(ArenaError::Undetermined)
    }

    /// Fits the splines to the current cameras: unweighted first, then robustly.
    fn solve_splines(&mut self) -> Option<()> {
        for is_first in [true, false] {
            let scale = if is_first { UNWEIGHTED } else { self.scale() };
            let tracks = self.tracks.par_iter();
            let solved = |track: &TrackBlock| {
                let reduced = track.reduce(&self.blocks, scale)?;
                Some(track.stepped(&reduced, &vec![0.0; reduced.gradient.len()]))
            };
            let splines: Vec<Spline> = tracks.map(solved).collect::<Option<_>>()?;
            for (track, spline) in self.tracks.iter_mut().zip(splines) {
                track.spline = spline;
            }
        }
        Some(())
    }

    /// Scale of the robust loss: squares of this size have a quarter of their weight.
    fn scale(&self) -> f64 {
        SCALE * self.excess_squared().max(1.0)
    }

    /// Median square over its expectation.
    fn excess_squared(&self) -> f64 {
        let mut squares: Vec<f64> =
            self.tracks.par_iter().flat_map_iter(|track| track.squares(&self.blocks)).collect();
        excess_squared(&mut squares)
    }

    fn outcome(&self, steps: usize) -> Option<Outcome> {
        let scale = self.scale();
        let covariance = self.covariance(&self.normal(scale)?, scale)?;
        Some(Outcome { covariance, steps, excess: self.excess_squared().sqrt() })
    }

    fn covariance(&self, equations: &Equations, scale: f64) -> Option<DMatrix<f64>> {
        let dims = unknowns_per_camera(&self.blocks);
        let size = equations.normal.gradient.len();
        let inverse = equations.normal.information.clone().cholesky()?.inverse();
        let scores = |(track, reduced): (&TrackBlock, &Reduced)| match track.stated {
            // Errors of references are those stated.
            Some(_) => Vec::new(),
            None => track.scores(reduced, &self.blocks, scale, BLOCK_S),
        };
        let scores: Vec<Vec<Vec<f64>>> =
            self.tracks.par_iter().zip(&equations.reduced).map(scores).collect();
        let (mut spread_of, mut stated) = (DMatrix::zeros(size, size), DMatrix::zeros(size, size));
        let mut moving = DMatrix::zeros(size, size);
        let mut block_count = 0;
        for ((track, reduced), scores) in self.tracks.iter().zip(&equations.reduced).zip(&scores) {
            let columns = columns_of(&track.cameras, dims);
            let target = if track.stated.is_some() { &mut stated } else { &mut moving };
            add_block(target, &columns, |i, j| reduced.information[i * columns.len() + j]);
            for score in scores {
                add_block(&mut spread_of, &columns, |i, j| score[i] * score[j]);
            }
            block_count += scores.len();
        }
        for (camera, block) in self.blocks.iter().enumerate() {
            for (number, _, weight) in block.priors(dims) {
                stated[(camera * dims + number, camera * dims + number)] += weight;
            }
        }
        if block_count > 0 {
            // With few blocks, blend with the stated covariance scaled by their mean inflation.
            let part = |middle: &DMatrix<f64>| (&inverse * middle * &inverse).trace();
            let inflation = part(&spread_of) / part(&moving).max(f64::MIN_POSITIVE);
            let few = size as f64 / (size + block_count) as f64;
            spread_of = spread_of * (1.0 - few) + moving * (inflation * few);
        }
        Some(&inverse * (spread_of + stated) * &inverse)
    }
}

/// Median of squared errors with three components over its expectation; 1 if empty.
pub(crate) fn excess_squared(squares: &mut [f64]) -> f64 {
    median(squares).map_or(1.0, |median| median.min(1e12) / MEDIAN)
}

fn columns_of(cameras: &[usize], dims: usize) -> Vec<usize> {
    cameras.iter().flat_map(|camera| camera * dims..(camera + 1) * dims).collect()
}

/// Adds the entries of a block to these rows and columns of a sum.
fn add_block(sum: &mut DMatrix<f64>, columns: &[usize], entry: impl Fn(usize, usize) -> f64) {
    for (i, &row) in columns.iter().enumerate() {
        for (j, &column) in columns.iter().enumerate() {
            sum[(row, column)] += entry(i, j);
        }
    }
}

/// Whether a sighting with this square has less than a quarter of its weight.
pub(crate) fn is_outlier(square: f64, excess: f64) -> bool {
    let scale = SCALE * (excess * excess).max(1.0);
    loss(square, scale) > 0.5 * scale
}
