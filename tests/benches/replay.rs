//! Speed of running fusion again on recordings: `cargo bench -p roundel-tests --bench replay [-- SECONDS]`.
//!
//! A server records R4 and R16 in real time, 20 s each by default. The recordings are then played from their observations
//! at full speed and copied into files, three times each, on one core. Prints how many times faster than recorded that is,
//! and whether all copies are identical.

use std::{
    fs,
    path::Path,
    time::{Duration, Instant},
};

use anyhow::bail;
use roundel_server::app::replay_server::ReplayServer;
use roundel_server::archive::replay::{
    ReplayFrom, ReplayStatus,
    copy::copy,
    session::{ReplayOptions, ReplaySession, initial_status},
};
use roundel_tests::{
    arena::Arena,
    recorded::{Recorded, record},
    scenario::swarm::PRECISE,
    sensor::Stream,
};

/// As in the `roundel` binary.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const RUNS: usize = 3;
/// The highest speed that a replay accepts.
const FASTEST: f64 = 100.0;

fn main() -> anyhow::Result<()> {
    let seconds = std::env::args().skip(1).find_map(|it| it.parse().ok()).unwrap_or(20.0);
    for (name, arena) in [("R4", Arena::r4(1)), ("R16", Arena::r16(1))] {
        measure(name, &arena, seconds)?;
    }
    Ok(())
}

fn measure(name: &str, arena: &Arena, seconds: f64) -> anyhow::Result<()> {
    let folder = tempfile::tempdir()?;
    let Recorded { file, dropped } =
        record(arena, Stream::new(arena, PRECISE, seconds), folder.path(), &[])?;
    if dropped > 0 {
        bail!("{dropped} messages were dropped: this machine is too slow to record that");
    }
    let options =
        ReplayOptions { file: file.clone(), from: ReplayFrom::Observations, config: None };
    let (mut played, mut times, mut files) = (Vec::new(), Vec::new(), Vec::new());
    for run in 0..RUNS {
        played.push(play(ReplaySession::open(&options)?, &file)?);
        let session = ReplaySession::open(&options)?;
        let to = folder.path().join(format!("copy{run}.mcap"));
        let started = Instant::now();
        let copied = copy(session, &to, |_| {})?;
        times.push(copied.seconds / started.elapsed().as_secs_f64());
        files.push((fs::read(&to)?, copied));
    }
    let [first, others @ ..] = &files[..] else { bail!("nothing was copied") };
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

/// Plays a recording at full speed through a server, and returns how many times faster than recorded that was.
fn play(session: ReplaySession, file: &Path) -> anyhow::Result<f64> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let begin = ReplayStatus {
            speed: FASTEST,
            ..initial_status(&session, file, ReplayFrom::Observations)
        };
        let seconds = begin.span.1.seconds_since(begin.span.0);
        let started = Instant::now();
        let server = ReplayServer::start(session, "127.0.0.1:0".parse()?, begin).await?;
        while !server.replay().status().ended {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        let took_s = started.elapsed().as_secs_f64();
        server.shutdown().await;
        Ok(seconds / took_s)
    })
}
