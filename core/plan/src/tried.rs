//! What no formula foretells well: tried on pictures of one ring (`trial`), with the real detector and pose.
//!
//! Two things are tried of a sort of pictures (mode, ratio of diameters, blur, noise, contrast, focal length):
//!
//! - **The least diameter that is found**, at some tilts: in nineteen of twenty pictures, and in as many of whatever is
//!   larger.
//! - **What errors are, over those by formula** ([`super::precision`]), rms along the line of sight and across it, at some
//!   tilts, angles off the axis, and diameters from the least one up to where formulas are as good as pictures: where disc
//!   and black are four blurs wide, and in fast mode from 32 px on. Small rings by moments stray by light that is mixed
//!   into levels, by what is about their sheet, by where they lie on the pixels, and by which of two normals that makes
//!   likelier: up to five times as far as formulas say, or half as far, and differently at each tilt.
//!
//! Between them it is interpolated, the logarithm of ratios by angle and by the diameter's logarithm, so that a map of
//! thousands of spots takes some dozens of trials of 0.05 to 0.15 s. Each is made when it is first asked for and kept
//! ([`Trials`]); blur, noise, contrast and focal length are taken in steps, so that a camera whose blur is measured again
//! and again is not tried each time. Seeds are fixed: the same question has the same answer.
//!
//! What a trial does not know is what lies about the sheet, and how wide that is: it takes a floor midway between black
//! and white, and a margin of 0.4 of the ring's diameter. Of coded rings only the least diameter is tried.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, OnceLock, PoisonError},
};

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::{
    FULL_SCALE, Imaging, Sensor,
    precision::{along_m, modelled},
    sight::Sighting,
    trial::{Geometry, Length, OUTER_M, Stage},
};
use roundel_vision::{
    camera::Camera,
    marker::{Kind, Mode, Params, Pattern, Polarity},
};

/// Tilts at which errors are tried, and at which the least diameter is, degrees. What the tilt's own error makes of the
/// distance changes within a few degrees of face-on.
const TILTS_DEG: [f64; 12] = [0.0, 3.0, 6.0, 10.0, 16.0, 24.0, 33.0, 42.0, 50.0, 58.0, 66.0, 74.0];
const LEAST_TILTS_DEG: [f64; 4] = [0.0, 25.0, 50.0, 74.0];
/// Angles off the axis of a pinhole, degrees: there one pixel spans less of an angle outwards than around, so that a ring is
/// imaged longer by 1/cos. What a lens' own model does to it at some place counts as the angle at which a pinhole does so.
const ASIDE_DEG: [f64; 3] = [0.0, 30.0, 50.0];
/// From one diameter that is tried to the next, how many there are, and which is none any more, pixels.
const SIZE_STEP: f64 = 1.12;
const SIZES: usize = 20;
const MOST_PX: f64 = 48.0;
/// Shorter diameter from which formulas are as good in fast mode, pixels; in both modes disc and black have to be so many
/// times as wide as the blur.
const FAST_PX: f64 = 32.0;
const WIDE: f64 = 4.0;
/// What is as wide, and so many times the detector's limit, is found, unless noise is more than this share of the contrast.
const SURE: f64 = 3.0;
const SURE_NOISE: f64 = 0.1;
/// Steps of the logarithms of blur, of noise and contrast, and of the focal length.
const BLUR_STEP: f64 = 0.02;
const LEVEL_STEP: f64 = 0.1;
const FOCAL_STEP: f64 = 0.2;
/// Of ratios of diameters.
const RATIO_STEP: f64 = 1e-4;
/// Most sorts that are kept.
const MOST_SORTS: usize = 64;

/// Rings for the errors, frames of each, and those that count: of 300 errors the rms is itself known to a 25th, and where
/// a few pictures with the wrong normal decide still to a tenth.
const LENGTH: Length = Length { courses: 150, frames: 3, counted: 2 };
/// Pictures that tell whether a diameter is found, and how many of them may be without it: one in twenty.
const LOOKS: Length = Length { courses: 120, frames: 1, counted: 1 };
const MOST_MISSED: usize = 6;
/// The least diameter is found to this share, after steps of this factor from what is surely found on, and looked for up to
/// so many times the detector's limit.
const LEAST_SHARE: f64 = 0.01;
const LEAST_STEP: f64 = 1.08;
const LEAST_MOST: f64 = 30.0;

