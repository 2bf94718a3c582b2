//! Who of several cameras moved.
//!
//! Freeing the cameras S, with all others as they are, takes a gain off the cost of all meetings. A camera
//! that moved disagrees with each of the others, and freeing it brings agreement, while freeing one of
//! the others cannot bring it into line with the moved one and with the rest at once. So of all S of one
//! camera, or of two where one does not bring agreement, that with the least cost is at fault, unless another
//! costs hardly more: two cameras alone explain a disagreement equally well, each by itself. Then all that is
//! known is that one of them moved.

use std::collections::BTreeSet;

use super::{
    co_observation::Roundel,
    pose_fit::{Fit, Round, cost, excess, first_gain, release},
};
use roundel_vision::rigid::Rigid;

/// A gain below this is chance: χ² of 6 beyond 1 - 10⁻¹⁰.
const SURE_GAIN: f64 = 60.0;
/// Cameras whose first step would gain less than this are not looked at any further.
const FIRST_GAIN: f64 = 30.0;
/// Others that cost no more than this above the best, and this share of its gain, may be at fault as well.
const CLEAR_COST: f64 = 30.0;
const CLEAR_SHARE: f64 = 0.01;
/// Roundels that have to say so: of one alone the code may be shown twice.
const LEAST_ROUNDELS: usize = 2;
/// Cameras taken first when pairs are tried.
const TRIED_FIRST: usize = 4;
/// Times that two cameras take turns.
const TURNS: usize = 6;

/// What disagreements say.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Verdict {
    /// There are none that matter.
    Agreed,
    /// These moved, by their posts.
    Moved(Vec<(usize, Rigid)>),
    /// One of these moved.
    Unclear(Vec<usize>),
}

/// Cameras freed and what came of it.
struct Hypothesis {
    freed: Vec<(usize, Fit)>,
    cost: f64,
    rounds: Vec<Round>,
}

impl Hypothesis {
    fn is_move(&self, least_m: &[f64]) -> bool {
        self.freed.iter().all(|(post, fit)| fit.moved_m > least_m[*post])
    }

    fn posts(&self) -> Vec<usize> {
        let mut posts: Vec<usize> = self.freed.iter().map(|(post, _)| *post).collect();
        posts.sort_unstable();
        posts
    }
}

/// Judges rounds with cameras at these places; of each, what it sees has to be off by more than `least_m`.
pub(super) fn judge(rounds: &[Round], places: &[Option<Rigid>], least_m: &[f64]) -> Verdict {
    let stirs = |post: &usize| {
        places[*post].is_some_and(|place| first_gain(rounds, *post, &place) > FIRST_GAIN)
            && is_backed(rounds, *post)
    };
    let posts: Vec<usize> = (0..places.len()).filter(stirs).collect();
    let base = cost(rounds);
    let mut singles: Vec<Hypothesis> =
        posts.iter().filter_map(|post| free(rounds, places, &[*post])).collect();
    singles.sort_by(|one, other| one.cost.total_cmp(&other.cost));
    let Some(best) = singles.first() else { return Verdict::Agreed };
    let matters =
        |gain: f64, post: usize, fit: &Fit| gain > SURE_GAIN && fit.moved_m > least_m[post];
    let (first, fit) = &best.freed[0];
    if !matters(base - best.cost, *first, fit) {
        return Verdict::Agreed;
    }
    // Does anybody else have to move, once the best one has?
    let is_enough = posts.iter().filter(|post| *post != first).all(|post| {
        let mut rest = best.rounds.clone();
        let fit = places[*post].and_then(|place| release(&mut rest, *post, &place));
        fit.is_none_or(|fit| !matters(best.cost - cost(&rest), *post, &fit))
    });
    let mut pairs: Vec<Hypothesis> = Vec::new();
    if !is_enough {
        for (rank, first) in singles.iter().enumerate().take(TRIED_FIRST) {
            for second in &singles[rank + 1..] {
                pairs.extend(free(rounds, places, &[first.freed[0].0, second.freed[0].0]));
            }
        }
        pairs.sort_by(|one, other| one.cost.total_cmp(&other.cost));
    }
    // What no move explains is noise; while it is not known who moved, much of it is not.
    let is_better = |pair: &&Hypothesis| {
        best.cost - pair.cost > SURE_GAIN * excess(&pair.rounds) && pair.is_move(least_m)
    };
    let sorted = if pairs.first().filter(is_better).is_some() { &pairs } else { &singles };
    let scale = excess(&sorted[0].rounds);
    if base - sorted[0].cost > SURE_GAIN * scale {
        verdict(sorted, base, scale)
    } else {
        Verdict::Agreed
    }
}

/// Whether enough roundels tell of a camera.
pub(super) fn is_backed(rounds: &[Round], post: usize) -> bool {
    let met = rounds.iter().filter(|round| round.posts().any(|it| it == post));
    let roundels: BTreeSet<Roundel> = met.map(|round| round.roundel).collect();
    roundels.len() >= LEAST_ROUNDELS
}

fn free(rounds: &[Round], places: &[Option<Rigid>], posts: &[usize]) -> Option<Hypothesis> {
    let mut rounds = rounds.to_vec();
    let mut freed = Vec::new();
    for _ in 0..if posts.len() > 1 { TURNS } else { 1 } {
        freed.clear();
        for post in posts {
            freed.push((*post, release(&mut rounds, *post, &places[*post]?)?));
        }
    }
    Some(Hypothesis { freed, cost: cost(&rounds), rounds })
}

/// Of hypotheses by cost: who moved in all of them that explain about equally well.
fn verdict(sorted: &[Hypothesis], base: f64, scale: f64) -> Verdict {
    let best = &sorted[0];
    let most = best.cost + CLEAR_COST * scale + CLEAR_SHARE * (base - best.cost);
    let likely: Vec<Vec<usize>> =
        sorted.iter().filter(|it| it.cost <= most).map(Hypothesis::posts).collect();
    let in_all = |post: &usize| likely.iter().all(|posts| posts.contains(post));
    let moved: Vec<(usize, Rigid)> = best
        .freed
        .iter()
        .filter(|(post, _)| in_all(post))
        .map(|(post, fit)| (*post, fit.place))
        .collect();
    if moved.is_empty() {
        let all: BTreeSet<usize> = likely.into_iter().flatten().collect();
        return Verdict::Unclear(all.into_iter().collect());
    }
    Verdict::Moved(moved)
}
