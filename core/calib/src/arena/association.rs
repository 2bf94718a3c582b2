//! Roundels without codes that several cameras saw: the same ones move alike.
//!
//! How far a robot is from where it was a second before does not depend on who looks, nor does it need clocks
//! that agree to better than that. So of two cameras' roundels those are compared whose distances run alike; for
//! each such pair, the rigid motion and the clocks' difference that lay one course upon the other
//! ([`super::initial_poses::align`]). A wrong pair either does not fit or fits by a motion that no other pair agrees
//! with. What most sightings agree on is how the two cameras stand to one another (a consensus as in Fischler,
//! Bolles 1981, over all hypotheses), and all roundels that then lie upon one another are the same.
//!
//! Robots that all move alike, or one that drives round a circle at one speed, leave it open, and then nothing is
//! joined. Kinds that have codes are left alone: there a code says more.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector3;
use rayon::prelude::*;

use super::{
    initial_poses::{Aligned, LEAST_SPREAD_M, align, at_once},
    recording::{Name, Sample, Seen, Sorted, overlap},
};
use roundel_vision::id::{CameraId, KindId};

/// Courses are compared in steps of this, seconds …
const STEP_S: f64 = 0.1;
/// … by how far each got in so many steps …
const CHORD_STEPS: usize = 10;
/// … with clocks that differ by up to so many steps.
const MOST_SHIFT: i64 = 6;
/// Fewer steps in common say nothing.
const LEAST_STEPS: usize = 40;
/// Distances that run alike differ by less, rms, metres.
const CHORD_M: f64 = 0.05;
/// A course that never gets this far says nothing, metres.
const LEAST_CHORD_M: f64 = 0.1;
/// Pairs of courses that are looked at closely, for two cameras.
const MOST_CANDIDATES: usize = 80;
/// Courses that are the same lie this near to one another, metres.
const SAME_M: f64 = 0.1;
/// Motions that agree differ by less where the course was, and by such a turn and time.
const AGREE_RAD: f64 = 0.1;
const AGREE_S: f64 = 0.1;
/// What is agreed on has as many sightings, and so many times those of anything else.
const LEAST_AGREED: usize = 60;
const CLEARLY: usize = 2;
/// Two courses in one camera that go on beside one another for longer are two roundels, seconds.
const MOST_OVERLAP_S: f64 = 0.5;

/// One nameless roundel in one camera.
struct Walk {
    name: Name,
    camera: CameraId,
    kind: Option<KindId>,
    samples: Vec<Sample>,
    /// Step of the first chord, and chords, metres; NaN where unseen.
    first_step: i64,
    chords_m: Vec<f64>,
}

/// Gives those that are the same one name.
pub(super) fn join(sorted: &mut Sorted) {
    let walks = walks(sorted);
    let mut couples = BTreeSet::new();
    for one in &walks {
        couples.extend(
            walks.iter().filter(|it| it.camera > one.camera).map(|it| (one.camera, it.camera)),
        );
    }
    let couples: Vec<(CameraId, CameraId)> = couples.into_iter().collect();
    let mut links: Vec<Link> =
        couples.into_par_iter().flat_map_iter(|couple| linked(&walks, couple)).collect();
    // Those that lie closest are joined first; sorting is stable, so equal ones keep the order of cameras.
    links.sort_by(|one, other| one.apart_m.total_cmp(&other.apart_m));
    for group in groups(&walks, &links) {
        let name = walks[group[0]].name;
        let mut seen: BTreeMap<CameraId, Seen> = BTreeMap::new();
        for &index in &group {
            let Walk { name, camera, kind, samples, .. } = &walks[index];
            sorted.remove(name);
            let entry = seen.entry(*camera);
            let entry = entry.or_insert(Seen { kind: *kind, samples: Vec::new() });
            entry.samples.extend_from_slice(samples);
            entry.samples.sort_by(|one, other| one.stamp_s.total_cmp(&other.stamp_s));
        }
        sorted.insert(name, seen);
    }
}

/// All that move, of kinds that have no codes.
fn walks(sorted: &Sorted) -> Vec<Walk> {
    let coded: BTreeSet<KindId> = sorted
        .keys()
        .filter_map(|name| match name {
            Name::Coded(kind, _) => Some(*kind),
            Name::Nameless(..) => None,
        })
        .collect();
    let mut walks = Vec::new();
    for (name, seen) in sorted.iter().filter(|(name, _)| matches!(name, Name::Nameless(..))) {
        for (camera, seen) in seen {
            if seen.kind.is_some_and(|kind| coded.contains(&kind)) {
                continue;
            }
            let (first_step, chords_m) = chords(&seen.samples);
            if chords_m.iter().any(|chord_m| *chord_m > LEAST_CHORD_M) {
                let (name, camera, kind) = (*name, *camera, seen.kind);
                let samples = seen.samples.clone();
                walks.push(Walk { name, camera, kind, samples, first_step, chords_m });
            }
        }
    }
    walks
}

