//! Camera intrinsics from coded roundels on moving robots that other, calibrated cameras observe.
//!
//! Input: trajectories of the roundels, fused without the camera in question ([`Trajectory`]), and the rim centres in the
//! raw pixels of that camera ([`RimObservation`]). Output: intrinsics as from views of a board, with the camera's pose and
//! clock and their covariances ([`MovingLens`]).
//!
//! Method: radial alignment gives an initial camera (`radial_alignment`, Tsai 1987); then intrinsics, pose and clock are
//! refined together (`bundle`). Residuals are weighted by the uncertainty of the positions and by the estimated noise of
//! rims and stamps (`noise_model`). The covariance comes from a block jackknife (`jackknife`). The prediction is the
//! centroid of the rim's image, with the orientation of the fused track. The model is selected by Schwarz's criterion as
//! for boards; n correlated values count as n / ĉ (Burnham, Anderson 2002, section 2.5), where ĉ is the factor by which
//! the parameters' variances exceed those for independent errors.
//!
//! Accuracy: `tests::a_lens_is_found_from_moving_roundels` and, from a recording, `tests/tests/moving_lens.rs`.
//! Limits: the camera must not move. Stated deviations are relative to the calibrated arena; common errors of the other
//! cameras are not included.

mod bundle;
mod error;
mod jackknife;
mod noise_model;
mod radial_alignment;
mod trajectory;

use nalgebra::{DMatrix, Matrix2, Vector2};

use self::{
    bundle::{Bundle, Fit, Observation},
    noise_model::NoiseModel,
};
pub use self::{
    error::{Missing, MovingLensError},
    trajectory::{Trajectory, Waypoint},
};
use super::{
    DistortionModel, LensCalibration, ZONES,
    fit::{
        model_selection::{Evidence, ScoredFit, select_fit},
        parameters::CameraParameters,
    },
    is_picture_size,
};
use crate::image_cells::cell_of;
use roundel_fusion::world::ClockPrior;
use roundel_vision::{
    camera::PixelPoint,
    rigid::{Covariance6, Rigid},
};

/// Minimum number of observations.
pub const MIN_SIGHTINGS: usize = 100;
/// Minimum number of distinct image positions.
pub const MIN_PLACES: usize = 20;
/// Minimum distance of distinct image positions, as a share of the picture's diagonal.
const PLACE_SHARE: f64 = 0.02;
/// Maximum number of observations used; more only cost time.
const MAX_SIGHTINGS: usize = 6000;
/// Number of observations used for the initial camera.
const START_SIGHTINGS: usize = 250;
/// Maximum relative deviation of the focal length.
const MAX_DEVIATION: f64 = 0.01;
/// Minimum share of observations that must agree with the result.
const MIN_AGREEING: f64 = 0.5;
/// Maximum noise of rim centres, pixels; more indicates a wrong result.
const MAX_PIXEL_PX: f64 = 3.0;
/// Minimum number of observations in a visited zone.
const MIN_ZONE_SIGHTINGS: usize = 20;
/// Quantiles reported as nearest and farthest depth.
const DEPTH_SHARES: [f64; 2] = [0.02, 0.98];
/// Sufficient ratio of farthest to nearest depth.
const DEPTH_RATIO: f64 = 1.15;
/// Minimum prior deviations of the clock: seconds, and seconds per second.
const EXACT: [f64; 2] = [1e-9, 1e-12];

/// The image of a roundel's rim.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RimObservation {
    /// Index of the roundel's trajectory.
    pub trajectory: usize,
    /// Stamp by the camera's clock, seconds since the trajectories' epoch.
    pub stamp_s: f64,
    /// Centre of the ellipse of the outer rim, raw pixels.
    pub center: PixelPoint,
    /// Geometric mean of the ellipse's semiaxes, pixels.
    pub radius_px: f64,
}

