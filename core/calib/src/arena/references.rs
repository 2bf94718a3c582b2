//! Reference roundels among the samples, and the cameras located by them.
//!
//! Coded references are identified by their codes; uncoded ones by their mutual distances among the stationary roundels
//! ([`roundel_fusion::world::reference::identify`]). The samples of a camera are averaged: if a share q of the variance Σ
//! is correlated over a time τ, the mean over T ≫ τ and N frames has Σ (q min(1, 2 τ / T) + (1 - q) / N). References that
//! were moved during the recording show by differing means over time; references at a wrong stated position show by the
//! effect of leaving them out.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};

use super::{
    ArenaCamera, ArenaError, ArenaParams, CameraPoses, Finding, LensDeviation,
    recording::{RoundelKey, RoundelSamples, Sample, SamplesByRoundel},
};
use roundel_fusion::world::{
    Landmark,
    reference::{self, Reference, Sighting, align_stated},
};
use roundel_vision::{
    id::CameraId,
    rigid::{Rigid, mahalanobis_squared},
};

/// Duration of the compared means, seconds.
const BLOCK_S: f64 = 2.0;
/// Means that differ by more than both limits indicate motion.
const MOVED_DEVIATIONS: f64 = 6.0;
const MOVED_M: f64 = 0.003;
/// Maximum rms spread of a stationary roundel beyond its noise, metres.
const STATIONARY_M: f64 = 0.003;
/// Squared Mahalanobis distance of an outlier (χ², 3 degrees of freedom: 1 - 10⁻⁶).
const OUTLIER_SQUARED: f64 = 30.7;
/// Minimum distance of an outlier from its stated position, metres.
const MIN_OUTLIER_M: f64 = 0.002;

#[derive(Clone, Debug)]
pub(super) struct ObservedReference {
    /// Index in the given order.
    pub(super) index: usize,
    /// Stated position and its standard deviation, metres.
    pub(super) stated: (Vector3<f64>, f64),
    /// Mean sample of each camera that sees it.
    pub(super) seen: Vec<(usize, Sample)>,
}

#[derive(Clone, Debug, Default)]
pub(super) struct ReferenceSet {
    pub(super) references: Vec<ObservedReference>,
    /// Pose of each camera from the references alone.
    pub(super) camera_poses: CameraPoses,
    /// Findings by kind, most important first.
    pub(super) misplaced: Vec<Finding>,
    pub(super) moved: Vec<Finding>,
    pub(super) unseen: Vec<Finding>,
}

/// Removes the references from the samples and locates the cameras that see three or more.
pub(super) fn take(
    by_roundel: &mut SamplesByRoundel,
    cameras: &[ArenaCamera],
    landmarks: &[Landmark],
    params: &ArenaParams,
) -> Result<ReferenceSet, ArenaError> {
    let index_of = |id: CameraId| cameras.iter().position(|camera| camera.id == id);
    let mut reference_set =
        ReferenceSet { camera_poses: vec![None; cameras.len()], ..ReferenceSet::default() };
    let mut seen = coded(by_roundel, landmarks);
    for camera in cameras {
        uncoded(by_roundel, camera.id, landmarks, &mut seen, params);
    }
    for (index, landmark) in landmarks.iter().enumerate() {
        let mut means = Vec::new();
        let moved_before = reference_set.moved.len();
        for (id, seen) in seen.remove(&index).unwrap_or_default() {
            let Some(camera) = index_of(id) else { continue };
            match mean(&seen.samples, params) {
                Ok(mean) => means.extend(mean.map(|mean| (camera, mean))),
                Err(moved_m) => {
                    let moved = Finding::Moved { reference: index, camera: id, moved_m };
                    reference_set.moved.push(moved);
                }
            }
        }
        if means.is_empty() && reference_set.moved.len() == moved_before {
            reference_set.unseen.push(Finding::ReferenceUnseen { reference: index });
        }
        reference_set.references.push(ObservedReference {
            index,
            stated: (landmark.position_m, landmark.position_deviation_m),
            seen: means,
        });
    }
    for (index, camera) in cameras.iter().enumerate() {
        locate_camera(&mut reference_set, camera, index)?;
    }
    if reference_set.camera_poses.iter().all(Option::is_none) {
        let count = |camera: usize| {
            reference_set.references.iter().filter(|r| r.seen.iter().any(|s| s.0 == camera)).count()
        };
        let seen = (0..cameras.len()).map(|index| (cameras[index].id, count(index))).collect();
        return Err(ArenaError::References { seen });
    }
    Ok(reference_set)
}

