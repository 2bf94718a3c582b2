//! Initial camera poses for the bundle adjustment.
//!
//! The relative pose of two cameras is the rigid motion between simultaneous positions of the same roundels, fitted with
//! iteratively reweighted least squares. A wrong clock offset increases the residual of moving roundels, so the offset
//! with the smallest residual is searched on a grid and refined by bisection. Starting with the cameras that see the
//! references, the strongest relative poses locate all others (Prim 1957).

use nalgebra::Vector3;
use rayon::prelude::*;

use super::{Roundel, recording::Sample};
use crate::robust::median;
use roundel_fusion::world::reference::{kabsch, spread};
use roundel_vision::rigid::Rigid;

/// Maximum clock offset, seconds …
const MAX_OFFSET_S: f64 = 0.6;
/// … step of the grid, and of the refined offset.
const GRID_S: f64 = 0.04;
const FINE_S: f64 = 0.001;
/// Maximum gap that is interpolated, seconds.
const GAP_S: f64 = 0.2;
/// Maximum number of position pairs for a relative pose.
const MAX_PAIRS: usize = 600;
const MIN_PAIRS: usize = 8;
const ROUNDS: usize = 6;
/// Minimum rms spread of the pairs in two directions, metres.
pub(super) const MIN_SPREAD_M: f64 = 0.15;

#[derive(Clone, Copy, Debug)]
pub(super) struct RelativePose {
    one: usize,
    other: usize,
    pub(super) alignment: Alignment,
}

impl RelativePose {
    /// The other camera, if this is one of both.
    pub(super) fn partner(&self, camera: usize) -> Option<usize> {
        let Self { one, other, .. } = *self;
        if camera == one { Some(other) } else { (camera == other).then_some(one) }
    }

    fn strength(&self) -> f64 {
        let Alignment { pairs, spread_m, median_residual_m, .. } = self.alignment;
        (pairs as f64).sqrt() * spread_m / median_residual_m.max(1e-4)
    }
}

/// Relative poses of all cameras with common roundels, in the order of cameras.
pub(super) fn relative_poses(roundels: &[Roundel], cameras: usize) -> Vec<RelativePose> {
    let camera_pairs: Vec<(usize, usize)> =
        (0..cameras).flat_map(|one| (0..one).map(move |other| (other, one))).collect();
    let relative_pose = |(one, other): (usize, usize)| {
        let shared: Vec<SharedTracks<'_>> = roundels
            .iter()
            .filter_map(|roundel| Some((roundel.samples(one)?, roundel.samples(other)?)))
            .collect();
        Some(RelativePose { one, other, alignment: align(&shared)? })
    };
    camera_pairs.into_par_iter().filter_map(relative_pose).collect()
}

/// Poses and clock offsets of cameras, from the known `camera_poses`; `None` if no relative pose leads there.
pub(super) fn propagate(
    placed: &[Option<Rigid>],
    relative_poses: &[RelativePose],
) -> Vec<Option<(Rigid, f64)>> {
    let mut found_poses: Vec<Option<(Rigid, f64)>> =
        placed.iter().map(|place| place.map(|place| (place, 0.0))).collect();
    let mut is_timed: Vec<bool> = vec![false; placed.len()];
    // Offsets are relative to the first camera that sees references, or to the first one of a separate group.
    while let Some(root) =
        (0..placed.len()).find(|&root| found_poses[root].is_some() && !is_timed[root])
    {
        is_timed[root] = true;
        while let Some(relative_pose) = strongest(relative_poses, &is_timed) {
            let RelativePose { one, other, alignment } = relative_pose;
            let Alignment { one_from_other, ahead_s, .. } = *alignment;
            let (from, to, from_to, ahead_s) = if is_timed[*one] {
                (*one, *other, one_from_other, ahead_s)
            } else {
                (*other, *one, one_from_other.inverse(), -ahead_s)
            };
            is_timed[to] = true;
            let Some((place, before_s)) = found_poses[from] else { continue };
            found_poses[to] = Some((placed[to].unwrap_or(place * from_to), before_s + ahead_s));
        }
    }
    found_poses
}

/// The strongest relative pose from a located camera to another one.
fn strongest<'a>(
    relative_poses: &'a [RelativePose],
    is_known: &[bool],
) -> Option<&'a RelativePose> {
    let leads_on =
        |it: &&RelativePose| it.alignment.is_determined() && is_known[it.one] != is_known[it.other];
    relative_poses.iter().filter(leads_on).max_by(|a, b| a.strength().total_cmp(&b.strength()))
}

