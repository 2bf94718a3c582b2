//! A lens from nothing but coded roundels on moving robots, where other cameras of a calibrated arena saw them.
//!
//! In: where the other cameras had each roundel ([`Way`]: fused without the camera in question, which is not to judge itself),
//! and where in its raw pixels that camera saw the centres of their rims ([`Glimpse`]). Out: a lens as
//! from views of a board, with the camera's place and its clock, and how well each is known ([`MovingLens`]).
//!
//! The method: a camera to begin with by radial alignment (`radial_alignment`, Tsai 1987), then lens, place and clock refined together
//! (`bundle`), errors weighed by what the others know of each place and by what the errors themselves show of rims and
//! stamps (`noise_model`); the covariance is the one that leaving out each roundel's stretches shows (`jackknife`). The image of a circle's centre is not its ellipse's, so what is predicted is the
//! centroid of the rim's image, with the orientation that the others gave. The model is chosen by Schwarz's criterion
//! as for boards, where n numbers whose errors hang together count as n / ĉ (Burnham & Anderson 2002, section 2.5), ĉ being how much larger
//! the parameters' variances are than independent errors would make them.
//!
//! Accuracy: `tests::a_lens_is_found_from_moving_roundels` and, from a recording, `tests/tests/moving_lens.rs`.
//! Limits: the camera stands still. What the other cameras' lenses and places are off by together is not in the deviations
//! that are stated: they are relative to the arena as it is calibrated.

mod bundle;
mod error;
mod jackknife;
mod noise_model;
mod radial_alignment;
mod trajectory;

use nalgebra::{DMatrix, Vector2};

use self::{
    bundle::{Bundle, Fit, Pair},
    noise_model::Spread,
};
pub use self::{
    error::{Missing, MovingLensError},
    trajectory::{Way, Waypoint},
};
use super::{
    LensCalibration, Model,
    fit::{
        model_selection::{Evidence, Judged, taken},
        parameters::Candidate,
    },
};
use roundel_fusion::world::ClockPrior;
use roundel_vision::{
    camera::PixelPoint,
    rigid::{Covariance6, Rigid},
};

/// Fewest sightings and places of the picture that a lens is told from.
pub const LEAST_SIGHTINGS: usize = 100;
/// Fewest places of the picture that a lens is told from.
pub const LEAST_PLACES: usize = 20;
/// Places are apart by this share of the picture's diagonal.
const PLACE_SHARE: f64 = 0.02;
/// More than so many sightings only cost time.
const MOST_SIGHTINGS: usize = 6000;
/// So many of them tell where to begin.
const START_SIGHTINGS: usize = 250;
/// A focal length that is known no better than this is not known.
const MOST_DEVIATION: f64 = 0.01;
/// Of the sightings that lie on a way so many have to agree with the lens.
const LEAST_AGREEING: f64 = 0.5;
/// Errors of rims beyond this many pixels are those of a wrong lens.
const MOST_PIXEL_PX: f64 = 3.0;
/// Zones of the picture across and down, and how many sightings are in one that was visited.
const ZONES: usize = 3;
const VISITED: usize = 20;
/// Depths are told between these shares of the sightings.
const DEPTH_SHARES: [f64; 2] = [0.02, 0.98];
/// Farthest over nearest depth that is enough.
const DEPTH_RATIO: f64 = 1.15;
/// Stamps of what is called exact may be off by so much, seconds, and a second.
const EXACT: [f64; 2] = [1e-9, 1e-12];

/// Where the camera saw a roundel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Glimpse {
    /// Index of the roundel's way.
    pub way: usize,
    /// When, by the camera's clock, since the ways' epoch, seconds.
    pub stamp_s: f64,
    /// The centre of its outer rim's ellipse, raw pixels.
    pub center: PixelPoint,
    /// Geometric mean of the ellipse's semiaxes, pixels.
    pub radius_px: f64,
}

/// What a lens is found from.
#[derive(Clone, Debug)]
pub struct Seen<'a> {
    /// Columns and rows of the picture.
    pub size: (usize, usize),
    /// Where the others had each roundel.
    pub ways: &'a [Way],
    /// What the camera saw.
    pub glimpses: &'a [Glimpse],
    /// What is known of the camera's clock.
    pub clock: ClockPrior,
}

/// A lens that was found, and what was found with it.
#[derive(Clone, Debug)]
pub struct MovingLens {
    /// The lens; there are no views.
    pub lens: LensCalibration,
    /// Where the camera stands.
    pub world_from_camera: Rigid,
    /// Over (position, rotation), world frame, left perturbation.
    pub pose_covariance: Covariance6,
    /// By how much the camera's stamps are late, and its deviation, seconds.
    pub offset_s: (f64, f64),
    /// Errors beside those of the places: of a rim's centre, pixels, and of stamps from frame to frame, seconds.
    pub unstated: (f64, f64),
    /// Sightings that were used.
    pub sightings: usize,
    /// Sightings by zone of the picture, row by row from the top left: 3 by 3.
    pub zones: Vec<usize>,
    /// Nearest and farthest roundels' depth, metres.
    pub depths_m: [f64; 2],
    /// What would make it better known.
    pub missing: Vec<Missing>,
}

