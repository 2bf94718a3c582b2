//! Attributes disagreements to the cameras that moved.
//!
//! Freeing the poses of some cameras, with all others fixed, reduces the total cost of all co-observations. A camera that
//! moved disagrees with every other one, and freeing it restores agreement; freeing one of the others cannot make it agree
//! with the moved camera and with the rest at once. Among all single cameras, and all pairs if no single one suffices, the
//! hypothesis of the lowest cost is chosen unless another costs hardly more. Two cameras alone explain a disagreement
//! equally well, so it remains unclear which one moved.

use std::collections::BTreeSet;

use super::{
    co_observation::Roundel,
    pose_fit::{Comparison, PoseFit, cost, excess, first_gain, fit_pose},
};
use roundel_vision::rigid::Rigid;

/// Smaller gains are noise: χ² of 6 beyond 1 - 10⁻¹⁰.
const SURE_GAIN: f64 = 60.0;
/// Minimum gain of a camera's first step.
const FIRST_GAIN: f64 = 30.0;
/// Hypotheses within this cost, and this share of the gain, of the best one are equally likely.
const CLEAR_COST: f64 = 30.0;
const CLEAR_SHARE: f64 = 0.01;
/// Minimum number of roundels, since a code may be shown twice.
const MIN_ROUNDELS: usize = 2;
/// Number of best single cameras that are combined into pairs.
const MAX_FIRST_CAMERAS: usize = 4;
/// Alternations between two freed cameras.
const TURNS: usize = 6;

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Verdict {
    /// No significant disagreement.
    Agreed,
    /// These slots moved, with their new poses.
    Moved(Vec<(usize, Rigid)>),
    /// One of these slots moved.
    Unclear(Vec<usize>),
}

/// Freed cameras and the result.
struct Hypothesis {
    freed: Vec<(usize, PoseFit)>,
    cost: f64,
    comparisons: Vec<Comparison>,
}

impl Hypothesis {
    fn slots(&self) -> Vec<usize> {
        let mut slots: Vec<usize> = self.freed.iter().map(|(slot, _)| *slot).collect();
        slots.sort_unstable();
        slots
    }
}

/// Judges comparisons of cameras at these poses. A camera counts as moved if its view is off by more than its
/// `min_m`.
pub(super) fn attribute(
    comparisons: &[Comparison],
    poses: &[Option<Rigid>],
    min_m: &[f64],
) -> Verdict {
    let is_suspect = |slot: &usize| {
        poses[*slot].is_some_and(|pose| first_gain(comparisons, *slot, &pose) > FIRST_GAIN)
            && has_enough_roundels(comparisons, *slot)
    };
    let slots: Vec<usize> = (0..poses.len()).filter(is_suspect).collect();
    let base = cost(comparisons);
    let mut singles: Vec<Hypothesis> =
        slots.iter().filter_map(|slot| free_cameras(comparisons, poses, &[*slot])).collect();
    singles.sort_by(|one, other| one.cost.total_cmp(&other.cost));
    let Some(best) = singles.first() else { return Verdict::Agreed };
    let is_significant =
        |gain: f64, slot: usize, fit: &PoseFit| gain > SURE_GAIN && fit.moved_m > min_m[slot];
    let (first, fit) = &best.freed[0];
    if !is_significant(base - best.cost, *first, fit) {
        return Verdict::Agreed;
    }
    // Is any other camera still significant after freeing the best one?
    let is_enough = slots.iter().filter(|slot| *slot != first).all(|slot| {
        let mut rest = best.comparisons.clone();
        let fit = poses[*slot].and_then(|pose| fit_pose(&mut rest, *slot, &pose));
        fit.is_none_or(|fit| !is_significant(best.cost - cost(&rest), *slot, &fit))
    });
    let mut pairs: Vec<Hypothesis> = Vec::new();
    if !is_enough {
        for (rank, first) in singles.iter().enumerate().take(MAX_FIRST_CAMERAS) {
            for second in &singles[rank + 1..] {
                let slots = [first.freed[0].0, second.freed[0].0];
                pairs.extend(free_cameras(comparisons, poses, &slots));
            }
        }
        pairs.sort_by(|one, other| one.cost.total_cmp(&other.cost));
    }
    // Disagreement that no motion explains is noise. While the moved camera is unknown, the estimate of the noise
    // is too high.
    let is_better = |pair: &&Hypothesis| {
        best.cost - pair.cost > SURE_GAIN * excess(&pair.comparisons)
            && pair.freed.iter().all(|(slot, fit)| fit.moved_m > min_m[*slot])
    };
    let sorted = if pairs.first().filter(is_better).is_some() { &pairs } else { &singles };
    let scale = excess(&sorted[0].comparisons);
    if base - sorted[0].cost > SURE_GAIN * scale {
        verdict(sorted, base, scale)
    } else {
        Verdict::Agreed
    }
}

/// Whether a camera shares enough roundels.
pub(super) fn has_enough_roundels(comparisons: &[Comparison], slot: usize) -> bool {
    let met = comparisons.iter().filter(|comparison| comparison.slots().any(|it| it == slot));
    let roundels: BTreeSet<Roundel> = met.map(|comparison| comparison.roundel).collect();
    roundels.len() >= MIN_ROUNDELS
}

fn free_cameras(
    comparisons: &[Comparison],
    poses: &[Option<Rigid>],
    slots: &[usize],
) -> Option<Hypothesis> {
    let mut comparisons = comparisons.to_vec();
    let mut freed = Vec::new();
    for _ in 0..if slots.len() > 1 { TURNS } else { 1 } {
        freed.clear();
        for slot in slots {
            freed.push((*slot, fit_pose(&mut comparisons, *slot, &poses[*slot]?)?));
        }
    }
    Some(Hypothesis { freed, cost: cost(&comparisons), comparisons })
}

/// Cameras that moved in all hypotheses of about the same cost.
fn verdict(sorted: &[Hypothesis], base: f64, scale: f64) -> Verdict {
    let best = &sorted[0];
    let max = best.cost + CLEAR_COST * scale + CLEAR_SHARE * (base - best.cost);
    let likely: Vec<Vec<usize>> =
        sorted.iter().filter(|it| it.cost <= max).map(Hypothesis::slots).collect();
    let in_all = |slot: &usize| likely.iter().all(|slots| slots.contains(slot));
    let moved = best.freed.iter().filter(|(slot, _)| in_all(slot));
    let moved: Vec<(usize, Rigid)> = moved.map(|(slot, fit)| (*slot, fit.pose)).collect();
    if moved.is_empty() {
        let all: BTreeSet<usize> = likely.into_iter().flatten().collect();
        return Verdict::Unclear(all.into_iter().collect());
    }
    Verdict::Moved(moved)
}
