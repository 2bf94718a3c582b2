//! Views of one roundel in one bin by several cameras, or by one and from where it is known to be.
//!
//! Roundels are told apart by kind and code. Those without a code meet where each is the other's nearest in
//! the world and nothing else is near ([`NEAR_M`]).

use std::collections::{BTreeMap, btree_map::Entry};

use nalgebra::{Point3, Vector3};

use super::{BIN_S, track::Sight};
use roundel_fusion::world::Landmark;
use roundel_vision::{
    id::{KindId, TrackNumber},
    marker::Code,
    rigid::Rigid,
};

/// Views without a code are of one roundel if they are no further apart than this, and no other is within
/// twice of it, metres.
pub(super) const NEAR_M: f64 = 0.2;
/// A roundel stands while it stays within this, metres.
const STANDS_M: f64 = 0.15;
/// A roundel that was not met for so long is new, bins.
const FORGOTTEN_BINS: i64 = 2400;
/// A landmark's place is not believed to be better, metres.
const LEAST_DEVIATION_M: f64 = 2e-5;

/// Which roundel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Roundel {
    /// A landmark, by its place in the list.
    Fixed(usize),
    /// By its code.
    Coded(KindId, Code),
    /// By the number that the first of the cameras gave it, and which that is.
    Plain(usize, TrackNumber),
}

/// A roundel in one camera, before it is known with which others it meets.
#[derive(Clone, Copy, Debug)]
pub(super) struct Single {
    pub(super) post: usize,
    pub(super) number: TrackNumber,
    pub(super) kind: KindId,
    pub(super) code: Option<Code>,
    pub(super) sight: Sight,
}

/// Several views of one roundel.
#[derive(Clone, Debug)]
pub(super) struct Meeting {
    pub(super) roundel: Roundel,
    /// Cameras by their post.
    pub(super) sights: Vec<(usize, Sight)>,
    /// Where it is known to be and with what variance, metres.
    pub(super) fixed: Option<(Vector3<f64>, f64)>,
    /// For how long it stood where it is.
    pub(super) stood_s: f64,
}

impl Meeting {
    /// As if that camera had not been there.
    pub(super) fn forget(&mut self, post: usize) {
        self.sights.retain(|(it, _)| *it != post);
    }
}

/// How long roundels stood.
#[derive(Clone, Debug, Default)]
pub(super) struct Stands {
    /// Place, bin of the arrival there and of the last sight.
    at: BTreeMap<Roundel, (Vector3<f64>, i64, i64)>,
}

impl Stands {
    fn since(&mut self, roundel: Roundel, place_m: &Vector3<f64>, bin: i64) -> f64 {
        let (from_m, arrived, seen) = self.at.entry(roundel).or_insert((*place_m, bin, bin));
        if (place_m - *from_m).norm() > STANDS_M {
            (*from_m, *arrived) = (*place_m, bin);
        }
        *seen = bin;
        (bin - *arrived + 1) as f64 * BIN_S
    }

    fn forget(&mut self, bin: i64) {
        self.at.retain(|_, (_, _, seen)| bin - *seen < FORGOTTEN_BINS);
    }
}

