//! How fast a recording is fused anew: the reference installations are recorded by a server that runs, in real time,
//! and then played from their observations as fast as it goes, and copied into files, three times each, on one core.
//!
//! ```sh
//! cargo run --release -p roundel-tests --bin replays                # R4 and R16, 20 s each
//! cargo run --release -p roundel-tests --bin replays -- 60
//! ```
//!
//! Told is how many times faster than it was recorded, and whether all three files are the same to the last bit.

use std::{
    collections::VecDeque,
    fs,
    path::Path,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use anyhow::{Context, bail};
use roundel_core::{time::Timestamp, world::FrameObservations};
use roundel_server::{
    config::Config,
    replay::{
        From, Status,
        copy::copy,
        server::{ReplayServer, Scene, Wanted, beginning},
    },
    serve::Server,
    source::{Arrival, CaptureClock, FrameSource, LentFrame, OpenSource, Sighting, SourceError},
    stop::Stop,
};
use roundel_tests::{arena::Arena, export::Export, scenario::swarm::PRECISE, sensor::Stream};

/// As of the `roundel` command.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Room for the server to start.
const LEAD_S: f64 = 0.5;
const RUNS: usize = 3;
/// What a replay can be asked for at most.
const FASTEST: f64 = 100.0;

/// What one camera sees, each frame when it is due.
struct Sights {
    coming: VecDeque<FrameObservations>,
    clock: roundel_server::clock::Clock,
    stop: Stop,
}

impl FrameSource for Sights {
    fn next_frame(&mut self) -> Result<LentFrame<'_>, SourceError> {
        Err(SourceError::Failed("it gives what was seen, and no frames".into()))
    }

    fn next(&mut self) -> Result<Arrival<'_>, SourceError> {
        let observations = self.coming.pop_front().ok_or(SourceError::Finished)?;
        let wait_s = observations.received_time.seconds_since(self.clock.now());
        if wait_s > 0.0 {
            self.stop.wait(Duration::from_secs_f64(wait_s));
        }
        if self.stop.is_stopped() {
            return Err(SourceError::Stopped);
        }
        let clock = CaptureClock::EXACT;
        Ok(Arrival::Seen(Box::new(Sighting { observations, clock, skipped: 0, figures: None })))
    }
}

/// Opens them once.
struct Once(Option<Sights>);

impl OpenSource for Once {
    fn open(&mut self) -> Result<Box<dyn FrameSource>, SourceError> {
        match self.0.take() {
            Some(sights) => Ok(Box::new(sights)),
            None => Err(SourceError::Finished),
        }
    }
}

fn main() -> anyhow::Result<()> {
    let seconds = std::env::args().skip(1).find_map(|it| it.parse().ok()).unwrap_or(20.0);
    for (name, arena) in [("R4", Arena::r4(1)), ("R16", Arena::r16(1))] {
        measure(name, &arena, seconds)?;
    }
    Ok(())
}

fn measure(name: &str, arena: &Arena, seconds: f64) -> anyhow::Result<()> {
    let folder = tempfile::tempdir()?;
    let file = record(arena, seconds, folder.path())?;
    let wanted = Wanted { file: file.clone(), from: From::Observations, config: None };
    let (mut played, mut times, mut files) = (Vec::new(), Vec::new(), Vec::new());
    for run in 0..RUNS {
        played.push(play(Scene::open(&wanted)?, &file)?);
        let scene = Scene::open(&wanted)?;
        let to = folder.path().join(format!("anew{run}.mcap"));
        let begun = Instant::now();
        let copied = copy(scene, &to, |_| {})?;
        times.push(copied.seconds / begun.elapsed().as_secs_f64());
        files.push((fs::read(&to)?, copied));
    }
    let [first, others @ ..] = &files[..] else { bail!("nothing was fused") };
    let are_same = others.iter().all(|other| other.0 == first.0);
    let best = |times: &[f64]| times.iter().copied().fold(0.0, f64::max);
    println!(
        "{name}: {} snapshots of {:.1} s, {:.1} MB; played {:.1} times faster than recorded, copied {:.1} times, {} to \
         the last bit",
        first.1.snapshots,
        first.1.seconds,
        fs::metadata(&file)?.len() as f64 * 1e-6,
        best(&played),
        best(&times),
        if are_same { "the same" } else { "NOT the same" }
    );
    Ok(())
}

/// Plays it as fast as it goes, as a server does: how many times faster than it was recorded.
fn play(scene: Scene, file: &Path) -> anyhow::Result<f64> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let begin = Status { speed: FASTEST, ..beginning(&scene, file, From::Observations) };
        let seconds = begin.span.1.seconds_since(begin.span.0);
        let begun = Instant::now();
        let server = ReplayServer::start(scene, "127.0.0.1:0".parse()?, begin).await?;
        while !server.replay().status().ended {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        let took_s = begun.elapsed().as_secs_f64();
        server.shutdown().await;
        Ok(seconds / took_s)
    })
}

/// Records what the arena's cameras see.
fn record(arena: &Arena, seconds: f64, folder: &Path) -> anyhow::Result<std::path::PathBuf> {
    let site = folder.join("site");
    fs::create_dir(&site)?;
    let config = Export::lab(1).write(arena, &site)?.config;
    let text = fs::read_to_string(&config)? + "\n[recording]\nstart = true\nmin_free_mb = 0\n";
    fs::write(&config, text)?;
    let config = Config::load(&config)?;
    let mut seen: Vec<VecDeque<FrameObservations>> = vec![VecDeque::new(); arena.sites.len()];
    for frame in Stream::new(arena, PRECISE, seconds) {
        seen[frame.camera.0 as usize].push_back(frame);
    }
    let seen = Arc::new(Mutex::new(seen));
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let start_ns = arena.start_ns;
    runtime.block_on(async move {
        let base: Mutex<Option<Timestamp>> = Mutex::new(None);
        let server = Server::start_with_sources(config, move |setting| {
            let mut base = base.lock().unwrap_or_else(PoisonError::into_inner);
            let begin = *base.get_or_insert_with(|| setting.clock.now().plus_seconds(LEAD_S));
            let mut seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
            let mut coming = std::mem::take(&mut seen[setting.index]);
            coming.iter_mut().for_each(|frame| shift(frame, begin.as_ns() - start_ns));
            let (clock, stop) = (setting.clock, setting.stop);
            Box::new(Once(Some(Sights { coming, clock, stop })))
        })
        .await?;
        tokio::time::sleep(Duration::from_secs_f64(seconds + 2.0 * LEAD_S)).await;
        let status = server.recorder().context("the server records")?.status();
        server.shutdown().await;
        if status.dropped > 0 {
            bail!(
                "{} messages found no room: this machine is too slow to record that",
                status.dropped
            );
        }
        Ok(status.folder.join(status.file))
    })
}

/// The same frame at another time.
fn shift(frame: &mut FrameObservations, by_ns: i64) {
    let moved = |time: Timestamp| Timestamp::from_ns(time.as_ns() + by_ns);
    frame.capture_time = moved(frame.capture_time);
    frame.received_time = moved(frame.received_time);
    for detection in &mut frame.detections {
        detection.capture_time = moved(detection.capture_time);
    }
}
