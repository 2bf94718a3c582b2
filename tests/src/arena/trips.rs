//! Robots that run errands on one floor: each drives straight from where it stands to where it likes,
//! and passes the others as closely as it may.
//!
//! An errand is a minimum-jerk move, s(τ) = 10 τ³ - 15 τ⁴ + 6 τ⁵ over τ = t / T (Flash, Hogan 1985),
//! whose greatest acceleration 10/√3 · d / T² says how long it takes. Errands are planned one by one in
//! the order in which robots become free. Each plan counts on all others finishing theirs and standing
//! still then, and no errand is taken up that would pass anybody nearer than [`CLEARANCE_M`] under that
//! assumption. Who finds none stays where it is, which is safe by the same assumption; so the clearance
//! holds at all times, whatever is drawn.

use std::f64::consts::TAU;

use nalgebra::{Vector2, Vector3};

use crate::normal::Random;

/// Centres keep this distance at least, metres.
pub const CLEARANCE_M: f64 = 0.25;
/// No acceleration is greater, m/s².
pub const MOST_M_S2: f64 = 1.0;
/// Greatest acceleration of a move over distance / duration².
const PEAK: f64 = 5.773_502_691_896_258;
/// Greatest speed of a move over distance / duration.
const PEAK_SPEED: f64 = 1.875;
/// Errands looked at before one is chosen, the one that passes the others most closely.
const CANDIDATES: usize = 8;
/// Who finds no errand waits so long.
const WAIT_S: f64 = 0.3;
/// Least distances are found to so much, metres.
const FINENESS_M: f64 = 0.005;

#[derive(Clone, Copy, Debug, PartialEq)]
struct Errand {
    from_s: f64,
    lasts_s: f64,
    from_m: Vector2<f64>,
    to_m: Vector2<f64>,
}

/// One robot's errands, one after another.
#[derive(Clone, Debug, PartialEq)]
pub struct Errands(Vec<Errand>);

impl Errand {
    fn place(&self, t: f64) -> Vector2<f64> {
        let x = ((t - self.from_s) / self.lasts_s).clamp(0.0, 1.0);
        self.from_m.lerp(&self.to_m, x * x * x * (10.0 + x * (6.0 * x - 15.0)))
    }

    fn top_speed(&self) -> f64 {
        PEAK_SPEED * (self.to_m - self.from_m).norm() / self.lasts_s
    }

    fn end_s(&self) -> f64 {
        self.from_s + self.lasts_s
    }
}

impl Errands {
    /// Position, velocity and acceleration, level.
    pub(super) fn at(&self, t: f64) -> [Vector3<f64>; 3] {
        let begun = self.0.partition_point(|errand| errand.from_s <= t);
        let errand = &self.0[begun.saturating_sub(1)];
        let way = errand.to_m - errand.from_m;
        let place = errand.place(t);
        let x = (t - errand.from_s) / errand.lasts_s;
        let (mut speed, mut push) = (0.0, 0.0);
        if (0.0..1.0).contains(&x) {
            speed = 30.0 * (x * (1.0 - x)).powi(2) / errand.lasts_s;
            push = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / errand.lasts_s.powi(2);
        }
        let level = |v: Vector2<f64>| Vector3::new(v.x, v.y, 0.0);
        [level(place), level(way * speed), level(way * push)]
    }

    fn last(&self) -> &Errand {
        &self.0[self.0.len() - 1]
    }
}

