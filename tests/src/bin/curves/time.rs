//! Times of following and searching, against what the paper's Fig. 6 varies: the number of roundels,
//! their size, and the image's. The least of many repetitions is taken, since others use the machine.

use std::time::Instant;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use roundel_core::{
    frame::Frame,
    marker::{Detector, Mode, Params, Scratch, Tracker},
    pose::Locator,
};
use roundel_tests::{
    arena::Kind,
    normal::Random,
    optics::{Distortion, Pinhole},
    pipeline::{core_camera, core_kinds},
    precision::MODES,
    render::{Canvas, Image, Imaging, Print, Renderer, Seen},
};

use crate::plot::{Curve, Panel, Style};

/// What is timed.
#[derive(Clone, Copy)]
struct Case {
    width: usize,
    height: usize,
    count: usize,
    diameter_px: f64,
}

const USUAL: Case = Case { width: 1920, height: 1080, count: 100, diameter_px: 30.0 };

/// Times against number, size and image.
pub fn panels(quick: bool) -> Vec<Panel> {
    let rounds = if quick { 10 } else { 60 };
    let counts = [1, 3, 10, 30, 100, 200, 400].map(|count| Case { count, ..USUAL });
    let sizes = [12.0, 15.0, 20.0, 30.0, 45.0, 60.0, 80.0, 110.0].map(|diameter_px| Case {
        count: 1,
        diameter_px,
        ..USUAL
    });
    let images = [(640, 480), (1280, 720), (1920, 1080), (2560, 1440), (3840, 2160)]
        .map(|(width, height)| Case { width, height, count: 50, ..USUAL });
    let of_counts = measured(&counts, |case| case.count as f64, rounds);
    let of_sizes = measured(&sizes, |case| case.diameter_px, 20 * rounds);
    let of_images = measured(&images, |case| (case.width * case.height) as f64 / 1e6, rounds);
    let ms = |times: &Times| 1e3 * times.follow_s;
    let us = |times: &Times| 1e6 * times.follow_s;
    let search_ms = |times: &Times| 1e3 * times.search_s;
    let (count, size, image) = ("roundels", "outer diameter, px", "image, megapixels");
    vec![
        panel("followed: 30 px, 1920x1080", [count, "ms a frame"], true, &of_counts, ms),
        panel("followed: one in 1920x1080", [size, "µs"], true, &of_sizes, us),
        panel("followed: 50 of 30 px", [image, "ms a frame"], false, &of_images, ms),
        panel("first search: 50 of 30 px", [image, "ms a frame"], false, &of_images, search_ms),
    ]
}

/// Least times of one case, poses included.
struct Times {
    /// To follow all.
    follow_s: f64,
    /// To search the whole frame.
    search_s: f64,
}

/// A place on the axis, and the times of both modes there.
type Point = (f64, [Times; 2]);

fn measured(cases: &[Case], place: fn(&Case) -> f64, rounds: usize) -> Vec<Point> {
    cases.iter().map(|case| (place(case), times(case, rounds))).collect()
}

fn panel(
    title: &str,
    [x_name, y_name]: [&'static str; 2],
    log_x: bool,
    points: &[Point],
    value: fn(&Times) -> f64,
) -> Panel {
    let curve = |style, mode: usize| Curve {
        style,
        points: points.iter().map(|(x, times)| (*x, value(&times[mode]))).collect(),
    };
    let curves = vec![curve(Style::Fast, 0), curve(Style::Precise, 1)];
    Panel { title: title.to_owned(), x_name, y_name, log_x, curves }
}

fn times(case: &Case, rounds: usize) -> [Times; 2] {
    let camera = Pinhole::centered(
        case.width,
        case.height,
        1100.0,
        Distortion::PlumbBob([-0.02, 0.0, 0.0, 0.0, 0.0]),
    );
    let image = picture(case, &camera);
    let frame = Frame::new(&image.pixels, image.width, image.height, image.width)
        .expect("a frame of the renderer's size");
    MODES.map(|mode| Times {
        follow_s: follow(case, &camera, &frame, mode, rounds),
        search_s: search(case, &camera, &frame, mode, rounds),
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

fn follow(case: &Case, camera: &Pinhole, frame: &Frame, mode: Mode, rounds: usize) -> f64 {
    let mut tracker = Tracker::new(detector(case, mode));
    let mut locator = locator(camera, mode);
    least(rounds, || {
        let tracked = tracker.process(frame);
        assert_eq!(tracked.len(), case.count, "all roundels are followed");
        tracked.iter().filter(|one| locator.locate(frame, one).is_ok()).count()
    })
}

fn search(case: &Case, camera: &Pinhole, frame: &Frame, mode: Mode, rounds: usize) -> f64 {
    let detector = detector(case, mode);
    let mut locator = locator(camera, mode);
    let mut scratch = Scratch::default();
    let kind = &core_kinds(&[Kind::robot()])[0];
    least(rounds, || {
        let rings = detector.detect(frame, &mut scratch);
        assert_eq!(rings.len(), case.count, "all roundels are found");
        rings.iter().filter(|ring| locator.locate_single(frame, kind, ring).is_ok()).count()
    })
}

/// The least time of a call, seconds, once it is warm; each must count all roundels.
fn least(rounds: usize, mut call: impl FnMut() -> usize) -> f64 {
    call();
    let mut least = f64::MAX;
    for _ in 0..rounds {
        let start = Instant::now();
        std::hint::black_box(call());
        least = least.min(start.elapsed().as_secs_f64());
    }
    least
}

/// Roundels of one size in a grid, each tilted to its own side.
fn picture(case: &Case, camera: &Pinhole) -> Image {
    let kind = Kind::robot();
    let print = Print::plain(kind.outer_diameter_m, kind.inner_diameter_m, 0.2);
    let z = camera.focal_px[0] * kind.outer_diameter_m / case.diameter_px;
    let columns =
        (case.count as f64 * case.width as f64 / case.height as f64).sqrt().ceil().max(1.0);
    let rows = (case.count as f64 / columns).ceil();
    let mut random = Random::new(6, case.count as u64);
    let poses: Vec<_> = (0..case.count)
        .map(|index| {
            let (column, row) = (index as f64 % columns, (index as f64 / columns).floor());
            let u = (column + 0.5) / columns * case.width as f64 + random.uniform(-1.0, 1.0);
            let v = (row + 0.5) / rows * case.height as f64 + random.uniform(-1.0, 1.0);
            let ray = camera.ray(&nalgebra::Vector2::new(u, v)).expect("a pixel of the image");
            let lean = Vector3::new(random.uniform(-0.5, 0.5), random.uniform(-0.5, 0.5), 0.0);
            let facing = UnitQuaternion::rotation_between(&Vector3::z(), &-ray)
                .expect("a ray in front of the camera");
            let rotation = facing * UnitQuaternion::from_scaled_axis(lean);
            Isometry3::from_parts(Translation3::from(ray * z), rotation)
        })
        .collect();
    let motions: Vec<_> = poses.iter().map(|pose| move |_: f64| *pose).collect();
    let seen: Vec<_> = motions.iter().map(|motion| Seen { print: &print, motion }).collect();
    let floor = Canvas::flat(case.width, case.height, 120.0);
    Renderer::new(*camera, Imaging::default()).frame(&floor, &seen, &mut random)
}
