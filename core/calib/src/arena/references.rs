//! References among what was seen, and the cameras that see three or more of them.
//!
//! A reference with a code is known by it; those without are found by their mutual distances among what
//! stands still ([`roundel_fusion::world::reference::identify`]). What a camera saw of one is averaged: with share q
//! of the variance Σ staying for a time τ, the mean over T ≫ τ and N frames has
//! Σ (q min(1, 2 τ / T) + (1 - q) / N). One that was moved meanwhile is seen by means of stretches that
//! differ; one that was never where it was said to be by what leaving it out does to the fit.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};

use super::{
    ArenaCamera, ArenaError, ArenaParams, LensDeviation, Placed,
    recording::{Name, Sample, Seen, Sorted},
};
use roundel_fusion::world::{
    Landmark,
    reference::{self, Reference, Sighting, align_stated},
};
use roundel_vision::{
    camera::Camera,
    id::CameraId,
    rigid::{Rigid, mahalanobis_squared},
};

/// Means over this long are compared, seconds.
const STRETCH_S: f64 = 2.0;
/// A mean that is off by more deviations and more metres than these has moved.
const MOVED_DEVIATIONS: f64 = 6.0;
const MOVED_M: f64 = 0.003;
/// What stands still spreads no more than this, rms, beyond its noise, metres.
const STILL_M: f64 = 0.003;
/// A reference's squared distance from its place, over its covariance, beyond which something is wrong
/// (χ², 3 degrees of freedom: 1 - 10⁻⁶).
const WRONG_SQUARED: f64 = 30.7;
/// What a stated place may be off without being called wrong, metres.
const LEAST_WRONG_M: f64 = 0.002;

/// One reference as cameras see it.
#[derive(Clone, Debug)]
pub(super) struct Stands {
    /// In the order given.
    pub(super) index: usize,
    pub(super) position_m: Vector3<f64>,
    pub(super) deviation_m: f64,
    /// Mean of each camera that sees it.
    pub(super) seen: Vec<(usize, Sample)>,
}

/// All references that are of use.
#[derive(Clone, Debug, Default)]
pub(super) struct Standing {
    pub(super) references: Vec<Stands>,
    /// By camera: where it is by the references alone.
    pub(super) placed: Placed,
    /// Reference, camera, by how much it moved.
    pub(super) moved: Vec<(usize, usize, f64)>,
    /// Reference, camera, how far it is from where it was said to be.
    pub(super) misplaced: Vec<(usize, usize, f64)>,
    pub(super) unseen: Vec<usize>,
}

/// Takes the references out of what was seen.
pub(super) fn take(
    sorted: &mut Sorted,
    cameras: &[ArenaCamera],
    landmarks: &[Landmark],
    params: &ArenaParams,
) -> Result<Standing, ArenaError> {
    let index_of = |id: CameraId| cameras.iter().position(|camera| camera.id == id);
    let mut standing = Standing { placed: vec![None; cameras.len()], ..Standing::default() };
    let mut seen = coded(sorted, landmarks);
    for camera in cameras {
        nameless(sorted, camera.id, landmarks, &mut seen, params)?;
    }
    for (index, landmark) in landmarks.iter().enumerate() {
        let mut means = Vec::new();
        for (camera, seen) in seen.remove(&index).unwrap_or_default() {
            let Some(camera) = index_of(camera) else { continue };
            let (mean, moved_m) = mean(&seen.samples, params);
            match (mean, moved_m) {
                (_, Some(moved_m)) => standing.moved.push((index, camera, moved_m)),
                (Some(mean), None) => means.push((camera, mean)),
                (None, None) => {}
            }
        }
        if means.is_empty() && !standing.moved.iter().any(|moved| moved.0 == index) {
            standing.unseen.push(index);
        }
        standing.references.push(Stands {
            index,
            position_m: landmark.position_m,
            deviation_m: landmark.position_deviation_m,
            seen: means,
        });
    }
    for (index, camera) in cameras.iter().enumerate() {
        place(&mut standing, camera, index)?;
    }
    if standing.placed.iter().all(Option::is_none) {
        let count = |camera: usize| {
            standing.references.iter().filter(|r| r.seen.iter().any(|s| s.0 == camera)).count()
        };
        let seen = (0..cameras.len()).map(|index| (cameras[index].id, count(index))).collect();
        return Err(ArenaError::References { seen });
    }
    Ok(standing)
}

