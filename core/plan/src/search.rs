//! Searches: the smallest roundel, and the fewest cameras, that meet the requirements.
//!
//! Both use the forward predictions. The diameter is found by bisection, the cameras by trying all grids of downward cameras
//! in increasing number at several heights. If both are unknown, the number of cameras has priority; then the smallest
//! roundel is found that a camera locates precisely enough straight below and that suffices over the grid. Combining several
//! cameras might allow a smaller one.

use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::{
    PlanError, Sensor,
    map::{Map, MapArea, PlacedCamera, Summary, map},
    precision::predict,
    range::{detection_range, pose_in_front},
    visibility::requirement,
    within,
};
use roundel_fusion::world::CameraPlacement;
use roundel_vision::{
    camera::NormalizedPoint,
    marker::{Kind, Mask, Pattern},
    rigid::{Covariance6, Rigid},
};

/// Searched outer diameters, metres.
const DIAMETERS_M: (f64, f64) = (0.002, 10.0);
/// Relative precision of a diameter.
const SHARE: f64 = 1e-3;
/// Maximum number of cameras.
pub const MAX_CAMERAS: usize = 64;
/// Number of mounting heights.
const HEIGHTS: usize = 10;
/// Spots of the map that judges a grid.
const GRID_SPOTS: f64 = 300.0;
/// Diameters tried for a grid, relative to the one that suffices straight below a camera. Larger ones are visible
/// farther out until they do not fit into the picture.
const DIAMETER_STEPS: [f64; 7] = [1.0, 1.3, 1.7, 2.2, 3.0, 4.5, 7.0];
/// Relative precision of a diameter for a grid.
const GRID_SHARE: f64 = 0.01;

/// The kind with another outer diameter and the same proportions.
pub fn scaled(kind: &Kind, outer_m: f64) -> Kind {
    let scale = outer_m / kind.outer_diameter_m;
    let pattern = match kind.pattern {
        Pattern::Elliptical { minor_diameter_m } => {
            Pattern::Elliptical { minor_diameter_m: minor_diameter_m * scale }
        }
        other => other,
    };
    let inner_diameter_m = kind.inner_diameter_m * scale;
    Kind { outer_diameter_m: outer_m, inner_diameter_m, pattern, ..kind.clone() }
}

/// Smallest outer diameter, metres, of roundels of these proportions that are detected at this distance and tilt on
/// the optical axis, with code read if coded, and located with an rms error of at most `max_m`.
pub fn smallest_diameter_m(
    sensor: &Sensor,
    kind: &Kind,
    distance_m: f64,
    tilt_rad: f64,
    max_m: Option<f64>,
) -> Result<f64, PlanError> {
    sensor.check(kind)?;
    within("distance", distance_m, [1e-3, 1e4], "0.001 to 10000 m")?;
    if let Some(max_m) = max_m {
        within("precision", max_m, [1e-7, 1e3], "0.0000001 to 1000 m")?;
    }
    let error_m = |outer_m: f64| {
        let pose = pose_in_front(NormalizedPoint::default(), distance_m, tilt_rad);
        let expected = predict(sensor, &scaled(kind, outer_m), &pose)?;
        expected.is_readable.then(|| expected.position_m())
    };
    let is_sufficient = |outer_m: f64| {
        error_m(outer_m).is_some_and(|error_m| max_m.is_none_or(|max_m| error_m <= max_m))
    };
    // The best precision is reached by the largest roundel that fits into the picture.
    let steps = (DIAMETERS_M.1 / DIAMETERS_M.0).ln() / 0.05;
    let diameters_m =
        || (0..=steps as usize).map(|step| DIAMETERS_M.0 * (0.05 * step as f64).exp());
    let Some(mut good) = diameters_m().find(|&outer_m| is_sufficient(outer_m)) else {
        let best = diameters_m().filter_map(|outer| Some((outer, error_m(outer)?)));
        return Err(PlanError::Unreachable(match best.min_by(|a, b| a.1.total_cmp(&b.1)) {
            Some((outer_m, error_m)) => format!(
                "no roundel is located to {:.3} mm at {distance_m} m: the best of this camera is {:.3} mm, with one \
                 of {:.0} mm; take more pixels, a longer focal length, or cameras nearer by",
                max_m.unwrap_or(f64::NAN) * 1e3,
                error_m * 1e3,
                outer_m * 1e3
            ),
            None => format!(
                "no roundel of {:.0} mm to {:.0} m is {} at {distance_m} m, tilted by {:.0}°",
                DIAMETERS_M.0 * 1e3,
                DIAMETERS_M.1,
                requirement(kind),
                tilt_rad.to_degrees()
            ),
        }));
    };
    let mut bad = good * (-0.05f64).exp();
    while (good / bad).ln() > SHARE {
        let middle = (good * bad).sqrt();
        if is_sufficient(middle) { good = middle } else { bad = middle }
    }
    Ok(good)
}

