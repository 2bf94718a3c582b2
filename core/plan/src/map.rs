//! Coverage and precision over an arena with several cameras.
//!
//! At each spot of a horizontal grid a roundel lies face up. Each camera that detects it and reads its code contributes a
//! detection with the predicted covariance ([`super::precision`], including the lens), carried into the world as in fusion
//! ([`roundel_fusion::world::seen_in_world`], including the camera's pose and the minimum covariance). The combined
//! covariance (Σ Cᵢ⁻¹)⁻¹ is that of one set of frames without filtering over time. Lens errors of different cameras are
//! independent; those of one camera shift all its roundels alike, so distances of neighbours are more precise than
//! positions. A camera that does not read the code is left out, although fusion may use its detection of a roundel that
//! another camera has identified.

use std::{
    f64::consts::{FRAC_PI_2, PI},
    sync::atomic::{AtomicUsize, Ordering},
};

use nalgebra::{Matrix3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::{PlanError, Sensor, precision::predict, within};
use roundel_fusion::world::{CameraPlacement, FusionParams, seen_in_world};
use roundel_vision::{
    camera::PixelPoint,
    marker::{Kind, Mask},
    rigid::{Covariance6, Rigid},
};

/// Maximum number of spots.
pub const MAX_SPOTS: usize = 1_000_000;
/// Rays per side of a picture for its footprint.
const RAYS_PER_SIDE: usize = 8;
/// Maximum distance of a footprint from its camera, metres.
const MAX_DISTANCE_M: f64 = 60.0;

/// A camera with its pose.
#[derive(Clone, Debug)]
pub struct PlacedCamera {
    /// The camera.
    pub sensor: Sensor,
    /// Its pose with covariance.
    pub place: CameraPlacement,
    /// Parts of the picture that are ignored.
    pub mask: Mask,
}

/// Horizontal grid of spots, from edge to edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapArea {
    /// Minimum x and y, metres.
    pub min_m: [f64; 2],
    /// Maximum x and y, metres.
    pub max_m: [f64; 2],
    /// Height of the roundels, metres.
    pub height_m: f64,
    /// Distance of spots along x and y, metres.
    pub step_m: f64,
}

/// Prediction for one spot.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spot {
    /// Number of cameras that detect the roundel and read its code.
    pub cameras: usize,
    /// Precision, if any camera does.
    pub deviation: Option<Deviation>,
}

/// Precision of a position from one set of frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deviation {
    /// Rms error, metres.
    pub total_m: f64,
    /// Horizontal part, metres.
    pub level_m: f64,
    /// Vertical part, metres.
    pub upright_m: f64,
}

/// Predictions for all spots.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// The grid.
    pub area: MapArea,
    /// Spots along x.
    pub columns: usize,
    /// Spots along y.
    pub rows: usize,
    /// Rows by increasing y, spots of a row by increasing x.
    pub spots: Vec<Spot>,
    /// Share of the spots that each camera covers.
    pub seen_shares: Vec<f64>,
}

/// Statistics of a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// Share of spots covered by at least one camera.
    pub seen_share: f64,
    /// Share of spots covered by at least two cameras.
    pub twice_share: f64,
    /// Median deviation of covered spots, metres; `None` without any.
    pub median_m: Option<f64>,
    /// 95th percentile, metres.
    pub p95_m: Option<f64>,
}

impl MapArea {
    /// Valid heights of roundels, metres.
    pub const HEIGHTS_M: [f64; 2] = [-1e3, 1e3];

    /// An area between two corners with about this number of spots.
    pub fn with_spots([min_m, max_m]: [[f64; 2]; 2], height_m: f64, spots: usize) -> Self {
        let area = Self { min_m, max_m, height_m, step_m: 0.0 };
        Self { step_m: (area.area_m2() / spots as f64).sqrt(), ..area }
    }

