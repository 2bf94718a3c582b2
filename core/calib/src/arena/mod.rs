//! Where all cameras of an arena stand, from robots that drive about.
//!
//! In: what cameras saw for a minute or so ([`Recording`]), lenses, and at least three reference roundels
//! with known places that one camera sees. Out: every camera's place in the world with its covariance, its
//! clock's offset and drift, if asked its lens, and what a person should know about the result
//! ([`ArenaCalibration`]). Cameras need not see the references, nor all of one another: chains of cameras
//! that overlap with their neighbours will do.
//!
//! Sightings are sorted by roundel (`recording`), references found among them (`references`), roundels without codes
//! told apart by how they move (`association`), cameras tied to one another two by two (`initial_poses`), and all of it adjusted at once (`adjustment`). `report` judges what came out.

mod adjustment;
mod association;
mod error;
mod finding;
mod image_coverage;
mod initial_poses;
mod recording;
mod references;
mod report;

use std::collections::BTreeMap;

use nalgebra::Matrix3;

use adjustment::{
    bundle::{Bundle, Failed, Prior},
    camera_block::Station,
    spline::Course,
    track_block::{Sight, Subject},
};
pub use error::ArenaError;
pub use finding::{Advice, Finding, Names, Numbers};
pub use image_coverage::Coverage;
pub use recording::Recording;
use recording::{Name, Sample};
use references::Standing;
use report::Found;
pub use report::{ArenaCalibration, CalibratedCamera, Neighbour, RefinedLens};
use roundel_fusion::world::Landmark;
use roundel_vision::{
    camera::Camera,
    id::CameraId,
    rigid::{Covariance6, Rigid},
};

/// A roundel seen by two cameras and less often than this together is left out.
const LEAST_SIGHTS: usize = 12;
/// Clock of the camera that all others' are counted from.
const BASE_CLOCK: [f64; 2] = [1e-9, 1e-12];
/// Offset s and skew of all others.
const CLOCK: [f64; 2] = [1.0, 2e-4];

/// One camera.
#[derive(Clone, Debug)]
pub struct ArenaCamera {
    /// As in the recording.
    pub id: CameraId,
    /// What its poses were computed with.
    pub lens: Camera,
    /// How well that lens is known; `None` takes it as exact. What is given is estimated as well.
    pub lens_deviation: Option<LensDeviation>,
}

/// Standard deviations of a lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LensDeviation {
    /// Of the focal length, relative.
    pub focal: f64,
    /// Of the principal point, each coordinate, pixels.
    pub center_px: f64,
    /// Of the first radial coefficient.
    pub radial: f64,
}

impl Default for LensDeviation {
    /// A lens that was calibrated with care.
    fn default() -> Self {
        Self { focal: 1e-3, center_px: 1.0, radial: 2e-3 }
    }
}

/// How much detections are believed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArenaParams {
    /// Control points of a roundel's course are this far apart, seconds.
    pub knot_s: f64,
    /// Share of a detection's variance that is the same in every frame of what stands still.
    pub systematic_share: f64,
}

impl Default for ArenaParams {
    fn default() -> Self {
        Self { knot_s: 0.1, systematic_share: 0.5 }
    }
}

/// How far it has come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Steps made.
    pub step: usize,
    /// Length of the last one in deviations of what it changed; below 0.001 is the end.
    pub length: f64,
}

/// Finds all cameras' places. `go_on` hears of every step and may end it by `false`.
pub fn calibrate(
    recording: &Recording,
    cameras: &[ArenaCamera],
    references: &[Landmark],
    params: &ArenaParams,
    mut go_on: impl FnMut(Progress) -> bool,
) -> Result<ArenaCalibration, ArenaError> {
    let ids: BTreeMap<CameraId, usize> =
        cameras.iter().enumerate().map(|(index, camera)| (camera.id, index)).collect();
    if ids.len() != cameras.len() || cameras.is_empty() {
        let found = cameras.iter().map(|camera| camera.id).collect();
        return Err(ArenaError::Cameras { found });
    }
    let (mut sorted, twice) = recording.sorted();
    let standing = references::take(&mut sorted, cameras, references, params)?;
    association::join(&mut sorted);
    let roundels = moving(sorted, &ids);
    let sights: Vec<initial_poses::Sights<'_>> =
        (0..cameras.len()).map(|camera| seen_by(&roundels, camera)).collect();
    let ties = initial_poses::ties(&sights);
    let started = initial_poses::spread_out(&standing.placed, &ties);
    let kept: Vec<usize> = (0..cameras.len()).filter(|&index| started[index].is_some()).collect();
    let stations = kept.iter().filter_map(|&index| {
        let (place, offset_s) = started[index]?;
        let lens = cameras[index].lens_deviation.map(|_| &cameras[index].lens);
        Some(Station::new(place, offset_s, lens))
    });
    let stations: Vec<Station> = stations.collect();
    let subjects = subjects(&standing, &roundels, &kept, params);
    let base = standing.placed.iter().position(Option::is_some);
    let priors = kept
        .iter()
        .map(|&index| prior(Some(index) == base, cameras[index].lens_deviation))
        .collect();
    let mut bundle = Bundle { stations, subjects, priors };
    let outcome =
        bundle.adjust(|step, length| go_on(Progress { step, length })).map_err(|failed| {
            match failed {
                Failed::Undetermined => ArenaError::Undetermined,
                Failed::Cancelled => ArenaError::Cancelled,
            }
        })?;
    let found = Found { recording, cameras, standing, ties, twice, kept };
    Ok(report::report(&found, &bundle, &outcome))
}

