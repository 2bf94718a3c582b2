//! What several cameras would make of roundels all over an arena.
//!
//! At each spot of a level grid a roundel lies face up. Each camera that would find it and, if it is coded, read its
//! code gives a detection with its expected covariance ([`super::precision`], what its lens leaves open included),
//! carried into the world as fusion does it ([`roundel_fusion::world::seen_in_world`]: the camera's own place and the floor of
//! what is believed included). Of detections at one instant fusion's update leaves (Σ Cᵢ⁻¹)⁻¹; so much is known of one
//! set of frames, before time averages anything. Lenses of several cameras are off each by itself, so that more cameras
//! help; all roundels that one camera sees its lens moves alike, so that distances between neighbours are known better
//! than each place. A camera that finds a coded ring and does not read it is left out, though fusion takes what it sees
//! of one that another camera has read.

use std::sync::atomic::{AtomicUsize, Ordering};

use nalgebra::{Matrix3, Translation3, UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::{
    PlanError, Sensor,
    precision::{LensDoubt, expect},
    within,
};
use roundel_fusion::world::{CameraPlacement, FusionParams, seen_in_world};
use roundel_vision::{
    camera::PixelPoint,
    marker::{Kind, Mask},
    rigid::Rigid,
};

/// Most spots of a map.
pub const MOST_SPOTS: usize = 1_000_000;
/// Rays along each side of a picture that say where it looks.
const RAYS: usize = 8;
/// What is looked at goes no farther than this from a camera, metres.
const FARTHEST_M: f64 = 60.0;

/// A camera that stands.
#[derive(Clone, Debug)]
pub struct Station {
    /// The camera.
    pub sensor: Sensor,
    /// How well its lens is known; `None`: exactly.
    pub doubt: Option<LensDoubt>,
    /// Where it stands, and how well that is known.
    pub place: CameraPlacement,
    /// Where it does not look.
    pub mask: Mask,
}

/// The spots that are looked at: a level grid, from edge to edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Field {
    /// Least x and y, metres.
    pub low_m: [f64; 2],
    /// Greatest x and y, metres.
    pub high_m: [f64; 2],
    /// Height of the roundels, metres.
    pub height_m: f64,
    /// Distance of spots along x and y, metres.
    pub step_m: f64,
}

/// What is known of a roundel at one spot.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spot {
    /// Cameras that would find it and, if it is coded, read its code.
    pub cameras: usize,
    /// How exactly it would be known, if any would.
    pub deviation: Option<Deviation>,
}

/// How exactly a place is known from one set of frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deviation {
    /// Root mean square of the distance from the truth, metres.
    pub total_m: f64,
    /// The part of it that is level, metres.
    pub level_m: f64,
    /// The part of it that is upright, metres.
    pub upright_m: f64,
}

/// A map.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// Where the spots lie.
    pub field: Field,
    /// Spots along x.
    pub columns: usize,
    /// Spots along y.
    pub rows: usize,
    /// Row by row from the least y on, each from the least x on.
    pub spots: Vec<Spot>,
    /// Share of the spots that each camera sees, and reads the code at, whatever the others do; in their order.
    pub seen_shares: Vec<f64>,
}

/// A map in a few numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// Share of spots that one camera sees at least.
    pub seen_share: f64,
    /// Share of spots that two see at least.
    pub twice_share: f64,
    /// Median of the spots' deviations that are seen, metres; NaN if none is.
    pub median_m: f64,
    /// 95 % of them are smaller, metres.
    pub p95_m: f64,
}

impl Field {
    /// Heights that roundels may have, metres.
    pub const HEIGHTS_M: [f64; 2] = [-1e3, 1e3];

    /// What the cameras look at in the plane of this height, with about `spots` spots; `None` if none looks there.
    pub fn seen_by(stations: &[Station], height_m: f64, spots: usize) -> Option<Self> {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for station in stations {
            for point in station.looks_at(height_m) {
                for axis in 0..2 {
                    low[axis] = low[axis].min(point[axis]);
                    high[axis] = high[axis].max(point[axis]);
                }
            }
        }
        let sides = [high[0] - low[0], high[1] - low[1]];
        if !sides.iter().all(|side| side.is_finite() && *side > 0.0) {
            return None;
        }
        let step_m = (sides[0] * sides[1] / spots.max(4) as f64).sqrt();
        Some(Self { low_m: low, high_m: high, height_m, step_m })
    }