impl MovingLens {
    /// Share of the picture's zones in which roundels were, 0 to 1.
    pub fn coverage(&self) -> f64 {
        let visited = self.zones.iter().filter(|&&count| count >= VISITED).count();
        visited as f64 / self.zones.len() as f64
    }
}

/// Finds a camera's lens; with `model` of that one, else of the one for which most speaks.
pub fn calibrate(seen: &Seen<'_>, model: Option<Model>) -> Result<MovingLens, MovingLensError> {
    let (width, height) = seen.size;
    let is_side = |side: usize| (16..=roundel_vision::camera::MAX_SIDE_PX).contains(&side);
    if !(is_side(width) && is_side(height)) {
        return Err(MovingLensError::Size { width, height });
    }
    let pairs = pairs(seen);
    let (found, places) = (pairs.len(), places(&pairs, seen.size));
    let zones = zones(&pairs, seen.size);
    if found < LEAST_SIGHTINGS || places < LEAST_PLACES {
        return Err(MovingLensError::TooFew { found, places, missing: unvisited(&zones) });
    }
    let unexplained = |agreeing| MovingLensError::Unexplained { found, agreeing };
    let begun = begin(seen, &pairs).ok_or(unexplained(0))?;
    let models = model.map_or_else(|| Model::ALL.to_vec(), |model| vec![model]);
    let (fit, evidence) = best(&begun, &pairs, &models).ok_or(unexplained(0))?;
    let agreeing = fit.bundle.pairs.len();
    if (agreeing as f64) < LEAST_AGREEING * found as f64
        || fit.bundle.spread.pixel_px > MOST_PIXEL_PX
    {
        return Err(unexplained(agreeing));
    }
    told(fit, evidence, found)
}

/// Sightings that lie on a way, thinned out evenly.
fn pairs(seen: &Seen<'_>) -> Vec<Pair> {
    let is_sound = |glimpse: &&Glimpse| {
        let numbers = [glimpse.stamp_s, glimpse.center.u, glimpse.center.v, glimpse.radius_px];
        let way = seen.ways.get(glimpse.way);
        numbers.into_iter().all(f64::is_finite)
            && glimpse.radius_px > 0.0
            && way.is_some_and(|way| way.at(glimpse.stamp_s).is_some())
    };
    let sound: Vec<&Glimpse> = seen.glimpses.iter().filter(is_sound).collect();
    let pair = |glimpse: &&Glimpse| {
        let center = Vector2::new(glimpse.center.u, glimpse.center.v);
        Pair::new(glimpse.way, glimpse.stamp_s, center, glimpse.radius_px)
    };
    every(&sound, MOST_SIGHTINGS).map(pair).collect()
}

/// So many at most, evenly.
fn every<T>(all: &[T], most: usize) -> impl Iterator<Item = &T> {
    let count = all.len().min(most);
    (0..count).map(move |index| &all[index * all.len() / count.max(1)])
}

/// Places of the picture in which roundels were, none near another.
fn places(pairs: &[Pair], (width, height): (usize, usize)) -> usize {
    let apart_px = PLACE_SHARE * (width as f64).hypot(height as f64);
    let mut places: Vec<Vector2<f64>> = Vec::new();
    for pair in pairs {
        if places.iter().all(|place| (place - pair.seen).norm() >= apart_px) {
            places.push(pair.seen);
        }
    }
    places.len()
}

fn zones(pairs: &[Pair], (width, height): (usize, usize)) -> Vec<usize> {
    let mut zones = vec![0; ZONES * ZONES];
    for pair in pairs {
        let zone = |place_px: f64, side_px: usize| {
            ((place_px / side_px as f64 * ZONES as f64).max(0.0) as usize).min(ZONES - 1)
        };
        zones[zone(pair.seen.y, height) * ZONES + zone(pair.seen.x, width)] += 1;
    }
    zones
}

fn unvisited(zones: &[usize]) -> Vec<Missing> {
    let zones = zones.iter().enumerate().filter(|(_, count)| **count < VISITED);
    zones.map(|(index, _)| Missing::Zone(index % ZONES, index / ZONES)).collect()
}

