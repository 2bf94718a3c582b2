//! Where cameras are, roughly: what the bundle starts from.
//!
//! Two cameras that saw the same roundels at the same times are tied by the rigid motion between what
//! they saw, weighed anew by how well each pair fits until wrong ones say nothing. If their
//! clocks differ, moving roundels fit badly; the offset is that of the best fit, found on a grid and then
//! by halving. From cameras that see the references, the strongest ties lead to all others (Prim 1957).

use std::collections::BTreeMap;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::recording::Sample;
use roundel_fusion::world::reference::{kabsch, spread};
use roundel_vision::rigid::Rigid;

/// Clocks are looked for this far apart, seconds …
const FARTHEST_S: f64 = 0.6;
/// … on a grid of this, and then to this.
const GRID_S: f64 = 0.04;
const FINE_S: f64 = 0.001;
/// Between samples further apart than this nothing is filled in, seconds.
const GAP_S: f64 = 0.2;
/// Pairs that one tie is computed from.
const MOST_PAIRS: usize = 600;
const LEAST_PAIRS: usize = 8;
const ROUNDS: usize = 6;
/// A tie needs pairs spread across two directions by this much, rms, metres.
pub(super) const LEAST_SPREAD_M: f64 = 0.15;

/// How two cameras stand to one another.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tie {
    pub(super) one: usize,
    pub(super) other: usize,
    pub(super) one_from_other: Rigid,
    /// What the other's stamps are ahead of the one's.
    pub(super) ahead_s: f64,
    pub(super) pairs: usize,
    /// Across two directions; below [`LEAST_SPREAD_M`] the turn is not known.
    pub(super) spread_m: f64,
    /// Median distance left.
    pub(super) left_m: f64,
}

impl Tie {
    pub(super) fn holds(&self) -> bool {
        self.spread_m >= LEAST_SPREAD_M
    }

    fn strength(&self) -> f64 {
        (self.pairs as f64).sqrt() * self.spread_m / self.left_m.max(1e-4)
    }
}

/// One camera's sightings by roundel.
pub(super) type Sights<'a> = BTreeMap<usize, &'a [Sample]>;

/// All ties between cameras that saw roundels in common, in the order of cameras.
pub(super) fn ties(cameras: &[Sights<'_>]) -> Vec<Tie> {
    let couples: Vec<(usize, usize)> =
        (0..cameras.len()).flat_map(|one| (0..one).map(move |other| (other, one))).collect();
    couples.into_par_iter().filter_map(|(one, other)| tie(cameras, one, other)).collect()
}

/// Place and clock of each camera from those that are `placed`; `None` where no tie leads.
pub(super) fn spread_out(placed: &[Option<Rigid>], ties: &[Tie]) -> Vec<Option<(Rigid, f64)>> {
    let mut known: Vec<Option<(Rigid, f64)>> =
        placed.iter().map(|place| place.map(|place| (place, 0.0))).collect();
    let mut is_timed: Vec<bool> = vec![false; placed.len()];
    // Clocks are counted from the first camera that sees references; only what no tie leads to begins anew.
    while let Some(root) = (0..placed.len()).find(|&root| known[root].is_some() && !is_timed[root])
    {
        is_timed[root] = true;
        while let Some(tie) = strongest(ties, &is_timed) {
            let is_forth = is_timed[tie.one];
            let (from, to) = if is_forth { (tie.one, tie.other) } else { (tie.other, tie.one) };
            let (from_to, ahead_s) = if is_forth {
                (tie.one_from_other, tie.ahead_s)
            } else {
                (tie.one_from_other.inverse(), -tie.ahead_s)
            };
            is_timed[to] = true;
            let Some((place, before_s)) = known[from] else { continue };
            known[to] = Some((placed[to].unwrap_or(place * from_to), before_s + ahead_s));
        }
    }
    known
}

/// Of the ties that lead from what is known to what is not.
fn strongest<'a>(ties: &'a [Tie], is_known: &[bool]) -> Option<&'a Tie> {
    ties.iter()
        .filter(|tie| tie.holds() && is_known[tie.one] != is_known[tie.other])
        .max_by(|a, b| a.strength().total_cmp(&b.strength()))
}