/// Requirements on a grid of cameras.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Requirements {
    /// Extent of the arena and height of the roundels.
    pub area: MapArea,
    /// Minimum and maximum mounting height, metres.
    pub mount_m: [f64; 2],
    /// Number of cameras that must see each spot.
    pub views: usize,
    /// Share of the spots that must meet the requirements.
    pub share: f64,
    /// Maximum rms error of a spot, metres, if required.
    pub max_m: Option<f64>,
}

/// Grid of cameras that look straight down.
#[derive(Clone, Debug)]
pub struct Grid {
    /// Cameras along x and y.
    pub counts: [usize; 2],
    /// Mounting height, metres.
    pub mount_m: f64,
    /// Whether the longer side of the pictures lies along y.
    pub is_turned: bool,
    /// The cameras.
    pub stations: Vec<PlacedCamera>,
    /// Coverage and precision.
    pub map: Map,
}

/// The fewest cameras that meet the requirements, and among equal numbers the most precise grid.
pub fn fewest_cameras(
    sensor: &Sensor,
    kind: &Kind,
    requirements: &Requirements,
) -> Result<Grid, PlanError> {
    sensor.check(kind)?;
    let area = requirements.check()?;
    let is_sufficient = |mount_m: f64| {
        let straight = pose_in_front(NormalizedPoint::default(), mount_m - area.height_m, 0.0);
        predict(sensor, kind, &straight).is_some_and(|expected| expected.is_readable)
    };
    if !heights(requirements.mount_m).any(is_sufficient) {
        let range = detection_range(sensor, kind, 0.0)?;
        let [nearest_m, farthest_m] = requirements.mount_m.map(|mount_m| mount_m - area.height_m);
        return Err(PlanError::Unreachable(format!(
            "a roundel of {:.0} mm is {} from {:.2} to {:.2} m before this camera, and cameras at {} to {} m hang \
             {nearest_m:.2} to {farthest_m:.2} m above it: take other heights, another size of roundels, or another \
             camera",
            kind.outer_diameter_m * 1e3,
            requirement(kind),
            range.min_m,
            range.max_m,
            requirements.mount_m[0],
            requirements.mount_m[1],
        )));
    }
    search_grids(sensor, requirements, |grid, found: Option<&Grid>, closest| {
        let (share, grid) = requirements.judged(grid, kind, area)?;
        closest.offer(share, &grid);
        let p95_m = |grid: &Grid| grid.map.summary().p95_m;
        let is_best = found.is_none_or(|found| p95_m(&grid) < p95_m(found));
        Ok((share >= requirements.share && is_best).then_some(grid))
    })
}

/// The fewest cameras that meet the requirements with roundels of any size, and the required diameter, metres.
pub fn fewest_cameras_of_any_size(
    sensor: &Sensor,
    kind: &Kind,
    requirements: &Requirements,
) -> Result<(f64, Grid), PlanError> {
    sensor.check(kind)?;
    let area = requirements.check()?;
    // Returns the reason if no roundel suffices.
    let lowest_m = requirements.mount_m[0] - area.height_m;
    smallest_diameter_m(sensor, kind, lowest_m, 0.0, requirements.max_m)?;
    search_grids(sensor, requirements, |grid, found: Option<&(f64, Grid)>, closest| {
        let straight_m = grid.mount_m - area.height_m;
        let min_m = smallest_diameter_m(sensor, kind, straight_m, 0.0, requirements.max_m);
        let Ok(min_m) = min_m else { return Ok(None) };
        let judged = |outer_m: f64| requirements.judged(grid.clone(), &scaled(kind, outer_m), area);
        let mut bad_m = min_m;
        for outer_m in DIAMETER_STEPS.map(|step| min_m * step) {
            if found.is_some_and(|(smallest_m, _)| *smallest_m <= outer_m) {
                break;
            }
            let (share, judged_grid) = judged(outer_m)?;
            closest.offer(share, &judged_grid);
            if share < requirements.share {
                bad_m = outer_m;
                continue;
            }
            let (mut good_m, mut good) = (outer_m, judged_grid);
            while (good_m / bad_m).ln() > GRID_SHARE {
                let middle_m = (good_m * bad_m).sqrt();
                let (share, judged_grid) = judged(middle_m)?;
                if share >= requirements.share {
                    (good_m, good) = (middle_m, judged_grid);
                } else {
                    bad_m = middle_m;
                }
            }
            return Ok(Some((good_m, good)));
        }
        Ok(None)
    })
}

