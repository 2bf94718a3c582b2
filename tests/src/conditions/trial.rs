//! Trials: a roundel that is searched in one frame and followed in the next ones.

use nalgebra::Vector2;
use rayon::prelude::*;
use roundel_core::{
    marker::{Mode, Params},
    pose::Detection,
};

use super::{
    condition::{Condition, Marker},
    score::{PoseScore, Summary},
    sequence::{Place, RATE_HZ, Sequence, side_px},
};
use crate::{
    pipeline::Observer,
    precision::{MODES, pose, reference},
    random::Random,
};

/// Frames after the first.
pub const FOLLOWED: usize = 12;
/// Frames that are scored, the last ones.
pub const SCORED: usize = 4;
/// Frames of a circle: a shadow edge crosses the ring once in [`FOLLOWED`].
const PERIOD: usize = 24;
/// Diameters vary by this share.
const SIZE_SPREAD: f64 = 0.03;

/// `count` trials of one size, computed in parallel, in each of the [`MODES`].
pub fn summaries(
    condition: &Condition,
    marker: Marker,
    diameter_px: f64,
    count: usize,
) -> [Summary; 2] {
    let trials: Vec<[Summary; 2]> = (0..count as u64)
        .into_par_iter()
        .map(|seed| trial(condition, marker, diameter_px, seed))
        .collect();
    let mut sums = <[Summary; 2]>::default();
    for trial in trials {
        for (sum, one) in sums.iter_mut().zip(trial) {
            sum.add(one);
        }
    }
    sums
}

fn trial(condition: &Condition, marker: Marker, diameter_px: f64, seed: u64) -> [Summary; 2] {
    let mut random = Random::new(seed, diameter_px.to_bits());
    let diameter_px = diameter_px * random.uniform(1.0 - SIZE_SPREAD, 1.0 + SIZE_SPREAD);
    let tilt_deg = random.uniform(condition.tilt_deg.0, condition.tilt_deg.1);
    let whole = reference();
    let central = pose(&whole, diameter_px, tilt_deg.to_radians(), &mut random);
    let center = whole.project(&central.translation.vector.into()).expect("a place in the image");
    let side_px = side_px(condition, diameter_px, PERIOD);
    let corner_px = [center.x, center.y].map(|at| (at - 0.5 * side_px as f64).round());
    let place = Place { whole, corner_px, side_px, row_offset: 0.0, period: PERIOD };
    let mut sequence = Sequence::new(condition, marker, central, place, seed);
    let mut observers = MODES.map(|mode| observer(&sequence, condition, mode));
    let mut summaries = MODES.map(|_| Summary { trials: 1, ..Summary::default() });
    let lost = lost_frames(condition, &mut random);
    // A roundel moves too little within the scored frames for another bound.
    let bound = sequence.bound(FOLLOWED);
    for index in (0..=FOLLOWED).filter(|index| !lost[*index]) {
        let image = sequence.frame(index);
        for (observer, summary) in observers.iter_mut().zip(&mut summaries) {
            let time_ns = (index as f64 / RATE_HZ * 1e9).round() as i64;
            let detections = observer.observe(&image, time_ns).expect("a frame of this size");
            let own = own_detection(&sequence, &detections, diameter_px);
            summary.false_detections += detections.len() - usize::from(own.is_some());
            let pose = own.and_then(|own| Some((own, own.pose.as_ref()?)));
            if index == 0 {
                summary.found = usize::from(pose.is_some());
            } else if summary.found == 1 {
                summary.frames += 1;
                summary.followed += usize::from(pose.is_some());
            }
            if index > FOLLOWED - SCORED
                && let (Some((detection, pose)), Some(bound)) = (pose, &bound)
            {
                let truth = sequence.pose(detection.capture_time.as_ns() as f64 * 1e-9);
                summary.scores.push(PoseScore::of(pose, &truth, bound.range_share));
            }
        }
    }
    summaries
}

fn observer(sequence: &Sequence, condition: &Condition, mode: Mode) -> Observer {
    let params = Params { mode, ..Params::default() };
    let kinds = std::slice::from_ref(&sequence.kind);
    let line_time_s = condition.camera.line_time_s;
    Observer::with_params(&sequence.known_camera(), kinds, line_time_s, params)
        .expect("a camera and a kind as above")
}

/// The detection at the roundel's place.
fn own_detection<'a>(
    sequence: &Sequence,
    detections: &'a [Detection],
    diameter_px: f64,
) -> Option<&'a Detection> {
    detections.iter().find(|detection| {
        let truth = sequence.pose(detection.capture_time.as_ns() as f64 * 1e-9);
        let center = detection.ring.outer.center;
        let expected = sequence.camera.project(&truth.translation.vector.into());
        expected.is_some_and(|expected| {
            (Vector2::new(center.u, center.v) - expected).norm() < 0.25 * diameter_px
        })
    })
}

/// Bursts of two frames; never the first.
fn lost_frames(condition: &Condition, random: &mut Random) -> [bool; FOLLOWED + 1] {
    let mut lost = [false; FOLLOWED + 1];
    for index in 1..FOLLOWED {
        if random.uniform(0.0, 1.0) < 0.5 * condition.camera.lost_frames {
            lost[index] = true;
            lost[index + 1] = true;
        }
    }
    lost
}