/// `count` robots' errands for `seconds` in a field of this size about the origin.
pub fn plan(count: usize, field_m: [f64; 2], seconds: f64, random: &mut Random) -> Vec<Errands> {
    let columns = (count as f64).sqrt().ceil() as usize;
    let rows = count.div_ceil(columns);
    let mut all: Vec<Errands> = (0..count)
        .map(|index| {
            let part = |place: usize, of: usize| (place as f64 + 0.5) / of as f64 - 0.5;
            let place = Vector2::new(
                field_m[0] * part(index % columns, columns),
                field_m[1] * part(index / columns, rows),
            );
            // A first stop, so that not all set off at once.
            let lasts_s = random.uniform(0.1, 2.0);
            Errands(vec![Errand { from_s: 0.0, lasts_s, from_m: place, to_m: place }])
        })
        .collect();
    let mut free_s: Vec<f64> = all.iter().map(|errands| errands.last().end_s()).collect();
    loop {
        let next = (0..count).min_by(|&a, &b| free_s[a].total_cmp(&free_s[b]));
        let Some(robot) = next.filter(|&robot| free_s[robot] < seconds) else { return all };
        free_s[robot] = match choose(&all, robot, free_s[robot], field_m, random) {
            Some(errand) => {
                all[robot].0.push(errand);
                errand.end_s() + random.uniform(0.0, 0.5)
            }
            None => free_s[robot] + WAIT_S,
        };
    }
}

/// Of a few errands that keep the clearance, the one that passes the others most closely.
fn choose(
    all: &[Errands],
    robot: usize,
    from_s: f64,
    field_m: [f64; 2],
    random: &mut Random,
) -> Option<Errand> {
    let from_m = all[robot].last().to_m;
    let mut best: Option<(Errand, f64)> = None;
    for _ in 0..CANDIDATES {
        let (length_m, angle) = (random.uniform(0.5, 2.5), random.uniform(0.0, TAU));
        let to_m = from_m + Vector2::new(angle.cos(), angle.sin()) * length_m;
        let push_m_s2 = random.uniform(0.5, 1.0) * MOST_M_S2;
        if to_m.x.abs() > field_m[0] / 2.0 || to_m.y.abs() > field_m[1] / 2.0 {
            continue;
        }
        let lasts_s = (PEAK * length_m / push_m_s2).sqrt();
        let errand = Errand { from_s, lasts_s, from_m, to_m };
        let others = all.iter().enumerate().filter(|(index, _)| *index != robot);
        let nearest_m =
            others.map(|(_, other)| least_distance(&errand, other.last())).fold(9.0, f64::min);
        let closer = best.is_none_or(|(_, before_m)| nearest_m < before_m);
        if nearest_m >= CLEARANCE_M + FINENESS_M && closer {
            best = Some((errand, nearest_m));
        }
    }
    best.map(|(errand, _)| errand)
}

/// The least distance from one errand's start on, to [`FINENESS_M`]: no step is longer than both can
/// need to come together.
fn least_distance(errand: &Errand, other: &Errand) -> f64 {
    let top_speed = (errand.top_speed() + other.top_speed()).max(0.1);
    let end_s = errand.end_s().max(other.end_s());
    let (mut t, mut least_m) = (errand.from_s, f64::INFINITY);
    while t < end_s {
        least_m = least_m.min((errand.place(t) - other.place(t)).norm());
        let apart_m = (errand.place(t) - other.place(t)).norm();
        t += (apart_m - CLEARANCE_M).max(FINENESS_M) / top_speed;
    }
    least_m.min((errand.to_m - other.to_m).norm())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robots_pass_closely_and_never_too_closely() {
        let all = plan(20, [5.0, 4.0], 60.0, &mut Random::new(1, 0));
        let (mut least_m, mut close) = (f64::INFINITY, 0);
        for step in 0..6000 {
            let t = f64::from(step) * 0.01;
            let places: Vec<_> = all.iter().map(|errands| errands.at(t)[0]).collect();
            for (index, place) in places.iter().enumerate() {
                for other in &places[..index] {
                    let apart_m = (place - other).norm();
                    least_m = least_m.min(apart_m);
                    close += usize::from(apart_m < 0.35);
                }
            }
        }
        assert!(least_m >= CLEARANCE_M, "{least_m}");
        assert!(close > 1000, "{close}");
    }
}