/// A robot's roundel with what each camera saw of it.
struct Roundel {
    name: Name,
    seen: Vec<(usize, Vec<Sample>)>,
}

/// Roundels that two cameras saw or more.
fn moving(sorted: recording::Sorted, ids: &BTreeMap<CameraId, usize>) -> Vec<Roundel> {
    let roundel = |(name, seen): (Name, BTreeMap<CameraId, recording::Seen>)| {
        let seen = seen
            .into_iter()
            .filter(|(_, seen)| seen.samples.len() >= LEAST_SIGHTS)
            .filter_map(|(camera, seen)| Some((*ids.get(&camera)?, seen.samples)));
        Roundel { name, seen: seen.collect() }
    };
    sorted.into_iter().map(roundel).filter(|roundel| roundel.seen.len() > 1).collect()
}

fn seen_by(roundels: &[Roundel], camera: usize) -> initial_poses::Sights<'_> {
    let mut sights = initial_poses::Sights::new();
    for (subject, roundel) in roundels.iter().enumerate() {
        if let Some((_, samples)) = roundel.seen.iter().find(|(other, _)| *other == camera) {
            sights.insert(subject, samples);
        }
    }
    sights
}

fn prior(is_base: bool, lens: Option<LensDeviation>) -> Prior {
    let [offset_s, skew] = if is_base { BASE_CLOCK } else { CLOCK };
    let LensDeviation { focal, center_px, radial } = lens.unwrap_or_default();
    Prior { deviations: [offset_s, skew, focal, center_px, center_px, radial] }
}

/// References first, then robots; cameras counted among those kept.
fn subjects(
    standing: &Standing,
    roundels: &[Roundel],
    kept: &[usize],
    params: &ArenaParams,
) -> Vec<Subject> {
    let sight = |camera: usize, sample: &Sample| {
        let camera = kept.iter().position(|&index| index == camera)?;
        let whitener = whitener(&sample.covariance)?;
        Some(Sight { camera, stamp_s: sample.stamp_s, place_m: sample.place_m, whitener })
    };
    let references = standing.references.iter().filter_map(|reference| {
        let sights = reference.seen.iter().filter_map(|(camera, sample)| sight(*camera, sample));
        let sights: Vec<Sight> = sights.collect();
        let stated = (reference.position_m, reference.deviation_m);
        let course = Course::standing(stated.0);
        (!sights.is_empty()).then(|| Subject::new(course, Some(stated), sights))
    });
    let robots = roundels.iter().filter_map(|roundel| {
        let sights: Vec<Sight> = roundel
            .seen
            .iter()
            .flat_map(|(camera, samples)| {
                samples.iter().filter_map(|sample| sight(*camera, sample))
            })
            .collect();
        let name = Some(roundel.name);
        let stamps = sights.iter().map(|sight| sight.stamp_s);
        let span = (stamps.clone().reduce(f64::min)?, stamps.reduce(f64::max)?);
        Some(Subject { name, ..Subject::new(Course::over(span, params.knot_s), None, sights) })
    });
    references.chain(robots).collect()
}

/// W of Σ⁻¹ = Wᵀ W.
fn whitener(covariance: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    covariance.cholesky()?.l().try_inverse()
}

/// A covariance over (position, rotation) out of a camera's unknowns.
fn place_covariance(covariance: &nalgebra::DMatrix<f64>, first: usize) -> Covariance6 {
    covariance.fixed_view::<6, 6>(first, first).into_owned()
}

/// A camera's place and which it is.
type Placed = Vec<Option<Rigid>>;
