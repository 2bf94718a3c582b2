//! Evaluation: compares a recording with another system's trajectories, the truth.
//!
//! | module | purpose |
//! | --- | --- |
//! | [`truth`] | reads the other system's trajectories |
//! | [`estimate`] | reads the recording's trajectories |
//! | [`align`] | estimates the offset of clocks and the transform of frames |
//! | [`metrics`] | absolute and relative errors, jitter, latency, gaps |
//! | [`plots`] | plots of trajectories and errors |
//!
//! Metrics are those of `evo` (M. Grupp, *evo: Python package for the evaluation of odometry and SLAM*): absolute
//! trajectory error after one rigid alignment (S. Umeyama, 1991, without scale), relative error of consecutive pairs.
//! A test compares them with its results.

pub mod align;
pub mod estimate;
pub mod metrics;
pub mod plots;
pub mod truth;

use nalgebra::{UnitQuaternion, Vector3};
use roundel_core::time::Timestamp;
use thiserror::Error;

/// Pose at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// On the clock of its system.
    pub time: Timestamp,
    /// In the frame of its system.
    pub position_m: Vector3<f64>,
    /// `None`: unknown or not observed.
    pub orientation: Option<UnitQuaternion<f64>>,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    /// Name in its system, or empty.
    pub name: String,
    /// Strictly increasing in time.
    pub samples: Vec<Sample>,
}

/// Maximum step that is interpolated; longer steps are gaps.
const MAX_STEP_S: f64 = 0.25;

impl Trajectory {
    /// The interpolated pose at a time; `None` before the start, after the end, and within gaps.
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

#[derive(Debug, Error)]
pub enum EvalError {
    /// Invalid file of the other system; lines count from 1.
    #[error("{file}:{line}: {message}")]
    Truth { file: String, line: usize, message: String },
    #[error(transparent)]
    Recording(#[from] crate::archive::replay::ReplayError),
    /// The object is ambiguous or missing.
    #[error("{0}")]
    Object(String),
    #[error(
        "expected at least {MIN_PAIRS} common instants of recording and truth, found {found}; {hint}"
    )]
    Apart {
        found: usize,
        /// A possible reason.
        hint: String,
    },
}

/// Minimum number of common instants.
pub const MIN_PAIRS: usize = 10;
