//! Predicts what cameras and roundels can do before they are bought or printed. Extends the sensor model of the paper's
//! section 5.
//!
//! | question | module | paper |
//! | --- | --- | --- |
//! | whether a roundel is detected and its code read | [`visibility`] | eq. (12), D of eq. (14) |
//! | range and field of view | [`range`] | eqs. (13) to (16) |
//! | precision | [`precision`] | eqs. (17) to (19) |
//! | the paper's predictions | [`paper`] | eqs. (12) to (20) |
//! | several cameras over an arena | [`map`] | – |
//! | required roundel, number and positions of cameras | [`search`] | – |
//!
//! The rims of a roundel are projected through the whole lens model ([`roundel_image`]); the detector's limits decide
//! whether they are detected; [`roundel_vision::pose::locate`] gives the covariance for the rim noise that the picture
//! causes. Over an arena, [`roundel_fusion::world::seen_in_world`] carries it into the world, as in fusion.
//!
//! The minimum diameter and the precision of small rings have no good formula. They are measured with the real detector on
//! rendered rings (`monte_carlo`, `ring_trial`, `ring_image`) and cached in [`TrialCache`]. The renderer shares no code
//! with the demo's or with the one that judges the predictions.
//!
//! Accuracy: `cargo run --release -p roundel-tests -- plans` compares predictions with a hundred rendered set-ups.

pub mod map;
mod monte_carlo;
pub mod paper;
mod pose_model;
pub mod precision;
pub mod range;
mod ring_image;
mod ring_trial;
pub mod roundel_image;
pub mod search;
pub mod visibility;

pub use monte_carlo::TrialCache;
use thiserror::Error;

use precision::LensUncertainty;

use roundel_vision::{
    camera::Camera,
    marker::{DetectorError, Kind, Mode, Params},
};

/// White level.
const FULL_SCALE: f64 = 255.0;

/// Image quality of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Imaging {
    /// Standard deviation of the noise, grey levels of 255.
    pub noise: f64,
    /// Standard deviation of the lens' blur, pixels.
    pub blur_px: f64,
    /// Grey level of black print.
    pub black: f64,
    /// Grey level of white paper.
    pub white: f64,
}

impl Default for Imaging {
    /// A typical camera in a lit lab.
    fn default() -> Self {
        Self { noise: 2.0, blur_px: 0.7, black: 40.0, white: 200.0 }
    }
}

/// A camera with its lens uncertainty, its image quality and the mode of its detector.
#[derive(Clone, Debug)]
pub struct Sensor {
    /// Intrinsics.
    pub camera: Camera,
    /// Uncertainty of the intrinsics; `None` if they are exact.
    pub lens_uncertainty: Option<LensUncertainty>,
    /// Image quality.
    pub imaging: Imaging,
    /// Mode of the detector.
    pub mode: Mode,
    /// Cached trials; sensors may share them.
    pub trials: TrialCache,
}

/// Why a prediction is impossible.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PlanError {
    /// A number is out of range.
    #[error("{field}: expected {expected}, found {found}")]
    Value {
        /// Name of the number.
        field: &'static str,
        /// Valid range.
        expected: &'static str,
        /// The given number.
        found: f64,
    },
    /// The detector does not support the kind.
    #[error(transparent)]
    Kind(#[from] DetectorError),
    /// No distance, roundel or grid of cameras meets the requirements.
    #[error("{0}")]
    Unreachable(String),
}

impl Imaging {
    /// Checks the range of each number.
    pub fn check(&self) -> Result<(), PlanError> {
        within("noise", self.noise, [0.0, 60.0], "0 to 60 grey levels")?;
        within("blur", self.blur_px, [0.1, 5.0], "0.1 to 5 px")?;
        within("black", self.black, [0.0, FULL_SCALE], "0 to 255 grey levels")?;
        within("white", self.white, [0.0, FULL_SCALE], "0 to 255 grey levels")?;
        let min = f64::from(Params::default().min_contrast);
        let contrast = self.white - self.black;
        within("white less black", contrast, [min, FULL_SCALE], "at least 20 grey levels")
    }

