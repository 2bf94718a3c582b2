//! Drives simulated robots into a circle, pushes one away, and has them keep the circle: a closed control loop.
//!
//! ```sh
//! cargo run --release -- demo --robots 12                           # in one terminal
//! cargo run --release -p roundel-client --example formation         # in another
//! ```
//!
//! Every 50 ms: the newest poses are predicted to when the robots will obey, each robot is drawn to its place on the
//! circle and away from whoever is near, and told so. Ends with an error if the circle is not as wanted, if the push
//! moved nobody, and as soon as there is no news of where the robots are, or no answer: they stop by themselves when
//! they are told nothing.

use std::{
    future::Future,
    time::{Duration, Instant},
};

use anyhow::{Context, bail, ensure};
use roundel_client::{
    Client, ClockOffset, Latest, Subscription, predicted,
    v1::{LifeStage, Snapshot},
};
use tokio::time::{MissedTickBehavior, interval, timeout};

const ROBOTS: usize = 12;
const RADIUS_M: f64 = 2.0;
const PERIOD: Duration = Duration::from_millis(50);
/// From a command until robots obey it.
const OBEYED_AFTER_S: f64 = 0.05;
/// Velocity for each metre off the place. The robots follow a command within half a second: more would swing.
const GAIN_HZ: f64 = 1.0;
const TOP_SPEED_M_S: f64 = 0.9;
/// Robots nearer than this give way to each other.
const NEAR_M: f64 = 0.6;
const GIVE_WAY_HZ: f64 = 1.5;
/// Root mean square distance from the places at which the circle stands …
const GOOD_M: f64 = 0.03;
/// … if it does for so long.
const SETTLED: Duration = Duration::from_secs(2);
const PATIENCE: Duration = Duration::from_secs(60);
/// Nobody is driven by what is older, nor is an answer waited for any longer.
const BLIND: Duration = Duration::from_secs(2);
/// So far the push must take its robot at least: it moves at 1 m/s for a second, and draws back meanwhile.
const PUSHED_M: f64 = 0.3;

type Point = [f64; 2];

#[tokio::main(flavor = "current_thread")]
async fn main() -> anyhow::Result<()> {
    let server = std::env::args().nth(1).unwrap_or_else(|| "http://127.0.0.1:7670".to_owned());
    let client = soon("connection", Client::connect(&server)).await?;
    let mut latest = client.latest(Subscription::default());
    let seen = timeout(PATIENCE, enough(&mut latest)).await;
    let snapshot =
        seen.with_context(|| format!("expected {ROBOTS} robots to be seen within {PATIENCE:?}"))??;
    let clock = soon("answer about the clock", client.clock_offset()).await?;
    let mut formation = Formation { client, latest, clock, ids: assigned(&snapshot) };
    let formed = formation.hold("forming", Duration::ZERO).await?;

    let (pushed, [x, y]) = (formation.ids[0], place(0));
    let outwards = [x / RADIUS_M, y / RADIUS_M, 0.0];
    let push = formation.client.push_robot(pushed, outwards, Duration::from_secs(1));
    soon("answer to the push", push).await?;
    println!("pushing robot {pushed} away");
    let again = formation.hold("holding", Duration::from_secs(3)).await?;
    ensure!(
        again.worst_m[0] >= PUSHED_M,
        "expected the push to take robot {pushed} at least {PUSHED_M} m away, found {:.2} m",
        again.worst_m[0]
    );
    println!(
        "formed in {:.1} s, again {:.1} s after the push, which took robot {pushed} {:.2} m away; rms {:.1} mm",
        formed.took.as_secs_f64(),
        again.took.as_secs_f64(),
        again.worst_m[0],
        again.rms_m * 1e3
    );
    Ok(())
}

/// What comes of `future`, if that is soon enough.
async fn soon<T>(
    what: &str,
    future: impl Future<Output = Result<T, roundel_client::Error>>,
) -> anyhow::Result<T> {
    let ended = timeout(BLIND, future).await;
    Ok(ended.with_context(|| format!("no {what} within {BLIND:?}"))??)
}

/// The first snapshot with enough robots that are seen.
async fn enough(latest: &mut Latest) -> Result<Snapshot, roundel_client::Error> {
    loop {
        let snapshot = latest.next().await?;
        if tracked(&snapshot).len() >= ROBOTS {
            return Ok(snapshot.as_ref().clone());
        }
    }
}

/// Ids and places of the robots that are seen.
fn tracked(snapshot: &Snapshot) -> Vec<(u64, Point)> {
    let seen = snapshot.objects.iter().filter(|state| state.stage() == LifeStage::Tracked);
    seen.filter_map(|state| state.position.map(|p| (state.object_id, [p.x, p.y]))).collect()
}

/// A robot's place on the circle.
fn place(index: usize) -> Point {
    let (sine, cosine) = (index as f64 / ROBOTS as f64 * std::f64::consts::TAU).sin_cos();
    [RADIUS_M * cosine, RADIUS_M * sine]
}