/// Those with codes, by reference.
fn coded(sorted: &mut Sorted, landmarks: &[Landmark]) -> BTreeMap<usize, BTreeMap<CameraId, Seen>> {
    let coded = landmarks.iter().enumerate().filter_map(|(index, landmark)| {
        let name = Name::Coded(landmark.kind, landmark.code?);
        Some((index, sorted.remove(&name)?))
    });
    coded.collect()
}

/// Those without, as one camera sees them.
fn nameless(
    sorted: &mut Sorted,
    camera: CameraId,
    landmarks: &[Landmark],
    seen: &mut BTreeMap<usize, BTreeMap<CameraId, Seen>>,
    params: &ArenaParams,
) -> Result<(), ArenaError> {
    let wanted: Vec<usize> =
        (0..landmarks.len()).filter(|&index| landmarks[index].code.is_none()).collect();
    if wanted.len() < 3 {
        return Ok(());
    }
    let kinds: Vec<_> = wanted.iter().map(|&index| landmarks[index].kind).collect();
    let mut still: Vec<(Name, Sighting)> = Vec::new();
    for (name, seen) in sorted.iter() {
        let Name::Nameless(of, _) = name else { continue };
        let Some(seen) = seen.get(&camera).filter(|_| *of == camera) else { continue };
        let is_kind = seen.kind.is_some_and(|kind| kinds.contains(&kind));
        let (Some(mean), None) = mean(&seen.samples, params) else { continue };
        if is_kind && is_still(&seen.samples, &mean) {
            still.push((*name, Sighting { position_m: mean.place_m, covariance: mean.covariance }));
        }
    }
    let references: Vec<Reference> = wanted
        .iter()
        .map(|&index| Reference {
            position_m: landmarks[index].position_m,
            normal: landmarks[index].orientation.map(|turn| turn * Vector3::z()),
        })
        .collect();
    let sightings: Vec<Sighting> = still.iter().map(|(_, sighting)| *sighting).collect();
    if sightings.len() < 3 {
        return Ok(());
    }
    // A camera that does not see them is none of the references' business.
    let Ok(found) = reference::identify(&references, &sightings) else { return Ok(()) };
    for (index, found) in std::iter::zip(wanted, found) {
        let Some((name, _)) = found.map(|at| still[at]) else { continue };
        if let Some(taken) = sorted.remove(&name).and_then(|mut seen| seen.remove(&camera)) {
            seen.entry(index).or_default().insert(camera, taken);
        }
    }
    Ok(())
}

fn is_still(samples: &[Sample], mean: &Sample) -> bool {
    let square: f64 = samples.iter().map(|s| (s.place_m - mean.place_m).norm_squared()).sum();
    let noise: f64 = samples.iter().map(|s| s.covariance.trace()).sum();
    let count = samples.len() as f64;
    square / count < 4.0 * noise / count + STILL_M * STILL_M
}

/// Mean with its covariance, or by how much it moved.
fn mean(samples: &[Sample], params: &ArenaParams) -> (Option<Sample>, Option<f64>) {
    let Some(first) = samples.first() else { return (None, None) };
    let whole = average(samples, params);
    let stretch = |sample: &Sample| ((sample.stamp_s - first.stamp_s) / STRETCH_S).floor() as i64;
    let parts: Vec<Sample> = samples
        .chunk_by(|one, other| stretch(one) == stretch(other))
        .filter(|part| part.len() >= 5)
        .filter_map(|part| average(part, params))
        .collect();
    // Compared with the first and the last, between which it would have moved.
    let moved_m = parts.first().zip(parts.last()).and_then(|(one, other)| {
        let apart = other.place_m - one.place_m;
        let square = mahalanobis_squared(&apart, &(one.covariance + other.covariance))?;
        (square > MOVED_DEVIATIONS * MOVED_DEVIATIONS && apart.norm() > MOVED_M)
            .then_some(apart.norm())
    });
    (whole, moved_m)
}

fn average(samples: &[Sample], params: &ArenaParams) -> Option<Sample> {
    let first = samples.first()?;
    let count = samples.len() as f64;
    let mut information = Matrix3::zeros();
    let mut weighted = Vector3::zeros();
    for sample in samples {
        let weight = sample.covariance.cholesky()?.inverse();
        information += weight;
        weighted += weight * sample.place_m;
    }
    let inverse = information.cholesky()?.inverse();
    // Of what stands, each frame shows the same pixels: what is systematic stays.
    let stays = params.systematic_share.clamp(0.0, 1.0);
    let covariance = inverse * count * (stays + (1.0 - stays) / count);
    Some(Sample { stamp_s: first.stamp_s, place_m: inverse * weighted, covariance })
}

