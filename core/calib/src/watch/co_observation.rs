//! Groups the views of one roundel in one bin by several cameras, or by one camera and a landmark.
//!
//! Roundels are identified by kind and code. Views without a code match if each is the other's nearest in the world and no
//! other is near ([`NEAR_M`]).

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Point3, Vector3};

use super::{BIN_S, track::RoundelView};
use roundel_fusion::world::Landmark;
use roundel_vision::{
    id::{KindId, TrackNumber},
    marker::Code,
    rigid::Rigid,
};

/// Maximum distance of matching views without a code; no other view may be within twice this, metres.
pub(super) const NEAR_M: f64 = 0.2;
/// A roundel rests while it stays within this, metres.
const REST_M: f64 = 0.15;
/// A roundel that was not observed for this long is new, bins.
const FORGOTTEN_BINS: i64 = 2400;
/// Minimum standard deviation of a landmark, metres.
const MIN_DEVIATION_M: f64 = 2e-5;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Roundel {
    /// Index of a landmark.
    Fixed(usize),
    /// By its code.
    Coded(KindId, Code),
    /// Slot of the first camera and its track number.
    Uncoded(usize, TrackNumber),
}

/// View of a roundel in one camera before matching.
#[derive(Clone, Copy, Debug)]
pub(super) struct SingleView {
    pub(super) slot: usize,
    pub(super) number: TrackNumber,
    pub(super) kind: KindId,
    pub(super) code: Option<Code>,
    pub(super) view: RoundelView,
}

/// Matched views of one roundel.
#[derive(Clone, Debug)]
pub(super) struct CoObservation {
    pub(super) roundel: Roundel,
    /// Views with the slots of their cameras.
    pub(super) views: Vec<(usize, RoundelView)>,
    /// Known position and its variance, metres and metres².
    pub(super) fixed: Option<(Vector3<f64>, f64)>,
    /// Time for which it has been resting, seconds.
    pub(super) rest_s: f64,
}

impl CoObservation {
    /// Removes the view of a camera.
    pub(super) fn forget(&mut self, slot: usize) {
        self.views.retain(|(it, _)| *it != slot);
    }
}

#[derive(Clone, Debug, Default)]
pub(super) struct RestTimes {
    /// Position, bin of arrival, and bin of the last view.
    at: BTreeMap<Roundel, (Vector3<f64>, i64, i64)>,
}

impl RestTimes {
    fn since(&mut self, roundel: Roundel, position_m: &Vector3<f64>, bin: i64) -> f64 {
        let (from_m, arrived, seen) = self.at.entry(roundel).or_insert((*position_m, bin, bin));
        if (position_m - *from_m).norm() > REST_M {
            (*from_m, *arrived) = (*position_m, bin);
        }
        *seen = bin;
        (bin - *arrived + 1) as f64 * BIN_S
    }

    fn forget(&mut self, bin: i64) {
        self.at.retain(|_, (_, _, seen)| bin - *seen < FORGOTTEN_BINS);
    }
}