/// Input of [`calibrate`].
#[derive(Clone, Debug)]
pub struct MovingInput<'a> {
    /// Columns and rows of the picture.
    pub size: (usize, usize),
    /// Trajectories of the roundels.
    pub trajectories: &'a [Trajectory],
    /// Observations of the camera.
    pub observations: &'a [RimObservation],
    /// Prior knowledge of the camera's clock.
    pub clock: ClockPrior,
}

/// Result of a calibration from moving roundels.
#[derive(Clone, Debug)]
pub struct MovingLens {
    /// The intrinsics, without views.
    pub lens: LensCalibration,
    /// Pose of the camera.
    pub world_from_camera: Rigid,
    /// Over (position, rotation), world frame, left perturbation.
    pub pose_covariance: Covariance6,
    /// Delay of the camera's stamps and its standard deviation, seconds.
    pub offset_s: (f64, f64),
    /// Estimated noise: of a rim's centre, pixels, and of stamps from frame to frame, seconds.
    pub estimated_noise: (f64, f64),
    /// Number of observations used.
    pub sightings: usize,
    /// Observations by zone of the picture, row by row from the top left: 3 by 3.
    pub zones: Vec<usize>,
    /// Depth of the nearest and farthest roundels, metres.
    pub depths_m: [f64; 2],
    /// Observations that would improve the result.
    pub missing: Vec<Missing>,
}

impl MovingLens {
    /// Share of the picture's zones with enough observations, 0 to 1.
    pub fn coverage(&self) -> f64 {
        let visited = self.zones.iter().filter(|&&count| count >= MIN_ZONE_SIGHTINGS).count();
        visited as f64 / self.zones.len() as f64
    }
}

/// Calibrates a camera with the given `model` or the one selected by evidence.
pub fn calibrate(
    input: &MovingInput<'_>,
    model: Option<DistortionModel>,
) -> Result<MovingLens, MovingLensError> {
    if !is_picture_size(input.size) {
        let (width, height) = input.size;
        return Err(MovingLensError::Size { width, height });
    }
    let observations = observations(input);
    let (found, places) = (observations.len(), places(&observations, input.size));
    let zones = zones(&observations, input.size);
    if found < MIN_SIGHTINGS || places < MIN_PLACES {
        return Err(MovingLensError::TooFew { found, places, missing: unvisited(&zones) });
    }
    let unexplained = |agreeing| MovingLensError::Unexplained { found, agreeing };
    let initial = initial_bundle(input, &observations).ok_or(unexplained(0))?;
    let models = model.map_or_else(|| DistortionModel::ALL.to_vec(), |model| vec![model]);
    let (fit, evidence) = best(&initial, &observations, &models).ok_or(unexplained(0))?;
    let agreeing = fit.bundle.observations.len();
    if (agreeing as f64) < MIN_AGREEING * found as f64 || fit.bundle.noise.pixel_px > MAX_PIXEL_PX {
        return Err(unexplained(agreeing));
    }
    finish(fit, evidence, found)
}

/// Valid observations within a trajectory, thinned evenly.
fn observations(input: &MovingInput<'_>) -> Vec<Observation> {
    let is_sound = |rim: &&RimObservation| {
        let numbers = [rim.stamp_s, rim.center.u, rim.center.v, rim.radius_px];
        let trajectory = input.trajectories.get(rim.trajectory);
        numbers.into_iter().all(f64::is_finite)
            && rim.radius_px > 0.0
            && trajectory.is_some_and(|trajectory| trajectory.at(rim.stamp_s).is_some())
    };
    let sound: Vec<&RimObservation> = input.observations.iter().filter(is_sound).collect();
    let observation = |rim: &&RimObservation| Observation {
        trajectory: rim.trajectory,
        stamp_s: rim.stamp_s,
        observed: Vector2::new(rim.center.u, rim.center.v),
        radius_px: rim.radius_px,
        offset: Vector2::zeros(),
        whitener: Matrix2::identity(),
    };
    thinned(&sound, MAX_SIGHTINGS).map(observation).collect()
}

