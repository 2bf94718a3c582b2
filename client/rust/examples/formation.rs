//! A closed control loop: drives simulated robots into a circle, pushes one away, and restores the circle.
//!
//! ```sh
//! cargo run --release -- demo --robots 12                           # in one terminal
//! cargo run --release -p roundel-client --example formation         # in another
//! ```
//!
//! Every 50 ms, the loop predicts the newest poses to the time at which a command takes effect, and commands each robot
//! towards its place on the circle and away from robots nearby. Ends with an error if the circle is not reached, if the
//! push moves no robot, or if no recent snapshot or no response arrives. Robots without commands stop automatically.

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
/// Time from a command until it takes effect.
const COMMAND_DELAY_S: f64 = 0.05;
/// Velocity per metre of position error. The robots reach a commanded velocity within half a second; more gain would
/// oscillate.
const GAIN_HZ: f64 = 1.0;
const TOP_SPEED_M_S: f64 = 0.9;
/// Robots closer than this avoid each other.
const AVOIDANCE_DISTANCE_M: f64 = 0.6;
const AVOIDANCE_GAIN_HZ: f64 = 1.5;
/// RMS position error at which the circle counts as reached.
const TOLERANCE_M: f64 = 0.03;
const SETTLED: Duration = Duration::from_secs(2);
const TIMEOUT: Duration = Duration::from_secs(60);
/// Limit for the wait for a snapshot or a response.
const CALL_TIMEOUT: Duration = Duration::from_secs(2);
/// Minimum displacement by the push, which moves a robot at 1 m/s for a second against its control loop.
const MIN_PUSH_M: f64 = 0.3;

type Point = [f64; 2];

