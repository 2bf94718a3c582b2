//! Robots that drive on one floor in straight trips between random stops, and pass each other closely.
//!
//! A trip is a minimum-jerk move, s(τ) = 10 τ³ - 15 τ⁴ + 6 τ⁵ over τ = t / T (Flash, Hogan 1985), whose largest
//! acceleration 10/√3 · d / T² determines its duration. Trips are planned one by one in the order in which robots
//! become free. Each plan assumes that all others finish their trips and then stand still, and rejects a trip that
//! would pass another robot closer than [`CLEARANCE_M`]. A robot without an acceptable trip stays where it is, which
//! is safe under the same assumption, so the clearance holds at all times.

use std::f64::consts::TAU;

use nalgebra::{Vector2, Vector3};

use crate::random::Random;

/// Minimum distance between centres.
pub const CLEARANCE_M: f64 = 0.25;
/// Maximum acceleration.
pub const MAX_ACCELERATION_M_S2: f64 = 1.0;
/// Largest acceleration of a move over distance / duration².
const PEAK: f64 = 5.773_502_691_896_258;
/// Largest speed of a move over distance / duration.
const PEAK_SPEED: f64 = 1.875;
/// Trips that are compared; the one that passes the others most closely is chosen.
const CANDIDATES: usize = 8;
/// Time until the next attempt of a robot without an acceptable trip.
const WAIT_S: f64 = 0.3;
/// Resolution of minimum distances.
const RESOLUTION_M: f64 = 0.005;

#[derive(Clone, Copy, Debug, PartialEq)]
struct Trip {
    from_s: f64,
    duration_s: f64,
    from_m: Vector2<f64>,
    to_m: Vector2<f64>,
}

/// One robot's trips in order.
#[derive(Clone, Debug, PartialEq)]
pub struct Trips(Vec<Trip>);

impl Trip {
    fn place(&self, t: f64) -> Vector2<f64> {
        let x = ((t - self.from_s) / self.duration_s).clamp(0.0, 1.0);
        self.from_m.lerp(&self.to_m, x * x * x * (10.0 + x * (6.0 * x - 15.0)))
    }

    fn max_speed(&self) -> f64 {
        PEAK_SPEED * (self.to_m - self.from_m).norm() / self.duration_s
    }

    fn end_s(&self) -> f64 {
        self.from_s + self.duration_s
    }
}

impl Trips {
    /// Position, velocity and acceleration, in the plane of the floor.
    pub(super) fn at(&self, t: f64) -> [Vector3<f64>; 3] {
        let started = self.0.partition_point(|trip| trip.from_s <= t);
        let trip = &self.0[started.saturating_sub(1)];
        let leg = trip.to_m - trip.from_m;
        let place = trip.place(t);
        let x = (t - trip.from_s) / trip.duration_s;
        let (mut speed, mut push) = (0.0, 0.0);
        if (0.0..1.0).contains(&x) {
            speed = 30.0 * (x * (1.0 - x)).powi(2) / trip.duration_s;
            push = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / trip.duration_s.powi(2);
        }
        let level = |v: Vector2<f64>| Vector3::new(v.x, v.y, 0.0);
        [level(place), level(leg * speed), level(leg * push)]
    }

    fn last(&self) -> &Trip {
        &self.0[self.0.len() - 1]
    }
}

/// Trips of `count` robots for `seconds` in a field of this size about the origin.
pub fn plan(count: usize, field_m: [f64; 2], seconds: f64, random: &mut Random) -> Vec<Trips> {
    let columns = (count as f64).sqrt().ceil() as usize;
    let rows = count.div_ceil(columns);
    let mut all: Vec<Trips> = (0..count)
        .map(|index| {
            let part = |place: usize, count: usize| (place as f64 + 0.5) / count as f64 - 0.5;
            let place = Vector2::new(
                field_m[0] * part(index % columns, columns),
                field_m[1] * part(index / columns, rows),
            );
            // A first stop, so that robots do not start at the same time.
            let duration_s = random.uniform(0.1, 2.0);
            Trips(vec![Trip { from_s: 0.0, duration_s, from_m: place, to_m: place }])
        })
        .collect();
    let mut free_s: Vec<f64> = all.iter().map(|trips| trips.last().end_s()).collect();
    loop {
        let next = (0..count).min_by(|&a, &b| free_s[a].total_cmp(&free_s[b]));
        let Some(robot) = next.filter(|&robot| free_s[robot] < seconds) else { return all };
        free_s[robot] = match choose(&all, robot, free_s[robot], field_m, random) {
            Some(trip) => {
                all[robot].0.push(trip);
                trip.end_s() + random.uniform(0.0, 0.5)
            }
            None => free_s[robot] + WAIT_S,
        };
    }
}

/// The candidate that keeps the clearance and passes the others most closely.
fn choose(
    all: &[Trips],
    robot: usize,
    from_s: f64,
    field_m: [f64; 2],
    random: &mut Random,
) -> Option<Trip> {
    let from_m = all[robot].last().to_m;
    let mut best: Option<(Trip, f64)> = None;
    for _ in 0..CANDIDATES {
        let (length_m, angle) = (random.uniform(0.5, 2.5), random.uniform(0.0, TAU));
        let to_m = from_m + Vector2::new(angle.cos(), angle.sin()) * length_m;
        let push_m_s2 = random.uniform(0.5, 1.0) * MAX_ACCELERATION_M_S2;
        if to_m.x.abs() > field_m[0] / 2.0 || to_m.y.abs() > field_m[1] / 2.0 {
            continue;
        }
        let duration_s = (PEAK * length_m / push_m_s2).sqrt();
        let trip = Trip { from_s, duration_s, from_m, to_m };
        let others = all.iter().enumerate().filter(|(index, _)| *index != robot);
        let nearest_m =
            others.map(|(_, other)| min_distance(&trip, other.last())).fold(9.0, f64::min);
        let closer = best.is_none_or(|(_, before_m)| nearest_m < before_m);
        if nearest_m >= CLEARANCE_M + RESOLUTION_M && closer {
            best = Some((trip, nearest_m));
        }
    }
    best.map(|(trip, _)| trip)
}

/// Minimum distance from the start of a trip on, to [`RESOLUTION_M`]. No step is longer than both robots need to
/// meet.
fn min_distance(trip: &Trip, other: &Trip) -> f64 {
    let max_speed = (trip.max_speed() + other.max_speed()).max(0.1);
    let end_s = trip.end_s().max(other.end_s());
    let (mut t, mut min_m) = (trip.from_s, f64::INFINITY);
    while t < end_s {
        min_m = min_m.min((trip.place(t) - other.place(t)).norm());
        let apart_m = (trip.place(t) - other.place(t)).norm();
        t += (apart_m - CLEARANCE_M).max(RESOLUTION_M) / max_speed;
    }
    min_m.min((trip.to_m - other.to_m).norm())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robots_pass_closely_and_keep_the_clearance() {
        let all = plan(20, [5.0, 4.0], 60.0, &mut Random::new(1, 0));
        let (mut min_m, mut close) = (f64::INFINITY, 0);
        for step in 0..6000 {
            let t = f64::from(step) * 0.01;
            let places: Vec<_> = all.iter().map(|trips| trips.at(t)[0]).collect();
            for (index, place) in places.iter().enumerate() {
                for other in &places[..index] {
                    let apart_m = (place - other).norm();
                    min_m = min_m.min(apart_m);
                    close += usize::from(apart_m < 0.35);
                }
            }
        }
        assert!(min_m >= CLEARANCE_M, "{min_m}");
        assert!(close > 1000, "{close}");
    }
}