/// At most `max` items, evenly spaced.
fn thinned<T>(all: &[T], max: usize) -> impl Iterator<Item = &T> {
    let count = all.len().min(max);
    (0..count).map(move |index| &all[index * all.len() / count.max(1)])
}

/// Number of distinct image positions.
fn places(observations: &[Observation], (width, height): (usize, usize)) -> usize {
    let apart_px = PLACE_SHARE * (width as f64).hypot(height as f64);
    let mut places: Vec<Vector2<f64>> = Vec::new();
    for observation in observations {
        if places.iter().all(|place| (place - observation.observed).norm() >= apart_px) {
            places.push(observation.observed);
        }
    }
    places.len()
}

fn zones(observations: &[Observation], size: (usize, usize)) -> Vec<usize> {
    let mut zones = vec![0; ZONES.0 * ZONES.1];
    for Observation { observed, .. } in observations {
        zones[cell_of(PixelPoint { u: observed.x, v: observed.y }, size, ZONES)] += 1;
    }
    zones
}

fn unvisited(zones: &[usize]) -> Vec<Missing> {
    let zones = zones.iter().enumerate().filter(|(_, count)| **count < MIN_ZONE_SIGHTINGS);
    zones.map(|(index, _)| Missing::Zone(index % ZONES.0, index / ZONES.0)).collect()
}

/// The initial camera: the candidate for which a simple model fits a part of the observations best.
fn initial_bundle<'a>(input: &MovingInput<'a>, observations: &[Observation]) -> Option<Bundle<'a>> {
    let few: Vec<Observation> = thinned(observations, START_SIGHTINGS).cloned().collect();
    let middle = Vector2::new(input.size.0 as f64 - 1.0, input.size.1 as f64 - 1.0) / 2.0;
    let side_px = input.size.0.max(input.size.1) as f64;
    let correspondence = |observation: &Observation| {
        let at = input.trajectories[observation.trajectory].at(observation.stamp_s)?;
        Some((at.position_m, observation.observed - middle))
    };
    let placed: Vec<radial_alignment::Correspondence> =
        few.iter().filter_map(correspondence).collect();
    let clock_prior = [input.clock.offset_s.max(EXACT[0]), input.clock.skew.max(EXACT[1])];
    let mut best: Option<(f64, Bundle<'a>)> = None;
    for start in radial_alignment::initial_cameras(&placed, side_px) {
        for model in [DistortionModel::Radial1, DistortionModel::Equidistant2] {
            let mut bundle = Bundle {
                parameters: CameraParameters::new(input.size, start.focal_px, model),
                trajectories: input.trajectories,
                observations: few.clone(),
                camera_from_world: start.camera_from_world,
                clock: [0.0; 2],
                clock_prior,
                noise: NoiseModel::INITIAL,
                is_noise_fixed: false,
            };
            let Some(scale) = bundle.fit_roughly() else { continue };
            if best.as_ref().is_none_or(|(min, _)| scale < *min) {
                best = Some((scale, bundle));
            }
        }
    }
    best.map(|(_, bundle)| bundle)
}

/// The fit of the selected model, and the evidence for all.
fn best<'a>(
    initial: &Bundle<'a>,
    observations: &[Observation],
    models: &[DistortionModel],
) -> Option<(Fit<'a>, Vec<Evidence>)> {
    let of = |model: DistortionModel, noise: Option<NoiseModel>| {
        let bundle = Bundle {
            parameters: initial.parameters.with_model(model),
            observations: observations.to_vec(),
            noise: noise.unwrap_or(NoiseModel::INITIAL),
            is_noise_fixed: noise.is_some(),
            ..initial.clone()
        };
        bundle.fit()
    };
    let fits: Vec<Fit<'_>> = models.iter().filter_map(|&model| of(model, None)).collect();
    // The best-fitting model determines the noise by which all models are compared.
    let by_noise = |one: &&Fit<'_>, other: &&Fit<'_>| {
        one.bundle.noise.pixel_px.total_cmp(&other.bundle.noise.pixel_px)
    };
    let min = fits.iter().min_by(by_noise)?;
    let (noise, inflation) = (min.bundle.noise, min.inflation);
    let scored = |fit: Fit<'a>| {
        let parameters = &fit.bundle.parameters;
        let (model, parameters) = (parameters.model, parameters.unknowns() as f64);
        let fit = of(model, Some(noise))?;
        let count = 2.0 * fit.bundle.observations.len() as f64;
        let criterion = (fit.squares / count).max(1e-300).ln() * count / inflation
            + parameters * (count / inflation).max(1.0).ln();
        Some(ScoredFit { model, rms_px: fit.rms_px, criterion, count, fit })
    };
    let (_, fit, evidence) = select_fit(fits.into_iter().filter_map(scored).collect())?;
    Some((fit, evidence))
}