/// Sorts a bin's views by roundel; one that is seen twice by a camera is left out, and who sees one alone.
pub(super) fn meet(
    singles: &[Single],
    places: &[Rigid],
    landmarks: &[Landmark],
    (stands, bin): (&mut Stands, i64),
) -> Vec<Meeting> {
    let mut groups: BTreeMap<Roundel, Option<Vec<(usize, Sight)>>> = BTreeMap::new();
    let mut join = |roundel: Roundel, single: &Single| match groups.entry(roundel) {
        Entry::Vacant(entry) => {
            entry.insert(Some(vec![(single.post, single.sight)]));
        }
        Entry::Occupied(mut entry) => match entry.get_mut() {
            Some(sights) if sights.iter().all(|(post, _)| *post != single.post) => {
                sights.push((single.post, single.sight));
            }
            // Twice in one picture: which is meant cannot be known.
            twice => *twice = None,
        },
    };
    let mut plain: Vec<(&Single, Vector3<f64>)> = Vec::new();
    for single in singles {
        let world_m = place(&places[single.post], &single.sight.position_m);
        let landmark = landmarks.iter().position(|it| is_landmark(it, single, &world_m));
        match (landmark, single.code) {
            (Some(index), _) => join(Roundel::Fixed(index), single),
            (None, Some(code)) => join(Roundel::Coded(single.kind, code), single),
            (None, None) => plain.push((single, world_m)),
        }
    }
    // So that who is near stands near in the list.
    plain.sort_by(|one, other| one.1.x.total_cmp(&other.1.x));
    let mut met: Vec<(&Single, Roundel)> = (0..plain.len())
        .filter_map(|index| {
            let (first, _) = plain[first_of(&plain, index)?];
            Some((plain[index].0, Roundel::Plain(first.post, first.number)))
        })
        .collect();
    met.sort_by_key(|(single, _)| (single.post, single.number));
    met.into_iter().for_each(|(single, roundel)| join(roundel, single));
    stands.forget(bin);
    let meeting = |(roundel, sights): (Roundel, Option<Vec<(usize, Sight)>>)| {
        let sights = sights?;
        let fixed = if let Roundel::Fixed(index) = roundel {
            let deviation_m = landmarks[index].position_deviation_m.max(LEAST_DEVIATION_M);
            Some((landmarks[index].position_m, deviation_m * deviation_m))
        } else {
            None
        };
        if sights.len() + usize::from(fixed.is_some()) < 2 {
            return None;
        }
        let (post, sight) = &sights[0];
        let stood_s = stands.since(roundel, &place(&places[*post], &sight.position_m), bin);
        Some(Meeting { roundel, sights, fixed, stood_s })
    };
    groups.into_iter().filter_map(meeting).collect()
}

pub(super) fn place(world_from_camera: &Rigid, position_m: &Vector3<f64>) -> Vector3<f64> {
    (world_from_camera * Point3::from(*position_m)).coords
}

fn is_landmark(landmark: &Landmark, single: &Single, world_m: &Vector3<f64>) -> bool {
    let is_near = || (landmark.position_m - world_m).norm() < NEAR_M;
    landmark.kind == single.kind
        && landmark.code == single.code
        && (landmark.code.is_some() || is_near())
}

/// Views without a code, by their x.
type Plain<'a> = [(&'a Single, Vector3<f64>)];

/// The first of all views without a code that are of the same roundel as this one; `None` if that is in doubt.
fn first_of(plain: &Plain<'_>, index: usize) -> Option<usize> {
    let (of, world_m) = &plain[index];
    let mut first = index;
    for other in around(plain, world_m) {
        let (single, other_m) = &plain[other];
        let is_mate =
            single.post != of.post && single.kind == of.kind && (other_m - world_m).norm() < NEAR_M;
        if is_mate {
            let is_alone = is_alone(plain, index, single.post) && is_alone(plain, other, of.post);
            if !is_alone {
                return None;
            }
            let order = |index: usize| (plain[index].0.post, plain[index].0.number);
            first = if order(other) < order(first) { other } else { first };
        }
    }
    Some(first)
}

/// Whether a camera has one view at most near that of another.
fn is_alone(plain: &Plain<'_>, index: usize, post: usize) -> bool {
    let (of, world_m) = &plain[index];
    let is_near = |other: &usize| {
        let (single, other_m) = &plain[*other];
        single.post == post && single.kind == of.kind && (other_m - world_m).norm() < 2.0 * NEAR_M
    };
    around(plain, world_m).filter(is_near).count() <= 1
}

/// All views that may be within twice [`NEAR_M`] of a place.
fn around(plain: &Plain<'_>, world_m: &Vector3<f64>) -> std::ops::Range<usize> {
    let reach_m = 2.0 * NEAR_M;
    let from = plain.partition_point(|(_, other_m)| other_m.x < world_m.x - reach_m);
    let count = plain[from..].partition_point(|(_, other_m)| other_m.x <= world_m.x + reach_m);
    from..from + count
}
