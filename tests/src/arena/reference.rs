//! The reference installations R4 and R16, and R4-lite of the demo.

use nalgebra::{Isometry3, Vector3};

use super::{Arena, Kind, Path, Robot, Site, SiteClock, look_at};
use crate::{
    coded::{coded_print, words},
    optics::{Distortion, Pinhole},
    random::Random,
    render::{Imaging, Print},
};

/// Unix time of every arena's second 0.
const START_NS: i64 = 1_790_000_000_000_000_000;
/// Height of roundels on floor robots.
const FLOOR_ROBOT_M: f64 = 0.3;
/// Largest offset of camera clocks that are not synchronized.
const AHEAD_S: f64 = 0.040;
/// Largest drift of such clocks.
const SKEW: f64 = 50e-6;

/// A camera's sensor and rate.
pub(super) struct Model {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) focal_px: f64,
    pub(super) rate_hz: f64,
}

const R4_MODEL: Model = Model { width: 1920, height: 1080, focal_px: 1100.0, rate_hz: 60.0 };
const LITE_MODEL: Model = Model { width: 1280, height: 720, focal_px: 733.3, rate_hz: 30.0 };

/// Robots in rows. Each has a cell of its own, so that robots never pass through each other.
struct Fleet {
    count: usize,
    field_m: [f64; 2],
    stands: fn(usize) -> bool,
    flies: Box<dyn Fn(usize) -> bool>,
    /// Heights of flying robots above floor robots.
    lift_m: (f64, f64),
}

impl Arena {
    /// Cameras without robots.
    pub(super) fn empty(seed: u64, kind: Kind, sites: Vec<Site>) -> Self {
        Self {
            start_ns: START_NS,
            seed,
            kinds: vec![kind],
            sites,
            robots: Vec::new(),
            landmarks: Vec::new(),
        }
    }

    /// R4-lite: four unsynchronized cameras 1280x720 at 30 Hz over 10 × 8 m, with `robots`, a quarter of which stands
    /// still, and `flying` of the others in the air.
    pub fn r4_lite(seed: u64, robots: usize, flying: usize) -> Self {
        let mut random = Random::new(seed, 0);
        let mut arena = Self::empty(seed, Kind::robot(), corner_sites(&LITE_MODEL, &mut random));
        let quarters_flying = flying * 4 / robots.max(1);
        let fleet = Fleet {
            count: robots,
            field_m: [6.0, 4.5],
            stands: |index| index % 4 == 0,
            flies: Box::new(move |index| index % 4 <= quarters_flying),
            lift_m: (0.5, 1.2),
        };
        arena.place(&fleet, &mut random);
        arena
    }

    /// R4: four unsynchronized cameras 1920x1080 at 60 Hz, and 24 robots with codes of 8 bits, a third of which flies
    /// up to 2 m; accelerations to 2 m/s². Clocks are right.
    pub fn r4(seed: u64) -> Self {
        let mut random = Random::new(seed, 4);
        let mut arena = Self::empty(seed, Kind::coded(8), corner_sites(&R4_MODEL, &mut random));
        let fleet = Fleet {
            count: 24,
            field_m: [6.0, 4.5],
            stands: |_| false,
            flies: Box::new(|index| index % 3 == 2),
            lift_m: (0.5, 1.4),
        };
        arena.place(&fleet, &mut random);
        arena
    }

    /// R16: sixteen such cameras in a 4 × 4 grid over 24 × 18 m, at a height at which four cameras on average see an
    /// object, and 200 robots with codes of 12 bits.
    pub fn r16(seed: u64) -> Self {
        let mut random = Random::new(seed, 16);
        let sites = (0..16)
            .map(|index| {
                let (x, y) = (f64::from(index % 4) - 1.5, f64::from(index / 4) - 1.5);
                let eye = Vector3::new(6.0 * x, 4.5 * y, 9.0);
                let target = Vector3::new(5.7 * x, 4.2 * y, 0.0);
                let name = format!("row {} camera {}", index / 4 + 1, index % 4 + 1);
                site(name, &R4_MODEL, look_at(eye, target), &mut random)
            })
            .collect();
        let mut arena = Self::empty(seed, Kind::coded(12), sites);
        let fleet = Fleet {
            count: 200,
            field_m: [24.0, 18.0],
            stands: |_| false,
            flies: Box::new(|index| index % 3 == 2),
            lift_m: (0.5, 1.4),
        };
        arena.place(&fleet, &mut random);
        arena
    }

    /// R4's cameras with the given robots' paths and kind of roundel.
    pub fn under_r4(seed: u64, kind: Kind, paths: Vec<Path>) -> Self {
        let sites = corner_sites(&R4_MODEL, &mut Random::new(seed, 4));
        let mut arena = Self::empty(seed, kind, sites);
        paths.into_iter().for_each(|path| arena.add_robot(path));
        arena
    }

    /// The same cameras with clocks that are off by up to 40 ms and 50 ppm.
    pub fn with_unsynchronized_clocks(mut self) -> Self {
        let mut random = Random::new(self.seed, 5);
        for site in &mut self.sites {
            let ahead_s = random.uniform(-AHEAD_S, AHEAD_S);
            site.clock = SiteClock { ahead_s, skew: random.uniform(-SKEW, SKEW) };
        }
        // Observations show only differences of clocks: the mean of all clocks is the time.
        let count = self.sites.len() as f64;
        let mean_s = self.sites.iter().map(|site| site.clock.ahead_s).sum::<f64>() / count;
        self.sites.iter_mut().for_each(|site| site.clock.ahead_s -= mean_s);
        self
    }