/// The camera to begin with: the start from which a simple lens explains a part of the sightings best.
fn begin<'a>(seen: &Seen<'a>, pairs: &[Pair]) -> Option<Bundle<'a>> {
    let few: Vec<Pair> = every(pairs, START_SIGHTINGS).cloned().collect();
    let middle = Vector2::new(seen.size.0 as f64 - 1.0, seen.size.1 as f64 - 1.0) / 2.0;
    let side_px = seen.size.0.max(seen.size.1) as f64;
    let placed: Vec<radial_alignment::Pair> = few
        .iter()
        .filter_map(|pair| {
            Some((seen.ways[pair.way].at(pair.stamp_s)?.place_m, pair.seen - middle))
        })
        .collect();
    let clock_prior = [seen.clock.offset_s.max(EXACT[0]), seen.clock.skew.max(EXACT[1])];
    let mut best: Option<(f64, Bundle<'a>)> = None;
    for start in radial_alignment::starts(&placed, side_px) {
        for model in [Model::Radial1, Model::Equidistant2] {
            let mut bundle = Bundle {
                candidate: Candidate::new(seen.size, start.focal_px, model),
                ways: seen.ways,
                pairs: few.clone(),
                camera_from_world: start.camera_from_world,
                clock: [0.0; 2],
                clock_prior,
                spread: Spread::BEGIN,
                keeps_spread: false,
            };
            let Some(scale) = bundle.approach() else { continue };
            if best.as_ref().is_none_or(|(least, _)| scale < *least) {
                best = Some((scale, bundle));
            }
        }
    }
    best.map(|(_, bundle)| bundle)
}

/// The fit of the model that is taken, and what speaks against each.
fn best<'a>(
    begun: &Bundle<'a>,
    pairs: &[Pair],
    models: &[Model],
) -> Option<(Fit<'a>, Vec<Evidence>)> {
    let of = |model: Model, spread: Option<Spread>| {
        let bundle = Bundle {
            candidate: begun.candidate.with_model(model),
            pairs: pairs.to_vec(),
            spread: spread.unwrap_or(Spread::BEGIN),
            keeps_spread: spread.is_some(),
            ..begun.clone()
        };
        bundle.fit()
    };
    let fits: Vec<Fit<'_>> = models.iter().filter_map(|&model| of(model, None)).collect();
    // What errors beside the lens' there are shows with the lens that explains most; by these all are judged.
    let by_spread = |one: &&Fit<'_>, other: &&Fit<'_>| {
        one.bundle.spread.pixel_px.total_cmp(&other.bundle.spread.pixel_px)
    };
    let least = fits.iter().min_by(by_spread)?;
    let (spread, inflation) = (least.bundle.spread, least.inflation);
    let judged = |fit: Fit<'a>| {
        let candidate = &fit.bundle.candidate;
        let (model, parameters) = (candidate.model(), candidate.unknowns() as f64);
        let fit = of(model, Some(spread))?;
        let count = 2.0 * fit.bundle.pairs.len() as f64;
        let criterion = (fit.squares / count).max(1e-300).ln() * count / inflation
            + parameters * (count / inflation).max(1.0).ln();
        Some(Judged { model, rms_px: fit.rms_px, criterion, count, fit })
    };
    let (_, fit, evidence) = taken(fits.into_iter().filter_map(judged).collect())?;
    Some((fit, evidence))
}

fn told(
    fit: Fit<'_>,
    evidence: Vec<Evidence>,
    given: usize,
) -> Result<MovingLens, MovingLensError> {
    let bundle = &fit.bundle;
    let lens = bundle.candidate.unknowns();
    let mut depths_m = fit.depths_m();
    depths_m.sort_by(f64::total_cmp);
    let depths_m = DEPTH_SHARES.map(|share| {
        let at = (share * depths_m.len() as f64) as usize;
        depths_m.get(at.min(depths_m.len().saturating_sub(1))).copied().unwrap_or_default()
    });
    let zones = zones(&bundle.pairs, bundle.candidate.size());
    let mut missing = Vec::new();
    let [nearest_m, farthest_m] = depths_m;
    let focal_px = fit.camera.intrinsics().fx_px;
    let deviation = fit.covariance[(0, 0)].max(fit.covariance[(1, 1)]).sqrt() / focal_px;
    let is_told = deviation <= MOST_DEVIATION;
    if farthest_m < DEPTH_RATIO * nearest_m || !is_told {
        missing.push(Missing::Depth { ratio: farthest_m / nearest_m });
    }
    missing.extend(unvisited(&zones));
    if !is_told {
        return Err(MovingLensError::Undetermined { deviation, missing });
    }
    let world_from_camera = bundle.camera_from_world.inverse();
    let clock_deviation_s = fit.covariance[(lens + 6, lens + 6)].max(0.0).sqrt();
    Ok(MovingLens {
        lens: LensCalibration {
            camera: fit.camera.clone(),
            model: bundle.candidate.model(),
            covariance: fit.covariance.view((0, 0), (lens, lens)).into_owned(),
            rms_px: fit.rms_px,
            views: Vec::new(),
            outliers: given - bundle.pairs.len(),
            evidence,
            width: None,
        },
        pose_covariance: world_covariance(&fit.covariance, lens, &bundle.camera_from_world),
        world_from_camera,
        offset_s: (bundle.clock[0], clock_deviation_s),
        unstated: (bundle.spread.pixel_px, bundle.spread.stamp_s),
        sightings: bundle.pairs.len(),
        zones,
        depths_m,
        missing,
    })
}

/// From a turn δ and shift ε of camera_from_world, R → exp(δ) R and t → t + ε, to those of its inverse: the world turns by -Rᵀ δ,
/// and the camera's origin -Rᵀ t moves by -Rᵀ (ε + [t]× δ).
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
