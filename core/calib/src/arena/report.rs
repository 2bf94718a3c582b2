//! Result of the arena calibration with findings.
//!
//! Reprojection errors are distances of roundel centres in raw pixels. Coverage is the share of the 8 × 6 cells of an
//! image in which roundels were observed.

use super::{
    ArenaCamera,
    adjustment::{
        bundle::{Bundle, Outcome, excess_squared, is_outlier},
        camera_block::POSE_AND_CLOCK,
        track_block::{TrackBlock, unknowns_per_camera},
    },
    finding::{Advice, Finding},
    initial_poses::{Alignment, MIN_SPREAD_M, RelativePose},
    recording::{Recording, RoundelKey},
    references::ReferenceSet,
};
use crate::{image_cells::ImageCoverage, robust::median};
use roundel_vision::{
    camera::Camera,
    id::CameraId,
    rigid::{Covariance6, Rigid},
};

/// Maximum rms deviation of position and rotation without a warning, metres and radians.
const WEAK_M: f64 = 0.003;
const WEAK_RAD: f64 = 0.0005;
/// A camera that disagrees about a roundel in more than this share of its sightings sees another roundel.
const MISPLACED_SHARE: f64 = 0.5;
/// A camera whose errors exceed the stated ones by this factor probably has a wrong lens file.
const DOUBTFUL_RATIO: f64 = 3.0;

/// Result of an arena calibration.
#[derive(Clone, Debug)]
pub struct ArenaCalibration {
    /// In the given order, without cameras that cannot be located.
    pub cameras: Vec<CalibratedCamera>,
    /// Findings, most important first.
    pub findings: Vec<Finding>,
    /// Number of sightings used.
    pub sightings: usize,
    /// Number of moving roundels that at least two cameras saw.
    pub roundels: usize,
    /// Duration of the recording, seconds.
    pub length_s: f64,
    /// Number of steps of the adjustment.
    pub steps: usize,
}

/// Result for one camera.
#[derive(Clone, Debug)]
pub struct CalibratedCamera {
    /// The camera.
    pub camera: CameraId,
    /// Its pose.
    pub world_from_camera: Rigid,
    /// Over (position, rotation), world frame, left perturbation.
    pub covariance: Covariance6,
    /// Its clock minus that of the first camera that sees references, at the middle of the recording, seconds.
    pub clock_offset_s: f64,
    /// Standard deviation of the offset.
    pub clock_offset_deviation_s: f64,
    /// Change of the offset, seconds per second.
    pub clock_skew: f64,
    /// Standard deviation of the skew.
    pub clock_skew_deviation: f64,
    /// The refined lens, if requested.
    pub lens: Option<RefinedLens>,
    /// Number of sightings used.
    pub sightings: usize,
    /// Rms distance of observed and predicted roundel centres, pixels.
    pub reprojection_rms_px: f64,
    /// Median ratio of errors to stated deviations; 1 if detections are consistent.
    pub error_ratio: f64,
    /// Share of the image's cells with observations.
    pub coverage: f64,
    /// Cameras that saw the same roundels at the same times.
    pub neighbours: Vec<Neighbour>,
}

/// A lens refined by the adjustment.
#[derive(Clone, Debug)]
pub struct RefinedLens {
    /// The refined camera.
    pub camera: Camera,
    /// Standard deviations of focal length (relative), principal point (pixels) and first radial coefficient.
    pub deviations: [f64; 4],
}

/// Overlap with another camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    /// The other camera.
    pub camera: CameraId,
    /// Number of simultaneous samples.
    pub shared: usize,
    /// Their rms spread in two directions, metres.
    pub spread_m: f64,
}

/// State before the adjustment.
pub(super) struct Survey<'a> {
    pub(super) recording: &'a Recording,
    pub(super) cameras: &'a [ArenaCamera],
    pub(super) reference_set: ReferenceSet,
    pub(super) relative_poses: Vec<RelativePose>,
    /// Codes that a camera saw at two positions at once.
    pub(super) duplicates: Vec<Finding>,
    /// Cameras that were adjusted.
    pub(super) kept: Vec<usize>,
}

