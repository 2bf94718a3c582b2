//! Identifies references among the detected roundels.
//!
//! Plain references carry no number, so their mutual distances identify them. A depth-first search assigns detections
//! to references one after another; each must have the right distance to all assigned before. The remaining
//! arrangements are aligned and weighted. As many references as possible are identified, at least three. If a second
//! arrangement explains the detections about as well as the best, the layout is ambiguous, and the error lists the
//! references in which the two differ.

use nalgebra::Vector3;

use super::{PLACE_SIGMA_M, Placement, Reference, ReferenceError, Sighting, align};

/// Tolerance of a distance in standard deviations.
const SIGMAS: f64 = 4.0;
/// Additional tolerance as a share of the distance, for errors of lens and print.
const SCALE_SLACK: f64 = 0.01;
/// A second arrangement is excluded if its sum of squared residuals exceeds the best one's by this much: odds of
/// e⁹ to 1.
const CLEARLY_BETTER: f64 = 18.0;
/// Largest number of arrangements to compare; this many are ambiguous anyway.
const MAX_ARRANGEMENTS: usize = 256;
/// Largest number of trials in one search.
const MAX_TRIALS: usize = 2_000_000;

/// For each reference the index of its detection, `None` where it is not in view.
///
/// Errors: fewer than three of either; a distance that no two detections have; no arrangement that fits; several
/// that do.
pub fn identify(
    references: &[Reference],
    sightings: &[Sighting],
) -> Result<Vec<Option<usize>>, ReferenceError> {
    if references.len() < 3 {
        return Err(ReferenceError::TooFew { found: references.len() });
    }
    if sightings.len() < 3 {
        return Err(ReferenceError::TooFewSeen { found: sightings.len() });
    }
    let max_wanted = references.len().min(sightings.len());
    let mut best_failure = None;
    for wanted in (3..=max_wanted).rev() {
        let mut search = Search { references, sightings, wanted, found: Vec::new(), trials: 0 };
        search.extend(&mut Vec::with_capacity(references.len()), 0);
        let mut fitting = Vec::new();
        for arrangement in search.found {
            match judge(references, sightings, &arrangement) {
                Ok(Verdict::Fits(cost)) => fitting.push((cost, arrangement)),
                Ok(Verdict::Misses { index, residual_m }) => {
                    let failure = ReferenceError::Inconsistent { wanted, index, residual_m };
                    best_failure.get_or_insert(failure);
                }
                Ok(Verdict::FacesAway) => {}
                Err(error) => {
                    best_failure.get_or_insert(error);
                }
            }
        }
        if !fitting.is_empty() {
            return choose(fitting);
        }
    }
    Err(missing_distance(references, sightings)
        .or(best_failure)
        .unwrap_or(ReferenceError::Inconsistent { wanted: 3, index: 0, residual_m: f64::INFINITY }))
}

/// Depth-first search over references, each assigned a detection or none.
struct Search<'a> {
    references: &'a [Reference],
    sightings: &'a [Sighting],
    wanted: usize,
    found: Vec<Vec<Option<usize>>>,
    trials: usize,
}

impl Search<'_> {
    fn extend(&mut self, given: &mut Vec<Option<usize>>, matched: usize) {
        let next = given.len();
        if next == self.references.len() {
            if matched == self.wanted {
                self.found.push(given.clone());
            }
            return;
        }
        if matched < self.wanted {
            for candidate in 0..self.sightings.len() {
                self.trials += 1;
                if self.found.len() >= MAX_ARRANGEMENTS || self.trials >= MAX_TRIALS {
                    return;
                }
                if !given.contains(&Some(candidate)) && self.agrees(given, next, candidate) {
                    given.push(Some(candidate));
                    self.extend(given, matched + 1);
                    given.pop();
                }
            }
        }
        if matched + self.references.len() - next > self.wanted {
            given.push(None);
            self.extend(given, matched);
            given.pop();
        }
    }

    fn agrees(&self, given: &[Option<usize>], next: usize, candidate: usize) -> bool {
        given.iter().enumerate().all(|(other, &taken)| {
            let Some(taken) = taken else { return true };
            let (a, b) = (&self.sightings[candidate], &self.sightings[taken]);
            let distance = Distance::between(a, b);
            let expected_m =
                (self.references[next].position_m - self.references[other].position_m).norm();
            (distance.length_m - expected_m).abs() <= distance.tolerance_m(expected_m)
        })
    }
}

/// Distance of two detections and its standard deviation.
struct Distance {
    length_m: f64,
    sigma_m: f64,
}

impl Distance {
    fn between(a: &Sighting, b: &Sighting) -> Self {
        let between = a.position_m - b.position_m;
        let length_m = between.norm();
        let along = if length_m > 0.0 { between / length_m } else { Vector3::z() };
        let variance = along.dot(&((a.covariance + b.covariance) * along))
            + 2.0 * PLACE_SIGMA_M * PLACE_SIGMA_M;
        Self { length_m, sigma_m: variance.sqrt() }
    }

