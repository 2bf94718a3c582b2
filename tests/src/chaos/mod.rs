//! Servers under faults that a seed chooses, and the promises that they keep.
//!
//! | module | content |
//! | --- | --- |
//! | [`timetable`] | which faults happen when |
//! | [`world`] | the robots and cameras that a server sees, with the truth |
//! | `sender`, `link` | honest programs that push detections, and their network |
//! | `attack` | hostile and greedy clients |
//! | `operator` | a person who changes the configuration |
//! | `host`, `disk` | the server in this process or in one of its own, whose disk and clock are disturbed |
//! | [`judge`] | snapshots of an honest client against the truth |
//! | `files` | what is left on the disk |
//!
//! Promises: a robot in sight of a healthy camera stays tracked under its id while the server runs; poses agree with the
//! truth within their covariances; snapshots never cease; the server stops within seconds; every file can be opened, and
//! has each change of the configuration that was confirmed.

mod attack;
mod disk;
mod files;
mod host;
pub mod judge;
mod link;
mod operator;
mod sender;
pub mod timetable;
pub mod world;

use std::{
    fmt,
    path::Path,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use anyhow::Context;
use futures::StreamExt;
use roundel_client::{Client, Subscription, Update};
use tokio::{
    task::{AbortHandle, JoinSet},
    time::{sleep, timeout},
};

use disk::DiskState;
use files::Expected;
use host::Host;
use judge::{Judge, Received};
use link::Link;
use operator::Confirmed;
use sender::SenderFaults;
use timetable::{CAMERAS, Fault, Stage, Timetable};
use world::World;

/// Time after the last fault in which all robots must be tracked again; a limit for hangs.
const RECOVERY: Duration = Duration::from_secs(20);
/// Limit of a whole run, for hangs of the test itself.
const LONGEST: Duration = Duration::from_secs(180);

/// The result of one seed.
#[derive(Debug)]
pub struct Outcome {
    /// The number that chose the timetable and the world.
    pub seed: u64,
    /// How the server was run.
    pub stage: Stage,
    /// The faults of the run.
    pub timetable: Timetable,
    /// What the honest client received.
    pub received: Received,
    /// Longest stop of the server, seconds.
    pub stop_s: f64,
    /// Broken promises.
    pub violations: Vec<String>,
    /// What processes logged.
    pub log: String,
}

impl Outcome {
    /// Whether all promises were kept.
    pub fn is_kept(&self) -> bool {
        self.violations.is_empty()
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let process = if self.stage == Stage::Process { " --process" } else { "" };
        writeln!(f, "seed {} breaks promises; to reproduce:", self.seed)?;
        writeln!(
            f,
            "    cargo run -p roundel-tests -- chaos --from {} --seeds 1{process}",
            self.seed
        )?;
        let hangs = if self.timetable.disk_hangs_at_stop { ", while the disk hangs" } else { "" };
        for (at_s, fault) in &self.timetable.faults {
            writeln!(f, "  {at_s:.2} s: {fault:?}")?;
        }
        writeln!(
            f,
            "  {:.2} s: stop{hangs}; camera {} is healthy",
            self.timetable.length_s, self.timetable.healthy_camera
        )?;
        for violation in &self.violations {
            writeln!(f, "  broken: {violation}")?;
        }
        writeln!(f, "  {:?}", self.received)
    }
}

/// Runs a seed to its end.
pub async fn run(seed: u64, stage: Stage) -> Outcome {
    let timetable = Timetable::new(seed, stage);
    let mut outcome = Outcome {
        seed,
        stage,
        timetable,
        received: Received::default(),
        stop_s: 0.0,
        violations: Vec::new(),
        log: String::new(),
    };
    let result = timeout(LONGEST, play(&mut outcome)).await;
    match result {
        Ok(Ok(())) => {}
        Ok(Err(error)) => outcome.violations.push(format!("{error:#}")),
        Err(_) => outcome.violations.push(format!("the run hangs for {LONGEST:?}")),
    }
    outcome
}

async fn play(outcome: &mut Outcome) -> anyhow::Result<()> {
    let folder = tempfile::tempdir()?;
    let mut run = Run::start(outcome, folder.path()).await?;
    let timetable = outcome.timetable.clone();
    let mut result = run.play(&timetable).await;
    if result.is_ok() {
        result = run.recover(&timetable).await;
    }
    if let Some(disturbance) =
        run.host.disturbance.as_ref().filter(|_| timetable.disk_hangs_at_stop)
    {
        disturbance.set_disk(DiskState::Hung)?;
    }
    lock(&run.judge).set_running(false);
    let stopped = run.stop().await;
    if let Some(disturbance) = &run.host.disturbance {
        disturbance.set_disk(DiskState::Works)?;
    }
    run.tasks.shutdown().await;
    outcome.log = run.host.whole_log();
    (outcome.received, outcome.violations) = lock(&run.judge).finish();
    outcome.stop_s = run.longest_stop.as_secs_f64();
    outcome.violations.extend(files::problems(folder.path(), &run.confirmed, expected(&timetable)));
    result.and(stopped)
}

/// What files must have after these faults.
fn expected(timetable: &Timetable) -> Expected {
    let disturbs_disk = |fault: &Fault| {
        matches!(fault, Fault::FullDisk { .. } | Fault::SlowDisk { .. } | Fault::HungDisk { .. })
    };
    let kills = |fault: &Fault| matches!(fault, Fault::Kill { .. });
    let any = |is: &dyn Fn(&Fault) -> bool| timetable.faults.iter().any(|(_, fault)| is(fault));
    let stored = !any(&disturbs_disk) && !timetable.disk_hangs_at_stop;
    Expected { complete_recordings: stored && !any(&kills), stored }
}

/// One seed under way.
struct Run {
    seed: u64,
    world: Arc<World>,
    host: Host,
    judge: Arc<Mutex<Judge>>,
    senders: Vec<Arc<SenderFaults>>,
    confirmed: Confirmed,
    tasks: JoinSet<()>,
    longest_stop: Duration,
    _client_link: Link,
    /// Ends a fault of the disk.
    disk_repair: Option<AbortHandle>,
}

impl Run {
    async fn start(outcome: &Outcome, folder: &Path) -> anyhow::Result<Self> {
        let world = Arc::new(World::new(outcome.seed, folder)?);
        let mut host = Host::new(outcome.stage, world.clone(), folder)?;
        host.start().await.context("the first start")?;
        let judge = Arc::new(Mutex::new(Judge::new(world.clone(), host.offset_ns.clone())));
        let mut tasks = JoinSet::new();
        let mut senders = Vec::new();
        for camera in 0..CAMERAS {
            let faults = Arc::new(SenderFaults::new(Link::to(host.address.clone()).await?));
            tasks.spawn(sender::send(world.clone(), camera, faults.clone()));
            senders.push(faults);
        }
        let client_link = Link::to(host.address.clone()).await?;
        let client = Client::connect_lazily(&client_link.url())?;
        let confirmed = Confirmed::default();
        tasks.spawn(watch(client.clone(), judge.clone()));
        tasks.spawn(watch_pauses(judge.clone()));
        tasks.spawn(operator::change_objects(client, confirmed.clone()));
        lock(&judge).set_running(true);
        Ok(Self {
            seed: outcome.seed,
            world,
            host,
            judge,
            senders,
            confirmed,
            tasks,
            longest_stop: Duration::ZERO,
            _client_link: client_link,
            disk_repair: None,
        })
    }

    async fn play(&mut self, timetable: &Timetable) -> anyhow::Result<()> {
        for (at_s, fault) in &timetable.faults {
            self.wait_until(*at_s).await;
            self.cause(*fault).await.with_context(|| format!("{fault:?}"))?;
        }
        self.wait_until(timetable.length_s).await;
        anyhow::ensure!(!self.host.has_ended(), "the server has ended:\n{}", self.host.whole_log());
        Ok(())
    }

    async fn wait_until(&self, at_s: f64) {
        sleep(Duration::from_secs_f64((at_s - self.world.seconds()).max(0.0))).await;
    }

    /// Waits until all robots are tracked.
    async fn recover(&mut self, timetable: &Timetable) -> anyhow::Result<()> {
        let tracked = async {
            while !lock(&self.judge).tracks_all() {
                sleep(Duration::from_millis(50)).await;
            }
        };
        let recovered = timeout(RECOVERY, tracked).await;
        recovered.with_context(|| {
            let camera = timetable.healthy_camera;
            format!("camera {camera} is healthy, but not all robots are tracked after {RECOVERY:?}")
        })
    }

    async fn cause(&mut self, fault: Fault) -> anyhow::Result<()> {
        match fault {
            Fault::StallLink { camera, lasts } => {
                let sender = self.senders[camera].clone();
                sender.link.set_stalled(true);
                self.tasks.spawn(async move {
                    sleep(lasts).await;
                    sender.link.set_stalled(false);
                });
            }
            Fault::BreakLink { camera } => self.senders[camera].link.break_now(),
            Fault::LoseSender { camera, lasts } => {
                let sender = self.senders[camera].clone();
                sender.set_lost(true);
                self.tasks.spawn(async move {
                    sleep(lasts).await;
                    sender.set_lost(false);
                });
            }
            Fault::DuplicateSender { camera } => {
                let name = self.world.arena.sites[camera].name.clone();
                self.tasks.spawn(attack::duplicate_sender(self.host.address.get(), name));
            }
            Fault::Restart { pause } => {
                self.stop().await?;
                self.start_again(pause).await?;
            }
            Fault::Kill { pause } => {
                lock(&self.judge).set_running(false);
                self.host.kill()?;
                self.start_again(pause).await?;
            }
            Fault::FullDisk { lasts } => self.disturb_disk(DiskState::Full, lasts)?,
            Fault::SlowDisk { lasts, delay } => self.disturb_disk(DiskState::Slow(delay), lasts)?,
            Fault::HungDisk { lasts } => self.disturb_disk(DiskState::Hung, lasts)?,
            Fault::StepClock { by_s } => self.host.step_clock((by_s * 1e9) as i64)?,
            attack => self.attack(attack),
        }
        Ok(())
    }

    fn attack(&mut self, fault: Fault) {
        let (address, seed, judge) = (self.host.address.get(), self.seed, self.judge.clone());
        self.tasks.spawn(async move {
            if let Err(error) = attack::attack(fault, address, seed).await {
                lock(&judge).violate(format!("{error:#}"));
            }
        });
    }

    async fn stop(&mut self) -> anyhow::Result<()> {
        lock(&self.judge).set_running(false);
        let took = self.host.stop().await?;
        self.longest_stop = self.longest_stop.max(took);
        Ok(())
    }

    async fn start_again(&mut self, pause: Duration) -> anyhow::Result<()> {
        sleep(pause).await;
        self.host.start().await?;
        lock(&self.judge).set_running(true);
        Ok(())
    }

    /// A later fault of the disk replaces an earlier one.
    fn disturb_disk(&mut self, state: DiskState, lasts: Duration) -> anyhow::Result<()> {
        let disturbance = self.host.disturbance.as_ref().context("expected a process")?;
        if let Some(repair) = self.disk_repair.take() {
            repair.abort();
        }
        disturbance.set_disk(state)?;
        let repair = disturbance.repair_later(lasts)?;
        self.disk_repair = Some(self.tasks.spawn(repair));
        Ok(())
    }
}

/// Passes every snapshot that an honest client receives to the judge.
async fn watch(client: Client, judge: Arc<Mutex<Judge>>) {
    let mut snapshots = client.snapshots(Subscription::default());
    while let Some(update) = snapshots.next().await {
        match update {
            Ok(Update::Snapshot(snapshot)) => lock(&judge).take(&snapshot),
            Ok(_) => {}
            Err(error) => lock(&judge).violate(format!("the honest client is rejected: {error}")),
        }
    }
}

/// Reports to the judge how late this process runs.
async fn watch_pauses(judge: Arc<Mutex<Judge>>) {
    const INTERVAL: Duration = Duration::from_millis(5);
    loop {
        let begun = Instant::now();
        sleep(INTERVAL).await;
        lock(&judge).paused(begun.elapsed().saturating_sub(INTERVAL));
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Runs seeds, several at a time, and hands over each outcome.
pub async fn run_all(
    seeds: std::ops::Range<u64>,
    stage: Stage,
    at_once: usize,
    mut report: impl FnMut(Outcome),
) {
    let runs = seeds.map(|seed| async move { tokio::spawn(run(seed, stage)).await });
    let mut outcomes = futures::stream::iter(runs).buffer_unordered(at_once);
    while let Some(outcome) = outcomes.next().await {
        match outcome {
            Ok(outcome) => report(outcome),
            Err(error) => std::panic::resume_unwind(error.into_panic()),
        }
    }
}