/// The robots by place: in the order in which they stand round their middle, so that their ways hardly cross.
fn assigned(snapshot: &Snapshot) -> Vec<u64> {
    let mut robots = tracked(snapshot);
    robots.truncate(ROBOTS);
    let middle = [0, 1].map(|axis| robots.iter().map(|r| r.1[axis]).sum::<f64>() / ROBOTS as f64);
    let angle = |at: Point| (at[1] - middle[1]).atan2(at[0] - middle[0]);
    robots.sort_by(|a, b| angle(a.1).total_cmp(&angle(b.1)));
    let ways = |turn: usize| -> f64 {
        let each = robots.iter().cycle().skip(turn).take(ROBOTS).enumerate();
        each.map(|(index, robot)| distance_m(robot.1, place(index)).powi(2)).sum()
    };
    let best = (0..ROBOTS).min_by(|&a, &b| ways(a).total_cmp(&ways(b))).unwrap_or_default();
    robots.iter().cycle().skip(best).take(ROBOTS).map(|robot| robot.0).collect()
}

fn distance_m(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Robots and their places on the circle.
struct Formation {
    client: Client,
    latest: Latest,
    clock: ClockOffset,
    /// By place.
    ids: Vec<u64>,
}

/// The circle once it stands.
struct Stands {
    took: Duration,
    rms_m: f64,
    /// Farthest that each robot was from its place.
    worst_m: Vec<f64>,
}

impl Formation {
    /// Drives, at least for so long, until the circle has stood for a while.
    async fn hold(&mut self, word: &str, least: Duration) -> anyhow::Result<Stands> {
        let begin = Instant::now();
        let (mut told, mut good_since) = (begin, None);
        let mut worst_m = vec![0.0_f64; ROBOTS];
        let mut ticks = interval(PERIOD);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            ticks.tick().await;
            let off_m = self.step().await?;
            worst_m.iter_mut().zip(&off_m).for_each(|(worst, off)| *worst = worst.max(*off));
            let rms_m = (off_m.iter().map(|off| off * off).sum::<f64>() / ROBOTS as f64).sqrt();
            let now = Instant::now();
            good_since = (rms_m <= GOOD_M).then(|| good_since.unwrap_or(now));
            if now - told >= Duration::from_secs(1) {
                told = now;
                println!(
                    "{:5.1} s  {word}: rms {:6.1} mm",
                    (now - begin).as_secs_f64(),
                    rms_m * 1e3
                );
            }
            match good_since {
                Some(since) if now - since >= SETTLED && now - begin >= least => {
                    return Ok(Stands { took: since - begin, rms_m, worst_m });
                }
                _ if now - begin > PATIENCE => {
                    bail!(
                        "{word}: expected rms {GOOD_M} m within {PATIENCE:?}, found {rms_m:.3} m"
                    );
                }
                _ => {}
            }
        }
    }

    /// Tells all robots how to move; how far each one is from its place, metres.
    async fn step(&mut self) -> anyhow::Result<Vec<f64>> {
        let snapshot = soon("snapshot", self.latest.next()).await?;
        let ahead_s = (self.clock.server_now_ns() - snapshot.pose_time_ns) as f64 * 1e-9;
        let at = self.places(&predicted(&snapshot, ahead_s + OBEYED_AFTER_S))?;
        // Whoever is not seen may be elsewhere than expected: it is told nothing, and stops if that lasts.
        let seen = tracked(&snapshot);
        let is_seen = |id: u64| seen.iter().any(|robot| robot.0 == id);
        let velocities = (0..ROBOTS).map(|index| (self.ids[index], wanted(index, &at)));
        let velocities = velocities.filter(|(id, _)| is_seen(*id));
        soon("answer to a command", self.client.drive(velocities)).await?;
        let now = self.places(&snapshot)?;
        Ok(now.into_iter().enumerate().map(|(i, at)| distance_m(at, place(i))).collect())
    }

    fn places(&self, snapshot: &Snapshot) -> anyhow::Result<Vec<Point>> {
        let at = |id: &u64| {
            let state = snapshot.objects.iter().find(|state| state.object_id == *id);
            let position = state.and_then(|state| state.position);
            position.map(|p| [p.x, p.y]).with_context(|| format!("robot {id} is followed no more"))
        };
        self.ids.iter().map(at).collect()
    }
}

/// A robot's velocity: towards its place, and away from whoever is near.
fn wanted(index: usize, at: &[Point]) -> [f64; 3] {
    let (own, target) = (at[index], place(index));
    let mut velocity = [0, 1].map(|axis| GAIN_HZ * (target[axis] - own[axis]));
    for (_, other) in at.iter().enumerate().filter(|(other, _)| *other != index) {
        let gap_m = distance_m(own, *other);
        let strength = GIVE_WAY_HZ * (NEAR_M - gap_m).max(0.0) / gap_m.max(0.05);
        velocity = [0, 1].map(|axis| velocity[axis] + strength * (own[axis] - other[axis]));
    }
    let share = TOP_SPEED_M_S / velocity[0].hypot(velocity[1]).max(TOP_SPEED_M_S);
    [velocity[0] * share, velocity[1] * share, 0.0]
}