impl Survey<'_> {
    /// Cameras that share roundels with one, and the alignments of their tracks.
    fn neighbours(&self, index: usize) -> impl Iterator<Item = (CameraId, &Alignment)> {
        self.relative_poses.iter().filter_map(move |relative_pose| {
            let partner = relative_pose.partner(index)?;
            Some((self.cameras[partner].id, &relative_pose.alignment))
        })
    }
}

pub(super) fn report(survey: &Survey<'_>, bundle: &Bundle, outcome: &Outcome) -> ArenaCalibration {
    let mut findings = findings_before(survey);
    let (residuals, elsewhere) = residuals(survey, bundle, outcome);
    let results: Vec<CalibratedCamera> = residuals
        .into_iter()
        .enumerate()
        .map(|(at, residuals)| calibrated(survey, at, residuals, bundle, outcome))
        .collect();
    findings.extend(elsewhere);
    findings.extend(results.iter().filter_map(doubtful));
    findings.extend(results.iter().filter_map(weak));
    ArenaCalibration {
        sightings: results.iter().map(|camera| camera.sightings).sum(),
        cameras: results,
        findings,
        roundels: bundle.tracks.iter().filter(|track| track.stated.is_none()).count(),
        length_s: survey.recording.length_s(),
        steps: outcome.steps,
    }
}

/// Findings that do not depend on the adjustment.
fn findings_before(survey: &Survey<'_>) -> Vec<Finding> {
    let Survey { recording, cameras, reference_set, duplicates, kept, .. } = survey;
    let ReferenceSet { misplaced, moved, unseen, .. } = reference_set;
    let mut findings: Vec<Finding> =
        [misplaced, moved, unseen, duplicates].into_iter().flatten().cloned().collect();
    for index in (0..cameras.len()).filter(|index| !kept.contains(index)) {
        let camera = cameras[index].id;
        let best =
            survey.neighbours(index).max_by(|(_, a), (_, b)| a.spread_m.total_cmp(&b.spread_m));
        findings.push(match best {
            Some((other, alignment)) if !alignment.is_determined() => {
                Finding::TooLittleMotion { camera, other, spread_m: alignment.spread_m }
            }
            None if !recording.has_seen(camera) => {
                Finding::Unseen { camera, frames: recording.frames(camera) }
            }
            _ => Finding::Apart { camera },
        });
    }
    findings
}

#[derive(Clone, Debug, Default)]
struct CameraResiduals {
    /// Squared errors of the used sightings.
    squares: Vec<f64>,
    square_px: f64,
    coverage: ImageCoverage,
}

/// Residuals of each camera, and roundels that a camera saw elsewhere than the others.
fn residuals(
    survey: &Survey<'_>,
    bundle: &Bundle,
    outcome: &Outcome,
) -> (Vec<CameraResiduals>, Vec<Finding>) {
    let mut residuals = vec![CameraResiduals::default(); survey.kept.len()];
    let mut findings = Vec::new();
    for track in &bundle.tracks {
        // Sightings of each camera, and the inconsistent ones among them.
        let mut counts = vec![[0usize; 2]; survey.kept.len()];
        for (observation, square) in track.observations.iter().zip(track.squares(&bundle.blocks)) {
            let is_off = is_outlier(square, outcome.excess);
            let [sightings, off] = &mut counts[observation.camera];
            *sightings += 1;
            *off += usize::from(is_off);
            if is_off {
                continue;
            }
            let residuals = &mut residuals[observation.camera];
            residuals.squares.push(square);
            let lens = &survey.cameras[survey.kept[observation.camera]].lens;
            let predicted = track.predict(observation, &bundle.blocks);
            let predicted = predicted.and_then(|at_m| lens.project(&at_m).ok());
            let observed = lens.project(&observation.position_m).ok();
            if let (Some(observed), Some(predicted)) = (observed, predicted) {
                residuals.square_px +=
                    (observed.u - predicted.u).powi(2) + (observed.v - predicted.v).powi(2);
                residuals.coverage.add(lens, observed);
            }
        }
        let Some(RoundelKey::Coded(kind, code)) = track.name else { continue };
        for (index, [sightings, off]) in counts.into_iter().enumerate() {
            let share = off as f64 / sightings.max(1) as f64;
            if share > MISPLACED_SHARE {
                let off_m = distance_m(track, index, bundle);
                let camera = survey.cameras[survey.kept[index]].id;
                findings.push(Finding::Elsewhere { camera, kind, code, sightings, share, off_m });
            }
        }
    }
    (residuals, findings)
}