/// Matches the views of a bin. Roundels that a camera sees twice, or that only one camera sees, are left out.
pub(super) fn match_views(
    singles: &[SingleView],
    poses: &[Rigid],
    landmarks: &[Landmark],
    rest_times: &mut RestTimes,
    bin: i64,
) -> Vec<CoObservation> {
    let mut groups: BTreeMap<Roundel, Vec<(usize, RoundelView)>> = BTreeMap::new();
    let mut add = |roundel: Roundel, single: &SingleView| {
        groups.entry(roundel).or_default().push((single.slot, single.view));
    };
    let mut uncoded: Vec<(&SingleView, Vector3<f64>)> = Vec::new();
    for single in singles {
        let world_m = to_world(&poses[single.slot], &single.view.position_m);
        let landmark = landmarks.iter().position(|it| is_landmark(it, single, &world_m));
        match (landmark, single.code) {
            (Some(index), _) => add(Roundel::Fixed(index), single),
            (None, Some(code)) => add(Roundel::Coded(single.kind, code), single),
            (None, None) => uncoded.push((single, world_m)),
        }
    }
    // Sorted by x for the search of neighbours.
    uncoded.sort_by(|one, other| one.1.x.total_cmp(&other.1.x));
    let mut matched: Vec<(&SingleView, Roundel)> = (0..uncoded.len())
        .filter_map(|index| {
            let (first, _) = uncoded[first_of(&uncoded, index)?];
            Some((uncoded[index].0, Roundel::Uncoded(first.slot, first.number)))
        })
        .collect();
    matched.sort_by_key(|(single, _)| (single.slot, single.number));
    for (single, roundel) in matched {
        add(roundel, single);
    }
    rest_times.forget(bin);
    let group = |(roundel, views): (Roundel, Vec<(usize, RoundelView)>)| {
        let fixed = if let Roundel::Fixed(index) = roundel {
            let deviation_m = landmarks[index].position_deviation_m.max(MIN_DEVIATION_M);
            Some((landmarks[index].position_m, deviation_m * deviation_m))
        } else {
            None
        };
        let slots: BTreeSet<usize> = views.iter().map(|(slot, _)| *slot).collect();
        let is_twice_in_one = slots.len() < views.len();
        if is_twice_in_one || views.len() + usize::from(fixed.is_some()) < 2 {
            return None;
        }
        let (slot, view) = &views[0];
        let rest_s = rest_times.since(roundel, &to_world(&poses[*slot], &view.position_m), bin);
        Some(CoObservation { roundel, views, fixed, rest_s })
    };
    groups.into_iter().filter_map(group).collect()
}

pub(super) fn to_world(world_from_camera: &Rigid, position_m: &Vector3<f64>) -> Vector3<f64> {
    (world_from_camera * Point3::from(*position_m)).coords
}

fn is_landmark(landmark: &Landmark, single: &SingleView, world_m: &Vector3<f64>) -> bool {
    let is_near = || (landmark.position_m - world_m).norm() < NEAR_M;
    landmark.kind == single.kind
        && landmark.code == single.code
        && (landmark.code.is_some() || is_near())
}

/// Views without a code, sorted by x.
type Uncoded<'a> = [(&'a SingleView, Vector3<f64>)];

/// The first of all views of the same roundel; `None` if ambiguous.
fn first_of(uncoded: &Uncoded<'_>, index: usize) -> Option<usize> {
    let (own, world_m) = &uncoded[index];
    let mut first = index;
    for other in neighbourhood(uncoded, world_m) {
        let (single, other_m) = &uncoded[other];
        let is_match = single.slot != own.slot
            && single.kind == own.kind
            && (other_m - world_m).norm() < NEAR_M;
        if is_match {
            let is_unambiguous = is_unambiguous(uncoded, index, single.slot)
                && is_unambiguous(uncoded, other, own.slot);
            if !is_unambiguous {
                return None;
            }
            let order = |index: usize| (uncoded[index].0.slot, uncoded[index].0.number);
            first = if order(other) < order(first) { other } else { first };
        }
    }
    Some(first)
}

/// Whether a camera has at most one view near this one.
fn is_unambiguous(uncoded: &Uncoded<'_>, index: usize, slot: usize) -> bool {
    let (own, world_m) = &uncoded[index];
    let is_near = |other: &usize| {
        let (single, other_m) = &uncoded[*other];
        single.slot == slot && single.kind == own.kind && (other_m - world_m).norm() < 2.0 * NEAR_M
    };
    neighbourhood(uncoded, world_m).filter(is_near).count() <= 1
}

/// All views within twice [`NEAR_M`] along x.
fn neighbourhood(uncoded: &Uncoded<'_>, world_m: &Vector3<f64>) -> std::ops::Range<usize> {
    let reach_m = 2.0 * NEAR_M;
    let from = uncoded.partition_point(|(_, other_m)| other_m.x < world_m.x - reach_m);
    let count = uncoded[from..].partition_point(|(_, other_m)| other_m.x <= world_m.x + reach_m);
    from..from + count
}
