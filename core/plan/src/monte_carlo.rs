//! Measures detection limits and errors on rendered rings, with the real detector and locator.
//!
//! For each kind of pictures (mode, ratio of diameters, blur, noise, contrast, focal length) there are two tables:
//!
//! - the minimum diameter that is detected in nineteen of twenty pictures, by tilt;
//! - the ratio of actual to predicted rms errors ([`super::precision`]), along and across the line of sight, by tilt, angle
//!   off the axis and diameter, up to the diameter from which predictions are good: discs and rings four blurs wide, and at
//!   least 32 px in fast mode. Below it, errors are between half and five times the prediction.
//!
//! Values in between are interpolated: the logarithm of ratios by angle and by logarithm of the diameter. A map of
//! thousands of spots takes some dozens of trials of 0.05 to 0.15 s, made on demand and cached ([`TrialCache`]). Blur,
//! noise, contrast and focal length are quantized, so that a new measurement of the blur hardly ever causes new trials.
//! Seeds are fixed, so results are reproducible.
//!
//! Limits: the floor around the sheet is midway between black and white, and the margin 0.4 ring diameters. Errors of coded
//! rings are not measured.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use nalgebra::{Matrix3, Vector3};

use super::{
    FULL_SCALE, Imaging, Sensor, bisect,
    pose_model::{along_m, predict_pose},
    ring_trial::{OUTER_M, RingTrial, TrialSetup, ViewGeometry},
    roundel_image::RoundelImage,
};
use roundel_vision::{
    camera::Camera,
    marker::{Kind, Mode, Params, Pattern},
};

/// Tilts of the error table and of the detection table, degrees. Near face-on, errors of the tilt change the
/// distance quickly.
const TILTS_DEG: [f64; 12] = [0.0, 3.0, 6.0, 10.0, 16.0, 24.0, 33.0, 42.0, 50.0, 58.0, 66.0, 74.0];
const DETECTION_TILTS_DEG: [f64; 4] = [0.0, 25.0, 50.0, 74.0];
/// Angles off the axis of a pinhole, degrees. There a ring is imaged longer by 1/cos, since a pixel spans a smaller
/// angle radially than tangentially. A lens with the same ratio counts as the same angle.
const OFF_AXIS_DEG: [f64; 3] = [0.0, 30.0, 50.0];
/// Ratio of successive diameters, their number, and the maximum diameter, pixels.
const SIZE_STEP: f64 = 1.12;
const SIZES: usize = 20;
const MAX_TRIAL_PX: f64 = 48.0;
/// Shorter diameter from which predictions are good in fast mode, pixels, and the required width of disc and ring
/// in blurs.
const FAST_PX: f64 = 32.0;
const MIN_WIDTH_BLURS: f64 = 4.0;
/// A ring of this many times the detector's limit is certainly detected, up to this ratio of noise to contrast.
const CERTAIN_RATIO: f64 = 3.0;
const CERTAIN_NOISE: f64 = 0.1;
/// Quantization of the logarithms of blur, of noise and contrast, and of the focal length.
const BLUR_STEP: f64 = 0.02;
const LEVEL_STEP: f64 = 0.1;
const FOCAL_STEP: f64 = 0.2;
/// Quantization of ratios of diameters.
const RATIO_STEP: f64 = 1e-4;
/// Maximum number of cached tables.
const MAX_TABLES: usize = 64;

/// Trials of an error ratio, and frames of each, of which all but the first count: 300 errors give the rms to 4 %, or
/// 10 % where a few wrong normals dominate.
const ERROR_TRIALS: u64 = 150;
const ERROR_FRAMES: usize = 3;
/// Trials of a detection limit, and the maximum number of misses (one in twenty).
const DETECTION_TRIALS: u64 = 120;
const MAX_MISSED: usize = 6;
/// Relative precision of the detection limit, step of the coarse search, and its maximum in multiples of the
/// detector's limit.
const BISECTION_SHARE: f64 = 0.01;
const SEARCH_STEP: f64 = 1.08;
const MAX_LIMIT_RATIO: f64 = 30.0;

/// Cache of trials, shared by clones. It affects the time of a prediction but not its result.
#[derive(Clone, Debug, Default)]
pub struct TrialCache(Arc<Mutex<Vec<Arc<TrialTable>>>>);

/// Ratio of actual to predicted errors along and across the line of sight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ErrorFactors {
    pub along: f64,
    pub across: f64,
}

/// Results of trials, made on demand.
#[derive(Debug)]
struct TrialTable {
    setup: TrialSetup,
    min_px: [OnceLock<f64>; DETECTION_TILTS_DEG.len()],
    factors: [[[OnceLock<ErrorFactors>; SIZES]; TILTS_DEG.len()]; OFF_AXIS_DEG.len()],
}

