//! Compares the plan's times per frame with those of independently rendered frames.
//!
//! In: number, size and kind of roundels, picture size, and motion from frame to frame. Out: median times of a frame
//! in which all are tracked, and of a frame that is searched as a whole, poses included, on one thread; of the plan's
//! own simulated frames, and of this crate's rendered frames with a lab's clutter. All roundels move along the same
//! arc, on which the direction changes by 1/64 turn per frame. The exposure is a quarter of the frame interval.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};
use roundel_core::plan::Imaging as PlannedImaging;
use roundel_server::lab::plan::timing::{FRAMES, FrameTimes, TimingCase};

use super::Pair;
use crate::{
    arena::Kind,
    clutter::{Clutter, background},
    coded::{coded_print, words},
    optics::{Distortion, Pinhole},
    pipeline::{core_camera, core_kinds},
    precision::MODES,
    random::Random,
    render::{Image, Imaging, MovingPrint, Print, Renderer},
};

/// Focal length over the picture's width, as in the reference installations.
const FOCAL: f64 = 1100.0 / 1920.0;
/// Frames of a whole turn.
const TURN: f64 = 64.0;
const FRAME_S: f64 = 1.0 / 60.0;
const EXPOSURE_S: f64 = 0.25 * FRAME_S;
/// White margin, as a share of the outer diameter.
const MARGIN: f64 = 0.2;
/// Grey level of the floor. Halfway between black and white, noise alone would make segments.
const FLOOR: f64 = 150.0;
/// Width, height, number of roundels, their diameter, and their motion from frame to frame, pixels.
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
/// Bits of the codes.
const BITS: u8 = 8;

/// A case, the share of frames that are searched as a whole, and seconds per frame.
pub type Timed = (TimingCase, f64, Pair);

/// Median times of all cases in both modes, tracked and searched.
pub fn times() -> anyhow::Result<Vec<Timed>> {
    let plain = PLAIN.iter().map(|listed| (listed, None));
    let coded = CODED.iter().map(|listed| (listed, Some(BITS)));
    let mut timed = Vec::new();
    for (&(width, height, count, diameter_px, motion_px), bits) in plain.chain(coded) {
        let shown = Shown { width, height, count, diameter_px, motion_px, bits };
        let imaging = Imaging::default();
        for mode in MODES {
            let case = TimingCase {
                size: (width, height),
                kind: core_kinds(&[shown.kind()]).remove(0),
                mode,
                imaging: PlannedImaging {
                    noise: imaging.noise,
                    blur_px: imaging.blur_px,
                    black: imaging.black,
                    white: imaging.white,
                },
                roundels: count,
                diameter_px,
                motion_px,
            };
            let (planned, simulated) = (case.measure()?, shown.times(&case)?);
            for searched_share in [0.0, 1.0] {
                let pair = Pair {
                    planned: planned.median_s(searched_share),
                    simulated: simulated.median_s(searched_share),
                };
                timed.push((case.clone(), searched_share, pair));
            }
        }
    }
    Ok(timed)
}

/// Contents of the rendered frames.
#[derive(Clone, Copy, Debug)]
pub struct Shown {
    pub width: usize,
    pub height: usize,
    pub count: usize,
    /// Outer diameter.
    pub diameter_px: f64,
    /// Motion from frame to frame.
    pub motion_px: f64,
    /// Bits of the codes; `None` for plain roundels.
    pub bits: Option<u8>,
}

impl Shown {
    /// Times of a case on these frames.
    pub fn times(&self, case: &TimingCase) -> anyhow::Result<FrameTimes> {
        let lens = Distortion::PlumbBob([-0.02, 0.0, 0.0, 0.0, 0.0]);
        let camera = Pinhole::centered(self.width, self.height, FOCAL * self.width as f64, lens);
        let pictures: Vec<_> =
            self.pictures(&camera).into_iter().map(|image| image.pixels).collect();
        let times = case.measure_on(&core_camera(&camera)?, &pictures)?;
        assert!(20 * times.followed >= 19 * self.count, "{self:?}: {} found", times.followed);
        Ok(times)
    }

    fn kind(&self) -> Kind {
        self.bits.map_or_else(Kind::robot, Kind::coded)
    }

    /// Roundels in a grid, each tilted in its own direction.
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
                let moving: Vec<_> = motions
                    .iter()
                    .zip(prints.iter().cycle())
                    .map(|(motion, print)| MovingPrint { print, motion })
                    .collect();
                renderer.frame(&floor, &moving, &mut random)
            })
            .collect()
    }

    /// A lab's clutter, with the density of a 2-megapixel picture.
    fn clutter(&self) -> Clutter {
        let share = (self.width * self.height) as f64 / 2e6;
        let scaled = |count: usize| (share * count as f64).round() as usize;
        let Clutter { boxes, lines, discs, words, .. } = Clutter::LAB;
        let [boxes, lines, discs, words] = [boxes, lines, discs, words].map(scaled);
        Clutter { boxes, lines, discs, words, ..Clutter::LAB }
    }

    /// Offset from the middle of the arc.
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
                let [x, y] = [0.5, 0.5].map(|max| random.uniform(-max, max));
                let lean = Vector3::new(x, y, random.uniform(-1.5, 1.5));
                let facing = UnitQuaternion::rotation_between(&Vector3::z(), &-ray)
                    .expect("a ray in front of the camera");
                let rotation = facing * UnitQuaternion::from_scaled_axis(lean);
                Isometry3::from_parts(Translation3::from(ray * z), rotation)
            })
            .collect()
    }
}