/// Samples of coded references by reference.
fn coded(
    by_roundel: &mut SamplesByRoundel,
    landmarks: &[Landmark],
) -> BTreeMap<usize, BTreeMap<CameraId, RoundelSamples>> {
    let coded = landmarks.iter().enumerate().filter_map(|(index, landmark)| {
        let name = RoundelKey::Coded(landmark.kind, landmark.code?);
        Some((index, by_roundel.remove(&name)?))
    });
    coded.collect()
}

/// Moves samples of uncoded references in one camera to `seen`.
fn uncoded(
    by_roundel: &mut SamplesByRoundel,
    camera: CameraId,
    landmarks: &[Landmark],
    seen: &mut BTreeMap<usize, BTreeMap<CameraId, RoundelSamples>>,
    params: &ArenaParams,
) {
    let uncoded_indices: Vec<usize> =
        (0..landmarks.len()).filter(|&index| landmarks[index].code.is_none()).collect();
    if uncoded_indices.len() < 3 {
        return;
    }
    let kinds: Vec<_> = uncoded_indices.iter().map(|&index| landmarks[index].kind).collect();
    let mut stationary: Vec<(RoundelKey, Sighting)> = Vec::new();
    for (name, seen) in by_roundel.iter() {
        let RoundelKey::Uncoded(of, _) = name else { continue };
        let Some(seen) = seen.get(&camera).filter(|_| *of == camera) else { continue };
        let is_kind = seen.kind.is_some_and(|kind| kinds.contains(&kind));
        let Ok(Some(mean)) = mean(&seen.samples, params) else { continue };
        if is_kind && is_stationary(&seen.samples, &mean) {
            let Sample { position_m, covariance, .. } = mean;
            stationary.push((*name, Sighting { position_m, covariance }));
        }
    }
    let reference = |&index: &usize| Reference {
        position_m: landmarks[index].position_m,
        normal: landmarks[index].orientation.map(|turn| turn * Vector3::z()),
    };
    let references: Vec<Reference> = uncoded_indices.iter().map(reference).collect();
    let sightings: Vec<Sighting> = stationary.iter().map(|(_, sighting)| *sighting).collect();
    if sightings.len() < 3 {
        return;
    }
    // The camera does not see the references.
    let Ok(found) = reference::identify(&references, &sightings) else { return };
    for (index, found) in std::iter::zip(uncoded_indices, found) {
        let Some((name, _)) = found.map(|at| stationary[at]) else { continue };
        if let Some(taken) = by_roundel.remove(&name).and_then(|mut seen| seen.remove(&camera)) {
            seen.entry(index).or_default().insert(camera, taken);
        }
    }
}

fn is_stationary(samples: &[Sample], mean: &Sample) -> bool {
    let square: f64 = samples.iter().map(|s| (s.position_m - mean.position_m).norm_squared()).sum();
    let noise: f64 = samples.iter().map(|s| s.covariance.trace()).sum();
    let count = samples.len() as f64;
    square / count < 4.0 * noise / count + STATIONARY_M * STATIONARY_M
}

/// Mean with its covariance, or the distance by which the roundel moved.
fn mean(samples: &[Sample], params: &ArenaParams) -> Result<Option<Sample>, f64> {
    let Some(first) = samples.first() else { return Ok(None) };
    let block = |sample: &Sample| ((sample.stamp_s - first.stamp_s) / BLOCK_S).floor() as i64;
    let parts: Vec<Sample> = samples
        .chunk_by(|one, other| block(one) == block(other))
        .filter(|part| part.len() >= 5)
        .filter_map(|part| average(part, params))
        .collect();
    // Compares the first and the last mean.
    let moved_m = parts.first().zip(parts.last()).and_then(|(one, other)| {
        let apart = other.position_m - one.position_m;
        let square = mahalanobis_squared(&apart, &(one.covariance + other.covariance))?;
        (square > MOVED_DEVIATIONS * MOVED_DEVIATIONS && apart.norm() > MOVED_M)
            .then_some(apart.norm())
    });
    moved_m.map_or_else(|| Ok(average(samples, params)), Err)
}

fn average(samples: &[Sample], params: &ArenaParams) -> Option<Sample> {
    let first = samples.first()?;
    let count = samples.len() as f64;
    let mut information = Matrix3::zeros();
    let mut weighted = Vector3::zeros();
    for sample in samples {
        let weight = sample.covariance.cholesky()?.inverse();
        information += weight;
        weighted += weight * sample.position_m;
    }
    let inverse = information.cholesky()?.inverse();
    // All frames of a stationary roundel show the same pixels, so systematic errors do not average out.
    let stays = params.systematic_share.clamp(0.0, 1.0);
    let covariance = inverse * count * (stays + (1.0 - stays) / count);
    Some(Sample { stamp_s: first.stamp_s, position_m: inverse * weighted, covariance })
}