/// How far it got in each [`CHORD_STEPS`].
fn chords(samples: &[Sample]) -> (i64, Vec<f64>) {
    let Some((first, last)) = samples.first().zip(samples.last()) else { return (0, Vec::new()) };
    let step = |stamp_s: f64| (stamp_s / STEP_S).floor() as i64;
    let (first_step, last_step) = (step(first.stamp_s) + 1, step(last.stamp_s));
    let places: Vec<Option<Vector3<f64>>> =
        (first_step..=last_step).map(|step| at_once(samples, step as f64 * STEP_S)).collect();
    let chords =
        places.windows(CHORD_STEPS + 1).map(|window| match (window[0], window[CHORD_STEPS]) {
            (Some(before), Some(after)) => (after - before).norm(),
            _ => f64::NAN,
        });
    (first_step, chords.collect())
}

/// Two courses that may be the same.
struct Link {
    walks: [usize; 2],
    apart_m: f64,
}

/// A pair of courses with the motion that lays one upon the other.
struct Candidate {
    walks: [usize; 2],
    aligned: Aligned,
    /// Of the other camera's course, metres.
    center_m: Vector3<f64>,
}

/// What is the same in two cameras.
fn linked(walks: &[Walk], (one, other): (CameraId, CameraId)) -> Vec<Link> {
    let of =
        |camera: CameraId| (0..walks.len()).filter(move |&index| walks[index].camera == camera);
    let together: Vec<[usize; 2]> = of(one)
        .flat_map(|i| of(other).map(move |j| [i, j]))
        .filter(|[i, j]| walks[*i].kind == walks[*j].kind)
        .collect();
    let mut alike: Vec<([usize; 2], f64)> = together
        .iter()
        .filter_map(|&[i, j]| Some(([i, j], unlikeness_m(&walks[i], &walks[j])?)))
        .filter(|(_, off_m)| *off_m < CHORD_M)
        .collect();
    alike.sort_by(|one, other| one.1.total_cmp(&other.1));
    let shared = |[i, j]: [usize; 2]| (&walks[i].samples[..], &walks[j].samples[..]);
    let candidates: Vec<Candidate> = alike
        .iter()
        .take(MOST_CANDIDATES)
        .filter_map(|&(pair, _)| {
            let aligned = align(&[shared(pair)])?;
            let fits = aligned.fit.spread_m >= LEAST_SPREAD_M && aligned.fit.left_m < SAME_M / 2.0;
            let samples = &walks[pair[1]].samples;
            let sum: Vector3<f64> = samples.iter().map(|sample| sample.place_m).sum();
            let center_m = sum / samples.len() as f64;
            fits.then_some(Candidate { walks: pair, aligned, center_m })
        })
        .collect();
    let Some(agreed) = agreed(&candidates) else { return Vec::new() };
    let all: Vec<_> = agreed.iter().map(|candidate| shared(candidate.walks)).collect();
    let Some(aligned) = align(&all) else { return Vec::new() };
    together
        .into_iter()
        .filter_map(|pair| {
            let apart_m = aligned.apart_m(&shared(pair))?;
            (apart_m < SAME_M).then_some(Link { walks: pair, apart_m })
        })
        .collect()
}

/// Root mean square by which distances differ, at the clocks' difference where that is least.
fn unlikeness_m(one: &Walk, other: &Walk) -> Option<f64> {
    let shifted = |shift: i64| {
        let skip = one.first_step - other.first_step + shift;
        let (mine, theirs) = (skip.min(0).unsigned_abs() as usize, skip.max(0) as usize);
        let ones = one.chords_m.iter().skip(mine);
        let (mut sum, mut count) = (0.0, 0);
        for off in ones.zip(other.chords_m.iter().skip(theirs)).map(|(a, b)| a - b) {
            if !off.is_nan() {
                sum += off * off;
                count += 1;
            }
        }
        (count >= LEAST_STEPS).then(|| (sum / count as f64).sqrt())
    };
    (-MOST_SHIFT..=MOST_SHIFT).filter_map(shifted).min_by(f64::total_cmp)
}

/// Candidates that agree with the hypothesis that most sightings agree with, if it is clear.
fn agreed(candidates: &[Candidate]) -> Option<Vec<&Candidate>> {
    let agree = |one: &Candidate, other: &Candidate| {
        let (mine, theirs) = (&one.aligned, &other.aligned);
        let at =
            |aligned: &Aligned| aligned.fit.one_from_other.transform_point(&other.center_m.into());
        let turn = mine.fit.one_from_other.rotation.angle_to(&theirs.fit.one_from_other.rotation);
        (at(mine) - at(theirs)).norm() < SAME_M
            && turn < AGREE_RAD
            && (mine.ahead_s - theirs.ahead_s).abs() < AGREE_S
    };
    let weight = |of: &[&Candidate]| of.iter().map(|it| it.aligned.fit.pairs).sum::<usize>();
    let with = |one: &Candidate| -> Vec<&Candidate> {
        candidates.iter().filter(|other| agree(one, other)).collect()
    };
    let best = candidates.iter().map(with).max_by_key(|found| weight(found))?;
    // What shares none of its pairs with the best speaks for another motion.
    let is_in_best = |it: &&Candidate| best.iter().any(|found| found.walks == it.walks);
    let rivals = candidates.iter().map(|one| {
        let found = with(one);
        if found.iter().any(is_in_best) { 0 } else { weight(&found) }
    });
    let rival = rivals.max().unwrap_or(0);
    (weight(&best) >= LEAST_AGREED && weight(&best) > CLEARLY * rival).then_some(best)
}