#[tokio::main(flavor = "current_thread")]
async fn main() -> anyhow::Result<()> {
    let server = std::env::args().nth(1).unwrap_or_else(|| "http://127.0.0.1:7670".to_owned());
    let client = within_timeout("connection", Client::connect(&server)).await?;
    let mut latest = client.latest(Subscription::default());
    let snapshot = timeout(TIMEOUT, first_complete(&mut latest)).await;
    let snapshot = snapshot
        .with_context(|| format!("expected {ROBOTS} observed robots within {TIMEOUT:?}"))??;
    let clock = within_timeout("clock offset", client.clock_offset()).await?;
    let mut formation = Formation { client, latest, clock, ids: assign(&snapshot) };
    let formed = formation.hold("forming", Duration::ZERO).await?;

    let (pushed, [x, y]) = (formation.ids[0], target(0));
    let outwards = [x / RADIUS_M, y / RADIUS_M, 0.0];
    let push = formation.client.push_robot(pushed, outwards, Duration::from_secs(1));
    within_timeout("response to the push", push).await?;
    println!("pushing robot {pushed} away");
    let again = formation.hold("holding", Duration::from_secs(3)).await?;
    ensure!(
        again.worst_m[0] >= MIN_PUSH_M,
        "expected the push to take robot {pushed} at least {MIN_PUSH_M} m away, found {:.2} m",
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

/// Awaits `future` for at most [`CALL_TIMEOUT`].
async fn within_timeout<T>(
    what: &str,
    future: impl Future<Output = Result<T, roundel_client::Error>>,
) -> anyhow::Result<T> {
    let ended = timeout(CALL_TIMEOUT, future).await;
    Ok(ended.with_context(|| format!("no {what} within {CALL_TIMEOUT:?}"))??)
}

/// The first snapshot in which enough robots are observed.
async fn first_complete(latest: &mut Latest) -> Result<Snapshot, roundel_client::Error> {
    loop {
        let snapshot = latest.next().await?;
        if observed(&snapshot).len() >= ROBOTS {
            return Ok(snapshot.as_ref().clone());
        }
    }
}

/// Ids and positions of the observed robots.
fn observed(snapshot: &Snapshot) -> Vec<(u64, Point)> {
    let objects = snapshot.objects.iter().filter(|state| state.stage() == LifeStage::Tracked);
    objects.filter_map(|state| state.position.map(|p| (state.object_id, [p.x, p.y]))).collect()
}

/// The target position with this index on the circle.
fn target(index: usize) -> Point {
    let (sine, cosine) = (index as f64 / ROBOTS as f64 * std::f64::consts::TAU).sin_cos();
    [RADIUS_M * cosine, RADIUS_M * sine]
}

/// Ids of the robots by target, in the order of their bearings from their centroid, so that paths rarely cross.
fn assign(snapshot: &Snapshot) -> Vec<u64> {
    let mut robots = observed(snapshot);
    robots.truncate(ROBOTS);
    let centroid = [0, 1].map(|axis| robots.iter().map(|r| r.1[axis]).sum::<f64>() / ROBOTS as f64);
    let angle = |at: Point| (at[1] - centroid[1]).atan2(at[0] - centroid[0]);
    robots.sort_by(|a, b| angle(a.1).total_cmp(&angle(b.1)));
    let cost = |shift: usize| -> f64 {
        let each = robots.iter().cycle().skip(shift).take(ROBOTS).enumerate();
        each.map(|(index, robot)| distance_m(robot.1, target(index)).powi(2)).sum()
    };
    let best = (0..ROBOTS).min_by(|&a, &b| cost(a).total_cmp(&cost(b))).unwrap_or_default();
    robots.iter().cycle().skip(best).take(ROBOTS).map(|robot| robot.0).collect()
}

fn distance_m(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Robots and their target positions on the circle.
struct Formation {
    client: Client,
    latest: Latest,
    clock: ClockOffset,
    /// By target.
    ids: Vec<u64>,
}

/// Result of [`Formation::hold`].
struct Held {
    took: Duration,
    rms_m: f64,
    /// Largest position error of each robot.
    worst_m: Vec<f64>,
}

impl Formation {
    /// Drives for at least `least`, until the circle has been kept for [`SETTLED`].
    async fn hold(&mut self, phase: &str, least: Duration) -> anyhow::Result<Held> {
        let begin = Instant::now();
        let (mut reported, mut settled_since) = (begin, None);
        let mut worst_m = vec![0.0_f64; ROBOTS];
        let mut ticks = interval(PERIOD);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            ticks.tick().await;
            let error_m = self.step().await?;
            worst_m.iter_mut().zip(&error_m).for_each(|(worst, error)| *worst = worst.max(*error));
            let rms_m =
                (error_m.iter().map(|error| error * error).sum::<f64>() / ROBOTS as f64).sqrt();
            let now = Instant::now();
            settled_since = (rms_m <= TOLERANCE_M).then(|| settled_since.unwrap_or(now));
            if now - reported >= Duration::from_secs(1) {
                reported = now;
                println!(
                    "{:5.1} s  {phase}: rms {:6.1} mm",
                    (now - begin).as_secs_f64(),
                    rms_m * 1e3
                );
            }
            match settled_since {
                Some(since) if now - since >= SETTLED && now - begin >= least => {
                    return Ok(Held { took: since - begin, rms_m, worst_m });
                }
                _ if now - begin > TIMEOUT => {
                    bail!(
                        "{phase}: expected rms {TOLERANCE_M} m within {TIMEOUT:?}, found {rms_m:.3} m"
                    );
                }
                _ => {}
            }
        }
    }

    /// Commands all robots. Returns their position errors, metres.
    async fn step(&mut self) -> anyhow::Result<Vec<f64>> {
        let snapshot = within_timeout("snapshot", self.latest.next()).await?;
        let ahead_s = (self.clock.server_now_ns() - snapshot.pose_time_ns) as f64 * 1e-9;
        let positions = self.positions(&predicted(&snapshot, ahead_s + COMMAND_DELAY_S))?;
        // Predicted positions may be wrong, so robots that are not observed get no commands, and stop.
        let observed = observed(&snapshot);
        let is_observed = |id: u64| observed.iter().any(|robot| robot.0 == id);
        let velocities = (0..ROBOTS).map(|index| (self.ids[index], velocity(index, &positions)));
        let velocities = velocities.filter(|(id, _)| is_observed(*id));
        within_timeout("response to a command", self.client.drive(velocities)).await?;
        let now = self.positions(&snapshot)?;
        Ok(now.into_iter().enumerate().map(|(i, at)| distance_m(at, target(i))).collect())
    }

    fn positions(&self, snapshot: &Snapshot) -> anyhow::Result<Vec<Point>> {
        let at = |id: &u64| {
            let state = snapshot.objects.iter().find(|state| state.object_id == *id);
            let position = state.and_then(|state| state.position);
            position
                .map(|p| [p.x, p.y])
                .with_context(|| format!("the server no longer tracks robot {id}"))
        };
        self.ids.iter().map(at).collect()
    }
}

/// The commanded velocity of a robot: towards its target, and away from robots nearby.
fn velocity(index: usize, at: &[Point]) -> [f64; 3] {
    let (own, target) = (at[index], target(index));
    let mut velocity = [0, 1].map(|axis| GAIN_HZ * (target[axis] - own[axis]));
    for (_, other) in at.iter().enumerate().filter(|(other, _)| *other != index) {
        let gap_m = distance_m(own, *other);
        let strength =
            AVOIDANCE_GAIN_HZ * (AVOIDANCE_DISTANCE_M - gap_m).max(0.0) / gap_m.max(0.05);
        velocity = [0, 1].map(|axis| velocity[axis] + strength * (own[axis] - other[axis]));
    }
    let share = TOP_SPEED_M_S / velocity[0].hypot(velocity[1]).max(TOP_SPEED_M_S);
    [velocity[0] * share, velocity[1] * share, 0.0]
}