    /// Adds a robot, with the next code if its kind has codes.
    pub fn add_robot(&mut self, path: Path) {
        let kind = &self.kinds[0];
        let index = self.robots.len();
        let code = kind.code_bits.map(|_| index as u16 + 1);
        let print = match kind.code_bits {
            Some(bits) => coded_print(kind.outer_diameter_m, bits, words(bits)[index], 0.25),
            None => Print::plain(kind.outer_diameter_m, kind.inner_diameter_m, 0.25),
        };
        let (name, kind) = (format!("robot {}", index + 1), kind.name.clone());
        self.robots.push(Robot {
            name,
            kind,
            print,
            code,
            path,
            hidden_s: Vec::new(),
            is_hidden_from_fixed_cameras: false,
        });
    }

    fn place(&mut self, fleet: &Fleet, random: &mut Random) {
        let [width_m, depth_m] = fleet.field_m;
        let columns = ((fleet.count as f64 * width_m / depth_m).sqrt().ceil() as usize).max(1);
        let rows = fleet.count.div_ceil(columns).max(1);
        let cell = [width_m / columns as f64, depth_m / rows as f64];
        let room_m = (cell[0].min(cell[1]) - 0.35).max(0.0) / 2.0;
        for index in 0..fleet.count {
            let center_m = Vector3::new(
                ((index % columns) as f64 + 0.5) * cell[0] - width_m / 2.0,
                ((index / columns) as f64 + 0.5) * cell[1] - depth_m / 2.0,
                FLOOR_ROBOT_M,
            );
            let lift_m = (fleet.flies)(index).then_some(fleet.lift_m);
            self.add_robot(if (fleet.stands)(index) {
                Path::still(center_m)
            } else {
                Path::wandering(center_m, room_m, lift_m, random)
            });
        }
    }
}

/// The four camera poses of R4, at (±2.5, ±2, 5) m, looking at (±1.25, ±1, 0).
fn corner_sites(model: &Model, random: &mut Random) -> Vec<Site> {
    let corners = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)];
    let names = ["southwest", "southeast", "northwest", "northeast"];
    std::iter::zip(corners, names)
        .map(|((x, y), name)| {
            let eye = Vector3::new(2.5 * x, 2.0 * y, 5.0);
            let target = Vector3::new(1.25 * x, y, 0.0);
            site(name.into(), model, look_at(eye, target), random)
        })
        .collect()
}

/// A camera with a mild lens, exposure 4 ms, rolling shutter 12 µs a line.
pub(super) fn site(
    name: String,
    model: &Model,
    world_from_camera: Isometry3<f64>,
    random: &mut Random,
) -> Site {
    let k = [random.uniform(-0.10, -0.06), random.uniform(0.01, 0.04)];
    let p = [random.uniform(-5e-4, 5e-4), random.uniform(-5e-4, 5e-4)];
    let distortion = Distortion::PlumbBob([k[0], k[1], p[0], p[1], 0.0]);
    let mut optics = Pinhole::centered(model.width, model.height, model.focal_px, distortion);
    optics.center_px[0] += random.uniform(-8.0, 8.0);
    optics.center_px[1] += random.uniform(-8.0, 8.0);
    Site {
        name,
        optics,
        imaging: Imaging {
            gradient: [random.uniform(-0.15, 0.15), random.uniform(-0.15, 0.15)],
            exposure_s: 4e-3,
            line_time_s: 12e-6,
            ..Imaging::default()
        },
        world_from_camera,
        mount: None,
        rate_hz: model.rate_hz,
        offset_s: random.uniform(0.0, 1.0 / model.rate_hz),
        clock: SiteClock::default(),
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;

    /// Minimum and mean number of cameras that see a robot's centre, over ten seconds.
    fn views(arena: &Arena) -> (usize, f64) {
        let (mut min, mut sum, mut count) = (usize::MAX, 0, 0);
        for second in 0..10 {
            for truth in arena.truth(arena.start_ns + second * 1_000_000_000) {
                let place = Point3::from(truth.pose.translation.vector);
                let sees = |site: &&Site| arena.pixel(site, &place).is_some();
                let seen_by = arena.sites.iter().filter(sees).count();
                min = min.min(seen_by);
                sum += seen_by;
                count += 1;
            }
        }
        (min, f64::from(sum as u32) / f64::from(count))
    }

    #[test]
    fn every_robot_is_seen_everywhere() {
        let (min, mean) = views(&Arena::r4(1));
        assert!(min >= 1 && mean > 2.0, "{min}, {mean}");
        let (min, mean) = views(&Arena::r16(1));
        assert!(min >= 1 && (3.5..4.5).contains(&mean), "{min}, {mean}");
    }

    #[test]
    fn robots_of_r4_are_as_described() {
        let arena = Arena::r4(1);
        let mut codes: Vec<_> = arena.robots.iter().map(|robot| robot.code).collect();
        codes.sort_unstable();
        codes.dedup();
        assert_eq!((codes.len(), codes[0]), (24, Some(1)));
        let flying = arena.robots.iter().filter(|robot| robot.path.leans).count();
        assert_eq!(flying, 8);
        for second in 0..40 {
            for robot in &arena.robots {
                assert!(robot.path.acceleration(f64::from(second)).norm() < 2.0);
                assert!((0.2..2.1).contains(&robot.path.pose(f64::from(second)).translation.z));
            }
        }
    }
}
