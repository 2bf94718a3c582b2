//! Evaluation: a recording beside another system's trajectories.
//!
//! | module | what it does |
//! | --- | --- |
//! | [`truth`] | reads what the other system says |
//! | [`estimate`] | reads what the recording says |
//! | [`align`] | by how much clocks and frames differ |
//! | [`metrics`] | absolute and relative errors, jitter, latency, gaps |
//! | [`plots`] | the same as pictures |
//!
//! Figures are those of `evo` (M. Grupp, *evo: Python package for the evaluation of odometry and SLAM*): absolute
//! trajectory error after one rigid alignment (S. Umeyama, 1991, without scale), relative error of consecutive pairs.
//! `tests/tests/eval.rs` holds them against it.

pub mod align;
pub mod estimate;
pub mod metrics;
pub mod plots;
pub mod truth;

use nalgebra::{UnitQuaternion, Vector3};
use roundel_core::time::Timestamp;
use thiserror::Error;

/// Where something was at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// When, on its system's clock.
    pub time: Timestamp,
    /// Metres, in its system's frame.
    pub position_m: Vector3<f64>,
    /// Its frame's axes in the system's; `None`: not said, or not observed.
    pub orientation: Option<UnitQuaternion<f64>>,
}

/// Where one thing was, in the order of time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    /// What it is called there; empty: nothing.
    pub name: String,
    /// Times grow strictly.
    pub samples: Vec<Sample>,
}

/// Two trajectories are compared with linear interpolation over no more than this: beyond, there is a gap.
const MAX_STEP_S: f64 = 0.25;

impl Trajectory {
    /// Where it was then; `None` before its begin, after its end, and within gaps.
    pub fn at(&self, time: Timestamp) -> Option<Sample> {
        let after = self.samples.partition_point(|sample| sample.time < time);
        let next = self.samples.get(after)?;
        if next.time == time {
            return Some(*next);
        }
        let last = self.samples.get(after.checked_sub(1)?)?;
        let step_s = next.time.seconds_since(last.time);
        if step_s > MAX_STEP_S {
            return None;
        }
        let share = time.seconds_since(last.time) / step_s;
        let orientation = match (last.orientation, next.orientation) {
            (Some(last), Some(next)) => last.try_slerp(&next, share, 1e-9).or(Some(last)),
            _ => None,
        };
        let position_m = last.position_m.lerp(&next.position_m, share);
        Some(Sample { time, position_m, orientation })
    }
}

/// Why there is nothing to compare.
#[derive(Debug, Error)]
pub enum EvalError {
    /// The other system's file is not what it should be.
    #[error("{file}:{line}: {message}")]
    Truth {
        file: String,
        /// Where in it, from 1.
        line: usize,
        /// What was expected, and what was found.
        message: String,
    },
    /// The recording cannot be read.
    #[error(transparent)]
    Recording(#[from] crate::archive::replay::ReplayError),
    /// Which object is meant is not clear, or it is not there.
    #[error("{0}")]
    Object(String),
    /// There are too few instants at which both say something.
    #[error(
        "the recording and the truth have {found} instants in common, and at least {MIN_PAIRS} are needed; {hint}"
    )]
    Apart {
        found: usize,
        /// What may be the matter.
        hint: String,
    },
}

pub const MIN_PAIRS: usize = 10;