    /// White minus black, grey levels.
    pub fn contrast(&self) -> f64 {
        self.white - self.black
    }
}

impl Sensor {
    /// Checks the image quality and the kind.
    pub fn check(&self, kind: &Kind) -> Result<(), PlanError> {
        self.imaging.check()?;
        roundel_vision::marker::Detector::new(vec![kind.clone()], Params::default())?;
        Ok(())
    }
}

/// Rejects NaN too.
fn within(
    field: &'static str,
    found: f64,
    [low, high]: [f64; 2],
    expected: &'static str,
) -> Result<(), PlanError> {
    if (low..=high).contains(&found) {
        Ok(())
    } else {
        Err(PlanError::Value { field, expected, found })
    }
}

/// Last point at which `holds` is true, to this relative precision, from a point where it is true towards one where it is
/// not.
fn bisect(mut good: f64, mut bad: f64, share: f64, holds: impl Fn(f64) -> bool) -> f64 {
    while (good / bad).ln().abs() > share {
        let middle = (good * bad).sqrt();
        if holds(middle) { good = middle } else { bad = middle }
    }
    good
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, Vector3};

    use super::{
        map::{MapArea, PlacedCamera, map},
        range::detection_range,
        search::{
            Requirements, fewest_cameras, fewest_cameras_of_any_size, scaled, smallest_diameter_m,
        },
        *,
    };
    use roundel_vision::{
        camera::{Intrinsics, Lens, NormalizedPoint},
        marker::{CodeLayout, Pattern},
    };

    /// 640x480, f = 700 px, no distortion, precise.
    pub(super) fn sensor() -> Sensor {
        let intrinsics = Intrinsics {
            width: 640,
            height: 480,
            fx_px: 700.0,
            fy_px: 700.0,
            cx_px: 319.5,
            cy_px: 239.5,
            lens: Lens::PlumbBob([0.0; 5]),
        };
        let camera = Camera::new(intrinsics).unwrap();
        Sensor {
            camera,
            lens_uncertainty: None,
            imaging: Imaging::default(),
            mode: Mode::Precise,
            trials: TrialCache::default(),
        }
    }

    fn kind() -> Kind {
        Kind::plain("robot", 0.16, 0.064)
    }

    #[test]
    fn ranges_without_distortion_match_the_paper() {
        let found = detection_range(&sensor(), &kind(), 0.0).unwrap();
        let paper = paper::Pinhole {
            size_px: [640.0, 480.0],
            focal_px: [700.0; 2],
            outer_m: 0.16,
            tilt_rad: [0.0; 2],
            min_px: found.min_minor_px,
            shrink: [1.0; 2],
        };
        let near = |one: f64, other: f64| (one / other - 1.0).abs() < 0.02;
        assert!(near(found.max_m, paper.max_distance_m()), "{found:?}");
        assert!(near(found.max_corner_m, found.max_m), "{found:?}");
        assert!(near(found.min_m, paper.min_distance_m()), "{found:?}");
        // The paper subtracts two diameters, where one suffices.
        let base_m = [0, 1].map(|axis| paper.base_m()[axis] + paper.outer_m);
        assert!(near(found.base_m[0], base_m[0]) && near(found.base_m[1], base_m[1]), "{found:?}");
        let tilted = detection_range(&sensor(), &kind(), 0.7).unwrap();
        assert!(tilted.max_m < 0.9 * found.max_m);
    }

    /// The same print with a code.
    fn coded(bits: u8) -> Kind {
        let pattern = Pattern::Coded(CodeLayout { bits, min_distance: 1 });
        Kind { pattern, ..Kind::plain("robot", 0.16, 0.16 * CodeLayout::RATIO) }
    }

    #[test]
    fn a_code_has_a_shorter_range_than_its_ring() {
        for (bits, min_px) in [(5, 30.0), (8, 36.0), (10, 48.0), (12, 60.0), (16, 90.0)] {
            let found = detection_range(&sensor(), &coded(bits), 0.0).unwrap();
            assert_eq!(found.min_minor_px, min_px);
            let by_pinhole_m = 700.0 * 0.16 / min_px;
            assert!((found.max_m / by_pinhole_m - 1.0).abs() < 0.02, "{bits}: {found:?}");
            let ring = found.unread.unwrap();
            assert!(ring.min_minor_px < 20.0 && ring.max_m > 1.5 * found.max_m, "{found:?}");
        }
        assert_eq!(detection_range(&sensor(), &kind(), 0.0).unwrap().unread, None);
        let face_on = detection_range(&sensor(), &coded(8), 0.0).unwrap();
        let tilted = detection_range(&sensor(), &coded(8), 0.8).unwrap();
        let ratio = tilted.max_m / face_on.max_m;
        assert!((ratio / 0.8f64.cos() - 1.0).abs() < 0.02, "{tilted:?}");
        assert!(tilted.max_corner_m <= tilted.max_m && tilted.base_m[0] < face_on.base_m[0]);
    }

    #[test]
    fn coverage_of_coded_roundels_requires_reading_the_code() {
        let [plain_m, coded_m] = [kind(), coded(8)]
            .map(|kind| smallest_diameter_m(&sensor(), &kind, 4.0, 0.0, None).unwrap());
        assert!(plain_m < 0.5 * coded_m && (coded_m / (36.0 * 4.0 / 700.0) - 1.0).abs() < 0.02);
        // From 3.5 m the ring is 32 px wide.
        let stations = [PlacedCamera::downward(sensor(), Vector3::new(0.0, 0.0, 3.5), false)];
        let area = area(0.5, 0.4, 0.0);
        let [plain, unread, read] = [kind(), coded(8), scaled(&coded(8), 0.2)]
            .map(|kind| map(&stations, &kind, area).unwrap().summary().seen_share);
        assert_eq!([plain, unread, read], [1.0, 0.0, 1.0]);
        let requirements =
            Requirements { area, mount_m: [3.0, 3.5], views: 1, share: 1.0, max_m: None };
        let grid = fewest_cameras(&sensor(), &coded(8), &requirements).unwrap();
        assert!(grid.layout.mount_m < 3.2, "{:?}", grid.layout);
        let refused = fewest_cameras(&sensor(), &coded(12), &requirements).unwrap_err().to_string();
        assert!(refused.contains("is found and its code read from"), "{refused}");
        assert!(refused.contains("hang 3.00 to 3.50 m above it"), "{refused}");
        let refused = smallest_diameter_m(&sensor(), &coded(8), 1e4, 0.0, None).unwrap_err();
        assert!(refused.to_string().contains("found and its code read at 10000 m"), "{refused}");
    }

    #[test]
    fn the_searched_roundel_needs_the_fewest_cameras() {
        let (area, max_m) = (area(1.2, 0.9, 0.0), Some(1.5e-3));
        let requirements = Requirements { area, mount_m: [2.0, 3.5], views: 1, share: 0.95, max_m };
        let grid = fewest_cameras_of_any_size(&sensor(), &kind(), &requirements).unwrap();
        let with = |outer_m| fewest_cameras(&sensor(), &scaled(&kind(), outer_m), &requirements);
        // It meets the requirements with the same number of cameras.
        let own = with(grid.outer_m).unwrap();
        assert_eq!(own.stations.len(), grid.stations.len(), "{}", grid.outer_m);
        // No larger roundel needs fewer cameras.
        for larger in [1.5, 2.5, 4.0] {
            let found = with(larger * grid.outer_m);
            assert!(found.map_or(usize::MAX, |it| it.stations.len()) >= grid.stations.len());
        }
    }

    #[test]
    fn barrel_distortion_reduces_the_range_in_corners() {
        let mut bent = sensor();
        let lens = Lens::PlumbBob([-0.2, 0.02, 0.0, 0.0, 0.0]);
        let intrinsics = Intrinsics { lens, ..bent.camera.intrinsics().clone() };
        bent.camera = Camera::new(intrinsics).unwrap();
        let found = detection_range(&bent, &kind(), 0.0).unwrap();
        assert!(found.max_corner_m < 0.95 * found.max_m, "{found:?}");
    }

    #[test]
    fn errors_name_the_wrong_value() {
        let refused = |change: &dyn Fn(&mut Sensor), kind: &Kind, tilt_rad: f64| {
            let mut sensor = sensor();
            change(&mut sensor);
            detection_range(&sensor, kind, tilt_rad).unwrap_err().to_string()
        };
        let as_is = |_: &mut Sensor| {};
        assert!(
            refused(&|s| s.imaging.noise = -1.0, &kind(), 0.0).starts_with("noise: expected 0")
        );
        assert!(refused(&|s| s.imaging.blur_px = f64::NAN, &kind(), 0.0).starts_with("blur: "));
        assert!(refused(&|s| s.imaging.white = 50.0, &kind(), 0.0).starts_with("white less black"));
        assert!(refused(&as_is, &Kind::plain("dot", 0.16, 0.0), 0.0).contains("inner diameter"));
        assert!(refused(&as_is, &kind(), 1.5).starts_with("tilt: expected 0 to 75 degrees"));
        let tiny = |sensor: &mut Sensor| {
            let intrinsics =
                Intrinsics { width: 8, height: 8, ..sensor.camera.intrinsics().clone() };
            sensor.camera = Camera::new(intrinsics).unwrap();
        };
        assert!(refused(&tiny, &kind(), 0.0).contains("is found at no distance"));
    }

    #[test]
    fn the_smallest_roundel_is_just_sufficient() {
        let at = (8.0, 0.3);
        let outer_m = smallest_diameter_m(&sensor(), &kind(), at.0, at.1, Some(2e-3)).unwrap();
        let error_m = |outer_m: f64| {
            let pose = range::pose_in_front(NormalizedPoint::default(), at.0, at.1);
            let kind = scaled(&kind(), outer_m);
            precision::predict(&sensor(), &kind, &pose).map(|it| it.position_m())
        };
        assert!(error_m(outer_m).unwrap() <= 2e-3);
        assert!(error_m(0.98 * outer_m).is_none_or(|error_m| error_m > 2e-3));
        let refused = smallest_diameter_m(&sensor(), &kind(), at.0, at.1, Some(1e-6)).unwrap_err();
        assert!(refused.to_string().contains("the best of this camera is"), "{refused}");
    }

    /// Cameras along x, 3 m up and looking straight down.
    fn row(places_m: &[f64]) -> Vec<PlacedCamera> {
        let station = |&x_m| PlacedCamera::downward(sensor(), Vector3::new(x_m, 0.0, 3.0), false);
        places_m.iter().map(station).collect()
    }

    /// An area of twice these sides around the origin.
    fn area(x_m: f64, y_m: f64, height_m: f64) -> MapArea {
        MapArea { min_m: [-x_m, -y_m], max_m: [x_m, y_m], height_m, step_m: 0.1 }
    }

    #[test]
    fn two_cameras_are_more_precise_than_one() {
        let area = area(0.5, 0.4, 0.2);
        let one = map(&row(&[0.2]), &kind(), area).unwrap();
        let two = map(&row(&[0.2, -0.2]), &kind(), area).unwrap();
        assert_eq!((one.columns, one.rows, one.spots.len()), (11, 9, 99));
        for (one, two) in one.spots.iter().zip(&two.spots) {
            assert_eq!((one.cameras, two.cameras), (1, 2));
            let ratio = two.deviation.unwrap().total_m / one.deviation.unwrap().total_m;
            assert!((0.1..0.9).contains(&ratio), "{ratio}");
        }
        // The depth, vertical here, is the least precise.
        let deviation = one.spots[49].deviation.unwrap();
        assert!(deviation.upright_m > 2.0 * deviation.level_m, "{deviation:?}");
        let far = MapArea { min_m: [5.0, 5.0], max_m: [6.0, 6.0], ..area };
        let unseen = map(&row(&[0.0]), &kind(), far).unwrap();
        assert!(unseen.summary().seen_share == 0.0 && unseen.summary().median_m.is_none());
        // The share of each camera is the one it has alone.
        let wide = MapArea { min_m: [-3.0, -1.0], max_m: [2.0, 1.0], ..area };
        let places_m = [1.5, -1.0];
        let both = map(&row(&places_m), &kind(), wide).unwrap();
        let alone = places_m.map(|x| map(&row(&[x]), &kind(), wide).unwrap().summary().seen_share);
        assert_eq!(both.seen_shares, alone);
        assert!(0.0 < alone[0] && alone[0] < alone[1] && alone[1] < 1.0, "{alone:?}");
        let [_, max_m] = MapArea::seen_corners_m(&row(&[0.0]), 0.2).unwrap();
        assert!((max_m[0] - 2.8 * 320.0 / 700.0).abs() < 0.01, "{max_m:?}");
    }

    #[test]
    fn uncertain_lenses_are_independent() {
        let area = area(0.5, 0.4, 0.2);
        // Both focal lengths are off by the same half percent.
        let mut covariance = DMatrix::zeros(4, 4);
        covariance.view_mut((0, 0), (2, 2)).fill(3.5f64.powi(2));
        let lens_uncertainty = Some(LensUncertainty { free: Vec::new(), covariance });
        let upright_m = |stations: &[PlacedCamera]| {
            map(stations, &kind(), area).unwrap().spots[49].deviation.unwrap().upright_m
        };
        let exact = row(&[0.0]).remove(0);
        let sensor = Sensor { lens_uncertainty, ..sensor() };
        let doubtful = PlacedCamera { sensor, ..exact.clone() };
        let [exact_m, doubtful_m] = [exact, doubtful.clone()].map(|one| upright_m(&[one]));
        let by_lens_m = (doubtful_m.powi(2) - exact_m.powi(2)).sqrt();
        assert!((by_lens_m / (0.005 * 2.8) - 1.0).abs() < 0.1, "{exact_m} {doubtful_m}");
        // Errors of the two lenses are independent.
        let both_m = upright_m(&[doubtful.clone(), doubtful]);
        assert!((both_m / doubtful_m - 0.5f64.sqrt()).abs() < 1e-6, "{both_m} {doubtful_m}");
    }

    #[test]
    fn the_fewest_cameras_cover_the_arena() {
        let area = area(2.0, 0.85, 0.0);
        let requirements =
            Requirements { area, mount_m: [3.0, 3.0], views: 1, share: 0.98, max_m: None };
        let fewest = |changed: &Requirements| fewest_cameras(&sensor(), &kind(), changed);
        let grid = fewest(&requirements).unwrap();
        // A picture covers 2.74 x 2.06 m of the floor.
        assert_eq!(grid.layout.counts, [2, 1], "{:?}", grid.map.summary());
        assert!(grid.map.summary().seen_share >= 0.98);
        let twice = fewest(&Requirements { views: 2, ..requirements }).unwrap();
        assert!(twice.stations.len() > 2 && twice.map.summary().twice_share >= 0.98);
        let refused =
            fewest_cameras(&sensor(), &scaled(&kind(), 0.008), &requirements).unwrap_err();
        assert!(refused.to_string().contains("hang 3.00 to 3.00 m above it"), "{refused}");
        let low = fewest(&Requirements { mount_m: [-1.0, 2.0], ..requirements }).unwrap_err();
        assert!(low.to_string().starts_with("mount: expected metres, 0.05"), "{low}");
        // The lowest mount is too near, a higher one suffices.
        let wide = Requirements { mount_m: [0.1, 3.0], share: 0.6, ..requirements };
        assert!(fewest(&wide).unwrap().layout.mount_m > 1.0);
        // An arena too large for the maximum number of cameras.
        let area = MapArea { min_m: [-400.0; 2], max_m: [400.0; 2], ..area };
        let refused = fewest(&Requirements { area, ..requirements }).unwrap_err().to_string();
        assert!(refused.contains("64 times the 6 m² that one sees from 3 m"), "{refused}");
    }
}
