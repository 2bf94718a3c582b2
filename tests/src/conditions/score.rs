//! Errors of poses under a condition, relative to the bound and to the stated covariances.

use nalgebra::{Isometry3, Matrix3, Vector3};
use roundel_core::pose::RoundelPose;

use crate::score::{CHI2_95_1, CHI2_95_2, CHI2_95_3, normal_error, normalized3};

/// Error of one pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseScore {
    /// Relative error of the range over its bound.
    pub depth: f64,
    /// Its stated deviation over the bound.
    pub stated: f64,
    /// Whether range, position and normal are inside their stated 95 %. No normal if the other one is right.
    pub inside: [Option<bool>; 3],
}

impl PoseScore {
    /// `range_share` is the bound of the range's relative deviation. A covariance that is not positive definite
    /// counts as outside.
    pub fn of(pose: &RoundelPose, truth: &Isometry3<f64>, range_share: f64) -> Self {
        let range_m = truth.translation.vector.norm();
        let ray = truth.translation.vector / range_m;
        let shift = pose.position_m - truth.translation.vector;
        let block = |corner: usize| -> Matrix3<f64> {
            pose.covariance.fixed_view::<3, 3>(corner, corner).into()
        };
        let (off_m, stated_m) = (shift.dot(&ray), ray.dot(&(block(0) * ray)).sqrt());
        let position = normalized3(&shift, &block(0));
        let normal = truth.rotation * Vector3::z();
        let angle = |one: &Vector3<f64>| one.cross(&normal).norm().atan2(one.dot(&normal));
        let is_first = angle(&pose.normal) <= angle(&pose.other_normal) + 1e-6;
        let turned = normal_error(&pose.normal, &normal, &block(3));
        Self {
            depth: off_m / range_m / range_share,
            stated: stated_m / range_m / range_share,
            inside: [
                Some((off_m / stated_m).powi(2) <= CHI2_95_1),
                Some(position.is_some_and(|square| square <= CHI2_95_3)),
                is_first.then(|| turned.is_some_and(|(_, square)| square <= CHI2_95_2)),
            ],
        }
    }
}

/// Statistics of trials under one condition in one mode.
#[derive(Clone, Debug, Default)]
pub struct Summary {
    pub trials: usize,
    /// Trials found in the first frame.
    pub found: usize,
    /// Later frames of trials that were found in the first.
    pub frames: usize,
    /// Those in which the roundel has a pose.
    pub followed: usize,
    /// Detections elsewhere.
    pub false_detections: usize,
    pub scores: Vec<PoseScore>,
}

impl Summary {
    pub fn add(&mut self, other: Self) {
        self.trials += other.trials;
        self.found += other.found;
        self.frames += other.frames;
        self.followed += other.followed;
        self.false_detections += other.false_detections;
        self.scores.extend(other.scores);
    }

    pub fn found_share(&self) -> f64 {
        self.found as f64 / self.trials as f64
    }

    pub fn followed_share(&self) -> f64 {
        self.followed as f64 / self.frames as f64
    }

    /// Rms of the depth's error over its bound.
    pub fn depth_over_bound(&self) -> f64 {
        let squares: f64 = self.scores.iter().map(|score| score.depth.powi(2)).sum();
        (squares / self.scores.len() as f64).sqrt()
    }

    /// Median of the depth's stated deviation over its bound.
    pub fn stated_over_bound(&self) -> f64 {
        let mut stated: Vec<f64> = self.scores.iter().map(|score| score.stated).collect();
        stated.sort_by(f64::total_cmp);
        stated.get(stated.len() / 2).copied().unwrap_or(f64::NAN)
    }

    /// Shares of ranges, positions and normals inside their stated 95 %.
    pub fn inside_shares(&self) -> [f64; 3] {
        [0, 1, 2].map(|quantity| {
            let judged = || self.scores.iter().filter_map(|score| score.inside[quantity]);
            judged().filter(|inside| *inside).count() as f64 / judged().count() as f64
        })
    }
}
