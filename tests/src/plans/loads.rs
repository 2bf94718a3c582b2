//! What the plan foretells of time, beside what frames take whose roundels are of one size and move by so much.
//!
//! The machine's constants are measured on other frames, rendered by other code ([`times`]). In: how many roundels of
//! which size and kind in a picture of which size, and by how much they move from frame to frame. Out: the usual times of
//! a frame in which they are followed, and of one that is searched as a whole, poses included, on one thread. All move
//! along the same arc, on which the direction changes by a 64th of a turn a frame; a frame is exposed for a quarter of
//! the time between two.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};
use roundel_core::{
    marker::{Detector, Mode, Params, Tracker},
    plan::time::Load,
    pose::Locator,
};
use roundel_server::lab::plan::{
    contention::ContentionProbe, machine_timings, timing::TimedPipeline,
};

use super::Pair;
use crate::{
    arena::Kind,
    clutter::{Clutter, background},
    coded::{coded_print, words},
    normal::Random,
    optics::{Distortion, Pinhole},
    pipeline::{core_camera, core_kinds},
    precision::MODES,
    render::{Image, Imaging, Print, Renderer, Seen},
};

/// Focal length over the picture's width, that of the reference installations.
const FOCAL: f64 = 1100.0 / 1920.0;
/// Frames from the first, which is searched, until what is kept of tracks has settled, and those that count: as many
/// as the precise way needs to look for motion again.
const SETTLING: usize = 7;
const COUNTED: usize = 9;
const FRAMES: usize = SETTLING + COUNTED;
/// Frames of a whole turn.
const TURN: f64 = 64.0;
const FRAME_S: f64 = 1.0 / 60.0;
const EXPOSURE_S: f64 = 0.25 * FRAME_S;
/// The white margin, a share of the outer diameter.
const MARGIN: f64 = 0.2;
/// Grey level of the floor, not just between black and white, where noise alone makes segments.
const FLOOR: f64 = 150.0;
/// What is timed: width, height, roundels, their pixels, pixels a frame.
type Listed = (usize, usize, usize, f64, f64);

const PLAIN: [Listed; 26] = [
    (640, 480, 1, 30.0, 0.0),
    (640, 480, 12, 20.0, 1.5),
    (640, 480, 12, 60.0, 3.0),
    (800, 600, 6, 16.0, 0.7),
    (800, 600, 2, 48.0, 6.0),
    (1280, 720, 1, 60.0, 1.5),
    (1280, 720, 3, 14.0, 0.0),
    (1280, 720, 10, 15.0, 2.5),
    (1280, 720, 10, 40.0, 1.5),
    (1280, 720, 18, 90.0, 0.0),
    (1280, 720, 30, 30.0, 0.0),
    (1280, 720, 30, 30.0, 5.0),
    (1280, 720, 30, 70.0, 1.5),
    (1280, 720, 60, 25.0, 2.5),
    (1280, 720, 100, 20.0, 1.0),
    (1920, 1080, 1, 100.0, 4.0),
    (1920, 1080, 4, 25.0, 7.0),
    (1920, 1080, 8, 55.0, 0.0),
    (1920, 1080, 24, 18.0, 0.0),
    (1920, 1080, 24, 35.0, 1.5),
    (1920, 1080, 24, 35.0, 7.0),
    (1920, 1080, 24, 80.0, 2.5),
    (1920, 1080, 60, 13.0, 1.0),
    (1920, 1080, 100, 30.0, 1.5),
    (1920, 1080, 100, 60.0, 0.0),
    (2592, 1944, 50, 40.0, 3.0),
];
const CODED: [Listed; 14] = [
    (640, 480, 1, 60.0, 0.0),
    (640, 480, 6, 50.0, 2.0),
    (800, 600, 4, 70.0, 5.0),
    (1280, 720, 1, 45.0, 1.0),
    (1280, 720, 10, 45.0, 0.0),
    (1280, 720, 20, 60.0, 1.5),
    (1280, 720, 12, 80.0, 3.5),
    (1280, 720, 30, 45.0, 4.0),
    (1920, 1080, 4, 55.0, 7.0),
    (1920, 1080, 24, 50.0, 0.0),
    (1920, 1080, 24, 65.0, 1.5),
    (1920, 1080, 40, 45.0, 2.5),
    (1920, 1080, 12, 100.0, 1.0),
    (2592, 1944, 30, 75.0, 6.0),
];
/// Bits of the codes of coded ones.
const BITS: u8 = 8;