    fn tolerance_m(&self, expected_m: f64) -> f64 {
        SIGMAS * self.sigma_m + SCALE_SLACK * expected_m
    }
}

/// Verdict about an arrangement whose distances agree.
enum Verdict {
    /// Sum of squared residuals in standard deviations.
    Fits(f64),
    /// Mirrored, or otherwise not rigid, with the reference that is farthest off.
    Misses { index: usize, residual_m: f64 },
    /// The camera would be behind a reference.
    FacesAway,
}

fn judge(
    references: &[Reference],
    sightings: &[Sighting],
    arrangement: &[Option<usize>],
) -> Result<Verdict, ReferenceError> {
    let pairs: Vec<(usize, usize)> = arrangement
        .iter()
        .enumerate()
        .filter_map(|(reference, &sighting)| Some((reference, sighting?)))
        .collect();
    let world_m: Vec<_> = pairs.iter().map(|&(r, _)| references[r].position_m).collect();
    let paired: Vec<_> = pairs.iter().map(|&(_, s)| sightings[s]).collect();
    let placement = align(&world_m, &paired)?;
    let camera_m = placement.world_from_camera.translation.vector;
    let faces_away = pairs.iter().any(|&(r, _)| {
        references[r].normal.is_some_and(|n| n.dot(&(camera_m - references[r].position_m)) <= 0.0)
    });
    if faces_away {
        return Ok(Verdict::FacesAway);
    }
    let mut cost = 0.0;
    for (place, (reference, sighting)) in
        pairs.iter().map(|&(r, _)| r).zip(world_m.iter().zip(&paired))
    {
        let (squared, residual_m) = squared_residual(&placement, reference, sighting);
        let slack_m = SCALE_SLACK * sighting.position_m.norm();
        if squared > SIGMAS * SIGMAS * 3.0 && residual_m > slack_m {
            return Ok(Verdict::Misses { index: place, residual_m });
        }
        cost += squared;
    }
    Ok(Verdict::Fits(cost))
}

/// Squared residual in standard deviations, and its length in metres.
fn squared_residual(
    placement: &Placement,
    world_m: &Vector3<f64>,
    sighting: &Sighting,
) -> (f64, f64) {
    let turn = placement.world_from_camera.rotation.to_rotation_matrix().into_inner();
    let there = turn * sighting.position_m + placement.world_from_camera.translation.vector;
    let residual = world_m - there;
    let spread = turn * sighting.covariance * turn.transpose()
        + nalgebra::Matrix3::from_diagonal_element(PLACE_SIGMA_M * PLACE_SIGMA_M);
    let squared =
        roundel_vision::rigid::mahalanobis_squared(&residual, &spread).unwrap_or(f64::INFINITY);
    (squared, residual.norm())
}

/// The best arrangement, unless others are about as good.
fn choose(
    mut fitting: Vec<(f64, Vec<Option<usize>>)>,
) -> Result<Vec<Option<usize>>, ReferenceError> {
    fitting.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (cost, best) = fitting.swap_remove(0);
    let mut indices: Vec<usize> = fitting
        .iter()
        .filter(|(other, _)| *other < cost + CLEARLY_BETTER)
        .flat_map(|(_, arrangement)| (0..best.len()).filter(|&k| arrangement[k] != best[k]))
        .collect();
    indices.sort_unstable();
    indices.dedup();
    if indices.is_empty() { Ok(best) } else { Err(ReferenceError::Ambiguous { indices }) }
}