impl TrialCache {
    fn table(&self, sensor: &Sensor, kind: &Kind) -> Arc<TrialTable> {
        let setup = quantized(sensor, kind);
        let mut tables = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = tables.iter().find(|table| table.setup == setup) {
            return known.clone();
        }
        if tables.len() >= MAX_TABLES {
            tables.clear();
        }
        let (min_px, factors) = Default::default();
        let table = Arc::new(TrialTable { setup, min_px, factors });
        tables.push(table.clone());
        table
    }
}

/// Minimum shorter diameter of the outer rim that is detected in nineteen of twenty pictures, pixels: D of the
/// paper's equation (14). Coded rings count as plain ones. The first call takes some tenths of a second for trials
/// ([`super::TrialCache`]).
pub(super) fn min_detected_px(sensor: &Sensor, kind: &Kind, tilt_rad: f64) -> f64 {
    sensor.trials.table(sensor, kind).min_detected_px(tilt_rad)
}

/// Whether a ring of this shorter diameter is detected. Large sharp rings need no trial.
pub(super) fn is_wide_enough(sensor: &Sensor, kind: &Kind, image: &RoundelImage) -> bool {
    let limit_px = 2.0 * Params::default().min_semi_minor_px;
    let is_quiet = sensor.imaging.noise <= CERTAIN_NOISE * sensor.imaging.contrast();
    let sure_px = blurred_px(&sensor.imaging, kind).max(CERTAIN_RATIO * limit_px);
    image.minor_px >= limit_px
        && (is_quiet && image.minor_px >= sure_px
            || image.minor_px >= min_detected_px(sensor, kind, image.tilt_rad))
}

/// Error ratios of a ring.
pub(super) fn factors(
    sensor: &Sensor,
    kind: &Kind,
    image: &RoundelImage,
    center_m: &Vector3<f64>,
) -> ErrorFactors {
    // Codes are only read at diameters where predictions are good.
    let is_coded = matches!(kind.pattern, Pattern::Coded(_));
    if is_coded || image.minor_px >= trusted_px(&sensor.imaging, sensor.mode, kind) {
        return ErrorFactors::NONE;
    }
    let RoundelImage { minor_px, tilt_rad, .. } = *image;
    let off_axis_rad = off_axis_rad(&sensor.camera, center_m);
    sensor.trials.table(sensor, kind).factors(&ViewGeometry { minor_px, tilt_rad, off_axis_rad })
}

/// Angle off the axis at which a pinhole has the same anisotropy as this camera at this point.
fn off_axis_rad(camera: &Camera, center_m: &Vector3<f64>) -> f64 {
    let Ok((_, jacobian)) = camera.project_with_jacobian(center_m) else { return 0.0 };
    let across = Matrix3::identity() - center_m * center_m.transpose() / center_m.norm_squared();
    let moved = jacobian * across;
    let [wide, narrow] = (moved * moved.transpose()).symmetric_eigenvalues().into();
    let ratio: f64 = wide.min(narrow) / wide.max(narrow);
    ratio.clamp(0.0, 1.0).sqrt().acos()
}

/// Shorter diameter from which predictions are good, pixels.
fn trusted_px(imaging: &Imaging, mode: Mode, kind: &Kind) -> f64 {
    let blurred_px = blurred_px(imaging, kind).min(MAX_TRIAL_PX);
    match mode {
        Mode::Precise => blurred_px,
        Mode::Fast => blurred_px.max(FAST_PX),
    }
}

/// Shorter diameter up to which disc or ring are not wide against the blur, pixels.
fn blurred_px(imaging: &Imaging, kind: &Kind) -> f64 {
    let (min, max) = kind.ratios();
    let spread_px = (imaging.blur_px.powi(2) + 1.0 / 12.0).sqrt();
    2.0 * MIN_WIDTH_BLURS * spread_px / min.min(1.0 - max)
}

impl ErrorFactors {
    const NONE: Self = Self { along: 1.0, across: 1.0 };
}

/// The set-up of trials, equal for similar sensors and kinds.
fn quantized(sensor: &Sensor, kind: &Kind) -> TrialSetup {
    let Imaging { noise, blur_px, .. } = sensor.imaging;
    let step = |value: f64, step: f64| ((value.ln() / step).round() * step).exp();
    let contrast = step(sensor.imaging.contrast(), LEVEL_STEP).min(FULL_SCALE);
    let noise = step((noise * noise + 1.0 / 12.0).sqrt(), LEVEL_STEP);
    let noise = (noise.powi(2) - 1.0 / 12.0).max(0.0).sqrt();
    let black = 0.5 * (FULL_SCALE - contrast);
    let blur_px = step(blur_px, BLUR_STEP);
    let (min, max) = kind.ratios();
    let [min_m, max_m] =
        [min, max].map(|ratio| (ratio / RATIO_STEP).round() * RATIO_STEP * OUTER_M);
    let pattern = if min_m < max_m {
        Pattern::Elliptical { minor_diameter_m: min_m }
    } else {
        Pattern::Plain
    };
    let plain = Kind::plain("trial", OUTER_M, max_m);
    TrialSetup {
        focal_px: step(sensor.camera.intrinsics().fx_px, FOCAL_STEP),
        imaging: Imaging { noise, blur_px, black, white: black + contrast },
        mode: sensor.mode,
        kind: Kind { pattern, polarity: kind.polarity, ..plain },
    }
}

