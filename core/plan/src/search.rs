//! The reverse questions: which roundel does it, how many cameras, and where.
//!
//! Both are plain searches over what the forward model says, so that what they give is what it holds: the diameter by
//! bisection, the cameras by trying every grid of downward cameras, fewer before more, at a number of heights. Where both are
//! asked for, the fewest cameras count first, then the smallest roundel that one of them would locate so exactly straight
//! below and that does it with so many; what several that overlap know together might let a smaller one do.

use nalgebra::{Translation3, UnitQuaternion, Vector3};

use super::{
    PlanError, Sensor,
    map::{Field, Map, Station, Summary, map},
    precision::{LensDoubt, expect},
    reach::{before, reach},
    sight::wanted,
    within,
};
use roundel_fusion::world::CameraPlacement;
use roundel_vision::{
    camera::NormalizedPoint,
    marker::{Kind, Mask, Pattern},
    rigid::{Covariance6, Rigid},
};

/// Outer diameters that are looked at, metres.
const DIAMETERS_M: (f64, f64) = (0.002, 10.0);
/// A diameter is found to this share.
const SHARE: f64 = 1e-3;
/// Most cameras that are tried.
pub const MOST_CAMERAS: usize = 64;
/// Heights that are tried.
const HEIGHTS: usize = 10;
/// Spots of a map that a grid of cameras is judged by.
const SPOTS: f64 = 300.0;
/// Diameters that are tried below a grid, of the smallest that would do straight below a camera: larger ones reach further
/// out, until they no longer fit into the picture.
const LADDER: [f64; 7] = [1.0, 1.3, 1.7, 2.2, 3.0, 4.5, 7.0];
/// A diameter below a grid is found to this share.
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

/// The smallest outer diameter, metres, of roundels like this one that are found at a distance along the optical axis,
/// tilted so, read if they are coded, and located to `most_m` (rms of the distance from the truth) if that is given.
pub fn smallest_m(
    sensor: &Sensor,
    doubt: Option<&LensDoubt>,
    kind: &Kind,
    (distance_m, tilt_rad): (f64, f64),
    most_m: Option<f64>,
) -> Result<f64, PlanError> {
    sensor.check(kind)?;
    within("distance", distance_m, [1e-3, 1e4], "0.001 to 10000 m")?;
    if let Some(most_m) = most_m {
        within("precision", most_m, [1e-7, 1e3], "0.0000001 to 1000 m")?;
    }
    let error_m = |outer_m: f64| {
        let pose = before(NormalizedPoint::default(), distance_m, tilt_rad);
        let expected = expect(sensor, doubt, &scaled(kind, outer_m), &pose)?;
        expected.is_read.then(|| expected.position_m())
    };
    let does = |outer_m: f64| {
        error_m(outer_m).is_some_and(|error_m| most_m.is_none_or(|most_m| error_m <= most_m))
    };
    // The largest that still fits into the picture is the best that there is.
    let steps = (DIAMETERS_M.1 / DIAMETERS_M.0).ln() / 0.05;
    let tried = || (0..=steps as usize).map(|step| DIAMETERS_M.0 * (0.05 * step as f64).exp());
    let Some(mut good) = tried().find(|&outer_m| does(outer_m)) else {
        let best = tried().filter_map(|outer| Some((outer, error_m(outer)?)));
        return Err(PlanError::Unreachable(match best.min_by(|a, b| a.1.total_cmp(&b.1)) {
            Some((outer_m, error_m)) => format!(
                "no roundel is located to {:.3} mm at {distance_m} m: the best of this camera is {:.3} mm, with one \
                 of {:.0} mm; take more pixels, a longer focal length, or cameras nearer by",
                most_m.unwrap_or(f64::NAN) * 1e3,
                error_m * 1e3,
                outer_m * 1e3
            ),
            None => format!(
                "no roundel of {:.0} mm to {:.0} m is {} at {distance_m} m, tilted by {:.0}°",
                DIAMETERS_M.0 * 1e3,
                DIAMETERS_M.1,
                wanted(kind),
                tilt_rad.to_degrees()
            ),
        }));
    };
    let mut bad = good * (-0.05f64).exp();
    while (good / bad).ln() > SHARE {
        let middle = (good * bad).sqrt();
        if does(middle) { good = middle } else { bad = middle }
    }
    Ok(good)
}