/// What was tried so far. A clone shares it; what is in it changes how long a plan takes, and nothing else.
#[derive(Clone, Debug, Default)]
pub struct Trials(Arc<Mutex<HashMap<Sort, Arc<Table>>>>);

/// What came out over what formulas say: of errors along the line of sight, and across it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Factors {
    pub along: f64,
    pub across: f64,
}

/// Pictures that are as good as the same, in steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Sort {
    mode: Mode,
    polarity: Polarity,
    ratios: [i32; 2],
    blur: i32,
    noise: i32,
    contrast: i32,
    focal: i32,
}

/// What was tried of a sort.
#[derive(Debug)]
struct Table {
    stage: Stage,
    least_px: [OnceLock<f64>; LEAST_TILTS_DEG.len()],
    factors: [[[OnceLock<Factors>; SIZES]; TILTS_DEG.len()]; ASIDE_DEG.len()],
}

/// A place in a table of factors: of the angle aside, the tilt and the diameter.
type Place = [usize; 3];

/// All trials are equal: they say the same when they are asked.
impl PartialEq for Trials {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Trials {
    fn table(&self, sensor: &Sensor, kind: &Kind) -> Arc<Table> {
        let sort = Sort::of(sensor, kind);
        let mut tables = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if tables.len() >= MOST_SORTS && !tables.contains_key(&sort) {
            tables.clear();
        }
        tables.entry(sort).or_insert_with(|| Arc::new(Table::new(&sort))).clone()
    }
}

/// The least shorter diameter that is found, pixels.
pub(super) fn least_minor_px(sensor: &Sensor, kind: &Kind, tilt_rad: f64) -> f64 {
    sensor.trials.table(sensor, kind).least_minor_px(tilt_rad)
}

/// Whether a ring of this shorter diameter is found; what is large and sharp is not tried.
pub(super) fn is_wide_enough(sensor: &Sensor, kind: &Kind, sighting: &Sighting) -> bool {
    let limit_px = 2.0 * Params::default().min_semi_minor_px;
    let is_quiet = sensor.imaging.noise <= SURE_NOISE * sensor.imaging.contrast();
    let sure_px = washed_px(sensor, kind).max(SURE * limit_px);
    sighting.minor_px >= limit_px
        && (is_quiet && sighting.minor_px >= sure_px
            || sighting.minor_px >= least_minor_px(sensor, kind, sighting.tilt_rad))
}

/// What errors come out to, over what formulas say.
pub(super) fn factors(
    sensor: &Sensor,
    kind: &Kind,
    sighting: &Sighting,
    center_m: &Vector3<f64>,
) -> Factors {
    // Teeth are read from sizes on that are none of these.
    let is_coded = matches!(kind.pattern, Pattern::Coded(_));
    if is_coded || sighting.minor_px >= trusted_px(sensor, kind) {
        return Factors::NONE;
    }
    let Sighting { minor_px, tilt_rad, .. } = *sighting;
    let aside_rad = aside_rad(&sensor.camera, center_m);
    sensor.trials.table(sensor, kind).factors(&Geometry { minor_px, tilt_rad, aside_rad })
}

/// The angle off the axis at which a pinhole images as unevenly as a camera does at a place.
fn aside_rad(camera: &Camera, center_m: &Vector3<f64>) -> f64 {
    let Ok((_, jacobian)) = camera.project_with_jacobian(center_m) else { return 0.0 };
    let across = Matrix3::identity() - center_m * center_m.transpose() / center_m.norm_squared();
    let moved = jacobian * across;
    let [wide, narrow] = (moved * moved.transpose()).symmetric_eigenvalues().into();
    let ratio: f64 = wide.min(narrow) / wide.max(narrow);
    ratio.clamp(0.0, 1.0).sqrt().acos()
}

/// Shorter diameter from which formulas are as good, pixels.
fn trusted_px(sensor: &Sensor, kind: &Kind) -> f64 {
    let washed_px = washed_px(sensor, kind).min(MOST_PX);
    match sensor.mode {
        Mode::Precise => washed_px,
        Mode::Fast => washed_px.max(FAST_PX),
    }
}

/// Shorter diameter up to which disc or black is not wide against the blur, pixels.
fn washed_px(sensor: &Sensor, kind: &Kind) -> f64 {
    let (least, most) = kind.ratios();
    let spread_px = (sensor.imaging.blur_px.powi(2) + 1.0 / 12.0).sqrt();
    2.0 * WIDE * spread_px / least.min(1.0 - most)
}

impl Factors {
    /// Formulas are right.
    const NONE: Self = Self { along: 1.0, across: 1.0 };
}

impl Sort {
    fn of(sensor: &Sensor, kind: &Kind) -> Self {
        let Imaging { noise, blur_px, .. } = sensor.imaging;
        let step = |value: f64, step: f64| (value.ln() / step).round() as i32;
        let (least, most) = kind.ratios();
        Self {
            mode: sensor.mode,
            polarity: kind.polarity,
            ratios: [least, most].map(|ratio| (ratio / RATIO_STEP).round() as i32),
            blur: step(blur_px, BLUR_STEP),
            noise: step((noise * noise + 1.0 / 12.0).sqrt(), LEVEL_STEP),
            contrast: step(sensor.imaging.contrast(), LEVEL_STEP),
            focal: step(sensor.camera.intrinsics().fx_px, FOCAL_STEP),
        }
    }