impl TrialTable {
    fn min_detected_px(&self, tilt_rad: f64) -> f64 {
        let at = |(tilt, weight): (usize, f64)| {
            let bisect_min_px = || self.bisect_min_px(DETECTION_TILTS_DEG[tilt].to_radians());
            weight * self.min_px[tilt].get_or_init(bisect_min_px)
        };
        between(&DETECTION_TILTS_DEG, tilt_rad).map(at).sum()
    }

    fn bisect_min_px(&self, tilt_rad: f64) -> f64 {
        let limit_px = 2.0 * Params::default().min_semi_minor_px;
        let is_detected = |minor_px: f64| {
            let view = ViewGeometry { minor_px, tilt_rad, off_axis_rad: 0.0 };
            let mut trial = RingTrial::new(&self.setup, view, 1);
            let is_missed =
                |&seed: &u64| trial.run(seed).iter().any(|frame| frame.position_m.is_none());
            (0..DETECTION_TRIALS).filter(is_missed).nth(MAX_MISSED).is_none()
        };
        // From above, since detection is not monotonic at small diameters.
        let mut good = blurred_px(&self.setup.imaging, &self.setup.kind)
            .min(MAX_TRIAL_PX)
            .max(CERTAIN_RATIO * limit_px);
        while !is_detected(good) {
            good *= SEARCH_STEP;
            if good > MAX_LIMIT_RATIO * limit_px {
                return good;
            }
        }
        let mut bad = good / SEARCH_STEP;
        while is_detected(bad) {
            (good, bad) = (bad, bad / SEARCH_STEP);
            if good < limit_px {
                return limit_px;
            }
        }
        bisect(good, bad, BISECTION_SHARE, is_detected)
    }

    /// Diameter of a table entry, pixels.
    fn size_px(&self, tilt: usize, size: usize) -> f64 {
        self.min_detected_px(TILTS_DEG[tilt].to_radians()) * SIZE_STEP.powi(size as i32)
    }

    fn factors(&self, view: &ViewGeometry) -> ErrorFactors {
        let mut logs = [0.0; 2];
        for (off_axis, by_off_axis) in between(&OFF_AXIS_DEG, view.off_axis_rad) {
            for (tilt, by_tilt) in between(&TILTS_DEG, view.tilt_rad) {
                let place = (view.minor_px / self.size_px(tilt, 0)).ln() / SIZE_STEP.ln();
                let place = place.clamp(0.0, (SIZES - 2) as f64);
                let (size, part) = (place.floor() as usize, place.fract());
                for (size, by_size) in [(size, 1.0 - part), (size + 1, part)] {
                    let weight = by_off_axis * by_tilt * by_size;
                    if weight > 0.0 {
                        let ErrorFactors { along, across } = self.at(off_axis, tilt, size);
                        logs[0] += weight * along.ln();
                        logs[1] += weight * across.ln();
                    }
                }
            }
        }
        let [along, across] = logs.map(f64::exp);
        ErrorFactors { along, across }
    }

    fn at(&self, off_axis: usize, tilt: usize, size: usize) -> ErrorFactors {
        *self.factors[off_axis][tilt][size].get_or_init(|| {
            let minor_px = self.size_px(tilt, size);
            let TrialSetup { imaging, mode, kind, .. } = &self.setup;
            if minor_px >= trusted_px(imaging, *mode, kind) {
                return ErrorFactors::NONE;
            }
            let [tilt_rad, off_axis_rad] =
                [TILTS_DEG[tilt], OFF_AXIS_DEG[off_axis]].map(f64::to_radians);
            self.run_errors(ViewGeometry { minor_px, tilt_rad, off_axis_rad })
        })
    }

