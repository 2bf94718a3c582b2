//! Cost of followed roundels under a condition, relative to that under `plain`.
//!
//! Twelve roundels of one size in one picture move on circles of [`PERIOD`] frames, which are shown again and again, so
//! that what is learned about a print from earlier frames is known. Both pictures are followed alternately, on one thread.
//! The minimum time of each frame over all rounds counts, since other processes use the machine.

use std::time::Instant;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};
use rayon::prelude::*;
use roundel_core::marker::{Mode, Params};

use super::{
    condition::{Condition, Marker},
    sequence::{Place, RATE_HZ, Sequence, side_px},
};
use crate::{
    arena::Kind,
    optics::{Distortion, Pinhole},
    pipeline::Observer,
    random::Random,
    render::Image,
};

/// Columns and rows of roundels.
const GRID: [usize; 2] = [4, 3];
pub const ROUNDELS: usize = GRID[0] * GRID[1];
const PERIOD: usize = 12;
/// Rounds are measured until their number and their time, seconds, are both reached, but no more than the last number.
const ROUNDS: (usize, f64, usize) = (2, 0.4, 12);
/// Rounds before the one whose work counts.
const WORK_ROUNDS: usize = 2;

/// Twelve roundels under one condition.
pub struct Picture {
    camera: Pinhole,
    kind: Kind,
    line_time_s: f64,
    frames: Vec<Image>,
}

/// Cost under a condition relative to that under `plain`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// Time per frame.
    pub time: f64,
    /// Share of the roundels that are followed with a pose.
    pub followed: f64,
    /// Work of the precise fits ([`Observer::work`]), the same in each run; NaN in fast mode.
    pub work: f64,
}

impl Picture {
    pub fn new(condition: &Condition, marker: Marker, diameter_px: f64) -> Self {
        let side_px = side_px(condition, diameter_px, PERIOD);
        let [width, height] = GRID.map(|count| count * side_px);
        let lens = Distortion::PlumbBob([-0.02, 0.0, 0.0, 0.0, 0.0]);
        let whole = Pinhole::centered(width, height, 1100.0, lens);
        let tiles: Vec<(Vec<Image>, f64)> = (0..ROUNDELS)
            .into_par_iter()
            .map(|index| {
                let (column, row) = (index % GRID[0], index / GRID[0]);
                let corner_px = [column, row].map(|at| (at * side_px) as f64);
                let row_offset = corner_px[1] + 0.5 * (side_px as f64 - height as f64);
                let place = Place { whole, corner_px, side_px, row_offset, period: PERIOD };
                let central = central(condition, &place, diameter_px, index as u64);
                let mut tile = Sequence::new(condition, marker, central, place, index as u64);
                let focal_px = tile.known_camera().focal_px[0];
                ((0..PERIOD).map(|frame| tile.frame(frame)).collect(), focal_px)
            })
            .collect();
        let frames = (0..PERIOD).map(|frame| joined(&tiles, frame, side_px)).collect();
        let kind = match marker {
            Marker::Plain => Kind::robot(),
            Marker::Coded => Kind::coded(8),
        };
        // The first roundel's lens error holds for the camera.
        let camera = Pinhole { focal_px: [tiles[0].1; 2], ..whole };
        Self { camera, kind, line_time_s: condition.camera.line_time_s, frames }
    }

    fn observer(&self, mode: Mode) -> Observer {
        let params = Params { mode, ..Params::default() };
        let kinds = std::slice::from_ref(&self.kind);
        Observer::with_params(&self.camera, kinds, self.line_time_s, params)
            .expect("a camera and a kind as above")
    }
}

