//! Times of tracking and searching, with poses, on rendered roundels.
//!
//! In: the number and size of roundels, and the image size. Out: minimum times per frame, in both modes, on one
//! thread. Poses are estimated for all rings of a frame at once, as in the server. The roundels move on small
//! circles, so that positions and poses change from frame to frame. The minimum over many repetitions counts, since
//! other processes use the machine.

use std::time::Instant;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};
use roundel_core::{
    frame::Frame,
    marker::{Detector, Mode, Params, Scratch, Tracker},
    pose::Locator,
};

use crate::{
    arena::Kind,
    optics::{Distortion, Pinhole},
    pipeline::{core_camera, core_kinds},
    precision::MODES,
    random::Random,
    render::{Canvas, Image, Imaging, MovingPrint, Print, Renderer},
};

/// Focal length over the image's width, as in the reference installations: the same view on sensors of other sizes.
const FOCAL: f64 = 1100.0 / 1920.0;
/// Frames of one revolution.
const FRAMES: usize = 8;
/// Radius of the circles.
const CIRCLE_PX: f64 = 2.0;
/// Resulting motion from frame to frame.
pub const MOTION_PX: f64 = 1.5;

#[derive(Clone, Copy, Debug)]
pub struct Case {
    pub width: usize,
    pub height: usize,
    pub count: usize,
    /// Outer diameter.
    pub diameter_px: f64,
}

/// Minimum times of one case in one mode, poses included.
#[derive(Clone, Copy, Debug)]
pub struct Times {
    /// Tracking all roundels, seconds per frame.
    pub track_s: f64,
    /// The part of it that finds the rings, without poses.
    pub rings_s: f64,
    /// Searching the whole frame, seconds per frame.
    pub search_s: f64,
}

/// Times in the [`MODES`].
pub fn times(case: &Case, rounds: usize) -> [Times; 2] {
    let lens = Distortion::PlumbBob([-0.02, 0.0, 0.0, 0.0, 0.0]);
    let camera = Pinhole::centered(case.width, case.height, FOCAL * case.width as f64, lens);
    let images = pictures(case, &camera);
    let frames: Vec<_> = images
        .iter()
        .map(|image| {
            Frame::new(&image.pixels, image.width, image.height, image.width)
                .expect("a frame of the renderer's size")
        })
        .collect();
    MODES.map(|mode| {
        let (track_s, rings_s) = track(case, &camera, &frames, mode, rounds);
        Times { track_s, rings_s, search_s: search(case, &camera, &frames[0], mode, rounds) }
    })
}

fn detector(case: &Case, mode: Mode) -> Detector {
    let params = Params { mode, max_roundels: case.count, ..Params::default() };
    Detector::new(core_kinds(&[Kind::robot()]), params).expect("a kind that can be printed")
}

fn locator(camera: &Pinhole, mode: Mode) -> Locator {
    let camera = core_camera(camera).expect("a camera as above");
    Locator::new(camera, core_kinds(&[Kind::robot()]), mode)
}

/// Times with poses, and without.
fn track(
    case: &Case,
    camera: &Pinhole,
    frames: &[Frame<'_>],
    mode: Mode,
    rounds: usize,
) -> (f64, f64) {
    let mut tracker = Tracker::new(detector(case, mode));
    let mut locator = locator(camera, mode);
    let mut located = Vec::new();
    let mut round = |with_poses: bool| {
        for frame in frames {
            let tracked = tracker.process(frame);
            assert_eq!(tracked.len(), case.count, "all roundels are tracked");
            if with_poses {
                locator.locate_all(frame, tracked, &mut located);
                let posed = located.iter().filter(|one| one.is_ok());
                assert_eq!(posed.count(), case.count, "all roundels are located");
            }
        }
    };
    let frames = frames.len() as f64;
    (min_time(rounds, || round(true)) / frames, min_time(rounds, || round(false)) / frames)
}

fn search(case: &Case, camera: &Pinhole, frame: &Frame<'_>, mode: Mode, rounds: usize) -> f64 {
    let detector = detector(case, mode);
    let mut locator = locator(camera, mode);
    let mut scratch = Scratch::default();
    let kind = &core_kinds(&[Kind::robot()])[0];
    min_time(rounds, || {
        let rings = detector.detect(frame, &mut scratch);
        assert_eq!(rings.len(), case.count, "all roundels are found");
        let located = rings.iter().filter(|ring| locator.locate_single(frame, kind, ring).is_ok());
        assert_eq!(located.count(), case.count, "all roundels are located");
    })
}

/// Minimum time of a call, seconds, after a warm-up.
fn min_time(rounds: usize, mut call: impl FnMut()) -> f64 {
    call();
    let mut min_time = f64::MAX;
    for _ in 0..rounds {
        let start = Instant::now();
        call();
        min_time = min_time.min(start.elapsed().as_secs_f64());
    }
    min_time
}

/// Roundels of one size in a grid, each tilted in its own direction, moving on circles.
fn pictures(case: &Case, camera: &Pinhole) -> Vec<Image> {
    let mut random = Random::new(6, case.count as u64);
    let poses = poses(case, camera, &mut random);
    let kind = Kind::robot();
    let print = Print::plain(kind.outer_diameter_m, kind.inner_diameter_m, 0.2);
    let floor = Canvas::flat(case.width, case.height, 120.0);
    let renderer = Renderer::new(*camera, Imaging::default());
    (0..FRAMES)
        .map(|frame| {
            let angle = std::f64::consts::TAU * frame as f64 / FRAMES as f64;
            let aside = Vector3::new(angle.cos(), angle.sin(), 0.0) * CIRCLE_PX;
            let motions: Vec<_> = poses
                .iter()
                .map(|pose| {
                    let z = pose.translation.vector.z;
                    let shift = Translation3::from(aside * z / camera.focal_px[0]);
                    move |_: f64| shift * pose
                })
                .collect();
            let moving: Vec<_> =
                motions.iter().map(|motion| MovingPrint { print: &print, motion }).collect();
            renderer.frame(&floor, &moving, &mut random)
        })
        .collect()
}

fn poses(case: &Case, camera: &Pinhole, random: &mut Random) -> Vec<Isometry3<f64>> {
    let z = camera.focal_px[0] * Kind::robot().outer_diameter_m / case.diameter_px;
    let columns =
        (case.count as f64 * case.width as f64 / case.height as f64).sqrt().ceil().max(1.0);
    let rows = (case.count as f64 / columns).ceil();
    (0..case.count)
        .map(|index| {
            let (column, row) = (index as f64 % columns, (index as f64 / columns).floor());
            let u = (column + 0.5) / columns * case.width as f64 + random.uniform(-1.0, 1.0);
            let v = (row + 0.5) / rows * case.height as f64 + random.uniform(-1.0, 1.0);
            let ray = camera.ray(&Vector2::new(u, v)).expect("a pixel of the image");
            let lean = Vector3::new(random.uniform(-0.5, 0.5), random.uniform(-0.5, 0.5), 0.0);
            let facing = UnitQuaternion::rotation_between(&Vector3::z(), &-ray)
                .expect("a ray in front of the camera");
            let rotation = facing * UnitQuaternion::from_scaled_axis(lean);
            Isometry3::from_parts(Translation3::from(ray * z), rotation)
        })
        .collect()
}