    fn imaging(&self) -> Imaging {
        let value = |count: i32, step: f64| (f64::from(count) * step).exp();
        let contrast = value(self.contrast, LEVEL_STEP).min(FULL_SCALE);
        let noise = (value(self.noise, LEVEL_STEP).powi(2) - 1.0 / 12.0).max(0.0).sqrt();
        let black = 0.5 * (FULL_SCALE - contrast);
        Imaging { noise, blur_px: value(self.blur, BLUR_STEP), black, white: black + contrast }
    }

    fn kind(&self) -> Kind {
        let [least_m, most_m] = self.ratios.map(|count| f64::from(count) * RATIO_STEP * OUTER_M);
        let pattern = if least_m < most_m {
            Pattern::Elliptical { minor_diameter_m: least_m }
        } else {
            Pattern::Plain
        };
        let plain = Kind::plain("tried", OUTER_M, most_m);
        Kind { pattern, polarity: self.polarity, ..plain }
    }
}

impl Table {
    fn new(sort: &Sort) -> Self {
        let focal_px = (f64::from(sort.focal) * FOCAL_STEP).exp();
        let stage = Stage::new(focal_px, sort.imaging(), sort.mode, sort.kind());
        Self { stage, least_px: Default::default(), factors: Default::default() }
    }

    fn least_minor_px(&self, tilt_rad: f64) -> f64 {
        let ends = between(&LEAST_TILTS_DEG, tilt_rad);
        // Side by side, each by one thread alone: none that waits for another holds up a third.
        let at = |tilt: usize| {
            let bisected = || self.bisected(LEAST_TILTS_DEG[tilt].to_radians());
            *self.least_px[tilt].get_or_init(bisected)
        };
        if ends.iter().any(|&(tilt, _)| self.least_px[tilt].get().is_none()) {
            ends.par_iter().filter(|(_, weight)| *weight > 0.0).for_each(|&(tilt, _)| {
                at(tilt);
            });
        }
        let weighted = |(tilt, weight)| if weight > 0.0 { weight * at(tilt) } else { 0.0 };
        ends.into_iter().map(weighted).sum()
    }

    fn bisected(&self, tilt_rad: f64) -> f64 {
        let limit_px = 2.0 * Params::default().min_semi_minor_px;
        let is_found = |minor_px: f64| {
            let mut missed = 0;
            let geometry = Geometry { minor_px, tilt_rad, aside_rad: 0.0 };
            self.stage.shoot(geometry, LOOKS, |_, position| {
                missed += usize::from(position.is_none());
                missed <= MOST_MISSED
            });
            missed <= MOST_MISSED
        };
        // From above: what is found at some size may not be at a larger one.
        let mut good =
            washed_px(&self.stage.sensor, &self.stage.kind).min(MOST_PX).max(SURE * limit_px);
        while !is_found(good) {
            good *= LEAST_STEP;
            if good > LEAST_MOST * limit_px {
                return good;
            }
        }
        let mut bad = good / LEAST_STEP;
        while is_found(bad) {
            (good, bad) = (bad, bad / LEAST_STEP);
            if good < limit_px {
                return limit_px;
            }
        }
        while (good / bad).ln() > LEAST_SHARE {
            let middle = (good * bad).sqrt();
            if is_found(middle) { good = middle } else { bad = middle }
        }
        good
    }