fn tie(cameras: &[Sights<'_>], one: usize, other: usize) -> Option<Tie> {
    let shared: Vec<Courses<'_>> = cameras[one]
        .iter()
        .filter_map(|(subject, samples)| Some((*samples, *cameras[other].get(subject)?)))
        .collect();
    let Aligned { fit: Fit { one_from_other, spread_m, left_m, pairs }, ahead_s } = align(&shared)?;
    Some(Tie { one, other, one_from_other, ahead_s, pairs, spread_m, left_m })
}

/// What two cameras saw of the same, laid upon one another.
pub(super) struct Aligned {
    pub(super) fit: Fit,
    /// What the other's stamps are ahead of the one's.
    pub(super) ahead_s: f64,
}

impl Aligned {
    /// Median distance of two courses so laid, metres; `None` if they have too little in common.
    pub(super) fn apart_m(&self, courses: &Courses<'_>) -> Option<f64> {
        let stride = (courses.0.len() / MOST_PAIRS).max(1);
        let pairs = pairs(std::slice::from_ref(courses), stride, self.ahead_s);
        let mut distances: Vec<f64> =
            pairs.iter().map(|pair| apart_m(&self.fit.one_from_other, pair)).collect();
        let middle = distances.len() / 2;
        (distances.len() >= LEAST_PAIRS)
            .then(|| *distances.select_nth_unstable_by(middle, f64::total_cmp).1)
    }
}

/// Sightings of one roundel by one camera and by the other.
pub(super) type Courses<'a> = (&'a [Sample], &'a [Sample]);

/// The rigid motion and the clocks' difference that fit best.
pub(super) fn align(shared: &[Courses<'_>]) -> Option<Aligned> {
    let total: usize = shared.iter().map(|(samples, _)| samples.len()).sum();
    let stride = (total / MOST_PAIRS).max(1);
    let left = |ahead_s: f64| fit(&pairs(shared, stride, ahead_s));
    let steps = (FARTHEST_S / GRID_S).round() as i32;
    let grid = (-steps..=steps).map(|step| f64::from(step) * GRID_S);
    let score = |ahead_s: f64| left(ahead_s).map_or(f64::INFINITY, |fit| fit.left_m);
    let mut best_s = grid.min_by(|a, b| score(*a).total_cmp(&score(*b)))?;
    let mut step_s = GRID_S / 2.0;
    while step_s > FINE_S {
        best_s = [best_s, best_s - step_s, best_s + step_s]
            .into_iter()
            .min_by(|a, b| score(*a).total_cmp(&score(*b)))?;
        step_s /= 2.0;
    }
    Some(Aligned { fit: left(best_s)?, ahead_s: best_s })
}

/// Where both saw the same at the same time, if the other's stamps are so far ahead.
fn pairs(shared: &[Courses<'_>], stride: usize, ahead_s: f64) -> Vec<[Vector3<f64>; 2]> {
    let mut pairs = Vec::new();
    for (ones, others) in shared {
        for one in ones.iter().step_by(stride) {
            if let Some(other_m) = at_once(others, one.stamp_s + ahead_s) {
                pairs.push([one.place_m, other_m]);
            }
        }
    }
    pairs
}

/// Where it was between two sightings.
pub(super) fn at_once(samples: &[Sample], stamp_s: f64) -> Option<Vector3<f64>> {
    let after = samples.partition_point(|sample| sample.stamp_s < stamp_s);
    let (before, after) = (samples.get(after.checked_sub(1)?)?, samples.get(after)?);
    let gap_s = after.stamp_s - before.stamp_s;
    let share = if gap_s > 0.0 { (stamp_s - before.stamp_s) / gap_s } else { 0.0 };
    (gap_s < GAP_S).then(|| before.place_m.lerp(&after.place_m, share))
}

/// A rigid motion with what speaks for it.
pub(super) struct Fit {
    pub(super) one_from_other: Rigid,
    /// Across two directions, rms, metres.
    pub(super) spread_m: f64,
    /// Median distance left, metres.
    pub(super) left_m: f64,
    pub(super) pairs: usize,
}

fn apart_m(one_from_other: &Rigid, [one, other]: &[Vector3<f64>; 2]) -> f64 {
    (one - one_from_other.transform_point(&(*other).into()).coords).norm()
}

/// The rigid motion, wrong pairs left out.
fn fit(pairs: &[[Vector3<f64>; 2]]) -> Option<Fit> {
    if pairs.len() < LEAST_PAIRS {
        return None;
    }
    let mut weights = vec![1.0; pairs.len()];
    let others: Vec<Vector3<f64>> = pairs.iter().map(|[_, other]| *other).collect();
    let mut found = None;
    for _ in 0..ROUNDS {
        let (rotation, origin_m, _) = kabsch(pairs, &weights);
        let one_from_other = Rigid::from_parts(origin_m.into(), rotation.into());
        let [_, spread_m] = spread(&others, &weights);
        let distances: Vec<f64> = pairs.iter().map(|pair| apart_m(&one_from_other, pair)).collect();
        let mut sorted = distances.clone();
        let middle = sorted.len() / 2;
        let left_m = *sorted.select_nth_unstable_by(middle, f64::total_cmp).1;
        let wide = (2.0 * left_m).max(1e-6);
        for (weight, distance_m) in weights.iter_mut().zip(&distances) {
            *weight = (1.0 + (distance_m / wide).powi(2)).powi(-2);
        }
        found = Some(Fit { one_from_other, spread_m, left_m, pairs: pairs.len() });
    }
    found
}
