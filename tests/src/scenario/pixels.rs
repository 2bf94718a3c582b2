//! R4 from rendered frames: the errors that remain after detection, pose estimation and fusion.
//!
//! Frames are rendered on all cores, before a lab's clutter, and go through core's tracker and pose estimation as in
//! a server. Calibration is exact. Fusion receives them with a latency of 20 ± 5 ms.

use nalgebra::Vector3;
use rayon::prelude::*;
use roundel_core::world::FrameObservations;

use super::{
    Length, Row,
    run::{Run, Ticks},
};
use crate::{
    arena::{Arena, Kind, Path},
    clutter::Clutter,
    export::Studio,
    pipeline::{Observer, observations},
    random::Random,
    score::{Errors, Score},
};

/// Grey level of the floor.
const FLOOR: f64 = 120.0;
/// Time until tracks and velocities have settled.
const SETTLED_S: f64 = 1.0;

/// Observations of this number of rendered frames of each camera, by capture time.
pub fn watch(arena: &Arena, frames: usize) -> Vec<FrameObservations> {
    let mut all: Vec<FrameObservations> = (0..arena.sites.len())
        .into_par_iter()
        .flat_map_iter(|index| {
            let site = &arena.sites[index];
            let studio = Studio::new(arena, index, FLOOR, &Clutter::LAB);
            let line_time_s = site.imaging.line_time_s;
            let mut observer = Observer::new(&site.optics, &arena.kinds, line_time_s).unwrap();
            let observe = |frame| {
                let capture_ns = arena.capture_time_ns(site, frame);
                let found = observer.observe(&studio.frame(frame), capture_ns).unwrap();
                observations(index, frame, capture_ns, found)
            };
            (0..frames).map(observe).collect::<Vec<_>>()
        })
        .collect();
    all.sort_by_key(|frame| frame.capture_time);
    all
}

/// The same frames, each received 15 to 25 ms after its exposure.
fn delayed(arena: &Arena, mut frames: Vec<FrameObservations>) -> Vec<FrameObservations> {
    let mut random = Random::new(arena.seed, 9);
    for frame in &mut frames {
        frame.received_time = frame.capture_time.plus_seconds(random.uniform(0.015, 0.025));
    }
    frames.sort_by_key(|frame| frame.received_time);
    frames
}

fn fused(arena: &Arena, frames: impl IntoIterator<Item = FrameObservations>) -> Score {
    let run = Run::new(arena, Ticks { rate_hz: 60.0, judged_from_s: SETTLED_S });
    run.take_all(frames).finish().score
}

/// All of R4's robots standing still, a third of them at flying height.
pub fn still(length: Length) -> Vec<Row> {
    kinds().map(|(name, kind)| standing(name, kind, length)).into()
}

fn standing(name: &str, kind: Kind, length: Length) -> Row {
    let places = Arena::r4(11).robots;
    let count = length.seconds(24.0, 6.0) as usize;
    let paths = places.iter().take(count).map(|robot| Path::still(robot.path.center_m)).collect();
    let arena = Arena::under_r4(11, kind, paths);
    let frames = delayed(&arena, watch(&arena, length.seconds(123.0, 72.0) as usize));
    let score = fused(&arena, frames.iter().cloned());
    let (mut plane, mut height) = (Errors::default(), Errors::default());
    for index in 0..arena.sites.len() as u32 {
        let own = frames.iter().filter(|frame| frame.camera.0 == index).cloned();
        let score = fused(&arena, own);
        plane.append(score.plane);
        height.append(score.height);
    }
    let (plane_mm, height_mm) = (score.plane.rms() * 1e3, score.height.rms() * 1e3);
    let alone =
        format!("one camera alone {:.2} and {:.2} mm", plane.rms() * 1e3, height.rms() * 1e3);
    Row::new(
        format!("R4 from pixels, {name} standing still, the second after the first"),
        "rms at most 0.3 mm in the plane, 0.6 mm in height",
    )
    .check(format!("{plane_mm:.3} mm in the plane"), plane_mm <= 0.3)
    .check(format!("{height_mm:.3} mm in height"), height_mm <= 0.6)
    .note(alone)
    .check_identities(count, &score)
    .scored(score)
}

/// Robots one behind another on a circle.
fn circuit(speed_m_s: f64, radius_m: f64, length: Length) -> Vec<Row> {
    let count = length.seconds(6.0, 2.0) as usize;
    let paths: Vec<Path> = (0..count)
        .map(|index| {
            let phase_rad = std::f64::consts::TAU * index as f64 / count as f64;
            Path::circuit(Vector3::new(0.0, 0.0, 0.3), radius_m, speed_m_s, phase_rad)
        })
        .collect();
    let (max_mm, bar) =
        if speed_m_s < 2.0 { (3.0, "rms at most 3 mm") } else { (8.0, "rms at most 8 mm") };
    let row = |(name, kind): (&str, Kind)| {
        let arena = Arena::under_r4(12, kind, paths.clone());
        let frames = watch(&arena, length.seconds(126.0, 90.0) as usize);
        let score = fused(&arena, delayed(&arena, frames));
        let rms_mm = score.position.rms() * 1e3;
        let push_m_s2 = speed_m_s * speed_m_s / radius_m;
        let scenario =
            format!("R4 from pixels, {name} moving at {speed_m_s} m/s, {push_m_s2:.1} m/s² across");
        Row::new(scenario, bar)
            .check(format!("{rms_mm:.2} mm at the stated time"), rms_mm <= max_mm)
            .note(format!(
                "{:.2} in the plane, {:.2} in height",
                score.plane.rms() * 1e3,
                score.height.rms() * 1e3
            ))
            .check_identities(count, &score)
            .scored(score)
    };
    kinds().map(row).into()
}

/// R4's kind of roundel, and the plain one of the same size.
fn kinds() -> [(&'static str, Kind); 2] {
    [("coded roundels", Kind::coded(8)), ("plain roundels", Kind::robot())]
}

/// At the paper's speed.
pub fn walking(length: Length) -> Vec<Row> {
    circuit(1.2, 2.0, length)
}

/// At two and a half times the paper's speed.
pub fn driving(length: Length) -> Vec<Row> {
    circuit(3.0, 2.5, length)
}