/// The grid that comes closest to the requirements, with its share of sufficient spots.
#[derive(Default)]
struct Closest(Option<(f64, Grid)>);

impl Closest {
    fn offer(&mut self, share: f64, grid: &Grid) {
        if self.0.as_ref().is_none_or(|(max, _)| share > *max) {
            self.0 = Some((share, grid.clone()));
        }
    }
}

/// The best solution with the fewest cameras. `improve` returns a solution for a grid if it is better than the one found
/// so far with as many cameras.
fn search_grids<T>(
    sensor: &Sensor,
    requirements: &Requirements,
    mut improve: impl FnMut(Grid, Option<&T>, &mut Closest) -> Result<Option<T>, PlanError>,
) -> Result<T, PlanError> {
    let mut closest = Closest::default();
    for count in 1..=MAX_CAMERAS {
        let mut found = None;
        for grid in candidate_grids(count, requirements, sensor) {
            if let Some(better) = improve(grid, found.as_ref(), &mut closest)? {
                found = Some(better);
            }
        }
        if let Some(found) = found {
            return Ok(found);
        }
    }
    Err(requirements.unreachable(sensor, closest.0))
}

impl Requirements {
    /// Minimum height of cameras above the roundels, metres.
    pub const MIN_HEIGHT_ABOVE_M: f64 = 0.05;

    /// The grid of judged spots.
    fn check(&self) -> Result<MapArea, PlanError> {
        let [low_m, high_m] = self.mount_m;
        within(
            "mount",
            low_m,
            [self.area.height_m + Self::MIN_HEIGHT_ABOVE_M, 1e3],
            "metres, 0.05 or more above the roundels",
        )?;
        within("highest mount", high_m, [low_m, 1e3], "not below the lowest one")?;
        within("views", self.views as f64, [1.0, 16.0], "1 to 16 cameras")?;
        within("share", self.share, [0.01, 1.0], "0.01 to 1")?;
        if let Some(max_m) = self.max_m {
            within("precision", max_m, [1e-7, 1e3], "0.0000001 to 1000 m")?;
        }
        let sides = [0, 1].map(|axis| self.area.max_m[axis] - self.area.min_m[axis]);
        for side in sides {
            within("arena", side, [0.05, 1e3], "sides of 0.05 to 1000 m")?;
        }
        Ok(MapArea { step_m: (sides[0] * sides[1] / GRID_SPOTS).sqrt(), ..self.area })
    }

    /// The grid with its map, and the share of spots that meet the requirements.
    fn judged(&self, grid: Grid, kind: &Kind, area: MapArea) -> Result<(f64, Grid), PlanError> {
        let map = map(&grid.stations, kind, area)?;
        Ok((self.satisfied_share(&map), Grid { map, ..grid }))
    }

    /// Share of spots that meet the requirements.
    fn satisfied_share(&self, map: &Map) -> f64 {
        let good = map.spots.iter().filter(|spot| {
            let exact = spot
                .deviation
                .is_some_and(|deviation| self.max_m.is_none_or(|max_m| deviation.total_m <= max_m));
            spot.cameras >= self.views && exact
        });
        good.count() as f64 / map.spots.len() as f64
    }