/// What a grid of cameras has to reach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wish {
    /// The arena: least and greatest x and y, and the height of the roundels, metres.
    pub field: Field,
    /// Lowest and highest mount, metres.
    pub mount_m: [f64; 2],
    /// Cameras that have to see a spot.
    pub views: usize,
    /// Share of the spots for which that and the precision have to hold.
    pub share: f64,
    /// What a spot's rms distance from the truth may be, metres, if that matters.
    pub most_m: Option<f64>,
}

/// Cameras that hang in a grid and look straight down.
#[derive(Clone, Debug)]
pub struct Grid {
    /// Along x and y.
    pub counts: [usize; 2],
    /// Height, metres.
    pub mount_m: f64,
    /// Whether the pictures' longer side lies along y.
    pub is_turned: bool,
    /// The cameras.
    pub stations: Vec<Station>,
    /// What they see.
    pub map: Map,
}

/// The fewest cameras that do what is wished; of equally many the most precise.
pub fn fewest(
    sensor: &Sensor,
    doubt: Option<&LensDoubt>,
    kind: &Kind,
    wish: &Wish,
) -> Result<Grid, PlanError> {
    sensor.check(kind)?;
    let field = wish.check()?;
    let does = |mount_m: f64| {
        let straight = before(NormalizedPoint::default(), mount_m - field.height_m, 0.0);
        expect(sensor, doubt, kind, &straight).is_some_and(|expected| expected.is_read)
    };
    if !heights(wish.mount_m).any(does) {
        let reach = reach(sensor, kind, 0.0)?;
        let [nearest_m, farthest_m] = wish.mount_m.map(|mount_m| mount_m - field.height_m);
        return Err(PlanError::Unreachable(format!(
            "a roundel of {:.0} mm is {} from {:.2} to {:.2} m before this camera, and cameras at {} to {} m hang \
             {nearest_m:.2} to {farthest_m:.2} m above it: take other heights, another size of roundels, or another \
             camera",
            kind.outer_diameter_m * 1e3,
            wanted(kind),
            reach.least_m,
            reach.most_m,
            wish.mount_m[0],
            wish.mount_m[1],
        )));
    }
    let mut best: Option<(f64, Grid)> = None;
    for count in 1..=MOST_CAMERAS {
        let mut done: Option<Grid> = None;
        for grid in tried(count, wish, sensor, doubt) {
            let map = map(&grid.stations, kind, field)?;
            let share = wish.fulfilled(&map);
            let grid = Grid { map, ..grid };
            if best.as_ref().is_none_or(|(most, _)| share > *most) {
                best = Some((share, grid.clone()));
            }
            let p95_m = |grid: &Grid| grid.map.summary().p95_m;
            if share >= wish.share && done.as_ref().is_none_or(|done| p95_m(&grid) < p95_m(done)) {
                done = Some(grid);
            }
        }
        if let Some(done) = done {
            return Ok(done);
        }
    }
    Err(wish.missed(sensor, best))
}

