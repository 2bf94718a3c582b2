//! Cameras on tracked robots, and cameras that localize by landmarks.
//!
//! The bars lie about 50 % above the errors that follow from geometry. Normals have errors of 20 mrad in each view,
//! half of the variance for about a second. Two views give a drone's orientation to about 10 mrad about each axis,
//! which displaces objects 1.7 m below it by 20 to 30 mm. A robot that sees four prints of 80 mm within 0.3 m of one
//! another knows its direction from their normals to about 10 mrad at 3 m, which is 30 mm there, and from their
//! positions at half a metre.

use roundel_core::{
    time::Timestamp,
    world::{FusionCounts, FusionParams},
};
use roundel_proto::v1::Snapshot;

use super::{Length, Row, swarm::PRECISE};
use crate::{
    arena::{
        Arena, Truth,
        moving::{DOCKING_M, DOCKING_S},
    },
    pipeline::{fusion, message},
    score::{Judge, Score},
    sensor::Stream,
};

const RATE_HZ: f64 = 60.0;
/// Snapshots are scored from this time on.
const JUDGED_FROM_S: f64 = 1.0;
/// Bar for robots that the drone sees, rms.
const DRONE_BAR_MM: f64 = 40.0;
/// Bars for the docking robot, rms, within [`WITHIN_M`] of the nearest and of the farthest point.
const DOCKING_BAR_MM: [f64; 2] = [2.0, 40.0];
const WITHIN_M: f64 = 0.15;

/// Snapshots at regular ticks.
fn watch(
    arena: &Arena,
    seconds: f64,
    mut look: impl FnMut(f64, Snapshot, Vec<Truth>),
) -> FusionCounts {
    let mut fusion = fusion(arena, FusionParams::default());
    let mut tick = 1;
    for frame in Stream::new(arena, PRECISE, seconds) {
        loop {
            let t = f64::from(tick) / RATE_HZ;
            let time_ns = arena.start_ns + (t * 1e9) as i64;
            if time_ns >= frame.received_time.as_ns() {
                break;
            }
            let snapshot = fusion.snapshot(Timestamp::from_ns(time_ns));
            if t >= JUDGED_FROM_S {
                look(t, message(&snapshot), arena.truth(time_ns));
            }
            tick += 1;
        }
        fusion.observe(&frame);
    }
    fusion.counts()
}

/// A snapshot's objects with codes in this range.
fn only(snapshot: &Snapshot, codes: std::ops::RangeInclusive<u32>) -> Snapshot {
    let mut part = snapshot.clone();
    part.objects
        .retain(|object| object.code.as_ref().is_none_or(|code| codes.contains(&code.number)));
    part
}

/// A drone's camera above robots that no other camera sees.
pub fn drone(length: Length) -> Vec<Row> {
    let arena = Arena::with_drone(31);
    let (mut drone, mut robots) = (Judge::default(), Judge::default());
    let counts = watch(&arena, length.seconds(60.0, 6.0), |_, snapshot, truth| {
        drone.take(&only(&snapshot, 1..=1), &truth[..1]);
        robots.take(&only(&snapshot, 2..=99), &truth[1..]);
    });
    let (drone, robots) = (drone.finish(), robots.finish());
    let mm = robots.position.rms() * 1e3;
    let ground = Row::new("10 robots that only a drone's camera sees", "rms ≤ 40 mm");
    let states = robots.position.count();
    let ground = ground
        .check(format!("{} ids for 10", robots.ids), robots.ids == 10)
        .check(format!("{} swaps", robots.swaps), robots.swaps == 0)
        .check(format!("{} strays", robots.strays), robots.strays == 0)
        .check(format!("rms {mm:.1} mm"), mm <= DRONE_BAR_MM)
        .note(format!("seen in {states} states, missing in {}", robots.misses))
        .note(format!("{} of {} detections unplaced", counts.no_camera_pose, counts.detections))
        .note_errors(&robots);
    let above = Row::new("the drone, seen by R4's cameras", "none of its own")
        .check_identities(1, &drone)
        .note(format!("turned by {:.1} mrad rms", drone.rotation.rms() * 1e3))
        .note_errors(&drone);
    vec![ground.scored(robots), above.scored(drone)]
}

/// A robot that localizes by the prints of its docking station.
pub fn docking(length: Length) -> Vec<Row> {
    let arena = Arena::docking(32);
    let [near_m, far_m] = DOCKING_M;
    let mut judges = [Judge::default(), Judge::default(), Judge::default()];
    let counts =
        watch(&arena, length.seconds(4.0 * DOCKING_S, 2.0 * DOCKING_S), |t, snapshot, truth| {
            let away_m = -arena.camera_pose(&arena.sites[0], t).translation.x;
            judges[2].take(&snapshot, &truth);
            for (judge, at_m) in judges.iter_mut().zip([near_m, far_m]) {
                if (away_m - at_m).abs() < WITHIN_M {
                    judge.take(&snapshot, &truth);
                }
            }
        });
    let [near, far, all] = judges.map(Judge::finish);
    let row = |at_m: f64, bar: &'static str, max_mm: f64, score: Score| {
        let mm = score.position.rms() * 1e3;
        let row = Row::new(format!("docking: a robot's own camera {at_m} m from four prints"), bar)
            .check_identities(1, &score)
            .check(format!("rms {mm:.2} mm"), mm <= max_mm)
            .note(format!("turned by {:.1} mrad rms", score.rotation.rms() * 1e3))
            .note_errors(&score);
        row.scored(score)
    };
    let whole = Row::new("docking: approach and retreat", "one id")
        .check_identities(1, &all)
        .note(format!("located in {} frames of {}", counts.localized, counts.frames))
        .scored(all);
    vec![
        row(near_m, "rms ≤ 2 mm", DOCKING_BAR_MM[0], near),
        row(far_m, "rms ≤ 40 mm", DOCKING_BAR_MM[1], far),
        whole,
    ]
}
