//! Cost of a followed ring in precise mode under conditions of real pictures, relative to the plain tilted ring:
//! `cargo bench -p roundel-core --bench conditions [-- PART OF A NAME]`.
//!
//! Twelve rings move by half a pixel from frame to frame. The conditions take turns, and the minimum over all turns counts.

#[path = "../tests/drawing/mod.rs"]
mod drawing;

use std::time::Instant;

use drawing::{Drawing, frame, projected};
use nalgebra::Vector3;
use roundel_core::{
    camera::{Camera, Intrinsics, Lens, PixelPoint},
    marker::{Detector, Kind, Mode, Params, Tracker},
    pose::Locator,
    rigid::orientation_of_normal,
};

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
const COLUMNS: usize = 4;
const ROWS: usize = 3;
const FRAMES: usize = 12;
const TURNS: usize = 12;
const FLOOR: f64 = 110.0;

/// What differs from the plain tilted ring.
#[derive(Clone, Copy)]
struct Condition {
    name: &'static str,
    tilt_rad: f64,
    /// White margin, as a share of the outer diameter.
    margin: f64,
    /// Factor on the disc's diameter.
    disc: f64,
    /// Factor on the light.
    light: f64,
    /// Share of the light left in a moving shadow.
    shadow: f64,
}

const PLAIN: Condition =
    Condition { name: "plain", tilt_rad: 0.6, margin: 0.5, disc: 1.0, light: 1.0, shadow: 1.0 };

const CONDITIONS: [Condition; 12] = [
    PLAIN,
    Condition { name: "face-on", tilt_rad: 0.0, ..PLAIN },
    Condition { name: "margin 10 %", margin: 0.1, ..PLAIN },
    Condition { name: "margin 7.5 %", margin: 0.075, ..PLAIN },
    Condition { name: "margin 7.5 %, face-on", margin: 0.075, tilt_rad: 0.0, ..PLAIN },
    Condition { name: "margin 6 %", margin: 0.06, ..PLAIN },
    Condition { name: "disc 1.5 % larger", disc: 1.015, ..PLAIN },
    Condition { name: "disc 3 % smaller", disc: 0.97, ..PLAIN },
    Condition { name: "light 1.65", light: 1.65, ..PLAIN },
    Condition { name: "light 2.8", light: 2.8, ..PLAIN },
    Condition { name: "shadow 30 %", shadow: 0.7, ..PLAIN },
    Condition { name: "shadow 60 %", shadow: 0.4, ..PLAIN },
];

fn camera() -> Camera {
    Camera::new(Intrinsics {
        width: WIDTH,
        height: HEIGHT,
        fx_px: 1100.0,
        fy_px: 1100.0,
        cx_px: 319.5,
        cy_px: 239.5,
        lens: Lens::PlumbBob([-0.08, 0.02, 0.0003, -0.0004, 0.0]),
    })
    .expect("the intrinsics above are valid")
}

/// A frame with all rings, `step` frames after the first.
fn picture(camera: &Camera, condition: &Condition, diameter_px: f64, step: usize) -> Vec<u8> {
    let mut drawing = Drawing::new(WIDTH, HEIGHT, FLOOR, 0.7);
    let moved_px = 0.5 * step as f64;
    for ring in 0..COLUMNS * ROWS {
        let u = (0.5 + (ring % COLUMNS) as f64) * (WIDTH / COLUMNS) as f64 + 0.3 + moved_px;
        let v = (0.5 + (ring / COLUMNS) as f64) * (HEIGHT / ROWS) as f64 - 0.2 + 0.4 * moved_px;
        let ray = camera.bearing(PixelPoint { u, v }).expect("a pixel of the picture");
        let position_m = ray * (0.16 * 1100.0 / diameter_px / ray.z);
        let (sin, cos) = condition.tilt_rad.sin_cos();
        let turn_rad = ring as f64 * 1.3;
        let leaned = Vector3::new(sin * turn_rad.cos(), sin * turn_rad.sin(), cos);
        let normal = orientation_of_normal(&-ray) * leaned;
        let rim = |radius_m: f64| projected::ellipse(camera, &position_m, &normal, [radius_m; 2]);
        drawing.add_disc(&rim(0.08 * (1.0 + 2.0 * condition.margin)), 200.0 - FLOOR);
        drawing.add_disc(&rim(0.08), -160.0);
        drawing.add_disc(&rim(0.032 * condition.disc), 160.0);
    }
    let edge_px = 80.0 + 2.0 * moved_px;
    drawing.light(|u, v| {
        let across_px = (u as f64 % 160.0) - edge_px + 0.2 * v as f64 - 0.2 * 240.0;
        let lit = (0.5 + across_px).clamp(0.0, 1.0);
        condition.light * (condition.shadow + (1.0 - condition.shadow) * lit)
    });
    drawing.picture(2.0, step as u64)
}

