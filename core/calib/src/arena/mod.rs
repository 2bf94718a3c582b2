//! Poses and clocks of all cameras of an arena, from moving roundels.
//!
//! Input: about a minute of detections of all cameras ([`Recording`]), their lenses, and at least three reference roundels
//! with known positions in the view of one camera. Output ([`ArenaCalibration`]): the pose of each camera in the world
//! with its covariance, the offset and drift of its clock, optionally its refined lens, and findings for the operator.
//! Not every camera must see the references, and cameras need not all overlap: chains of overlapping cameras suffice.
//!
//! | step | module |
//! | --- | --- |
//! | sort the samples by roundel | `recording` |
//! | find the reference roundels | `references` |
//! | associate roundels without codes | `association` |
//! | estimate relative poses | `initial_poses` |
//! | bundle adjustment | `adjustment` |
//! | results and findings | `report` |

mod adjustment;
mod association;
mod error;
mod finding;
mod initial_poses;
mod recording;
mod references;
mod report;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

pub use crate::image_cells::ImageCoverage;
use adjustment::{
    bundle::Bundle,
    camera_block::CameraBlock,
    spline::Spline,
    track_block::{Observation, TrackBlock},
};
pub use error::ArenaError;
pub use finding::{Advice, Finding, Names, Numbers};
pub use recording::Recording;
use recording::{RoundelKey, Sample, SamplesByRoundel};
use references::ReferenceSet;
use report::Survey;
pub use report::{ArenaCalibration, CalibratedCamera, Neighbour, RefinedLens};
use roundel_fusion::world::Landmark;
use roundel_vision::{camera::Camera, id::CameraId, rigid::Rigid};

/// Minimum number of samples of a roundel in a camera.
const MIN_SIGHTS: usize = 12;
/// Prior deviations (offset s, skew) of the reference clock.
const BASE_CLOCK: [f64; 2] = [1e-9, 1e-12];
/// Prior deviations (offset s, skew) of the other clocks.
const CLOCK: [f64; 2] = [1.0, 2e-4];

/// A camera to be calibrated.
#[derive(Clone, Debug)]
pub struct ArenaCamera {
    /// Identifier in the recording.
    pub id: CameraId,
    /// The lens that its detections were computed with.
    pub lens: Camera,
    /// Uncertainty of the lens, which is then refined; `None` if the lens is exact.
    pub lens_deviation: Option<LensDeviation>,
}

/// Standard deviations of a lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LensDeviation {
    /// Focal length, relative.
    pub focal: f64,
    /// Each coordinate of the principal point, pixels.
    pub center_px: f64,
    /// First radial coefficient.
    pub radial: f64,
}

impl Default for LensDeviation {
    /// Typical values after a careful lens calibration.
    fn default() -> Self {
        Self { focal: 1e-3, center_px: 1.0, radial: 2e-3 }
    }
}

/// Parameters of the adjustment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArenaParams {
    /// Distance of the control points of a roundel's spline, seconds.
    pub knot_s: f64,
    /// Share of a detection's variance that is the same in every frame of a stationary roundel.
    pub systematic_share: f64,
}

impl Default for ArenaParams {
    fn default() -> Self {
        Self { knot_s: 0.1, systematic_share: 0.5 }
    }
}

/// Progress of the adjustment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Number of steps.
    pub step: usize,
    /// Length of the last step in standard deviations; it converges below 0.001.
    pub length: f64,
}