/// Locates a camera by the references. A reference that is inconsistent with all others is left out.
fn locate_camera(
    reference_set: &mut ReferenceSet,
    camera: &ArenaCamera,
    camera_index: usize,
) -> Result<(), ArenaError> {
    let id = camera.id;
    loop {
        let view = view(reference_set, camera, camera_index);
        if view.len() < 3 {
            return Ok(());
        }
        let pose = fit(&view).map_err(|source| ArenaError::Placing { camera: id, source })?;
        if is_consistent(&view, &pose) {
            reference_set.camera_poses[camera_index] = Some(pose);
            return Ok(());
        }
        // Unambiguous if leaving out exactly one reference makes the others consistent.
        let without = |index: usize| {
            let rest: Vec<_> = view.iter().filter(|one| one.index != index).copied().collect();
            let pose = fit(&rest).ok()?;
            is_consistent(&rest, &pose).then_some((index, pose))
        };
        let remedies: Vec<(usize, Rigid)> = if view.len() > 3 {
            view.iter().filter_map(|one| without(one.index)).collect()
        } else {
            Vec::new()
        };
        let [(index, pose)] = remedies[..] else {
            let offset = |one: &SeenReference| (one.index, offset(one, &pose).0);
            let offs_m = view.iter().map(offset).collect();
            return Err(ArenaError::Misplaced { camera: id, offs_m });
        };
        if let Some(one) = view.iter().find(|one| one.index == index) {
            let (off_m, _) = offset(one, &pose);
            let misplaced = Finding::Misplaced { reference: index, camera: id, off_m };
            reference_set.misplaced.push(misplaced);
        }
        // Drop it for all cameras.
        for reference in reference_set.references.iter_mut().filter(|one| one.index == index) {
            reference.seen.clear();
        }
    }
}

/// A reference in the view of one camera.
#[derive(Clone, Copy)]
struct SeenReference {
    index: usize,
    /// Stated position and its standard deviation.
    stated: (Vector3<f64>, f64),
    sighting: Sighting,
}

fn view(
    reference_set: &ReferenceSet,
    camera: &ArenaCamera,
    camera_index: usize,
) -> Vec<SeenReference> {
    let seen = reference_set.references.iter().filter_map(|one| {
        let (_, mean) = one.seen.iter().find(|(other, _)| *other == camera_index)?;
        let sighting = with_lens_uncertainty(mean, camera);
        Some(SeenReference { index: one.index, stated: one.stated, sighting })
    });
    seen.collect()
}

/// Adds the uncertainty of the lens: along the line of sight by the focal length, across by the principal point.
fn with_lens_uncertainty(seen: &Sample, camera: &ArenaCamera) -> Sighting {
    let mut covariance = seen.covariance;
    if let Some(LensDeviation { focal, center_px, .. }) = camera.lens_deviation {
        let along = seen.position_m.normalize();
        let along = along * along.transpose();
        let turn_rad = center_px / camera.lens.intrinsics().fx_px;
        let share = along * (focal * focal) + (Matrix3::identity() - along) * (turn_rad * turn_rad);
        covariance += share * seen.position_m.norm_squared();
    }
    Sighting { position_m: seen.position_m, covariance }
}

fn fit(view: &[SeenReference]) -> Result<Rigid, reference::ReferenceError> {
    let (stated, seen): (Vec<_>, Vec<_>) =
        view.iter().map(|one| (one.stated, one.sighting)).unzip();
    Ok(align_stated(&stated, &seen)?.world_from_camera)
}

/// Distance from the stated position, metres, and squared Mahalanobis distance.
fn offset(one: &SeenReference, pose: &Rigid) -> (f64, f64) {
    let (position_m, deviation_m) = one.stated;
    let turn = pose.rotation.to_rotation_matrix().into_inner();
    let error = pose.transform_point(&one.sighting.position_m.into()).coords - position_m;
    let covariance = turn * one.sighting.covariance * turn.transpose()
        + Matrix3::from_diagonal_element(deviation_m * deviation_m);
    (error.norm(), mahalanobis_squared(&error, &covariance).unwrap_or(f64::INFINITY))
}

/// Whether no reference is far from its stated position.
fn is_consistent(view: &[SeenReference], pose: &Rigid) -> bool {
    let is_outlier = |(off_m, square)| square > OUTLIER_SQUARED && off_m > MIN_OUTLIER_M;
    !view.iter().map(|one| offset(one, pose)).any(is_outlier)
}
