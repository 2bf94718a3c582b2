//! Association of roundels without codes across cameras, by their motion.
//!
//! The distance that a robot covers within a second is the same in every camera, even if clocks differ by much less than
//! that. Tracks of two cameras with similar distances are candidates. For each, [`super::initial_poses::align`] estimates
//! the rigid motion and clock offset that map one track onto the other. A wrong pair does not fit, or fits with a motion
//! that no other pair shares. The motion supported by most samples is the relative pose of the two cameras (consensus as
//! in Fischler, Bolles 1981, over all hypotheses), and all tracks that it maps onto each other belong together.
//!
//! Robots that all move alike, or a single one on a circle at constant speed, are ambiguous; nothing is associated then.
//! Kinds with codes are left to their codes.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector3;
use rayon::prelude::*;

use super::{
    initial_poses::{Alignment, align, interpolate},
    recording::{RoundelKey, RoundelSamples, Sample, SamplesByRoundel, overlap},
};
use roundel_vision::id::{CameraId, KindId};

/// Interval of the compared distances, seconds …
const STEP_S: f64 = 0.1;
/// … distance over this number of intervals …
const CHORD_STEPS: usize = 10;
/// … and maximum clock offset in intervals.
const MAX_SHIFT: i64 = 6;
/// Minimum number of common intervals.
const MIN_STEPS: usize = 40;
/// Maximum rms difference of distances, metres.
const CHORD_M: f64 = 0.05;
/// A track must cover at least this distance within a second, metres.
const MIN_CHORD_M: f64 = 0.1;
/// Maximum number of aligned pairs for two cameras.
const MAX_CANDIDATES: usize = 80;
/// Maximum median distance of aligned tracks, metres.
const SAME_M: f64 = 0.1;
/// Consistent motions differ by less than this rotation and clock offset, and by [`SAME_M`] at the track.
const CONSISTENT_RAD: f64 = 0.1;
const CONSISTENT_S: f64 = 0.1;
/// Minimum number of samples for a consensus, and minimum ratio to any other hypothesis.
const MIN_CONSENSUS: usize = 60;
const CLEAR_RATIO: usize = 2;
/// Two tracks of one camera that overlap for longer are two roundels, seconds.
const MAX_OVERLAP_S: f64 = 0.5;

/// A roundel without code in one camera.
struct UncodedTrack {
    name: RoundelKey,
    camera: CameraId,
    kind: Option<KindId>,
    samples: Vec<Sample>,
    /// Index of the first distance, and distances, metres; NaN where unobserved.
    first_step: i64,
    chords_m: Vec<f64>,
}

/// Merges the samples of each associated group under one key.
pub(super) fn associate(by_roundel: &mut SamplesByRoundel) {
    let tracks = tracks(by_roundel);
    let cameras: BTreeSet<CameraId> = tracks.iter().map(|track| track.camera).collect();
    let mut camera_pairs = Vec::new();
    for one in &cameras {
        camera_pairs
            .extend(cameras.iter().filter(|other| *other > one).map(|other| (*one, *other)));
    }
    let links = |(one, other)| links_between(&tracks, one, other).unwrap_or_default();
    let mut links: Vec<Link> = camera_pairs.into_par_iter().flat_map_iter(links).collect();
    // Closest first; the sort is stable, so ties keep the order of cameras.
    links.sort_by(|one, other| one.distance_m.total_cmp(&other.distance_m));
    for group in groups(&tracks, &links) {
        let name = tracks[group[0]].name;
        let mut seen: BTreeMap<CameraId, RoundelSamples> = BTreeMap::new();
        for &index in &group {
            let UncodedTrack { name, camera, kind, samples, .. } = &tracks[index];
            by_roundel.remove(name);
            let entry = seen.entry(*camera);
            let entry = entry.or_insert(RoundelSamples { kind: *kind, samples: Vec::new() });
            entry.samples.extend_from_slice(samples);
            entry.samples.sort_by(|one, other| one.stamp_s.total_cmp(&other.stamp_s));
        }
        by_roundel.insert(name, seen);
    }
}

/// Moving roundels of kinds without codes.
fn tracks(by_roundel: &SamplesByRoundel) -> Vec<UncodedTrack> {
    let coded_kind = |name: &RoundelKey| match name {
        RoundelKey::Coded(kind, _) => Some(*kind),
        RoundelKey::Uncoded(..) => None,
    };
    let coded: BTreeSet<KindId> = by_roundel.keys().filter_map(coded_kind).collect();
    let mut tracks = Vec::new();
    for (name, cameras) in by_roundel.iter().filter(|(name, _)| coded_kind(name).is_none()) {
        for (camera, seen) in cameras {
            if seen.kind.is_some_and(|kind| coded.contains(&kind)) {
                continue;
            }
            let (first_step, chords_m) = chords(&seen.samples);
            if chords_m.iter().any(|chord_m| *chord_m > MIN_CHORD_M) {
                let (name, camera, kind) = (*name, *camera, seen.kind);
                let samples = seen.samples.clone();
                tracks.push(UncodedTrack { name, camera, kind, samples, first_step, chords_m });
            }
        }
    }
    tracks
}