/// Calibrates all cameras. Calls `go_on` before each step; `false` cancels.
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
    let (mut by_roundel, duplicates) = recording.by_roundel();
    let reference_set = references::take(&mut by_roundel, cameras, references, params)?;
    association::associate(&mut by_roundel);
    let roundels = moving(by_roundel, &ids);
    let relative_poses = initial_poses::relative_poses(&roundels, cameras.len());
    let initial = initial_poses::propagate(&reference_set.camera_poses, &relative_poses);
    let kept: Vec<usize> = (0..cameras.len()).filter(|&index| initial[index].is_some()).collect();
    let base = reference_set.camera_poses.iter().position(Option::is_some);
    let blocks = kept.iter().filter_map(|&index| {
        let (pose, offset_s) = initial[index]?;
        let ArenaCamera { lens, lens_deviation, .. } = &cameras[index];
        let [offset_deviation_s, skew] = if Some(index) == base { BASE_CLOCK } else { CLOCK };
        let LensDeviation { focal, center_px, radial } = lens_deviation.unwrap_or_default();
        let priors = [offset_deviation_s, skew, focal, center_px, center_px, radial];
        Some(CameraBlock::new(pose, offset_s, priors, lens_deviation.map(|_| lens)))
    });
    let tracks = tracks(&reference_set, &roundels, &kept, params);
    let mut bundle = Bundle::new(blocks.collect(), tracks);
    let outcome = bundle.adjust(|step, length| go_on(Progress { step, length }))?;
    let survey = Survey { recording, cameras, reference_set, relative_poses, duplicates, kept };
    Ok(report::report(&survey, &bundle, &outcome))
}

/// A moving roundel with the samples of each camera.
struct Roundel {
    name: RoundelKey,
    seen: Vec<(usize, Vec<Sample>)>,
}

impl Roundel {
    fn samples(&self, camera: usize) -> Option<&[Sample]> {
        let (_, samples) = self.seen.iter().find(|(other, _)| *other == camera)?;
        Some(samples)
    }
}

/// Roundels that at least two cameras saw.
fn moving(by_roundel: SamplesByRoundel, ids: &BTreeMap<CameraId, usize>) -> Vec<Roundel> {
    let mut roundels = Vec::new();
    for (name, cameras) in by_roundel {
        let cameras = cameras.into_iter().filter(|(_, seen)| seen.samples.len() >= MIN_SIGHTS);
        let seen: Vec<_> =
            cameras.filter_map(|(id, seen)| Some((*ids.get(&id)?, seen.samples))).collect();
        if seen.len() > 1 {
            roundels.push(Roundel { name, seen });
        }
    }
    roundels
}

/// References first, then robots; cameras are numbered among `kept`.
fn tracks(
    reference_set: &ReferenceSet,
    roundels: &[Roundel],
    kept: &[usize],
    params: &ArenaParams,
) -> Vec<TrackBlock> {
    let observation = |camera: usize, sample: &Sample| {
        let camera = kept.iter().position(|&index| index == camera)?;
        let Sample { stamp_s, position_m, covariance } = sample;
        // W of Σ⁻¹ = Wᵀ W.
        let whitener = covariance.cholesky()?.l().try_inverse()?;
        Some(Observation { camera, stamp_s: *stamp_s, position_m: *position_m, whitener })
    };
    let references = reference_set.references.iter().filter_map(|reference| {
        let seen = reference.seen.iter();
        let observations: Vec<Observation> =
            seen.filter_map(|(camera, sample)| observation(*camera, sample)).collect();
        let spline = Spline::constant(reference.stated.0);
        (!observations.is_empty())
            .then(|| TrackBlock::new(None, spline, Some(reference.stated), observations))
    });
    let robots = roundels.iter().filter_map(|roundel| {
        let seen = roundel.seen.iter();
        let samples = seen.flat_map(|(camera, samples)| samples.iter().map(|it| (*camera, it)));
        let observations: Vec<Observation> =
            samples.filter_map(|(camera, sample)| observation(camera, sample)).collect();
        let stamps = observations.iter().map(|observation| observation.stamp_s);
        let (first_s, last_s) = (stamps.clone().reduce(f64::min)?, stamps.reduce(f64::max)?);
        let spline = Spline::over(first_s, last_s, params.knot_s);
        Some(TrackBlock::new(Some(roundel.name), spline, None, observations))
    });
    references.chain(robots).collect()
}

/// Poses of all cameras; `None` if unknown.
type CameraPoses = Vec<Option<Rigid>>;