/// Alignment of the tracks of two cameras.
#[derive(Clone, Copy, Debug)]
pub(super) struct Alignment {
    pub(super) one_from_other: Rigid,
    /// Clock of the other camera minus the clock of the one.
    pub(super) ahead_s: f64,
    /// Number of aligned pairs of positions.
    pub(super) pairs: usize,
    /// Their rms spread in two directions, metres; below [`MIN_SPREAD_M`] the rotation is undetermined.
    pub(super) spread_m: f64,
    /// Median distance of the aligned pairs, metres.
    pub(super) median_residual_m: f64,
}

impl Alignment {
    pub(super) fn is_determined(&self) -> bool {
        self.spread_m >= MIN_SPREAD_M
    }

    /// Median distance of two aligned tracks, metres; `None` if they have too little in common.
    pub(super) fn distance_m(&self, tracks: &SharedTracks<'_>) -> Option<f64> {
        let stride = (tracks.0.len() / MAX_PAIRS).max(1);
        let pairs = pairs(std::slice::from_ref(tracks), stride, self.ahead_s);
        let mut distances: Vec<f64> =
            pairs.iter().map(|pair| distance_m(&self.one_from_other, pair)).collect();
        if distances.len() < MIN_PAIRS { None } else { median(&mut distances) }
    }
}

/// Samples of one roundel in one camera and in the other.
pub(super) type SharedTracks<'a> = (&'a [Sample], &'a [Sample]);

/// The best rigid motion and clock offset.
pub(super) fn align(shared: &[SharedTracks<'_>]) -> Option<Alignment> {
    let total: usize = shared.iter().map(|(samples, _)| samples.len()).sum();
    let stride = (total / MAX_PAIRS).max(1);
    let aligned = |ahead_s: f64| fit(&pairs(shared, stride, ahead_s), ahead_s);
    let steps = (MAX_OFFSET_S / GRID_S).round() as i32;
    let grid = (-steps..=steps).map(|step| f64::from(step) * GRID_S);
    let score = |ahead_s: f64| aligned(ahead_s).map_or(f64::INFINITY, |it| it.median_residual_m);
    let mut best_s = grid.min_by(|a, b| score(*a).total_cmp(&score(*b)))?;
    let mut step_s = GRID_S / 2.0;
    while step_s > FINE_S {
        let near = [best_s, best_s - step_s, best_s + step_s].into_iter();
        best_s = near.min_by(|a, b| score(*a).total_cmp(&score(*b)))?;
        step_s /= 2.0;
    }
    aligned(best_s)
}

/// Simultaneous positions for this clock offset.
fn pairs(shared: &[SharedTracks<'_>], stride: usize, ahead_s: f64) -> Vec<[Vector3<f64>; 2]> {
    let mut pairs = Vec::new();
    for (ones, others) in shared {
        for one in ones.iter().step_by(stride) {
            if let Some(other_m) = interpolate(others, one.stamp_s + ahead_s) {
                pairs.push([one.position_m, other_m]);
            }
        }
    }
    pairs
}

/// Linear interpolation between two samples.
pub(super) fn interpolate(samples: &[Sample], stamp_s: f64) -> Option<Vector3<f64>> {
    let after = samples.partition_point(|sample| sample.stamp_s < stamp_s);
    let (before, after) = (samples.get(after.checked_sub(1)?)?, samples.get(after)?);
    let gap_s = after.stamp_s - before.stamp_s;
    let share = if gap_s > 0.0 { (stamp_s - before.stamp_s) / gap_s } else { 0.0 };
    (gap_s < GAP_S).then(|| before.position_m.lerp(&after.position_m, share))
}

fn distance_m(one_from_other: &Rigid, [one, other]: &[Vector3<f64>; 2]) -> f64 {
    (one - one_from_other.transform_point(&(*other).into()).coords).norm()
}

/// Rigid motion by iteratively reweighted least squares.
fn fit(pairs: &[[Vector3<f64>; 2]], ahead_s: f64) -> Option<Alignment> {
    if pairs.len() < MIN_PAIRS {
        return None;
    }
    let mut weights = vec![1.0; pairs.len()];
    let others: Vec<Vector3<f64>> = pairs.iter().map(|[_, other]| *other).collect();
    let mut found = None;
    for _ in 0..ROUNDS {
        let (rotation, origin_m, _) = kabsch(pairs, &weights);
        let one_from_other = Rigid::from_parts(origin_m.into(), rotation.into());
        let [_, spread_m] = spread(&others, &weights);
        let distances: Vec<f64> =
            pairs.iter().map(|pair| distance_m(&one_from_other, pair)).collect();
        let median_residual_m = median(&mut distances.clone())?;
        let wide = (2.0 * median_residual_m).max(1e-6);
        for (weight, distance_m) in weights.iter_mut().zip(&distances) {
            *weight = (1.0 + (distance_m / wide).powi(2)).powi(-2);
        }
        let pairs = pairs.len();
        found = Some(Alignment { one_from_other, ahead_s, pairs, spread_m, median_residual_m });
    }
    found
}