fn finish(
    fit: Fit<'_>,
    evidence: Vec<Evidence>,
    given: usize,
) -> Result<MovingLens, MovingLensError> {
    let bundle = &fit.bundle;
    let lens = bundle.parameters.unknowns();
    let mut depths_m = fit.depths_m();
    depths_m.sort_by(f64::total_cmp);
    let depths_m = DEPTH_SHARES.map(|share| {
        let at = (share * depths_m.len() as f64) as usize;
        depths_m.get(at.min(depths_m.len().saturating_sub(1))).copied().unwrap_or_default()
    });
    let zones = zones(&bundle.observations, bundle.parameters.size);
    let mut missing = Vec::new();
    let [nearest_m, farthest_m] = depths_m;
    let focal_px = fit.camera.intrinsics().fx_px;
    let deviation = fit.covariance[(0, 0)].max(fit.covariance[(1, 1)]).sqrt() / focal_px;
    let is_determined = deviation <= MAX_DEVIATION;
    if farthest_m < DEPTH_RATIO * nearest_m || !is_determined {
        missing.push(Missing::Depth { ratio: farthest_m / nearest_m });
    }
    missing.extend(unvisited(&zones));
    if !is_determined {
        return Err(MovingLensError::Undetermined { deviation, missing });
    }
    let world_from_camera = bundle.camera_from_world.inverse();
    let clock_deviation_s = fit.covariance[(lens + 6, lens + 6)].max(0.0).sqrt();
    Ok(MovingLens {
        lens: LensCalibration {
            camera: fit.camera.clone(),
            model: bundle.parameters.model,
            covariance: fit.covariance.view((0, 0), (lens, lens)).into_owned(),
            rms_px: fit.rms_px,
            views: Vec::new(),
            outliers: given - bundle.observations.len(),
            evidence,
            diameter_check: None,
        },
        pose_covariance: world_covariance(&fit.covariance, lens, &bundle.camera_from_world),
        world_from_camera,
        offset_s: (bundle.clock[0], clock_deviation_s),
        estimated_noise: (bundle.noise.pixel_px, bundle.noise.stamp_s),
        sightings: bundle.observations.len(),
        zones,
        depths_m,
        missing,
    })
}

/// Carries a perturbation of camera_from_world, R → exp(δ) R and t → t + ε, to its inverse: the rotation changes by
/// -Rᵀ δ, and the origin -Rᵀ t moves by -Rᵀ (ε + [t]× δ).
fn world_covariance(
    covariance: &DMatrix<f64>,
    first: usize,
    camera_from_world: &Rigid,
) -> Covariance6 {
    let back = camera_from_world.rotation.inverse().to_rotation_matrix().into_inner();
    let mut carry = Covariance6::zeros();
    let by_turn = -back * camera_from_world.translation.vector.cross_matrix();
    carry.fixed_view_mut::<3, 3>(0, 0).copy_from(&by_turn);
    carry.fixed_view_mut::<3, 3>(0, 3).copy_from(&-back);
    carry.fixed_view_mut::<3, 3>(3, 0).copy_from(&-back);
    carry * covariance.fixed_view::<6, 6>(first, first) * carry.transpose()
}

#[cfg(test)]
mod tests;