/// The fewest cameras that do what is wished with roundels like this one of some diameter, and such a diameter, metres: the
/// smallest but for what several cameras know together.
pub fn fewest_of_any_size(
    sensor: &Sensor,
    doubt: Option<&LensDoubt>,
    kind: &Kind,
    wish: &Wish,
) -> Result<(f64, Grid), PlanError> {
    sensor.check(kind)?;
    let field = wish.check()?;
    // Also says why if nothing would do, and how well the best does.
    let lowest_m = wish.mount_m[0] - field.height_m;
    smallest_m(sensor, doubt, kind, (lowest_m, 0.0), wish.most_m)?;
    let mut best: Option<(f64, Grid)> = None;
    for count in 1..=MOST_CAMERAS {
        let mut done: Option<(f64, Grid)> = None;
        for grid in tried(count, wish, sensor, doubt) {
            let straight_m = grid.mount_m - field.height_m;
            let Ok(least_m) = smallest_m(sensor, doubt, kind, (straight_m, 0.0), wish.most_m)
            else {
                continue;
            };
            if done.as_ref().is_some_and(|(outer_m, _)| *outer_m <= least_m) {
                continue;
            }
            let mapped = |outer_m: f64| -> Result<(f64, Grid), PlanError> {
                let map = map(&grid.stations, &scaled(kind, outer_m), field)?;
                Ok((wish.fulfilled(&map), Grid { map, ..grid.clone() }))
            };
            let mut bad_m = least_m;
            for step in LADDER {
                let outer_m = least_m * step;
                if done.as_ref().is_some_and(|(smallest_m, _)| *smallest_m <= outer_m) {
                    break;
                }
                let (share, found) = mapped(outer_m)?;
                if best.as_ref().is_none_or(|(most, _)| share > *most) {
                    best = Some((share, found.clone()));
                }
                if share < wish.share {
                    bad_m = outer_m;
                    continue;
                }
                let (mut good_m, mut good) = (outer_m, found);
                while (good_m / bad_m).ln() > GRID_SHARE {
                    let middle_m = (good_m * bad_m).sqrt();
                    let (share, found) = mapped(middle_m)?;
                    if share >= wish.share {
                        (good_m, good) = (middle_m, found);
                    } else {
                        bad_m = middle_m;
                    }
                }
                done = Some((good_m, good));
                break;
            }
        }
        if let Some(done) = done {
            return Ok(done);
        }
    }
    Err(wish.missed(sensor, best))
}

impl Wish {
    /// Cameras hang so far above the roundels at least, metres.
    pub const LEAST_ABOVE_M: f64 = 0.05;

    /// The field with the spots that are judged.
    fn check(&self) -> Result<Field, PlanError> {
        let [low_m, high_m] = self.mount_m;
        within(
            "mount",
            low_m,
            [self.field.height_m + Self::LEAST_ABOVE_M, 1e3],
            "metres, 0.05 or more above the roundels",
        )?;
        within("highest mount", high_m, [low_m, 1e3], "not below the lowest one")?;
        within("views", self.views as f64, [1.0, 16.0], "1 to 16 cameras")?;
        within("share", self.share, [0.01, 1.0], "0.01 to 1")?;
        if let Some(most_m) = self.most_m {
            within("precision", most_m, [1e-7, 1e3], "0.0000001 to 1000 m")?;
        }
        let sides = [0, 1].map(|axis| self.field.high_m[axis] - self.field.low_m[axis]);
        for side in sides {
            within("arena", side, [0.05, 1e3], "sides of 0.05 to 1000 m")?;
        }
        Ok(Field { step_m: (sides[0] * sides[1] / SPOTS).sqrt(), ..self.field })
    }

    /// Share of spots with enough views, exact enough.
    fn fulfilled(&self, map: &Map) -> f64 {
        let good = map.spots.iter().filter(|spot| {
            let exact = spot.deviation.is_some_and(|deviation| {
                self.most_m.is_none_or(|most_m| deviation.total_m <= most_m)
            });
            spot.cameras >= self.views && exact
        });
        good.count() as f64 / map.spots.len() as f64
    }

    fn missed(&self, sensor: &Sensor, best: Option<(f64, Grid)>) -> PlanError {
        let most = "take larger roundels, other heights, or more pixels";
        let (tried, remedy) = match best {
            Some((share, grid)) if share > 0.0 => {
                let Summary { median_m, .. } = grid.map.summary();
                let told = format!(
                    "the best, {} x {} at {:.2} m, does it for {:.0} % (median {:.2} mm)",
                    grid.counts[0],
                    grid.counts[1],
                    grid.mount_m,
                    share * 100.0,
                    median_m * 1e3
                );
                (told, most)
            }
            Some(_) => ("none of them sees a spot well enough".to_owned(), most),
            // Not one was worth a map.
            None => {
                let sides_m = [0, 1].map(|axis| self.field.high_m[axis] - self.field.low_m[axis]);
                let each_m2 = seen_m2(sensor, self.mount_m[1] - self.field.height_m);
                let told = format!(
                    "{MOST_CAMERAS} times the {each_m2:.0} m² that one sees from {} m, {} on every place, are less \
                     than its {:.0} m²",
                    self.mount_m[1],
                    self.views,
                    sides_m[0] * sides_m[1]
                );
                (
                    told,
                    "hang them higher, take a wider lens, or plan parts of the arena by themselves",
                )
            }
        };
        PlanError::Unreachable(format!(
            "no grid of up to {MOST_CAMERAS} such cameras at {} to {} m does it for {:.0} % of the arena: {tried}; \
             {remedy}",
            self.mount_m[0],
            self.mount_m[1],
            self.share * 100.0
        ))
    }
}