    /// A diameter that is tried, pixels.
    fn size_px(&self, tilt: usize, size: usize) -> f64 {
        self.least_minor_px(TILTS_DEG[tilt].to_radians()) * SIZE_STEP.powi(size as i32)
    }

    fn factors(&self, geometry: &Geometry) -> Factors {
        let mut corners: Vec<(Place, f64)> = Vec::with_capacity(8);
        for (aside, by_aside) in between(&ASIDE_DEG, geometry.aside_rad) {
            for (tilt, by_tilt) in between(&TILTS_DEG, geometry.tilt_rad) {
                let place = (geometry.minor_px / self.size_px(tilt, 0)).ln() / SIZE_STEP.ln();
                let place = place.clamp(0.0, (SIZES - 2) as f64);
                let (size, part) = (place.floor() as usize, place.fract());
                let weight = by_aside * by_tilt;
                corners.push(([aside, tilt, size], weight * (1.0 - part)));
                corners.push(([aside, tilt, size + 1], weight * part));
            }
        }
        corners.retain(|(_, weight)| *weight > 0.0);
        let is_tried =
            |&[aside, tilt, size]: &Place| self.factors[aside][tilt][size].get().is_some();
        if !corners.iter().all(|(place, _)| is_tried(place)) {
            corners.par_iter().for_each(|(place, _)| {
                self.at(*place);
            });
        }
        let mut logs = [0.0; 2];
        for (place, weight) in corners {
            let Factors { along, across } = self.at(place);
            logs[0] += weight * along.ln();
            logs[1] += weight * across.ln();
        }
        let [along, across] = logs.map(f64::exp);
        Factors { along, across }
    }

    fn at(&self, [aside, tilt, size]: Place) -> Factors {
        *self.factors[aside][tilt][size].get_or_init(|| {
            let minor_px = self.size_px(tilt, size);
            if minor_px >= trusted_px(&self.stage.sensor, &self.stage.kind) {
                return Factors::NONE;
            }
            let [tilt_rad, aside_rad] = [TILTS_DEG[tilt], ASIDE_DEG[aside]].map(f64::to_radians);
            self.measured(Geometry { minor_px, tilt_rad, aside_rad })
        })
    }

    fn measured(&self, geometry: Geometry) -> Factors {
        let (mut planned, mut came) = ([0.0; 2], [0.0; 2]);
        self.stage.shoot(geometry, LENGTH, |shown, position| {
            let modelled = modelled(shown.sensor, shown.kind, &shown.sighting);
            let (Some(position), Some(modelled)) = (position, modelled) else { return true };
            let position_m2: Matrix3<f64> = modelled.covariance.fixed_view::<3, 3>(0, 0).into();
            let truth = shown.pose.translation.vector;
            let along = along_m(&position_m2, &truth);
            planned[0] += along * along;
            planned[1] += position_m2.trace() - along * along;
            let error = position - truth;
            let along = error.dot(&truth.normalize());
            came[0] += along * along;
            came[1] += error.norm_squared() - along * along;
            true
        });
        let [along, across] = [0, 1].map(|axis| {
            let ratio: f64 = came[axis] / planned[axis];
            if ratio.is_finite() && ratio > 0.0 { ratio.sqrt() } else { 1.0 }
        });
        Factors { along, across }
    }
}

/// Known angles about this one, with their weights.
fn between(known_deg: &[f64], angle_rad: f64) -> [(usize, f64); 2] {
    let deg = angle_rad.to_degrees();
    let after = known_deg.partition_point(|&known| known <= deg).clamp(1, known_deg.len() - 1);
    let [from, to] = [known_deg[after - 1], known_deg[after]];
    let share = ((deg - from) / (to - from)).clamp(0.0, 1.0);
    [(after - 1, 1.0 - share), (after, share)]
}

#[cfg(test)]
mod tests {
    use super::{
        super::{
            precision::expect,
            reach::before,
            search::scaled,
            sight::{is_found, sight},
            tests::sensor,
        },
        *,
    };
    use roundel_vision::camera::NormalizedPoint;