/// Where a camera is by the references alone; one that fits with no others is left out.
fn place(
    standing: &mut Standing,
    ArenaCamera { id, lens, lens_deviation }: &ArenaCamera,
    camera: usize,
) -> Result<(), ArenaError> {
    let id = *id;
    let sure = |seen: &Sample| lensed(seen, lens, lens_deviation.as_ref());
    loop {
        let view = view(standing, camera, sure);
        if view.len() < 3 {
            return Ok(());
        }
        let place = fit(&view).map_err(|source| ArenaError::Placing { camera: id, source })?;
        let wrong = worst(&view, &place);
        if wrong.is_none() {
            standing.placed[camera] = Some(place);
            return Ok(());
        }
        // Right is what is left if just one way of leaving one out makes all others fit.
        let without = |index: usize| {
            let rest: Vec<_> = view.iter().filter(|one| one.0 != index).copied().collect();
            let place = fit(&rest).ok()?;
            worst(&rest, &place).is_none().then_some((index, place))
        };
        let cures: Vec<(usize, Rigid)> = if view.len() > 3 {
            view.iter().filter_map(|one| without(one.0)).collect()
        } else {
            Vec::new()
        };
        let [(index, place)] = cures[..] else {
            let off = |one: &(usize, Stated, Sighting)| (one.0, off(one, &place).0);
            return Err(ArenaError::Misplaced {
                camera: id,
                offs_m: view.iter().map(off).collect(),
            });
        };
        if let Some(one) = view.iter().find(|one| one.0 == index) {
            standing.misplaced.push((index, camera, off(one, &place).0));
        }
        // Wrong for one camera is wrong for all.
        for reference in standing.references.iter_mut().filter(|one| one.index == index) {
            reference.seen.clear();
        }
    }
}

/// Where a reference was said to be, and how well that is known.
type Stated = (Vector3<f64>, f64);

/// References that a camera sees.
fn view(
    standing: &Standing,
    camera: usize,
    sure: impl Fn(&Sample) -> Sighting,
) -> Vec<(usize, Stated, Sighting)> {
    let seen = standing.references.iter().filter_map(|one| {
        let (_, mean) = one.seen.iter().find(|(other, _)| *other == camera)?;
        Some((one.index, (one.position_m, one.deviation_m), sure(mean)))
    });
    seen.collect()
}

/// What a lens that is not exactly known adds: along the line of sight by the focal length, across by the
/// principal point.
fn lensed(seen: &Sample, lens: &Camera, deviation: Option<&LensDeviation>) -> Sighting {
    let mut covariance = seen.covariance;
    if let Some(LensDeviation { focal, center_px, .. }) = deviation {
        let along = seen.place_m.normalize();
        let along = along * along.transpose();
        let turn_rad = center_px / lens.intrinsics().fx_px;
        let share = along * (focal * focal) + (Matrix3::identity() - along) * (turn_rad * turn_rad);
        covariance += share * seen.place_m.norm_squared();
    }
    Sighting { position_m: seen.place_m, covariance }
}

fn fit(view: &[(usize, Stated, Sighting)]) -> Result<Rigid, reference::ReferenceError> {
    let (stated, seen): (Vec<Stated>, Vec<Sighting>) =
        view.iter().map(|(_, stated, sighting)| (*stated, *sighting)).unzip();
    Ok(align_stated(&stated, &seen)?.world_from_camera)
}

/// Distance from the stated place, metres, and its square over the covariance.
fn off(one: &(usize, Stated, Sighting), place: &Rigid) -> (f64, f64) {
    let (error, covariance) = error(one, place);
    (error.norm(), mahalanobis_squared(&error, &covariance).unwrap_or(f64::INFINITY))
}

/// From the stated place to where a camera there sees it, and how well both are known.
fn error(
    (_, stated, sighting): &(usize, Stated, Sighting),
    place: &Rigid,
) -> (Vector3<f64>, Matrix3<f64>) {
    let turn = place.rotation.to_rotation_matrix().into_inner();
    let seen_m = place.transform_point(&sighting.position_m.into()).coords;
    let covariance = turn * sighting.covariance * turn.transpose()
        + Matrix3::from_diagonal_element(stated.1 * stated.1);
    (seen_m - stated.0, covariance)
}

/// The one that is off by most, if that is too much.
fn worst(view: &[(usize, Stated, Sighting)], place: &Rigid) -> Option<usize> {
    view.iter()
        .map(|one| (one.0, off(one, place)))
        .filter(|(_, (off_m, square))| *square > WRONG_SQUARED && *off_m > LEAST_WRONG_M)
        .max_by(|one, other| one.1.1.total_cmp(&other.1.1))
        .map(|(index, _)| index)
}
