//! A map as numbers.

use roundel_core::plan::map::{Deviation, Map, Summary};
use serde::Serialize;
use utoipa::ToSchema;

use super::planned_camera::PlannedCamera;

/// Predicted precision and coverage of roundels that lie face up, on a grid of spots over an arena.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct PlanMap {
    /// Kind of roundel.
    pub roundel: String,
    /// Height of the roundels, metres.
    pub height_m: f64,
    /// Position of the first spot: smallest x and y, metres.
    pub min_m: [f64; 2],
    /// Position of the last spot: largest x and y, metres.
    pub max_m: [f64; 2],
    /// Spots along x.
    pub columns: usize,
    /// Spots along y.
    pub rows: usize,
    /// For each spot, the number of cameras that detect a roundel there and, if it is coded, read its code. Rows by increasing
    /// y, spots of a row by increasing x.
    pub cameras: Vec<usize>,
    /// Rms position error after one frame of each camera, metres; null where no camera sees the spot.
    pub deviation_m: Vec<Option<f64>>,
    /// Horizontal part of the deviation, metres.
    pub level_m: Vec<Option<f64>>,
    /// Vertical part of the deviation, metres.
    pub upright_m: Vec<Option<f64>>,
    /// Statistics over all spots.
    pub summary: PlanSummary,
    /// All cameras, including those that are left out.
    pub stations: Vec<PlanStation>,
}

/// Statistics over all spots of a map.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct PlanSummary {
    /// Share of spots where at least one camera detects a roundel and, if it is coded, reads its code.
    pub seen_share: f64,
    /// Share of spots where at least two cameras do.
    pub twice_share: f64,
    /// Median of the deviations, metres; null if nothing is seen.
    pub median_m: Option<f64>,
    /// 95th percentile of the deviations, metres.
    pub p95_m: Option<f64>,
}

/// A camera of a map.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct PlanStation {
    pub name: String,
    /// Position, metres; null if the camera is left out.
    pub position_m: Option<[f64; 3]>,
    /// Share of spots where this camera detects a roundel and, if it is coded, reads its code; null if it is left out.
    pub seen_share: Option<f64>,
    /// Why the camera is left out; empty if it is not.
    pub reason: String,
}

impl PlanMap {
    /// `map` must have been computed from the usable ones of `cameras`.
    pub fn of(map: &Map, roundel: &str, cameras: &[PlannedCamera]) -> Self {
        let each = |value: fn(&Deviation) -> f64| {
            map.spots.iter().map(|spot| spot.deviation.as_ref().map(value)).collect()
        };
        let Summary { seen_share, twice_share, median_m, p95_m } = map.summary();
        let mut seen_shares = map.seen_shares.iter().copied();
        let stations = cameras.iter().map(|camera| {
            let name = camera.name.clone();
            match &camera.station {
                Ok(station) => PlanStation {
                    name,
                    position_m: Some(station.place.world_from_camera.translation.vector.into()),
                    seen_share: seen_shares.next(),
                    reason: String::new(),
                },
                Err(reason) => {
                    PlanStation { name, position_m: None, seen_share: None, reason: reason.clone() }
                }
            }
        });
        Self {
            roundel: roundel.to_owned(),
            height_m: map.area.height_m,
            min_m: map.area.min_m,
            max_m: map.area.max_m,
            columns: map.columns,
            rows: map.rows,
            cameras: map.spots.iter().map(|spot| spot.cameras).collect(),
            deviation_m: each(|deviation| deviation.total_m),
            level_m: each(|deviation| deviation.level_m),
            upright_m: each(|deviation| deviation.upright_m),
            summary: PlanSummary { seen_share, twice_share, median_m, p95_m },
            stations: stations.collect(),
        }
    }
}

/// The quantity that the colours of a drawing show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum MapLayer {
    /// Rms error of a roundel's position
    #[default]
    Precision,
    /// Number of cameras that see a roundel
    Cameras,
}
