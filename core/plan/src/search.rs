//! Searches: the smallest roundel, and the fewest cameras, that meet the requirements.
//!
//! Both use the forward predictions. The diameter is found by bisection, the cameras by trying all grids of downward cameras
//! in increasing number at several heights. If both are unknown, the number of cameras has priority; then the smallest
//! roundel is found that a camera locates precisely enough straight below and that suffices over the grid. Combining several
//! cameras might allow a smaller one.

use nalgebra::Vector3;

use super::{
    PlanError, Sensor, bisect,
    map::{Map, MapArea, PlacedCamera, map},
    precision::predict,
    range::{detection_range, pose_in_front},
    visibility::requirement,
    within,
};
use roundel_vision::{
    camera::NormalizedPoint,
    marker::{Kind, Pattern},
};

/// Searched outer diameters, metres.
const DIAMETERS_M: (f64, f64) = (0.002, 10.0);
/// Step of the logarithm of the diameter, and relative precision of a diameter.
const STEP: f64 = 0.05;
const SHARE: f64 = 1e-3;
/// Maximum number of cameras.
pub const MAX_CAMERAS: usize = 64;
/// Number of mounting heights.
const HEIGHTS: usize = 10;
/// Spots of the map that judges a grid.
const GRID_SPOTS: usize = 300;
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
    let limit_m = max_m.unwrap_or(f64::INFINITY);
    let is_sufficient = |outer_m: f64| error_m(outer_m).is_some_and(|error_m| error_m <= limit_m);
    // The best precision is reached by the largest roundel that fits into the picture.
    let steps = ((DIAMETERS_M.1 / DIAMETERS_M.0).ln() / STEP) as usize;
    let diameters_m = || (0..=steps).map(|step| DIAMETERS_M.0 * (STEP * step as f64).exp());
    let Some(good) = diameters_m().find(|&outer_m| is_sufficient(outer_m)) else {
        let errors_m = diameters_m().filter_map(|outer_m| Some((outer_m, error_m(outer_m)?)));
        let best = errors_m.min_by(|a, b| a.1.total_cmp(&b.1));
        return Err(PlanError::Unreachable(match best {
            Some((outer_m, error_m)) => format!(
                "no roundel is located to {:.3} mm at {distance_m} m: the best of this camera is {:.3} mm, with one \
                 of {:.0} mm; take more pixels, a longer focal length, or cameras nearer by",
                limit_m * 1e3,
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
    Ok(bisect(good, good * (-STEP).exp(), SHARE, is_sufficient))
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

/// Arrangement of cameras that look straight down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layout {
    /// Cameras along x and y.
    pub counts: [usize; 2],
    /// Mounting height, metres.
    pub mount_m: f64,
    /// Whether the longer side of the pictures lies along y.
    pub is_turned: bool,
}

/// Grid of cameras with its prediction.
#[derive(Clone, Debug)]
pub struct Grid {
    /// Number and positions of the cameras.
    pub layout: Layout,
    /// Outer diameter of the roundels, metres.
    pub outer_m: f64,
    /// The cameras.
    pub stations: Vec<PlacedCamera>,
    /// Coverage and precision.
    pub map: Map,
    /// Share of the spots that meet the requirements.
    pub share: f64,
}

/// The fewest cameras that meet the requirements, and among equal numbers the most precise grid.
pub fn fewest_cameras(
    sensor: &Sensor,
    kind: &Kind,
    requirements: &Requirements,
) -> Result<Grid, PlanError> {
    let search = GridSearch::new(sensor, kind, requirements)?;
    let above_m = |mount_m: f64| mount_m - requirements.area.height_m;
    let is_readable = |mount_m: f64| {
        let straight = pose_in_front(NormalizedPoint::default(), above_m(mount_m), 0.0);
        predict(sensor, kind, &straight).is_some_and(|expected| expected.is_readable)
    };
    if !requirements.heights().any(is_readable) {
        let range = detection_range(sensor, kind, 0.0)?;
        let [low_m, high_m] = requirements.mount_m;
        return Err(PlanError::Unreachable(format!(
            "a roundel of {:.0} mm is {} from {:.2} to {:.2} m before this camera, and cameras at {low_m} to {high_m} m \
             hang {:.2} to {:.2} m above it: take other heights, another size of roundels, or another camera",
            kind.outer_diameter_m * 1e3,
            requirement(kind),
            range.min_m,
            range.max_m,
            above_m(low_m),
            above_m(high_m)
        )));
    }
    search.run(&[1.0], |_| Some(kind.outer_diameter_m))
}

/// The fewest cameras that meet the requirements with roundels of any size, and among equal numbers the grid with the
/// smallest roundels.
pub fn fewest_cameras_of_any_size(
    sensor: &Sensor,
    kind: &Kind,
    requirements: &Requirements,
) -> Result<Grid, PlanError> {
    let search = GridSearch::new(sensor, kind, requirements)?;
    let min_outer_m = |mount_m: f64| {
        let straight_m = mount_m - requirements.area.height_m;
        smallest_diameter_m(sensor, kind, straight_m, 0.0, requirements.max_m)
    };
    // Returns the reason if no roundel suffices.
    min_outer_m(requirements.mount_m[0])?;
    search.run(&DIAMETER_STEPS, |mount_m| min_outer_m(mount_m).ok())
}

impl Requirements {
    /// Minimum height of cameras above the roundels, metres.
    pub const MIN_HEIGHT_ABOVE_M: f64 = 0.05;

    fn check(&self) -> Result<(), PlanError> {
        let [low_m, high_m] = self.mount_m;
        let lowest_m = self.area.height_m + Self::MIN_HEIGHT_ABOVE_M;
        within("mount", low_m, [lowest_m, 1e3], "metres, 0.05 or more above the roundels")?;
        within("highest mount", high_m, [low_m, 1e3], "not below the lowest one")?;
        within("views", self.views as f64, [1.0, 16.0], "1 to 16 cameras")?;
        within("share", self.share, [0.01, 1.0], "0.01 to 1")?;
        if let Some(max_m) = self.max_m {
            within("precision", max_m, [1e-7, 1e3], "0.0000001 to 1000 m")?;
        }
        for side in self.area.sides_m() {
            within("arena", side, [0.05, 1e3], "sides of 0.05 to 1000 m")?;
        }
        Ok(())
    }

    /// Mounting heights from the highest down.
    fn heights(&self) -> impl Iterator<Item = f64> {
        let [low_m, high_m] = self.mount_m;
        let count = if high_m > low_m { HEIGHTS } else { 1 };
        (0..count).map(move |number| {
            let share = number as f64 / (count - 1).max(1) as f64;
            high_m + share * (low_m - high_m)
        })
    }

    /// Share of spots that meet the requirements.
    fn satisfied_share(&self, map: &Map) -> f64 {
        let max_m = self.max_m.unwrap_or(f64::INFINITY);
        let good = map.spots.iter().filter(|spot| {
            let is_precise = spot.deviation.is_some_and(|deviation| deviation.total_m <= max_m);
            spot.cameras >= self.views && is_precise
        });
        good.count() as f64 / map.spots.len() as f64
    }
}

/// Search for the fewest cameras.
struct GridSearch<'a> {
    sensor: &'a Sensor,
    kind: &'a Kind,
    requirements: &'a Requirements,
    /// The judged spots.
    area: MapArea,
    /// The grid that comes closest to the requirements.
    closest: Option<Grid>,
}

impl<'a> GridSearch<'a> {
    fn new(
        sensor: &'a Sensor,
        kind: &'a Kind,
        requirements: &'a Requirements,
    ) -> Result<Self, PlanError> {
        sensor.check(kind)?;
        requirements.check()?;
        let MapArea { min_m, max_m, height_m, .. } = requirements.area;
        let area = MapArea::with_spots([min_m, max_m], height_m, GRID_SPOTS);
        Ok(Self { sensor, kind, requirements, area, closest: None })
    }

    /// The grid with the fewest cameras, then the smallest roundels, then the best precision. Tries diameters of `steps`
    /// times `min_outer_m` of the mounting height.
    fn run(
        mut self,
        steps: &[f64],
        min_outer_m: impl Fn(f64) -> Option<f64>,
    ) -> Result<Grid, PlanError> {
        let mounts: Vec<(f64, f64)> = (self.requirements.heights())
            .filter_map(|mount_m| Some((mount_m, min_outer_m(mount_m)?)))
            .collect();
        let rank = |grid: &Grid| (grid.outer_m, grid.map.summary().p95_m);
        for count in 1..=MAX_CAMERAS {
            let mut best: Option<Grid> = None;
            for (layout, min_m) in layouts(count, &mounts) {
                if !self.could_cover(count, layout.mount_m) {
                    continue;
                }
                let max_m = best.as_ref().map_or(f64::INFINITY, |best| best.outer_m);
                let diameters_m = steps.iter().map(|step| min_m * step);
                let tried_m = diameters_m.take_while(|&outer_m| outer_m <= max_m);
                let Some(grid) = self.smallest(layout, tried_m)? else { continue };
                if best.as_ref().is_none_or(|best| rank(&grid) < rank(best)) {
                    best = Some(grid);
                }
            }
            if let Some(best) = best {
                return Ok(best);
            }
        }
        Err(self.unreachable())
    }

    /// The smallest roundel that suffices, up to the first sufficient one of `tried_m`.
    fn smallest(
        &mut self,
        layout: Layout,
        tried_m: impl Iterator<Item = f64>,
    ) -> Result<Option<Grid>, PlanError> {
        let mut bad_m = None;
        for outer_m in tried_m {
            let mut good = self.judge(layout, outer_m)?;
            if good.share < self.requirements.share {
                bad_m = Some(outer_m);
                continue;
            }
            let mut bad_m = bad_m.unwrap_or(outer_m);
            while (good.outer_m / bad_m).ln() > GRID_SHARE {
                let middle = self.judge(layout, (good.outer_m * bad_m).sqrt())?;
                if middle.share < self.requirements.share {
                    bad_m = middle.outer_m;
                } else {
                    good = middle;
                }
            }
            return Ok(Some(good));
        }
        Ok(None)
    }

    fn judge(&mut self, layout: Layout, outer_m: f64) -> Result<Grid, PlanError> {
        let stations = self.stations(layout);
        let map = map(&stations, &scaled(self.kind, outer_m), self.area)?;
        let share = self.requirements.satisfied_share(&map);
        let grid = Grid { layout, outer_m, stations, map, share };
        if self.closest.as_ref().is_none_or(|closest| share > closest.share) {
            self.closest = Some(grid.clone());
        }
        Ok(grid)
    }

    /// Cameras above the centres of a grid's cells.
    fn stations(&self, Layout { counts, mount_m, is_turned }: Layout) -> Vec<PlacedCamera> {
        let sides_m = self.area.sides_m();
        let at = |index: usize, axis: usize| {
            self.area.min_m[axis] + sides_m[axis] * (index as f64 + 0.5) / counts[axis] as f64
        };
        let station = |index: usize| {
            let (x, y) = (at(index % counts[0], 0), at(index / counts[0], 1));
            PlacedCamera::downward(self.sensor.clone(), Vector3::new(x, y, mount_m), is_turned)
        };
        (0..counts[0] * counts[1]).map(station).collect()
    }

    /// Whether the pictures together are large enough, with 50 % allowance for distortion at the corners.
    fn could_cover(&self, count: usize, mount_m: f64) -> bool {
        let Requirements { views, share, .. } = *self.requirements;
        let together_m2 = self.seen_m2(mount_m) * count as f64 * 1.5;
        together_m2 >= share * views as f64 * self.area.area_m2()
    }

    /// Area in the view of one camera by its focal length, square metres.
    fn seen_m2(&self, mount_m: f64) -> f64 {
        let camera = self.sensor.camera.intrinsics();
        let [wide, high] =
            [camera.width as f64 / camera.fx_px, camera.height as f64 / camera.fy_px];
        wide * high * (mount_m - self.area.height_m).powi(2)
    }

    fn unreachable(self) -> PlanError {
        let Requirements { mount_m: [low_m, high_m], views, share, .. } = *self.requirements;
        let larger = "take larger roundels, other heights, or more pixels";
        let (reason, remedy) = match &self.closest {
            Some(Grid { layout, map, share, .. }) if *share > 0.0 => {
                let ([columns, rows], median_m) = (layout.counts, map.summary().median_m);
                let reason = format!(
                    "the best, {columns} x {rows} at {:.2} m, does it for {:.0} % (median {:.2} mm)",
                    layout.mount_m,
                    share * 100.0,
                    median_m.unwrap_or(f64::NAN) * 1e3
                );
                (reason, larger)
            }
            Some(_) => ("none of them sees a spot well enough".to_owned(), larger),
            // No grid was worth a map.
            None => {
                let reason = format!(
                    "{MAX_CAMERAS} times the {:.0} m² that one sees from {high_m} m, {views} on every place, are less \
                     than its {:.0} m²",
                    self.seen_m2(high_m),
                    self.area.area_m2()
                );
                (
                    reason,
                    "hang them higher, take a wider lens, or plan parts of the arena by themselves",
                )
            }
        };
        PlanError::Unreachable(format!(
            "no grid of up to {MAX_CAMERAS} such cameras at {low_m} to {high_m} m does it for {:.0} % of the arena: \
             {reason}; {remedy}",
            share * 100.0
        ))
    }
}

/// All layouts of this number of cameras at these heights, each with the number that belongs to the height.
fn layouts(count: usize, mounts: &[(f64, f64)]) -> impl Iterator<Item = (Layout, f64)> {
    let columns = (1..=count).filter(move |columns| count.is_multiple_of(*columns));
    columns.flat_map(move |columns| {
        let counts = [columns, count / columns];
        mounts.iter().flat_map(move |&(mount_m, min_m)| {
            [false, true].map(|is_turned| (Layout { counts, mount_m, is_turned }, min_m))
        })
    })
}
