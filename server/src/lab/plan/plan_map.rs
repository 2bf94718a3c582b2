//! A map as numbers.

use roundel_core::plan::map::{Map, Spot, Station};
use serde::Serialize;
use utoipa::ToSchema;

use super::planned_camera::PlannedCamera;

/// What cameras would make of roundels that lie face up, all over an arena.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct PlanMap {
    /// The kind of roundel.
    pub roundel: String,
    /// Height of the roundels, metres.
    pub height_m: f64,
    /// Place of the first spot: least x and y, metres.
    pub min_m: [f64; 2],
    /// Place of the last spot: greatest x and y, metres.
    pub max_m: [f64; 2],
    /// Spots along x.
    pub columns: usize,
    /// Spots along y.
    pub rows: usize,
    /// Cameras that would find one and, if it is coded, read its code, by spot: row by row from the least y on, each
    /// from the least x on.
    pub cameras: Vec<usize>,
    /// Root mean square of the distance from the truth, of one set of frames, metres; null where no camera sees it.
    pub deviation_m: Vec<Option<f64>>,
    /// The level part of it, metres.
    pub level_m: Vec<Option<f64>>,
    /// The upright part of it, metres.
    pub upright_m: Vec<Option<f64>>,
    /// The same in a few numbers.
    pub summary: PlanSummary,
    /// The cameras.
    pub stations: Vec<PlanStation>,
}

/// A map in a few numbers.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct PlanSummary {
    /// Share of spots that a camera sees; of a coded roundel, where it reads the code.
    pub seen_share: f64,
    /// Share of spots that two see at least, in the same sense.
    pub twice_share: f64,
    /// Median of the deviations, metres; null if nothing is seen.
    pub median_m: Option<f64>,
    /// 95 % of the deviations are smaller, metres.
    pub p95_m: Option<f64>,
}

/// A camera of a map.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct PlanStation {
    /// Its name.
    pub name: String,
    /// Where it stands, metres; null if it is left out.
    pub position_m: Option<[f64; 3]>,
    /// Share of spots that it sees, and reads the code at, whatever the others do; null if it is left out.
    pub seen_share: Option<f64>,
    /// Why it is left out; empty if it is not.
    pub reason: String,
}

/// The cameras that are planned with.
pub fn usable_stations(cameras: &[PlannedCamera]) -> Vec<Station> {
    cameras.iter().filter_map(|camera| camera.station.as_deref().ok().cloned()).collect()
}

impl PlanMap {
    /// Of a map of those of these cameras that are not left out.
    pub fn of(map: &Map, roundel: &str, cameras: &[PlannedCamera]) -> Self {
        let each = |value: fn(&roundel_core::plan::map::Deviation) -> f64| {
            map.spots.iter().map(|spot: &Spot| spot.deviation.as_ref().map(value)).collect()
        };
        let summary = map.summary();
        let finite = |value: f64| Some(value).filter(|value| value.is_finite());
        let mut seen_shares = map.seen_shares.iter().copied();
        Self {
            roundel: roundel.to_owned(),
            height_m: map.field.height_m,
            min_m: map.field.low_m,
            max_m: map.field.high_m,
            columns: map.columns,
            rows: map.rows,
            cameras: map.spots.iter().map(|spot| spot.cameras).collect(),
            deviation_m: each(|deviation| deviation.total_m),
            level_m: each(|deviation| deviation.level_m),
            upright_m: each(|deviation| deviation.upright_m),
            summary: PlanSummary {
                seen_share: summary.seen_share,
                twice_share: summary.twice_share,
                median_m: finite(summary.median_m),
                p95_m: finite(summary.p95_m),
            },
            stations: cameras.iter().map(|one| PlanStation::of(one, &mut seen_shares)).collect(),
        }
    }
}

impl PlanStation {
    /// `seen_shares`: of those that are not left out, from this one on.
    fn of(camera: &PlannedCamera, seen_shares: &mut impl Iterator<Item = f64>) -> Self {
        let name = camera.name.clone();
        match &camera.station {
            Ok(station) => {
                let position_m = Some(station.place.world_from_camera.translation.vector.into());
                Self { name, position_m, seen_share: seen_shares.next(), reason: String::new() }
            }
            Err(reason) => {
                Self { name, position_m: None, seen_share: None, reason: reason.clone() }
            }
        }
    }
}

/// What a drawing's colours show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum MapLayer {
    /// How exactly a roundel would be located
    #[default]
    Precision,
    /// How many cameras would see it
    Cameras,
}