    /// Corners of the bounding box of all footprints at this height; `None` if no camera looks there.
    pub fn seen_corners_m(stations: &[PlacedCamera], height_m: f64) -> Option<[[f64; 2]; 2]> {
        let points: Vec<[f64; 2]> =
            stations.iter().flat_map(|station| station.footprint(height_m)).collect();
        let corner = |start: f64, pick: fn(f64, f64) -> f64| {
            [0, 1].map(|axis| points.iter().map(|point| point[axis]).fold(start, pick))
        };
        let (low, high) = (corner(f64::INFINITY, f64::min), corner(f64::NEG_INFINITY, f64::max));
        (low[0] < high[0] && low[1] < high[1]).then_some([low, high])
    }

    /// Lengths along x and y, metres.
    pub(super) fn sides_m(&self) -> [f64; 2] {
        [0, 1].map(|axis| self.max_m[axis] - self.min_m[axis])
    }

    pub(super) fn area_m2(&self) -> f64 {
        let [along_x, along_y] = self.sides_m();
        along_x * along_y
    }

    /// Spots along x and y.
    pub fn counts(&self) -> Result<[usize; 2], PlanError> {
        let sides = self.sides_m();
        for (name, side) in ["arena along x", "arena along y"].into_iter().zip(sides) {
            within(name, side, [1e-3, 1e4], "a side of 0.001 to 10000 m")?;
        }
        within("height", self.height_m, Self::HEIGHTS_M, "-1000 to 1000 m")?;
        within("step", self.step_m, [1e-6, 1e4], "0.000001 to 10000 m")?;
        let counts = sides.map(|side| (side / self.step_m).round().max(1.0) + 1.0);
        let all = counts[0] * counts[1];
        within("spots of the map", all, [1.0, MAX_SPOTS as f64], "at most 1000000: a longer step")?;
        Ok(counts.map(|count| count as usize))
    }
}

impl PlacedCamera {
    /// A camera that looks straight down. The top of its image is towards +y, or towards -x if it is turned.
    pub(super) fn downward(sensor: Sensor, position_m: Vector3<f64>, is_turned: bool) -> Self {
        let yaw_rad = if is_turned { FRAC_PI_2 } else { 0.0 };
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad)
            * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
        let world_from_camera = Rigid::from_parts(Translation3::from(position_m), rotation);
        let place = CameraPlacement { world_from_camera, covariance: Covariance6::zeros() };
        Self { sensor, place, mask: Mask::default() }
    }

    /// Points of the picture's border in a plane of this height below the camera.
    fn footprint(&self, height_m: f64) -> Vec<[f64; 2]> {
        let camera = &self.sensor.camera;
        let ends = [camera.width(), camera.height()].map(|side| side as f64 - 1.0);
        let eye = self.place.world_from_camera.translation.vector;
        let mut points = Vec::new();
        for step in 0..=RAYS_PER_SIDE {
            let share = step as f64 / RAYS_PER_SIDE as f64;
            let (u, v) = (share * ends[0], share * ends[1]);
            for (u, v) in [(u, 0.0), (u, ends[1]), (0.0, v), (ends[0], v)] {
                let Ok(ray) = camera.bearing(PixelPoint { u, v }) else { continue };
                let ray = self.place.world_from_camera.rotation * ray;
                let reach_m = (height_m - eye.z) / ray.z;
                if ray.z < 0.0 && (0.0..=MAX_DISTANCE_M).contains(&reach_m) {
                    let point = eye + ray * reach_m;
                    points.push([point.x, point.y]);
                }
            }
        }
        points
    }

    /// Information about a roundel's position in the world; `None` if it is not detected or its code not read.
    fn information(
        &self,
        kind: &Kind,
        world_from_roundel: &Rigid,
        params: &FusionParams,
    ) -> Option<Matrix3<f64>> {
        let camera_from_roundel = self.place.world_from_camera.inv_mul(world_from_roundel);
        let expected = predict(&self.sensor, kind, &camera_from_roundel)?;
        if !expected.is_readable || self.mask.covers(expected.image.ring.outer.center) {
            return None;
        }
        let (_, covariance) = seen_in_world(&expected.detection(), &self.place, params)?;
        covariance.try_inverse()
    }
}

