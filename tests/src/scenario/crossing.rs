//! Plain roundels that pass each other closely and are occluded meanwhile.

use std::sync::Arc;

use super::{
    Length, Row,
    run::{Outcome, Run, Ticks},
    swarm::PRECISE,
};
use crate::{
    arena::{
        Arena, Course, Kind, Path,
        trips::{self, CLEARANCE_M},
    },
    random::Random,
    score::CHI2_95_3,
    sensor::{Sensing, Stream},
};
use nalgebra::Vector3;
use roundel_core::world::EventKind;

const ROBOTS: usize = 20;
const FIELD_M: [f64; 2] = [5.0, 4.0];
/// Two robots closer than this pass each other.
const NEAR_M: f64 = 0.35;
/// Duration of an occlusion.
const HIDDEN_S: f64 = 0.5;
/// Minimum time between occlusions of a robot.
const APART_S: f64 = 4.0;
/// Share of passes in which each robot is occluded.
const COVERED: f64 = 0.1;
/// Sampling interval of paths.
const STEP_S: f64 = 0.05;

/// The arena with occlusions of this duration, and the number of passes.
fn arena(seconds: f64, covered_s: f64) -> (Arena, usize) {
    let mut random = Random::new(31, 0);
    let paths = trips::plan(ROBOTS, FIELD_M, seconds, &mut random).into_iter().map(|trips| {
        let course = Course::Trips(Arc::new(trips));
        Path { course, ..Path::still(Vector3::new(0.0, 0.0, 0.3)) }
    });
    let mut arena = Arena::under_r4(31, Kind::robot(), paths.collect());
    let passes = passes(&arena, seconds);
    for &(t, pair) in &passes {
        for robot in pair {
            let hidden_s = &mut arena.robots[robot].hidden_s;
            let free = hidden_s.last().is_none_or(|span| t - span.1 > APART_S);
            if t > 2.0 && free && random.uniform(0.0, 1.0) < COVERED {
                hidden_s.push((t - covered_s / 2.0, t + covered_s / 2.0));
            }
        }
    }
    (arena, passes.len())
}

/// Times at which two robots are closest, and their indices.
fn passes(arena: &Arena, seconds: f64) -> Vec<(f64, [usize; 2])> {
    let apart = |t: f64| -> Vec<f64> {
        let places: Vec<_> =
            arena.robots.iter().map(|robot| robot.path.pose(t).translation.vector).collect();
        let pairs = (0..ROBOTS).flat_map(|one| (0..one).map(move |other| (one, other)));
        pairs.map(|(one, other)| (places[one] - places[other]).norm()).collect()
    };
    let pairs: Vec<[usize; 2]> =
        (0..ROBOTS).flat_map(|one| (0..one).map(move |other| [one, other])).collect();
    let mut found = Vec::new();
    let (mut before, mut now) = (apart(0.0), apart(STEP_S));
    for step in 1..(seconds / STEP_S) as usize {
        let t = step as f64 * STEP_S;
        let after = apart(t + STEP_S);
        for (index, pair) in pairs.iter().enumerate() {
            if now[index] < NEAR_M && now[index] < before[index] && now[index] <= after[index] {
                found.push((t, *pair));
            }
        }
        (before, now) = (now, after);
    }
    found
}

fn fused(arena: &Arena, seconds: f64) -> Outcome {
    let sensing = Sensing { clutter: 0.01, ..PRECISE };
    let run = Run::new(arena, Ticks { rate_hz: 60.0, judged_from_s: 1.0 });
    run.take_all(Stream::new(arena, sensing, seconds)).finish()
}

/// Twenty robots under four cameras.
pub fn crossing(length: Length) -> Vec<Row> {
    let seconds = length.seconds(600.0, 20.0);
    let (arena, passes) = arena(seconds, HIDDEN_S);
    let occlusions: usize = arena.robots.iter().map(|robot| robot.hidden_s.len()).sum();
    let outcome = fused(&arena, seconds);
    let score = &outcome.score;
    let row = Row::new(
        format!(
            "{ROBOTS} plain roundels, {seconds:.0} s: {passes} times two pass each other at \
             {CLEARANCE_M} to {NEAR_M} m, {occlusions} occlusions of {HIDDEN_S} s then"
        ),
        "no swapped identity",
    );
    let row = row
        .check_identities(ROBOTS, score)
        .note(format!("{} lost", outcome.happened(EventKind::Lost)))
        .note_errors(score)
        .note(format!(
            "unseen {:.0} mm, {:.0} % inside 95 %",
            score.predicted.rms() * 1e3,
            score.predicted.share_within(CHI2_95_3) * 100.0
        ));
    vec![row.scored(outcome.score)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Shows that the scenario can fail: plain roundels that pass each other unobserved cannot be distinguished.
    #[test]
    fn occlusions_of_a_second_and_a_half_swap_identities() {
        let (arena, _) = arena(60.0, 1.5);
        let score = fused(&arena, 60.0).score;
        assert!(score.swaps > 0, "{score}");
    }
}