/// Median offset across the line of sight between a camera's sightings and the adjusted track, metres.
fn distance_m(track: &TrackBlock, camera: usize, bundle: &Bundle) -> f64 {
    let own = track.observations.iter().filter(|observation| observation.camera == camera);
    let distances_m = own.filter_map(|observation| {
        let predicted_m = track.predict(observation, &bundle.blocks)?;
        let sine = observation.position_m.normalize().cross(&predicted_m.normalize()).norm();
        Some(sine * observation.position_m.norm())
    });
    median(&mut distances_m.collect::<Vec<f64>>()).unwrap_or(f64::INFINITY)
}

fn calibrated(
    survey: &Survey<'_>,
    at: usize,
    mut residuals: CameraResiduals,
    bundle: &Bundle,
    outcome: &Outcome,
) -> CalibratedCamera {
    let index = survey.kept[at];
    let block = &bundle.blocks[at];
    let first = at * unknowns_per_camera(&bundle.blocks);
    let deviation = |number: usize| {
        let at = first + number;
        outcome.covariance[(at, at)].max(0.0).sqrt()
    };
    let lens = block.lens.as_ref().map(|lens| RefinedLens {
        camera: lens.now.clone(),
        deviations: std::array::from_fn(|number| deviation(POSE_AND_CLOCK + number)),
    });
    CalibratedCamera {
        camera: survey.cameras[index].id,
        world_from_camera: block.world_from_camera,
        covariance: outcome.covariance.fixed_view::<6, 6>(first, first).into_owned(),
        clock_offset_s: block.offset_s,
        clock_offset_deviation_s: deviation(6),
        clock_skew: block.skew,
        clock_skew_deviation: deviation(7),
        lens,
        sightings: residuals.squares.len(),
        reprojection_rms_px: (residuals.square_px / residuals.squares.len().max(1) as f64).sqrt(),
        error_ratio: excess_squared(&mut residuals.squares).sqrt(),
        coverage: residuals.coverage.share(),
        neighbours: survey
            .neighbours(index)
            .map(|(camera, it)| Neighbour { camera, shared: it.pairs, spread_m: it.spread_m })
            .collect(),
    }
}

fn doubtful(camera: &CalibratedCamera) -> Option<Finding> {
    let (ratio, rms_px) = (camera.error_ratio, camera.reprojection_rms_px);
    (ratio > DOUBTFUL_RATIO).then_some(Finding::Doubtful { camera: camera.camera, ratio, rms_px })
}

fn weak(camera: &CalibratedCamera) -> Option<Finding> {
    let rms = |first: usize| {
        (camera.covariance.fixed_view::<3, 3>(first, first).trace() / 3.0).max(0.0).sqrt()
    };
    let (deviation_m, deviation_rad) = (rms(0), rms(3));
    if deviation_m < WEAK_M && deviation_rad < WEAK_RAD {
        return None;
    }
    let usable = camera.neighbours.iter().filter(|it| it.spread_m >= MIN_SPREAD_M);
    let advice = match usable.min_by_key(|it| it.shared) {
        _ if camera.coverage < 0.3 => Advice::Cover(camera.coverage),
        Some(neighbour) => Advice::Overlap(neighbour.camera),
        None => Advice::References,
    };
    Some(Finding::Weak { camera: camera.camera, deviation_m, deviation_rad, advice })
}