    fn run_errors(&self, view: ViewGeometry) -> ErrorFactors {
        let (mut planned, mut observed) = ([0.0; 2], [0.0; 2]);
        let mut trial = RingTrial::new(&self.setup, view, ERROR_FRAMES);
        for seed in 0..ERROR_TRIALS {
            for frame in trial.run(seed).iter().skip(1) {
                let predicted = predict_pose(&trial.sensor, &self.setup.kind, &frame.image);
                let (Some(position_m), Some(predicted)) = (frame.position_m, predicted) else {
                    continue;
                };
                let position_m2: Matrix3<f64> =
                    predicted.covariance.fixed_view::<3, 3>(0, 0).into();
                let truth = frame.pose.translation.vector;
                let along = along_m(&position_m2, &truth);
                planned[0] += along * along;
                planned[1] += position_m2.trace() - along * along;
                let error = position_m - truth;
                let along = error.dot(&truth.normalize());
                observed[0] += along * along;
                observed[1] += error.norm_squared() - along * along;
            }
        }
        let [along, across] = [0, 1].map(|axis| {
            let ratio: f64 = observed[axis] / planned[axis];
            if ratio.is_finite() && ratio > 0.0 { ratio.sqrt() } else { 1.0 }
        });
        ErrorFactors { along, across }
    }
}

/// Adjacent known angles with their weights, without weights of zero.
fn between(known_deg: &[f64], angle_rad: f64) -> impl Iterator<Item = (usize, f64)> {
    let deg = angle_rad.to_degrees();
    let after = known_deg.partition_point(|&known| known <= deg).clamp(1, known_deg.len() - 1);
    let [from, to] = [known_deg[after - 1], known_deg[after]];
    let share = ((deg - from) / (to - from)).clamp(0.0, 1.0);
    let ends = [(after - 1, 1.0 - share), (after, share)];
    ends.into_iter().filter(|(_, weight)| *weight > 0.0)
}

#[cfg(test)]
mod tests {
    use super::{
        super::{
            precision::predict, range::pose_in_front, roundel_image::image_roundel, search::scaled,
            tests::sensor, visibility::is_detected,
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
    fn similar_sensors_share_trials() {
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
    }

    #[test]
    fn more_blur_and_narrower_discs_need_larger_rings() {
        let min = |blur_px: f64, ratio: f64| {
            min_detected_px(&fast(blur_px), &Kind::plain("", 0.16, 0.16 * ratio), 0.3)
        };
        let limit_px = 2.0 * Params::default().min_semi_minor_px;
        let usual_px = min(0.7, 0.4);
        assert!((limit_px..1.5 * limit_px).contains(&usual_px), "{usual_px}");
        assert!(min(1.1, 0.4) > 1.04 * usual_px && min(0.7, 0.3) > 1.04 * usual_px);
        // Nothing is detected in noise alone.
        let mut noisy = fast(0.7);
        (noisy.imaging.noise, noisy.imaging.white) = (60.0, 60.0);
        assert!(min_detected_px(&noisy, &kind(), 0.3) > 20.0 * limit_px);
    }

    #[test]
    fn only_small_or_blurred_rings_are_corrected() {
        let sensor = fast(0.7);
        let of = |diameter_px: f64, tilt_rad: f64| {
            let distance_m = sensor.camera.intrinsics().fx_px * 0.16 / diameter_px;
            let pose = pose_in_front(NormalizedPoint::default(), distance_m, tilt_rad);
            let seen = image_roundel(&sensor.camera, &kind(), &sensor.imaging, &pose).unwrap();
            assert!(is_detected(&sensor, &kind(), &seen));
            let factors = factors(&sensor, &kind(), &seen, &pose.translation.vector);
            let by_formula = predict_pose(&sensor, &kind(), &seen).unwrap();
            let expected = predict(&sensor, &kind(), &pose).unwrap();
            let by_formula: Matrix3<f64> = by_formula.covariance.fixed_view::<3, 3>(0, 0).into();
            let ratio = expected.depth_m() / along_m(&by_formula, &pose.translation.vector);
            assert!((ratio / factors.along - 1.0).abs() < 1e-9, "{ratio} {factors:?}");
            factors
        };
        assert_eq!(of(60.0, 0.3), ErrorFactors::NONE);
        // Light of the rims and of the floor mix.
        assert!(of(11.0, 0.1).along > 1.3, "{:?}", of(11.0, 0.1));
        assert_eq!(of(15.0, 0.7), of(15.0, 0.7));
        let [one, other] = [of(15.0, 0.7), of(15.1, 0.7)];
        assert!((one.along / other.along - 1.0).abs() < 0.1, "{one:?} {other:?}");
    }

    #[test]
    fn the_equivalent_angle_of_a_pinhole_is_its_own() {
        for angle_rad in [0.0, 0.3f64, 0.6] {
            let center_m = Vector3::new(angle_rad.sin(), 0.0, angle_rad.cos()) * 3.0;
            let found = off_axis_rad(&sensor().camera, &center_m);
            assert!((found - angle_rad).abs() < 1e-6, "{found} {angle_rad}");
        }
    }
}