/// Distance covered over [`CHORD_STEPS`] intervals, for each start.
fn chords(samples: &[Sample]) -> (i64, Vec<f64>) {
    let Some((first, last)) = samples.first().zip(samples.last()) else { return (0, Vec::new()) };
    let step = |stamp_s: f64| (stamp_s / STEP_S).floor() as i64;
    let (first_step, last_step) = (step(first.stamp_s) + 1, step(last.stamp_s));
    let places: Vec<Option<Vector3<f64>>> =
        (first_step..=last_step).map(|step| interpolate(samples, step as f64 * STEP_S)).collect();
    let chords =
        places.windows(CHORD_STEPS + 1).map(|window| match (window[0], window[CHORD_STEPS]) {
            (Some(before), Some(after)) => (after - before).norm(),
            _ => f64::NAN,
        });
    (first_step, chords.collect())
}

/// Two tracks that may belong together.
struct Link {
    tracks: [usize; 2],
    distance_m: f64,
}

/// A pair of tracks with the alignment that maps one onto the other.
struct Candidate {
    tracks: [usize; 2],
    aligned: Alignment,
    /// Centroid of the other camera's track, metres.
    center_m: Vector3<f64>,
}

/// Tracks of two cameras that belong together.
fn links_between(tracks: &[UncodedTrack], one: CameraId, other: CameraId) -> Option<Vec<Link>> {
    let of =
        |camera: CameraId| (0..tracks.len()).filter(move |&index| tracks[index].camera == camera);
    let same_kind: Vec<[usize; 2]> = of(one)
        .flat_map(|i| of(other).map(move |j| [i, j]))
        .filter(|[i, j]| tracks[*i].kind == tracks[*j].kind)
        .collect();
    let similar = same_kind.iter().filter_map(|&[i, j]| {
        let distance_m = chord_difference_m(&tracks[i], &tracks[j])?;
        (distance_m < CHORD_M).then_some(Link { tracks: [i, j], distance_m })
    });
    let mut similar: Vec<Link> = similar.collect();
    similar.sort_by(|one, other| one.distance_m.total_cmp(&other.distance_m));
    let shared = |[i, j]: [usize; 2]| (&tracks[i].samples[..], &tracks[j].samples[..]);
    let candidate = |link: &Link| {
        let aligned = align(&[shared(link.tracks)])?;
        let fits = aligned.is_determined() && aligned.median_residual_m < SAME_M / 2.0;
        let samples = &tracks[link.tracks[1]].samples;
        let sum: Vector3<f64> = samples.iter().map(|sample| sample.position_m).sum();
        let center_m = sum / samples.len() as f64;
        fits.then_some(Candidate { tracks: link.tracks, aligned, center_m })
    };
    let candidates: Vec<Candidate> =
        similar.iter().take(MAX_CANDIDATES).filter_map(candidate).collect();
    let all: Vec<_> = consensus(&candidates)?.iter().map(|it| shared(it.tracks)).collect();
    let aligned = align(&all)?;
    let links = same_kind.into_iter().filter_map(|pair| {
        let distance_m = aligned.distance_m(&shared(pair))?;
        (distance_m < SAME_M).then_some(Link { tracks: pair, distance_m })
    });
    Some(links.collect())
}

/// Rms difference of distances at the best clock offset.
fn chord_difference_m(one: &UncodedTrack, other: &UncodedTrack) -> Option<f64> {
    let shifted = |shift: i64| {
        let skip = one.first_step - other.first_step + shift;
        let (mine, theirs) = (skip.min(0).unsigned_abs() as usize, skip.max(0) as usize);
        let pairs = one.chords_m.iter().skip(mine).zip(other.chords_m.iter().skip(theirs));
        let squares = pairs.map(|(a, b)| (a - b).powi(2)).filter(|square| !square.is_nan());
        let squares: Vec<f64> = squares.collect();
        let mean = squares.iter().sum::<f64>() / squares.len() as f64;
        (squares.len() >= MIN_STEPS).then(|| mean.sqrt())
    };
    (-MAX_SHIFT..=MAX_SHIFT).filter_map(shifted).min_by(f64::total_cmp)
}