    /// Spots along x and y.
    pub fn counts(&self) -> Result<[usize; 2], PlanError> {
        let sides = [0, 1].map(|axis| self.high_m[axis] - self.low_m[axis]);
        for (field, side) in ["arena along x", "arena along y"].into_iter().zip(sides) {
            within(field, side, [1e-3, 1e4], "a side of 0.001 to 10000 m")?;
        }
        within("height", self.height_m, Self::HEIGHTS_M, "-1000 to 1000 m")?;
        within("step", self.step_m, [1e-6, 1e4], "0.000001 to 10000 m")?;
        let counts = sides.map(|side| (side / self.step_m).round().max(1.0) + 1.0);
        let all = counts[0] * counts[1];
        within(
            "spots of the map",
            all,
            [1.0, MOST_SPOTS as f64],
            "at most 1000000: a longer step",
        )?;
        Ok(counts.map(|count| count as usize))
    }
}

impl Station {
    /// Where the edges of its picture lie in a plane of this height, as far as it looks down on it.
    fn looks_at(&self, height_m: f64) -> Vec<[f64; 2]> {
        let camera = &self.sensor.camera;
        let ends = [camera.width(), camera.height()].map(|side| side as f64 - 1.0);
        let eye = self.place.world_from_camera.translation.vector;
        let mut points = Vec::new();
        for step in 0..=RAYS {
            let share = step as f64 / RAYS as f64;
            let (u, v) = (share * ends[0], share * ends[1]);
            for (u, v) in [(u, 0.0), (u, ends[1]), (0.0, v), (ends[0], v)] {
                let Ok(ray) = camera.bearing(PixelPoint { u, v }) else { continue };
                let ray = self.place.world_from_camera.rotation * ray;
                let reach_m = (height_m - eye.z) / ray.z;
                if ray.z < 0.0 && (0.0..=FARTHEST_M).contains(&reach_m) {
                    let point = eye + ray * reach_m;
                    points.push([point.x, point.y]);
                }
            }
        }
        points
    }

    /// The information that this camera has of a roundel's place in the world; `None` if it would not find it, or not
    /// read its code.
    fn information(
        &self,
        kind: &Kind,
        world_from_roundel: &Rigid,
        params: &FusionParams,
    ) -> Option<Matrix3<f64>> {
        let camera_from_roundel = self.place.world_from_camera.inv_mul(world_from_roundel);
        let expected = expect(&self.sensor, self.doubt.as_ref(), kind, &camera_from_roundel)?;
        if !expected.is_read || self.mask.covers(expected.sighting.ring.outer.center) {
            return None;
        }
        let (_, covariance) = seen_in_world(&expected.detection(), &self.place, params)?;
        covariance.try_inverse()
    }
}

/// What is known of a roundel that lies face up at a place of the world; the cameras that see it are counted in `seen`.
fn spot(
    stations: &[Station],
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

/// The map of a kind of roundel.
pub fn map(stations: &[Station], kind: &Kind, field: Field) -> Result<Map, PlanError> {
    let map = map_while(stations, kind, field, || true)?;
    Ok(map.expect("it goes on to the last spot"))
}

/// Like [`map`]; returns `None` as soon as `goes_on`, which is asked before each spot, returns false.
pub fn map_while(
    stations: &[Station],
    kind: &Kind,
    field: Field,
    goes_on: impl Fn() -> bool + Sync,
) -> Result<Option<Map>, PlanError> {
    for station in stations {
        station.sensor.check(kind)?;
    }
    let [columns, rows] = field.counts()?;
    let params = FusionParams::default();
    let at = |index: usize, count: usize, axis: usize| {
        let share = index as f64 / (count - 1) as f64;
        field.low_m[axis] + share * (field.high_m[axis] - field.low_m[axis])
    };
    let seen: Vec<AtomicUsize> = stations.iter().map(|_| AtomicUsize::new(0)).collect();
    let spots = (0..columns * rows)
        .into_par_iter()
        .map(|index| {
            let (x, y) = (at(index % columns, columns, 0), at(index / columns, rows, 1));
            let place_m = Vector3::new(x, y, field.height_m);
            goes_on().then(|| spot(stations, kind, place_m, &params, &seen))
        })
        .collect::<Option<_>>();
    let Some(spots) = spots else { return Ok(None) };
    let all = (columns * rows) as f64;
    let seen_shares = seen.into_iter().map(|count| count.into_inner() as f64 / all).collect();
    Ok(Some(Map { field, columns, rows, spots, seen_shares }))
}

impl Map {
    /// In a few numbers.
    pub fn summary(&self) -> Summary {
        let share = |least: usize| {
            let count = self.spots.iter().filter(|spot| spot.cameras >= least).count();
            count as f64 / self.spots.len() as f64
        };
        let mut deviations: Vec<f64> =
            self.spots.iter().filter_map(|spot| Some(spot.deviation?.total_m)).collect();
        deviations.sort_by(f64::total_cmp);
        let quantile = |share: f64| {
            let last = deviations.len().saturating_sub(1) as f64;
            deviations.get((share * last).round() as usize).copied().unwrap_or(f64::NAN)
        };
        Summary {
            seen_share: share(1),
            twice_share: share(2),
            median_m: quantile(0.5),
            p95_m: quantile(0.95),
        }
    }
}