/// Prediction for a roundel that lies face up; counts the cameras that cover it in `seen`.
fn spot(
    stations: &[PlacedCamera],
    kind: &Kind,
    position_m: Vector3<f64>,
    params: &FusionParams,
    seen: &[AtomicUsize],
) -> Spot {
    let pose = Rigid::from_parts(Translation3::from(position_m), UnitQuaternion::identity());
    let mut sum = Matrix3::zeros();
    let mut cameras = 0;
    for (station, count) in stations.iter().zip(seen) {
        let Some(information) = station.information(kind, &pose, params) else { continue };
        sum += information;
        cameras += 1;
        count.fetch_add(1, Ordering::Relaxed);
    }
    let covariance = if cameras > 0 { sum.try_inverse() } else { None };
    let deviation = covariance.map(|covariance| {
        let level = covariance[(0, 0)] + covariance[(1, 1)];
        let upright = covariance[(2, 2)];
        let root = |variance: f64| variance.max(0.0).sqrt();
        Deviation { total_m: root(level + upright), level_m: root(level), upright_m: root(upright) }
    });
    Spot { cameras, deviation }
}

/// Computes the map of a kind of roundel.
pub fn map(stations: &[PlacedCamera], kind: &Kind, area: MapArea) -> Result<Map, PlanError> {
    let map = map_while(stations, kind, area, || true)?;
    Ok(map.expect("it goes on to the last spot"))
}

/// Like [`map`]. Calls `keep_going` before each spot, and returns `None` once it returns false.
pub fn map_while(
    stations: &[PlacedCamera],
    kind: &Kind,
    area: MapArea,
    keep_going: impl Fn() -> bool + Sync,
) -> Result<Option<Map>, PlanError> {
    for station in stations {
        station.sensor.check(kind)?;
    }
    let [columns, rows] = area.counts()?;
    let params = FusionParams::default();
    let at = |index: usize, count: usize, axis: usize| {
        let share = index as f64 / (count - 1) as f64;
        area.min_m[axis] + share * (area.max_m[axis] - area.min_m[axis])
    };
    let seen: Vec<AtomicUsize> = stations.iter().map(|_| AtomicUsize::new(0)).collect();
    let spots = (0..columns * rows)
        .into_par_iter()
        .map(|index| {
            let (x, y) = (at(index % columns, columns, 0), at(index / columns, rows, 1));
            let place_m = Vector3::new(x, y, area.height_m);
            keep_going().then(|| spot(stations, kind, place_m, &params, &seen))
        })
        .collect::<Option<_>>();
    let Some(spots) = spots else { return Ok(None) };
    let all = (columns * rows) as f64;
    let seen_shares = seen.into_iter().map(|count| count.into_inner() as f64 / all).collect();
    Ok(Some(Map { area, columns, rows, spots, seen_shares }))
}

impl Map {
    /// Statistics over all spots.
    pub fn summary(&self) -> Summary {
        let share = |min: usize| {
            let count = self.spots.iter().filter(|spot| spot.cameras >= min).count();
            count as f64 / self.spots.len() as f64
        };
        let mut deviations: Vec<f64> =
            self.spots.iter().filter_map(|spot| Some(spot.deviation?.total_m)).collect();
        deviations.sort_by(f64::total_cmp);
        let quantile = |share: f64| {
            let last = deviations.len().saturating_sub(1) as f64;
            deviations.get((share * last).round() as usize).copied()
        };
        Summary {
            seen_share: share(1),
            twice_share: share(2),
            median_m: quantile(0.5),
            p95_m: quantile(0.95),
        }
    }
}