/// Candidates that are consistent with the best-supported hypothesis, if it is unambiguous.
fn consensus(candidates: &[Candidate]) -> Option<Vec<&Candidate>> {
    let is_consistent = |one: &Candidate, other: &Candidate| {
        let (mine, theirs) = (&one.aligned, &other.aligned);
        let at =
            |aligned: &Alignment| aligned.one_from_other.transform_point(&other.center_m.into());
        let turn = mine.one_from_other.rotation.angle_to(&theirs.one_from_other.rotation);
        (at(mine) - at(theirs)).norm() < SAME_M
            && turn < CONSISTENT_RAD
            && (mine.ahead_s - theirs.ahead_s).abs() < CONSISTENT_S
    };
    let weight = |of: &[&Candidate]| of.iter().map(|it| it.aligned.pairs).sum::<usize>();
    let with = |one: &Candidate| -> Vec<&Candidate> {
        candidates.iter().filter(|other| is_consistent(one, other)).collect()
    };
    let best = candidates.iter().map(with).max_by_key(|found| weight(found))?;
    // A hypothesis without any pair of the best one is a rival.
    let is_in_best = |it: &&Candidate| best.iter().any(|found| found.tracks == it.tracks);
    let rivals = candidates.iter().map(|one| {
        let found = with(one);
        if found.iter().any(is_in_best) { 0 } else { weight(&found) }
    });
    let rival = rivals.max().unwrap_or(0);
    (weight(&best) >= MIN_CONSENSUS && weight(&best) > CLEAR_RATIO * rival).then_some(best)
}

/// Tracks of one roundel, each group in the order of keys.
fn groups(tracks: &[UncodedTrack], links: &[Link]) -> Vec<Vec<usize>> {
    let mut group_of: Vec<usize> = (0..tracks.len()).collect();
    let mut groups: Vec<Vec<usize>> = (0..tracks.len()).map(|index| vec![index]).collect();
    for link in links {
        let [one, other] = link.tracks.map(|index| group_of[index]);
        let collide = |i: usize, j: usize| {
            tracks[i].camera == tracks[j].camera
                && overlap(&tracks[i].samples, &tracks[j].samples) > MAX_OVERLAP_S
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

    /// A robot's path: two oscillations that do not repeat.
    fn robot_path(robot: usize, t: f64) -> Vector3<f64> {
        let phase = robot as f64 * 1.7;
        let (slow, quick) = (0.31 + 0.07 * robot as f64, 0.83 + 0.05 * robot as f64);
        Vector3::new((slow * t + phase).sin() * 2.0, (quick * t).cos() + 0.4 * robot as f64, 0.2)
    }

    /// Samples of two cameras over 20 s, the other's clock 0.23 s ahead.
    fn seen(robots: usize, path: impl Fn(usize, f64) -> Vector3<f64>) -> SamplesByRoundel {
        let place = |camera: u32| {
            let turn = UnitQuaternion::from_euler_angles(2.5 + 0.2 * f64::from(camera), 0.3, 0.5);
            Rigid::from_parts(Vector3::new(f64::from(camera), -2.0, 4.0).into(), turn)
        };
        let mut by_roundel = SamplesByRoundel::new();
        for (camera, robot) in (0..2).flat_map(|camera| (0..robots).map(move |it| (camera, it))) {
            let sample = |step: i32| {
                let t = f64::from(step) / 20.0;
                Sample {
                    stamp_s: t + 0.23 * f64::from(camera),
                    position_m: place(camera)
                        .inverse_transform_point(&path(robot, t).into())
                        .coords,
                    covariance: Matrix3::identity() * 1e-6,
                }
            };
            // The other camera numbers the robots in reverse order.
            let number = if camera == 0 { robot } else { 100 - robot };
            let name = RoundelKey::Uncoded(CameraId(camera), TrackNumber(number as u64));
            let samples = (-200..200).map(sample).collect();
            let seen = RoundelSamples { kind: Some(KindId(0)), samples };
            by_roundel.insert(name, BTreeMap::from([(CameraId(camera), seen)]));
        }
        by_roundel
    }

    #[test]
    fn only_tracks_with_equal_motion_are_associated() {
        let mut by_roundel = seen(6, robot_path);
        associate(&mut by_roundel);
        assert_eq!(by_roundel.len(), 6);
        for (robot, (name, cameras)) in by_roundel.iter().enumerate() {
            assert_eq!(*name, RoundelKey::Uncoded(CameraId(0), TrackNumber(robot as u64)));
            let place = |camera: u32| cameras[&CameraId(camera)].samples[200].position_m;
            let other = seen(6, robot_path);
            let number = TrackNumber(100 - robot as u64);
            let expected = &other[&RoundelKey::Uncoded(CameraId(1), number)][&CameraId(1)];
            assert_eq!(place(1), expected.samples[200].position_m);
            assert!(place(0) != place(1));
        }
    }

    #[test]
    fn robots_in_formation_are_not_associated() {
        let column =
            |robot: usize, t: f64| robot_path(0, t) + Vector3::new(0.0, 0.5 * robot as f64, 0.0);
        let mut by_roundel = seen(4, column);
        associate(&mut by_roundel);
        // Every pair fits some motion: four agree on the right one, three on the next.
        assert_eq!(by_roundel.len(), 8, "it is not clear who is who");
    }

    #[test]
    fn kinds_with_codes_are_left_alone() {
        let mut by_roundel = seen(3, robot_path);
        let code = roundel_vision::marker::Code { bits: 8, number: 3 };
        by_roundel.insert(RoundelKey::Coded(KindId(0), code), BTreeMap::new());
        associate(&mut by_roundel);
        assert_eq!(by_roundel.len(), 7);
    }
}