/// Middle of the motion of one roundel, the same for all conditions with the same tilt.
fn central(condition: &Condition, place: &Place, diameter_px: f64, index: u64) -> Isometry3<f64> {
    let mut random = Random::new(index, 3);
    let z = place.whole.focal_px[0] * Kind::robot().outer_diameter_m / diameter_px;
    let half = 0.5 * (place.side_px as f64 - 1.0);
    let at = place.corner_px.map(|corner| corner + half + random.uniform(-1.0, 1.0));
    let ray = place.whole.ray(&Vector2::from(at)).expect("a pixel of the image");
    let tilt_rad = random.uniform(condition.tilt_deg.0, condition.tilt_deg.1).to_radians();
    let axis = random.uniform(0.0, std::f64::consts::TAU);
    let lean = Vector3::new(axis.cos(), axis.sin(), 0.0) * tilt_rad;
    let facing = UnitQuaternion::rotation_between(&Vector3::z(), &-ray)
        .expect("a ray in front of the camera");
    let rotation = facing * UnitQuaternion::from_scaled_axis(lean);
    Isometry3::from_parts(Translation3::from(ray * z), rotation)
}

fn joined(tiles: &[(Vec<Image>, f64)], frame: usize, side_px: usize) -> Image {
    let [width, height] = GRID.map(|count| count * side_px);
    let mut pixels = vec![0; width * height];
    for (index, (images, _)) in tiles.iter().enumerate() {
        let (left, top) = (index % GRID[0] * side_px, index / GRID[0] * side_px);
        for (row, line) in images[frame].pixels.chunks(side_px).enumerate() {
            let start = (top + row) * width + left;
            pixels[start..start + side_px].copy_from_slice(line);
        }
    }
    Image { width, height, pixels }
}

/// An observer with its minimum time of each frame.
struct Runner<'a> {
    picture: &'a Picture,
    observer: Observer,
    times_s: Vec<f64>,
    /// Poses and work in the last round.
    poses: usize,
    work: u64,
    shown: i64,
}

impl<'a> Runner<'a> {
    fn new(picture: &'a Picture, mode: Mode) -> Self {
        let mut runner = Self {
            picture,
            observer: picture.observer(mode),
            times_s: Vec::new(),
            poses: 0,
            work: 0,
            shown: 0,
        };
        runner.round();
        runner.times_s = vec![f64::MAX; picture.frames.len()];
        runner
    }

    /// Shows all frames once.
    fn round(&mut self) {
        self.poses = 0;
        let before = self.observer.work();
        for (frame, image) in self.picture.frames.iter().enumerate() {
            let time_ns = (self.shown as f64 / RATE_HZ * 1e9).round() as i64;
            self.shown += 1;
            let start = Instant::now();
            let found = self.observer.observe(image, time_ns).expect("a frame of this size");
            let time_s = start.elapsed().as_secs_f64();
            self.poses += found.iter().filter(|detection| detection.pose.is_some()).count();
            if let Some(min_s) = self.times_s.get_mut(frame) {
                *min_s = min_s.min(time_s);
            }
        }
        self.work = self.observer.work() - before;
    }
}

/// Follows both pictures alternately.
pub fn cost(picture: &Picture, plain: &Picture, mode: Mode) -> Cost {
    let mut runners = [picture, plain].map(|picture| Runner::new(picture, mode));
    let (min_rounds, enough_s, max_rounds) = ROUNDS;
    let start = Instant::now();
    for round in 0..max_rounds {
        if round >= min_rounds && start.elapsed().as_secs_f64() > enough_s {
            break;
        }
        runners.iter_mut().for_each(Runner::round);
    }
    let [own_s, plain_s] = runners.each_ref().map(|runner| runner.times_s.iter().sum::<f64>());
    Cost {
        time: own_s / plain_s,
        followed: runners[0].poses as f64 / (ROUNDELS * PERIOD) as f64,
        work: work(&runners),
    }
}

/// The work alone, in the last of some rounds.
pub fn work_ratio(picture: &Picture, plain: &Picture) -> f64 {
    let mut runners = [picture, plain].map(|picture| Runner::new(picture, Mode::Precise));
    for _ in 0..WORK_ROUNDS {
        runners.iter_mut().for_each(Runner::round);
    }
    work(&runners)
}

fn work(runners: &[Runner; 2]) -> f64 {
    runners[0].work as f64 / runners[1].work as f64
}