/// The pair of references whose distance is farthest from that of any two detections, if it is missing.
fn missing_distance(references: &[Reference], sightings: &[Sighting]) -> Option<ReferenceError> {
    let mut worst: Option<(f64, ReferenceError)> = None;
    for second in 1..references.len() {
        for first in 0..second {
            let expected_m = (references[first].position_m - references[second].position_m).norm();
            let nearest = (1..sightings.len())
                .flat_map(|b| (0..b).map(move |a| (a, b)))
                .map(|(a, b)| Distance::between(&sightings[a], &sightings[b]))
                .min_by(|a, b| {
                    (a.length_m - expected_m).abs().total_cmp(&(b.length_m - expected_m).abs())
                })?;
            let miss_m = (nearest.length_m - expected_m).abs();
            if miss_m > nearest.tolerance_m(expected_m)
                && worst.as_ref().is_none_or(|(worst_m, _)| miss_m > *worst_m)
            {
                let nearest_m = nearest.length_m;
                let error = ReferenceError::NoSuchDistance { first, second, expected_m, nearest_m };
                worst = Some((miss_m, error));
            }
        }
    }
    worst.map(|(_, error)| error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::reference::place_camera;
    use nalgebra::{Matrix3, Point3};
    use proptest::prelude::*;
    use roundel_vision::rigid::Rigid;

    fn reference(position_m: [f64; 3]) -> Reference {
        Reference { position_m: position_m.into(), normal: Some(Vector3::z()) }
    }

    /// Layout of the example configuration.
    fn layout() -> Vec<Reference> {
        [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 1.5, 0.0], [2.0, 1.7, 0.0]].map(reference).to_vec()
    }

    fn overhead() -> Rigid {
        Rigid::new(Vector3::new(1.2, 0.3, 4.0), Vector3::new(3.0, 0.2, -0.1))
    }

    fn see(world_from_camera: &Rigid, world_m: Vector3<f64>) -> Sighting {
        let point = world_from_camera.inverse() * Point3::from(world_m);
        Sighting {
            position_m: point.coords,
            covariance: Matrix3::from_diagonal(&Vector3::new(1e-6, 1e-6, 1e-4)),
        }
    }

    fn see_all(references: &[Reference]) -> Vec<Sighting> {
        references.iter().map(|r| see(&overhead(), r.position_m)).collect()
    }

    proptest! {
        #[test]
        fn shuffled_references_among_decoys_are_found(
            order in Just([0usize, 1, 2, 3, 4, 5, 6]).prop_shuffle(),
            decoys in proptest::collection::vec((-3.0..3.0f64, -3.0..3.0f64, 0.1..1.0f64), 3),
        ) {
            let references = layout();
            let mut all = see_all(&references);
            all.extend(decoys.iter().map(|&(x, y, z)| see(&overhead(), Vector3::new(x, y, z))));
            let shuffled: Vec<_> = order.iter().map(|&k| all[k]).collect();
            match place_camera(&references, &shuffled) {
                Ok((placement, found)) => {
                    for (index, sighting) in found.iter().enumerate() {
                        prop_assert_eq!(order[sighting.unwrap()], index);
                    }
                    let off = placement.world_from_camera.inverse() * overhead();
                    prop_assert!(off.translation.vector.norm() < 1e-9);
                }
                // A decoy may happen to take a reference's place.
                Err(error) => prop_assert!(matches!(error, ReferenceError::Ambiguous { .. }), "{}", error),
            }
        }
    }

    #[test]
    fn three_of_four_suffice_without_symmetry() {
        let references = layout();
        let sightings = see_all(&references[1..]);
        assert_eq!(identify(&references, &sightings).unwrap(), [None, Some(0), Some(1), Some(2)]);
    }

    #[test]
    fn a_rectangle_is_reported_as_ambiguous() {
        let references =
            [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0], [2.0, 1.0, 0.0]].map(reference);
        assert_eq!(
            identify(&references, &see_all(&references)),
            Err(ReferenceError::Ambiguous { indices: vec![0, 1, 2, 3] })
        );
    }

    #[test]
    fn an_isosceles_triangle_needs_its_normals() {
        let mut references = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [1.0, 1.5, 0.0]].map(reference);
        let sightings = see_all(&references);
        assert_eq!(identify(&references, &sightings).unwrap(), [Some(0), Some(1), Some(2)]);
        for reference in &mut references {
            reference.normal = None;
        }
        assert_eq!(
            identify(&references, &sightings),
            Err(ReferenceError::Ambiguous { indices: vec![0, 1] })
        );
    }

    #[test]
    fn a_moved_reference_is_left_out_and_a_missing_distance_reported() {
        let references = layout();
        let mut sightings = see_all(&references);
        sightings[3] = see(&overhead(), Vector3::new(2.6, 1.9, 0.0));
        assert_eq!(
            identify(&references, &sightings).unwrap(),
            [Some(0), Some(1), Some(2), None],
            "the three that still agree"
        );
        let error = identify(&references[..3], &see_all(&references)[1..]).unwrap_err();
        assert!(
            matches!(error, ReferenceError::NoSuchDistance { first: 0, second: 1, .. })
                || matches!(error, ReferenceError::NoSuchDistance { first: 0, second: 2, .. }),
            "{error}"
        );
    }

    #[test]
    fn a_mirrored_arrangement_does_not_fit() {
        // Not in one plane: its mirror image has the same distances.
        let references =
            [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.3, 1.5, 0.0], [0.8, 0.4, 1.0]].map(reference);
        let mirrored: Vec<_> = references
            .iter()
            .map(|r| see(&overhead(), r.position_m.component_mul(&Vector3::new(1.0, 1.0, -1.0))))
            .collect();
        let found = identify(&references, &mirrored);
        assert!(found.as_ref().map_or(true, |f| f.contains(&None)), "{found:?}");
    }

    #[test]
    fn too_few_are_rejected() {
        let references = layout();
        let sightings = see_all(&references);
        assert_eq!(
            identify(&references[..2], &sightings),
            Err(ReferenceError::TooFew { found: 2 })
        );
        assert_eq!(
            identify(&references, &sightings[..2]),
            Err(ReferenceError::TooFewSeen { found: 2 })
        );
    }
}
