//! Many objects under many cameras, without pixels: identities, consistency and speed.

use std::sync::Arc;

use nalgebra::Vector3;

use super::{
    Length, Row,
    run::{Outcome, Run, Ticks, min_seconds},
};
use crate::{
    arena::{Arena, Course, Kind, Path, look_at, path::Stray},
    random::Random,
    sensor::{Sensing, Stream},
};

/// Noise of a precise detector at 30 px.
pub const PRECISE: Sensing =
    Sensing { noise_px: 0.05, tilt_rad: 0.02, yaw_rad: 0.005, ..Sensing::DEFAULT };

/// Objects along a side of the swarm's grid.
const ROWS: usize = 8;

/// 64 plain roundels with random accelerations to 2 m/s², each near its own place, a third of them 0.9 m higher.
/// Eight synchronized cameras around them see all of them.
pub fn swarm(seed: u64, seconds: f64) -> Arena {
    let mut random = Random::new(seed, 64);
    let mut paths = Vec::new();
    for index in 0..ROWS * ROWS {
        let flies = index % 3 == 2;
        let place = |number: usize, step_m: f64| (number as f64 - 3.5) * step_m;
        let center_m = Vector3::new(
            place(index % ROWS, 0.7),
            place(index / ROWS, 0.55),
            if flies { 1.2 } else { 0.3 },
        );
        let axes = Vector3::new(1.0, 1.0, if flies { 0.6 } else { 0.0 });
        let stray = Stray::new(seconds, &axes, 2.0, &mut random);
        paths.push(Path { course: Course::Stray(Arc::new(stray)), ..Path::still(center_m) });
    }
    let mut arena = Arena::under_r4(seed, Kind::robot(), paths);
    let model = arena.sites[0].clone();
    arena.sites.clear();
    for index in 0..8 {
        let (y, x) = (f64::from(index) * std::f64::consts::FRAC_PI_4 + 0.3).sin_cos();
        let eye = Vector3::new(3.5 * x, 3.5 * y, 6.5);
        let mut site = model.clone();
        site.name = format!("camera {}", index + 1);
        site.world_from_camera = look_at(eye, Vector3::new(0.0, 0.0, 0.5));
        (site.rate_hz, site.offset_s) = (100.0, 0.0);
        arena.sites.push(site);
    }
    arena
}

/// Equal runs, of which the fastest counts.
const REPEATS: usize = 3;

/// The first of several equal runs, and the minimum time in fusion's calls, seconds.
fn timed(arena: &Arena, sensing: Sensing, ticks: Ticks, seconds: f64) -> (Outcome, f64) {
    let run = |_| Run::new(arena, ticks).take_all(Stream::new(arena, sensing, seconds)).finish();
    let mut runs: Vec<Outcome> = (0..REPEATS).map(run).collect();
    let spent_s = min_seconds(&runs);
    (runs.swap_remove(0), spent_s)
}

fn fused(seconds: f64, latency_s: (f64, f64)) -> (Outcome, f64) {
    let arena = swarm(1, seconds + 1.0);
    let sensing = Sensing { noise_px: 0.5, tilt_rad: 0.05, clutter: 0.1, latency_s, ..PRECISE };
    let ticks = Ticks { rate_hz: 100.0, judged_from_s: 0.5 };
    let (outcome, spent_s) = timed(&arena, sensing, ticks, seconds);
    (outcome, 100.0 * seconds / spent_s)
}

/// The scenario that compares with Braid's tracker.
pub fn alone(length: Length) -> Vec<Row> {
    let seconds = length.seconds(10.0, 2.0);
    let (Outcome { score, counts, .. }, sets_per_s) = fused(seconds, (0.02, 0.02));
    let views = counts.detections as f64 / (64.0 * 100.0 * seconds);
    let row = Row::new(
        format!("64 objects, 8 synchronized cameras at 100 Hz, {:.0} frame sets", 100.0 * seconds),
        "64 ids, no swap; at least 1,000 frame sets/s on one core",
    );
    let row = row
        .check_identities(64, &score)
        .check(format!("{sets_per_s:.0} frame sets/s"), sets_per_s >= 1000.0)
        .note(format!("seen by {views:.1} cameras"))
        .note_errors(&score);
    vec![row.scored(score)]
}

/// The same with frames that arrive 0 to 40 ms late at random.
pub fn late(length: Length) -> Vec<Row> {
    let (Outcome { score, counts, .. }, sets_per_s) = fused(length.seconds(10.0, 2.0), (0.0, 0.04));
    let out_of_order = 100.0 * counts.out_of_order as f64 / counts.used as f64;
    let row = Row::new(
        "the same, arriving 0 to 40 ms late",
        "64 ids, no swap; at least 300 frame sets/s",
    );
    let row = row
        .check_identities(64, &score)
        .check(format!("{sets_per_s:.0} frame sets/s"), sets_per_s >= 300.0)
        .note(format!("{out_of_order:.0} % out of order, {} dropped", counts.late))
        .note_errors(&score);
    vec![row.scored(score)]
}

/// R16's robots on their loops.
pub fn r16(length: Length) -> Vec<Row> {
    let seconds = length.seconds(6.0, 1.0);
    let arena = Arena::r16(1);
    let ticks = Ticks { rate_hz: 60.0, judged_from_s: 0.5 };
    let (Outcome { score, counts, .. }, spent_s) = timed(&arena, PRECISE, ticks, seconds);
    let times = seconds / spent_s;
    let views = counts.detections as f64 / (200.0 * 60.0 * seconds);
    let row = Row::new(
        format!("R16: 200 coded objects, 16 cameras at 60 Hz, {seconds:.0} s"),
        "10 times faster than real time on one core",
    );
    let row = row
        .check(format!("{times:.1} times real time"), times >= 10.0)
        .check_identities(200, &score)
        .note(format!("seen by {views:.1} cameras"))
        .note_errors(&score);
    vec![row.scored(score)]
}

/// R4's robots on their loops.
pub fn r4(length: Length) -> Vec<Row> {
    let arena = Arena::r4(1);
    let run = Run::new(&arena, Ticks { rate_hz: 60.0, judged_from_s: 1.0 });
    let stream = Stream::new(&arena, PRECISE, length.seconds(20.0, 4.0));
    let score = run.take_all(stream).finish().score;
    let yaw = 100.0 * score.rotation.count() as f64 / score.normal.count() as f64;
    let row = Row::new("R4: 24 coded robots, accelerations to 2 m/s², clocks right", "one id each")
        .check_identities(24, &score)
        .note(format!("yaw known in {yaw:.1} % of states"))
        .note_errors(&score);
    vec![row.scored(score)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robots_of_the_swarm_keep_their_distance() {
        let arena = swarm(1, 11.0);
        let mut min_m = f64::INFINITY;
        for step in 0..1000 {
            let truth = arena.truth(arena.start_ns + step * 10_000_000);
            for (index, one) in truth.iter().enumerate() {
                for other in &truth[..index] {
                    let apart = one.pose.translation.vector - other.pose.translation.vector;
                    min_m = min_m.min(apart.norm());
                }
            }
        }
        assert!(min_m > 0.16, "{min_m}");
    }
}