/// Walks that are one roundel, each group in the order of names.
fn groups(walks: &[Walk], links: &[Link]) -> Vec<Vec<usize>> {
    let mut group_of: Vec<usize> = (0..walks.len()).collect();
    let mut groups: Vec<Vec<usize>> = (0..walks.len()).map(|index| vec![index]).collect();
    for link in links {
        let [one, other] = link.walks.map(|index| group_of[index]);
        let collide = |i: usize, j: usize| {
            walks[i].camera == walks[j].camera
                && overlap(&walks[i].samples, &walks[j].samples) > MOST_OVERLAP_S
        };
        let are_two = groups[one].iter().any(|&i| groups[other].iter().any(|&j| collide(i, j)));
        if one == other || are_two {
            continue;
        }
        let joined = std::mem::take(&mut groups[other]);
        joined.iter().for_each(|&index| group_of[index] = one);
        groups[one].extend(joined);
    }
    groups.retain(|group| group.len() > 1);
    groups.iter_mut().for_each(|group| group.sort_unstable());
    groups
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, UnitQuaternion};

    use super::*;
    use roundel_vision::{id::TrackNumber, rigid::Rigid};

    /// A robot's course: two turns that do not repeat.
    fn course(robot: usize, t: f64) -> Vector3<f64> {
        let phase = robot as f64 * 1.7;
        let (slow, quick) = (0.31 + 0.07 * robot as f64, 0.83 + 0.05 * robot as f64);
        Vector3::new((slow * t + phase).sin() * 2.0, (quick * t).cos() + 0.4 * robot as f64, 0.2)
    }

    /// What two cameras see of so many robots in 20 s, the other's clock 0.23 s ahead.
    fn seen(robots: usize, path: impl Fn(usize, f64) -> Vector3<f64>) -> Sorted {
        let place = |camera: u32| {
            let turn = UnitQuaternion::from_euler_angles(2.5 + 0.2 * f64::from(camera), 0.3, 0.5);
            Rigid::from_parts(Vector3::new(f64::from(camera), -2.0, 4.0).into(), turn)
        };
        let mut sorted = Sorted::new();
        for (camera, robot) in (0..2).flat_map(|camera| (0..robots).map(move |it| (camera, it))) {
            let sample = |step: i32| {
                let t = f64::from(step) / 20.0;
                Sample {
                    stamp_s: t + 0.23 * f64::from(camera),
                    place_m: place(camera).inverse_transform_point(&path(robot, t).into()).coords,
                    covariance: Matrix3::identity() * 1e-6,
                }
            };
            // The other camera's numbers run the other way.
            let number = if camera == 0 { robot } else { 100 - robot };
            let name = Name::Nameless(CameraId(camera), TrackNumber(number as u64));
            let samples = (-200..200).map(sample).collect();
            let seen = Seen { kind: Some(KindId(0)), samples };
            sorted.insert(name, BTreeMap::from([(CameraId(camera), seen)]));
        }
        sorted
    }

    #[test]
    fn those_that_move_alike_are_joined_and_no_others() {
        let mut sorted = seen(6, course);
        join(&mut sorted);
        assert_eq!(sorted.len(), 6);
        for (robot, (name, cameras)) in sorted.iter().enumerate() {
            assert_eq!(*name, Name::Nameless(CameraId(0), TrackNumber(robot as u64)));
            let place = |camera: u32| cameras[&CameraId(camera)].samples[200].place_m;
            let other = seen(6, course);
            let number = TrackNumber(100 - robot as u64);
            let expected = &other[&Name::Nameless(CameraId(1), number)][&CameraId(1)];
            assert_eq!(place(1), expected.samples[200].place_m);
            assert!(place(0) != place(1));
        }
    }

    #[test]
    fn a_column_of_robots_that_moves_as_one_is_left_apart() {
        let column =
            |robot: usize, t: f64| course(0, t) + Vector3::new(0.0, 0.5 * robot as f64, 0.0);
        let mut sorted = seen(4, column);
        join(&mut sorted);
        // Each lies on each other's course by another motion: four agree on the right one, three on the next.
        assert_eq!(sorted.len(), 8, "it is not clear who is who");
    }

    #[test]
    fn kinds_with_codes_are_left_alone() {
        let mut sorted = seen(3, course);
        let code = roundel_vision::marker::Code { bits: 8, number: 3 };
        sorted.insert(Name::Coded(KindId(0), code), BTreeMap::new());
        join(&mut sorted);
        assert_eq!(sorted.len(), 7);
    }
}