    fn unreachable(&self, sensor: &Sensor, best: Option<(f64, Grid)>) -> PlanError {
        let remedy = "take larger roundels, other heights, or more pixels";
        let (reason, remedy) = match best {
            Some((share, grid)) if share > 0.0 => {
                let Summary { median_m, .. } = grid.map.summary();
                let reason = format!(
                    "the best, {} x {} at {:.2} m, does it for {:.0} % (median {:.2} mm)",
                    grid.counts[0],
                    grid.counts[1],
                    grid.mount_m,
                    share * 100.0,
                    median_m * 1e3
                );
                (reason, remedy)
            }
            Some(_) => ("none of them sees a spot well enough".to_owned(), remedy),
            // No grid was worth a map.
            None => {
                let sides_m = [0, 1].map(|axis| self.area.max_m[axis] - self.area.min_m[axis]);
                let each_m2 = seen_m2(sensor, self.mount_m[1] - self.area.height_m);
                let reason = format!(
                    "{MAX_CAMERAS} times the {each_m2:.0} m² that one sees from {} m, {} on every place, are less \
                     than its {:.0} m²",
                    self.mount_m[1],
                    self.views,
                    sides_m[0] * sides_m[1]
                );
                (
                    reason,
                    "hang them higher, take a wider lens, or plan parts of the arena by themselves",
                )
            }
        };
        PlanError::Unreachable(format!(
            "no grid of up to {MAX_CAMERAS} such cameras at {} to {} m does it for {:.0} % of the arena: {reason}; \
             {remedy}",
            self.mount_m[0],
            self.mount_m[1],
            self.share * 100.0
        ))
    }
}

/// All grids of this number of cameras that could cover the arena, with an empty map.
fn candidate_grids<'a>(
    count: usize,
    requirements: &'a Requirements,
    sensor: &'a Sensor,
) -> impl Iterator<Item = Grid> + 'a {
    let pairs = (1..=count).filter(move |columns| count.is_multiple_of(*columns));
    let grids = pairs.flat_map(move |columns| {
        let counts = [columns, count / columns];
        heights(requirements.mount_m)
            .flat_map(move |mount_m| [false, true].map(|is_turned| (counts, mount_m, is_turned)))
    });
    grids.filter_map(move |(counts, mount_m, is_turned)| {
        if !could_cover(requirements, sensor, counts, mount_m) {
            return None;
        }
        let stations = downward_cameras(requirements, sensor, counts, mount_m, is_turned);
        let (area, spots, seen_shares) = (requirements.area, Vec::new(), Vec::new());
        let map = Map { area, columns: 0, rows: 0, spots, seen_shares };
        Some(Grid { counts, mount_m, is_turned, stations, map })
    })
}

/// Mounting heights from the highest down.
fn heights([low_m, high_m]: [f64; 2]) -> impl Iterator<Item = f64> {
    let count = if high_m > low_m { HEIGHTS } else { 1 };
    (0..count).map(move |number| {
        let share = number as f64 / (count - 1).max(1) as f64;
        high_m + share * (low_m - high_m)
    })
}

/// Area in the view of one camera by its focal length, square metres.
fn seen_m2(sensor: &Sensor, above_m: f64) -> f64 {
    let camera = sensor.camera.intrinsics();
    let [wide, high] = [camera.width as f64 / camera.fx_px, camera.height as f64 / camera.fy_px];
    wide * high * above_m * above_m
}

/// Whether the pictures together are large enough, with 50 % allowance for distortion at the corners.
fn could_cover(
    requirements: &Requirements,
    sensor: &Sensor,
    counts: [usize; 2],
    mount_m: f64,
) -> bool {
    let arena_m = [0, 1].map(|axis| requirements.area.max_m[axis] - requirements.area.min_m[axis]);
    let each_m2 = seen_m2(sensor, mount_m - requirements.area.height_m);
    let together_m2 = each_m2 * (counts[0] * counts[1]) as f64 * 1.5;
    together_m2 >= requirements.share * requirements.views as f64 * arena_m[0] * arena_m[1]
}

/// Cameras above the centres of a grid's cells, looking straight down.
fn downward_cameras(
    requirements: &Requirements,
    sensor: &Sensor,
    counts: [usize; 2],
    mount_m: f64,
    is_turned: bool,
) -> Vec<PlacedCamera> {
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let quarter = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
    let rotation = if is_turned { quarter * down } else { down };
    let at = |index: usize, axis: usize| {
        let (low, high) = (requirements.area.min_m[axis], requirements.area.max_m[axis]);
        low + (high - low) * (index as f64 + 0.5) / counts[axis] as f64
    };
    let place = |index: usize| {
        let (x, y) = (at(index % counts[0], 0), at(index / counts[0], 1));
        Rigid::from_parts(Translation3::new(x, y, mount_m), rotation)
    };
    (0..counts[0] * counts[1])
        .map(|index| PlacedCamera {
            sensor: sensor.clone(),
            place: CameraPlacement {
                world_from_camera: place(index),
                covariance: Covariance6::zeros(),
            },
            mask: Mask::default(),
        })
        .collect()
}