    fn fast(blur_px: f64) -> Sensor {
        let imaging = Imaging { blur_px, ..Imaging::default() };
        Sensor { imaging, mode: Mode::Fast, ..sensor() }
    }

    fn kind() -> Kind {
        Kind::plain("", 0.16, 0.064)
    }

    #[test]
    fn what_is_as_good_as_the_same_is_tried_once() {
        let sensor = fast(0.7);
        let table = |sensor: &Sensor, kind: &Kind| sensor.trials.table(sensor, kind);
        let first = table(&sensor, &kind());
        let shared = Sensor { trials: sensor.trials.clone(), ..fast(0.703) };
        assert!(Arc::ptr_eq(&first, &table(&shared, &scaled(&kind(), 0.0531))));
        for other in [fast(0.75), super::super::tests::sensor()] {
            let other = Sensor { trials: sensor.trials.clone(), ..other };
            assert!(!Arc::ptr_eq(&first, &table(&other, &kind())));
        }
        let other = Kind::plain("", 0.16, 0.065);
        assert!(!Arc::ptr_eq(&first, &table(&sensor, &other)));
        assert_eq!(fast(0.7), sensor);
    }

    #[test]
    fn more_blur_and_narrower_discs_need_larger_rings() {
        let least = |blur_px: f64, ratio: f64| {
            least_minor_px(&fast(blur_px), &Kind::plain("", 0.16, 0.16 * ratio), 0.3)
        };
        let limit_px = 2.0 * Params::default().min_semi_minor_px;
        let usual_px = least(0.7, 0.4);
        assert!((limit_px..1.5 * limit_px).contains(&usual_px), "{usual_px}");
        assert!(least(1.1, 0.4) > 1.04 * usual_px && least(0.7, 0.3) > 1.04 * usual_px);
        // Nothing is found in noise alone.
        let mut noisy = fast(0.7);
        (noisy.imaging.noise, noisy.imaging.white) = (60.0, 60.0);
        assert!(least_minor_px(&noisy, &kind(), 0.3) > 20.0 * limit_px);
    }

    #[test]
    fn large_sharp_rings_are_left_to_formulas_and_small_ones_are_not() {
        let sensor = fast(0.7);
        let of = |diameter_px: f64, tilt_rad: f64| {
            let distance_m = sensor.camera.intrinsics().fx_px * 0.16 / diameter_px;
            let pose = before(NormalizedPoint::default(), distance_m, tilt_rad);
            let seen = sight(&sensor.camera, &kind(), &sensor.imaging, &pose).unwrap();
            assert!(is_found(&sensor, &kind(), &seen));
            let factors = factors(&sensor, &kind(), &seen, &pose.translation.vector);
            let by_formula = modelled(&sensor, &kind(), &seen).unwrap();
            let expected = expect(&sensor, None, &kind(), &pose).unwrap();
            let by_formula: Matrix3<f64> = by_formula.covariance.fixed_view::<3, 3>(0, 0).into();
            let ratio = expected.depth_m() / along_m(&by_formula, &pose.translation.vector);
            assert!((ratio / factors.along - 1.0).abs() < 1e-9, "{ratio} {factors:?}");
            factors
        };
        assert_eq!(of(60.0, 0.3), Factors::NONE);
        // Rims' light and the floor's run into each other.
        assert!(of(11.0, 0.1).along > 1.3, "{:?}", of(11.0, 0.1));
        assert_eq!(of(15.0, 0.7), of(15.0, 0.7));
        let [one, other] = [of(15.0, 0.7), of(15.1, 0.7)];
        assert!((one.along / other.along - 1.0).abs() < 0.1, "{one:?} {other:?}");
    }

    #[test]
    fn a_pinhole_images_as_unevenly_as_its_angle_off_the_axis_says() {
        for angle_rad in [0.0, 0.3f64, 0.6] {
            let center_m = Vector3::new(angle_rad.sin(), 0.0, angle_rad.cos()) * 3.0;
            let found = aside_rad(&sensor().camera, &center_m);
            assert!((found - angle_rad).abs() < 1e-6, "{found} {angle_rad}");
        }
    }
}