struct Run {
    pictures: Vec<Vec<u8>>,
    tracker: Tracker,
    locator: Locator,
    fastest_s: f64,
    median_s: Vec<f64>,
    lost: usize,
    precise: usize,
    all: usize,
    depth: [f64; 2],
    depth_m: f64,
}

impl Run {
    fn new(condition: &Condition, diameter_px: f64) -> Self {
        let camera = camera();
        let kind = Kind::plain("robot", 0.16, 0.064);
        let params = Params { max_roundels: COLUMNS * ROWS, ..Params::default() };
        let detector = Detector::new(vec![kind.clone()], params).expect("the kind is valid");
        let pictures = (0..FRAMES).map(|step| picture(&camera, condition, diameter_px, step));
        Self {
            pictures: pictures.collect(),
            tracker: Tracker::new(detector),
            locator: Locator::new(camera, vec![kind], Mode::Precise),
            fastest_s: f64::INFINITY,
            median_s: Vec::new(),
            lost: 0,
            precise: 0,
            all: 0,
            depth: [0.0; 2],
            depth_m: 0.16 * 1100.0 / diameter_px,
        }
    }

    /// Follows the rings through the frames, there and back.
    fn turn(&mut self) {
        let mut located = Vec::new();
        for step in (0..FRAMES).chain((0..FRAMES).rev()) {
            let frame = frame(&self.pictures[step], WIDTH);
            let tracked = self.tracker.process(&frame);
            self.lost += COLUMNS * ROWS - tracked.len();
            let start = Instant::now();
            self.locator.locate_all(&frame, tracked, &mut located);
            let per_ring_s = start.elapsed().as_secs_f64() / tracked.len().max(1) as f64;
            self.fastest_s = self.fastest_s.min(per_ring_s);
            self.median_s.push(per_ring_s);
            for one in located.iter().flatten() {
                self.precise += usize::from(one.by == Mode::Precise);
                self.all += 1;
                let off = one.pose.position_m.z / self.depth_m - 1.0;
                self.depth[0] += off * off;
                let stated = one.pose.covariance[(2, 2)] / self.depth_m.powi(2);
                self.depth[1] += off * off / stated;
            }
        }
    }
}

fn main() {
    let filter = std::env::args().skip(1).find(|arg| !arg.starts_with('-'));
    for diameter_px in [20.0, 36.0, 72.0] {
        let chosen = |condition: &Condition| {
            condition.name == PLAIN.name
                || filter.as_ref().is_none_or(|filter| condition.name.contains(filter))
        };
        let conditions: Vec<_> = CONDITIONS.into_iter().filter(chosen).collect();
        let mut runs: Vec<_> =
            conditions.iter().map(|condition| Run::new(condition, diameter_px)).collect();
        for _ in 0..TURNS {
            runs.iter_mut().for_each(Run::turn);
        }
        let median = |run: &mut Run| {
            run.median_s.sort_by(f64::total_cmp);
            run.median_s[run.median_s.len() / 2]
        };
        let plain_s = median(&mut runs[0]);
        println!(
            "{diameter_px} px                    us/ring   ratio  precise   lost  depth rms  over stated"
        );
        for (condition, run) in conditions.iter().zip(&mut runs) {
            let own_s = median(run);
            println!(
                "{:<24} {:>8.1} {:>7.2} {:>7.1} % {:>6} {:>8.3} % {:>7.2}",
                condition.name,
                1e6 * own_s,
                own_s / plain_s,
                100.0 * run.precise as f64 / run.all.max(1) as f64,
                run.lost,
                100.0 * (run.depth[0] / run.all.max(1) as f64).sqrt(),
                (run.depth[1] / run.all.max(1) as f64).sqrt(),
            );
        }
    }
}