/// Every grid of so many cameras that could cover the arena, with an empty map.
fn tried<'a>(
    count: usize,
    wish: &'a Wish,
    sensor: &'a Sensor,
    doubt: Option<&'a LensDoubt>,
) -> impl Iterator<Item = Grid> + 'a {
    let pairs = (1..=count).filter(move |columns| count.is_multiple_of(*columns));
    let grids = pairs.flat_map(move |columns| {
        let counts = [columns, count / columns];
        heights(wish.mount_m)
            .flat_map(move |mount_m| [false, true].map(|is_turned| (counts, mount_m, is_turned)))
    });
    grids.filter_map(move |(counts, mount_m, is_turned)| {
        if !could_cover(wish, sensor, counts, mount_m) {
            return None;
        }
        let stations = hung(wish, sensor, doubt, (counts, mount_m, is_turned));
        let (field, spots, seen_shares) = (wish.field, Vec::new(), Vec::new());
        let map = Map { field, columns: 0, rows: 0, spots, seen_shares };
        Some(Grid { counts, mount_m, is_turned, stations, map })
    })
}

/// The heights that are tried, from the highest on.
fn heights([low_m, high_m]: [f64; 2]) -> impl Iterator<Item = f64> {
    let count = if high_m > low_m { HEIGHTS } else { 1 };
    (0..count).map(move |number| {
        let share = number as f64 / (count - 1).max(1) as f64;
        high_m + share * (low_m - high_m)
    })
}

/// What one camera sees from above, by its focal length, square metres.
fn seen_m2(sensor: &Sensor, above_m: f64) -> f64 {
    let camera = sensor.camera.intrinsics();
    let [wide, high] = [camera.width as f64 / camera.fx_px, camera.height as f64 / camera.fy_px];
    wide * high * above_m * above_m
}

/// Whether the pictures are wide enough together, by half again for what the lens adds at the corners.
fn could_cover(wish: &Wish, sensor: &Sensor, counts: [usize; 2], mount_m: f64) -> bool {
    let arena_m = [0, 1].map(|axis| wish.field.high_m[axis] - wish.field.low_m[axis]);
    let each_m2 = seen_m2(sensor, mount_m - wish.field.height_m);
    let together_m2 = each_m2 * (counts[0] * counts[1]) as f64 * 1.5;
    together_m2 >= wish.share * wish.views as f64 * arena_m[0] * arena_m[1]
}

/// Cameras over the middles of a grid's cells, looking straight down.
fn hung(
    wish: &Wish,
    sensor: &Sensor,
    doubt: Option<&LensDoubt>,
    (counts, mount_m, is_turned): ([usize; 2], f64, bool),
) -> Vec<Station> {
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let quarter = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
    let rotation = if is_turned { quarter * down } else { down };
    let at = |index: usize, axis: usize| {
        let (low, high) = (wish.field.low_m[axis], wish.field.high_m[axis]);
        low + (high - low) * (index as f64 + 0.5) / counts[axis] as f64
    };
    let place = |index: usize| {
        let (x, y) = (at(index % counts[0], 0), at(index / counts[0], 1));
        Rigid::from_parts(Translation3::new(x, y, mount_m), rotation)
    };
    (0..counts[0] * counts[1])
        .map(|index| Station {
            sensor: sensor.clone(),
            doubt: doubt.cloned(),
            place: CameraPlacement {
                world_from_camera: place(index),
                covariance: Covariance6::zeros(),
            },
            mask: Mask::default(),
        })
        .collect()
}