/// What is timed, the mode, and seconds a frame by the model with constants of this machine and as they are.
pub type Timed = (Load, Mode, Pair);

/// Measures the constants of this machine, and holds them against other frames than they are from: of other sizes,
/// numbers and motions, before a lab's clutter, rendered by other code. Each followed and searched. Beside them what was
/// measured, as the model has it.
pub fn times() -> anyhow::Result<[Vec<Timed>; 2]> {
    let (machine, measured) = machine_timings::measure(|_, _| {})?;
    let plain = PLAIN.iter().map(|listed| (listed, None));
    let coded = CODED.iter().map(|listed| (listed, Some(BITS)));
    let own = measured.iter().map(|one| {
        let planned = machine.of(one.mode).frame_s(&one.load);
        (one.load, one.mode, Pair { planned, simulated: one.time_s })
    });
    let mut others = Vec::new();
    let mut probe = ContentionProbe::new()?;
    for (&(width, height, count, diameter_px, motion_px), bits) in plain.chain(coded) {
        let shown = Shown { width, height, count, diameter_px, motion_px, bits };
        for (mode, took) in MODES.into_iter().zip(shown.took(MODES, &mut probe)) {
            for (searched_share, simulated) in [(0.0, took.follow_s), (1.0, took.search_s)] {
                let load = Load {
                    image_px: (width * height) as f64,
                    roundels: count as f64,
                    diameter_px,
                    motion_px,
                    is_coded: bits.is_some(),
                    searched_share,
                };
                let planned = machine.of(mode).frame_s(&load);
                others.push((load, mode, Pair { planned, simulated }));
            }
        }
    }
    Ok([own.collect(), others])
}

/// What is shown.
#[derive(Clone, Copy, Debug)]
pub struct Shown {
    /// Of the picture, pixels.
    pub width: usize,
    /// Of the picture, pixels.
    pub height: usize,
    /// Roundels in it.
    pub count: usize,
    /// Their outer diameter, pixels.
    pub diameter_px: f64,
    /// How far they move from frame to frame, pixels.
    pub motion_px: f64,
    /// Of coded ones: the bits of their codes.
    pub bits: Option<u8>,
}

/// Usual times of a frame of a quiet machine, seconds.
#[derive(Clone, Copy, Debug, Default)]
pub struct Took {
    /// In which all are followed, the search for new ones and poses included.
    pub follow_s: f64,
    /// That is searched as a whole, poses included.
    pub search_s: f64,
}

impl Shown {
    /// Times in these modes.
    pub fn took<const N: usize>(&self, modes: [Mode; N], probe: &mut ContentionProbe) -> [Took; N] {
        let lens = Distortion::PlumbBob([-0.02, 0.0, 0.0, 0.0, 0.0]);
        let camera = Pinhole::centered(self.width, self.height, FOCAL * self.width as f64, lens);
        let images = self.pictures(&camera);
        let mut ways = modes.map(|mode| self.way(&camera, mode));
        let rounds = probe.rounds(|| {
            let times = |way: &mut TimedPipeline| {
                way.begin(&images[1].pixels);
                let time = |image: &Image| {
                    let (time_s, found) = way.pass(&image.pixels);
                    assert!(20 * found >= 19 * self.count, "{self:?}: {found} found");
                    time_s
                };
                images.iter().map(time).collect::<Vec<_>>()
            };
            ways.iter_mut().flat_map(times).collect()
        });
        if !rounds.any_uncontended(probe) {
            eprintln!("{self:?}: others used the machine all the time");
        }
        let times_s = rounds.times_s(probe);
        std::array::from_fn(|mode| {
            let times_s = &times_s[mode * FRAMES..][..FRAMES];
            let sum_s: f64 = times_s[SETTLING..].iter().sum();
            Took { follow_s: sum_s / COUNTED as f64, search_s: times_s[0] }
        })
    }

    fn kind(&self) -> Kind {
        self.bits.map_or_else(Kind::robot, Kind::coded)
    }

    fn way(&self, camera: &Pinhole, mode: Mode) -> TimedPipeline {
        let kinds = core_kinds(&[self.kind()]);
        let params = Params { mode, ..Params::default() };
        let detector = Detector::new(kinds.clone(), params).expect("a kind that can be printed");
        let camera = core_camera(camera).expect("a camera as above");
        let locator = Locator::new(camera, kinds, mode);
        TimedPipeline::new(Tracker::new(detector), locator, (self.width, self.height))
    }

    /// Roundels in a grid, each tilted to its own side.
    fn pictures(&self, camera: &Pinhole) -> Vec<Image> {
        let mut random = Random::new(16, self.count as u64);
        let kind = self.kind();
        let (outer_m, inner_m) = (kind.outer_diameter_m, kind.inner_diameter_m);
        let prints: Vec<Print> = match self.bits {
            None => vec![Print::plain(outer_m, inner_m, MARGIN)],
            Some(bits) => words(bits)
                .into_iter()
                .map(|word| coded_print(outer_m, bits, word, MARGIN))
                .collect(),
        };
        let poses = self.poses(camera, &mut random);
        let imaging = Imaging { exposure_s: EXPOSURE_S, ..Imaging::default() };
        let renderer = Renderer::new(*camera, imaging);
        let floor = background(&renderer, FLOOR, &self.clutter(), &mut random);
        (0..FRAMES)
            .map(|frame| {
                let motions: Vec<_> = poses
                    .iter()
                    .map(|pose| {
                        let per_px = pose.translation.vector.z / camera.focal_px[0];
                        move |time_s: f64| {
                            let aside = self.aside_px(frame as f64 + time_s / FRAME_S) * per_px;
                            Translation3::new(aside.x, aside.y, 0.0) * pose
                        }
                    })
                    .collect();
                let seen: Vec<_> = motions
                    .iter()
                    .zip(prints.iter().cycle())
                    .map(|(motion, print)| Seen { print, motion })
                    .collect();
                renderer.frame(&floor, &seen, &mut random)
            })
            .collect()
    }

    /// A lab's, as dense as it is in a picture of 2 megapixels.
    fn clutter(&self) -> Clutter {
        let share = (self.width * self.height) as f64 / 2e6;
        let of = |count: usize| (share * count as f64).round() as usize;
        let Clutter { boxes, lines, discs, words, .. } = Clutter::LAB;
        let [boxes, lines, discs, words] = [boxes, lines, discs, words].map(of);
        Clutter { boxes, lines, discs, words, ..Clutter::LAB }
    }

    /// From the middle of what is passed through.
    fn aside_px(&self, frame: f64) -> Vector2<f64> {
        let radius_px = self.motion_px * TURN / TAU;
        let angle = (frame - 0.5 * (FRAMES - 1) as f64) * TAU / TURN;
        Vector2::new(angle.sin(), angle.cos() - 0.8) * radius_px
    }

    fn poses(&self, camera: &Pinhole, random: &mut Random) -> Vec<Isometry3<f64>> {
        let outer_m = self.kind().outer_diameter_m;
        let z = camera.focal_px[0] * outer_m / self.diameter_px;
        let edge_px = 0.5 * self.motion_px * FRAMES as f64;
        let sides = [self.width, self.height].map(|side| side as f64 - 2.0 * edge_px);
        let columns = (self.count as f64 * sides[0] / sides[1]).sqrt().ceil().max(1.0);
        let rows = (self.count as f64 / columns).ceil();
        (0..self.count)
            .map(|index| {
                let (column, row) = (index as f64 % columns, (index as f64 / columns).floor());
                let u = edge_px + (column + 0.5) / columns * sides[0] + random.uniform(-1.0, 1.0);
                let v = edge_px + (row + 0.5) / rows * sides[1] + random.uniform(-1.0, 1.0);
                let ray = camera.ray(&Vector2::new(u, v)).expect("a pixel of the picture");
                let [x, y] = [0.5, 0.5].map(|most| random.uniform(-most, most));
                let lean = Vector3::new(x, y, random.uniform(-1.5, 1.5));
                let facing = UnitQuaternion::rotation_between(&Vector3::z(), &-ray)
                    .expect("a ray in front of the camera");
                let rotation = facing * UnitQuaternion::from_scaled_axis(lean);
                Isometry3::from_parts(Translation3::from(ray * z), rotation)
            })
            .collect()
    }
}
